// SPDX-License-Identifier: Apache-2.0
#include "render/light/emission.h"

#include <cmath>
#include <numbers>
#include <type_traits>
#include <utility>
#include <variant>

#include "haarlight/core/error.h"
#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/shading_frame.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;

/// As in the choice of lights by power: however dim, none is missed.
constexpr double kAlike = 0.1;

/// Of cos^mu, mu = 1 for surfaces that emit radiance alike in all directions: as LedLight has it.
double lobe_of(const Light& light) {
  const auto* const led = std::get_if<LedLight>(&light);
  return led != nullptr ? led->square.lobe_mu : 1.0;
}

/// Per sr, of a surface that is drawn by its cosine law.
double cosine_density(double cosine, double mu) {
  return (mu + 1.0) / (2.0 * kPi) * std::pow(cosine, mu);
}

/// Draws by (mu + 1)/(2 pi) cos^mu about a normal.
void leave(const Vector3d& normal, double mu, const Vector2d& square, Emission& ray) {
  Vector3d local;
  if (mu == 1.0) {
    local = cosine_direction(square);
  } else {
    const double cosine = std::pow(1.0 - square.x(), 1.0 / (mu + 1.0));
    const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
    const Vector2d around = at_turns(square.y());
    local = {sine * around.x(), sine * around.y(), cosine};
  }
  ray.normal = normal;
  ray.cosine = local.z();
  ray.direction = frame_of(normal) * local;
  ray.is_found = ray.cosine > 0.0;
}

Vector3d on_sphere(const Vector2d& square, double cos_end) {
  // 1 - cos is even up to that of the end.
  const double fallen = square.x() * (1.0 - cos_end);
  const double sine = std::sqrt(std::max(0.0, fallen * (2.0 - fallen)));
  const Vector2d around = at_turns(square.y());
  return {sine * around.x(), sine * around.y(), 1.0 - fallen};
}

/// Draws a ray, and what it carries but for the choice of the light.
class Draw {
 public:
  Draw(const Light& light, const Vector3d& middle, double radius_mm, const Vector2d& point,
       const Vector2d& direction)
      : light_(light),
        middle_(middle),
        radius_mm_(radius_mm),
        point_(point),
        direction_(direction) {}

  template <class Kind>
  Emission operator()(const Kind& light) const {
    Emission ray;
    const AreaPoint at = light.draw(point_);
    ray.point = at.point;
    const double mu = lobe_of(light_);
    leave(at.normal, mu, direction_, ray);
    if (ray.is_found) {
      ray.power = light.radiance(ray.cosine) * ray.cosine /
                  (at.density_per_mm2 * cosine_density(ray.cosine, mu));
    }
    return ray;
  }

  Emission operator()(const SphereLight& light) const {
    Emission ray;
    const Vector3d normal = on_sphere(point_, -1.0);
    ray.point = light.sphere.centre + light.sphere.radius_mm * normal;
    leave(normal, 1.0, direction_, ray);
    ray.power =
        4.0 * kPi * kPi * light.sphere.radius_mm * light.sphere.radius_mm * light.radiance;
    return ray;
  }

  Emission operator()(const PointSource& source) const {
    Emission ray;
    const PointLight& light = source.light;
    ray.point = light.position;
    ray.direction = frame_of(light.axis) * on_sphere(direction_, light.cos_end);
    // What arrives at distance 1, of the formula that asks the light.
    const LightSample seen = source.sample(light.position + ray.direction, direction_);
    ray.is_found = seen.is_found;
    ray.power = 2.0 * kPi * (1.0 - light.cos_end) * seen.radiance;
    return ray;
  }

  Emission operator()(const DirectionalSource& source) const {
    Emission ray;
    ray.is_found = true;
    ray.direction = source.light.direction;
    from_afar(ray);
    ray.power = kPi * radius_mm_ * radius_mm_ * source.light.irradiance;
    return ray;
  }

  Emission operator()(const EnvironmentSourceLight& source) const {
    Emission ray;
    const EnvironmentDirection drawn = source.light.sample(direction_);
    ray.is_found = drawn.density > 0.0;
    ray.direction = -drawn.direction;
    from_afar(ray);
    ray.power = kPi * radius_mm_ * radius_mm_ / drawn.density * drawn.radiance;
    return ray;
  }

