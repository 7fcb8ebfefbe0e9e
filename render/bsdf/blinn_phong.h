// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"

namespace haarlight::render {

/// Lambert plus normalised Blinn-Phong: f = kd/pi + ks (n + 8)/(8 pi) (n.h)^n above the surface, 0
/// below. Reciprocal. May reflect more than it receives where kd + ks is near 1, seen from above.
struct BlinnPhong {
  Eigen::Vector3d kd = Eigen::Vector3d::Zero();
  double ks = 0.0;
  double exponent = 1.0;

  [[nodiscard]] bool is_black() const { return kd.isZero(0.0) && ks == 0.0; }
  [[nodiscard]] Eigen::Vector3d evaluate(const Eigen::Vector3d& to_eye,
                                         const Eigen::Vector3d& to_light) const;
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const;
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  [[nodiscard]] Eigen::Vector3d near_diffuse_albedo(const Eigen::Vector3d& /*to_eye*/) const {
    return kd;
  }
  [[nodiscard]] Eigen::Vector3d glossy(const Eigen::Vector3d& to_eye,
                                       const Eigen::Vector3d& to_light) const;
  /// kd + ks, at most 1.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& to_eye) const;
};

}  // namespace haarlight::render
