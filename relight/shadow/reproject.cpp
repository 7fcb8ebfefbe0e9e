// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/reproject.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "core/parallel.h"
#include "haarlight/render/direct/picture.h"

namespace haarlight::relight {
namespace {

constexpr std::size_t kGrain = 256;      // receivers per task
constexpr double kOnPlaneTexels = 0.01;  // closer than this to the plane counts as on it
constexpr double kAffected = 0.01;  // fraction of a receiver's light that counts as affected

void fill_report(std::span<const Receiver> receivers, std::span<const PointTotal> totals,
                 const SamplingPlane& plane, double sign, ReprojectReport& report) {
  double light = 0.0;
  double n_affected = 0.0;
  double n_under = 0.0;
  double n_over = 0.0;
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    const PointTotal& total = totals[i];
    light += total.light;
    report.on_fraction += total.on;
    report.above_fraction += total.above;
    report.below_fraction += total.below;
    report.no_point_fraction += total.no_point;
    report.unknown_fraction += total.unknown;
    report.outside_fraction += total.outside;
    report.occluder_fraction += total.from_occluder;
    report.worst_widening = std::max(report.worst_widening, total.widening);
    n_affected += total.unknown > kAffected * total.light ? 1.0 : 0.0;
    if (plane.object) {
      const double over = sign * plane.frame.height_of(receivers[i].surface.point);
      const bool is_off = over > kOnPlaneTexels * plane.frame.texel_mm;
      n_under += is_off && over > plane.object->low_mm && over < plane.object->high_mm ? 1 : 0;
      n_over += over >= plane.object->high_mm ? 1.0 : 0.0;
    }
  }
  report.n_receivers = static_cast<std::int64_t>(receivers.size());
  if (light > 0.0) {
    for (double* fraction :
         {&report.on_fraction, &report.above_fraction, &report.below_fraction,
          &report.no_point_fraction, &report.unknown_fraction, &report.outside_fraction,
          &report.occluder_fraction}) {
      *fraction /= light;
    }
  }
  if (!receivers.empty()) {
    const auto n = static_cast<double>(receivers.size());
    report.affected_receivers = n_affected / n;
    report.under_object_fraction = n_under / n;
    report.over_object_fraction = n_over / n;
  }
}

}  // namespace

void add_to_pixel(Image<float>& picture, int pixel, const Eigen::Vector3d& value) {
  const std::size_t at = static_cast<std::size_t>(pixel) * 3;
  for (std::size_t c = 0; c < 3; ++c) {
    picture.pixels()[at + c] += static_cast<float>(value[static_cast<Eigen::Index>(c)]);
  }
}

std::vector<Receiver> find_receivers(const render::Scene& scene,
                                     const render::RayCaster& caster, const CameraModel& camera,
                                     int n_subpixels) {
  const auto n_pixels =
      static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  const auto n_side = static_cast<std::size_t>(n_subpixels);
  const auto n_sub = n_side * n_side;
  const auto width = static_cast<std::size_t>(camera.width);
  std::vector<std::optional<render::SurfacePoint>> seen(n_pixels * n_sub);
  parallel_for(n_pixels, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t s = 0; s < n_sub; ++s) {
        const std::size_t row = i / width;
        const std::size_t sub_row = s / n_side;
        const double x = static_cast<double>(i % width) +
                         (static_cast<double>(s % n_side) + 0.5) / n_subpixels;
        const double y =
            static_cast<double>(row) + (static_cast<double>(sub_row) + 0.5) / n_subpixels;
        seen[i * n_sub + s] = render::visible_surface(caster, camera, x, y);
      }
    }
  });
  std::vector<Receiver> receivers;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (seen[i]) {
      const render::Material& material =
          scene.materials[static_cast<std::size_t>(seen[i]->material)];
      receivers.push_back({static_cast<int>(i / n_sub), *seen[i], material.kd});
    }
  }
  return receivers;
}

ReprojectResult reproject_shadow(const render::Scene& scene, const CameraModel& camera,
                                 const PlaneFrame& frame,
                                 std::span<const render::SquareLight> lights,
                                 std::span<const Eigen::Vector3d> weights,
                                 const VisibilitySource& visibility,
                                 const ReprojectOptions& options) {
  const std::vector<SamplingPlane> planes{{frame, visibility, options.object}};
  return reproject_shadow(scene, camera, planes, lights, weights, options);
}

ReprojectResult reproject_shadow(const render::Scene& scene, const CameraModel& camera,
                                 std::span<const SamplingPlane> planes,
                                 std::span<const render::SquareLight> lights,
                                 std::span<const Eigen::Vector3d> weights,
                                 const ReprojectOptions& options) {
  const render::RayCaster caster(scene);
  const std::vector<Receiver> receivers =
      find_receivers(scene, caster, camera, options.n_subpixels);
  ReprojectResult result{Image<float>(camera.height, camera.width, 3),
                         Image<float>(camera.height, camera.width, 3),
                         Image<float>(camera.height, camera.width, 3),
                         Image<float>(camera.height, camera.width, 3),
                         options.has_spread,
                         Image<float>(camera.height, camera.width, 1),
                         {}};
  for (const render::Material& material : scene.materials) {
    result.report.has_glossy = result.report.has_glossy || material.ks > 0.0;
  }
  std::vector<render::SurfacePoint> points;
  points.reserve(receivers.size());
  for (const Receiver& receiver : receivers) {
    points.push_back(receiver.surface);
  }
  const PointsResult found =
      shadow_at_points(points, planes, lights, weights,
                       {.rule = options.rule,
                        .method = options.method,
                        .occluder = options.occluder,
                        .has_spread = options.has_spread,
                        .tolerance = options.tolerance,
                        .own_shadows = options.has_own_shadows ? &caster : nullptr,
                        .memory_bytes = options.memory_bytes,
                        .progress = options.progress});
  const double fraction = 1.0 / (options.n_subpixels * options.n_subpixels);
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    const PointTotal& total = found.totals[i];
    const Eigen::Vector3d f = receivers[i].albedo * (fraction / std::numbers::pi);
    add_to_pixel(result.picture, receivers[i].pixel, total.shadowed.cwiseProduct(f));
    add_to_pixel(result.unshadowed, receivers[i].pixel, total.unshadowed.cwiseProduct(f));
    add_to_pixel(result.unseen, receivers[i].pixel, total.unseen.cwiseProduct(f));
    add_to_pixel(result.spread, receivers[i].pixel, total.spread.cwiseProduct(f));
    if (total.light > 0.0) {
      result.from_occluder.pixels()[static_cast<std::size_t>(receivers[i].pixel)] +=
          static_cast<float>(fraction * total.from_occluder / total.light);
    }
  }
  result.report.points = found.report;
  result.report.n_lights = found.report.n_lights;
  result.report.count = found.report.count;
  double sign = 1.0;  // the side of the plane that the lights are on
  for (std::size_t k = lights.size(); k-- > 0;) {
    if (!weights[k].isZero(0.0)) {
      sign = planes[0].frame.height_of(lights[k].centre) > 0.0 ? 1.0 : -1.0;
    }
  }
  fill_report(receivers, found.totals, planes[0], sign, result.report);
  const auto norm = [](const Image<float>& image) {
    double sum = 0.0;
    for (const float v : image.pixels()) {
      sum += static_cast<double>(v) * static_cast<double>(v);
    }
    return std::sqrt(sum);
  };
  const double length = norm(result.picture);
  if (length > 0.0) {
    result.report.unseen_relative = norm(result.unseen) / length;
    result.report.spread_relative = norm(result.spread) / length;
  }
  return result;
}

}  // namespace haarlight::relight
