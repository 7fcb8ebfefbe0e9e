// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/circle_polygon.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/soft_shadow/circular_segment.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Polygon = std::vector<Vector2d>;

constexpr double kPi = std::numbers::pi;

/// Some roundings of pi for each of up to a hundred vertices.
constexpr double kRounding = 1e-14;

Polygon rectangle(double x0, double x1, double y0, double y1) {
  return {{x0, y0}, {x1, y0}, {x1, y1}, {x0, y1}};
}

Polygon regular(int n, double circumradius, double turn = 0.1) {
  Polygon polygon;
  for (int i = 0; i < n; ++i) {
    const double angle = turn + 2.0 * kPi * i / n;
    polygon.emplace_back(circumradius * std::cos(angle), circumradius * std::sin(angle));
  }
  return polygon;
}

TEST(CirclePolygon, OfARegularPolygonIsTheClosedForm) {
  for (const int n : {3, 4, 5, 6, 17, 100}) {
    const double slope = std::cos(kPi / n);
    const double sector = kPi / n;
    for (const double r : {0.3, 1.0 - 1e-9, 1.0, 1.02, 1.3, 1.99, 2.1, 50.0}) {
      double truth = 0.5 * n * r * r * std::sin(2.0 * sector);  // all of the polygon
      if (r * slope >= 1.0) {
        truth = kPi;  // all of the circle
      } else if (r > 1.0) {
        truth = kPi - n * kPi * segment_fraction_beyond(r * slope);
      }
      EXPECT_NEAR(unit_disk_intersection(regular(n, r)), truth, n * kRounding) << n << " " << r;
    }
  }
}

TEST(CirclePolygon, OfAHalfPlaneIsTheSegment) {
  for (const double s : {-1.0, -0.999999, -0.5, 0.0, 0.3, 0.9999, 1.0}) {
    EXPECT_NEAR(unit_disk_intersection(rectangle(s, 5.0, -3.0, 2.0)),
                kPi * segment_fraction_beyond(s), kRounding)
        << s;
    EXPECT_NEAR(unit_disk_intersection(rectangle(s, 1e12, -3e12, 2e12)),
                kPi * segment_fraction_beyond(s), 1e-12)
        << s;
  }
}

TEST(CirclePolygon, OfALineBetweenFarVerticesIsNotMoved) {
  // x + y >= 1, its ends 2^40 away, exactly: a plain product of theirs is off by 2^28 of 2^41.
  const double far = 0x1p40;
  EXPECT_NEAR(
      unit_disk_intersection(Polygon{{-far, far + 1}, {far + 1, -far}, {2 * far, 2 * far}}),
      kPi * segment_fraction_beyond(std::sqrt(0.5)), kRounding);
}

TEST(CirclePolygon, OfAQuadrantAndAWedgeIsTheirAngle) {
  EXPECT_NEAR(unit_disk_intersection(rectangle(0.0, 2.0, 0.0, 2.0)), kPi / 4.0, kRounding);
  EXPECT_NEAR(
      unit_disk_intersection(Polygon{{0, 0}, {3, 0}, {3 * std::cos(0.2), 3 * std::sin(0.2)}}),
      0.1, kRounding);
  // The centre on an edge, and a concave polygon round it.
  EXPECT_NEAR(unit_disk_intersection(rectangle(-2.0, 2.0, 0.0, 2.0)), kPi / 2.0, kRounding);
  EXPECT_NEAR(
      unit_disk_intersection(Polygon{{0, 0}, {0, -2}, {2, -2}, {2, 2}, {-2, 2}, {-2, 0}}),
      0.75 * kPi, kRounding);
}

TEST(CirclePolygon, TouchesWithoutHarm) {
  EXPECT_EQ(unit_disk_intersection(rectangle(1.0, 2.0, -1.0, 1.0)), 0.0);  // an edge
  EXPECT_NEAR(unit_disk_intersection(Polygon{{1, 0}, {2, -1}, {2, 1}}), 0.0, kRounding);
  EXPECT_EQ(unit_disk_intersection(rectangle(-1.0, 1.0, -1.0, 1.0)), kPi);  // from outside
  EXPECT_NEAR(unit_disk_intersection(Polygon{{1, 0}, {0, 1}, {-1, 0}, {0, -1}}), 2.0,
              kRounding);
  // A vertex on the circle between two edges that cross it.
  EXPECT_NEAR(unit_disk_intersection(Polygon{{0, 0}, {1, 0}, {2, 2}, {0, 2}}), kPi / 4.0,
              kRounding);
  // Vertices repeated, and one in the middle of an edge.
  EXPECT_NEAR(
      unit_disk_intersection(Polygon{{0, 0}, {0, 0}, {1, 0}, {2, 0}, {2, 0}, {2, 2}, {0, 2}}),
      kPi / 4.0, kRounding);
}

