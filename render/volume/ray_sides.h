// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include <Eigen/Core>

#include "render/volume/passed_face.h"
#include "render/volume/side_of_ray.h"
#include "render/volume/volume_view.h"

/// @file
/// On which sides of faces' edges one ray passes: in doubles where these tell, else exactly. The same
/// for all ways to a picture, so that each gives a ray to the same cells.

namespace haarlight::render {

/// Of one ray after the other. For one thread.
class RaySides {
 public:
  explicit RaySides(const VolumeView& view) : view_(view) {}

  /// @param p  (x, y) of side_of_ray.h
  /// @param shift  of the whole ray, across the axis: of meshes with bent cells; what exact arithmetic
  ///               decides is decided without it
  void set_ray(const Eigen::Vector2d& p,
               const Eigen::Vector2d& shift = Eigen::Vector2d::Zero()) {
    p_ = p;
    shift_ = shift;
  }
  [[nodiscard]] const Eigen::Vector2d& shift() const noexcept { return shift_; }
  [[nodiscard]] const Eigen::Vector2d& p() const noexcept { return p_; }
  /// Sides that took exact arithmetic.
  [[nodiscard]] std::uint64_t n_exact() const noexcept { return n_exact_; }

  [[nodiscard]] Corner corner_of(std::uint32_t node) const {
    const FieldPoint& point = view_.points[node];
    const double w = view_.projection == Projection::perspective ? point.seen.z : 1.0;
    Corner corner{.node = node, .point = &point};
    const double px = p_.x() * w + shift_.x();
    const double py = p_.y() * w + shift_.y();
    corner.x = point.seen.x - px;
    corner.y = point.seen.y - py;
    corner.size = std::abs(corner.x) + std::abs(corner.y);
    corner.error = 2.0 * kRounding * (corner.size + std::abs(px) + std::abs(py));
    return corner;
  }

  /// det[p, a, b], of the sign that exact arithmetic gives it; its size may be rounded to 0.
  /// @param is_left  whether it counts as positive
  [[nodiscard]] double side(const Corner& a, const Corner& b, bool& is_left) {
    const double det = a.x * b.y - a.y * b.x;
    const double error = a.error * b.size + b.error * a.size + a.error * b.error +
                         4.0 * kRounding * a.size * b.size;
    if (std::abs(det) > error) {
      is_left = det > 0.0;
      return det;
    }
    ++n_exact_;
    is_left = exact_side(view_.projection, p_, a.point->seen, b.point->seen) > 0;
    return is_left == (det > 0.0) ? det : 0.0;
  }

  /// Whether the ray passes a face of these corners, anticlockwise as it sees it; fills in the sides.
  [[nodiscard]] bool has_all_on_its_left(PassedFace& passed) {
    for (std::size_t i = 0; i < 3; ++i) {
      bool is_left = false;
      passed.sides.at(i) =
          side(passed.corners.at(i), passed.corners.at(i == 2 ? 0 : i + 1), is_left);
      if (!is_left) {
        return false;
      }
    }
    return true;
  }

 private:
  static constexpr double kRounding = std::numeric_limits<double>::epsilon() / 2.0;

  const VolumeView& view_;
  Eigen::Vector2d p_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d shift_ = Eigen::Vector2d::Zero();
  std::uint64_t n_exact_ = 0;
};

}  // namespace haarlight::render
