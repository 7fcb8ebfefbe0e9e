// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// An environment as a light: directions are drawn by its texels' light.

namespace haarlight::render {

/// The scene's, turned as it asks; nothing where it has none.
/// @throws Error  as Environment::read
[[nodiscard]] std::optional<Environment> read_environment(const Scene& scene);

struct EnvironmentDirection {
  Eigen::Vector3d direction;  ///< unit
  Eigen::Vector3d radiance;
  double density = 0.0;  ///< per sr
};

/// A texel is drawn with the probability of its fraction of the light (radiance, mean over the
/// colours, times solid angle), a direction within it evenly. So the density is the radiance over
/// the light of all directions, but that within a cube's texel it is even on the picture.
class EnvironmentLight {
 public:
  /// Keeps a reference. @param scale  of the environment's radiance
  EnvironmentLight(const Environment& environment, double scale);

  /// Memory for its tables and the environment itself.
  [[nodiscard]] static std::uint64_t bytes_needed(const Environment& environment);

  /// Radiance over all directions, mean over the colours, times sr. 0: a black environment.
  [[nodiscard]] double total() const noexcept { return total_; }

  /// @param square  in [0, 1)^2. The environment must not be black.
  [[nodiscard]] EnvironmentDirection sample(const Eigen::Vector2d& square) const;
  /// With which `sample` finds a direction, per sr. @param direction  unit
  [[nodiscard]] double density(const Eigen::Vector3d& direction) const;
  [[nodiscard]] Eigen::Vector3d radiance(const Eigen::Vector3d& direction) const;

 private:
  [[nodiscard]] double density(const EnvironmentPosition& position) const;

  const Environment* environment_;
  double scale_;
  double total_ = 0.0;
  std::vector<double> rows_;  ///< light of the rows up to and with each
  std::vector<double>
      texels_;  ///< (rows, columns), of each row: of the texels up to and with it
};

}  // namespace haarlight::render
