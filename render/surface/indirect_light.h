// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>

#include <Eigen/Core>

#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// What a surface shows of every light of a rig after one bounce or more, E(D|G)(D|G)+L: from one set
/// of paths for all lights. A path is followed by the BSDF; at each of its vertices DirectLight tells
/// of all lights at once, so that the lights themselves bring no noise.

namespace haarlight::render {

struct IndirectOptions {
  int bounces = 0;  ///< longer paths' light is left out; 0: direct light only
  int paths = 32;   ///< per pixel, an even number
};

class IndirectLight {
 public:
  /// Keeps references. @param direct  its lights are those that are asked
  IndirectLight(const Scene& scene, const RayCaster& caster, const DirectLight& direct,
                const IndirectOptions& options);

  [[nodiscard]] const IndirectOptions& options() const noexcept { return options_; }

  /// Which paths of a pixel, and how they count.
  struct Paths {
    int x = 0;  ///< the pixel
    int y = 0;
    int first = 0;
    int n = 0;  ///< even
    double weight = 1.0;
  };

  /// Adds weight times the mean over the even paths to one half, over the odd ones to the other: the
  /// mean of both is the estimate, their difference tells its error.
  /// @param surface  what the pixel shows, of a blinn_phong material
  /// @param colour   response to red, green, blue
  /// @param scratch, even, odd  (n_lights,)
  /// @return rays cast
  // NOLINTNEXTLINE(modernize-use-nodiscard): the halves are the result, the count a by-product
  std::uint64_t add(const SurfacePoint& surface, const Eigen::Vector3d& colour,
                    const Paths& paths, std::span<LightContribution> scratch,
                    std::span<double> even, std::span<double> odd) const;

 private:
  const Scene* scene_;
  const RayCaster* caster_;
  const DirectLight* direct_;
  IndirectOptions options_;
};

}  // namespace haarlight::render
