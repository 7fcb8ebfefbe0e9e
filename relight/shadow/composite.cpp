// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/composite.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// Over a disc of directions, by points of a golden spiral: equal parts of its area.
Eigen::Vector3d mean_radiance(const render::Environment& environment,
                              const Eigen::Vector3d& direction, double radius) {
  if (radius <= 0.0) {
    return environment.radiance(direction);
  }
  constexpr int kPoints = 64;
  const Eigen::Vector3d along = direction.normalized();
  const Eigen::Vector3d u = along.unitOrthogonal();
  const Eigen::Vector3d v = along.cross(u);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < kPoints; ++i) {
    const double away = std::tan(radius * std::sqrt((i + 0.5) / kPoints));
    const double turn = i * std::numbers::pi * (3.0 - std::sqrt(5.0));
    sum += environment.radiance(along + away * (std::cos(turn) * u + std::sin(turn) * v));
  }
  return sum / kPoints;
}

render::Ray camera_ray(const CameraModel& camera, double x, double y) {
  const CameraRay ray = ray_through(camera, x, y);
  return {.origin = ray.origin_world, .direction = ray.direction_world};
}

}  // namespace

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
  std::vector<render::Ray> rays(static_cast<std::size_t>(picture.width()));
  std::vector<render::RawHit> hits(rays.size());
  for (int y = 0; y < picture.height(); ++y) {
    if (options.object) {
      for (int x = 0; x < picture.width(); ++x) {
        rays[static_cast<std::size_t>(x)] = camera_ray(camera, x + 0.5, y + 0.5);
      }
      scene.intersect(rays, render::RayOrder::coherent, hits);
    }
    for (int x = 0; x < picture.width(); ++x) {
      if (shows_object(y, x) == 0) {
        continue;
      }
      if (options.object) {
        const render::Ray& ray = rays[static_cast<std::size_t>(x)];
        const render::RawHit& hit = hits[static_cast<std::size_t>(x)];
        const double eye = frame.height_of(ray.origin);
        const double top = (eye > 0.0 ? 1.0 : -1.0) * options.object->high_mm;
        const double towards = frame.plane.n.dot(ray.direction);
        const double enters =
            std::abs(eye) > std::abs(top) && towards != 0.0 ? (top - eye) / towards : 0.0;
        if (hit.is_hit() && scene.surface_at(ray, hit).distance_mm < enters) {
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

double draw_background(Image<float>& picture, const render::Environment& environment,
                       const render::RayCaster& scene, const CameraModel& camera,
                       const Image<std::uint8_t>& drawn, int n_subpixels, double blur_deg) {
  HAARLIGHT_EXPECTS(picture.width() == camera.width && picture.height() == camera.height &&
                        picture.channels() == 3 && n_subpixels >= 1 && blur_deg >= 0.0 &&
                        blur_deg <= 45.0 &&
                        (drawn.is_empty() ||
                         (drawn.width() == camera.width && drawn.height() == camera.height)),
                    "one camera's pictures");
  const double fraction = 1.0 / (n_subpixels * n_subpixels);
  const double blur = blur_deg * std::numbers::pi / 180.0;
  double seen = 0.0;
  std::vector<render::Ray> rays(static_cast<std::size_t>(picture.width()) *
                                static_cast<std::size_t>(n_subpixels * n_subpixels));
  std::vector<std::uint8_t> blocked(rays.size());
  for (int y = 0; y < picture.height(); ++y) {
    std::size_t i = 0;
    for (int x = 0; x < picture.width(); ++x) {
      for (int s = 0; s < n_subpixels * n_subpixels; ++s) {
        const int column = s % n_subpixels;
        const int row = s / n_subpixels;
        rays[i++] =
            camera_ray(camera, x + (column + 0.5) / n_subpixels, y + (row + 0.5) / n_subpixels);
      }
    }
    scene.are_blocked(rays, render::RayOrder::coherent, blocked);
    i = 0;
    for (int x = 0; x < picture.width(); ++x) {
      for (int s = 0; s < n_subpixels * n_subpixels; ++s, ++i) {
        if (blocked[i] != 0 || (!drawn.is_empty() && drawn(y, x) != 0)) {
          continue;
        }
        seen += fraction;
        const Eigen::Vector3d radiance = mean_radiance(environment, rays[i].direction, blur);
        for (int c = 0; c < 3; ++c) {
          picture(y, x, c) += static_cast<float>(fraction * radiance[c]);
        }
      }
    }
  }
  return seen / (static_cast<double>(picture.width()) * picture.height());
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
