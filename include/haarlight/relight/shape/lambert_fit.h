// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Core>

/// @file
/// One pixel's normal and albedo from its brightness under many lights: I_k = b.s_k with b =
/// albedo * normal [Woodham80], by least squares or robustly against shadows and highlights.
/// Accuracy on rendered captures and costs: docs/numerics/shape.md.

#include "haarlight/core/enum_words.h"

namespace haarlight::relight {

enum class LambertMethod {
  least_squares,  ///< every sample that is neither dark nor saturated
  trimmed,        ///< the samples that fit best: least trimmed squares [Rousseeuw84]
  m_estimator,    ///< iteratively reweighted least squares: bad samples count less
};
inline constexpr auto kLambertMethodWords =
    std::to_array<std::string_view>({"least-squares", "trimmed", "m-estimator"});
constexpr std::span<const std::string_view> words_of(LambertMethod) {
  return kLambertMethodWords;
}

/// The weight of a residual that is u scales large.
enum class RobustLoss {
  huber,   ///< min(1, c / u): convex, the result does not depend on the start
  cauchy,  ///< 1 / (1 + (u / c)^2)
  tukey,   ///< (1 - (u / c)^2)^2 below c, 0 above
};
inline constexpr auto kRobustLossWords =
    std::to_array<std::string_view>({"huber", "cauchy", "tukey"});
constexpr std::span<const std::string_view> words_of(RobustLoss) { return kRobustLossWords; }

struct LambertOptions {
  LambertMethod method = LambertMethod::trimmed;
  /// Samples at or below this fraction of the pixel's bright level (the value exceeded by a
  /// tenth of its samples, so that one highlight does not set it) are shadow: left out.
  double dark_fraction = 0.05;
  double dark_level = 0.0;  ///< likewise samples at or below this value
  double keep = 0.6;        ///< trimmed: fraction of the samples that count
  RobustLoss loss = RobustLoss::tukey;
  /// c; the scale is 1.4826 times the median |residual|. 0: huber 0.1, cauchy 0.5, tukey 3, by
  /// rendered captures with highlights (docs/numerics/shape.md).
  double loss_scales = 0.0;
  int max_rounds = 20;
  bool has_sigma = false;  ///< LambertFit::sigma_deg too
};

enum class PixelState : std::uint8_t {
  masked = 0,
  good = 1,
  too_dark = 2,   ///< fewer than three samples are lit: shadow, or a black surface
  saturated = 3,  ///< fewer than three samples are left because the others are clipped
  ambiguous = 4,  ///< the lights that reach it are coplanar: one component is unknown
};

struct LambertFit {
  Eigen::Vector3d b = Eigen::Vector3d::Zero();  ///< albedo * normal; 0 unless good
  double error = 0.0;                           ///< rms residual of the samples used, over |b|
  /// Standard error of the normal's direction (rms angle), degrees, 0 to 90: by leaving out one
  /// group of neighbouring lights after the other, by the common part of neighbours' residuals,
  /// and by the fit's distance from plain least squares. 90: nothing constrains the normal. 0
  /// if not requested. Measured against true normals: docs/numerics/shape.md.
  double sigma_deg = 0.0;
  int n_used = 0;
  PixelState state = PixelState::too_dark;
  /// Ambiguous: the unit direction along which b is undetermined.
  Eigen::Vector3d unknown = Eigen::Vector3d::Zero();
};

/// Below this ratio of the smallest to the largest eigenvalue of sum s s^T a direction is
/// unknown: lights within about half a degree of one plane.
inline constexpr double kAmbiguous = 1e-4;

/// The direction that lights at these unit directions leave undetermined; nothing if they
/// determine all three components.
[[nodiscard]] std::optional<Eigen::Vector3d> unknown_direction(
    const std::vector<Eigen::Vector3d>& directions);

struct SampleColumns;

/// Working memory for pixels with up to `n_lights` samples. One thread.
class LambertFitter {
 public:
  LambertFitter(int n_lights, const LambertOptions& options);

