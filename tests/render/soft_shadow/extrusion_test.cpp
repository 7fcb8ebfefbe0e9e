// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/extrusion.h"

#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

TEST(FaceClass, IsThatOfThePointsOfTheRim) {
  for (std::uint64_t i = 0; i < 300; ++i) {
    const auto draw = [i](std::uint64_t what) {
      return 2.0 * uniform_unit(hash_key(29, i, what)) - 1.0;
    };
    const Vector3d normal(draw(0), draw(1), draw(2));
    const Vector3d point(2.0 * draw(3), 2.0 * draw(4), 1.0 + draw(5));
    const double radius = 0.7;
    int n_front = 0;
    constexpr int kRim = 1000;
    for (int k = 0; k < kRim; ++k) {
      const double angle = 2.0 * std::numbers::pi * k / kRim;
      const Vector3d rim(radius * std::cos(angle), radius * std::sin(angle), 0.0);
      n_front += normal.dot(rim - point) > 0.0 ? 1 : 0;
    }
    const FaceClass truth = n_front == 0      ? FaceClass::none_front_facing
                            : n_front == kRim ? FaceClass::all_front_facing
                                              : FaceClass::silhouette;
    EXPECT_EQ(face_class(normal, point, radius), truth) << i;
  }
}

TEST(FaceClass, KnowsFacesParallelToTheDisk) {
  EXPECT_EQ(face_class({0, 0, -3}, {5, 0, 2}, 1.0), FaceClass::all_front_facing);
  EXPECT_EQ(face_class({0, 0, 3}, {5, 0, 2}, 1.0), FaceClass::none_front_facing);
}

TEST(FaceClass, TouchingTheRimIsNoSilhouette) {
  EXPECT_EQ(face_class({-1, 0, 0}, {1, 0, 2}, 1.0), FaceClass::all_front_facing);
  EXPECT_EQ(face_class({1, 0, 0}, {1, 0, 2}, 1.0), FaceClass::none_front_facing);
  EXPECT_EQ(face_class({1, 0, 0}, {0.999, 0, 2}, 1.0), FaceClass::silhouette);
}

TEST(FaceClass, PartsEdgesIntoSilhouettes) {
  using enum FaceClass;
  EXPECT_TRUE(is_umbra_edge(none_front_facing, silhouette));
  EXPECT_TRUE(is_umbra_edge(all_front_facing, none_front_facing));
  EXPECT_FALSE(is_umbra_edge(all_front_facing, silhouette));
  EXPECT_TRUE(is_penumbra_edge(all_front_facing, silhouette));
  EXPECT_TRUE(is_penumbra_edge(none_front_facing, all_front_facing));
  EXPECT_FALSE(is_penumbra_edge(none_front_facing, silhouette));
  for (const FaceClass c : all_values<FaceClass>()) {
    EXPECT_FALSE(is_umbra_edge(c, c) || is_penumbra_edge(c, c)) << to_string(c);
  }
}

TEST(FaceClass, RefusesAFaceWithoutNormal) {
  EXPECT_THROW((void)face_class({0, 0, 0}, {0, 0, 1}, 1.0), ContractViolation);
  EXPECT_THROW((void)face_class({0, 0, kNan}, {0, 0, 1}, 1.0), ContractViolation);
  EXPECT_THROW((void)face_class({0, 0, 1}, {0, kInfinity, 1}, 1.0), ContractViolation);
  EXPECT_THROW((void)face_class({0, 0, 1}, {0, 0, 1}, 0.0), ContractViolation);
}

TEST(Extrusion, OfAParallelEdgeIsAcrossIt) {
  const auto points = extrusion_points({-1, 0, 2}, {1, 0, 2}, {0, -1, 2}, 0.5);
  ASSERT_TRUE(points.has_value());
  EXPECT_EQ(points->umbra, Vector2d(0, 0.5));
  EXPECT_EQ(points->penumbra, Vector2d(0, -0.5));
}

TEST(Extrusion, GoesToTheParallelEdgesSmoothly) {
  // a at a distance D turns both points by r/D about the centre.
  for (const double tilt : {1e-3, 1e-8, 1e-15, 1e-300, -1e-300, -1e-15, -1e-8, -1e-3}) {
    const auto points = extrusion_points({-1, 0, 2}, {1, 0, 2 + tilt}, {0, -1, 2}, 0.5);
    ASSERT_TRUE(points.has_value()) << tilt;
    const double w = (2 + tilt) - 2;  // as double has it
    const double cosine = 0.5 * w / (std::abs(-1.0 * w - 2.0 * 2.0));
    EXPECT_NEAR(points->umbra.x(), -0.5 * cosine, 1e-16) << tilt;
    EXPECT_NEAR(points->umbra.y(), 0.5, 0.5 * cosine * cosine + 1e-16) << tilt;
    EXPECT_NEAR(points->penumbra.x(), -0.5 * cosine, 1e-16) << tilt;
  }
}

