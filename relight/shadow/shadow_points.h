// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "relight/shadow/occluder.h"
#include "relight/shadow/shadow_lookup.h"

/// @file
/// The captured shadow at many points: irradiance
///
///     E(v) = sum_k w_k E_k(v) V_k(p_k(v))
///
/// at a million receivers under a thousand lights. Exact: every light. With a tolerance: blocks
/// of lights (light_tree.h) replace their members wherever refining a block changes its
/// contribution by less than a threshold; the threshold is found on a few thousand receivers
/// that are also computed exactly, and the error measured there is in the report. Where blocks
/// would not take clearly less than the exact sums, the result is exact. Method, cost
/// and guarantees: docs/numerics/shadow.md, "At scale".

namespace haarlight::relight {

/// Where visibility comes from.
enum class ShadowMethod {
  plane,  ///< shadow pictures alone; hidden points are unknown
  hull,   ///< the occluder alone
  both,   ///< shadow pictures where they are known and the receiver is on or below the plane,
          ///< elsewhere the occluder
};
inline constexpr auto kShadowMethodWords =
    std::to_array<std::string_view>({"plane", "hull", "both"});
constexpr std::span<const std::string_view> words_of(ShadowMethod) {
  return kShadowMethodWords;
}

struct PointsOptions {
  WindowRule rule = WindowRule::corrected;
  ShadowMethod method = ShadowMethod::plane;
  const Occluder* occluder = nullptr;  ///< of the methods that need one
  bool has_spread = false;             ///< fill PointTotal::spread: nine times the look-ups
  /// Tolerance of the receivers' irradiance, all colours; worst_pixel: largest error of a
  /// receiver's colour as a fraction of the largest value. 0 (the L2 error): exact. Infinity:
  /// no limit.
  Tolerance tolerance{.relative_l2 = 0.0,
                      .worst_pixel = std::numeric_limits<double>::infinity()};
  /// Receivers that are computed exactly to find the threshold: at most these, an eighth of all,
  /// but 2048 if this is not less. With twice as many or fewer receivers as this, all are
  /// computed exactly.
  int n_checked = 4096;
  /// The scene's own shadows on the receivers; null: none.
  const render::RayCaster* own_shadows = nullptr;
  /// Memory for tables of shadow pictures; at least one light's are held. Exact results do not
  /// depend on it; with a tolerance it bounds the blocks' size, and where the tables of all
  /// blocks don't fit, pictures are requested twice, or the result is exact (SamplingPlane).
  std::uint64_t memory_bytes = std::uint64_t{1} << 30U;
  ProgressStyle progress = ProgressStyle::none;
};

/// One receiver's sums over all lights.
struct PointTotal {
  Eigen::Vector3d shadowed = Eigen::Vector3d::Zero();    ///< RGB irradiance
  Eigen::Vector3d unshadowed = Eigen::Vector3d::Zero();  ///< the same with V = 1
  /// Distance to the farther bound of what was not seen and of the object's heights.
  Eigen::Vector3d unseen = Eigen::Vector3d::Zero();
  /// The same with what resolution and noise leave open; only on request.
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();  ///< of `shadowed`: noise and coding
  // Sums of w E, mean of the colours: the total, and the parts that the report distinguishes.
  double light = 0.0;
  double above = 0.0;
  double below = 0.0;
  double on = 0.0;
  double no_point = 0.0;
  double unknown = 0.0;
  double outside = 0.0;
  double from_occluder = 0.0;
  double widening = 1.0;
};

struct PointsReport {
  int n_lights = 0;      ///< of non-zero weight
  bool is_exact = true;  ///< every light was looked up at every receiver
  /// Measured on `n_checked` receivers against their exact values; 0 if everything is exact.
  Achieved achieved;
  double relative_l2_limit = 0.0;  ///< achieved error and three standard errors or more
  std::int64_t n_checked = 0;
  double threshold = 0.0;  ///< per block, relative to the receivers' rms irradiance; 0: exact
  int block_side = 0;      ///< lights per side of the largest block
  double lookups_a_point = 0.0;    ///< look-ups of shadow pictures
  std::uint64_t table_bytes = 0;   ///< peak memory of the tables
  std::uint64_t totals_bytes = 0;  ///< of the receivers' sums
  VisibilityCount count;           ///< of the shadow pictures
};

struct PointsResult {
  std::vector<PointTotal> totals;  ///< one per receiver
  PointsReport report;
};

/// Receivers behind a light or turned away from it get nothing from it.
/// @param planes   one or more; each one's pictures are requested light by light from this
///                 thread in the order of visiting_order(), once each; with a tolerance those
///                 whose tables are not kept once more
/// @param weights  one RGB weight per light; zero ones are not requested. With a negative
///                 weight or fewer than 32 lights everything is exact.
/// The result does not depend on the number of threads.
[[nodiscard]] PointsResult shadow_at_points(std::span<const render::SurfacePoint> receivers,
                                            std::span<const SamplingPlane> planes,
                                            std::span<const render::SquareLight> lights,
                                            std::span<const Eigen::Vector3d> weights,
                                            const PointsOptions& options = {});

/// The lights of non-zero weight in the order in which their pictures are requested.
[[nodiscard]] std::vector<int> visiting_order(std::span<const render::SquareLight> lights,
                                              std::span<const Eigen::Vector3d> weights);

}  // namespace haarlight::relight
