// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/shadow_truth.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/render/direct/direct_light.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kGrain = 256;  // receivers per task

}  // namespace

void remove_plane_triangles(render::Scene& scene, const PlaneFrame& frame) {
  constexpr double kInPlaneMm = 0.01;
  HAARLIGHT_EXPECTS(scene.instances.empty(), "instances are expanded");
  for (render::Mesh& mesh : scene.meshes) {
    std::erase_if(mesh.triangles, [&](const Eigen::Vector3i& t) {
      return std::all_of(t.begin(), t.end(), [&](int i) {
        return std::abs(frame.height_of(mesh.vertices[static_cast<std::size_t>(i)])) <
               kInPlaneMm;
      });
    });
  }
  std::erase_if(scene.meshes, [](const render::Mesh& mesh) { return mesh.triangles.empty(); });
}

Image<float> trace_shadow(const render::Scene& receivers, const render::Scene& object,
                          const CameraModel& camera,
                          std::span<const render::SquareLight> lights,
                          std::span<const Eigen::Vector3d> weights, int n_subpixels,
                          ProgressStyle progress_style) {
  HAARLIGHT_EXPECTS(lights.size() == weights.size(), "one weight per light");
  std::vector<render::SquareLight> lit;
  std::vector<Eigen::Vector3d> w;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (!weights[k].isZero(0.0)) {
      lit.push_back(lights[k]);
      w.push_back(weights[k]);
    }
  }
  const render::RayCaster eye(receivers);
  render::Scene all = receivers;
  render::append_scene(all, object);
  const render::RayCaster caster(all);
  const std::vector<Receiver> seen = find_receivers(receivers, eye, camera, n_subpixels);
  const render::DirectLight direct(caster, lit);
  std::vector<Eigen::Vector3d> radiance(seen.size(), Eigen::Vector3d::Zero());
  Progress progress("ray-traced shadow", seen.size(), progress_style);
  parallel_for(seen.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    std::vector<render::LightContribution> contributions(lit.size());
    for (std::size_t i = begin; i < end; ++i) {
      render::Material lambert;
      (void)direct.evaluate(seen[i].surface, lambert, i, contributions);
      for (std::size_t k = 0; k < lit.size(); ++k) {
        radiance[i] += contributions[k].diffuse * w[k].cwiseProduct(seen[i].albedo);
      }
    }
    progress.advance(end - begin);
  });
  Image<float> picture(camera.height, camera.width, 3);
  const double fraction = 1.0 / (n_subpixels * n_subpixels);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    add_to_pixel(picture, seen[i].pixel, fraction * radiance[i]);
  }
  return picture;
}

namespace {

/// Whether the spread holds the truth where it has something to say.
std::optional<ShadowError::Spread> assess_spread(const ReprojectResult& result,
                                                 const Image<float>& truth) {
  constexpr double kPartly = 0.02;      // of the unshadowed value; and told by an occluder
  constexpr double kRayTraced = 0.002;  // of it: float pictures, stratified samples
  std::vector<double> spreads;
  ShadowError::Spread found;
  double square = 0.0;
  for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
    const auto u = static_cast<double>(result.unshadowed.pixels()[i]);
    if (!(u > 0.0)) {
      continue;
    }
    const double t = static_cast<double>(truth.pixels()[i]) / u;
    const double p = static_cast<double>(result.picture.pixels()[i]) / u;
    const bool is_lit = t >= 1.0 - kPartly && p >= 1.0 - kPartly;
    const bool is_dark = t <= kPartly && p <= kPartly;
    const bool is_told = static_cast<double>(result.from_occluder.pixels()[i / 3]) > kPartly;
    if (is_lit || (is_dark && !is_told)) {
      continue;
    }
    const double error = std::abs(p - t);
    spreads.push_back(static_cast<double>(result.spread.pixels()[i]) / u);
    found.holding_fraction += error <= spreads.back() + kRayTraced ? 1.0 : 0.0;
    found.mean_error += error;
    square += error * error;
  }
  if (spreads.empty()) {
    return std::nullopt;
  }
  const auto n = static_cast<double>(spreads.size());
  found.holding_fraction /= n;
  found.mean_error /= n;
  found.rms_error = std::sqrt(square / n);
  found.median = median(std::move(spreads));
  return found;
}

}  // namespace

ShadowError compare_shadow(const ReprojectResult& result, const Image<float>& truth) {
  HAARLIGHT_EXPECTS(truth.pixels().size() == result.picture.pixels().size(),
                    "one picture size");
  constexpr double kKnownSpread = 0.01;  // of the unshadowed value
  double wrong = 0.0;
  double shadow = 0.0;
  double known_wrong = 0.0;
  double known_shadow = 0.0;
  double known_square = 0.0;
  double known_norm = 0.0;
  double n_known = 0.0;
  double n_lit = 0.0;
  for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
    const auto t = static_cast<double>(truth.pixels()[i]);
    const auto u = static_cast<double>(result.unshadowed.pixels()[i]);
    const double e = std::abs(static_cast<double>(result.picture.pixels()[i]) - t);
    wrong += e;
    shadow += std::abs(u - t);
    if (u <= 0.0) {
      continue;
    }
    n_lit += 1.0;
    if (static_cast<double>(result.unseen.pixels()[i]) <= kKnownSpread * u) {
      known_wrong += e;
      known_shadow += std::abs(u - t);
      known_square += e * e;
      known_norm += t * t;
      n_known += 1.0;
    }
  }
  const auto ratio = [](double a, double b) { return b > 0.0 ? a / b : 0.0; };
  return {ratio(wrong, shadow), ratio(known_wrong, known_shadow),
          std::sqrt(ratio(known_square, known_norm)), ratio(n_known, n_lit),
          result.has_spread ? assess_spread(result, truth) : std::nullopt};
}

}  // namespace haarlight::relight
