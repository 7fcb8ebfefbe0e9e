// SPDX-License-Identifier: Apache-2.0
/// @file
/// Which records a point may use, by the rule alone and by the octree, and records of hemispheres
/// that are known.

#include "render/surface/irradiance_octree.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "render/bsdf/shading_frame.h"
#include "render/surface/irradiance_gather.h"

namespace haarlight::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

double number(std::uint64_t i, std::uint64_t which) {
  return uniform_unit(hash_key(11, i, which));
}

Vector3d unit_vector(std::uint64_t i, std::uint64_t which) {
  const double z = 2.0 * number(i, which) - 1.0;
  const double turn = 2.0 * pi * number(i, which + 1);
  const double sine = std::sqrt(1.0 - z * z);
  return {sine * std::cos(turn), sine * std::sin(turn), z};
}

/// Values worked out by hand; exact but for the rounding of a few operations.
TEST(ReuseWeight, IsTheRule) {
  const RecordReach record{
      .point = {10, 20, 30}, .normal = Vector3d::UnitZ(), .radius_mm = 8.0};
  const auto at = [&](double x, double y, double z, const Vector3d& normal) {
    return reuse_weight(record, record.point + Vector3d(x, y, z), normal);
  };
  const Vector3d up = Vector3d::UnitZ();
  EXPECT_EQ(at(0, 0, 0, up), 1.0);
  EXPECT_NEAR(at(4, 0, 0, up), 0.25, 1e-15);     // err = 1/2
  EXPECT_NEAR(at(0, -6, 0, up), 0.0625, 1e-15);  // err = 3/4
  EXPECT_EQ(at(8, 0, 0, up), 0.0);
  EXPECT_EQ(at(0, 8.001, 0, up), 0.0);
  // Turned by 60 degrees about x: n.n' = 1/2, so that 2 mm count as 4.
  const Vector3d turned(0.0, -std::sqrt(0.75), 0.5);
  EXPECT_NEAR(at(2, 0, 0, turned), 0.25, 1e-12);
  EXPECT_EQ(at(4.001, 0, 0, turned), 0.0);
  EXPECT_EQ(at(1, 0, 0, -up), 0.0);
  EXPECT_EQ(at(0, 0, 0, Vector3d(1.0, 0.0, 0.0)), 0.0);                     // n.n' = 0
  EXPECT_EQ(at(0, 0, 0, Vector3d(0.99996, 0.0, 0.009).normalized()), 0.0);  // below 0.01
  EXPECT_GT(at(0, 0, 0, Vector3d(0.9999, 0.0, 0.011).normalized()), 0.0);
  // Behind the record by 0.01 R = 0.08 mm at most; before it as far as it reaches.
  EXPECT_GT(at(1, 0, -0.079, up), 0.0);
  EXPECT_EQ(at(1, 0, -0.081, up), 0.0);
  EXPECT_GT(at(1, 0, 3.0, up), 0.0);
}

/// Reaches from 1e-4 of the cube to more than all of it, points within, on borders of nodes and on the
/// cube's own. Exactly the same sets.
TEST(IrradianceOctree, FindsWhatTheRuleFindsAmongAllRecords) {
  const Vector3d lower(-100.0, 50.0, 1000.0);
  constexpr double kSide = 256.0;
  IrradianceOctree octree(lower, kSide);
  const auto point = [&](std::uint64_t i, std::uint64_t key) -> Vector3d {
    Vector3d within(number(i, key), number(i, key + 1), number(i, key + 2));
    if (i % 3 == 0) {
      within = (16.0 * within).array().round() / 16.0;
    }
    return lower + kSide * within;
  };
  for (std::uint64_t i = 0; i < 4000; ++i) {
    IrradianceRecord record;
    record.reach = {.point = point(i, 0),
                    .normal = unit_vector(i, 3),
                    .radius_mm = kSide * std::pow(10.0, -4.0 + 3.6 * number(i, 5))};
    octree.add(record);
  }
  octree.add(
      {.reach = {.point = lower, .normal = Vector3d::UnitZ(), .radius_mm = 3.0 * kSide}});
  std::size_t n_found = 0;
  for (std::uint64_t i = 0; i < 3000; ++i) {
    // Also right at records and next to them.
    const Vector3d at =
        i % 4 == 0 ? octree.records()[i].reach.point + 1e-3 * unit_vector(i, 40) : point(i, 20);
    const Vector3d normal = unit_vector(i, 30);
    std::vector<std::uint32_t> by_rule;
    for (std::size_t k = 0; k < octree.records().size(); ++k) {
      if (reuse_weight(octree.records()[k].reach, at, normal) > 0.0) {
        by_rule.push_back(static_cast<std::uint32_t>(k));
      }
    }
    std::vector<std::uint32_t> found = octree.records_at(at, normal);
    std::ranges::sort(found);
    ASSERT_EQ(found, by_rule) << i;
    ASSERT_EQ(octree.has_records_at(at, normal), !by_rule.empty());
    ASSERT_EQ(octree.irradiance(at, normal).has_value(), !by_rule.empty());
    n_found += found.size();
  }
  std::printf("%.1f records a point\n", static_cast<double>(n_found) / 3000);
  EXPECT_GT(n_found, 3000U);
}

