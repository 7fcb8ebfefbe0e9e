// SPDX-License-Identifier: Apache-2.0
#include "session/develop/demultiplex.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

constexpr double kFullLevel = 65535.0;

[[noreturn]] void refuse(const Session& session, const std::string& what,
                         const std::string& hint) {
  throw Error(what, (session.folder() / "session.json").string(), hint);
}

std::vector<LightDriveLevel> drive_levels_of(const std::vector<LightLevel>& pattern) {
  std::vector<LightDriveLevel> drive_levels;
  drive_levels.reserve(pattern.size());
  for (const LightLevel& level : pattern) {
    drive_levels.push_back({level.light, level.level / kFullLevel});
  }
  return drive_levels;
}

/// Patterns without parameters: as they are.
MatchedShots match_any(const Session& session, PatternParameters parameters,
                       const std::vector<std::vector<LightLevel>>& patterns) {
  std::vector<std::vector<LightDriveLevel>> shots;
  std::vector<std::size_t> order;
  for (const auto& pattern : patterns) {
    order.push_back(shots.size());
    shots.push_back(drive_levels_of(pattern));
  }
  const auto n_lights = static_cast<int>(session.info().lights.size());
  try {
    return {std::move(order),
            PatternInverse(std::move(parameters), std::move(shots), n_lights)};
  } catch (const Error& error) {
    refuse(session, error.problem(), error.hint());
  }
}

}  // namespace

MatchedShots match_shots(const Session& session,
                         const std::vector<std::vector<LightLevel>>& patterns) {
  const PatternParameters& parameters = session.info().patterns;
  const auto n_lights = static_cast<int>(session.info().lights.size());
  constexpr std::size_t kMaxTargets = 8;
  if (parameters.family == PatternFamily::target && patterns.size() > kMaxTargets) {
    refuse(session, fmt::format("{} target shots", patterns.size()),
           "a lighting has one shot per colour: capture the plan again");
  }
  if (parameters.family == PatternFamily::list || parameters.family == PatternFamily::target) {
    return match_any(session, parameters, patterns);
  }
  if (!fits(parameters) || parameters.n_lights() != n_lights) {
    refuse(session,
           fmt::format("\"patterns\" describes {} of {} lights, the session has {}",
                       to_string(parameters.family), parameters.n_lights(), n_lights),
           "the file was changed after the capture: rebuild it (haarlight rebuild)");
  }
  // Shots by the lights they light; a set of lights may occur twice in the parameters.
  std::map<std::vector<int>, std::size_t> by_lights;
  const std::uint16_t level = patterns.front().front().level;
  for (std::size_t i = 0; i < patterns.size(); ++i) {
    std::vector<int> lights;
    for (const LightLevel& lit : patterns[i]) {
      lights.push_back(lit.light);
      if (lit.level != level) {
        refuse(session,
               fmt::format("levels {} and {} in one set of {} patterns", level, lit.level,
                           to_string(parameters.family)),
               "shoot all its patterns at one level");
      }
    }
    by_lights[std::move(lights)] = i;
  }
  const std::vector<std::vector<int>> expected = lit_lights(parameters);
  std::vector<std::size_t> order;
  std::vector<std::vector<LightDriveLevel>> shots;
  std::vector<bool> is_used(patterns.size(), false);
  for (std::size_t j = 0; j < expected.size(); ++j) {
    const auto it = by_lights.find(expected[j]);
    if (it == by_lights.end()) {
      refuse(
          session,
          fmt::format("pattern {} of {} of the {} set has no committed frame ({} lights, the "
                      "first is {})",
                      j + 1, expected.size(), to_string(parameters.family), expected[j].size(),
                      expected[j].front()),
          "take its shot (haarlight capture)");
    }
    order.push_back(it->second);
    is_used[it->second] = true;
    shots.push_back(drive_levels_of(patterns[it->second]));
  }
  const auto n_unused = std::count(is_used.begin(), is_used.end(), false);
  if (n_unused > 0) {
    refuse(session,
           fmt::format("{} patterns are not of the {} set", n_unused,
                       to_string(parameters.family)),
           "capture other patterns as a session of their own");
  }
  return {std::move(order), PatternInverse(parameters, std::move(shots), n_lights)};
}

