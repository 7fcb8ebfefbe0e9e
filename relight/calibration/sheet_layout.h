// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/core/image.h"
#include "haarlight/relight/light/near_light.h"
#include "relight/calibration/target_samples.h"

/// @file
/// Where a flat sheet's blocks lie in the pictures, and its samples from one picture per light:
/// common to rigs and folders of pictures. Frame of the sheet: mm, z = 0 on it, +z to the
/// lights.

namespace haarlight::relight {

/// The sampled part of the sheet: a rectangle of the plane, mm along its u and v.
struct SheetRegion {
  double u0 = 0.0;
  double u1 = 0.0;
  double v0 = 0.0;
  double v1 = 0.0;
};

/// Square blocks of pixels, (rows x cols), that cover a region of the sheet.
struct SheetLayout {
  int width = 0;  ///< of the pictures
  int height = 0;
  int x0 = 0;  ///< first pixel of the first block
  int y0 = 0;
  int block = 1;  ///< pixels along a side
  int rows = 0;
  int cols = 0;
  std::vector<std::uint8_t> is_sheet;     ///< (height, width)
  std::vector<Eigen::Vector2d> position;  ///< (height, width), position on the sheet

  [[nodiscard]] std::size_t n_blocks() const {
    return static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols);
  }
};
/// @param samples  approximate number of blocks along the longer side
/// @throws Error  a region that fills fewer than 6 x 6 blocks
[[nodiscard]] SheetLayout lay_out_sheet(const PixelPoints& points, int width, int height,
                                        const Eigen::Isometry3d& sheet_from_world,
                                        const SheetRegion& region, int samples);

/// Positions, normals, directions to the camera and lens shifts, with no light yet. Blocks not
/// wholly on the sheet are masked.
[[nodiscard]] TargetSamples samples_without_light(const SheetLayout& layout,
                                                  const PixelPoints& points,
                                                  const CameraModel& camera,
                                                  const Eigen::Isometry3d& sheet_from_world,
                                                  int n_lights, int n_channels);

/// A camera `camera_mm` straight over the middle of a sheet, its pictures `width_mm` across:
/// frame as in PixelPoints::orthographic.
/// @param tilt  rad, its offset towards +x and +y; it still looks at the middle
[[nodiscard]] CameraModel camera_over_sheet(
    int width, int height, double width_mm, double camera_mm,
    const Eigen::Vector2d& tilt = Eigen::Vector2d::Zero());

/// The same samples as seen by another camera: positions, directions to the camera and lens
/// shifts are recomputed from the block centres.
[[nodiscard]] TargetSamples seen_from(TargetSamples samples, const SheetLayout& layout,
                                      const CameraModel& camera);

/// Block averages of one picture per light.
class SheetSampler {
 public:
  /// @param empty  samples_without_light() of this layout
  SheetSampler(SheetLayout layout, TargetSamples empty);
  /// @param picture  linear light, of the layout's size and the samples' channels
  /// @param clip  a block with a value at or above it is masked for this light
  void add(int light, ImageView<const float> picture, float clip);
  /// With the noise of a block as estimated by noise_between_lights().
  [[nodiscard]] TargetSamples finish() const;

 private:
  SheetLayout layout_;
  TargetSamples samples_;
};

/// The noise of samples on a grid, from the pictures alone: fourth differences, along rows and
/// columns, of the logarithm of two lights' ratio. The albedo, however patterned, cancels;
/// smooth light cancels to (block / distance)^4. Medians ignore dust and shadow edges. What is
/// the same in all pictures is not counted as noise.
/// @throws Error  fewer than 100 runs of five blocks lit by both of two lights
[[nodiscard]] SampleNoise noise_between_lights(const TargetSamples& samples);

}  // namespace haarlight::relight
