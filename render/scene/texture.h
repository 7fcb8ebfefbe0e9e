// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <Eigen/Core>

#include "haarlight/core/image.h"

/// @file
/// A picture over a surface, in memory. docs/decisions/0012-textures-in-memory.md says why it is no
/// library's.

namespace haarlight::render {

/// Periodic in u and v; thread-safe. v = 0 is the lower edge of the picture's bottom row, v = 1 the
/// upper edge of its top row, u = 0 the left edge of its first column: the centre of the texel at
/// column i, row j (from the top) of w x h is at u = (i + 0.5) / w, v = 1 - (j + 0.5) / h.
class Texture {
 public:
  /// @param picture  (h, w, 1 or 3), linear, within 0..1, one texel or more
  explicit Texture(Image<float> picture);

  /// Bilinear between the centres of the four nearest texels, at the picture's own resolution:
  /// nothing is filtered over a pixel's footprint, which a renderer's samples average. Within
  /// half a texel of a side the opposite side's texels take part.
  /// @param uv  finite @return RGB, within 0..1
  [[nodiscard]] Eigen::Vector3d at(const Eigen::Vector2d& uv) const;

  /// Of size and texels: 32 hexadecimal digits.
  [[nodiscard]] const std::string& hash() const noexcept { return hash_; }

 private:
  Image<float> picture_;
  std::string hash_;
};

}  // namespace haarlight::render
