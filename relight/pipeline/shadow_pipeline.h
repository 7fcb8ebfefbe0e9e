// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/shadow/area_mean.h"
#include "relight/pipeline/captured_hull.h"
#include "relight/pipeline/light_choice.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/pipeline/shadow_captures.h"
#include "relight/shadow/reproject.h"
#include "relight/shadow/shadow_truth.h"

/// @file
/// From basis files to a picture: the captured object's shadow on another scene, under an
/// environment or chosen lights, with the object itself over it and the ray-traced truth next
/// to it on request. Method: relight/shadow/reproject.h, docs/numerics/shadow.md.

namespace haarlight::relight {

struct ShadowOptions {
  CapturedObject captured;
  std::string scene;   ///< receives the shadow; its camera, if any, takes the picture
  std::string output;  ///< picture: .exr linear, .png for display
  LightChoice light;
  ShadowMethod method = ShadowMethod::both;
  double hull_voxel_mm = 0.0;  ///< 0: chosen (relight/hull/shadow_hull.h)
  WindowRule window = WindowRule::corrected;
  std::optional<double> max_error;     ///< relative L2 of the irradiance, in [0, 1]
  std::optional<double> worst_point;   ///< of the irradiance, as a fraction of the brightest
  bool with_object = false;            ///< composite the relit object over the scene
  std::optional<double> plane_albedo;  ///< of the captured plane, (0, 1]; with_object needs it
  /// Degrees: the environment, so far out of focus, where the camera looks past the scene.
  std::optional<double> background;
  std::vector<int> size;           ///< width, height; empty: the camera's
  int subpixels = 2;               ///< n x n samples per pixel
  bool has_own_shadows = true;     ///< those that the scene casts on itself
  std::optional<double> exposure;  ///< default: unshadowed 99.5th percentile white for .png
  std::string spread;              ///< picture of ReprojectResult::spread; empty: none
  std::string unseen;              ///< of ReprojectResult::unseen; empty: none
  std::string truth_object;        ///< scene of the object itself; goes with `truth`
  std::string truth;               ///< ray-traced picture; empty: none
  std::string difference;          ///< picture, four times brighter; empty: none
  PipelineSettings settings;
};

/// The object composited over the scene.
struct ShadowObject {
  std::int64_t n_drawn = 0;   ///< pixels
  std::int64_t n_hidden = 0;  ///< pixels behind the scene
  double scale = 0.0;         ///< from the capture's values to the scene's radiance
};

/// The picture's error against the ray-traced one.
struct ShadowAgreement {
  Achieved achieved;
  std::optional<ShadowError> shadow;  ///< of the shadow alone
  std::optional<Achieved> object;     ///< with_object: of its own pixels
};

struct ShadowSummary {
  ReprojectReport reprojected;
  std::optional<HullSource> hull;  ///< of the methods that need one
  std::size_t n_planes = 0;
  /// One per capture and plane; empty if no light is on.
  std::vector<ShadowPlate> plates;
  std::vector<JoinedPlane> joined;         ///< planes that several captures show
  std::optional<double> missing_fraction;  ///< of an environment, where the rig has no lights
  std::string layout;                      ///< of the environment; empty: none
  double exposure = 1.0;
  std::optional<ShadowObject> object;
  std::optional<double> background_fraction;  ///< of the picture that shows the environment
  std::optional<ShadowAgreement> truth;
  std::uint64_t bytes = 0;          ///< of all pictures
  std::vector<PipelineNote> notes;  ///< all messages
};

/// Reads everything, then writes the pictures.
/// @throws Error(usage)  options that contradict each other
/// @throws Error  inputs that cannot be read or do not belong together, outputs that exist
[[nodiscard]] ShadowSummary cast_shadow(const ShadowOptions& options);

/// Tolerance of the irradiance, from max_error and worst_point; 0: exact.
[[nodiscard]] Tolerance shadow_tolerance(const ShadowOptions& options);

/// What was requested and achieved.
void add_to_report(const ShadowOptions& options, const ShadowSummary& summary, Report& report);

}  // namespace haarlight::relight
