// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "render/volume/side_of_ray.h"
#include "render/volume/volume_view.h"

/// @file
/// How three points of a mesh lie on the picture.

namespace haarlight::render {

/// Signs of det[a, b, c] (side_of_ray.h): in doubles where these tell, else exact. For one thread.
class Orientation {
 public:
  explicit Orientation(const VolumeView& view) : view_(view) {}

  /// 0: in one line of the picture.
  [[nodiscard]] int sign(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (a == b || b == c || c == a) {
      return 0;
    }
    const Determinant det = determinant(a, b, c);
    if (std::abs(det.value) > det.error) {
      return det.value > 0.0 ? 1 : -1;
    }
    ++n_exact_;
    return exact_orientation(view_.projection, view_.points[a].seen, view_.points[b].seen,
                             view_.points[c].seen);
  }

  /// To rounding.
  [[nodiscard]] double value(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    return determinant(a, b, c).value;
  }

  /// The sign of (b - a) x (c - a) . (d - a); 0: in one plane.
  [[nodiscard]] int side_of_plane(std::uint32_t a, std::uint32_t b, std::uint32_t c,
                                  std::uint32_t d) {
    if (d == a || d == b || d == c) {
      return 0;
    }
    const Determinant det = volume(a, b, c, d);
    if (std::abs(det.value) > det.error) {
      return det.value > 0.0 ? 1 : -1;
    }
    ++n_exact_;
    return exact_side_of_plane(view_.points[a].seen, view_.points[b].seen, view_.points[c].seen,
                               view_.points[d].seen);
  }

  [[nodiscard]] std::size_t n_exact() const noexcept { return n_exact_; }

 private:
  struct Determinant {
    double value = 0.0;
    double error = 0.0;
  };

  [[nodiscard]] Determinant determinant(std::uint32_t a, std::uint32_t b,
                                        std::uint32_t c) const {
    const SeenPoint& p = view_.points[a].seen;
    const SeenPoint& q = view_.points[b].seen;
    const SeenPoint& r = view_.points[c].seen;
    const bool is_perspective = view_.projection == Projection::perspective;
    const double p_w = is_perspective ? p.z : 1.0;
    const double q_w = is_perspective ? q.z : 1.0;
    const double r_w = is_perspective ? r.z : 1.0;
    const double yw = q.y * r_w;
    const double wy = q_w * r.y;
    const double wx = q_w * r.x;
    const double xw = q.x * r_w;
    const double xy = q.x * r.y;
    const double yx = q.y * r.x;
    return {.value = p.x * (yw - wy) + p.y * (wx - xw) + p_w * (xy - yx),
            .error = kBound * (std::abs(p.x) * (std::abs(yw) + std::abs(wy)) +
                               std::abs(p.y) * (std::abs(wx) + std::abs(xw)) +
                               std::abs(p_w) * (std::abs(xy) + std::abs(yx)))};
  }

  [[nodiscard]] Determinant volume(std::uint32_t a, std::uint32_t b, std::uint32_t c,
                                   std::uint32_t d) const {
    const SeenPoint& p = view_.points[a].seen;
    const auto from_a = [&p](const SeenPoint& to) {
      return std::array{to.x - p.x, to.y - p.y, to.z - p.z};
    };
    const std::array<double, 3> u = from_a(view_.points[b].seen);
    const std::array<double, 3> v = from_a(view_.points[c].seen);
    const std::array<double, 3> w = from_a(view_.points[d].seen);
    Determinant det;
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t j = i == 2 ? 0 : i + 1;
      const std::size_t k = 3 - i - j;
      const double one = u.at(j) * v.at(k);
      const double other = u.at(k) * v.at(j);
      det.value += (one - other) * w.at(i);
      det.error += (std::abs(one) + std::abs(other)) * std::abs(w.at(i));
    }
    det.error *= kBound;
    return det;
  }

  /// Each of the products is rounded up to five times, differences and sums of them once more each.
  static constexpr double kBound = 8.0 * std::numeric_limits<double>::epsilon() / 2.0;

  const VolumeView& view_;
  std::size_t n_exact_ = 0;
};

}  // namespace haarlight::render