TEST(Extrusion, PlanesTouchTheRimAndPartItFromTheOccluder) {
  int n_found = 0;
  for (std::uint64_t i = 0; i < 500; ++i) {
    const auto draw = [i](std::uint64_t what) {
      return 2.0 * uniform_unit(hash_key(31, i, what)) - 1.0;
    };
    const double radius = 0.6 + 0.5 * draw(9);
    const Vector3d v1(3 * draw(0), 3 * draw(1), 2 + draw(2));
    const Vector3d v2(3 * draw(3), 3 * draw(4), 2 + draw(5));
    const Vector3d occluder(3 * draw(6), 3 * draw(7), 2 + draw(8));
    const auto points = extrusion_points(v1, v2, occluder, radius);
    if (!points) {
      continue;
    }
    ++n_found;
    const Vector3d umbra = touching_plane(points->umbra, v1);
    const Vector3d penumbra = touching_plane(points->penumbra, v1);
    for (const Vector3d& normal : {umbra, penumbra}) {
      // The plane has both ends of the edge, and the rim on one side: the greatest of normal.p
      // over the rim is r |(n_x, n_y)| = r.
      const double length = normal.norm();
      EXPECT_NEAR(normal.dot(v1) / length, radius / length, 1e-14 * v1.norm()) << i;
      EXPECT_NEAR(normal.dot(v2) / length, radius / length, 1e-11)
          << i;  // v1 to v2 may be short
      EXPECT_NEAR(normal.head<2>().norm(), 1.0, 1e-15) << i;
    }
    EXPECT_LT(umbra.dot(occluder), radius) << i;
    EXPECT_GT(penumbra.dot(occluder), radius) << i;
  }
  EXPECT_GT(n_found, 200);
}

TEST(Extrusion, OnTheRimBothPointsAreA) {
  for (const double d : {1.0 - 0.9e-12, 1.0, 1.0 + 0.9e-12}) {
    for (const double sign : {1.0, -1.0}) {  // either end first
      const Vector3d low(d, 0, 1);
      const Vector3d high(d, 0, 3);
      const auto points =
          extrusion_points(sign > 0 ? low : high, sign > 0 ? high : low, {2, 0, 2}, 1.0);
      ASSERT_TRUE(points.has_value()) << d;
      EXPECT_EQ(points->umbra, Vector2d(1, 0));
      EXPECT_EQ(points->penumbra, Vector2d(1, 0));
    }
  }
  // At D = r (1 + 2^-30) the planes are 2 sqrt(2^-29) = 9e-5 from one another: what is aside of
  // the edge by a distance of 1 is between them, or beyond.
  const Vector3d low(1 + 0x1p-30, 0, 1);
  const Vector3d high(1 + 0x1p-30, 0, 3);
  const auto aside = extrusion_points(low, high, {1, -1, 2}, 1.0);
  ASSERT_TRUE(aside.has_value());
  EXPECT_NEAR(aside->umbra.y(), std::sqrt(0x1p-29), 1e-13);  // the next term: 3e-14
  EXPECT_NEAR(aside->penumbra.y(), -std::sqrt(0x1p-29), 1e-13);
  EXPECT_FALSE(extrusion_points(low, high, {1 + 1e-4, -1, 2}, 1.0).has_value());
}

/// Nothing: it has extrusion points.
std::optional<ExtrusionFault> fault_of(const Vector3d& v1, const Vector3d& v2,
                                       const Vector3d& occluder, double radius) {
  const auto points = extrusion_points(v1, v2, occluder, radius);
  return points ? std::nullopt : std::optional(points.error());
}

