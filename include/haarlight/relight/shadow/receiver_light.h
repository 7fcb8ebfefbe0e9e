// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Irradiance of square lights at receivers, unoccluded, fast where the light subtends a small
/// angle. Divided by the light's radiance. Pure.

namespace haarlight::relight {

/// E_k / radiance: exact near the light, four Gauss points where it is ten sides away or more
/// and wholly above the receiver's horizon (relative error below 1e-6 there; render/analytic
/// has the exact form). 0 behind the light.
[[nodiscard]] double receiver_irradiance(const render::SquareLight& light,
                                         const Eigen::Vector3d& point,
                                         const Eigen::Vector3d& normal);

/// The four points for a light of any size: a block of lights.
[[nodiscard]] double block_irradiance(const render::SquareLight& light,
                                      const render::SurfacePoint& at);

/// Receivers, each coordinate in an array of its own.
struct PointRows {
  std::vector<double> px, py, pz;  ///< point
  std::vector<double> nx, ny, nz;  ///< shading normal

  void reserve(std::size_t n);
  void add(const render::SurfacePoint& at);
  [[nodiscard]] std::size_t size() const noexcept { return px.size(); }
};

/// receiver_irradiance at many; -1 where it must be evaluated individually (near, at the
/// horizon, a lobe other than Lambert's).
void irradiance_far(const render::SquareLight& light, const PointRows& rows,
                    std::span<double> out);

}  // namespace haarlight::relight
