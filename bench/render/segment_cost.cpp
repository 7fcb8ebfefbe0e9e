// SPDX-License-Identifier: Apache-2.0
/// @file
/// Nanoseconds per segment of a volume: quartiles over runs, CPU time of one thread; the table of
/// docs/numerics/volume.md. Optical depths are drawn beforehand.
///
///     segment_cost [RUNS]

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <exception>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "core/random.h"
#include "render/volume/segment.h"

namespace haarlight::render {
namespace {

double cpu_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

constexpr std::size_t kSegments = 4096;

struct Depths {
  std::vector<double> near;
  std::vector<double> far;
};

/// Log-uniform between 10^low and 10^high.
Depths draw(double low, double high) {
  Depths depths;
  for (std::uint64_t i = 0; i < kSegments; ++i) {
    depths.near.push_back(std::pow(10.0, low + (high - low) * uniform_unit(hash_key(1, i))));
    depths.far.push_back(std::pow(10.0, low + (high - low) * uniform_unit(hash_key(2, i))));
  }
  return depths;
}

double sum_of(const SegmentWeights& w) {
  return w.of_chromaticity.near + w.of_chromaticity.far + w.of_glow.near + w.of_glow.far +
         w.transparency;
}

template <class Function>
void report(const char* what, int runs, std::size_t n, const Function& function) {
  std::vector<double> times;
  double sum = function();
  constexpr int kPasses = 20;
  for (int run = 0; run < runs; ++run) {
    const double begin = cpu_seconds();
    for (int pass = 0; pass < kPasses; ++pass) {
      sum += function();
    }
    times.push_back(1e9 * (cpu_seconds() - begin) / (kPasses * static_cast<double>(n)));
  }
  std::ranges::sort(times);
  fmt::print("{:<46} {:>8.1f} {:>8.1f} {:>8.1f}   (sum {:.6g})\n", what,
             times[times.size() / 4], times[times.size() / 2], times[times.size() * 3 / 4],
             sum);
}

void run(int runs) {
  fmt::print("{:<46} {:>8} {:>8} {:>8}\n", "ns per segment", "25 %", "median", "75 %");
  const struct {
    const char* name;
    double low;
    double high;
  } mixes[] = {{"24 decades", -12.0, 12.0},
               {"small, 0.001..0.5", -3.0, std::log10(0.5)},
               {"0.7..2", std::log10(0.7), std::log10(2.0)},
               {"2..100", std::log10(2.0), 2.0}};
  for (const auto& mix : mixes) {
    const Depths depths = draw(mix.low, mix.high);
    report(fmt::format("linear, {}", mix.name).c_str(), runs, kSegments, [&] {
      double sum = 0.0;
      for (std::size_t i = 0; i < kSegments; ++i) {
        sum += sum_of(weights_of_depths(depths.near[i], depths.far[i]));
      }
      return sum;
    });
    std::vector<double> results(5 * kSegments);
    const auto part = [&](std::size_t i) {
      return std::span(results).subspan(i * kSegments, kSegments);
    };
    report("the same, many at once", runs, kSegments, [&] {
      find_weights(depths.near, depths.far, {part(0), part(1), part(2), part(3), part(4)});
      return results.front();
    });
  }
  for (const double size : {0.1, 3.0, 100.0}) {
    std::vector<Parabola> rhos;
    for (std::uint64_t i = 0; i < kSegments; ++i) {
      rhos.push_back({.near = size * uniform_unit(hash_key(3, i)),
                      .middle = size * uniform_unit(hash_key(4, i)),
                      .far = size * uniform_unit(hash_key(5, i))});
    }
    report(fmt::format("quadratic, depths 0..{}", size).c_str(), runs, kSegments, [&] {
      double sum = 0.0;
      for (const Parabola& rho : rhos) {
        sum += quadratic_weights(rho, 1.0).of_glow.near;
      }
      return sum;
    });
  }
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  try {
    haarlight::render::run(argc == 2 ? std::stoi(argv[1]) : 21);
  } catch (const std::exception& error) {
    fmt::print(stderr, "segment_cost: {}\n", error.what());
    return 1;
  }
  return 0;
}
