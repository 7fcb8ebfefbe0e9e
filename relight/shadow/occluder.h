// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"

/// @file
/// What an object with a shape hides of a light: the interface for what computes it where shadow
/// pictures do not tell (relight/hull).

namespace haarlight::relight {

/// Visible fraction of a light, and its bounds.
struct OccluderLook {
  double value = 1.0;
  double low = 1.0;   ///< <= value
  double high = 1.0;  ///< >= value
};

class Occluder {
 public:
  Occluder() = default;
  virtual ~Occluder() = default;
  Occluder(const Occluder&) = delete;
  Occluder& operator=(const Occluder&) = delete;
  Occluder(Occluder&&) = delete;
  Occluder& operator=(Occluder&&) = delete;

  /// Called from several threads.
  /// @param point  world
  /// @param light  one light, or a block of lights taken as one
  [[nodiscard]] virtual OccluderLook look(const Eigen::Vector3d& point,
                                          const render::SquareLight& light) const = 0;

  /// What look() says of every light within a ball, if that is surely the same for all of them.
  [[nodiscard]] virtual std::optional<OccluderLook> look_at_all(const Eigen::Vector3d& point,
                                                                const Eigen::Vector3d& centre,
                                                                double radius_mm) const = 0;

  /// How finely its shape is known, mm.
  [[nodiscard]] virtual double resolution_mm() const = 0;
};

}  // namespace haarlight::relight
