// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/corrected_light.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kRowsATask = 16;

}  // namespace

LightCorrection::LightCorrection(std::vector<NearLight> lights, PixelPoints points, int width,
                                 int height, Eigen::Vector3d plane_normal, FallOff kind)
    : lights_(std::move(lights)),
      points_(std::move(points)),
      width_(width),
      height_(height),
      plane_normal_(std::move(plane_normal)),
      kind_(kind) {
  HAARLIGHT_EXPECTS(width > 0 && height > 0, "a picture");
  std::vector<double> middles;
  for (int k = 0; k < n_lights(); ++k) {
    const double value = lights_[static_cast<std::size_t>(k)].power.mean() *
                         stencil(k, 0.5 * width_, 0.5 * height_);
    if (value > 0.0) {
      middles.push_back(value);
    }
  }
  if (middles.empty()) {
    throw Error("no light shines on the picture's middle", "the lights' positions",
                "check the positions' unit (mm) and frame: z to the camera, the target at 0");
  }
  common_ = upper_median(middles);
}

double LightCorrection::stencil(int light, double x, double y) const {
  const NearLight& source = lights_[static_cast<std::size_t>(light)];
  const Eigen::Vector3d point = points_.at(x, y);
  if (kind_ == FallOff::plane) {
    return light_stencil(source, point, plane_normal_);
  }
  // A surface that faces the light has the stencil cos^mu / r^2.
  const Eigen::Vector3d way = source.position_mm - point;
  const double r = way.norm();
  return r > 0.0 ? light_stencil(source, point, way / r) : 0.0;
}

Image<float> LightCorrection::attenuation(int light) const {
  Image<float> map(height_, width_, 1);
  double reference = stencil(light, 0.5 * width_, 0.5 * height_);
  if (!(reference > 0.0)) {
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        reference = std::max(reference, stencil(light, x + 0.5, y + 0.5));
      }
    }
  }
  if (!(reference > 0.0)) {
    return map;
  }
  parallel_for(
      static_cast<std::size_t>(height_), kRowsATask, [&](std::size_t begin, std::size_t end) {
        for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
          for (int x = 0; x < width_; ++x) {
            map(y, x) = static_cast<float>(stencil(light, x + 0.5, y + 0.5) / reference);
          }
        }
      });
  return map;
}

Image<float> LightCorrection::corrected(ImageView<const float> picture, int light) const {
  HAARLIGHT_EXPECTS(picture.height() == height_ && picture.width() == width_, "its picture");
  Image<float> out(height_, width_, picture.channels());
  const NearLight& source = lights_[static_cast<std::size_t>(light)];
  const Eigen::Vector3d power = picture.channels() == 3
                                    ? source.power
                                    : Eigen::Vector3d::Constant(source.power.mean()).eval();
  parallel_for(
      static_cast<std::size_t>(height_), kRowsATask, [&](std::size_t begin, std::size_t end) {
        for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
          for (int x = 0; x < width_; ++x) {
            const double f = stencil(light, x + 0.5, y + 0.5);
            for (int c = 0; c < picture.channels(); ++c) {
              const double whole = f * power[c % 3];
              out(y, x, c) =
                  whole > 0.0 ? static_cast<float>(double{picture(y, x, c)} * common_ / whole)
                              : 0.0F;
            }
          }
        }
      });
  return out;
}

}  // namespace haarlight::relight
