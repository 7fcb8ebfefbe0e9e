// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/light_outline.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Polygon = std::vector<Vector2d>;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// A square about the origin whose corners are on the unit circle, turned.
Polygon square(double angle) {
  Polygon corners;
  for (int i = 0; i < 4; ++i) {
    const double a = angle + 0.5 * std::numbers::pi * i;
    corners.emplace_back(std::cos(a), std::sin(a));
  }
  return corners;
}

std::vector<OutlineSegment> outline_of(const std::vector<Polygon>& polygons) {
  std::vector<OutlineSegment> segments;
  for (const Polygon& polygon : polygons) {
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      segments.push_back(
          {.from = polygon[i], .to = polygon[(i + 1) % polygon.size()], .jump = 1});
    }
  }
  return segments;
}

/// How often the polygons go around a point: independent of lines and slabs.
int winding(const std::vector<Polygon>& polygons, const Vector2d& point) {
  int turns = 0;
  for (const Polygon& polygon : polygons) {
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Vector2d& a = polygon[i];
      const Vector2d& b = polygon[(i + 1) % polygon.size()];
      const bool is_above = b.y() > point.y();
      if ((a.y() > point.y()) != is_above) {
        const bool is_left = cross(b - a, point - a) > 0.0;
        turns += is_above && is_left ? 1 : !is_above && !is_left ? -1 : 0;
      }
    }
  }
  return turns;
}

bool is_inside(const Polygon& light, const Vector2d& point) {
  if (light.empty()) {
    return point.squaredNorm() < 1.0;
  }
  for (std::size_t i = 0; i < light.size(); ++i) {
    if (cross(light[(i + 1) % light.size()] - light[i], point - light[i]) < 0.0) {
      return false;
    }
  }
  return true;
}

/// Fraction of the light with the fewest layers, by counting on a grid; and that number.
std::pair<double, int> counted(const Polygon& light, const std::vector<Polygon>& polygons) {
  constexpr int kGrid = 120;
  int n = 0;
  int n_least = 0;
  int least = 1 << 20;
  for (int i = 0; i < kGrid; ++i) {
    for (int j = 0; j < kGrid; ++j) {
      const Vector2d point(2.0 * (i + 0.5) / kGrid - 1.0, 2.0 * (j + 0.5) / kGrid - 1.0);
      if (!is_inside(light, point)) {
        continue;
      }
      const int layers = winding(polygons, point);
      if (layers < least) {
        least = layers;
        n_least = 0;
      }
      ++n;
      n_least += layers == least ? 1 : 0;
    }
  }
  return {static_cast<double>(n_least) / n, least};
}

LeastCovered least_of(const Polygon& light, const std::vector<OutlineSegment>& segments) {
  LightOutline::Scratch scratch;
  const auto least = LightOutline(light).least_covered(segments, 1e-9, scratch);
  EXPECT_TRUE(least.has_value());
  return least.value_or(LeastCovered{});
}

TEST(LightOutline, NothingInTheWayLeavesItWhole) {
  EXPECT_EQ(least_of({}, {}).fraction, 1.0);
  const auto far = outline_of({{{2.0, 0.0}, {3.0, 0.0}, {3.0, 1.0}}});
  EXPECT_EQ(least_of({}, far).n_segments, 0);
  EXPECT_EQ(least_of(square(0.3), far).fraction, 1.0);
}

TEST(LightOutline, OneLineAcrossADiskIsASegmentInClosedForm) {
  for (const double s : {-0.999, -0.5, 0.0, 0.3, 0.9999}) {
    // Layers to the right of a line upwards at x = s: what is left of it is seen.
    const std::vector<OutlineSegment> line = {{.from = {s, -5.0}, .to = {s, 7.0}, .jump = -1}};
    const LeastCovered least = least_of({}, line);
    const double exact = 1.0 - (std::acos(s) - s * std::sqrt(1.0 - s * s)) / std::numbers::pi;
    EXPECT_NEAR(least.fraction, exact, 1e-14);
    EXPECT_TRUE(least.is_chord);
    EXPECT_LT(least.point.x(), s);
    // The general way, taken because of two lines that hide nothing, gives the same.
    std::vector<OutlineSegment> two = line;
    two.push_back({.from = {5.0, 0.0}, .to = {s, 0.0}, .jump = 1});
    two.push_back({.from = {s, 0.0}, .to = {5.0, 0.0}, .jump = 1});
    const LeastCovered same = least_of({}, two);
    EXPECT_NEAR(same.fraction, exact, 1e-14);
    EXPECT_FALSE(same.is_chord);
  }
}

