// SPDX-License-Identifier: Apache-2.0
/// @file
/// CPU seconds and errors of photometric stereo a megapixel, by method, lights and model, and
/// of integration by method; every result beside its truth. The tables of
/// docs/numerics/shape.md.

#include <algorithm>
#include <cmath>
#include <ctime>
#include <functional>
#include <numbers>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/report.h"
#include "core/tradeoff.h"
#include "haarlight/core/files.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "relight/shape/near_alternation.h"

namespace haarlight::bench {
namespace {

using Eigen::Vector3d;
using Record = TradeoffRecord;

struct Arguments {
  int side = 1000;
  int repeats = 3;
  int threads = 1;
  std::string json;
  std::string command;
};

/// Of the processors, all threads: what the work costs whatever else the machine does.
double cpu_seconds_of(const std::function<void()>& work) {
  const std::clock_t start = std::clock();
  work();
  return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
}

std::vector<double> repeat(int n, const std::function<void()>& work) {
  std::vector<double> seconds(static_cast<std::size_t>(n));
  for (double& second : seconds) {
    second = cpu_seconds_of(work);
  }
  return seconds;
}

constexpr double kWidthMm = 400.0;

/// A rippled sheet, 4 mm high.
Vector3d normal_at(const Vector3d& p) {
  return Vector3d(-0.2 * std::cos(0.1 * p.x()) * std::cos(0.08 * p.y()),
                  0.16 * std::sin(0.1 * p.x()) * std::sin(0.08 * p.y()), 1.0)
      .normalized();
}
double height_at(const Vector3d& p) {
  return 2.0 * std::sin(0.1 * p.x()) * std::cos(0.08 * p.y());
}

/// The sheet under every light, 0.5 % noise, a tenth of the samples shadowed; made when
/// requested.
class SheetStack final : public StackSource {
 public:
  SheetStack(int side, const relight::StereoLights& lights, const relight::PixelPoints& pixels)
      : side_(side), lights_(lights), pixels_(pixels) {}
  [[nodiscard]] StackDims dims() const override {
    return {
        side_, side_, 1,
        static_cast<int>(lights_.are_near ? lights_.near.size() : lights_.directions.size())};
  }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    const int n = dims().n_lights;
    float* to = out.data();
    for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
      for (int x = rect.x0; x < rect.x0 + rect.width; ++x) {
        Vector3d p = pixels_.at(x + 0.5, y + 0.5);
        const Vector3d normal = normal_at(p);
        p.z() += height_at(p);
        for (int k = 0; k < n; ++k) {
          const auto i = static_cast<std::size_t>(k);
          const double shade = lights_.are_near
                                   ? 1e6 * relight::light_stencil(lights_.near[i], p, normal)
                                   : std::max(0.0, normal.dot(lights_.directions[i]));
          const std::uint64_t key =
              hash_key(static_cast<std::uint64_t>(y) * 100000U + static_cast<std::uint64_t>(x),
                       static_cast<std::uint64_t>(k));
          const double noise = 1.0 + 0.005 * 3.46 * (uniform_unit(key) - 0.5);
          *to++ = static_cast<float>(shade * noise * (key % 10 == 0 ? 0.2 : 1.0));
        }
      }
    }
  }

 private:
  int side_;
  const relight::StereoLights& lights_;
  const relight::PixelPoints& pixels_;
};

relight::StereoLights dome(int n) {
  relight::StereoLights lights;
  for (int k = 0; k < n; ++k) {
    const double up = (25.0 + 55.0 * k / (n - 1)) * std::numbers::pi / 180.0;
    const double round = 2.399963 * k;
    lights.directions.emplace_back(std::cos(up) * std::cos(round),
                                   std::cos(up) * std::sin(round), std::sin(up));
  }
  return lights;
}

