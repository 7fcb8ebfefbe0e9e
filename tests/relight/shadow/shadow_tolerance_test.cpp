// SPDX-License-Identifier: Apache-2.0
/// @file
/// The tolerance on many random environments and pictures, as a job has it: 4096 receivers are
/// checked. Prints the largest error.

#include <cstdio>
#include <string>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using namespace shadow_scene;  // NOLINT(google-build-using-namespace): one scene's words

TEST(ShadowTolerance, IsKeptOnRandomEnvironments) {
  const std::vector<render::SquareLight> lights = ceiling(16);
  const PlaneFrame frame = ground();
  const std::vector<render::SurfacePoint> receivers = hills(100);
  double worst = 0.0;
  double worst_point_over = 0.0;
  for (std::uint64_t i = 0; i < 42; ++i) {
    const auto kind = static_cast<Kind>(i % 6);
    const double tolerance = std::pow(10.0, -1.0 - 2.0 * uniform_unit(hash_key(3, i)));
    const double noise = i % 3 == 0 ? 0.01 : 0.0;
    const std::vector<Vector3d> weights = environment(kind, lights, 100 + i);
    const std::vector<SamplingPlane> planes{
        {frame,
         [&](int k) {
           return plate_shadow(frame, lights[static_cast<std::size_t>(k)], noise,
                               1000 * i + static_cast<std::uint64_t>(k));
         },
         HeightRange{90.0, 110.0}}};
    PointsOptions options;
    const PointsResult exact = shadow_at_points(receivers, planes, lights, weights, options);
    options.tolerance = {tolerance, 10.0 * tolerance};
    const PointsResult found = shadow_at_points(receivers, planes, lights, weights, options);
    const Difference error = compare(found, exact);
    EXPECT_LE(error.relative_l2, tolerance) << i;
    EXPECT_LE(found.report.achieved.worst_pixel, 10.0 * tolerance) << i;
    worst = std::max(worst, error.relative_l2 / tolerance);
    worst_point_over = std::max(worst_point_over, error.worst / (10.0 * tolerance));
  }
  std::printf("largest error: %.2f of the tolerance; worst point %.2f of its limit\n", worst,
              worst_point_over);
}

TEST_F(ShadowPoints, TheErrorIsBelowTheToleranceAndMonotone) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  double lookups_smooth = 0.0;
  for (const std::uint64_t seed : {1U}) {
    for (const Kind kind :
         {Kind::one, Kind::nine, Kind::sparse, Kind::smooth, Kind::rough, Kind::coloured}) {
      const std::vector<Vector3d> weights = environment(kind, lights_, seed);
      const PointsResult exact = run(receivers, weights);
      double threshold = kInfinity;
      for (const double tolerance : {0.03, 0.01, 0.001}) {
        const PointsResult found = run(receivers, weights, tolerance);
        const Difference error = compare(found, exact);
        EXPECT_LE(error.relative_l2, tolerance)
            << static_cast<int>(kind) << " threshold " << found.report.threshold;
        EXPECT_LE(found.report.relative_l2_limit, tolerance);
        EXPECT_LE(found.report.threshold, threshold);
        threshold = found.report.threshold;
        if (kind == Kind::smooth && tolerance == 0.01) {
          lookups_smooth = found.report.lookups_a_point;
        }
      }
    }
  }
  EXPECT_LT(lookups_smooth, 0.5 * 256.0) << "blocks were not used";
  RecordProperty("lookups_a_point", std::to_string(lookups_smooth));
}

TEST_F(ShadowPoints, TheWorstPointIsLimitedToo) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 2);
  const PointsResult exact = run(receivers, weights);
  const PointsResult loose = run(receivers, weights, 0.03);
  const PointsResult tight = run(receivers, weights, 0.03, 0.004);
  EXPECT_LE(tight.report.achieved.worst_pixel, 0.004);
  EXPECT_LT(tight.report.threshold, loose.report.threshold);
  // The limit was checked on 512 receivers: at most some in a hundred can be over it.
  std::size_t n_over = 0;
  double peak = 0.0;
  for (const PointTotal& total : exact.totals) {
    peak = std::max(peak, total.shadowed.maxCoeff());
  }
  for (std::size_t i = 0; i < exact.totals.size(); ++i) {
    const Vector3d e = tight.totals[i].shadowed - exact.totals[i].shadowed;
    n_over += e.cwiseAbs().maxCoeff() > 0.004 * peak ? 1 : 0;
  }
  EXPECT_LE(n_over, exact.totals.size() / 50);
}

TEST_F(ShadowPoints, DoesNotDependOnThreadsOrExactSumsOnMemory) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::rough, lights_, 9);
  const auto with = [&](int threads, double tolerance, std::uint64_t memory) {
    const ThreadLimit limit(threads);
    PointsOptions options = few();
    options.tolerance.relative_l2 = tolerance;
    options.memory_bytes = memory;
    return shadow_at_points(receivers, planes(), lights_, weights, options);
  };
  constexpr std::uint64_t kPlenty = 1U << 30U;
  EXPECT_TRUE(same_bits(with(1, 0.0, kPlenty), with(3, 0.0, kPlenty)));
  EXPECT_TRUE(same_bits(with(1, 0.0, kPlenty), with(2, 0.0, 1)));  // a light at a time
  EXPECT_TRUE(same_bits(with(1, 0.01, kPlenty), with(3, 0.01, kPlenty)));
  // Little memory: smaller blocks, the tolerance kept, the bound on the tables too.
  const std::uint64_t table = std::uint64_t{16} * 101 * 101;
  const PointsResult exact = with(2, 0.0, kPlenty);
  const PointsResult small = with(2, 0.01, 30 * table);
  EXPECT_LE(compare(small, exact).relative_l2, 0.01);
  EXPECT_EQ(small.report.block_side, 4);
  EXPECT_LE(small.report.table_bytes, 30 * table);
}

}  // namespace
}  // namespace haarlight::relight
