// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/count.h"
#include "core/random.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/dense_half.h"
#include "relight/basis/prepared_basis.h"
#include "tests/extremes.h"
#include "tests/relight/basis/basis_extremes.h"

namespace haarlight::relight {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::Cell;
using extremes::exact;
using extremes::refused;
using extremes::stated;
using test::ClippedStack;
using test::compressed;
using test::made_source;
using test::make_stack;
using test::scaled;
using test::small_stack;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

LightWeights random_weights(int n, double scale = 1.0) {
  LightWeights w(n, 1);
  for (int k = 0; k < n; ++k) {
    w(k, 0) = scale * std::pow(uniform_unit(hash_key(3, count(k))), 4.0);
  }
  return w;
}

LightWeights one_light(int k, int n) {
  LightWeights w = LightWeights::Zero(n, 1);
  w(k, 0) = 1.0;
  return w;
}

/// ||picture - sum of w_k T_k||, and the sum's norm, in double.
struct Distance {
  double error = 0.0;
  double norm = 0.0;
};
Distance distance(const Image<float>& picture, const MemoryStack& stack,
                  const LightWeights& w) {
  Distance found;
  const std::size_t n = count(stack.dims().n_lights);
  for (std::size_t p = 0; p < picture.pixels().size(); ++p) {
    double sum = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      sum += w(static_cast<Eigen::Index>(k), 0) * double{stack.values()[p * n + k]};
    }
    const double off = double{picture.pixels()[p]} - sum;
    found.error += off * off;
    found.norm += sum * sum;
  }
  return {std::sqrt(found.error), std::sqrt(found.norm)};
}

/// A stack, its files and the ways to relight from them.
using Relighter = std::function<RelitPicture(const LightWeights&, const RelightOptions&)>;
using MakeRelighters =
    std::function<std::vector<Relighter>(const MemoryStack& stack, const HaarGrid& grid)>;

using Files = std::vector<std::shared_ptr<const BasisFile>>;
Files files_of(const MemoryStack& stack, const HaarGrid& grid) {
  Files files;
  for (const CompressOptions& options : {CompressOptions{}, CompressOptions{.relative_l2 = 0.0},
                                         CompressOptions{.basis = BasisKind::direct}}) {
    files.push_back(
        std::make_shared<const BasisFile>(compressed(made_source(stack, grid), options)));
  }
  return files;
}

std::vector<Relighter> from_files(const MemoryStack& stack, const HaarGrid& grid) {
  std::vector<Relighter> all;
  for (const auto& file : files_of(stack, grid)) {
    all.emplace_back([file](const LightWeights& w, const RelightOptions& options) {
      return relight(*file, w, options);
    });
  }
  return all;
}

std::vector<Relighter> from_memory(const MemoryStack& stack, const HaarGrid& grid) {
  std::vector<Relighter> all;
  for (const auto& file : files_of(stack, grid)) {
    if (file->header().coding != BasisCoding::quantised) {
      continue;  // its sums are those of the dense half
    }
    const auto basis =
        std::make_shared<PreparedBasis>(*file, PrepareOptions{.form = PreparedForm::sparse});
    for (const RelightMethod method :
         {RelightMethod::sparse_rows, RelightMethod::coefficient_lists}) {
      all.emplace_back([basis, method](const LightWeights& w, const RelightOptions& options) {
        PreparedRun run;
        run.method = method;
        return basis->relight(std::span(&w, 1), options, std::move(run)).front();
      });
    }
  }
  return all;
}

std::vector<Relighter> from_halfs(const MemoryStack& stack, const HaarGrid&) {
  const auto half = std::make_shared<DenseHalf>(stack, "made");
  return {[half](const LightWeights& w, const RelightOptions&) {
    return half->relight(std::span(&w, 1)).front();
  }};
}

