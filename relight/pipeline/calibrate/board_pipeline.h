// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/picture/chessboard.h"
#include "core/report.h"
#include "core/rig/measured_rig.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// A rig's lens and its shadow plane from pictures of a printed chessboard: found, fitted
/// (core/picture/chessboard.h), shown on a page with every corner's residual, and kept in
/// NAME.measured.toml next to the rig file.

namespace haarlight::relight {

struct BoardOptions {
  std::string rig;                    ///< the rig file
  std::vector<std::string> pictures;  ///< of that camera, neither cut nor scaled
  Chessboard board{9, 6, 20.0};       ///< 3 to 100 inner corners per side
  std::string camera;                 ///< id; empty: the first
  std::string page;  ///< empty: NAME.camera.html or NAME.plane.html next to the rig file
  PipelineSettings settings;
};

struct CameraBoardSummary {
  CameraFit fit;
  int n_views = 0;  ///< pictures that show the whole board
  std::string page;
  std::uint64_t bytes = 0;          ///< of the measured file
  std::vector<PipelineNote> notes;  ///< all messages
};

struct PlaneBoardSummary {
  MeasuredPlane plane;
  double distance_mm = 0.0;  ///< from the camera
  double moved_deg = 0.0;    ///< from the rig file's
  int n_views = 0;
  std::string page;
  std::uint64_t bytes = 0;
  std::vector<PipelineNote> notes;
};

/// The lens: K and distortion with uncertainties.
/// @throws Error  no such camera, pictures of another size, too few whole boards, a page that
///                exists
[[nodiscard]] CameraBoardSummary calibrate_camera(const BoardOptions& options);

/// The first plane, from one or more pictures of a board that lies on it; the lens as currently
/// known, the camera's pose as written.
/// @throws Error  the same; a rig without a plane; a camera that sees the plane's back
[[nodiscard]] PlaneBoardSummary calibrate_plane(const BoardOptions& options);

/// The achieved values.
void add_to_report(const CameraBoardSummary& summary, Report& report);
void add_to_report(const PlaneBoardSummary& summary, Report& report);

}  // namespace haarlight::relight
