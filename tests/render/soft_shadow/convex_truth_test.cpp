// SPDX-License-Identifier: Apache-2.0
/// @file
/// The tests' own truth, held to what is known otherwise.

#include "tests/render/soft_shadow/convex_truth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/soft_shadow/circle_polygon.h"
#include "render/soft_shadow/circular_segment.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using test::ConvexPiece;
using test::Polygon2;

ConvexPiece level_square(const Vector2d& centre, double half_side, double z) {
  const auto at = [&](double x, double y) {
    return Vector3d(centre.x() + x * half_side, centre.y() + y * half_side, z);
  };
  return {{at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)}};
}

ConvexPiece box(const Vector3d& low, const Vector3d& high) {
  return test::convex_piece_of(make_box(low, high, 0));
}

Polygon2 square_light(double half_side) {
  return {{-half_side, -half_side},
          {half_side, -half_side},
          {half_side, half_side},
          {-half_side, half_side}};
}

double disk_visibility_of(const ConvexPiece& piece, const Vector3d& x, double radius) {
  return test::true_disk_visibility(std::array{piece}, x, radius);
}

TEST(ConvexTruth, OfASquareSheetIsItsShadowCastOnTheLight) {
  // r = 1, half-side 0.5 at z = 2, from x = (0, 0.1 z, z): the umbra ends at z = 20/7 = 2.857. The
  // shadow's upper side is at y = (0.5 z - 0.2 z)/(z - 2), the others are beyond the rim to z = 4.
  const ConvexPiece sheet = level_square({0, 0}, 0.5, 2.0);
  for (const double z : {2.5, 2.85, 2.87, 3.0, 4.0}) {
    const double side = 0.3 * z / (z - 2.0);
    const double truth = side >= 1.0 ? 0.0 : segment_fraction_beyond(side);
    EXPECT_NEAR(disk_visibility_of(sheet, {0, 0.1 * z, z}, 1.0), truth, 1e-14) << z;
  }
  EXPECT_NEAR(disk_visibility_of(sheet, {0, 0.4, 4}, 1.0), 0.1424, 5e-5);
  EXPECT_EQ(disk_visibility_of(sheet, {0, 0, 3}, 1.0), 0.0);
  EXPECT_EQ(disk_visibility_of(sheet, {9, 0, 3}, 1.0), 1.0);
  // Far behind it, the whole shadow is within the disk: a square of half-side 0.5 z/(z - 2).
  EXPECT_NEAR(disk_visibility_of(sheet, {0, 0, 6}, 2.0),
              1.0 - 1.5 * 1.5 / (4.0 * std::numbers::pi), 1e-14);
}

TEST(ConvexTruth, OfASquareLightIsTheRestOfItsRectangle) {
  const ConvexPiece sheet = level_square({0.3, -0.2}, 0.5, 1.0);
  // From (0, 0, 2) its shadow is [-0.4, 1.6] x [-1.4, 0.6].
  EXPECT_NEAR(test::true_polygon_visibility(std::array{sheet}, {0, 0, 2}, square_light(1.0)),
              1.0 - 1.4 * 1.6 / 4.0, 1e-14);
  EXPECT_NEAR(test::true_polygon_visibility(std::array{sheet}, {0, 0, 2}, square_light(3.0)),
              1.0 - 4.0 / 36.0, 1e-14);
  EXPECT_EQ(test::true_polygon_visibility(std::array{sheet}, {0, 0, 2}, square_light(0.3)),
            0.0);
}

TEST(ConvexTruth, WithoutAPieceBetweenTheLightIsWhole) {
  const Vector3d x(0.1, 0.2, 3.0);
  EXPECT_EQ(test::true_disk_visibility({}, x, 1.0), 1.0);
  EXPECT_EQ(disk_visibility_of(box({-1, -1, 3.5}, {1, 1, 4}), x, 1.0), 1.0);  // behind x
  EXPECT_EQ(disk_visibility_of(box({-9, -9, 3.0}, {9, 9, 4}), x, 1.0), 1.0);  // x on its face
  EXPECT_EQ(disk_visibility_of(box({-1, -1, -2}, {1, 1, -1}), x, 1.0),
            1.0);  // behind the light
  EXPECT_EQ(disk_visibility_of(box({-1, -1, 2.0}, {1, 1, 3.0}), x, 1.0), 0.0);  // x on its back
  EXPECT_EQ(disk_visibility_of(box({-1, -1, 2.5}, {1, 1, 3.5}), x, 1.0), 0.0);  // x within
  for (const double z : {0.0, -1.0}) {  // the light emits to the front
    EXPECT_EQ(test::true_disk_visibility({}, {0, 0, z}, 1.0), 0.0);
    EXPECT_EQ(test::true_polygon_visibility({}, {0, 0, z}, square_light(1.0)), 0.0);
  }
}

