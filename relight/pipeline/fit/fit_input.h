// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/picture/picture_facts.h"
#include "haarlight/session/session.h"
#include "relight/pipeline/fit/fit_pipeline.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/reflectance/fit/picture_rows.h"

/// @file
/// A capture as input to fits: rows of pictures and a direction for each, from a session, or
/// from a folder of pictures and a list of lights.

namespace haarlight::relight {

struct FitInput {
  std::unique_ptr<session::Session>
      session;                        ///< which `rows` borrows; null: a folder of pictures
  std::unique_ptr<PictureRows> rows;  ///< of linear light for near lights of a session
  /// (n_lights), unit, to the light: x right, y up, z to the camera.
  std::vector<Eigen::Vector3d> directions;
  PictureFacts photographed;  ///< facts on which all pictures agree
};

/// @throws Error(usage)  a session cropped; a rectangle that extends beyond the pictures
/// @throws Error  as Session::open, read_light_file, match_pictures and picture_rows
[[nodiscard]] FitInput open_fit_input(const FitOptions& options, PipelineNotes& notes);

}  // namespace haarlight::relight
