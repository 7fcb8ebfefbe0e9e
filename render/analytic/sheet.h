// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>

#include <Eigen/Core>

#include "haarlight/render/light/square_light.h"

/// @file
/// Opaque rectangles that stand in each other's light and sight, in closed form: a rig's shadow
/// planes. Pure; safe from any thread.

namespace haarlight::render {

struct Sheet {
  Eigen::Vector3d corner = Eigen::Vector3d::Zero();
  Eigen::Vector3d side_u = Eigen::Vector3d::UnitX();  ///< to the next corner, mm
  Eigen::Vector3d side_v = Eigen::Vector3d::UnitY();  ///< perpendicular to it
};

/// How far along a ray the sheet is; infinity: the ray misses it.
/// @param direction  unit
[[nodiscard]] double distance_to(const Sheet& sheet, const Eigen::Vector3d& origin,
                                 const Eigen::Vector3d& direction);

/// Fraction of the light's area that the sheet hides from the point, 0..1: the light's rectangle
/// clipped by the pyramid from the point through the sheet's border. 0 from a point of the sheet.
[[nodiscard]] double hidden_fraction(const Sheet& sheet, const SquareLight& light,
                                     const Eigen::Vector3d& point);

/// What all sheets but one leave of the light, 0..1. Exact for one other sheet; where the shadows of
/// two overlap within the light, the overlap counts twice.
[[nodiscard]] double visible_fraction(std::span<const Sheet> sheets, std::size_t own,
                                      const SquareLight& light, const Eigen::Vector3d& point);

}  // namespace haarlight::render
