// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "render/volume/curve.h"
#include "render/volume/segment_rule.h"
#include "render/volume/volume_scene.h"

/// @file
/// What rays gather, stretch by stretch from the eye on.

namespace haarlight::render {

/// The optical depth beyond which e^-x is 0 in doubles.
inline constexpr double kNoLight = 745.2;

struct PixelLight {
  Eigen::Array3d light = Eigen::Array3d::Zero();
  double opacity = 0.0;
  double transparency = 1.0;
};

/// A stretch of a ray within one cell: its ends' fields where they are linear.
struct Stretch {
  double length = 0.0;
  double density_near = 0.0;
  double density_far = 0.0;
  double colour_near = 0.0;
  double colour_far = 0.0;
};

/// What a rule other than the exact one did, and what bounds its error.
struct RuleCounts {
  std::uint64_t pieces = 0;      ///< into which segments were cut
  std::uint64_t terms = 0;       ///< points, or terms of series, that were evaluated
  std::uint64_t not_finite = 0;  ///< segments whose mean colour was taken instead
  std::uint64_t negative = 0;    ///< segments with a negative weight, taken as it is
  /// Of series: the largest of RuledWeights::relative_bound.
  double relative_bound = 0.0;
  double linear_peak = 0.0;    ///< of gauss: the largest RuledWeights::peak
  double curved_peak = 0.0;    ///< the same where fields bend, an upper bound of it
  double curved_excess = 1.0;  ///< the largest of that upper bound over the depth of its piece
  std::size_t density_degree = 1;  ///< the largest where fields bend
  std::size_t colour_degree = 1;

  void add(const RuleCounts& other);
};

/// By how much light may be off, over the most that a ray can gather; rounding included. Nothing:
/// the mode has no bound, or none below 1.
[[nodiscard]] std::optional<double> relative_bound(const VolumeRule& rule, Glow glow,
                                                   const RuleCounts& counts);

/// Of the pixels of a tile, one after the other.
class LightSum {
 public:
  /// @param most_depth  from the eye, behind which nothing has to be added: a ray that passes it has
  ///                    to end there
  LightSum(const VolumeScene& scene, std::size_t n_pixels, const VolumeRule& rule = {},
           double most_depth = std::numeric_limits<double>::infinity());

  void begin_ray(std::uint32_t pixel);
  /// Cut at the breakpoints of the transfer functions; each piece in closed form, or by the rule.
  void add(const Stretch& stretch);
  /// The same of fields that are polynomials: by Gauss' rules, within rounding.
  /// @param length    from s = 0 to 1 @param from, to  the part of it that is added
  void add(double length, const Curve& density, const Curve& colour, double from, double to);
  /// A surface that the ray passes.
  void add(const SurfaceLight& surface);
  /// What has been summed already.
  void add_summed(const PixelLight& sum);
  /// Of the ray so far.
  [[nodiscard]] double optical_depth() const noexcept { return depth_; }

  /// Once the last ray is done.
  [[nodiscard]] const std::vector<PixelLight>& finish();
  /// Pieces that were not empty.
  [[nodiscard]] std::uint64_t n_segments() const noexcept { return n_segments_; }
  /// Of a rule other than the exact one, once it is finished.
  [[nodiscard]] const RuleCounts& rule_counts() const noexcept { return rule_counts_; }

 private:
  /// Between breakpoints; its depths are in columns of their own.
  struct Piece {
    Eigen::Array3d near;  ///< colours at its ends; or the light of the whole
    Eigen::Array3d far;
    double length = 0.0;
    double opacity = -1.0;  ///< of one that is summed already; else -1
    double transparency = 1.0;
    std::uint32_t pixel = 0;
  };

  void add_linear_piece(double length, double rho_near, double rho_far,
                        const Eigen::Array3d& near, const Eigen::Array3d& far);
  void add_parts(double length, const Curve& density, const Curve& colour, double from,
                 double to);
  void add_part(double length, const Curve& density, const Curve& colour, double from,
                double to);
  void add_quadratic(double length, const Curve& density, const Curve& colour, double from,
                     double to);
  void add_smooth(double length, const Curve& density, const Curve& colour, double from,
                  double to);
  void composite();
  /// Of most_depth_ what the ray has not passed, and a little more: its end is then noticed.
  [[nodiscard]] double depth_left() const {
    constexpr double kMore = 1e-6;
    return std::max(most_depth_ - depth_, 0.0) + kMore;
  }

  // By a rule other than the exact one: light_sum_rules.cpp.
  struct CurvedPart;
  [[nodiscard]] bool is_unsliced() const {
    return rule_ && rule_->rule().mode == VolumeMode::approximate_unsliced;
  }
  void add_unsliced(const Stretch& stretch);
  void add_curved_by_rule(double length, const Curve& density, const Curve& colour, double from,
                          double to);
  void add_ends(const CurvedPart& part);
  void add_in_one_piece(const CurvedPart& part);
  void add_in_pieces(const CurvedPart& part);
  void composite_by_rule();

  const VolumeScene& scene_;
  bool is_glowing_;
  std::optional<SegmentRule> rule_;  ///< none: exact
  double most_depth_;
  RuleCounts rule_counts_;
  std::vector<PixelLight> light_;
  std::uint64_t n_segments_ = 0;
  std::uint32_t pixel_ = 0;
  double depth_ = 0.0;
  std::size_t density_part_ = 0;  ///< where the last stretch ended
  std::size_t colour_part_ = 0;
  std::vector<double> splits_;
  std::vector<double> cuts_;
  // Pieces that are not composited yet.
  std::vector<double> depths_near_;
  std::vector<double> depths_far_;
  std::vector<Piece> pieces_;
  std::array<std::vector<double>, 5> weights_;
};

}  // namespace haarlight::render
