// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "relight/shadow/shadow_points.h"

/// @file
/// The captured object's shadow on another scene:
///
///     I(v) = rho(v)/pi sum_k w_k E_k(v) V_k(p_k(v))
///
/// with E_k the analytic irradiance of square light k at v and V_k its shadow picture, looked
/// up where the light's ray through v meets the plane (projection.h, area_mean.h). The object's
/// geometry is never used; its height range, where known, corrects the window and tells for
/// which receivers the method fails.

namespace haarlight::relight {

/// A point of the scene that a sub-pixel of the camera sees.
struct Receiver {
  int pixel = 0;  ///< row * width + column
  render::SurfacePoint surface;
  Eigen::Vector3d albedo;
};

/// n x n sub-pixel centres per pixel, in pixel order.
[[nodiscard]] std::vector<Receiver> find_receivers(const render::Scene& scene,
                                                   const render::RayCaster& caster,
                                                   const CameraModel& camera, int n_subpixels);

struct ReprojectOptions {
  WindowRule rule = WindowRule::corrected;
  ShadowMethod method = ShadowMethod::plane;
  const Occluder* occluder = nullptr;  ///< of the methods that need one
  bool has_spread = false;            ///< fill ReprojectResult::spread: nine times the look-ups
  std::optional<HeightRange> object;  ///< over the plane; the planes' own count if given
  int n_subpixels = 2;
  bool has_own_shadows = true;  ///< the scene's own shadows, by ray casting
  /// Tolerance of the receivers' irradiance; exact by default (shadow_points.h).
  Tolerance tolerance{.relative_l2 = 0.0,
                      .worst_pixel = std::numeric_limits<double>::infinity()};
  /// Memory for tables of shadow pictures. An exact result does not depend on it.
  std::uint64_t memory_bytes = std::uint64_t{1} << 30U;
  ProgressStyle progress = ProgressStyle::none;
};

/// What the user of the picture should know. Fractions are fractions of lit (receiver, light)
/// pairs, weighted by w E, so that a dark pair does not count.
struct ReprojectReport {
  std::int64_t n_receivers = 0;
  int n_lights = 0;          ///< of non-zero weight
  double on_fraction = 0.0;  ///< within a hundredth of a texel of the plane
  double above_fraction = 0.0;
  double below_fraction = 0.0;
  double no_point_fraction =
      0.0;  ///< no projection (light in the plane, beyond the light): drawn lit
  double unknown_fraction = 0.0;   ///< pairs whose window touches the unknown region
  double outside_fraction = 0.0;   ///< energy looked up beyond the plane picture, taken as lit
  double occluder_fraction = 0.0;  ///< energy whose visibility the occluder told
  double affected_receivers =
      0.0;  ///< fraction of receivers with any such pair worth 1 % of their light
  double unseen_relative = 0.0;  ///< ||unseen||_2 / ||picture||_2
  double spread_relative = 0.0;  ///< ||spread||_2 / ||picture||_2, on request
  double under_object_fraction =
      0.0;  ///< receivers above the object's lowest point: parts of it
            ///< below wrongly darken them (height range known)
  double over_object_fraction = 0.0;  ///< receivers above its highest point: drawn lit
  double worst_widening = 1.0;        ///< penumbra above the plane: largest factor too wide
  VisibilityCount count;
  PointsReport points;      ///< how the sums were computed, and their error
  bool has_glossy = false;  ///< some materials' gloss was left out
};

struct ReprojectResult {
  Image<float> picture;     ///< (h, w, 3) linear; in units of a light's radiance at weight 1
  Image<float> unshadowed;  ///< (h, w, 3) the same with V = 1
  /// (h, w, 3) how far the picture may differ because of what was not seen: half the distance
  /// between the bounds in unknown regions; where an occluder told, that to the farther bound.
  Image<float> unseen;
  /// (h, w, 3) the same with what resolution and noise leave open; black unless requested.
  Image<float> spread;
  bool has_spread = false;
  Image<float> from_occluder;  ///< (h, w, 1) fraction of the light that an occluder told
  ReprojectReport report;
};

/// @param scene   the receivers; Lambertian part only
/// @param lights  as in the rig, light k at index k
/// @param weights one RGB weight per light; zero ones are not requested
/// The result does not depend on the number of threads.
[[nodiscard]] ReprojectResult reproject_shadow(
    const render::Scene& scene, const CameraModel& camera, const PlaneFrame& frame,
    std::span<const render::SquareLight> lights, std::span<const Eigen::Vector3d> weights,
    const VisibilitySource& visibility, const ReprojectOptions& options = {});

/// The same from several planes, each with its own pictures. Heights in the report are over the
/// first.
[[nodiscard]] ReprojectResult reproject_shadow(const render::Scene& scene,
                                               const CameraModel& camera,
                                               std::span<const SamplingPlane> planes,
                                               std::span<const render::SquareLight> lights,
                                               std::span<const Eigen::Vector3d> weights,
                                               const ReprojectOptions& options = {});

/// Adds one receiver's contribution to its pixel of an RGB picture.
void add_to_pixel(Image<float>& picture, int pixel, const Eigen::Vector3d& value);

}  // namespace haarlight::relight
