#include "relight/shadow/reproject.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <numbers>
#include <optional>

#include "core/parallel.h"
#include "render/analytic/polygon_light.h"
#include "render/picture.h"

namespace haarlight {
namespace {

constexpr std::size_t kGrain = 256;  // receivers a task
/// Lights that share the tests of the scene's own shadows (render/direct_light.h). A fixed
/// number, so that pictures do not depend on the memory that was allowed.
constexpr std::size_t kOwnShadowBlock = 128;
constexpr double kOnPlaneTexels = 0.01;  // nearer than this to the plane counts as on it
constexpr double kAffected = 0.01;       // share of a receiver's light that counts as affected

/// A light of non-zero weight with its tables.
struct ActiveLight {
  int index = 0;
  SquareLight light;
  std::array<Eigen::Vector3d, 4> corners;
  Eigen::Vector3d weight;
  double height = 0.0;  ///< over the plane
};

/// One receiver's sums over all lights so far.
struct Total {
  Eigen::Vector3d shadowed = Eigen::Vector3d::Zero();
  Eigen::Vector3d unshadowed = Eigen::Vector3d::Zero();
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();
  double light = 0.0;  ///< sum of w E, mean of the channels
  double above = 0.0;
  double below = 0.0;
  double on = 0.0;
  double no_point = 0.0;
  double unknown = 0.0;
  double outside = 0.0;
  double widening = 1.0;
};

/// Visibility of one light at one receiver.
struct LookUp {
  double value = 1.0;
  double half_spread = 0.0;
};

class Reprojector {
 public:
  Reprojector(const PlaneFrame& frame, const ReprojectOptions& options)
      : frame_(frame), options_(options) {}

  [[nodiscard]] LookUp look_up(const ActiveLight& light, const WindowSums& sums,
                               const Eigen::Vector3d& point, double flux, Total& total) const {
    const LightWindow window =
        project_window(frame_.plane, light.light.centre, light.corners, point);
    if (!is_valid(window.status)) {
      total.no_point += flux;
      return {};
    }
    const double height = frame_.height_of(point);
    const double sign = light.height > 0.0 ? 1.0 : -1.0;
    const double over = sign * height;  // mm on the light's side
    const bool is_on = std::abs(over) < kOnPlaneTexels * frame_.texel_mm;
    (is_on ? total.on : over > 0.0 ? total.above : total.below) += flux;
    const double H = std::abs(light.height);
    if (options_.object && over >= options_.object->high_mm) {
      return {};  // nothing of the object is between this point and the light
    }
    const auto mean_at = [&](double object_height) {
      const double share = object_height < 0.0 ? -1.0 : std::min(object_height / H, 0.999);
      return window_visibility(frame_, sums, window, is_on ? WindowRule::none : options_.rule,
                               share);
    };
    WindowMean mean;
    LookUp result;
    const bool is_corrected =
        options_.rule == WindowRule::corrected && options_.object && !is_on && over < 0.0;
    if (is_corrected) {
      // A range of heights has a window at each end.
      const double low = std::max(0.0, options_.object->low_mm);
      mean = mean_at(low);
      const WindowMean high = mean_at(options_.object->high_mm);
      result.half_spread = 0.5 * std::abs(high.value - mean.value);
      mean = {0.5 * (mean.value + high.value), std::max(mean.unknown, high.unknown),
              0.5 * (mean.outside + high.outside)};
    } else {
      mean = mean_at(-1.0);
    }
    if (options_.object && over > 0.0 && !is_on && mean.value < 1.0) {
      const double share = std::min(options_.object->high_mm / H, 0.999);
      total.widening = std::max(total.widening, widening_above(window.ratio, share));
    }
    total.unknown += mean.unknown > 0.0 ? flux : 0.0;
    total.outside += mean.outside * flux;
    result.value = mean.value;
    result.half_spread += 0.5 * mean.unknown;
    return result;
  }

