// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "haarlight/relight/shape/photometric_stereo.h"
#include "relight/shape/fit_choice.h"
#include "relight/shape/hull_parts.h"
#include "relight/shape/light_nearness.h"
#include "relight/shape/part_heights.h"

/// @file
/// A capture's surface: normals, heights and points. Under near lights the normals need the
/// points and vice versa: start on the reference plane and alternate until the points converge
/// (Huang et al., section V.B). Gauge: each connected part's mean height above the reference
/// plane is 0, unless found from the lights' fall-off or a shadow hull; normals do not determine
/// it.

namespace haarlight::relight {

struct ShapeOptions {
  StereoOptions stereo{};
  IntegrateOptions integrate{};
  int max_rounds = 20;  ///< near lights; 1: only the plane's points
  /// Rms change of the heights, relative to the picture's width; more if the normals' standard
  /// errors, if requested, imply more.
  double tolerance = 1e-4;
  /// Choose method and loss of the fit by held-out lights (fit_choice.h).
  bool chooses_fit = false;
  /// Near lights: find each part's height from their fall-off (part_heights.h).
  bool finds_part_heights = false;
  /// Near lights and a camera; borrowed, may be null: parts that the hull tells apart are placed
  /// apart, each within the hull.
  const HullBounds* hull = nullptr;
  /// Near lights: number of lights used before the last round, which refines the result.
  int n_coarse_lights = 128;
};

struct Shape {
  SurfaceEstimate surface;  ///< normals in the lights' frame
  HeightMap map;            ///< as integrated in the last round: mm, or ln D for a camera
  Image<float> height;      ///< (height, width) mm above the reference plane; 0 where unknown
  Image<float> points;      ///< (height, width, 3) mm, the lights' frame
  std::vector<double> changes;  ///< rms change of the heights in each round, mm
  double bow_mm = 0.0;          ///< largest minus smallest height
  bool is_settled = true;       ///< false: stopped by max_rounds
  /// The connected parts, largest first.
  std::vector<PartHeight> parts;
  int n_divided = 0;             ///< regions that the hull told apart, beside the first
  LambertOptions fit{};          ///< the options used
  std::vector<FitScore> scores;  ///< if chosen: best first
  LightNearness nearness{};      ///< far lights with standard errors: already included in those
};

/// @throws Error  as photometric_stereo()
[[nodiscard]] Shape recover_shape(const StackSource& stack, const StereoLights& lights,
                                  const PixelPoints& pixels, ImageView<const std::uint8_t> mask,
                                  const ShapeOptions& options = {});

/// Heights and points of a surface with given normals, without iteration.
[[nodiscard]] Shape shape_of(SurfaceEstimate surface, const PixelPoints& pixels,
                             const IntegrateOptions& options = {});

}  // namespace haarlight::relight
