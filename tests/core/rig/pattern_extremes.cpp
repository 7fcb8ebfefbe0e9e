// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/count.h"
#include "core/random.h"
#include "core/rig/pattern_inverse.h"
#include "tests/extremes.h"

namespace haarlight {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using extremes::stated;

// Demultiplexing by the families that determine every light.

EXTREMES_OF(patterns, "core/rig",
            "demultiplexing: S-matrix (Hadamard) and Haar patterns, lists")

std::vector<double> random_values(std::size_t n, double scale = 1.0) {
  std::vector<double> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = scale * uniform_unit(hash_key(4, i));
  }
  return values;
}

PatternInverse inverse_of(PatternFamily family, const FaceGrid& face) {
  PatternParameters parameters{family, {face}, 0, {}};
  if (family == PatternFamily::haar) {
    parameters.wavelets.resize(count(face.n_lights()));
    std::iota(parameters.wavelets.begin(), parameters.wavelets.end(), 0);
  }
  std::vector<std::vector<LightDriveLevel>> shots;
  for (const std::vector<int>& lights : lit_lights(parameters)) {
    shots.emplace_back();
    for (const int light : lights) {
      shots.back().push_back({light, 0.5});
    }
  }
  return {parameters, std::move(shots), face.n_lights()};
}

/// One light after the other and all at once; any patterns that separate the lights.
PatternInverse list_of(int n, double drive = 0.5) {
  std::vector<std::vector<LightDriveLevel>> shots(count(n) + 1);
  for (int k = 0; k < n; ++k) {
    shots[count(k)].push_back({k, drive});
    shots[count(n)].push_back({k, drive});
  }
  return {{}, std::move(shots), n};
}

std::vector<double> there_and_back(const PatternInverse& inverse,
                                   const std::vector<double>& lights) {
  std::vector<double> measured(count(inverse.n_shots()));
  inverse.shoot(lights, 1, measured);
  std::vector<double> back(lights.size());
  inverse.apply(measured, {}, 1, back);
  return back;
}

/// Largest error over the largest light.
double worst(const PatternInverse& inverse, double scale = 1.0) {
  const std::vector<double> lights = random_values(count(inverse.n_lights()), scale);
  const std::vector<double> back = there_and_back(inverse, lights);
  double error = 0.0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const double off = std::abs(back[k] - lights[k]);
    error = std::isnan(off) ? off : std::max(error, off);
  }
  return error / *std::max_element(lights.begin(), lights.end());
}

std::vector<PatternInverse> families(int side) {
  std::vector<PatternInverse> all;
  all.push_back(inverse_of(PatternFamily::s_matrix, {side, side}));
  all.push_back(inverse_of(PatternFamily::haar, {side, side}));
  return all;
}

double worst_of(const std::vector<PatternInverse>& all, double scale = 1.0) {
  double error = 0.0;
  for (const PatternInverse& inverse : all) {
    error = std::max(error, worst(inverse, scale));
  }
  return error;
}
constexpr const char* kOf = "shot and undone: error / largest light";
constexpr const char* kWhy = "sums of all lights, 2^-53 each";

EXTREME(patterns, dark) {
  for (const PatternInverse& inverse : families(8)) {
    const std::vector<double> zeros(64, 0.0);
    EXPECT_EQ(there_and_back(inverse, zeros), zeros);
  }
  return exact("black shots: black lights");
}
EXTREME(patterns, one) {
  return bounded(std::max(worst(inverse_of(PatternFamily::s_matrix, {1, 1})),
                          worst(inverse_of(PatternFamily::haar, {1, 1}))),
                 1e-15, std::string("one light: ") + kOf, "2 roundings");
}
EXTREME(patterns, largest) {
  return bounded(worst_of(families(64)), 1e-11, std::string("4096 lights: ") + kOf,
                 "sums of 4096, 2^-53 each");
}
EXTREME(patterns, odd_size) {
  const double error =
      std::max({worst(inverse_of(PatternFamily::s_matrix, {3, 7})),
                worst(inverse_of(PatternFamily::s_matrix, {13, 1})), worst(list_of(13))});
  return both(bounded(error, 1e-12,
                      std::string("3 × 7, 13 × 1 lights, S-matrix and list: ") + kOf, kWhy),
              refused("a grid that the family", [] {
                (void)inverse_of(PatternFamily::haar, {3, 7});
              }));
}
EXTREME(patterns, scale) {
  return bounded(std::max({worst_of(families(8), 1e-30), worst_of(families(8), 1e30),
                           worst(list_of(9), 1e-30), worst(list_of(9), 1e30)}),
                 1e-13, std::string("signals of 1e±30: ") + kOf, kWhy);
}
EXTREME(patterns, subnormal) {
  return bounded(worst_of(families(8), 1e-310), 1e-11, std::string("signals of 1e-310: ") + kOf,
                 "1e-310 has 13 digits less than a normal number, 64 sums");
}
EXTREME(patterns, not_finite) {
  for (const PatternInverse& inverse : families(8)) {
    std::vector<double> measured(count(inverse.n_shots()), 1.0);
    measured[1] = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> lights(64);
    inverse.apply(measured, {}, 1, lights);
    EXPECT_TRUE(
        std::any_of(lights.begin(), lights.end(), [](double v) { return std::isnan(v); }));
  }
  return stated(
      "NaN in a shot becomes NaN in the lights that it shows; light stacks refuse it");
}
NO_EXTREME(patterns, degenerate, "it knows no geometry")
NO_EXTREME(patterns, grazing, "it knows no geometry")
NO_EXTREME(patterns, far_near, "it knows no geometry")
EXTREME(patterns, duplicate) {
  return refused("cannot tell 3 lights apart (rank 2)", [] {
    // Two lights that are always lit together.
    const std::vector<std::vector<LightDriveLevel>> shots = {
        {{0, 1.0}, {1, 1.0}}, {{0, 0.5}, {1, 0.5}}, {{2, 1.0}}};
    const PatternInverse inverse({}, shots, 3);
  });
}
NO_EXTREME(patterns, clipped, "developing marks the lights of a clipped shot: session/develop")

