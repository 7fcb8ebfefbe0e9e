// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include <Eigen/Core>

/// @file
/// Numbers and vectors of 16 rays at once, as many as a packet has, for loops that become vectors.

namespace haarlight::render {

inline constexpr std::size_t kLanes = 16;
/// Plain, so that GCC makes vectors of loops over several of them.
struct alignas(64) Lanes {
  double values[kLanes];  // NOLINT(modernize-avoid-c-arrays)

  [[nodiscard]] double& operator[](std::size_t lane) { return values[lane]; }
  [[nodiscard]] double operator[](std::size_t lane) const { return values[lane]; }
};

struct VectorLanes {
  Lanes x;
  Lanes y;
  Lanes z;

  [[nodiscard]] Eigen::Vector3d operator[](std::size_t lane) const {
    return {x[lane], y[lane], z[lane]};
  }
  void put(std::size_t lane, const Eigen::Vector3d& vector) {
    x[lane] = vector.x();
    y[lane] = vector.y();
    z[lane] = vector.z();
  }
};

}  // namespace haarlight::render
