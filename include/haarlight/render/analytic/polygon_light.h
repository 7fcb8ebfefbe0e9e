// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>

#include <Eigen/Core>

#include "haarlight/core/error.h"
#include "haarlight/render/light/square_light.h"

/// @file
/// Noise-free irradiance from flat emitters. A Lambertian polygon has Lambert's closed form
/// [Lambert1760], E = L/2 sum_i theta_i n.g_i, after clipping at the receiver's horizon; it
/// loses digits when the light is small or grazing, so beyond a switch-over point
/// Gauss-Legendre quadrature over the clipped polygon replaces it (converging geometrically
/// there). Lobes cos^(mu - 1) have no closed form: quadrature throughout, refined near the
/// light. Accuracy: 1e-12 relative on tests/golden/transport.json; docs/reference/simulator.md
/// has the table.

namespace haarlight::render {

/// A result and its own estimate of the absolute error.
struct Irradiance {
  double value = 0.0;
  double error = 0.0;
};

/// Irradiance at `point` on a surface of normal `normal` from a planar convex polygon of
/// radiance 1 that emits from both sides alike.
/// @param vertices  world, in order around the polygon, 3 or more
/// @param normal    unit
/// Pure; safe from any thread.
[[nodiscard]] Irradiance polygon_irradiance(std::span<const Eigen::Vector3d> vertices,
                                            const Eigen::Vector3d& point,
                                            const Eigen::Vector3d& normal);

/// E_k: irradiance from one rectangular light, unoccluded; 0 behind the light.
/// Radiance towards the point is `radiance` cos^(mu - 1) of the angle to `emits`. Positions are
/// finite. Pure; safe from any thread.
[[nodiscard]] double light_irradiance(const SquareLight& light, const Eigen::Vector3d& point,
                                      const Eigen::Vector3d& normal);
[[nodiscard]] Irradiance light_irradiance_with_error(const SquareLight& light,
                                                     const Eigen::Vector3d& point,
                                                     const Eigen::Vector3d& normal);

/// Corners in the order (-u -v), (+u -v), (+u +v), (-u +v).
[[nodiscard]] std::array<Eigen::Vector3d, 4> light_corners(const SquareLight& light);

}  // namespace haarlight::render