 private:
  void from_afar(Emission& ray) const {
    ray.is_far = true;
    const Vector2d at = radius_mm_ * concentric_disk(point_);
    ray.point = middle_ + frame_of(ray.direction) * Vector3d(at.x(), at.y(), -radius_mm_);
  }

  const Light& light_;
  const Vector3d& middle_;
  double radius_mm_;
  const Vector2d& point_;
  const Vector2d& direction_;
};

/// Emitters::density() but for the choice of the light.
class Density {
 public:
  Density(const LightHit& hit, double radius_mm) : hit_(hit), radius_mm_(radius_mm) {}

  double operator()(const MeshLight& light) const {
    return cosine_density(hit_.cosine, 1.0) / light.area_mm2();
  }
  double operator()(const DiskLight& light) const {
    return cosine_density(hit_.cosine, 1.0) /
           (kPi * light.disk.radius_mm * light.disk.radius_mm);
  }
  double operator()(const LedLight& light) const {
    return cosine_density(hit_.cosine, light.square.lobe_mu) /
           (light.square.width_mm * light.square.height_mm);
  }
  double operator()(const SphereLight& light) const {
    return cosine_density(hit_.cosine, 1.0) /
           (4.0 * kPi * light.sphere.radius_mm * light.sphere.radius_mm);
  }
  double operator()(const PointSource& source) const {
    return -source.light.axis.dot(hit_.direction) < source.light.cos_end
               ? 0.0
               : 1.0 / (2.0 * kPi * (1.0 - source.light.cos_end));
  }
  double operator()(const DirectionalSource& /*source*/) const { return 1.0 / disk(); }
  double operator()(const EnvironmentSourceLight& source) const {
    return source.light.density(hit_.direction) / disk();
  }

 private:
  [[nodiscard]] double disk() const { return kPi * radius_mm_ * radius_mm_; }

  const LightHit& hit_;
  double radius_mm_;
};

}  // namespace

Emitters::Emitters(const SceneLights& lights, Vector3d middle, double radius_mm)
    : lights_(&lights), middle_(std::move(middle)), radius_mm_(radius_mm) {
  const auto n = static_cast<double>(lights.size());
  double sum = 0.0;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    sum += render::power(lights[i]);
  }
  double up_to = 0.0;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    up_to += kAlike / n + (1.0 - kAlike) * (render::power(lights[i]) / sum);
    up_to_.push_back(up_to);
  }
}

Emission Emitters::emit(const Vector2d& point, const Vector2d& direction) const {
  HAARLIGHT_EXPECTS(!up_to_.empty(), "a light to leave");
  const CutUnit cut = cut_unit(up_to_, point.x());
  const Light& light = (*lights_)[cut.index];
  const Vector2d within(std::min(cut.within, 0x1.fffffffffffffp-1), point.y());
  Emission ray = std::visit(Draw(light, middle_, radius_mm_, within, direction), light);
  ray.light = cut.index;
  const double before = cut.index == 0 ? 0.0 : up_to_[cut.index - 1];
  ray.power /= (up_to_[cut.index] - before) / up_to_.back();
  return ray;
}

double Emitters::density(std::size_t light, const LightHit& hit) const {
  const double before = light == 0 ? 0.0 : up_to_[light - 1];
  return (up_to_[light] - before) / up_to_.back() *
         std::visit(Density(hit, radius_mm_), (*lights_)[light]);
}

double asked_density(const Light& light, const Vector3d& from, const LightHit& hit) {
  if (const auto* const led = std::get_if<LedLight>(&light)) {
    return hit.cosine > 0.0 ? hit.distance_mm * hit.distance_mm /
                                  (hit.cosine * led->square.width_mm * led->square.height_mm)
                            : 0.0;
  }
  return can_be_met(light) ? density(light, from, hit) : 1.0;
}

double cosine_at(const Light& light, const LightSample& sample) {
  if (const auto* const led = std::get_if<LedLight>(&light)) {
    return -led->square.emits.dot(sample.direction);
  }
  return sample.normal.isZero(0.0) ? 1.0 : -sample.normal.dot(sample.direction);
}

}  // namespace haarlight::render
