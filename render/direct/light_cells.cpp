// SPDX-License-Identifier: Apache-2.0
#include "render/direct/light_cells.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

}  // namespace

LightCells::LightCells(const LightGrid& grid, const SquareLight& first)
    : grid_(grid), first_(first.centre), u_(first.u), v_(first.v), emits_(first.emits) {
  const Vector2d side(first.width_mm, first.height_mm);
  step_ = {grid.cols > 1 ? grid.step_u.dot(u_) : side.x(),
           grid.rows > 1 ? grid.step_v.dot(v_) : side.y()};
  side_ = side.cwiseQuotient(step_);
}

Vector2d LightCells::low() const { return -kHalfCell * step_; }

Vector2d LightCells::high() const {
  return Vector2d(grid_.cols - 1 + kHalfCell, grid_.rows - 1 + kHalfCell).cwiseProduct(step_);
}

Pyramid LightCells::pyramid(const Vector3d& apex) const {
  Pyramid pyramid;
  pyramid.apex = apex;
  pyramid.towards = -emits_;
  pyramid.height = height(apex);
  // A point q from the apex is seen at (h, x) = (towards.q, height u.q / h + u.(apex - first)).
  const Vector3d from_first = apex - first_;
  const auto side = [&](const Vector3d& along, double border) -> Vector3d {
    return pyramid.height * along + (along.dot(from_first) - border) * pyramid.towards;
  };
  pyramid.sides[0] = side(u_, low().x());
  pyramid.sides[1] = -side(u_, high().x());
  pyramid.sides[2] = side(v_, low().y());
  pyramid.sides[3] = -side(v_, high().y());
  const Vector2d middle = 0.5 * (low() + high());
  pyramid.axis = (first_ + middle.x() * u_ + middle.y() * v_ - apex).normalized();
  pyramid.cosine = 1.0;
  for (const double x : {low().x(), high().x()}) {
    for (const double y : {low().y(), high().y()}) {
      const Vector3d corner = first_ + x * u_ + y * v_ - apex;
      pyramid.cosine = std::min(pyramid.cosine, pyramid.axis.dot(corner) / corner.norm());
    }
  }
  pyramid.cosine -= 1e-9;  // rounding
  pyramid.sine = std::sqrt(std::max(0.0, 1.0 - pyramid.cosine * pyramid.cosine));
  return pyramid;
}

std::optional<FlatSegment> LightCells::project(const Pyramid& pyramid, const Vector3d& a,
                                               const Vector3d& b) const {
  const Vector3d from = a - pyramid.apex;
  const Vector3d to = b - pyramid.apex;
  double begin = 0.0;
  double end = 1.0;
  const auto clip = [&](double at_from, double at_to) {  // to where the two values are >= 0
    if (at_from < 0.0 && at_to < 0.0) {
      end = -1.0;
    } else if (at_from < 0.0) {
      begin = std::max(begin, at_from / (at_from - at_to));
    } else if (at_to < 0.0) {
      end = std::min(end, at_from / (at_from - at_to));
    }
  };
  const double h_from = pyramid.towards.dot(from);
  const double h_to = pyramid.towards.dot(to);
  const double nearest = 1e-9 * pyramid.height;
  clip(h_from - nearest, h_to - nearest);
  clip(pyramid.height - h_from, pyramid.height - h_to);
  for (const Vector3d& side : pyramid.sides) {
    clip(side.dot(from), side.dot(to));
    if (begin > end) {
      return std::nullopt;
    }
  }
  if (begin > end) {
    return std::nullopt;
  }
  const auto seen_at = [&](double t) -> Vector2d {
    const Vector3d q = from + t * (to - from);
    const double scale = pyramid.height / pyramid.towards.dot(q);
    const Vector3d on_plane = pyramid.apex + scale * q - first_;
    return Vector2d(u_.dot(on_plane), v_.dot(on_plane)).cwiseQuotient(step_);
  };
  return FlatSegment{seen_at(begin), seen_at(end)};
}

void LightCells::mark_strata(const FlatSegment& segment, int cell, int n,
                             std::span<std::uint8_t> marks) const {
  const Vector2d centre(cell % grid_.cols,
                        cell / grid_.cols);  // NOLINT(bugprone-integer-division)
  const auto in_strata = [&](const Vector2d& p) -> Vector2d {
    return (n * (p - centre).cwiseQuotient(side_)).array() + 0.5 * (n - 1);
  };
  for_each_crossed(in_strata(segment.a), in_strata(segment.b),
                   Vector2d::Constant(0.5 + n * kCellMargin), n, n,
                   [&](int row, int col) { marks[to_index(row * n + col)] = 1; });
}

void LightCells::mark_crossing(const SilhouetteEdges& edges, double reach,
                               std::span<std::uint8_t> marks) const {
  // A plate in the lights' own plane hides nothing: it has no point in front of it.
  const double plane = emits_.dot(first_);
  const double front = 0.01 * reach;
  const std::vector<Vector3d> corners =
      edges.triangles_at(emits_, plane + front, plane + reach);
  for (std::size_t i = 0; i < corners.size(); i += 3) {
    // The box of the triangle's part within the slab: corners inside, crossings of its sides.
    Eigen::AlignedBox2d box;
    for (std::size_t c = 0; c < 3; ++c) {
      const Vector3d& a = corners[i + c];
      const Vector3d& b = corners[i + (c + 1) % 3];
      const double h_a = height(a);
      const double h_b = height(b);
      const auto add = [&](double t) {
        const Vector3d p = a + std::clamp(t, 0.0, 1.0) * (b - a) - first_;
        box.extend(Vector2d(u_.dot(p), v_.dot(p)).cwiseQuotient(step_));
      };
      if (std::max(h_a, h_b) < front || std::min(h_a, h_b) > reach) {
        continue;
      }
      const double rise = h_b - h_a;
      const bool is_level = std::abs(rise) < 1e-3 * front;
      add(is_level ? 0.0 : (std::clamp(h_a, front, reach) - h_a) / rise);
      add(is_level ? 1.0 : (std::clamp(h_b, front, reach) - h_a) / rise);
    }
    if (box.isEmpty()) {
      continue;
    }
    const auto first_of = [](double x, int n) {
      return static_cast<int>(std::clamp(std::ceil(x - kHalfCell), 0.0, double(n)));
    };
    const auto last_of = [](double x, int n) {
      return static_cast<int>(std::clamp(std::floor(x + kHalfCell), -1.0, double(n - 1)));
    };
    for (int row = first_of(box.min().y(), grid_.rows);
         row <= last_of(box.max().y(), grid_.rows); ++row) {
      for (int col = first_of(box.min().x(), grid_.cols);
           col <= last_of(box.max().x(), grid_.cols); ++col) {
        marks[to_index(row * grid_.cols + col)] = kCellCrossed | kLightCrossed | kAnywhere;
      }
    }
  }
}

}  // namespace haarlight::render