relight::StereoLights array(int side) {
  relight::StereoLights lights;
  lights.are_near = true;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      relight::NearLight light;
      light.position_mm = {930.0 * (col / (side - 1.0) - 0.5),
                           930.0 * (row / (side - 1.0) - 0.5), 900.0};
      light.mu = 1.0;
      lights.near.push_back(light);
      lights.directions.push_back(light.position_mm.normalized());
    }
  }
  return lights;
}

double mean_degrees(const relight::SurfaceEstimate& found, const relight::PixelPoints& pixels) {
  double sum = 0.0;
  double n = 0.0;
  for (int y = 0; y < found.normal.height(); ++y) {
    for (int x = 0; x < found.normal.width(); ++x) {
      if (found.state(y, x) != static_cast<int>(relight::PixelState::good)) {
        continue;
      }
      const Vector3d truth = normal_at(pixels.at(x + 0.5, y + 0.5));
      const Vector3d normal(double{found.normal(y, x, 0)}, double{found.normal(y, x, 1)},
                            double{found.normal(y, x, 2)});
      sum += std::atan2(truth.cross(normal).norm(), truth.dot(normal));
      n += 1.0;
    }
  }
  return sum / n * 180.0 / std::numbers::pi;
}

Record record_of(const Arguments& arguments, const std::string& mode, int lights) {
  Record record;
  record.algorithm = "haarlight";
  record.mode = mode;
  record.conditions.threads = arguments.threads;
  record.conditions.lights = lights;
  record.conditions.pixels = static_cast<long long>(arguments.side) * arguments.side;
  record.conditions.repeats = arguments.repeats;
  record.conditions.command = arguments.command;
  record.conditions.more = {{"seconds_are", std::string("CPU seconds, all threads")}};
  return record;
}

void print(const Record& record) {
  const double mp = static_cast<double>(record.conditions.pixels) / 1e6;
  fmt::print("{:48} {:5} lights  {:8.3f} CPU s/MP ({:.3f}..{:.3f})  {} {:.3g}\n", record.mode,
             record.conditions.lights, record.seconds / mp, record.seconds_least / mp,
             record.seconds_most / mp, record.error_norm, record.error);
}

void time_stereo(const Arguments& arguments, const relight::StereoLights& lights, int side,
                 std::vector<Record>& records) {
  Arguments own = arguments;
  own.side = side;
  const relight::PixelPoints pixels = relight::PixelPoints::orthographic(side, side, kWidthMm);
  const SheetStack made(side, lights, pixels);
  const MemoryStack stack = read_all(made, std::size_t{8} << 30U);
  Image<float> points = relight::plane_points(pixels, side, side);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      points(y, x, 2) += static_cast<float>(height_at(pixels.at(x + 0.5, y + 0.5)));
    }
  }
  for (const relight::LambertMethod method :
       {relight::LambertMethod::least_squares, relight::LambertMethod::trimmed,
        relight::LambertMethod::m_estimator}) {
    for (const bool is_masked : {false, true}) {
      if (is_masked && method != relight::LambertMethod::trimmed) {
        continue;
      }
      Image<std::uint8_t> mask(side, side, 1);
      for (int y = 0; y < side; ++y) {
        for (int x = 0; x < side / 10; ++x) {
          mask(y, x) = 1;
        }
      }
      Record record =
          record_of(own,
                    fmt::format("{} {}{}", lights.are_near ? "near" : "far", to_string(method),
                                is_masked ? ", nine tenths masked" : ""),
                    stack.dims().n_lights);
      relight::StereoOptions options;
      options.fit.method = method;
      relight::SurfaceEstimate found;
      const std::vector<double> seconds = repeat(arguments.repeats, [&] {
        found =
            relight::photometric_stereo(stack, lights, points.view(),
                                        is_masked ? ImageView<const std::uint8_t>(mask.view())
                                                  : ImageView<const std::uint8_t>(),
                                        options);
      });
      record.error_norm = "mean angle, degrees";
      record.error = mean_degrees(found, pixels);
      set_times(seconds, record);
      print(record);
      records.push_back(record);
    }
  }
}

