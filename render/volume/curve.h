// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

/// @file
/// A field along a ray within a cell: a polynomial over 0 <= s <= 1. Pure; safe from any thread.

namespace haarlight::render {

/// By its Chebyshev coefficients: c_0 + c_1 T_1(2 s - 1) + ...
class Curve {
 public:
  static constexpr std::size_t kPoints = 9;  ///< that make one of degree 8 or less
  /// Where those are: cos(pi i/8), from s = 0 to s = 1.
  [[nodiscard]] static const std::array<double, kPoints>& points();

  Curve() = default;
  [[nodiscard]] static Curve linear(double at_0, double at_1);
  /// Through three values: exact for degree 2. Of degree 1 where that is true but for rounding.
  [[nodiscard]] static Curve quadratic(double at_0, double at_half, double at_1);
  /// Through values at points(). @param noise  that they are off by; coefficients below it are left
  ///                                             out
  [[nodiscard]] static Curve through(const std::array<double, kPoints>& values, double noise);

  [[nodiscard]] double operator()(double s) const;
  [[nodiscard]] double slope(double s) const;
  [[nodiscard]] std::size_t degree() const noexcept { return degree_; }
  /// The larger of the last two coefficients of one through points(): what is left out is about as large.
  [[nodiscard]] double tail() const noexcept { return tail_; }

  /// Numbers 0 < s < 1 between which, and 0 and 1, it only rises or only falls; added to `splits`.
  void add_turns(std::vector<double>& splits) const;

 private:
  void add_turns_between(const Curve& part, double from, double to, int n_halvings,
                         std::vector<double>& splits) const;
  [[nodiscard]] Curve resampled(double from, double to) const;
  [[nodiscard]] double turn_between(double low, double high) const;

  std::array<double, kPoints> c_{};
  std::size_t degree_ = 0;
  double tail_ = 0.0;
  double noise_ = 0.0;  ///< of its values
};

/// Where a curve that only rises or only falls from `from` to `to` has a value between its values
/// there: to rounding.
[[nodiscard]] double crossing_of(const Curve& curve, double value, double from, double to);

}  // namespace haarlight::render
