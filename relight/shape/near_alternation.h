// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "core/image.h"
#include "relight/light/near_light.h"
#include "relight/shape/fit_choice.h"
#include "relight/shape/integrate_normals.h"
#include "relight/shape/light_nearness.h"
#include "relight/shape/part_heights.h"
#include "relight/shape/photometric_stereo.h"

/// @file
/// A capture's surface: normals, heights and points. Under near lights the normals need the
/// points and the points the normals: begin on the reference plane, and go round until the
/// points stand still (Huang et al., section V.B). Gauge: each connected part's mean height
/// above the reference plane is 0, unless it is asked of the lights' fall-off; normals do not
/// tell how far it really is.

namespace haarlight {

struct ShapeOptions {
  StereoOptions stereo{};
  IntegrateOptions integrate{};
  int max_rounds = 20;  ///< near lights; 1: the plane's points once
  /// Rms change of the heights, of the picture's width; more where the normals' standard
  /// errors, if asked for, make more of it.
  double tolerance = 1e-4;
  /// Choose method and loss of the fit by lights held out (fit_choice.h).
  bool chooses_fit = false;
  /// Near lights: where each part stands, by their fall-off (part_heights.h).
  bool finds_part_heights = false;
  /// Near lights: rounds before the last use so many of the lights; their answer is refined.
  int n_coarse_lights = 128;
};

struct Shape {
  SurfaceEstimate surface;  ///< normals in the lights' frame
  HeightMap map;            ///< as integrated in the last round: mm, or ln D of a camera
  Image<float> height;      ///< (height, width) mm above the reference plane; 0 where unknown
  Image<float> points;      ///< (height, width, 3) mm, the lights' frame
  std::vector<double> changes;  ///< rms change of the heights in each round, mm
  double bow_mm = 0.0;          ///< largest minus smallest height
  bool is_settled = true;       ///< false: max_rounds came first
  /// The connected parts, largest first.
  std::vector<PartHeight> parts;
  LambertOptions fit{};          ///< what was used
  std::vector<FitScore> scores;  ///< where it was chosen: best first
  LightNearness nearness{};      ///< far lights with standard errors: in those already
};

/// @throws Error  as photometric_stereo()
[[nodiscard]] Shape recover_shape(const StackSource& stack, const StereoLights& lights,
                                  const PixelPoints& pixels, ImageView<const std::uint8_t> mask,
                                  const ShapeOptions& options = {});

/// Heights and points of a surface whose normals are given, once.
[[nodiscard]] Shape shape_of(SurfaceEstimate surface, const PixelPoints& pixels,
                             const IntegrateOptions& options = {});

}  // namespace haarlight
