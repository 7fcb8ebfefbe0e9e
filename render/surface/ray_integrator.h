// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/bsdf_sample.h"
#include "render/camera/camera.h"
#include "render/film/filter.h"
#include "render/light/scene_lights.h"
#include "render/loop/tile_renderer.h"
#include "render/sampling/sampler.h"

/// @file
/// Integrators that follow one camera ray at a time: what they add is radiance(), written as
/// its formula is. They are to be read and to be compared with; PathIntegrator follows the paths of
/// a tile together, and is faster.

namespace haarlight::render {

struct RayOptions {
  LightChoice lights = LightChoice::all;  ///< direct_light() asks all
  SamplerKind sampler = SamplerKind::sobol;
  std::uint64_t seed = 0;
  FilterKind filter = FilterKind::box;
  bool has_features = false;  ///< fills the layers after the first (surface_layers.h)
  int first_x = 0;  ///< pixel of the camera that the film's first is: a crop of its picture
  int first_y = 0;
};

/// The random numbers of one sample, by what they are for.
class SampleNumbers {
 public:
  SampleNumbers(const PixelSamples& pixel, std::uint32_t sample)
      : pixel_(&pixel), sample_(sample) {}
  /// @param bounce    from 0 at the first surface
  /// @param question  of it, less than kQuestions
  [[nodiscard]] double one(int bounce, std::uint32_t question) const {
    return pixel_->one(sample_, dimension(bounce, question));
  }
  [[nodiscard]] Eigen::Vector2d two(int bounce, std::uint32_t question) const {
    return pixel_->two(sample_, dimension(bounce, question));
  }
  /// A point of each light in turn.
  [[nodiscard]] Eigen::Vector2d light_point(int bounce, std::size_t light,
                                            std::size_t n_lights) const;
  /// The i-th of n that a sample asks for together: those of all samples are spread as one.
  [[nodiscard]] double one_of(int bounce, std::uint32_t question, std::uint32_t i,
                              std::uint32_t n) const {
    return pixel_->one(sample_ * n + i, dimension(bounce, question));
  }
  [[nodiscard]] Eigen::Vector2d two_of(int bounce, std::uint32_t question, std::uint32_t i,
                                       std::uint32_t n) const {
    return pixel_->two(sample_ * n + i, dimension(bounce, question));
  }
  static constexpr std::uint32_t kQuestions = 8;
  /// What every integrator asks; the rest of the questions are its own.
  enum Question : std::uint32_t { lobe, direction_to_go, first_own };

 private:
  [[nodiscard]] static std::uint32_t dimension(int bounce, std::uint32_t question);

  const PixelSamples* pixel_;
  std::uint32_t sample_;
};

class RayIntegrator : public TileRenderer {
 public:
  /// Keeps references to all but the camera.
  /// @param environment  of the scene's source; nothing: the scene has none
  RayIntegrator(const Scene& scene, const RayCaster& caster, const Environment* environment,
                Camera camera, const RayOptions& options);

  /// Fills surface_layers().
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const final;

 protected:
  /// What arrives at the camera along one of its rays, RGB; an estimate without bias, unless the
  /// integrator says otherwise.
  /// @param n_rays  counts those that it casts
  [[nodiscard]] virtual Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                                 std::uint64_t& n_rays) const = 0;

  /// A point of a surface on a ray's way.
  struct SurfacePoint {
    Hit hit;
    Eigen::Matrix3d world_from_local;  ///< the BSDF's frame
    Eigen::Vector3d to_eye;            ///< local
    Bsdf bsdf;
  };
  [[nodiscard]] SurfacePoint surface_at(const Ray& ray, const RawHit& raw) const;

  /// What lights that are met send back along the ray: a surface's front, the environment.
  [[nodiscard]] Eigen::Vector3d emitted(const Hit& hit) const;
  [[nodiscard]] Eigen::Vector3d emitted_from_afar(const Ray& ray) const;
  /// Reflected light of all lights, one point of each: Σ f L cos θ / p over those that are seen.
  [[nodiscard]] Eigen::Vector3d direct_light(const SurfacePoint& at,
                                             const SampleNumbers& numbers, int bounce,
                                             std::uint64_t& n_rays) const;

  /// What a point of a light would send there, not yet asked whether it is hidden.
  struct AskedLight {
    LightSample light;
    Eigen::Vector3d to_light;  ///< local
    Eigen::Vector3d f;         ///< the BSDF's, of some colour above 0
    Ray ray;                   ///< to the light
  };
  /// @param square  where on the light
  [[nodiscard]] std::optional<AskedLight> ask_light(const SurfacePoint& at, std::size_t light,
                                                    const Eigen::Vector2d& square) const;
  /// The sum of what arrives along those rays that nothing blocks.
  [[nodiscard]] Eigen::Vector3d sum_of_seen(const std::vector<Ray>& rays,
                                            const std::vector<Eigen::Vector3d>& arrives,
                                            std::uint64_t& n_rays) const;

  /// The way on from a surface, drawn of its BSDF; from ideal mirrors and glass one of reflection
  /// and refraction, drawn by Fresnel's equations, as both would be two rays, and theirs four.
  /// @param ray  that arrives; then the one that goes on
  /// @return nothing: none does
  [[nodiscard]] static std::optional<BsdfSample> go_on(const SurfacePoint& at, double lobe,
                                                       const Eigen::Vector2d& square, Ray& ray);

  /// E[S*]: a camera ray's way over ideal mirrors and glass.
  struct SpecularWay {
    Eigen::Vector3d sum =
        Eigen::Vector3d::Zero();  ///< what lights on the way send back, E[S*]L
    Eigen::Vector3d throughput = Eigen::Vector3d::Ones();
    int bounces = 0;                  ///< surfaces that were passed
    std::optional<SurfacePoint> end;  ///< the first that is neither; nothing: it met none
  };
  [[nodiscard]] SpecularWay follow_specular(Ray ray, const SampleNumbers& numbers,
                                            int most_bounces, std::uint64_t& n_rays) const;

  [[nodiscard]] const Scene& scene() const noexcept { return *scene_; }
  [[nodiscard]] const RayCaster& caster() const noexcept { return *caster_; }
  [[nodiscard]] const SceneLights& lights() const noexcept { return lights_; }
  /// RayCaster::most_offset_mm(); of no surface 0.
  [[nodiscard]] double light_offset(std::size_t light) const { return light_offsets_[light]; }

 private:
  const Scene* scene_;
  const RayCaster* caster_;
  Camera camera_;
  RayOptions options_;
  PixelFilter filter_;
  SceneLights lights_;
  std::vector<double> light_offsets_;
};

}  // namespace haarlight::render
