// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"

/// @file
/// Ideal surfaces. Their lobes are deltas: evaluate() and density() are 0, directions come from
/// sample() alone.

namespace haarlight::render {

struct Mirror {
  Eigen::Vector3d reflectance = Eigen::Vector3d::Ones();

  [[nodiscard]] bool is_black() const { return reflectance.isZero(0.0); }
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& /*to_eye*/) const {
    return reflectance;
  }
};

/// A boundary between two dielectrics: reflects with the probability of its reflectance, else
/// refracts. Nothing is absorbed.
struct Dielectric {
  double ior = 1.5;  ///< of the other side over that of the side that is looked at

  [[nodiscard]] static bool is_black() { return false; }
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  /// Reflected and transmitted flux together: 1.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& /*to_eye*/) const {
    return Eigen::Vector3d::Ones();
  }
};

}  // namespace haarlight::render
