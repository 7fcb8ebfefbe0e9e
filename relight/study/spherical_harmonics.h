// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <vector>

#include <Eigen/Core>

#include "relight/basis/light_basis.h"

/// @file
/// Real spherical harmonics over the directions of a rig's lights. A rig covers part of the
/// sphere with finitely many lights: a pixel's coefficients are the least-squares fit to its
/// lights. That is a projection: what no harmonic up to the order can follow is lost, whatever
/// the number of bits.

namespace haarlight::relight {

/// Y_lm of a unit direction at index l (l + 1) + m, l <= order: orthonormal over the sphere, no
/// Condon-Shortley phase: Y_00 = 1/sqrt(4 pi), Y_1 = sqrt(3/(4 pi)) (y, z, x). By the stable
/// recurrence in l [Sloan08].
[[nodiscard]] std::vector<double> spherical_harmonics(const Eigen::Vector3d& direction,
                                                      int order);

/// Patterns: the harmonics sampled at the lights, orthonormalised one after the other
/// (Gram-Schmidt, twice), which leaves the fit unchanged. Functions that the lights cannot
/// distinguish from those before them (less than 1e-8 is new) are left out: n_coefficients()
/// counts the rest.
/// @param directions  unit, to each light
[[nodiscard]] std::unique_ptr<LightBasis> make_spherical_harmonics(
    const std::vector<Eigen::Vector3d>& directions, int order);

}  // namespace haarlight::relight
