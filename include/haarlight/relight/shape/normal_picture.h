// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/image.h"

/// @file
/// Normals and albedo as pictures for viewing. Frame: x right, y up, z to the camera.

namespace haarlight::relight {

/// Each normal turned from one frame into another; zero ones (unknown) stay zero.
/// @param normals  (height, width, 3)
[[nodiscard]] Image<float> turned_normals(ImageView<const float> normals,
                                          const Eigen::Matrix3d& turn);

/// Linear values whose sRGB coding, as by write_image() for a .png, is (n + 1) / 2: the usual
/// normal map, R = x, G = y, B = z. Zero normals (unknown) become black.
[[nodiscard]] Image<float> normal_map(ImageView<const float> normals);

struct EnhancedLook {
  Eigen::Vector3d light{0.5, 0.5, 1.0};  ///< to the light; any length but 0
  double diffuse = 0.4;                  ///< fraction of the albedo's own colour
  double specular = 0.7;                 ///< white gloss
  double exponent = 30.0;                ///< its sharpness
};

/// The surface under one far light, albedo * diffuse * n.l + specular * (n.h)^exponent: the
/// "specular enhancement" of RTI viewers, here from measured normals. Reveals relief that
/// colour hides. Albedo is scaled so that its 99th percentile is 1.
/// @return  (height, width, 3) linear; unknown pixels black
[[nodiscard]] Image<float> enhanced_picture(ImageView<const float> normals,
                                            ImageView<const float> albedo,
                                            const EnhancedLook& look = {});

}  // namespace haarlight::relight
