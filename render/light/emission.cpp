// SPDX-License-Identifier: Apache-2.0
#include "render/light/emission.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "haarlight/core/error.h"
#include "render/light/emitted_ray.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// As in the choice of lights by power: however dim, none is missed.
constexpr double kAlike = 0.1;

}  // namespace

Emitters::Emitters(const SceneLights& lights, Vector3d middle)
    : lights_(&lights), middle_(std::move(middle)) {
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
  const EmittedRay ray = render::emit(light, middle_, within, direction);
  return {.is_found = ray.direction_density > 0.0 && ray.cosine > 0.0,
          .is_far = ray.is_far,
          .light = cut.index,
          .point = ray.origin,
          .direction = ray.direction,
          .normal = ray.is_far ? Vector3d::Zero() : ray.normal,
          .cosine = ray.cosine,
          .power = ray.flux() / probability(cut.index)};
}

double Emitters::probability(std::size_t light) const {
  const double before = light == 0 ? 0.0 : up_to_[light - 1];
  return (up_to_[light] - before) / up_to_.back();
}

double Emitters::density(std::size_t light, const LightHit& hit) const {
  const EmissionDensity density =
      emission_density((*lights_)[light], hit.cosine, -hit.direction);
  return probability(light) * density.position * density.direction;
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
