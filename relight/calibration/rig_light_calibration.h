// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/light_stack.h"
#include "relight/calibration/near_calibration.h"
#include "relight/calibration/sheet_layout.h"
#include "relight/calibration/sheet_model.h"

/// @file
/// The lights of a rig from a session of a flat matte sheet on its shadow plane: each face as a
/// rigid array, starting from its pose in the rig file. Frames: docs/reference/rig-file.md;
/// method and errors: docs/numerics/near-light.md.

namespace haarlight::relight {

struct SheetOptions {
  /// Nothing: the middle four fifths of the plane's extent.
  std::optional<SheetRegion> region;
  double height_mm = 0.0;  ///< of the sheet over the plane: its thickness
  int samples = 48;        ///< approximate number of blocks along the longer side
};

/// Block averages of the session's pictures, in the plane's frame (x along u, y along v, z
/// along n, origin at the plane's). Blocks not wholly on the sheet are masked, as are samples
/// with a clipped pixel.
struct SheetSamples {
  TargetSamples samples;
  Eigen::Isometry3d world_from_sheet = Eigen::Isometry3d::Identity();
  int block = 1;                ///< pixels along a block's side
  double relative_noise = 0.0;  ///< of a block, median of all samples
};
/// @param error  standard errors of the stack, -1 where clipped; null: clipping is unknown, and
///               the noise is estimated from neighbouring pixels
/// @param rig  its first camera took the pictures, its first plane carries the sheet
/// @throws Error  a stack of different pictures, a sheet that fills fewer than 6 x 6 blocks
[[nodiscard]] SheetSamples sample_sheet(const Rig& rig, const LightStack& stack,
                                        const LightStack* error,
                                        const SheetOptions& options = {});

/// The samples of some lights, in their order.
[[nodiscard]] TargetSamples samples_of(const TargetSamples& all, int first, int n_lights);

struct FaceCalibration {
  int face = 0;
  LightCalibration lights;
  Eigen::Isometry3d world_from_face = Eigen::Isometry3d::Identity();  ///< x u, y v, z -emits
  /// Of turn (rad) and shift (mm), about the world's axes.
  Eigen::Matrix<double, 6, 6> pose_world = Eigen::Matrix<double, 6, 6>::Zero();
  double moved_mm = 0.0;  ///< displacement of the middle from the rig file's pose
  double turned_deg = 0.0;
};

/// Uncertainties of a sheet of matte paper under this rig's first camera (matte_paper()), and
/// of its first plane, if measured: its height and its tilt.
[[nodiscard]] SheetPriors sheet_priors(const Rig& rig, const SheetSamples& sheet);

/// Every face of the rig, with emitters of the rig file's size. Powers of all faces share one
/// scale: their mean is 1.
/// @throws Error  naming the face that cannot be calibrated
[[nodiscard]] std::vector<FaceCalibration> calibrate_faces(const Rig& rig,
                                                           const SheetSamples& sheet,
                                                           const CalibrationOptions& options);

}  // namespace haarlight::relight