TEST(ConvexTruth, ClipsAPieceAtTheReceiverAndAtTheLight) {
  // An upright sheet x = 0.5, y <= 0.3, from behind the light to behind the receiver: from (1, 0, z)
  // it hides all of the disk that lies at x < 0.5 and at y <= where the ray meets the sheet.
  const ConvexPiece sheet{{{0.5, -50, -7}, {0.5, 50, -7}, {0.5, 50, 90}, {0.5, -50, 90}}};
  EXPECT_NEAR(disk_visibility_of(sheet, {1, 0, 3}, 1.0), segment_fraction_beyond(0.5), 1e-14);
  EXPECT_NEAR(disk_visibility_of(sheet, {-1, 0, 3}, 1.0), segment_fraction_beyond(-0.5), 1e-14);
  // A body round the light's edge, through its plane.
  EXPECT_NEAR(disk_visibility_of(box({0.5, -5, -1}, {5, 5, 1e-9}), {0, 0, 3}, 1.0),
              segment_fraction_beyond(-0.5), 1e-9);
  // A wall on whose side the receiver stands: it hides the half-plane behind it.
  EXPECT_NEAR(disk_visibility_of(box({0.2, -50, 0}, {5, 50, 9}), {0.2, 0, 3}, 1.0),
              segment_fraction_beyond(-0.2), 1e-14);
}

TEST(ConvexTruth, TheShadowIsTheSumOfThoseOfTheFacesThatFaceTheReceiver) {
  for (std::uint64_t i = 0; i < 50; ++i) {
    const auto draw = [i](std::uint64_t what) { return uniform_unit(hash_key(37, i, what)); };
    const Eigen::Matrix3d turn =
        Eigen::Quaterniond(draw(0) - 0.5, draw(1) - 0.5, draw(2) - 0.5, draw(3) - 0.5)
            .normalized()
            .toRotationMatrix();
    Mesh mesh = make_sphere({0, 0, 0}, 0.6, 1, 0);
    for (Vector3d& v : mesh.vertices) {
      v = turn * v.cwiseProduct(Vector3d(1.0, 0.7, 0.4)) + Vector3d(draw(4), draw(5), 2.0);
    }
    const Vector3d x(2.0 * draw(6), 2.0 * draw(7), 4.0 + draw(8));
    double sum = 0.0;
    for (const Eigen::Vector3i& t : mesh.triangles) {
      const std::array corners{mesh.vertices[static_cast<std::size_t>(t[0])],
                               mesh.vertices[static_cast<std::size_t>(t[1])],
                               mesh.vertices[static_cast<std::size_t>(t[2])]};
      const Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
      if (normal.dot(x - corners[0]) > 0.0) {
        Polygon2 cast;
        for (const Vector3d& v : corners) {
          cast.push_back((x + (v - x) * (x.z() / (x.z() - v.z()))).head<2>());
        }
        sum += unit_disk_intersection(cast);
      }
    }
    EXPECT_NEAR(1.0 - disk_visibility_of(test::convex_piece_of(mesh), x, 1.0),
                sum / std::numbers::pi, 1e-13)
        << i;
  }
}

