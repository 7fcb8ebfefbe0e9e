// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "relight/calibration/mirror_ball.h"
#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Mirror balls in the pictures of lights: masked or detected, with each light's highlight.

namespace haarlight::relight {

/// The highlights of each light on each circle, and why any is missing.
struct BallHighlights {
  std::vector<std::vector<std::optional<BallHighlight>>> at;  ///< (K, B)
  std::vector<std::string> why;                               ///< (K), the last ball's
};

/// Balls of the masks, or found among the pictures' circles.
struct SeenBalls {
  std::vector<MeasuredBall> balls;
  BallHighlights highlights;
  Image<float> mean;  ///< of all pictures
};

/// Two passes over the pictures.
/// @throws Error  a mask that does not fit; no ball, a different number than requested, or
///                circles that rival each other
[[nodiscard]] SeenBalls see_balls(const CalibratePipelineOptions& options,
                                  const LightPictures& pictures);

/// How many highlights a ball shows, and how far they wander.
/// @param ball  its index
[[nodiscard]] BallEvidence evidence_of(const BallHighlights& highlights, std::size_t ball);

/// The pictures' mean with the circles (green) and the highlights (red) drawn in.
[[nodiscard]] Image<float> drawn_balls(const SeenBalls& seen);

/// "a circle about (x, y) of radius r", pixels.
[[nodiscard]] std::string circle_text(const PictureCircle& circle);

}  // namespace haarlight::relight