 private:
  const PlaneFrame& frame_;
  const ReprojectOptions& options_;
};

std::vector<ActiveLight> choose_active(const PlaneFrame& frame,
                                       std::span<const SquareLight> lights,
                                       std::span<const Eigen::Vector3d> weights) {
  std::vector<ActiveLight> active;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (!weights[k].isZero(0.0)) {
      active.push_back({static_cast<int>(k), lights[k], light_corners(lights[k]), weights[k],
                        frame.height_of(lights[k].centre)});
    }
  }
  return active;
}

std::vector<SquareLight> lights_of(std::span<const ActiveLight> active) {
  std::vector<SquareLight> lights;
  lights.reserve(active.size());
  for (const ActiveLight& light : active) {
    lights.push_back(light.light);
  }
  return lights;
}

void fill_report(std::span<const Receiver> receivers, std::span<const Total> totals,
                 const PlaneFrame& frame, const ReprojectOptions& options,
                 std::span<const ActiveLight> active, ReprojectReport& report) {
  double light = 0.0;
  double n_affected = 0.0;
  double n_under = 0.0;
  double n_over = 0.0;
  const double sign = active.empty() || active[0].height > 0.0 ? 1.0 : -1.0;
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    const Total& total = totals[i];
    light += total.light;
    report.on_share += total.on;
    report.above_share += total.above;
    report.below_share += total.below;
    report.no_point_share += total.no_point;
    report.unknown_share += total.unknown;
    report.outside_share += total.outside;
    report.worst_widening = std::max(report.worst_widening, total.widening);
    n_affected += total.unknown > kAffected * total.light ? 1.0 : 0.0;
    if (options.object) {
      const double over = sign * frame.height_of(receivers[i].surface.point);
      const bool is_off = over > kOnPlaneTexels * frame.texel_mm;
      n_under +=
          is_off && over > options.object->low_mm && over < options.object->high_mm ? 1 : 0;
      n_over += over >= options.object->high_mm ? 1.0 : 0.0;
    }
  }
  report.n_receivers = static_cast<std::int64_t>(receivers.size());
  report.n_lights = static_cast<int>(active.size());
  if (light > 0.0) {
    for (double* share :
         {&report.on_share, &report.above_share, &report.below_share, &report.no_point_share,
          &report.unknown_share, &report.outside_share}) {
      *share /= light;
    }
  }
  if (!receivers.empty()) {
    const auto n = static_cast<double>(receivers.size());
    report.affected_receivers = n_affected / n;
    report.under_object_share = n_under / n;
    report.over_object_share = n_over / n;
  }
}

}  // namespace

void add_to_pixel(Image<float>& picture, int pixel, const Eigen::Vector3d& value) {
  const std::size_t at = static_cast<std::size_t>(pixel) * 3;
  for (std::size_t c = 0; c < 3; ++c) {
    picture.pixels()[at + c] += static_cast<float>(value[static_cast<Eigen::Index>(c)]);
  }
}

double receiver_irradiance(const SquareLight& light, const Eigen::Vector3d& point,
                           const Eigen::Vector3d& normal) {
  const Eigen::Vector3d to_light = light.centre - point;
  const double side = std::max(light.width_mm, light.height_mm);
  const double r2 = to_light.squaredNorm();
  const double over_surface = normal.dot(to_light);
  const double before_light = -light.emits.dot(to_light);
  const bool is_far = r2 >= 100.0 * side * side && over_surface > side && before_light > side;
  if (!is_far) {
    return light_irradiance(light, point, normal) / light.radiance;
  }
  // 2 x 2 Gauss-Legendre points: error O((side/r)^4).
  const double q = 0.5 / std::numbers::sqrt3;
  const Eigen::Vector3d du = q * light.width_mm * light.u;
  const Eigen::Vector3d dv = q * light.height_mm * light.v;
  double sum = 0.0;
  for (const double su : {-1.0, 1.0}) {
    for (const double sv : {-1.0, 1.0}) {
      const Eigen::Vector3d to = to_light + su * du + sv * dv;
      const double d2 = to.squaredNorm();
      const double cos_cos = normal.dot(to) * before_light / d2;
      const double lobe = light.lobe_mu == 1.0
                              ? 1.0
                              : std::pow(before_light / std::sqrt(d2), light.lobe_mu - 1.0);
      sum += cos_cos * lobe / d2;
    }
  }
  return 0.25 * light.width_mm * light.height_mm * sum;
}

std::vector<Receiver> find_receivers(const Scene& scene, const RayCaster& caster,
                                     const CameraModel& camera, int n_subpixels) {
  const auto n_pixels =
      static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  const auto n_side = static_cast<std::size_t>(n_subpixels);
  const auto n_sub = n_side * n_side;
  const auto width = static_cast<std::size_t>(camera.width);
  std::vector<std::optional<SurfacePoint>> seen(n_pixels * n_sub);
  parallel_for(n_pixels, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t s = 0; s < n_sub; ++s) {
        const std::size_t row = i / width;
        const std::size_t sub_row = s / n_side;
        const double x = static_cast<double>(i % width) +
                         (static_cast<double>(s % n_side) + 0.5) / n_subpixels;
        const double y =
            static_cast<double>(row) + (static_cast<double>(sub_row) + 0.5) / n_subpixels;
        seen[i * n_sub + s] = visible_surface(caster, camera, x, y);
      }
    }
  });
  std::vector<Receiver> receivers;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (seen[i]) {
      const Material& material = scene.materials[static_cast<std::size_t>(seen[i]->material)];
      receivers.push_back({static_cast<int>(i / n_sub), *seen[i], material.kd});
    }
  }
  return receivers;
}

