// SPDX-License-Identifier: Apache-2.0
/// @file
/// CPU time and memory of the shadow hull at the commands that a user types, over voxels, lights
/// and camera pixels: `haarlight hull`, `haarlight shadow` with a stored hull and without one, and
/// with --method plane. Prints the tables of docs/numerics/hull.md with the slopes, draws the
/// figure. Captures are rendered: no noise, relative L2 error 1e-3.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <regex>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/parallel.h"
#include "core/plot.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"
#include "haarlight/render/scene/scene.h"

namespace haarlight {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string program;
  std::string work;
  std::string plot;
  std::string rig = "configs/rigs/cube32.toml";
  std::string scene = "configs/scenes/airplane.toml";
  std::string receiver = "configs/scenes/stairs.toml";
  std::string environment = "configs/environments/room.hdr";
  std::string memory = "4G";
  bool is_quick = false;
};

/// What a capture is made with.
struct Capture {
  int side = 16;    ///< lights along the face
  int width = 320;  ///< camera pixels

  [[nodiscard]] double lights() const { return double{1} * side * side; }
  [[nodiscard]] double pixels() const { return 0.75 * width * width; }
};

constexpr int kUsualVoxels = 1 << 21;

/// cube32's file with other lights over the same face, and another camera.
std::string rig_text(const Arguments& arguments, const Capture& capture) {
  std::string text = read_file(arguments.rig);
  const auto put = [&text](const char* key, const std::string& value) {
    text = std::regex_replace(text, std::regex(fmt::format("\n{} = [^\n]*", key)),
                              fmt::format("\n{} = {}", key, value));
  };
  const int height = capture.width * 3 / 4;
  const double focal = 439.596387 * capture.width / 320.0;
  put("rows", fmt::format("{}", capture.side));
  put("cols", fmt::format("{}", capture.side));
  put("pitch", fmt::format("{}", 960.0 / capture.side));
  put("size", fmt::format("[{}, {}]", capture.width, height + 8));
  put("active_area", fmt::format("{}", height));
  put("K", fmt::format("[[{0}, 0.0, {1}], [0.0, {0}, {2}], [0.0, 0.0, 1.0]]", focal,
                       0.5 * capture.width, 0.5 * height));
  return text;
}

/// Renders the capture, one sample per pixel, and compresses it.
void make_capture(const Arguments& arguments, const Capture& capture, const std::string& file) {
  const std::string text = rig_text(arguments, capture);
  const Rig rig = parse_rig(text, "rig");
  const CameraModel& eye = rig.cameras[0].model;
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  const render::Scene scene = render::with_instances_expanded(
      render::read_scene(arguments.scene).scene, arguments.scene);
  const render::RayCaster caster(scene);
  const render::DirectLight direct(caster, lights);
  MemoryStack stack({eye.width, eye.height, 1, static_cast<int>(lights.size())});
  parallel_for(
      static_cast<std::size_t>(eye.height), 1, [&](std::size_t begin, std::size_t end) {
        std::vector<render::LightContribution> found(lights.size());
        for (std::size_t row = begin; row < end; ++row) {
          const int y = static_cast<int>(row);
          for (int x = 0; x < eye.width; ++x) {
            const auto seen = render::visible_surface(caster, eye, x + 0.5, y + 0.5);
            if (!seen) {
              continue;
            }
            const auto material = static_cast<std::size_t>(seen->material);
            const double kd = scene.materials[material].kd.mean();
            direct.evaluate(*seen, scene.materials[material], row * 100000U + x, found);
            for (std::size_t k = 0; k < lights.size(); ++k) {
              stack.at(0, y, x, static_cast<int>(k)) =
                  static_cast<float>(1e6 * kd * found[k].diffuse);
            }
          }
        }
      });
  relight::CompressSource source;
  source.stack = &stack;
  source.rig_toml = text;
  source.grid = {capture.side, capture.side};
  source.name = fs::path(file).filename().string();
  (void)relight::compress_stack(source, file, {.relative_l2 = 1e-3});
}

struct Cost {
  double cpu_s = 0.0;
  double megabytes = 0.0;  ///< largest resident set
};

