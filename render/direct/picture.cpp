// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct/picture.h"

#include <chrono>
#include <cmath>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

std::optional<SurfacePoint> visible_surface(const RayCaster& caster, const CameraModel& camera,
                                            double x, double y) {
  const CameraRay ray = ray_through(camera, x, y);
  const std::optional<Hit> hit = caster.intersect(ray.origin_world, ray.direction_world);
  if (!hit) {
    return std::nullopt;
  }
  SurfacePoint surface;
  surface.point = hit->point;
  surface.normal = hit->normal;
  surface.flat_normal = hit->flat_normal;
  surface.to_eye = -ray.direction_world;
  surface.material = hit->material;
  surface.offset_mm = hit->offset_mm;
  return surface;
}

LitPicture render_lit(const Scene& scene, const CameraModel& camera,
                      std::span<const SquareLight> lights, std::span<const Vector3d> weights,
                      const LitOptions& options) {
  return render_lit(scene, RayCaster(scene), camera, lights, weights, options);
}

LitPicture render_lit(const Scene& scene, const RayCaster& caster, const CameraModel& camera,
                      std::span<const SquareLight> lights, std::span<const Vector3d> weights,
                      const LitOptions& options) {
  HAARLIGHT_EXPECTS(lights.size() == weights.size(), "one weight per light");
  HAARLIGHT_EXPECTS(options.n_subpixels >= 1, "at least one sub-pixel");
  const auto start = std::chrono::steady_clock::now();
  std::vector<SquareLight> lit;
  std::vector<Vector3d> lit_weights;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (!weights[k].isZero(0.0)) {
      lit.push_back(lights[k]);
      lit_weights.push_back(weights[k]);
    }
  }
  const DirectLight direct(caster, lit, options.direct);
  const int n = options.n_subpixels;
  LitPicture picture;
  picture.radiance = Image<float>(camera.height, camera.width, 3);
  picture.error = Image<float>(camera.height, camera.width, 3);
  picture.coverage = Image<float>(camera.height, camera.width, 1);
  std::vector<std::uint64_t> rays_of_row(static_cast<std::size_t>(camera.height), 0);
  Progress progress("render", static_cast<std::size_t>(camera.height), options.progress);
  parallel_for(static_cast<std::size_t>(camera.height), 1, [&](std::size_t y0, std::size_t y1) {
    std::vector<LightContribution> contributions(lit.size());
    for (int y = static_cast<int>(y0); y < static_cast<int>(y1); ++y) {
      for (int x = 0; x < camera.width; ++x) {
        Vector3d radiance = Vector3d::Zero();
        Vector3d variance = Vector3d::Zero();
        int n_hits = 0;
        for (int s = 0; s < n * n; ++s) {
          const int row = s / n;
          const std::optional<SurfacePoint> surface =
              visible_surface(caster, camera, x + (s % n + 0.5) / n, y + (row + 0.5) / n);
          ++rays_of_row[static_cast<std::size_t>(y)];
          if (!surface) {
            radiance += options.background;
            continue;
          }
          ++n_hits;
          const Material& material =
              scene.materials[static_cast<std::size_t>(surface->material)];
          const auto key =
              hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x),
                       static_cast<std::uint64_t>(s));
          rays_of_row[static_cast<std::size_t>(y)] +=
              direct.evaluate(*surface, material, key, contributions);
          for (std::size_t k = 0; k < lit.size(); ++k) {
            const LightContribution& contribution = contributions[k];
            if (contribution.visible == 0.0) {
              continue;
            }
            const Vector3d light = (material.kd * contribution.diffuse +
                                    Vector3d::Constant(material.ks * contribution.specular))
                                       .cwiseProduct(lit_weights[k]);
            radiance += light;
            variance += (light * (contribution.error / contribution.visible)).cwiseAbs2();
          }
        }
        const double fraction_of_pixel = 1.0 / (n * n);
        for (int c = 0; c < 3; ++c) {
          picture.radiance(y, x, c) = static_cast<float>(radiance[c] * fraction_of_pixel);
          picture.error(y, x, c) =
              static_cast<float>(std::sqrt(variance[c]) * fraction_of_pixel);
        }
        picture.coverage(y, x) = static_cast<float>(n_hits * fraction_of_pixel);
      }
      progress.advance();
    }
  });
  for (const std::uint64_t rays : rays_of_row) {
    picture.n_rays += rays;
  }
  double error2 = 0.0;
  double radiance2 = 0.0;
  for (std::size_t i = 0; i < picture.error.pixels().size(); ++i) {
    error2 += static_cast<double>(picture.error.pixels()[i]) * picture.error.pixels()[i];
    radiance2 +=
        static_cast<double>(picture.radiance.pixels()[i]) * picture.radiance.pixels()[i];
  }
  picture.relative_error = radiance2 > 0.0 ? std::sqrt(error2 / radiance2) : 0.0;
  picture.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return picture;
}

}  // namespace haarlight::render
