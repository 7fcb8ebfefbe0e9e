// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/render/light/cubemap.h"

/// @file
/// Light weights with which a rig reproduces an environment, each light its cell of the sphere.
/// w_k = (integral over the light's cell of L dw) / G_k, G_k = irradiance of light k at weight
/// 1 at the object's centre on a surface facing it. Method, accuracy and cost:
/// docs/numerics/relight.md, "Weights".

namespace haarlight::relight {

struct EnvironmentWeights {
  Eigen::MatrixXd weights;           ///< (n_lights, 1 or 3)
  Eigen::MatrixXd cell_radiance;     ///< (n_lights, 1 or 3): integral of L over the cell
  Eigen::VectorXd cell_solid_angle;  ///< (n_lights): as integrated, sr
  Eigen::Vector3d total = Eigen::Vector3d::Zero();    ///< integral of L over the sphere
  Eigen::Vector3d missing = Eigen::Vector3d::Zero();  ///< of it, where the rig has no lights
  /// Fraction of the environment's energy (sum of the colours) that the rig cannot reproduce; 0
  /// for a black environment.
  double missing_fraction = 0.0;
  /// |sum of the cells + missing - total| / total. `missing` is measured on the faces'
  /// outlines, the cells one by one: anything lost or counted twice in cutting cells shows up
  /// here.
  double conservation_error = 0.0;
};

/// Cells are pitch x pitch around each LED and tile the face; seen from the rig's object
/// centre. Each texel is clipped exactly against the cells' planes. A face that emits away from
/// the object counts as missing.
/// @throws Error  two faces cover the same directions
/// @param turn_rad  by which the environment is turned about z, counter-clockwise from above
[[nodiscard]] EnvironmentWeights rig_weights(const render::Environment& environment,
                                             const Rig& rig, double turn_rad = 0.0);

/// Cells are the spherical Voronoi cells of the directions; G_k = 1, so T_k is the picture
/// under unit irradiance from light k. Nothing is missing: lights at the rim of a dome cover
/// what lies beyond them.
/// @param directions  unit, to the light; two equal ones share their cell
[[nodiscard]] EnvironmentWeights voronoi_weights(const render::Environment& environment,
                                                 const std::vector<Eigen::Vector3d>& directions,
                                                 double turn_rad = 0.0);

/// G_k of a light: radiance 1 along its normal.
[[nodiscard]] double facing_irradiance(const LightElement& light,
                                       const Eigen::Vector3d& object_centre);

}  // namespace haarlight::relight