/// Runs work in a child process. This one stays small: a child's peak begins with its parent's.
Cost in_child(const std::function<int()>& work, const std::string& what) {
  std::fflush(stdout);
  const pid_t child = fork();
  if (child == 0) {
    _exit(work());
  }
  int status = 0;
  rusage used{};
  if (child < 0 || wait4(child, &status, 0, &used) != child || status != 0) {
    throw Error("the command failed", what, "run it by itself: it says why");
  }
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return {seconds(used.ru_utime) + seconds(used.ru_stime),
          1.024e-3 * static_cast<double>(used.ru_maxrss)};
}

class Study {
 public:
  explicit Study(Arguments arguments) : arguments_(std::move(arguments)) {
    fs::create_directories(arguments_.work);
  }

  /// One row of the table: every command once. @param voxels  0: as many as it chooses
  void measure(std::size_t panel, double x, const Capture& capture, double voxels) {
    const std::string basis = basis_of(capture);
    const double voxel = voxels > 0.0 ? voxel_for(basis, voxels) : 0.0;
    std::vector<std::string> options{"--memory", arguments_.memory};
    if (voxel > 0.0) {
      options.insert(options.end(), {"--voxel", fmt::format("{:.5g}", voxel)});
    }
    const auto shadow = [&](const char* method) {
      return run("shadow", basis, options,
                 {"--scene", arguments_.receiver, "--cubemap", arguments_.environment, "--size",
                  "160x120", "--subpixels", "1", "--method", method, "-o", path("shadow.png")});
    };
    fs::remove(basis + ".hull");
    const Cost without = shadow("both");
    fs::remove(basis + ".hull");
    const Cost hull = run("hull", basis, options, {"-o", path("hull.ply")});
    const Cost stored = shadow("both");
    const Cost plane = shadow("plane");
    const std::vector<Cost> costs{hull, without, stored, plane};
    fmt::print("| {:.0f} | {:.0f} | {:.0f} |", n_voxels_, capture.lights(), capture.pixels());
    for (std::size_t i = 0; i < costs.size(); ++i) {
      fmt::print(" {:.1f} / {:.0f} |", costs[i].cpu_s, costs[i].megabytes);
      seconds_[panel][i].emplace_back(panel == 0 ? n_voxels_ : x, costs[i].cpu_s);
      megabytes_[panel][i].emplace_back(panel == 0 ? n_voxels_ : x, costs[i].megabytes);
    }
    fmt::print("\n");
    std::fflush(stdout);
  }

  void print_slopes() const;
  void write_plot() const;

 private:
  using Line = std::vector<std::pair<double, double>>;
  static constexpr std::array<const char*, 4> kNames{"hull", "shadow, carves", "shadow, stored",
                                                     "shadow, plane"};
  static constexpr std::array<const char*, 3> kAxes{"voxels", "lights", "camera pixels"};

  [[nodiscard]] std::string path(const std::string& name) const {
    return (fs::path(arguments_.work) / name).string();
  }

  std::string basis_of(const Capture& capture) {
    std::string file =
        path(fmt::format("airplane_{}x{}_{}.hlb", capture.side, capture.side, capture.width));
    if (!fs::exists(file)) {
      (void)in_child(
          [&] {
            make_capture(arguments_, capture, file);
            return 0;
          },
          file);
    }
    return file;
  }

  /// By the volume of the grid that the command chooses.
  double voxel_for(const std::string& basis, double voxels) {
    (void)run("hull", basis, {}, {"-o", path("hull.ply")});
    return voxel_mm_ * std::cbrt(n_voxels_ / voxels);
  }

  Cost run(const char* verb, const std::string& basis, const std::vector<std::string>& options,
           const std::vector<std::string>& more) {
    std::vector<std::string> words{arguments_.program, verb, basis};
    words.insert(words.end(), options.begin(), options.end());
    words.insert(words.end(), more.begin(), more.end());
    words.insert(words.end(), {"--quiet", "--force", "--report", path("report.json")});
    const Cost cost = in_child(
        [&words] {
          std::vector<char*> pointers;
          for (std::string& word : words) {
            pointers.push_back(word.data());
          }
          pointers.push_back(nullptr);
          (void)!freopen("/dev/null", "w", stdout);
          execv(pointers[0], pointers.data());
          return 127;
        },
        fmt::format("{} {} {}", arguments_.program, verb, basis));
    const auto report = nlohmann::json::parse(read_file(path("report.json")));
    if (report.at("details").contains("hull_voxels")) {
      n_voxels_ = report["details"]["hull_voxels"];
      voxel_mm_ = report["details"]["hull_voxel_mm"];
    }
    return cost;
  }

