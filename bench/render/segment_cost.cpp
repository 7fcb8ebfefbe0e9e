// SPDX-License-Identifier: Apache-2.0
/// @file
/// Nanoseconds per segment of a volume: quartiles over runs, CPU time of one thread; the table of
/// docs/numerics/volume.md. Optical depths are drawn beforehand.
///
///     segment_cost [RUNS]
///     segment_cost modes [RUNS]    each rule one segment at a time, and its largest error over the
///                                  segment's opacity: a line of JSON for each (volume_report.py)

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "core/cpu_time.h"
#include "core/random.h"
#include "render/volume/segment.h"
#include "render/volume/segment_rule.h"

namespace haarlight::render {
namespace {

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

/// Quartiles of the nanoseconds that each of n segments takes.
template <class Function>
std::array<double, 3> quartiles(int runs, std::size_t n, double& sum,
                                const Function& function) {
  std::vector<double> times;
  sum = function();
  constexpr int kPasses = 20;
  for (int run = 0; run < runs; ++run) {
    const double begin = thread_cpu_seconds();
    for (int pass = 0; pass < kPasses; ++pass) {
      sum += function();
    }
    times.push_back(1e9 * (thread_cpu_seconds() - begin) / (kPasses * static_cast<double>(n)));
  }
  std::ranges::sort(times);
  return {times[times.size() / 4], times[times.size() / 2], times[times.size() * 3 / 4]};
}

template <class Function>
void report(const char* what, int runs, std::size_t n, const Function& function) {
  double sum = 0.0;
  const std::array<double, 3> ns = quartiles(runs, n, sum, function);
  fmt::print("{:<46} {:>8.1f} {:>8.1f} {:>8.1f}   (sum {:.6g})\n", what, ns[0], ns[1], ns[2],
             sum);
}

struct Mix {
  const char* name;
  double low;  ///< decades
  double high;
};
constexpr Mix kMixes[] = {{"24 decades", -12.0, 12.0},
                          {"0.001..0.5", -3.0, -0.301},
                          {"0.7..2", -0.155, 0.301},
                          {"2..100", 0.301, 2.0}};

/// @param weights_of  (a, b): SegmentWeights @param n_terms  that all took
template <class Function>
void report_rule(const std::string& rule, const Mix& mix, const Depths& depths, int runs,
                 std::int64_t n_terms, const Function& weights_of) {
  double worst = 0.0;
  for (std::size_t i = 0; i < kSegments; ++i) {
    const SegmentWeights ours = weights_of(depths.near[i], depths.far[i]);
    const SegmentWeights exact = weights_of_depths(depths.near[i], depths.far[i]);
    const double near = ours.of_chromaticity.near - exact.of_chromaticity.near;
    const double far = ours.of_chromaticity.far - exact.of_chromaticity.far;
    worst = std::max(
        worst, std::max({std::abs(near), std::abs(far), std::abs(near + far)}) / exact.opacity);
  }
  double sum = 0.0;
  const std::array<double, 3> ns = quartiles(runs, kSegments, sum, [&] {
    double of_all = 0.0;
    for (std::size_t i = 0; i < kSegments; ++i) {
      of_all += sum_of(weights_of(depths.near[i], depths.far[i]));
    }
    return of_all;
  });
  fmt::print(
      R"({{"rule": "{}", "depths": "{}", "ns": {:.1f}, "terms": {:.2f}, "worst": {:.3g}}})"
      "\n",
      rule, mix.name, ns[1], static_cast<double>(n_terms) / static_cast<double>(kSegments),
      worst);
}

void run_modes(int runs) {
  std::vector<std::pair<std::string, VolumeRule>> rules;
  for (const auto& [n, depth] : {std::pair{2, 0.1}, {3, 0.5}, {5, 0.5}, {10, 0.5}, {10, 2.0}}) {
    rules.emplace_back(
        fmt::format("gauss {} {:g}", n, depth),
        VolumeRule{.mode = VolumeMode::gauss, .points = n, .piece_depth = depth});
  }
  for (const double tolerance : {1e-3, 1e-6, 1e-9, 1e-15}) {
    rules.emplace_back(fmt::format("series {:g}", tolerance),
                       VolumeRule{.mode = VolumeMode::series, .tolerance = tolerance});
  }
  rules.emplace_back("paper", VolumeRule{.mode = VolumeMode::paper});
  rules.emplace_back("approximate", VolumeRule{.mode = VolumeMode::approximate});
  for (const Mix& mix : kMixes) {
    const Depths depths = draw(mix.low, mix.high);
    report_rule("exact", mix, depths, runs, kSegments,
                [](double a, double b) { return weights_of_depths(a, b); });
    for (const auto& [name, options] : rules) {
      const SegmentRule rule(options);
      std::int64_t n_terms = 0;
      for (std::size_t i = 0; i < kSegments; ++i) {
        n_terms += rule.of_depths(depths.near[i], depths.far[i]).n_terms;
      }
      report_rule(name, mix, depths, runs, n_terms,
                  [&](double a, double b) { return rule.of_depths(a, b).weights; });
    }
  }
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
    const std::vector<std::string> words(argv + 1, argv + argc);
    constexpr int kRuns = 21;
    if (!words.empty() && words[0] == "modes") {
      haarlight::render::run_modes(words.size() > 1 ? std::stoi(words[1]) : kRuns);
    } else {
      haarlight::render::run(words.empty() ? kRuns : std::stoi(words[0]));
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "segment_cost: {}\n", error.what());
    return 1;
  }
  return 0;
}