// The same with light that a clean plate distributes.

EXTREMES_OF(shared, "core/rig",
            "demultiplexing: bins and target, distributed by the clean plate")

PatternInverse binned(int side, int bin) {
  const PatternParameters parameters{PatternFamily::bins, {{side, side}}, bin, {}};
  std::vector<std::vector<LightDriveLevel>> shots;
  for (const std::vector<int>& lights : lit_lights(parameters)) {
    shots.emplace_back();
    for (const int light : lights) {
      shots.back().push_back({light, 1.0});
    }
  }
  return {parameters, std::move(shots), side * side};
}

std::vector<double> undone(const std::vector<double>& measured,
                           const std::vector<double>& plate) {
  std::vector<double> lights(16);
  binned(4, 2).apply(measured, plate, 1, lights);
  return lights;
}

/// |sum of the lights of a block - its shot| / shot, the largest.
double lost(const std::vector<double>& lights, const std::vector<double>& measured) {
  double worst_of_all = 0.0;
  std::vector<double> shot(4);
  binned(4, 2).shoot(lights, 1, shot);
  for (std::size_t j = 0; j < 4; ++j) {
    const double off = std::abs(shot[j] / measured[j] - 1.0);
    worst_of_all = std::isnan(off) ? off : std::max(worst_of_all, off);
  }
  return worst_of_all;
}
const std::vector<double>& four() {
  static const std::vector<double> kFour = {1.0, 2.0, 3.0, 4.0};
  return kFour;
}
constexpr const char* kLost = "light of a block lost / its shot";

EXTREME(shared, dark) {
  const std::vector<double> lights = undone(four(), std::vector<double>(16, 0.0));
  EXPECT_EQ(lights[0], 0.25);
  EXPECT_EQ(undone(std::vector<double>(4, 0.0), std::vector<double>(16, 1.0)),
            std::vector<double>(16, 0.0));
  return both(bounded(lost(lights, four()), 1e-15,
                      std::string("a clean plate of zeros distributes evenly: ") + kLost,
                      "4 roundings"),
              exact("a black shot: black lights"));
}
EXTREME(shared, one) {
  // Blocks of 2 x 2 of a 4 x 4 grid begin at lights 0, 2, 8 and 10.
  std::vector<double> plate(16, 0.0);
  plate[0] = plate[2] = plate[8] = plate[10] = 1.0;
  const std::vector<double> lights = undone(four(), plate);
  EXPECT_EQ(lights[0], 1.0);
  EXPECT_EQ(lights[1], 0.0);
  EXPECT_EQ(lights[10], 4.0);
  plate[10] = 0.0;
  EXPECT_EQ(undone(four(), plate),
            std::vector<double>({0.25, 0.25, 0.5, 0.5, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0,
                                 1.0, 0.75, 0.75, 1.0, 1.0}));
  return exact(
      "a clean plate of one light per block: it takes all; where a block is dark: evenly");
}
NO_EXTREME(shared, largest, "as for the other families")
EXTREME(shared, odd_size) {
  return refused("a grid that the family", [] { (void)binned(5, 2); });
}
EXTREME(shared, scale) {
  double worst_of_all = 0.0;
  for (const double scale : {1e-30, 1e30, 1e-160, 1e160}) {
    worst_of_all =
        std::max(worst_of_all, lost(undone(four(), random_values(16, scale)), four()));
  }
  return bounded(worst_of_all, 1e-14, std::string("clean plates of 1e±160: ") + kLost,
                 "8 roundings");
}
EXTREME(shared, subnormal) {
  return bounded(lost(undone(four(), random_values(16, 1e-40)), four()), 1e-14,
                 std::string("clean plates of 1e-40, subnormal floats: ") + kLost,
                 "8 roundings");
}
NO_EXTREME(shared, not_finite,
           "a computed clean plate is finite, a captured one is a stack, which is")
NO_EXTREME(shared, degenerate, "it knows no geometry")
NO_EXTREME(shared, grazing, "it knows no geometry")
NO_EXTREME(shared, far_near, "it knows no geometry")
EXTREME(shared, duplicate) {
  // A target of two equal shots: both say the same of the lights.
  const std::vector<std::vector<LightDriveLevel>> shots(2, {{0, 1.0}, {1, 0.5}, {2, 0.25}});
  const PatternInverse inverse({PatternFamily::target, {}, 0, {}}, shots, 3);
  std::vector<double> lights(3);
  const std::vector<double> measured = {1.0, 1.0};
  inverse.apply(measured, std::vector<double>(3, 1.0), 1, lights);
  std::vector<double> shot(2);
  inverse.shoot(lights, 1, shot);
  return bounded(std::abs(shot[0] - 1.0), 1e-6,
                 "target, the same shot twice: error of the shot from its lights",
                 "the least-squares solution of a singular system");
}
NO_EXTREME(shared, clipped, "developing marks the lights of a clipped shot: session/develop")

}  // namespace
}  // namespace haarlight