  Arguments arguments_;
  double n_voxels_ = 0.0;
  double voxel_mm_ = 0.0;
  std::array<std::array<Line, 4>, 3> seconds_;
  std::array<std::array<Line, 4>, 3> megabytes_;
};

/// Of the straight line through the logarithms, by least squares.
double slope_of(const std::vector<std::pair<double, double>>& line) {
  double x_mean = 0.0;
  double y_mean = 0.0;
  for (const auto& [x, y] : line) {
    x_mean += std::log(x) / static_cast<double>(line.size());
    y_mean += std::log(y) / static_cast<double>(line.size());
  }
  double xy = 0.0;
  double xx = 0.0;
  for (const auto& [x, y] : line) {
    xy += (std::log(x) - x_mean) * (std::log(y) - y_mean);
    xx += (std::log(x) - x_mean) * (std::log(x) - x_mean);
  }
  return xx > 0.0 ? xy / xx : 0.0;
}

void Study::print_slopes() const {
  fmt::print("\nSlope of all points / of the last two, CPU s; memory\n\n| over |");
  for (const char* name : kNames) {
    fmt::print(" {} |", name);
  }
  fmt::print("\n|---|---|---|---|---|\n");
  for (std::size_t p = 0; p < kAxes.size(); ++p) {
    fmt::print("| {} |", kAxes[p]);
    for (std::size_t i = 0; i < kNames.size(); ++i) {
      const auto words = [](const Line& line) {
        const auto from = line.size() < 2 ? line.begin() : line.end() - 2;
        return fmt::format("{:.2f} / {:.2f}", slope_of(line), slope_of({from, line.end()}));
      };
      fmt::print(" {}; {} |", words(seconds_[p][i]), words(megabytes_[p][i]));
    }
    fmt::print("\n");
  }
}

void Study::write_plot() const {
  std::vector<PlotPanel> panels;
  for (const bool is_time : {true, false}) {
    for (std::size_t p = 0; p < kAxes.size(); ++p) {
      PlotPanel panel;
      panel.x_name = kAxes[p];
      panel.y_name = is_time ? "CPU s" : "MB";
      for (std::size_t i = 0; i < kNames.size(); ++i) {
        panel.series.push_back({.name = kNames[i],
                                .points = (is_time ? seconds_ : megabytes_)[p][i],
                                .look = static_cast<int>(i)});
      }
      panels.push_back(std::move(panel));
    }
  }
  std::ofstream(arguments_.plot) << draw_panels("Cost of the shadow hull", panels, 3);
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("hull_scale", "CPU time and memory of the shadow hull",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("HAARLIGHT", &arguments.program, "The program to measure",
                 {.is_required = true});
  program.option("--work", &arguments.work,
                 "Folder for everything that is made; what it holds "
                 "already is not rendered again",
                 {.is_required = true});
  program.option("--memory", &arguments.memory, "For the commands", {.shows_default = true});
  program.option("--plot", &arguments.plot, "SVG of the growth");
  program.flag("--quick", &arguments.is_quick, "The smallest of each only");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  Study study(arguments);
  fmt::print(
      "CPU s / MB\n\n| voxels | lights | camera pixels | `hull` | `shadow`, carves | `shadow`, "
      "stored hull | `shadow --method plane` |\n|---|---|---|---|---|---|---|\n");
  const Capture usual;
  for (const double side : {64.0, 96.0, 128.0, 192.0, 256.0, 342.0}) {
    if (!arguments.is_quick || side == 64.0) {
      study.measure(0, 0.0, usual, side * side * side);
    }
  }
  for (const int side : {8, 16, 32}) {
    if (!arguments.is_quick || side == 8) {
      const Capture capture{side, usual.width};
      study.measure(1, capture.lights(), capture, kUsualVoxels);
    }
  }
  for (const int width : {160, 320, 640}) {
    if (!arguments.is_quick || width == 160) {
      const Capture capture{usual.side, width};
      study.measure(2, capture.pixels(), capture, kUsualVoxels);
    }
  }
  study.print_slopes();
  if (!arguments.plot.empty()) {
    study.write_plot();
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("hull_scale", haarlight::run, argc, argv);
}
