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
    // Each of the products is rounded up to five times; one more for the sum of sizes.
    constexpr double kRounding = std::numeric_limits<double>::epsilon() / 2.0;
    return {.value = p.x * (yw - wy) + p.y * (wx - xw) + p_w * (xy - yx),
            .error = 8.0 * kRounding *
                     (std::abs(p.x) * (std::abs(yw) + std::abs(wy)) +
                      std::abs(p.y) * (std::abs(wx) + std::abs(xw)) +
                      std::abs(p_w) * (std::abs(xy) + std::abs(yx)))};
  }

  const VolumeView& view_;
  std::size_t n_exact_ = 0;
};

}  // namespace haarlight::render