namespace {

/// Runs of pixels of all shots through `solve(measured, plate, n, single)`, (shots, n) to
/// (lights, n).
template <class Solve>
void demultiplex(const PatternInverse& inverse, const std::vector<double>& power,
                 const PlatePixels& plate, int y0, std::vector<Image<float>>& pictures,
                 const Solve& solve) {
  const auto n_shots = static_cast<std::size_t>(inverse.n_shots());
  const auto n_lights = static_cast<std::size_t>(inverse.n_lights());
  HAARLIGHT_EXPECTS(pictures.size() == n_shots && power.size() == n_lights,
                    "one picture per shot, one power per light");
  const int height = pictures[0].height();
  const int width = pictures[0].width();
  const auto channels = static_cast<std::size_t>(pictures[0].channels());
  std::vector<Image<float>> lights;
  lights.reserve(n_lights);
  for (std::size_t k = 0; k < n_lights; ++k) {
    lights.emplace_back(height, width, static_cast<int>(channels));
  }
  // 16 pixels: 1024 shots of them are 128 KB, which fits into a core's cache.
  constexpr int kRun = 16;
  const auto runs_a_row = static_cast<std::size_t>((width + kRun - 1) / kRun);
  const bool has_plate = inverse.needs_plate() && !plate.is_empty();
  parallel_for(runs_a_row * static_cast<std::size_t>(height), 4,
               [&](std::size_t begin, std::size_t end) {
                 std::vector<double> measured;
                 std::vector<double> shared;
                 std::vector<double> single;
                 std::vector<float> plate_run;
                 for (std::size_t run = begin; run < end; ++run) {
                   const auto y = static_cast<int>(run / runs_a_row);
                   const int x0 = static_cast<int>(run % runs_a_row) * kRun;
                   const int x1 = std::min(width, x0 + kRun);
                   const auto n_pixels = static_cast<std::size_t>(x1 - x0);
                   const std::size_t n = n_pixels * channels;
                   const std::size_t first =
                       (static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                        static_cast<std::size_t>(x0)) *
                       channels;
                   measured.resize(n_shots * n);
                   single.resize(n_lights * n);
                   for (std::size_t j = 0; j < n_shots; ++j) {
                     const float* in = pictures[j].pixels().data() + first;
                     std::copy_n(in, n, measured.data() + j * n);
                   }
                   if (has_plate) {
                     plate_run.resize(n_pixels * n_lights);
                     plate.read(y0 + y, x0, x1, plate_run);
                     shared.resize(n_lights * n);
                     for (std::size_t i = 0; i < n; ++i) {
                       const float* row = plate_run.data() + i / channels * n_lights;
                       for (std::size_t k = 0; k < n_lights; ++k) {
                         shared[k * n + i] = double{row[k]} * power[k];
                       }
                     }
                   }
                   solve(measured, shared, n, single);
                   for (std::size_t k = 0; k < n_lights; ++k) {
                     float* out = lights[k].pixels().data() + first;
                     std::transform(single.begin() + static_cast<std::ptrdiff_t>(k * n),
                                    single.begin() + static_cast<std::ptrdiff_t>((k + 1) * n),
                                    out,
                                    [](double value) { return static_cast<float>(value); });
                   }
                 }
               });
  pictures = std::move(lights);
}

/// values[k] /= power[k]^exponent, exponent 1 or 2.
void divide_by_power(const std::vector<double>& power, int exponent, std::size_t n,
                     std::vector<double>& values) {
  for (std::size_t k = 0; k < power.size(); ++k) {
    const double divisor = exponent == 1 ? power[k] : power[k] * power[k];
    for (std::size_t i = 0; i < n; ++i) {
      values[k * n + i] /= divisor;
    }
  }
}

}  // namespace

void demultiplex_rows(const PatternInverse& inverse, const std::vector<double>& power,
                      const PlatePixels& plate, int y0, std::vector<Image<float>>& pictures) {
  demultiplex(inverse, power, plate, y0, pictures,
              [&](const std::vector<double>& measured, const std::vector<double>& shared,
                  std::size_t n, std::vector<double>& single) {
                inverse.apply(measured, shared, n, single);
                divide_by_power(power, 1, n, single);
              });
}

void demultiplex_variance_rows(const PatternInverse& inverse, const std::vector<double>& power,
                               const PlatePixels& plate, int y0,
                               const std::vector<double>& common_sigma,
                               std::vector<Image<float>>& variances) {
  HAARLIGHT_EXPECTS(common_sigma.size() == static_cast<std::size_t>(inverse.n_shots()),
                    "one sigma per shot");
  // A picture in fractions of the range per second has variances below 1e6; squares of the
  // significant entries of the inverse are above 1e-12.
  constexpr double kMark = 1e30;
  constexpr double kMarked = 1e15;
  const bool has_common = std::any_of(common_sigma.begin(), common_sigma.end(),
                                      [](double sigma) { return sigma > 0.0; });
  demultiplex(inverse, power, plate, y0, variances,
              [&](std::vector<double>& measured, const std::vector<double>& shared,
                  std::size_t n, std::vector<double>& single) {
                for (double& v : measured) {
                  v = v < 0.0 ? kMark : v;
                }
                inverse.apply_variance(measured, shared, n, single);
                if (has_common) {
                  for (std::size_t j = 0; j < common_sigma.size(); ++j) {
                    std::fill_n(measured.begin() + static_cast<std::ptrdiff_t>(j * n), n,
                                common_sigma[j]);
                  }
                  std::vector<double> sum(single.size());
                  inverse.apply(measured, shared, n, sum);
                  for (std::size_t i = 0; i < single.size(); ++i) {
                    single[i] += sum[i] * sum[i];
                  }
                }
                divide_by_power(power, 2, n, single);
                for (double& v : single) {
                  v = v > kMarked ? -1.0 : v;
                }
              });
}

}  // namespace haarlight::session
