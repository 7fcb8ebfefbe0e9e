// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/square_light.h"

/// @file
/// Unoccluded irradiance of one plane from many rectangular lights: as light_irradiance(), for
/// points that share their normal. A distant light fully above the horizon needs few Gauss
/// points, and those of a rectangle share their Jacobian; their number is chosen by a bound on
/// the rule's error. Near lights, or those cut by the horizon, use light_irradiance() itself.
/// Error, cost: docs/numerics/relight.md, "What a plate costs".

namespace haarlight::render {

class PlaneIrradiance {
 public:
  static constexpr int kMaxNodes = 8;

  /// @param lights     at finite positions; borrowed for the call only
  /// @param normal     unit: the lit side
  /// @param d          normal.x + d = 0 on the plane
  /// @param tolerance  relative error of each light's irradiance, as bounded by rule_error();
  ///                   at least 1e-13
  PlaneIrradiance(std::span<const SquareLight> lights, const Eigen::Vector3d& normal, double d,
                  double tolerance);

  /// @param point  on the plane
  /// @param out    (n_lights,) irradiance; a light of radiance 1 gives at most pi
  /// Pure; safe from any thread.
  void evaluate(const Eigen::Vector3d& point, std::span<double> out) const;

  /// Bound on the relative error of n x n Gauss points on a rectangle whose half diagonal is
  /// `radius` and whose every point is at least `distance` away, for a lobe cos^mu.
  /// @param slant  change of n.r over the rectangle, relative to its mean: 0 where light
  ///               and plane are parallel, at most 1 if the whole light is above the plane
  [[nodiscard]] static double rule_error(int n, double radius, double distance, double mu,
                                         double slant);

 private:
  struct Light {
    SquareLight square;
    Eigen::Vector3d half_u;
    Eigen::Vector3d half_v;
    double uv = 0.0;      ///< half_u . half_v
    double scale = 0.0;   ///< radiance times area
    double radius = 0.0;  ///< half diagonal
    double slant = 0.0;   ///< as rule_error() takes it
    bool is_whole = false;
    /// The smallest distance at which n Gauss points per axis suffice.
    std::array<double, kMaxNodes + 1> reach{};
  };

  [[nodiscard]] double irradiance(const Light& light, const Eigen::Vector3d& point) const;

  Eigen::Vector3d normal_;
  std::vector<Light> lights_;
};

}  // namespace haarlight::render