/// error / (bound + 1e-6 ||sum||) of all relighters, with all terms and with few.
double worst_of_bound(const std::vector<Relighter>& relighters, const MemoryStack& stack,
                      const LightWeights& w) {
  double worst = 0.0;
  for (const Relighter& relighter : relighters) {
    for (const RelightOptions& options :
         {RelightOptions{}, RelightOptions{.terms = 4}, RelightOptions{.max_error = 0.05}}) {
      const RelitPicture relit = relighter(w, options);
      const RelightBound& bound = relit.bound;
      const Distance found = distance(relit.picture, stack, w);
      const double total = bound.dropped + bound.coded + bound.rounding + 1e-6 * found.norm;
      EXPECT_TRUE(std::isfinite(total));
      worst = std::max(worst, found.error == 0.0 ? 0.0 : found.error / total);
    }
  }
  return worst;
}
constexpr const char* kOfBound = "error / stated bound";
constexpr const char* kOfBoundWhy =
    "the picture's own bound; 1e-6 of the picture for the float that holds it";

Cell black_both_ways(const MakeRelighters& make) {
  const MemoryStack black(small_stack().dims());
  for (const Relighter& relighter : make(small_stack(), {8, 8})) {
    for (const RelightOptions& options :
         {RelightOptions{}, RelightOptions{.max_error = 0.01}}) {
      const RelitPicture relit = relighter(LightWeights::Zero(64, 1), options);
      EXPECT_THAT(relit.picture.pixels(), ::testing::Each(0.0F));
      EXPECT_EQ(relit.bytes_read, 0U);
      EXPECT_EQ(relit.bound.relative_l2, 0.0);
    }
  }
  for (const Relighter& relighter : make(black, {8, 8})) {
    const RelitPicture relit = relighter(random_weights(64), {});
    EXPECT_THAT(relit.picture.pixels(), ::testing::Each(0.0F));
    EXPECT_EQ(relit.bound.relative_l2, 0.0);
  }
  return exact("no light, or a black stack: black, bound 0; without light nothing is read");
}

Cell one_pixel_one_light(const MakeRelighters& make) {
  MemoryStack stack({1, 1, 1, 1});
  stack.at(0, 0, 0, 0) = 0.3F;
  const double single = worst_of_bound(make(stack, {1, 1}), stack, one_light(0, 1));
  const double of_many =
      worst_of_bound(make(small_stack(), {8, 8}), small_stack(), one_light(9, 64));
  return bounded(std::max(single, of_many), 1.0,
                 std::string("one pixel, one light; one of 64 lights: ") + kOfBound,
                 kOfBoundWhy);
}

Cell odd_grids(const MakeRelighters& make) {
  double worst = 0.0;
  for (const HaarGrid grid : {HaarGrid{1, 9}, {3, 5}, {7, 30}}) {
    const MemoryStack& stack = make_stack(
        {.width = 33, .height = 3, .grid = grid.cols, .noise = 0.02, .rows = grid.rows});
    worst =
        std::max(worst, worst_of_bound(make(stack, grid), stack, random_weights(grid.size())));
  }
  return bounded(worst, 1.0, kOfBound, kOfBoundWhy);
}

Cell scales(const MakeRelighters& make) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e-20, 1.0, 1e20, 1e30}) {
    const MemoryStack stack = scaled(small_stack(), scale);
    const std::vector<Relighter> relighters = make(stack, {8, 8});
    worst = std::max(worst, worst_of_bound(relighters, stack, random_weights(64)));
    worst = std::max(worst, worst_of_bound(relighters, stack, random_weights(64, 1.0 / scale)));
  }
  for (const Relighter& relighter : make(small_stack(), {8, 8})) {
    EXPECT_EQ(relighter(random_weights(64, 1e39), {}).bound.relative_l2,
              std::numeric_limits<double>::infinity());
  }
  return both(
      bounded(worst, 1.0, std::string("stack or weights scaled: ") + kOfBound, kOfBoundWhy),
      stated("pictures beyond the largest float: the bound is infinite"));
}