/// Whether the segment from x to p meets a box.
bool is_hidden_by(const Vector3d& low, const Vector3d& high, const Vector3d& x,
                  const Vector3d& p) {
  double from = 0.0;
  double to = 1.0;
  for (const int axis : {0, 1, 2}) {
    const double way = p[axis] - x[axis];
    const double a = (low[axis] - x[axis]) / way;
    const double b = (high[axis] - x[axis]) / way;
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  return from <= to;
}

TEST(ConvexTruth, OfUpToFourBoxesIsWhatRaysOnAGridMeet) {
  constexpr int kGrid = 500;
  double seen_part = 0.0;
  for (std::uint64_t i = 0; i < 24; ++i) {
    const auto draw = [i](std::uint64_t what) { return uniform_unit(hash_key(41, i, what)); };
    struct Box {
      Vector3d low;
      Vector3d high;
    };
    std::vector<Box> boxes;
    std::vector<ConvexPiece> pieces;
    for (std::uint64_t k = 0; k <= i % 4; ++k) {
      const Vector3d centre(1.6 * draw(10 * k) - 0.8, 1.6 * draw(10 * k + 1) - 0.8,
                            0.2 + 3.5 * draw(10 * k + 2));
      const Vector3d half(0.1 + 0.3 * draw(10 * k + 3), 0.1 + 0.3 * draw(10 * k + 4),
                          0.1 + 0.5 * draw(10 * k + 5));
      boxes.push_back({centre - half, centre + half});
      pieces.push_back(box(centre - half, centre + half));
    }
    const Vector3d x(1.2 * draw(90) - 0.6, 1.2 * draw(91) - 0.6, 4.0);
    const double radius = 0.5 + draw(92);
    int n_disk = 0;
    int n_disk_seen = 0;
    int n_square_seen = 0;
    for (int k = 0; k < kGrid * kGrid; ++k) {
      const Vector3d p(radius * ((k % kGrid + 0.5) * 2.0 / kGrid - 1.0),
                       radius * ((k / kGrid + 0.5) * 2.0 / kGrid - 1.0), 0.0);  // NOLINT
      const bool is_seen = std::none_of(boxes.begin(), boxes.end(), [&](const Box& b) {
        return is_hidden_by(b.low, b.high, x, p);
      });
      n_square_seen += is_seen ? 1 : 0;
      n_disk += p.norm() <= radius ? 1 : 0;
      n_disk_seen += is_seen && p.norm() <= radius ? 1 : 0;
    }
    // A straight border of a grid of n x n cells is off by less than a row's 1/n, a few borders
    // by as much together.
    const double tolerance = 1.5 / kGrid;
    const double disk = test::true_disk_visibility(pieces, x, radius);
    EXPECT_NEAR(disk, static_cast<double>(n_disk_seen) / n_disk, tolerance) << i;
    EXPECT_NEAR(test::true_polygon_visibility(pieces, x, square_light(radius)),
                n_square_seen / static_cast<double>(kGrid * kGrid), tolerance)
        << i;
    seen_part += disk / 24.0;
  }
  EXPECT_GT(seen_part, 0.2);  // neither all hidden nor all seen
  EXPECT_LT(seen_part, 0.8);
}

TEST(ConvexTruth, OfPiecesThatOverlapCountsTheOverlapOnce) {
  const Vector3d x(0, 0, 2);
  const ConvexPiece a = level_square({0.5, 0}, 0.5, 1.0);  // its shadow [0, 2] x [-1, 1]
  const ConvexPiece b = level_square({0, 0.5}, 0.5, 1.0);  // [-1, 1] x [0, 2]
  EXPECT_NEAR(test::true_disk_visibility(std::array{a, b}, x, 1.0), 0.25, 1e-14);
  EXPECT_NEAR(test::true_disk_visibility(std::array{a, a, b, b}, x, 1.0), 0.25, 1e-14);
  const ConvexPiece whole = level_square({0, 0}, 9.0, 1.0);
  EXPECT_EQ(test::true_disk_visibility(std::array{a, whole, b}, x, 1.0), 0.0);
}

TEST(ConvexTruth, IsTheSameInAnyUnit) {
  const Vector3d x(0.2, 0.1, 4);
  const double v = disk_visibility_of(box({-0.2, 0, 1}, {1, 0.8, 2}), x, 1.0);
  EXPECT_GT(v, 0.1);
  EXPECT_LT(v, 0.9);
  for (const double unit : {0x1p-30, 0x1p30}) {
    EXPECT_NEAR(disk_visibility_of(box(unit * Vector3d(-0.2, 0, 1), unit * Vector3d(1, 0.8, 2)),
                                   unit * x, unit),
                v, 1e-15);
  }
}

TEST(ConvexTruth, RefusesWhatItCannotTell) {
  const Vector3d x(0, 0, 2);
  const std::vector<ConvexPiece> five(5, level_square({0, 0}, 0.5, 1.0));
  EXPECT_THROW((void)test::true_disk_visibility(five, x, 1.0), ContractViolation);
  EXPECT_THROW((void)test::true_polygon_visibility(five, x, square_light(1.0)),
               ContractViolation);
  EXPECT_THROW((void)test::true_disk_visibility({}, x, 0.0), ContractViolation);
  Polygon2 clockwise = square_light(1.0);
  std::reverse(clockwise.begin(), clockwise.end());
  EXPECT_THROW((void)test::true_polygon_visibility({}, x, clockwise), ContractViolation);
  const ConvexPiece bad{
      {{0, 0, 1}, {1, 0, 1}, {0, std::numeric_limits<double>::quiet_NaN(), 1}}};
  EXPECT_THROW((void)disk_visibility_of(bad, x, 1.0), ContractViolation);
}

}  // namespace
}  // namespace haarlight::render
