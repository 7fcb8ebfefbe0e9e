// SPDX-License-Identifier: Apache-2.0
/// @file
/// Cast shadows at scale: seconds and error of exact sums and of blocks of lights, for numbers
/// of lights and of receivers, under hard and soft light, on clean and on noisy shadow
/// pictures; penumbra widths against the truth. Prints the tables of docs/numerics/shadow.md,
/// writes the records and the plot. Shadow pictures are ray-traced: no capture, nothing hidden.

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>
#include <thread>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/parallel.h"
#include "core/plot.h"
#include "core/random.h"
#include "core/report.h"
#include "core/tradeoff.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/relight/shadow/predict.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/light/rig_lights.h"
#include "haarlight/render/scene/scene.h"
#include "relight/shadow/shadow_points.h"
#include "relight/shadow/shadow_truth.h"

namespace haarlight {
namespace {

using Record = TradeoffRecord;
using Eigen::Vector3d;

struct Arguments {
  std::string rig = "configs/rigs/cube32.toml";
  std::string scene = "configs/scenes/airplane.toml";
  std::string environment = "configs/environments/room.hdr";
  std::string json;
  std::string plot;
  int repeats = 3;
  bool is_quick = false;
  std::string command;
};

constexpr relight::HeightRange kAirplane{76.0, 128.0};

/// The rig with its one face cut into side x side lights.
Rig rig_with(const std::string& file, int side) {
  Rig rig = read_rig(file);
  Face& face = rig.faces.at(0);
  const double scale = static_cast<double>(face.rows) / side;
  face.rows = face.cols = side;
  face.pitch_mm *= scale;
  face.emitter_w_mm *= scale;
  face.emitter_h_mm *= scale;
  return rig;
}

/// Fraction of every light that each plane pixel's centre sees past the object.
std::vector<relight::Visibility> ideal_pictures(const relight::PlaneFrame& frame,
                                                const render::Scene& object,
                                                std::span<const render::SquareLight> lights) {
  const render::RayCaster caster(object);
  const render::DirectLight direct(caster, lights);
  std::vector<relight::Visibility> pictures;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    pictures.push_back({Image<float>(frame.height, frame.width, 1),
                        Image<std::uint8_t>(frame.height, frame.width, 1),
                        {}});
  }
  parallel_for(
      static_cast<std::size_t>(frame.height), 1, [&](std::size_t begin, std::size_t end) {
        std::vector<render::LightContribution> contributions(lights.size());
        for (std::size_t row = begin; row < end; ++row) {
          for (int x = 0; x < frame.width; ++x) {
            const int y = static_cast<int>(row);
            const Vector3d up = frame.plane.n;
            const render::SurfacePoint point{frame.world_of(x + 0.5, y + 0.5), up, up, up, 0};
            (void)direct.evaluate(point, render::Material{},
                                  row * 100000 + static_cast<std::uint64_t>(x), contributions);
            for (std::size_t k = 0; k < lights.size(); ++k) {
              pictures[k].value(y, x) = static_cast<float>(contributions[k].visible);
              pictures[k].known(y, x) = 1;
            }
          }
        }
      });
  return pictures;
}

/// The pictures of a camera with 1 % noise, clamped as V is.
std::vector<relight::Visibility> with_noise(std::vector<relight::Visibility> pictures,
                                            double sigma) {
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      std::size_t at = 0;
      for (float& v : pictures[k].value.pixels()) {
        double sum = -6.0;
        for (std::uint64_t i = 0; i < 12; ++i) {
          sum += uniform_unit(hash_key(k, at, i));
        }
        v = std::clamp(v + static_cast<float>(sigma * sum), 0.0F, 1.0F);
        ++at;
      }
    }
  });
  return pictures;
}

/// Hills between 100 mm below the plane and 50 mm above it, under the object.
std::vector<render::SurfacePoint> hills(int n) {
  const int side = static_cast<int>(std::lround(std::sqrt(n)));
  std::vector<render::SurfacePoint> points;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      const double x = ((col + 0.5) / side - 0.5) * 300.0;
      const double y = ((row + 0.5) / side - 0.5) * 300.0;
      const Vector3d normal = Vector3d(-1.5 * std::cos(x / 50.0) * std::cos(y / 50.0),
                                       1.5 * std::sin(x / 50.0) * std::sin(y / 50.0), 1.0)
                                  .normalized();
      points.push_back({{x, y, -25.0 + 75.0 * std::sin(x / 50.0) * std::cos(y / 50.0)},
                        normal,
                        normal,
                        Vector3d::UnitZ(),
                        0});
    }
  }
  return points;
}

struct Light {
  std::string name;
  std::vector<Vector3d> weights;
};

