// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "render/volume/segment_tables.h"

/// @file
/// The arithmetic of segment.h, for one segment and, called in a loop, for vectors of them: no branch
/// and no call, the same bits in both. a and b are the extinction at the near and the far end times
/// the length, >= 0; s = 0 at the near end, tau(s) = a s + (b - a) s^2/2.

namespace haarlight::render::segment {

/// With E = e^{-tau(s)} and rho = a + (b - a) s, integrals over s = 0..1.
struct Integrals {
  double near_k = 0.0;  ///< of (1 - s) rho E = 1 - P0
  double far_k = 0.0;   ///< of s rho E = P0 - T
  double near_g = 0.0;  ///< of (1 - s) E = P0 - P1
  double far_g = 0.0;   ///< of s E = P1
  double transparency = 0.0;
};

/// Up to which max(a, b) Gauss rules of 5, 8 and 10 points are within rounding of the integrals.
inline constexpr double kFivePointsUpTo = 0.01;
inline constexpr double kEightPointsUpTo = 0.69;  // 2 * 0.345: within exp_of_small()'s range
inline constexpr double kTenPointsUpTo = 2.0;

/// Points and weights of Gauss and Legendre's rule on 0..1.
template <std::size_t n>
struct GaussRule;
template <>
struct GaussRule<5> {
  static constexpr std::array<double, 5> kPoints = {0.046910077030668004, 0.23076534494715845,
                                                    0.5, 0.7692346550528415, 0.953089922969332};
  static constexpr std::array<double, 5> kWeights = {0.11846344252809454, 0.23931433524968324,
                                                     0.28444444444444444, 0.23931433524968324,
                                                     0.11846344252809454};
};
template <>
struct GaussRule<8> {
  static constexpr std::array<double, 8> kPoints = {
      0.019855071751231884, 0.10166676129318664, 0.2372337950418355, 0.4082826787521751,
      0.591717321247825,    0.7627662049581645,  0.8983332387068134, 0.9801449282487681};
  static constexpr std::array<double, 8> kWeights = {
      0.05061426814518813, 0.11119051722668724, 0.15685332293894363, 0.181341891689181,
      0.181341891689181,   0.15685332293894363, 0.11119051722668724, 0.05061426814518813};
};
template <>
struct GaussRule<10> {
  static constexpr std::array<double, 10> kPoints = {
      0.01304673574141414, 0.06746831665550775, 0.1602952158504878, 0.2833023029353764,
      0.4255628305091844,  0.5744371694908156,  0.7166976970646236, 0.8397047841495122,
      0.9325316833444922,  0.9869532642585859};
  static constexpr std::array<double, 10> kWeights = {
      0.03333567215434407, 0.0747256745752903,  0.10954318125799102, 0.13463335965499817,
      0.14776211235737644, 0.14776211235737644, 0.13463335965499817, 0.10954318125799102,
      0.0747256745752903,  0.03333567215434407};
};

/// 1 + r + r^2/2 + ... to r^n/n!.
template <std::size_t n>
[[nodiscard]] inline double taylor_exp(double r) {
  constexpr std::array<double, 15> kInverseFactorials = {1.0,
                                                         1.0,
                                                         1.0 / 2.0,
                                                         1.0 / 6.0,
                                                         1.0 / 24.0,
                                                         1.0 / 120.0,
                                                         1.0 / 720.0,
                                                         1.0 / 5040.0,
                                                         1.0 / 40320.0,
                                                         1.0 / 362880.0,
                                                         1.0 / 3628800.0,
                                                         1.0 / 39916800.0,
                                                         1.0 / 479001600.0,
                                                         1.0 / 6227020800.0,
                                                         1.0 / 87178291200.0};
  static_assert(n < kInverseFactorials.size());
  return [&]<std::size_t... i>(std::index_sequence<i...>) {
    double sum = kInverseFactorials[n];
    ((sum = sum * r + kInverseFactorials[n - 1 - i]), ...);
    return sum;
  }
  (std::make_index_sequence<n>());
}

/// e^r for |r| <= 0.35: what the series leaves out is below 5e-18.
[[nodiscard]] inline double exp_of_small(double r) { return taylor_exp<13>(r); }

/// e^{-x} for x >= 0, within 1.5 units of the last place; 0 where double has no number for it.
[[nodiscard]] inline double exp_of_minus(double x) {
  constexpr double kLog2E = 1.4426950408889634;
  constexpr double kLn2High = 0.6931467056274414;  // 21 bits: times n below it is exact
  constexpr double kLn2Low = 4.7493250390316726e-07;
  constexpr double kRound = 6755399441055744.0;  // 1.5 * 2^52: its last bits count ones
  constexpr double kLargest = 1400.0;            // beyond: 0 all the same
  const double bounded = std::min(x, kLargest);
  const double shifted = bounded * kLog2E + kRound;
  const double n = shifted - kRound;
  const double r = (n * kLn2High - bounded) + n * kLn2Low;
  const std::uint64_t whole = std::bit_cast<std::uint64_t>(shifted) & 0xFFFU;
  const std::uint64_t half = whole >> 1U;
  // 2^-n in two factors, neither below the smallest normal number.
  const auto first = std::bit_cast<double>((std::uint64_t{1023} - half) << 52U);
  const auto second = std::bit_cast<double>((std::uint64_t{1023} - (whole - half)) << 52U);
  return exp_of_small(r) * first * second;
}

/// The exponential over the range that the rule of n points is for: the series about its middle, and
/// for 10 points the square of that of half the argument.
template <std::size_t n>
[[nodiscard]] inline double exp_for_rule(double tau) {
  if constexpr (n == 5) {
    return taylor_exp<6>(-tau);  // 0.01^7/7!: 2e-18
  } else if constexpr (n == 8) {
    constexpr double kMiddle = 0.345;
    constexpr double kExpOfMinusMiddle = 0.7082203534678;
    return kExpOfMinusMiddle * exp_of_small(kMiddle - tau);
  } else {
    constexpr double kExpOfMinusOne = 0.36787944117144233;
    const double root = taylor_exp<14>(0.5 - 0.5 * tau);  // 0.5^15/15!: 2e-17
    return kExpOfMinusOne * root * root;
  }
}

/// Each integral of its own integrand, which is nowhere negative; with 1 - s = s of the point opposite.
template <std::size_t n>
[[nodiscard]] inline Integrals by_gauss(double a, double b) {
  constexpr const std::array<double, n>& kS = GaussRule<n>::kPoints;
  std::array<double, n> weights;
  for (std::size_t i = 0; i < n; ++i) {
    const double tau = (0.5 * kS[i] * (1.0 + kS[n - 1 - i])) * a + (0.5 * kS[i] * kS[i]) * b;
    weights[i] = GaussRule<n>::kWeights[i] * exp_for_rule<n>(tau);
  }
  Integrals sums;
  for (std::size_t i = 0; i < n; ++i) {
    const double of_near = kS[n - 1 - i] * weights[i];
    const double of_far = kS[i] * weights[i];
    const double rho = kS[n - 1 - i] * a + kS[i] * b;
    sums.near_g += of_near;
    sums.far_g += of_far;
    sums.near_k += of_near * rho;
    sums.far_k += of_far * rho;
  }
  sums.transparency = 1.0 - (sums.near_k + sums.far_k);
  return sums;
}

/// phi and psi of segment_tables.h at u.
struct TableValues {
  double phi;
  double psi;
};
[[nodiscard]] inline TableValues look_up(double u, std::size_t first) {
  constexpr double kParts = kTableParts;
  constexpr double kRound = 6755399441055744.0;  // as in exp_of_minus()
  static_assert(std::has_single_bit(kTableParts));
  const double scaled = u * kParts;
  const double shifted = std::min(scaled - 0.5, kParts - 1.0) + kRound;
  const double t = 2.0 * (scaled - (shifted - kRound)) - 1.0;
  const std::size_t part = std::bit_cast<std::uint64_t>(shifted) & (kTableParts - 1);
  const std::size_t row = first + part * kTableStride;
  return [&]<std::size_t... i>(std::index_sequence<i...>) {
    TableValues values{.phi = kSegmentTables[row + kTableStride - 2],
                       .psi = kSegmentTables[row + kTableStride - 1]};
    ((values.phi = values.phi * t + kSegmentTables[row + kTableStride - 4 - 2 * i],
      values.psi = values.psi * t + kSegmentTables[row + kTableStride - 3 - 2 * i]),
     ...);
    return values;
  }
  (std::make_index_sequence<kTableCoefficients - 1>());
}

/// With w = sqrt(2 |b - a|), p = a/w, q = b/w, u = c/(c + p) = c w/A, A = c w + a, B = c w + b:
///
///     P0 = phi(u_p)/A - T phi(u_q)/B
///     P1 = psi(u_p)/A^2 - T (phi(u_q)/B + psi(u_q)/B^2)
///
/// What the usual form divides by w, and by the square of it, has dropped out: nothing cancels where
/// a and b are nearly equal, and at a = b phi = psi = 1 gives that case's own formula.
/// For max(a, b) > 2, where 1 - P0 and P0 - T keep their digits.
[[nodiscard]] inline Integrals by_closed_form(double a, double b) {
  const double d = b - a;
  const double scaled = kTableScale * std::sqrt(2.0 * std::abs(d));
  const double inverse_near = 1.0 / (scaled + a);
  const double inverse_far = 1.0 / (scaled + b);
  const std::size_t first = d < 0.0 ? kTableParts * kTableStride : 0;
  const TableValues of_near = look_up(scaled * inverse_near, first);
  const TableValues of_far = look_up(scaled * inverse_far, first);
  const double transparency = exp_of_minus(0.5 * a + 0.5 * b);
  const double far_end = of_far.phi * inverse_far;
  const double p0 = of_near.phi * inverse_near - transparency * far_end;
  const double p1 = of_near.psi * inverse_near * inverse_near -
                    transparency * (far_end + of_far.psi * inverse_far * inverse_far);
  return {.near_k = 1.0 - p0,
          .far_k = p0 - transparency,
          .near_g = p0 - p1,
          .far_g = p1,
          .transparency = transparency};
}

}  // namespace haarlight::render::segment