TEST(Extrusion, IsRefusedWithItsReason) {
  using enum ExtrusionFault;
  EXPECT_EQ(fault_of({1, 0, 1}, {1, 0, 1}, {2, 0, 1}, 1.0), no_length);
  EXPECT_EQ(fault_of({0.5, 0, 1}, {0.5, 0, 3}, {1, 0, 2}, 1.0), meets_disk);
  EXPECT_EQ(fault_of({0, 0, 1}, {0, 0, 3}, {1, 0, 2}, 1.0), meets_disk);
  EXPECT_EQ(fault_of({1.0 - 1.1e-12, 0, 1}, {1.0 - 1.1e-12, 0, 3}, {2, 0, 2}, 1.0), meets_disk);
  // Right above and right below the edge; on the edge.
  EXPECT_EQ(fault_of({-1, 0, 2}, {1, 0, 2}, {0, 0, 1}, 0.5), no_side);
  EXPECT_EQ(fault_of({-1, 0, 2}, {1, 0, 2}, {0, 0, 3}, 0.5), no_side);
  EXPECT_EQ(fault_of({-1, 0, 2}, {1, 0, 2}, {0.3, 0, 2}, 0.5), no_side);
  EXPECT_NE(to_string(meets_disk).find("meets the disk"), std::string_view::npos);
}

TEST(Extrusion, RefusesWhatIsNotInFrontAndNotFinite) {
  const Vector3d v1(-1, 0, 2);
  const Vector3d v2(1, 0, 2);
  const Vector3d o(0, -1, 2);
  EXPECT_THROW((void)extrusion_points({-1, 0, -0.1}, v2, o, 1.0), ContractViolation);
  EXPECT_THROW((void)extrusion_points({-1, 0, 0}, {1, 0, 0}, o, 1.0), ContractViolation);
  EXPECT_THROW((void)extrusion_points({-1, kNan, 2}, v2, o, 1.0), ContractViolation);
  EXPECT_THROW((void)extrusion_points(v1, {kInfinity, 0, 2}, o, 1.0), ContractViolation);
  EXPECT_THROW((void)extrusion_points(v1, v2, {0, 0, kNan}, 1.0), ContractViolation);
  for (const double bad : {0.0, -1.0, kInfinity, kNan}) {
    EXPECT_THROW((void)extrusion_points(v1, v2, o, bad), ContractViolation) << bad;
  }
  EXPECT_THROW((void)touching_plane({1, 0}, {0, 0, 0}), ContractViolation);
}

TEST(EdgePlane, IsParallelToTheDiskIfTheEdgeIs) {
  const Vector3d direction = Vector3d(0.3, -0.2, 1.0).normalized();
  const double truth = 2.0 / direction.z();
  EXPECT_NEAR(edge_plane_distance(direction, {-1, 0.4, 2}, {1, 0.7, 2}), truth, 1e-15);
  EXPECT_NEAR(paper_edge_distance(direction, {-1, 0.4, 2}, {1, 0.7, 2}), truth, 1e-15);
}

TEST(EdgePlane, HasTheEdgeAndALevelLineThroughA) {
  const Vector3d v1(1, 2, 3);
  const Vector3d v2(2, 3, 1);
  const Vector3d homogeneous = point_in_disk_plane(v1, v2);
  const Vector2d a = homogeneous.head<2>() / homogeneous.z();
  EXPECT_NEAR((a - Vector2d(2.5, 3.5)).norm(), 0.0, 1e-15);
  const Vector3d across(-a.y(), a.x(), 0.0);
  for (const double k : {-0.2, 0.0, 0.1}) {
    const Vector3d on_plane = 0.3 * v1 + 0.7 * v2 + k * across;
    EXPECT_NEAR(edge_plane_distance(on_plane.normalized(), v1, v2), on_plane.norm(), 1e-14);
  }
  EXPECT_EQ(edge_plane_distance(-Vector3d(v1 + v2).normalized(), v1, v2), kInfinity);
  EXPECT_THROW((void)edge_plane_distance(Vector3d::UnitZ(), {1, 1, 1}, {2, 2, 2}),
               ContractViolation);
}

TEST(EdgePlane, ThePapersIsThatOfTheEdgesNearestPoint) {
  // Straight forward, past an edge that is nearest in its middle, and in its end.
  EXPECT_NEAR(paper_edge_distance(Vector3d::UnitZ(), {-1, 0.5, 2}, {1, 0.5, 4}), 3.0, 1e-15);
  EXPECT_NEAR(paper_edge_distance(Vector3d::UnitZ(), {1, 0.5, 2}, {3, 0.5, 4}), 2.0, 1e-15);
  EXPECT_EQ(paper_edge_distance(Vector3d::UnitX(), {1, 0.5, 2}, {3, 0.5, 4}), kInfinity);
}

}  // namespace
}  // namespace haarlight::render
