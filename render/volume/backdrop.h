// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include <Eigen/Core>

#include "haarlight/core/image.h"

/// @file
/// What is seen through a medium: a background at no distance, or surfaces that have a depth.

namespace haarlight::render {

enum class BackgroundKind : std::uint8_t {
  colour,    ///< everywhere the same
  gradient,  ///< from the picture's top to its bottom
  checker,   ///< squares of two colours, the first in the top left corner
  picture,   ///< of the size of the picture that is rendered
};

/// Linear light, RGB.
struct Background {
  BackgroundKind kind = BackgroundKind::colour;
  Eigen::Array3d colour =
      Eigen::Array3d::Zero();  ///< or the gradient's top, the checker's first
  Eigen::Array3d other =
      Eigen::Array3d::Zero();  ///< the gradient's bottom, the checker's second
  int square_px = 1;           ///< side of the checker's squares
  std::filesystem::path file;
  Image<float> picture;  ///< (height, width, 1 or 3), finite
  std::string where;     ///< that names the file, for errors
};

/// Behind a pixel. A gradient has at the middle of row y the part (y + 1/2)/height of its bottom.
[[nodiscard]] Eigen::Array3d light_of(const Background& background, int x, int y, int height);

/// The largest absolute value of any of its pixels.
[[nodiscard]] double brightest_of(const Background& background);

/// Surfaces within the medium or behind it, as the same camera sees them: rays end there.
struct SurfacesBehind {
  std::filesystem::path file;
  Image<float> light;  ///< (height, width, 3), linear, finite
  Image<float>
      depth;  ///< (height, width, 1), mm along the camera's axis; kNoDepth or more: none
  std::string where;  ///< that names the file, for errors
};

/// The largest absolute value of any of its pixels.
[[nodiscard]] double brightest_of(const SurfacesBehind& surfaces);

/// Reads R, G, B and Z of an OpenEXR file.
/// @param where  that names it
/// @throws Error  as read_picture_with_depth(), at `where`; the first pixel whose depth is no number
[[nodiscard]] SurfacesBehind read_surfaces(const std::filesystem::path& file,
                                           const std::string& where);

/// Reads the picture of a background. @throws Error  as read_linear_image(), at `where`
void read_background(Background& background);

}  // namespace haarlight::render
