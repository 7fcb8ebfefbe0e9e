// SPDX-License-Identifier: Apache-2.0
#include "tests/relight/basis/basis_extremes.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/count.h"
#include "core/random.h"
#include "haarlight/relight/basis/compress.h"
#include "relight/basis/coder/quantiser.h"
#include "relight/basis/plate/plate.h"
#include "tests/extremes.h"

namespace haarlight::relight {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using extremes::stated;
using test::ClippedStack;
using test::compressed;
using test::made_source;
using test::MadeScene;
using test::make_stack;
using test::scaled;
using test::small_stack;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// ||decoded - stack|| / ||stack||, or 0 where both are black.
double decoded_error(const BasisFile& basis, const MemoryStack& stack) {
  const MemoryStack decoded = read_all(BasisSource(basis));
  double energy = 0.0;
  double error = 0.0;
  for (std::size_t i = 0; i < stack.values().size(); ++i) {
    const double t = stack.values()[i];
    const double rest = double{decoded.values()[i]} - t;
    energy += t * t;
    error += rest * rest;
  }
  return error == 0.0 ? 0.0 : std::sqrt(error / energy);
}

// ---- compressing ----

EXTREMES_OF(quantiser, "relight/basis: compressing", "dead-zone quantiser")

constexpr double kStep = 0.01;
double quantised(double c) { return kStep * quantise(c, 1.0 / kStep); }

EXTREME(quantiser, dark) {
  EXPECT_EQ(quantise(0.0, 1.0 / kStep), 0);
  EXPECT_EQ(quantise(-0.0, 1.0 / kStep), 0);
  return exact("0 of 0");
}
NO_EXTREME(quantiser, one, "value by value")
EXTREME(quantiser, largest) {
  EXPECT_EQ(quantise(1e300, 1.0), std::int32_t{1} << 30);
  EXPECT_EQ(quantise(-1e300, 1.0), -(std::int32_t{1} << 30));
  return stated("2^30 steps and more: ± 2^30; the error is measured on what was coded");
}
NO_EXTREME(quantiser, odd_size, "value by value")
EXTREME(quantiser, scale) {
  double worst = 0.0;
  for (int i = 0; i < 10000; ++i) {
    const double c = 2000.0 * (uniform_unit(hash_key(2, count(i))) - 0.5) * kStep;
    worst = std::max(worst, std::abs(quantised(c) - c) / kStep);
  }
  for (const double scale : {1e-30, 1e30}) {
    EXPECT_EQ(quantise(12.3 * kStep * scale, 1.0 / (kStep * scale)), 12);
  }
  return bounded(worst, kDeadZone, "error / step", "the dead zone, at any scale of the step");
}
EXTREME(quantiser, subnormal) {
  EXPECT_EQ(quantise(std::numeric_limits<double>::denorm_min(), 1.0 / kStep), 0);
  EXPECT_EQ(quantise(std::numeric_limits<float>::denorm_min(), 100.0F), 0);
  return exact("below the dead zone: 0");
}
EXTREME(quantiser, not_finite) {
  EXPECT_EQ(quantise(std::numeric_limits<double>::infinity(), 1.0), std::int32_t{1} << 30);
  EXPECT_EQ(quantise(std::numeric_limits<double>::quiet_NaN(), 1.0), std::int32_t{1} << 30);
  return stated("2^30 steps; the tile coder refuses such values first");
}
NO_GEOMETRY(quantiser)
NO_EXTREME(quantiser, duplicate, "value by value")
NO_EXTREME(quantiser, clipped, "value by value")

EXTREMES_OF(compress, "relight/basis: compressing",
            "`compress` to an error of 0, 1e-12, 1 % and 1")

constexpr double kTargets[] = {0.0, 1e-12, 0.01, 1.0};
/// A reader's floats: as Compress.ReachesTheErrorAskedAndSaysWhatItReached.
constexpr double kDecoding = 2e-7;

/// The largest excess of an error over its target, the readers' floats taken off.
double worst_excess(const MemoryStack& stack, const HaarGrid& grid,
                    const StackSource* plate = nullptr) {
  double worst = -1.0;
  for (const double target : kTargets) {
    CompressSummary summary;
    const BasisFile basis =
        compressed(made_source(stack, grid, plate), {.relative_l2 = target}, &summary);
    EXPECT_TRUE(summary.is_achieved()) << target;
    EXPECT_EQ(summary.header.stack_norm > 0.0, summary.header.peak > 0.0);
    const double found = decoded_error(basis, stack);
    EXPECT_LE(std::abs(found - summary.header.achieved.relative_l2), kDecoding) << target;
    worst = std::max(worst, target < 1e-6 ? found : found - target);
  }
  return worst;
}
constexpr const char* kExcess = "error beyond the target";
constexpr const char* kExcessWhy =
    "the readers' floats, 2^-24 of a value; nothing at 0 and 1e-12";

EXTREME(compress, dark) {
  const MemoryStack stack({64, 40, 1, 64});
  for (const double target : kTargets) {
    CompressSummary summary;
    const BasisFile basis =
        compressed(made_source(stack, 8), {.relative_l2 = target}, &summary);
    EXPECT_EQ(summary.header.achieved.relative_l2, 0.0);
    EXPECT_LT(summary.bytes, 64U << 10U);
    EXPECT_THAT(read_all(BasisSource(basis)).values(), ::testing::Each(0.0F));
  }
  return exact("a black stack comes back black, error 0");
}
EXTREME(compress, one) {
  MemoryStack stack({1, 1, 1, 1});
  stack.at(0, 0, 0, 0) = 0.3F;
  return bounded(worst_excess(stack, {1, 1}), kDecoding, kExcess, kExcessWhy);
}
EXTREME(compress, largest) {
  const MadeScene scene{.width = 5, .height = 4, .grid = 1, .noise = 0.02, .rows = 1024};
  const MemoryStack& stack = make_stack(scene);
  const BasisFile basis = compressed(made_source(stack, {1024, 1}), {});
  return both(bounded(decoded_error(basis, stack) - 0.01, kDecoding,
                      "1024 × 1 lights: error beyond 1 %", "the readers' floats"),
              refused("at most 1024 of each", [] {
                const MemoryStack wide({1, 1, 1, 1025});
                (void)compressed(made_source(wide, HaarGrid{1025, 1}), {});
              }));
}
EXTREME(compress, odd_size) {
  double worst = -1.0;
  for (const HaarGrid grid : {HaarGrid{1, 9}, {9, 1}, {2, 3}, {3, 3}, {7, 30}}) {
    const MemoryStack& stack = make_stack(
        {.width = 33, .height = 3, .grid = grid.cols, .noise = 0.02, .rows = grid.rows});
    worst = std::max(worst, worst_excess(stack, grid));
  }
  return bounded(worst, kDecoding, kExcess, kExcessWhy);
}
EXTREME(compress, scale) {
  double worst = -1.0;
  for (const double scale : {1e-30, 1e-20, 1e20, 1e30}) {
    worst = std::max(worst, worst_excess(scaled(small_stack(), scale), {8, 8}));
  }
  return bounded(worst, kDecoding, kExcess, kExcessWhy);
}
EXTREME(compress, subnormal) {
  const MemoryStack stack = scaled(small_stack(), 1e-40);
  double worst = -1.0;
  for (const double target : kTargets) {
    const BasisFile basis = compressed(made_source(stack, 8), {.relative_l2 = target});
    worst = std::max(worst, decoded_error(basis, stack) - target);
  }
  // Readers' floats have units of 2^-149: 1e-5 of values of 1e-40.
  return bounded(worst, 2e-5, kExcess, "half the smallest float, 7e-46, of values of 1e-40");
}
EXTREME(compress, not_finite) {
  for (const double target : kTargets) {
    for (const float bad : {kNan, kInfinity, -kInfinity}) {
      MemoryStack stack = small_stack();
      stack.at(0, 8, 32, 20) = bad;
      (void)refused("under light 20 at pixel (32, 8)",
                    [&] { (void)compressed(made_source(stack, 8), {.relative_l2 = target}); });
    }
  }
  return refused("under light 20 at pixel (32, 8)", [] {
    MemoryStack stack = small_stack();
    stack.at(0, 8, 32, 20) = kNan;
    (void)compressed(made_source(stack, 8), {});
  });
}
NO_GEOMETRY(compress)
EXTREME(compress, duplicate) {
  MemoryStack stack = small_stack();
  for (int i = 0; i < 33 * 9; ++i) {
    for (int k = 1; k < 64; ++k) {
      stack.at(0, i / 33, i % 33, k) = stack.at(0, i / 33, i % 33, 0);
    }
  }
  CompressSummary summary;
  (void)compressed(made_source(stack, 8), {}, &summary);
  EXPECT_LE(summary.header.mean_coefficients, 1.0);
  return both(bounded(worst_excess(stack, {8, 8}), kDecoding, kExcess, kExcessWhy),
              exact("of equal lights one coefficient per pixel"));
}
EXTREME(compress, clipped) {
  const ClippedStack stack(small_stack(), 20);
  for (const double target : kTargets) {
    CompressSource source = made_source(small_stack(), 8);
    source.stack = &stack;
    CompressSummary summary;
    (void)compressed(source, {.relative_l2 = target}, &summary);
    EXPECT_EQ(summary.header.clipped.value().n_values, 33.0 * 9.0);
    EXPECT_GT(summary.header.clipped->least_norm, 0.0);
  }
  return stated(
      "clipped values are counted, with their norm; the error is against what was stored");
}

// ---- the clean plate's gain ----

EXTREMES_OF(gain, "relight/basis: compressing", "clean plate: gain and vectors")

const MemoryStack& small_plate() {
  return make_stack({.width = 33, .height = 9, .grid = 8, .has_sphere = false});
}

EXTREME(gain, dark) {
  EXPECT_EQ(plate_gain(std::vector<float>{1.0F, 2.0F}, std::vector<float>{0.0F, 0.0F}), 0.0F);
  EXPECT_EQ(plate_gain(std::vector<float>{0.0F, 0.0F}, std::vector<float>{1.0F, 2.0F}), 0.0F);
  const MemoryStack black(small_stack().dims());
  EXPECT_EQ(fit_plate_vectors(black, 1e-3).rank, 0);
  return both(bounded(worst_excess(small_stack(), {8, 8}, &black), kDecoding,
                      "a black clean plate is not used: " + std::string(kExcess), kExcessWhy),
              exact("gain 0"));
}
EXTREME(gain, one) {
  EXPECT_EQ(plate_gain(std::vector<float>{3.0F}, std::vector<float>{2.0F}), 1.5F);
  return exact("one light: the ratio");
}
NO_EXTREME(gain, largest, "as compressing")
NO_EXTREME(gain, odd_size, "as compressing")
EXTREME(gain, scale) {
  double worst = -1.0;
  for (const double scale : {1e-20, 1e20}) {
    const MemoryStack plate = scaled(small_plate(), scale);
    worst = std::max(worst, worst_excess(small_stack(), {8, 8}, &plate));
    worst = std::max(worst, worst_excess(scaled(small_stack(), scale), {8, 8}, &plate));
  }
  return bounded(worst, kDecoding, kExcess, kExcessWhy);
}
EXTREME(gain, subnormal) {
  const MemoryStack plate = scaled(small_plate(), 1e-41);
  return bounded(worst_excess(small_stack(), {8, 8}, &plate), kDecoding, kExcess, kExcessWhy);
}
NO_EXTREME(gain, not_finite,
           "a computed clean plate is finite, a captured one is a stack, which is")
EXTREME(gain, degenerate) {
  MemoryStack plate = small_plate();
  for (int k = 0; k < 64; ++k) {
    plate.at(0, 4, 4, k) = 0.0F;  // a pixel that does not see the plane
    plate.at(0, 5, k % 33, k) = 0.0F;
  }
  return bounded(worst_excess(small_stack(), {8, 8}, &plate), kDecoding,
                 "pixels that do not see the plane, zeros in others: " + std::string(kExcess),
                 kExcessWhy);
}
NO_EXTREME(gain, grazing, "the closed form's: render/analytic")
NO_EXTREME(gain, far_near, "the closed form's: render/analytic")
EXTREME(gain, duplicate) {
  const PlateVectors vectors =
      fit_plate_vectors(MemoryStack({2, 2, 1, 2}, std::vector<float>(8, 0.5F)), 1e-6);
  EXPECT_EQ(vectors.rank, 1);
  return bounded(vectors.missed, 1e-6, "equal lights: one vector, missed", "as requested");
}
NO_EXTREME(gain, clipped, "compressing counts the clipped")

}  // namespace
}  // namespace haarlight::relight