Cell subnormals(const MakeRelighters& make) {
  const MemoryStack stack = scaled(small_stack(), 1e-40);
  // Half of the smallest float in each of 297 pixels.
  const double units = 0.5 * 1.5e-45 * std::sqrt(297.0);
  double worst = 0.0;
  for (const Relighter& relighter : make(stack, {8, 8})) {
    const LightWeights w = random_weights(64);
    const RelitPicture relit = relighter(w, {});
    const double total = relit.bound.coded + relit.bound.rounding + units;
    worst = std::max(worst, distance(relit.picture, stack, w).error / total);
  }
  return bounded(worst, 1.0, kOfBound, "the picture's own bound, and half the smallest float");
}

Cell weights_not_finite(const MakeRelighters& make) {
  const std::vector<Relighter> all = make(small_stack(), {8, 8});
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    (void)refused("finite", [&] { (void)all[0](bad * one_light(3, 64), {}); });
  }
  return both(refused("finite", [&] { (void)all[0](double{kNan} * one_light(3, 64), {}); }),
              refused("lights", [&] { (void)all[0](one_light(3, 63), {}); }));
}

Cell equal_lights_cancel(const MakeRelighters& make) {
  MemoryStack stack = small_stack();
  for (int i = 0; i < 33 * 9; ++i) {
    stack.at(0, i / 33, i % 33, 10) = stack.at(0, i / 33, i % 33, 9);
  }
  LightWeights w = one_light(9, 64);
  w(10, 0) = -1.0;
  double worst = 0.0;
  for (const Relighter& relighter : make(stack, {8, 8})) {
    const RelitPicture relit = relighter(w, {});
    const double error = distance(relit.picture, stack, w).error;
    const double total = relit.bound.coded + relit.bound.rounding;
    worst = std::max(worst, error == 0.0 ? 0.0 : error / total);
  }
  return bounded(worst, 1.0, "equal lights, weights 1 and −1: what is left / stated bound",
                 "the picture's own bound");
}

Cell clipped_is_told(BasisKind basis) {
  const ClippedStack stack(small_stack(), 20);
  CompressSource source = made_source(small_stack(), 8);
  source.stack = &stack;
  const BasisFile file = compressed(source, {.basis = basis});
  for (const bool is_prepared : {false, true}) {
    const auto relit = [&](int k) {
      const LightWeights w = one_light(k, 64);
      return is_prepared ? PreparedBasis(file).relight(std::span(&w, 1)).front()
                         : relight(file, w);
    };
    EXPECT_EQ(relit(20).bound.clipped_fraction.value(), 1.0);
    EXPECT_GT(relit(20).bound.clipped, 0.0);
    EXPECT_EQ(relit(21).bound.clipped_fraction.value(), 0.0);
    EXPECT_EQ(relit(21).bound.clipped, 0.0);
  }
  return stated(
      "the picture says which fraction of its light's values were clipped, and their norm");
}

EXTREMES_OF(relight_file, "relight/basis: relighting",
            "`relight` from the file, sums in double")
EXTREME(relight_file, dark) { return black_both_ways(from_files); }
EXTREME(relight_file, one) { return one_pixel_one_light(from_files); }
NO_EXTREME(relight_file, largest, "its sizes are the file's")
EXTREME(relight_file, odd_size) { return odd_grids(from_files); }
EXTREME(relight_file, scale) { return scales(from_files); }
EXTREME(relight_file, subnormal) { return subnormals(from_files); }
EXTREME(relight_file, not_finite) { return weights_not_finite(from_files); }
NO_GEOMETRY(relight_file)
EXTREME(relight_file, duplicate) { return equal_lights_cancel(from_files); }
EXTREME(relight_file, clipped) { return clipped_is_told(BasisKind::haar); }

EXTREMES_OF(relight_memory, "relight/basis: relighting",
            "`PreparedBasis`: rows and lists in memory, sums in float")
