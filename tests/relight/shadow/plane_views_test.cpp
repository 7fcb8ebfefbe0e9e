// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/plane_views.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

ShadowPlane ground(double extent, double texel) {
  ShadowPlane plane;
  plane.extent_u_mm = plane.extent_v_mm = extent;
  plane.texel_mm = texel;
  return plane;
}

TEST(RelatePlanes, KnowsAPlaneByItsGeometryNotByItsPicture) {
  const PlaneFrame frame = make_plane_frame(ground(400.0, 2.0));
  EXPECT_EQ(relate_planes(frame, frame), PlaneRelation::same);
  // Smaller, coarser, turned, with its normal the other way: the same plane.
  ShadowPlane other = ground(200.0, 5.0);
  other.origin = {60.0, -40.0, 0.0};
  other.u = {0.0, 1.0, 0.0};
  other.v = {-1.0, 0.0, 0.0};
  other.n = {0.0, 0.0, -1.0};
  EXPECT_EQ(relate_planes(frame, make_plane_frame(other)), PlaneRelation::same);
  other.origin.x() = 150.0;
  EXPECT_EQ(relate_planes(frame, make_plane_frame(other)), PlaneRelation::reaches_out);
  other.origin.x() = 301.0;  // next to it
  EXPECT_EQ(relate_planes(frame, make_plane_frame(other)), PlaneRelation::apart);
}

TEST(RelatePlanes, TellsAMovedOrTiltedPlane) {
  const PlaneFrame frame = make_plane_frame(ground(400.0, 2.0));
  ShadowPlane other = ground(400.0, 2.0);
  for (const double z : {0.4, -0.4, 0.6, -0.6}) {  // a quarter of a texel is 0.5 mm
    other.origin.z() = z;
    other.d = -z;
    EXPECT_EQ(relate_planes(frame, make_plane_frame(other)),
              std::abs(z) < 0.5 ? PlaneRelation::same : PlaneRelation::apart);
  }
  other = ground(400.0, 2.0);
  const double tilt = 0.6 / 200.0;  // 0.6 mm at the border
  other.u = {std::cos(tilt), 0.0, std::sin(tilt)};
  other.n = {-std::sin(tilt), 0.0, std::cos(tilt)};
  EXPECT_EQ(relate_planes(frame, make_plane_frame(other)), PlaneRelation::apart);
}

Visibility picture(const std::vector<float>& values, const std::vector<std::uint8_t>& known) {
  const auto n = static_cast<int>(values.size());
  Visibility v{Image<float>(1, n, 1), Image<std::uint8_t>(1, n, 1), {}};
  std::copy(values.begin(), values.end(), v.value.pixels().begin());
  std::copy(known.begin(), known.end(), v.known.pixels().begin());
  v.count.n_values = values.size();
  return v;
}

TEST(JoinViews, KnowsWhatAnyViewKnows) {
  const std::vector<Visibility> views{picture({0.2F, 0.8F, 0.0F, 0.0F}, {1, 1, 0, 0}),
                                      picture({0.6F, 0.0F, 0.5F, 0.0F}, {1, 0, 1, 0})};
  const std::vector<double> weights{3.0, 1.0};
  const Visibility joined = join_views(views, weights);
  const std::vector<float> value{0.3F, 0.8F, 0.5F, 0.0F};  // (3 * 0.2 + 0.6)/4 where both know
  const std::vector<std::uint8_t> known{1, 1, 1, 0};
  for (std::size_t i = 0; i < value.size(); ++i) {
    EXPECT_FLOAT_EQ(joined.value.pixels()[i], value[i]);
    EXPECT_EQ(joined.known.pixels()[i], known[i]);
  }
  EXPECT_EQ(joined.count.n_values, 8U);
  EXPECT_THROW((void)join_views({}, {}), ContractViolation);
}

}  // namespace
}  // namespace haarlight::relight