std::vector<Light> lightings(const Rig& rig, const std::string& environment) {
  const auto n = static_cast<std::size_t>(rig.n_lights());
  const int side = rig.faces[0].rows;
  std::vector<Light> all;
  const Eigen::MatrixXd room =
      relight::rig_weights(render::Environment::read(environment), rig).weights;
  Light soft{"room", std::vector<Vector3d>(n)};
  for (std::size_t k = 0; k < n; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    soft.weights[k] = room.cols() == 3 ? Vector3d(room.row(row).transpose())
                                       : Vector3d::Constant(room(row, 0));
  }
  all.push_back(soft);
  all.push_back({"all equal", std::vector<Vector3d>(n, Vector3d::Ones())});
  Light rough{"random", std::vector<Vector3d>(n)};
  for (std::size_t k = 0; k < n; ++k) {
    rough.weights[k].setConstant(std::pow(uniform_unit(hash_key(5, k)), 8.0));
  }
  all.push_back(rough);
  Light nine{"nine", std::vector<Vector3d>(n, Vector3d::Zero())};
  for (const int row : {side / 6, side / 2, 5 * side / 6}) {
    for (const int col : {side / 6, side / 2, 5 * side / 6}) {
      nine.weights[static_cast<std::size_t>(row * side + col)].setOnes();
    }
  }
  all.push_back(nine);
  return all;
}

struct Difference {
  double relative_l2 = 0.0;
  double worst = 0.0;
};

Difference compare(const relight::PointsResult& found, const relight::PointsResult& exact) {
  double square = 0.0;
  double norm = 0.0;
  double worst = 0.0;
  double peak = 0.0;
  for (std::size_t i = 0; i < exact.totals.size(); ++i) {
    const Vector3d e = found.totals[i].shadowed - exact.totals[i].shadowed;
    square += e.squaredNorm();
    norm += exact.totals[i].shadowed.squaredNorm();
    worst = std::max(worst, e.cwiseAbs().maxCoeff());
    peak = std::max(peak, exact.totals[i].shadowed.maxCoeff());
  }
  return {norm > 0.0 ? std::sqrt(square / norm) : 0.0, peak > 0.0 ? worst / peak : 0.0};
}

class Study {
 public:
  explicit Study(const Arguments& arguments) : arguments_(arguments) {
    object_ = render::with_instances_expanded(render::read_scene(arguments.scene).scene,
                                              arguments.scene);
    frame_ = relight::make_plane_frame(read_rig(arguments.rig).planes.at(0));
    relight::remove_plane_triangles(object_, frame_);
  }

  /// Pictures of a rig of side x side lights.
  const std::vector<relight::Visibility>& pictures(int side) {
    auto [position, is_new] = pictures_.try_emplace(side);
    if (is_new) {
      position->second =
          ideal_pictures(frame_, object_, render::rig_lights(rig_with(arguments_.rig, side)));
    }
    return position->second;
  }

  void run(int side, int n_points, bool is_noisy, const std::vector<std::string>& names,
           int repeats) {
    const Rig rig = rig_with(arguments_.rig, side);
    const std::vector<render::SquareLight> lights = render::rig_lights(rig);
    const std::vector<relight::Visibility> noisy =
        is_noisy ? with_noise(pictures(side), 0.01) : std::vector<relight::Visibility>{};
    const std::vector<relight::Visibility>& shown = is_noisy ? noisy : pictures(side);
    const std::vector<relight::SamplingPlane> planes{
        {frame_, [&](int k) { return shown[static_cast<std::size_t>(k)]; }, kAirplane}};
    const std::vector<render::SurfacePoint> points = hills(n_points);
    for (const Light& light : lightings(rig, arguments_.environment)) {
      if (std::find(names.begin(), names.end(), light.name) != names.end()) {
        measure(light, lights, planes, points, is_noisy, repeats);
        write();  // what there is, should the rest be interrupted
      }
    }
  }

  void write() const {
    if (!arguments_.json.empty()) {
      write_file_atomically(arguments_.json, tradeoff_json(records_));
    }
    if (!arguments_.plot.empty()) {
      write_plot();
    }
  }

  /// Width of the drawn edge over the true one, for a straight edge at 150 mm.
  void penumbras();