TEST(IrradianceOctree, IsTheMeanByWeights) {
  IrradianceOctree octree(Vector3d::Zero(), 64.0);
  IrradianceRecord one{.reach = {.point = {10, 10, 0}, .radius_mm = 8.0},
                       .irradiance = Vector3d(1.0, 2.0, 0.1)};
  IrradianceRecord two{.reach = {.point = {16, 10, 0}, .radius_mm = 12.0},
                       .irradiance = Vector3d(5.0, 0.0, 0.1)};
  two.by_shift.row(0) = Vector3d(0.5, 0.0, 0.0);
  one.by_shift.row(2) = Vector3d(-1.0, 0.0, 0.0);  // would be below 0: it is 0
  two.by_turn.row(1) = Vector3d(0.0, 7.0, 0.0);    // of a turn about y, there is none
  octree.add(one);
  octree.add(two);
  const auto found = octree.irradiance({14, 10, 0}, Vector3d::UnitZ());
  ASSERT_TRUE(found);
  const double first = 0.25;          // 4 mm of 8
  const double second = 25.0 / 36.0;  // 2 mm of 12
  EXPECT_NEAR(found->x(), (first * 1.0 + second * 4.0) / (first + second), 1e-14);
  EXPECT_NEAR(found->y(), (first * 2.0) / (first + second), 1e-14);
  EXPECT_NEAR(found->z(), (second * 0.1) / (first + second), 1e-14);
  const auto without = octree.irradiance_without(1, {14, 10, 0}, Vector3d::UnitZ());
  ASSERT_TRUE(without);
  EXPECT_EQ(without->x(), 1.0);
  EXPECT_FALSE(octree.irradiance({40, 40, 0}, Vector3d::UnitZ()));
}

TEST(HemisphereCells, AreAsManyAsThereAreRaysAndOfTheSameShare) {
  for (const int n_rays : {4, 7, 64, 500, 4096}) {
    const HemisphereCells cells = HemisphereCells::of(n_rays);
    EXPECT_LE(cells.size(), n_rays);
    EXPECT_GT(cells.size(), n_rays - cells.n_high);
    // The mean of z over cells that are alike in cos/pi is 2/3: the midpoint rule, off by the square
    // of a cell's height.
    double mean = 0.0;
    Vector3d sum = Vector3d::Zero();
    for (int cell = 0; cell < cells.size(); ++cell) {
      const Vector3d direction = cells.direction(cell, Vector2d(0.5, 0.5));
      EXPECT_NEAR(direction.norm(), 1.0, 1e-14);
      mean += direction.z() / cells.size();
      sum += direction / cells.size();
    }
    EXPECT_NEAR(mean, 2.0 / 3.0, 0.05 / cells.n_high);
    EXPECT_NEAR(sum.head<2>().norm(), 0.0, 1e-12);
  }
}

/// Radiance 1 + k d.x over the sky of a point, all at the distance r: a large sphere that is lit from
/// one side. E = pi; a turn of n by w changes it by the integral of L (w x n).d, that is w_y k pi... in
/// closed form: the integral of (n x d) k d.x over the hemisphere is k 2 pi/3 (n x x), and n x x = y.
TEST(RecordOf, AGradientOfTheSkyTurnsWithTheNormal) {
  constexpr double kSlope = 0.7;
  const Vector3d normal = Vector3d(0.3, -0.5, 0.8).normalized();
  const Matrix3d frame = frame_of(normal);
  const HemisphereCells cells = HemisphereCells::of(20000);
  std::vector<PathIntegrator::Gathered> found;
  for (int cell = 0; cell < cells.size(); ++cell) {
    const Vector3d direction = cells.direction(cell, Vector2d(0.5, 0.5));
    found.push_back({.radiance = Vector3d(1.0 + kSlope * direction.x(), 1.0, 0.0)});
  }
  const IrradianceRecord record =
      record_of({1, 2, 3}, frame, cells, found, 0.5, {.least_mm = 2.0, .most_mm = 40.0});
  EXPECT_NEAR(record.irradiance.x(), pi, 1e-12);
  EXPECT_NEAR(record.irradiance.z(), 0.0, 1e-15);
  // Off by what the sky changes within a cell, 1 % of a half turn each way.
  const Vector3d turn = kSlope * 2.0 * pi / 3.0 * frame.col(1);
  EXPECT_LE((record.by_turn.row(0).transpose() - turn).norm(), 0.01 * turn.norm());
  EXPECT_LE(record.by_turn.row(1).norm(), 1e-10);
  EXPECT_LE(record.by_shift.norm(), 1e-12) << "what is infinitely far does not move";
  EXPECT_EQ(record.reach.radius_mm, 20.0) << "nothing near: a times the most";
  EXPECT_EQ(record.reach.normal, normal);
}

/// R = a clamp(harmonic mean, least, most), and no more than the nearest.
TEST(RecordOf, TheRadiusIsTheHarmonicMeanWithinItsLimits) {
  const HemisphereCells cells = HemisphereCells::of(12);
  const auto radius = [&](double distance, double other, double accuracy) {
    std::vector<PathIntegrator::Gathered> found(static_cast<std::size_t>(cells.size()));
    for (std::size_t i = 0; i < found.size(); ++i) {
      found[i].distance_mm = i % 2 == 0 ? distance : other;
    }
    return record_of(Vector3d::Zero(), Matrix3d::Identity(), cells, found, accuracy,
                     {.least_mm = 10.0, .most_mm = 100.0})
        .reach.radius_mm;
  };
  EXPECT_NEAR(radius(30.0, 60.0, 0.25), 0.25 * 40.0, 1e-12);
  EXPECT_NEAR(radius(30.0, std::numeric_limits<double>::infinity(), 0.25), 0.25 * 60.0, 1e-12);
  EXPECT_NEAR(radius(400.0, 400.0, 0.25), 25.0, 1e-12);
  EXPECT_NEAR(radius(1.0, 2.0, 0.25), 2.5, 1e-12);
  EXPECT_NEAR(radius(15.0, 1e9, 0.9), 15.0, 1e-12) << "no further than the nearest surface";
  EXPECT_NEAR(radius(1.0, 1e9, 0.9), 9.0, 1e-12) << "but a times the least";
}

}  // namespace
}  // namespace haarlight::render