ReprojectResult reproject_shadow(const Scene& scene, const CameraModel& camera,
                                 const PlaneFrame& frame, std::span<const SquareLight> lights,
                                 std::span<const Eigen::Vector3d> weights,
                                 const VisibilitySource& visibility,
                                 const ReprojectOptions& options) {
  HAARLIGHT_EXPECTS(lights.size() == weights.size(), "one weight a light");
  const RayCaster caster(scene);
  const std::vector<Receiver> receivers =
      find_receivers(scene, caster, camera, options.n_subpixels);
  const std::vector<ActiveLight> active = choose_active(frame, lights, weights);
  ReprojectResult result{Image<float>(camera.height, camera.width, 3),
                         Image<float>(camera.height, camera.width, 3),
                         Image<float>(camera.height, camera.width, 3),
                         {}};
  for (const Material& material : scene.materials) {
    result.report.has_glossy = result.report.has_glossy || material.ks > 0.0;
  }
  const std::uint64_t bytes_a_light = 16ULL * static_cast<std::uint64_t>(frame.width + 1) *
                                      static_cast<std::uint64_t>(frame.height + 1);
  // Shadow sums are held for as many lights as memory allows, and never beyond a block's end.
  const auto batch = static_cast<std::size_t>(
      std::clamp<std::uint64_t>(options.memory_bytes / bytes_a_light, 1, kOwnShadowBlock));
  std::vector<Total> totals(receivers.size());
  const Reprojector reprojector(frame, options);
  Progress progress("shadow", active.size(), options.progress);
  std::optional<DirectLight> own;
  std::span<const ActiveLight> block;
  for (std::size_t first = 0, size = 0; first < active.size(); first += size) {
    const std::size_t in_block = first % kOwnShadowBlock;
    if (in_block == 0) {
      block =
          std::span(active).subspan(first, std::min(kOwnShadowBlock, active.size() - first));
      own.emplace(caster, lights_of(block));
    }
    size = std::min(batch, block.size() - in_block);
    const auto part = block.subspan(in_block, size);
    std::vector<WindowSums> sums;
    sums.reserve(part.size());
    for (const ActiveLight& light : part) {
      const Visibility v = visibility(light.index);
      HAARLIGHT_EXPECTS(v.value.width() == frame.width && v.value.height() == frame.height,
                        "visibility in the plane's frame");
      result.report.count.add(v.count);
      sums.emplace_back(v.value.view(), v.known.view());
    }
    parallel_for(receivers.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      std::vector<LightShare> shares(block.size());
      for (std::size_t i = begin; i < end; ++i) {
        const Receiver& receiver = receivers[i];
        Total& total = totals[i];
        if (options.has_own_shadows) {
          Material lambert;
          (void)own->evaluate(receiver.surface, lambert, i, shares);
        }
        for (std::size_t k = 0; k < part.size(); ++k) {
          const ActiveLight& light = part[k];
          // Irradiance at unit drive, the scene's own shadows included.
          const double E =
              options.has_own_shadows
                  ? std::numbers::pi * shares[in_block + k].diffuse
                  : (receiver.surface.flat_normal.dot(light.light.centre -
                                                      receiver.surface.point) > 0.0
                         ? light.light.radiance * receiver_irradiance(light.light,
                                                                      receiver.surface.point,
                                                                      receiver.surface.normal)
                         : 0.0);
          if (!(E > 0.0)) {
            continue;
          }
          const double flux = E * std::abs(light.weight.mean());
          const LookUp look =
              reprojector.look_up(light, sums[k], receiver.surface.point, flux, total);
          const Eigen::Vector3d lit = E * light.weight;
          total.light += flux;
          total.unshadowed += lit;
          total.shadowed += look.value * lit;
          total.spread += look.half_spread * lit.cwiseAbs();
        }
      }
    });
    progress.advance(part.size());
  }
  const double share = 1.0 / (options.n_subpixels * options.n_subpixels);
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    const Eigen::Vector3d f = receivers[i].albedo * (share / std::numbers::pi);
    add_to_pixel(result.picture, receivers[i].pixel, totals[i].shadowed.cwiseProduct(f));
    add_to_pixel(result.unshadowed, receivers[i].pixel, totals[i].unshadowed.cwiseProduct(f));
    add_to_pixel(result.spread, receivers[i].pixel, totals[i].spread.cwiseProduct(f));
  }
  fill_report(receivers, totals, frame, options, active, result.report);
  const auto norm = [](const Image<float>& image) {
    double sum = 0.0;
    for (const float v : image.pixels()) {
      sum += static_cast<double>(v) * static_cast<double>(v);
    }
    return std::sqrt(sum);
  };
  const double length = norm(result.picture);
  result.report.spread_relative = length > 0.0 ? norm(result.spread) / length : 0.0;
  return result;
}

}  // namespace haarlight