 private:
  void measure(const Light& light, std::span<const render::SquareLight> lights,
               std::span<const relight::SamplingPlane> planes,
               std::span<const render::SurfacePoint> points, bool is_noisy, int repeats) {
    struct Mode {
      std::string name;
      double tolerance;
    };
    const std::vector<Mode> modes{{"exact", 0.0}, {"0.1 %", 0.001}, {"1 %", 0.01}};
    std::vector<relight::PointsResult> results(modes.size());
    std::vector<std::function<void()>> runs;
    for (std::size_t m = 0; m < modes.size(); ++m) {
      runs.emplace_back([&, m] {
        relight::PointsOptions options;
        options.tolerance.relative_l2 = modes[m].tolerance;
        results[m] = relight::shadow_at_points(points, planes, lights, light.weights, options);
      });
    }
    const std::vector<std::vector<double>> seconds = time_in_turn(runs, repeats);
    for (std::size_t m = 0; m < modes.size(); ++m) {
      const relight::PointsReport& report = results[m].report;
      const Difference found = compare(results[m], results[0]);
      Record record;
      record.algorithm = "haarlight";
      record.mode = fmt::format("cast shadows, {} light{}, {}", light.name,
                                is_noisy ? ", pictures with 1 % noise" : "",
                                m == 0 ? "exact" : "blocks of lights at " + modes[m].name);
      record.error_norm = "relative L2";
      record.error = found.relative_l2;
      set_times(seconds[m], record);
      record.bytes = static_cast<double>(report.table_bytes + report.totals_bytes);
      record.conditions.threads = static_cast<int>(std::thread::hardware_concurrency());
      record.conditions.lights = report.n_lights;
      record.conditions.pixels = static_cast<long long>(points.size());
      record.conditions.repeats = repeats;
      record.conditions.command = arguments_.command;
      record.conditions.more.emplace_back("bytes_are", "held in memory");
      records_.push_back(record);
      times_[{light.name + (is_noisy ? " noisy" : ""), modes[m].name}].push_back(
          {lights.size(), points.size(), record.seconds});
      fmt::print(
          "| {}{} | {} | {} | {} | {:.2f} | {:.2g} | {:.2g} | {:.2g} | {:.0f} | {:.0f} |\n",
          light.name, is_noisy ? ", noise 1 %" : "", report.n_lights, points.size(),
          modes[m].name, record.seconds, found.relative_l2, found.worst,
          report.relative_l2_limit, report.lookups_a_point, record.bytes / 1e6);
      std::fflush(stdout);
    }
  }

  void write_plot() const;

  struct Time {
    std::size_t lights = 0;
    std::size_t points = 0;
    double seconds = 0.0;
  };

  Arguments arguments_;
  render::Scene object_;
  relight::PlaneFrame frame_;
  std::map<int, std::vector<relight::Visibility>> pictures_;
  std::vector<Record> records_;
  std::map<std::pair<std::string, std::string>, std::vector<Time>> times_;
};

/// Seconds over lights, and over receivers.
void Study::write_plot() const {
  std::vector<PlotPanel> panels;
  for (const bool is_over_lights : {true, false}) {
    PlotPanel panel;
    panel.title = is_over_lights ? "100 000 receivers" : "1024 lights";
    panel.x_name = is_over_lights ? "lights" : "receivers";
    panel.y_name = "seconds";
    for (const auto& [name, times] : times_) {
      if (name.first != "room") {
        continue;
      }
      std::map<std::size_t, double> line;
      for (const Time& time : times) {
        if (is_over_lights ? time.points / 10000 == 9 : time.lights == 1024) {
          line[is_over_lights ? time.lights : time.points] = time.seconds;
        }
      }
      PlotSeries series{.name = name.second, .look = static_cast<int>(panel.series.size())};
      for (const auto& [x, y] : line) {
        series.points.emplace_back(static_cast<double>(x), y);
      }
      panel.series.push_back(std::move(series));
    }
    panels.push_back(std::move(panel));
  }
  std::ofstream(arguments_.plot) << draw_panels("Time of shadows", panels, 2);
}

