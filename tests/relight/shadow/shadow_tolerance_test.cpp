/// @file
/// The tolerance on many random environments and pictures, as a job has it: 4096 receivers are
/// checked. Prints the worst of what was reached.

#include <cstdio>

#include <gtest/gtest.h>

#include "core/random.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight {
namespace {

using Eigen::Vector3d;
using namespace shadow_scene;  // NOLINT(google-build-using-namespace): one scene's words

TEST(ShadowTolerance, IsKeptOnRandomEnvironments) {
  const std::vector<SquareLight> lights = ceiling(16);
  const PlaneFrame frame = ground();
  const std::vector<SurfacePoint> receivers = hills(100);
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
    EXPECT_LE(found.report.reached.worst_pixel, 10.0 * tolerance) << i;
    worst = std::max(worst, error.relative_l2 / tolerance);
    worst_point_over = std::max(worst_point_over, error.worst / (10.0 * tolerance));
  }
  std::printf("largest error reached: %.2f of the tolerance; worst point %.2f of its limit\n",
              worst, worst_point_over);
}

}  // namespace
}  // namespace haarlight