EXTREME(relight_memory, dark) { return black_both_ways(from_memory); }
EXTREME(relight_memory, one) { return one_pixel_one_light(from_memory); }
EXTREME(relight_memory, largest) {
  const BasisFile file = compressed(made_source(small_stack(), 8), {});
  return refused("memory", [&] { const PreparedBasis basis(file, {.memory_bytes = 1000}); });
}
EXTREME(relight_memory, odd_size) { return odd_grids(from_memory); }
EXTREME(relight_memory, scale) { return scales(from_memory); }
EXTREME(relight_memory, subnormal) { return subnormals(from_memory); }
EXTREME(relight_memory, not_finite) { return weights_not_finite(from_memory); }
NO_GEOMETRY(relight_memory)
EXTREME(relight_memory, duplicate) { return equal_lights_cancel(from_memory); }
EXTREME(relight_memory, clipped) { return clipped_is_told(BasisKind::direct); }

EXTREMES_OF(dense_half, "relight/basis: relighting", "`DenseHalf`: half floats, sums in float")
EXTREME(dense_half, dark) { return black_both_ways(from_halfs); }
EXTREME(dense_half, one) { return one_pixel_one_light(from_halfs); }
EXTREME(dense_half, largest) {
  MemoryStack stack({40, 10, 1, 9});
  stack.at(0, 7, 33, 4) = 65504.0F;
  EXPECT_EQ(DenseHalf(stack, "made", {.exponent = 0}).report().relative_l2, 0.0);
  stack.at(0, 7, 33, 4) = 65505.0F;
  EXPECT_LT(DenseHalf(stack, "made").report().relative_l2, 0x1p-11) << "a unit of its own";
  return both(
      refused("under light 4 at pixel (33, 7)",
              [&] { const DenseHalf half(stack, "made", {.exponent = 0}); }),
      refused("memory", [&] { const DenseHalf half(stack, "made", {.memory_bytes = 1000}); }));
}
EXTREME(dense_half, odd_size) { return odd_grids(from_halfs); }
EXTREME(dense_half, scale) {
  double worst = 0.0;
  for (const float value : {1e-30F, 1.0F, 1e30F, 3e38F}) {
    MemoryStack stack({3, 3, 1, 4});
    stack.at(0, 1, 1, 2) = value;
    const DenseHalf half(stack, "made");
    const LightWeights w = one_light(2, 4);
    const double found = half.relight(std::span(&w, 1))[0].picture(1, 1);
    worst = std::max(worst, std::abs(found / double{value} - 1.0));
    EXPECT_EQ(half.report().underflowed, 0U);
  }
  return both(scales(from_halfs),
              bounded(worst, 0x1p-11, "one value up to 3e38: relative error",
                      "11 bits of a half float"));
}
EXTREME(dense_half, subnormal) {
  MemoryStack stack({2, 1, 1, 4});
  stack.at(0, 0, 0, 0) = 1.0F;      // stored as 2^14
  stack.at(0, 0, 0, 1) = 0x1p-40F;  // 2^-26 of a half's units: below half of the smallest
  stack.at(0, 0, 1, 2) = 0x1p-38F;  // the smallest
  const DenseHalf half(stack, "made");
  EXPECT_EQ(half.report().underflowed, 1U);
  EXPECT_NEAR(half.report().relative_l2, 0x1p-40, 1e-18);
  return both(
      subnormals(from_halfs),
      stated(
          "values below 2^-39 of their tile's largest become 0, are counted and in the error"));
}
EXTREME(dense_half, not_finite) {
  MemoryStack stack({40, 10, 3, 9});
  stack.at(2, 9, 39, 8) = kInfinity;
  (void)refused("light 8 at pixel (39, 9)", [&] { const DenseHalf half(stack, "made"); });
  stack.at(2, 9, 39, 8) = kNan;
  return both(refused("light 8 at pixel (39, 9)", [&] { const DenseHalf half(stack, "made"); }),
              weights_not_finite(from_halfs));
}
NO_GEOMETRY(dense_half)
EXTREME(dense_half, duplicate) { return equal_lights_cancel(from_halfs); }
NO_EXTREME(dense_half, clipped, "a stack in memory marks no clipped values")

}  // namespace
}  // namespace haarlight::relight
