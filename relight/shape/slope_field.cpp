// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/slope_field.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr std::size_t kRowsATask = 16;

Vector3d normal_at(ImageView<const float> normals, int y, int x) {
  return {double{normals(y, x, 0)}, double{normals(y, x, 1)}, double{normals(y, x, 2)}};
}

SlopeField empty_field(ImageView<const float> normals, ImageView<const std::uint8_t> known) {
  const int h = normals.height();
  const int w = normals.width();
  HAARLIGHT_EXPECTS(normals.channels() == 3 && known.height() == h && known.width() == w,
                    "normals and a mask of one size");
  SlopeField field;
  field.step_right = Image<float>(h, w, 1);
  field.step_down = Image<float>(h, w, 1);
  field.slope_right = Image<float>(h, w, 1);
  field.slope_down = Image<float>(h, w, 1);
  field.is_known = Image<std::uint8_t>(h, w, 1);
  return field;
}

/// Calls row(y) for each row, which returns its count; returns the sum.
std::int64_t count_rows(int height, const std::function<std::int64_t(int)>& row) {
  std::vector<std::int64_t> counts(static_cast<std::size_t>(height));
  parallel_for(counts.size(), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      counts[y] = row(static_cast<int>(y));
    }
  });
  std::int64_t sum = 0;
  for (const std::int64_t value : counts) {
    sum += value;
  }
  return sum;
}

}  // namespace

SlopeField orthographic_slopes(ImageView<const float> normals,
                               ImageView<const std::uint8_t> is_known, double mm_per_pixel) {
  HAARLIGHT_EXPECTS(mm_per_pixel > 0.0, "a pixel has a size");
  SlopeField field = empty_field(normals, is_known);
  const int h = field.height();
  const int w = field.width();
  field.n_steep = count_rows(h, [&](int y) {
    std::int64_t n_steep = 0;
    for (int x = 0; x < w; ++x) {
      if (is_known(y, x) == 0) {
        continue;
      }
      field.is_known(y, x) = 1;
      const Vector3d n = normal_at(normals, y, x);
      n_steep += n.z() < kLeastFacing ? 1 : 0;
      const double facing = std::max(n.z(), kLeastFacing);
      field.slope_right(y, x) = static_cast<float>(-n.x() / facing * mm_per_pixel);
      field.slope_down(y, x) = static_cast<float>(n.y() / facing * mm_per_pixel);
    }
    return n_steep;
  });
  parallel_for(static_cast<std::size_t>(h), kRowsATask,
               [&](std::size_t begin, std::size_t end) {
                 for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
                   for (int x = 0; x < w; ++x) {
                     if (field.is_known(y, x) == 0) {
                       continue;
                     }
                     if (x + 1 < w && field.is_known(y, x + 1) != 0) {
                       field.step_right(y, x) =
                           0.5F * (field.slope_right(y, x) + field.slope_right(y, x + 1));
                     }
                     if (y + 1 < h && field.is_known(y + 1, x) != 0) {
                       field.step_down(y, x) =
                           0.5F * (field.slope_down(y, x) + field.slope_down(y + 1, x));
                     }
                   }
                 }
               });
  return field;
}

SlopeField perspective_slopes(ImageView<const float> normals,
                              ImageView<const std::uint8_t> is_known,
                              const CameraModel& camera) {
  SlopeField field = empty_field(normals, is_known);
  const int h = field.height();
  const int w = field.width();
  HAARLIGHT_EXPECTS(camera.width == w && camera.height == h, "the camera's own picture");
  const auto ray = [&](double x, double y) -> Vector3d {
    return ray_through(camera, x, y).direction_world;
  };
  field.n_steep = count_rows(h, [&](int y) {
    std::int64_t n_steep = 0;
    for (int x = 0; x < w; ++x) {
      if (is_known(y, x) == 0) {
        continue;
      }
      field.is_known(y, x) = 1;
      const Vector3d n = normal_at(normals, y, x);
      const Vector3d r = ray(x + 0.5, y + 0.5);
      const double facing = -n.dot(r);
      n_steep += facing < kLeastFacing ? 1 : 0;
      const Vector3d across = ray(x + 1.0, y + 0.5) - ray(x, y + 0.5);
      const Vector3d down = ray(x + 0.5, y + 1.0) - ray(x + 0.5, y);
      const double least = std::max(facing, kLeastFacing);
      field.slope_right(y, x) = static_cast<float>(n.dot(across) / least);
      field.slope_down(y, x) = static_cast<float>(n.dot(down) / least);
    }
    return n_steep;
  });
  // ln D_b - ln D_a on the plane with normal n is ln(n.r_a / n.r_b).
  const auto step = [&](const Vector3d& n, const Vector3d& from, const Vector3d& to) {
    return std::log(std::max(-n.dot(from), kLeastFacing) / std::max(-n.dot(to), kLeastFacing));
  };
  parallel_for(
      static_cast<std::size_t>(h), kRowsATask, [&](std::size_t begin, std::size_t end) {
        for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
          for (int x = 0; x < w; ++x) {
            if (field.is_known(y, x) == 0) {
              continue;
            }
            const Vector3d n = normal_at(normals, y, x);
            const Vector3d here = ray(x + 0.5, y + 0.5);
            if (x + 1 < w && field.is_known(y, x + 1) != 0) {
              const Vector3d there = ray(x + 1.5, y + 0.5);
              field.step_right(y, x) =
                  static_cast<float>(0.5 * (step(n, here, there) +
                                            step(normal_at(normals, y, x + 1), here, there)));
            }
            if (y + 1 < h && field.is_known(y + 1, x) != 0) {
              const Vector3d there = ray(x + 0.5, y + 1.5);
              field.step_down(y, x) =
                  static_cast<float>(0.5 * (step(n, here, there) +
                                            step(normal_at(normals, y + 1, x), here, there)));
            }
          }
        }
      });
  return field;
}

}  // namespace haarlight::relight