void time_integration(const Arguments& arguments, std::vector<Record>& records) {
  const int side = arguments.side;
  const relight::PixelPoints pixels = relight::PixelPoints::orthographic(side, side, kWidthMm);
  Image<float> normals(side, side, 3);
  Image<std::uint8_t> known(side, side, 1);
  Image<std::uint8_t> disc(side, side, 1);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const Vector3d n = normal_at(pixels.at(x + 0.5, y + 0.5));
      for (int c = 0; c < 3; ++c) {
        normals(y, x, c) = static_cast<float>(n[c]);
      }
      known(y, x) = 1;
      disc(y, x) = std::hypot(x - 0.5 * side, y - 0.5 * side) < 0.49 * side ? 1 : 0;
    }
  }
  const auto run = [&](const std::string& name, relight::Integrator method,
                       const Image<std::uint8_t>& mask) {
    Record record = record_of(arguments, name, 0);
    relight::IntegrateOptions options;
    options.method = method;
    relight::HeightMap map;
    const std::vector<double> seconds = repeat(arguments.repeats, [&] {
      map = relight::integrate_slopes(
          relight::orthographic_slopes(normals.view(), mask.view(), pixels.mm_per_pixel()),
          options);
    });
    double offset = 0.0;
    double n = 0.0;
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        if (mask(y, x) != 0) {
          offset += height_at(pixels.at(x + 0.5, y + 0.5)) - double{map.height(y, x)};
          n += 1.0;
        }
      }
    }
    offset /= n;
    double sum = 0.0;
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        if (mask(y, x) != 0) {
          sum += std::pow(
              height_at(pixels.at(x + 0.5, y + 0.5)) - double{map.height(y, x)} - offset, 2);
        }
      }
    }
    record.error_norm = "rms height, mm";
    record.error = std::sqrt(sum / n);
    record.conditions.more.emplace_back("solver_iterations", std::int64_t{map.iterations});
    record.conditions.more.emplace_back("solves", std::int64_t{map.n_solves});
    set_times(seconds, record);
    print(record);
    records.push_back(record);
  };
  run("frankot-chellappa", relight::Integrator::frankot_chellappa, known);
  run("poisson, cosines", relight::Integrator::poisson, known);
  run("poisson, disc mask, multigrid", relight::Integrator::poisson, disc);
  run("robust, disc mask", relight::Integrator::robust, disc);
}

}  // namespace
}  // namespace haarlight::bench

int main(int argc, char** argv) {
  using namespace haarlight;         // NOLINT(google-build-using-namespace)
  using namespace haarlight::bench;  // NOLINT(google-build-using-namespace)
  Arguments arguments;
  for (int i = 0; i < argc; ++i) {
    arguments.command += (i > 0 ? " " : "") + std::string(argv[i]);
  }
  apps::CommandLine line("relight_shape", "seconds and errors of shape", std::string(kVersion));
  line.root().option("--side", &arguments.side, "Pixels per side",
                     {.bounds = apps::Bounds{64, 8192}});
  line.root().option("--repeats", &arguments.repeats, "Times",
                     {.bounds = apps::Bounds{1, 100}});
  line.root().option("--threads", &arguments.threads, "Threads",
                     {.bounds = apps::Bounds{1, 64}});
  line.root().option("--json", &arguments.json, "Write the records here", {.type = "FILE"});
  if (const auto end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  const ThreadLimit limit(arguments.threads);
  std::vector<Record> records;
  time_stereo(arguments, dome(50), arguments.side, records);
  time_stereo(arguments, array(7), arguments.side, records);
  time_stereo(arguments, array(32), std::max(64, arguments.side / 5), records);
  time_integration(arguments, records);
  if (!arguments.json.empty()) {
    write_file_atomically(arguments.json, tradeoff_json(records));
  }
  return 0;
}