TEST(CirclePolygon, WithoutACrossingIsExact) {
  EXPECT_EQ(unit_disk_intersection(rectangle(1.5, 3.0, -9.0, 7.0)), 0.0);
  EXPECT_EQ(unit_disk_intersection(Polygon{{-7, -5}, {9, -3.3}, {1.1, 8.7}}), kPi);
  EXPECT_EQ(unit_disk_intersection(Polygon{{1.1, 8.7}, {9, -3.3}, {-7, -5}}), kPi);
  // Round the circle but not over it: a concave polygon.
  EXPECT_EQ(unit_disk_intersection(Polygon{
                {-3, -3}, {3, -3}, {3, 3}, {2, 3}, {2, -2}, {-2, -2}, {-2, 3}, {-3, 3}}),
            0.0);
  EXPECT_EQ(unit_disk_intersection(Polygon{}), 0.0);
  EXPECT_EQ(unit_disk_intersection(Polygon{{0, 0}, {0.5, 0}}), 0.0);
}

/// Length of the part of a horizontal line that is in both, y-values not those of vertices.
double common_length(const Polygon& polygon, double y) {
  std::vector<double> crossings;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector2d& a = polygon[i];
    const Vector2d& b = polygon[(i + 1) % polygon.size()];
    if ((a.y() > y) != (b.y() > y)) {
      crossings.push_back(a.x() + (b.x() - a.x()) * (y - a.y()) / (b.y() - a.y()));
    }
  }
  std::sort(crossings.begin(), crossings.end());
  const double half = std::sqrt(1.0 - y * y);
  double length = 0.0;
  for (std::size_t i = 0; i + 1 < crossings.size(); i += 2) {
    length += std::max(0.0, std::min(half, crossings[i + 1]) - std::max(-half, crossings[i]));
  }
  return length;
}

TEST(CirclePolygon, OfRandomPolygonsIsTheIntegralOfTheirWidth) {
  constexpr int kSteps = 200'000;
  double largest = 0.0;
  for (std::uint64_t i = 0; i < 60; ++i) {
    const auto draw = [i](std::uint64_t what) { return uniform_unit(hash_key(23, i, what)); };
    Polygon polygon;  // a star about a point, of either orientation
    const Vector2d centre(3.0 * draw(0) - 1.5, 3.0 * draw(1) - 1.5);
    const int n = 3 + static_cast<int>(7.0 * draw(2));
    for (int k = 0; k < n; ++k) {
      const double angle = (i % 2 == 0 ? 2.0 : -2.0) * kPi * k / n;
      const double r = 0.2 + 2.0 * draw(10 + static_cast<std::uint64_t>(k));
      polygon.emplace_back(centre + r * Vector2d(std::cos(angle), std::sin(angle)));
    }
    double truth = 0.0;
    for (int k = 0; k < kSteps; ++k) {  // y = -cos a: smooth at the circle's ends
      const double a = kPi * (k + 0.5) / kSteps;
      truth += common_length(polygon, -std::cos(a)) * std::sin(a) * kPi / kSteps;
    }
    const double error = std::abs(unit_disk_intersection(polygon) - truth);
    largest = std::max(largest, error);
  }
  // The midpoint rule's error at a bend of the width is its slope (up to 100 for flat edges) times
  // the step's square, (pi/kSteps)^2 = 2.5e-10; some bends each.
  EXPECT_LT(largest, 1e-7);
}

TEST(CirclePolygon, TurnedMirroredAndReversedIsTheSame) {
  const Polygon polygon{{-0.2, -1.7}, {1.4, -0.6}, {0.3, 0.1}, {0.8, 1.2}, {-0.9, 0.4}};
  const double area = unit_disk_intersection(polygon);
  EXPECT_GT(area, 0.5);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Rotation2Dd turn(0.0628 * i);
    Polygon turned;
    Polygon mirrored;
    for (const Vector2d& p : polygon) {
      turned.push_back(turn * p);
      mirrored.emplace_back(turned.back().x(), -turned.back().y());
    }
    EXPECT_NEAR(unit_disk_intersection(turned), area, kRounding) << i;
    EXPECT_NEAR(unit_disk_intersection(mirrored), area, kRounding) << i;
    std::reverse(turned.begin(), turned.end());
    EXPECT_NEAR(unit_disk_intersection(turned), area, kRounding) << i;
  }
}

TEST(CirclePolygon, OfBothPartsOfACutIsThatOfTheWhole) {
  const Polygon whole{{-0.5, -1.5}, {2.0, -0.3}, {0.6, 1.9}, {-1.1, 0.2}};
  const Polygon low{whole[0], whole[1], whole[2]};
  const Polygon high{whole[2], whole[3], whole[0]};
  EXPECT_NEAR(unit_disk_intersection(low) + unit_disk_intersection(high),
              unit_disk_intersection(whole), kRounding);
}

TEST(CirclePolygon, OfASmallPolygonIsItsAreaByTheSquareOfItsScale) {
  const Polygon polygon{{-0.2, -0.7}, {0.4, -0.6}, {0.3, 0.1}};
  const double area = unit_disk_intersection(polygon);
  Polygon small = polygon;
  for (Vector2d& p : small) {
    p *= 0x1p-30;
  }
  EXPECT_EQ(unit_disk_intersection(small), 0x1p-60 * area);
}

TEST(CirclePolygon, RefusesWhatIsNotFinite) {
  for (const double bad :
       {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_THROW((void)unit_disk_intersection(Polygon{{0, 0}, {1, 0}, {bad, 1}}),
                 ContractViolation);
  }
}

}  // namespace
}  // namespace haarlight::render