/// A half plane at height kEdge whose edge runs along y at x = 0; one light straight above it
/// sideways. Everything in closed form: no pixels of a capture, 0.25 mm pixels here.
void Study::penumbras() {
  constexpr double kEdge = 150.0;
  const Face face = read_rig(arguments_.rig).faces.at(0);
  const double H = face.centre.z();
  const double s = face.emitter_w_mm;
  ShadowPlane plane;
  plane.extent_u_mm = 120.0;
  plane.extent_v_mm = 10.0;
  plane.texel_mm = 0.25;
  const relight::PlaneFrame frame = relight::make_plane_frame(plane);
  render::SquareLight light;
  light.centre = {0.5 * face.pitch_mm, 0.0, H};
  light.width_mm = light.height_mm = s;
  relight::Visibility picture{Image<float>(frame.height, frame.width, 1),
                              Image<std::uint8_t>(frame.height, frame.width, 1),
                              {}};
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const double p = frame.world_of(x + 0.5, y + 0.5).x();
      const double seen =
          p * (1.0 - H / kEdge);  // where the ray past the edge meets the lights
      picture.value(y, x) =
          static_cast<float>(std::clamp((light.centre.x() + 0.5 * s - seen) / s, 0.0, 1.0));
      picture.known(y, x) = 1;
    }
  }
  const std::vector<render::SquareLight> lights{light};
  const std::vector<Vector3d> weights{Vector3d::Ones()};
  fmt::print(
      "| receiver mm | s(h_o - h_v)/(H - h_o) mm | none | plain | corrected | error of "
      "corrected |\n|---|---|---|---|---|---|\n");
  for (const double h : {-100.0, -50.0, 0.0, 50.0, 100.0}) {
    const double truth = relight::penumbra_width_at(s, kEdge, H, h);
    std::map<relight::WindowRule, double> widths;
    for (const relight::WindowRule rule :
         {relight::WindowRule::none, relight::WindowRule::plain,
          relight::WindowRule::corrected}) {
      const std::vector<relight::SamplingPlane> planes{
          {frame, [&](int) { return picture; }, relight::HeightRange{kEdge, kEdge}}};
      std::vector<render::SurfacePoint> points;
      constexpr double kStep = 0.05;
      for (double x = -40.0; x < 40.0; x += kStep) {
        points.push_back(
            {{x, 0.0, h}, Vector3d::UnitZ(), Vector3d::UnitZ(), Vector3d::UnitZ(), 0});
      }
      relight::PointsOptions options;
      options.rule = rule;
      const relight::PointsResult found =
          relight::shadow_at_points(points, planes, lights, weights, options);
      // sqrt(12) times the rms width of the edge's derivative.
      double mass = 0.0;
      double first = 0.0;
      double second = 0.0;
      for (std::size_t i = 1; i < points.size(); ++i) {
        const auto v = [&](std::size_t j) {
          return found.totals[j].shadowed.x() / found.totals[j].unshadowed.x();
        };
        const double x = 0.5 * (points[i].point.x() + points[i - 1].point.x());
        const double step = v(i) - v(i - 1);
        mass += step;
        first += step * x;
        second += step * x * x;
      }
      const double mean = first / mass;
      widths[rule] = std::sqrt(12.0 * std::max(0.0, second / mass - mean * mean));
    }
    fmt::print("| {:+g} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {:+.1f} % |\n", h, truth,
               widths[relight::WindowRule::none], widths[relight::WindowRule::plain],
               widths[relight::WindowRule::corrected],
               100.0 * (widths[relight::WindowRule::corrected] / truth - 1.0));
    for (const auto& [rule, name] : {std::pair{relight::WindowRule::none, "none"},
                                     std::pair{relight::WindowRule::plain, "plain"},
                                     std::pair{relight::WindowRule::corrected, "corrected"}}) {
      Record record;
      record.algorithm = "haarlight";
      record.mode = fmt::format("penumbra at {:+g} mm, window {}", h, name);
      record.error_norm = "relative error of the penumbra's width";
      record.error = std::abs(widths[rule] / truth - 1.0);
      record.conditions.lights = 1;
      record.conditions.repeats = 1;
      record.conditions.command = arguments_.command;
      record.conditions.more.emplace_back("bytes_are", "held in memory");
      records_.push_back(record);
    }
  }
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("shadow_scale", "Seconds and error of cast shadows at scale",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("--rig", &arguments.rig, "Rig; its first face is cut into other numbers",
                 {.shows_default = true});
  program.option("--scene", &arguments.scene, "The object", {.shows_default = true});
  program.option("--environment", &arguments.environment, "Soft light",
                 {.shows_default = true});
  program.option("--repeats", &arguments.repeats,
                 "Interleaved runs; the largest cases run once", {.shows_default = true});
  program.option("--json", &arguments.json, "Records, docs/reference/tradeoff.schema.json");
  program.option("--plot", &arguments.plot, "SVG of the growth with lights and receivers");
  program.flag("--quick", &arguments.is_quick, "1024 lights and 10^5 receivers only");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  for (int i = 0; i < argc; ++i) {
    arguments.command += (i > 0 ? " " : "") + std::string(argv[i]);
  }
  Study study(arguments);
  study.penumbras();
  fmt::print(
      "\n| light | lights | receivers | mode | seconds | relative L2 | worst point | promised "
      "| "
      "look-ups per receiver | MB |\n|---|---|---|---|---|---|---|---|---|---|\n");
  const std::vector<std::string> all{"room", "all equal", "random", "nine"};
  const int n = arguments.repeats;
  if (arguments.is_quick) {
    study.run(32, 100000, false, all, 1);
    study.run(32, 100000, true, {"room"}, 1);
  } else {
    study.run(32, 10000, false, {"room"}, n);
    study.run(32, 100000, false, all, n);
    study.run(32, 100000, true, {"room"}, n);
    study.run(16, 100000, false, {"room"}, n);
    study.run(32, 1000000, false, {"room"}, 1);
    study.run(64, 100000, false, {"room"}, 1);
  }
  study.write();
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("shadow_scale", haarlight::run, argc, argv);
}
