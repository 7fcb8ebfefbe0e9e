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
#include "relight/hull/shadow_hull.h"
#include "relight/pipeline/light_choice.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/shadow/reproject.h"
#include "relight/shadow/shadow_truth.h"

/// @file
/// From basis files to a picture: the captured object's shadow on another scene, under an
/// environment or chosen lights, with the object itself over it and the ray-traced truth next
/// to it on request. Method: relight/shadow/reproject.h, docs/numerics/shadow.md.

namespace haarlight::relight {

struct ShadowOptions {
  std::string basis;   ///< of the object on the shadow plane, with its rig
  std::string scene;   ///< receives the shadow; its camera, if any, takes the picture
  std::string output;  ///< picture: .exr linear, .png for display
  LightChoice light;
  ShadowMethod method = ShadowMethod::both;
  double hull_voxel_mm = 0.0;  ///< 0: chosen (relight/hull/shadow_hull.h)
  WindowRule window = WindowRule::corrected;
  std::optional<HeightRange> object;  ///< over the first plane
  std::vector<std::string> planes;    ///< ids of the rig's; empty: all
  /// Further captures of the object: the plane moved, or another camera's view of it.
  std::vector<std::string> also;
  std::optional<double> max_error;     ///< relative L2 of the irradiance, in [0, 1]
  std::optional<double> worst_point;   ///< of the irradiance, as a fraction of the brightest
  bool with_object = false;            ///< composite the relit object over the scene
  std::optional<double> plane_albedo;  ///< of the captured plane, (0, 1]; with_object needs it
  std::string plate = "computed";      ///< or falloff, or a .hlb file
  std::string mask;             ///< picture, white where the plane is visible; empty: detected
  std::vector<int> size;        ///< width, height; empty: the camera's
  int subpixels = 2;            ///< n x n samples per pixel
  bool has_own_shadows = true;  ///< those that the scene casts on itself
  std::optional<double> exposure;  ///< default: unshadowed 99.5th percentile white for .png
  std::string spread;              ///< picture of the bounds' half distance; empty: none
  std::string truth_object;        ///< scene of the object itself; goes with `truth`
  std::string truth;               ///< ray-traced picture; empty: none
  std::string difference;          ///< picture, four times brighter; empty: none
  PipelineSettings settings;
};

/// One capture's clean plate of one plane.
struct ShadowPlate {
  double scale = 0.0;           ///< g of T = g B: light transport matrix, clean plate
  double known_fraction = 0.0;  ///< of the plane picture
};

/// A plane that several captures show: fractions of its picture.
struct JoinedPlane {
  std::vector<double> known_fractions;  ///< known by each capture
  double known_fraction = 0.0;          ///< by any of them
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

/// The hull that casts the shadow where the pictures do not tell.
struct ShadowFromHull {
  HullSummary hull;
  std::string file;       ///< where it is kept; empty: not
  bool is_carved = true;  ///< now; false: read
};

struct ShadowSummary {
  ReprojectReport reprojected;
  std::optional<ShadowFromHull> hull;  ///< of the methods that need one
  std::size_t n_planes = 0;
  /// One per capture and plane; empty if no light is on.
  std::vector<ShadowPlate> plates;
  std::vector<JoinedPlane> joined;         ///< planes that several captures show
  std::optional<double> missing_fraction;  ///< of an environment, where the rig has no lights
  std::string layout;                      ///< of the environment; empty: none
  double exposure = 1.0;
  std::optional<ShadowObject> object;
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
