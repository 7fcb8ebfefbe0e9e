// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/ggx.h"

namespace haarlight::render {

/// A rough metal: microfacets (ggx.h) with the Fresnel reflectance of a conductor [Cook82].
struct Conductor {
  Ggx facets;
  Eigen::Vector3d eta = Eigen::Vector3d::Ones();  ///< complex index eta + i k, RGB
  Eigen::Vector3d k = Eigen::Vector3d::Zero();

  [[nodiscard]] static bool is_black() { return false; }
  [[nodiscard]] Eigen::Vector3d evaluate(const Eigen::Vector3d& to_eye,
                                         const Eigen::Vector3d& to_light) const;
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const;
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  /// That of a smooth surface of the metal: an upper estimate.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& to_eye) const;
};

}  // namespace haarlight::render
