// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/composite.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "haarlight/core/error.h"

namespace haarlight::relight {

double scene_scale(double plate_scale, int channels, double albedo, double area_mm2) {
  HAARLIGHT_EXPECTS(plate_scale > 0.0 && channels > 0, "a capture that the clean plate fits");
  // RigPlate gives irradiance per square millimetre of the first light, times 1e6.
  return channels * albedo * area_mm2 / (std::numbers::pi * 1e6 * plate_scale);
}

CompositeCount draw_object(Image<float>& picture, const Image<float>& object,
                           const Image<std::uint8_t>& shows_object,
                           const render::RayCaster& scene, const CameraModel& camera,
                           const PlaneFrame& frame, const CompositeOptions& options) {
  HAARLIGHT_EXPECTS(picture.width() == object.width() && picture.height() == object.height() &&
                        shows_object.width() == object.width() &&
                        shows_object.height() == object.height() &&
                        camera.width == object.width() && camera.height == object.height(),
                    "one camera's pictures");
  CompositeCount count;
  count.drawn = Image<std::uint8_t>(picture.height(), picture.width(), 1);
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      if (shows_object(y, x) == 0) {
        continue;
      }
      if (options.object) {
        const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
        const double eye = frame.height_of(ray.origin_world);
        const double top = (eye > 0.0 ? 1.0 : -1.0) * options.object->high_mm;
        const double towards = frame.plane.n.dot(ray.direction_world);
        const double enters =
            std::abs(eye) > std::abs(top) && towards != 0.0 ? (top - eye) / towards : 0.0;
        const std::optional<render::Hit> hit =
            scene.intersect(ray.origin_world, ray.direction_world);
        if (hit && hit->distance_mm < enters) {
          ++count.n_hidden;
          continue;
        }
      }
      ++count.n_object;
      count.drawn(y, x) = 1;
      for (int c = 0; c < 3; ++c) {
        picture(y, x, c) = static_cast<float>(options.scale) *
                           object(y, x, std::min(c, object.channels() - 1));
      }
    }
  }
  return count;
}

Achieved compare_drawn(const Image<float>& picture, const Image<float>& truth,
                       const Image<std::uint8_t>& drawn) {
  HAARLIGHT_EXPECTS(picture.width() == drawn.width() && picture.height() == drawn.height() &&
                        truth.width() == drawn.width() && truth.height() == drawn.height() &&
                        picture.channels() == 3 && truth.channels() == 3,
                    "pictures of one size");
  std::vector<float> found;
  std::vector<float> expected;
  for (int y = 0; y < drawn.height(); ++y) {
    for (int x = 0; x < drawn.width(); ++x) {
      for (int c = 0; drawn(y, x) != 0 && c < 3; ++c) {
        found.push_back(picture(y, x, c));
        expected.push_back(truth(y, x, c));
      }
    }
  }
  return compare(found, expected);
}

}  // namespace haarlight::relight
