// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"

namespace haarlight::render {

/// Ideally diffuse: f = kd/pi above the surface, 0 below. All in the header: most surfaces are this.
struct Lambert {
  Eigen::Vector3d kd = Eigen::Vector3d::Zero();

  [[nodiscard]] bool is_black() const { return kd.isZero(0.0); }

  [[nodiscard]] Eigen::Vector3d evaluate(const Eigen::Vector3d& to_eye,
                                         const Eigen::Vector3d& to_light) const {
    return are_above(to_eye, to_light) ? Eigen::Vector3d(kd * std::numbers::inv_pi)
                                       : Eigen::Vector3d::Zero();
  }

  /// cos/pi
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const {
    return are_above(to_eye, to_light) ? to_light.z() * std::numbers::inv_pi : 0.0;
  }

  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double /*lobe*/,
                                  const Eigen::Vector2d& square) const {
    return sample(to_eye, cosine_direction(square));
  }
  /// @param cosine  a direction drawn from cos/pi
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye,
                                  const Eigen::Vector3d& cosine) const {
    const double density = this->density(to_eye, cosine);
    return {.is_found = density > 0.0 && !is_black(),
            .to_light = cosine,
            .weight = kd,  // kd/pi cos / (cos/pi)
            .density = density};
  }

  [[nodiscard]] Eigen::Vector3d near_diffuse_albedo(const Eigen::Vector3d& /*to_eye*/) const {
    return kd;
  }
  [[nodiscard]] static Eigen::Vector3d glossy(const Eigen::Vector3d& /*to_eye*/,
                                              const Eigen::Vector3d& /*to_light*/) {
    return Eigen::Vector3d::Zero();
  }
  /// kd, exact.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& /*to_eye*/) const {
    return kd.cwiseMin(1.0);
  }
};

}  // namespace haarlight::render