  /// Forgets the samples of the last pixel.
  void clear() noexcept {
    n_ = 0;
    n_clipped_ = 0;
  }
  void add(const Eigen::Vector3d& s, double value, int light) noexcept {
    x_[n_] = s.x();
    y_[n_] = s.y();
    z_[n_] = s.z();
    value_[n_] = value;
    light_[static_cast<std::size_t>(n_)] = light;
    ++n_;
  }
  /// All samples of a pixel, as lights 0, 1, 2 ..., but those where `is_left_out` is not 0.
  void add(std::span<const double> x, std::span<const double> y, std::span<const double> z,
           std::span<const double> value, std::span<const std::uint8_t> is_left_out);
  /// Samples that only say "at least this".
  void add_clipped(int n = 1) noexcept { n_clipped_ += n; }
  /// Samples whose `light` is in the same group are left out together for sigma_deg. They must
  /// be added group after group. @param group  of each light; without: every light is its own
  void set_groups(std::vector<int> group) { group_ = std::move(group); }
  [[nodiscard]] LambertFit fit();
  /// The median |residual| of the last good fit's lit samples, over |b|: insensitive to the
  /// other half.
  [[nodiscard]] double median_residual(const LambertFit& fit);
  /// The common part of neighbouring lights' residuals in the last good fit's lit samples, rms,
  /// in the values' unit: corrected for independent errors and for the fit's three degrees of
  /// freedom. 0: none significant.
  [[nodiscard]] double common_residual(const LambertFit& fit);
  /// Weight of sample i of the last fit, 0..1, and its light.
  [[nodiscard]] double weight(int i) const { return w_[i]; }
  [[nodiscard]] int light(int i) const { return light_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] int n_samples() const noexcept { return n_; }
  [[nodiscard]] Eigen::Vector3d direction(int i) const { return {x_[i], y_[i], z_[i]}; }

 private:
  struct Sums {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();  ///< sum w s s^T
    Eigen::Vector3d right = Eigen::Vector3d::Zero();   ///< sum w s value
  };
  [[nodiscard]] SampleColumns columns(int first, int n) const;
  [[nodiscard]] Sums sums(int first, int n) const;
  void accumulate();
  [[nodiscard]] int group_of(int i) const;
  [[nodiscard]] int end_of_group(int first) const;
  [[nodiscard]] double jackknife(const Eigen::Vector3d& b) const;
  [[nodiscard]] double common_square(const Eigen::Vector3d& b, Eigen::Matrix3d& matrix);
  [[nodiscard]] double common_error(const Eigen::Vector3d& b);
  [[nodiscard]] double sigma(const Eigen::Vector3d& b, const Eigen::Vector3d& plain);
  [[nodiscard]] bool solve(Eigen::Vector3d& b) const;
  void drop_dark();
  /// Into r_, and as floats into ranked_.
  void residuals(const Eigen::Vector3d& b);
  /// The value of that rank (0: the smallest) among the first n_ of ranked_.
  [[nodiscard]] float select(int rank) const;
  /// A limit within which n_wanted of them lie; more only where values are equal.
  /// @param guess, reach  searches guess - reach to guess + reach first, if both are > 0
  [[nodiscard]] float find_limit(int n_wanted, float guess = 0.0F, float reach = 0.0F) const;
  void trim(Eigen::Vector3d& b);
  [[nodiscard]] int update_kept(float most);
  void add_changed(int n_changed);
  void reweight(Eigen::Vector3d& b);

  LambertOptions options_;
  int n_ = 0;
  int n_clipped_ = 0;
  Eigen::ArrayXd x_, y_, z_, value_, w_, r_;
  Eigen::ArrayXf ranked_;                 ///< values to be ranked, >= 0
  Eigen::ArrayXd product_;                ///< b.s
  std::vector<std::uint8_t> kept_;        ///< trimmed: 1 where the sample counts
  std::vector<std::uint8_t> is_changed_;  ///< and 1 where it entered or left
  std::vector<int> changed_;              ///< indices of those that entered or left
  std::vector<int> light_;
  std::vector<int> group_;                            ///< of each light; empty: each its own
  Eigen::Matrix3d matrix_ = Eigen::Matrix3d::Zero();  ///< sum w s s^T
  Eigen::Vector3d right_ = Eigen::Vector3d::Zero();   ///< sum w s value
};

}  // namespace haarlight::relight