TEST(LightOutline, ASquareLightCutParallelAndAcross) {
  const double half = std::sqrt(0.5);
  const std::vector<OutlineSegment> line = {
      {.from = {0.25 * half, -9.0}, .to = {0.25 * half, 9.0}, .jump = -1}};
  EXPECT_NEAR(least_of(square(0.25 * std::numbers::pi), line).fraction, 0.625, 1e-15);
  const std::vector<OutlineSegment> corner = {
      {.from = {half, -9.0}, .to = {half, 9.0}, .jump = -1}};
  const double left =
      1.0 - 0.5 * (1.0 - half) * (1.0 - half);  // the tip of a square on its corner
  EXPECT_NEAR(least_of(square(0.0), corner).fraction, left, 1e-15);
}

/// Random polygons, also such that cross themselves and each other and share corners.
TEST(LightOutline, CountsTheLayersThatAGridOfPointsCounts) {
  int n_deep = 0;
  int n_compared = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    std::uint64_t i = 0;
    const auto random = [&] { return uniform_unit(hash_key(seed, i++)); };
    std::vector<Polygon> polygons;
    const int n = 1 + static_cast<int>(4.0 * random());
    const double size = 0.3 + 2.5 * random();
    for (int p = 0; p < n; ++p) {
      Polygon polygon;
      const Vector2d middle(2.4 * random() - 1.2, 2.4 * random() - 1.2);
      const int corners = 3 + static_cast<int>(5.0 * random());
      for (int c = 0; c < corners; ++c) {
        polygon.emplace_back(middle + size * Vector2d(random() - 0.5, random() - 0.5));
      }
      polygons.push_back(polygon);
      if (random() < 0.3) {  // a neighbour with a side in common
        polygons.push_back({polygon[1], polygon[0], middle + Vector2d(random(), random())});
      }
    }
    for (const Polygon& light : {Polygon{}, square(0.2 + random())}) {
      const LeastCovered least = least_of(light, outline_of(polygons));
      const auto [fraction, layers] = counted(light, polygons);
      const int own = winding(polygons, least.point);
      if (own < layers) {  // cells that the grid's points miss
        EXPECT_LT(least.fraction, 0.01) << "seed " << seed;
      } else {
        EXPECT_EQ(own, layers) << "seed " << seed;
        EXPECT_NEAR(least.fraction, fraction, 0.01) << "seed " << seed;
        ++n_compared;
      }
      EXPECT_TRUE(is_inside(light, least.point));
      // Nothing is nearer to the point than it says.
      for (const OutlineSegment& segment : outline_of(polygons)) {
        const Vector2d way = segment.to - segment.from;
        const double s =
            std::clamp((least.point - segment.from).dot(way) / way.squaredNorm(), 0.0, 1.0);
        EXPECT_GE((segment.from + s * way - least.point).norm(), least.clearance * (1 - 1e-9));
      }
      n_deep += least.n_segments > 3 ? 1 : 0;
    }
  }
  EXPECT_GT(n_deep, 40);
  EXPECT_GT(n_compared, 72);
}

TEST(LightOutline, DoesNotDependOnWhereEdgesAreCutOrTheirOrder) {
  std::vector<OutlineSegment> whole = outline_of(
      {{{-0.7, -0.6}, {0.8, -0.3}, {0.1, 0.9}}, {{-0.2, -0.2}, {2.0, 0.1}, {0.3, 2.0}}});
  std::vector<OutlineSegment> cut;
  for (const OutlineSegment& segment : whole) {
    constexpr int kPieces = 17;
    Vector2d last = segment.from;
    for (int i = 1; i <= kPieces; ++i) {
      const Vector2d next = i == kPieces ? segment.to
                                         : segment.from + (static_cast<double>(i) / kPieces) *
                                                              (segment.to - segment.from);
      cut.push_back({.from = last, .to = next, .jump = 1});
      last = next;
    }
  }
  std::ranges::reverse(cut);
  EXPECT_NEAR(least_of({}, whole).fraction, least_of({}, cut).fraction, 1e-13);
  EXPECT_NEAR(least_of(square(1.0), whole).fraction, least_of(square(1.0), cut).fraction,
              1e-13);
}

}  // namespace
}  // namespace haarlight::render
