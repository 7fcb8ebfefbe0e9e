// SPDX-License-Identifier: Apache-2.0
#include "render/volume/segment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "haarlight/core/error.h"
#include "render/volume/segment_kernel.h"

namespace haarlight::render {

namespace {

/// The optical depth of a piece.
constexpr double kPieceDepth = 0.5;

bool is_depth(double depth) { return depth >= 0.0 && depth <= kLargestDepth; }

segment::Integrals integrals(double a, double b) {
  const double m = std::max(a, b);
  if (m <= segment::kFivePointsUpTo) {
    return segment::by_gauss<5>(a, b);
  }
  if (m <= segment::kEightPointsUpTo) {
    return segment::by_gauss<8>(a, b);
  }
  if (m <= segment::kTenPointsUpTo) {
    return segment::by_gauss<10>(a, b);
  }
  return segment::by_closed_form(a, b);
}

/// f by its three values, at s.
double value_at(const Parabola& f, double s) {
  const double rest = 1.0 - s;
  return rest * rest * f.near + 2.0 * s * rest * f.middle + s * s * f.far;
}

/// The same parabola between s0 and s1.
Parabola part_of(const Parabola& f, double s0, double s1) {
  const double rest0 = 1.0 - s0;
  const double rest1 = 1.0 - s1;
  return {
      .near = std::max(0.0, value_at(f, s0)),
      .middle = rest0 * rest1 * f.near + (rest0 * s1 + s0 * rest1) * f.middle + s0 * s1 * f.far,
      .far = std::max(0.0, value_at(f, s1))};
}

/// The integral of f from 0 to x.
double integral_to(const Parabola& f, double x) {
  return x * (f.near + x * ((f.middle - f.near) +
                            x * ((f.near - 2.0 * f.middle + f.far) * (1.0 / 3.0))));
}

/// Of the depth, an upper bound, and the depth itself where no value is negative: what bounds the
/// error of the rule, as the series of e^{-tau} has powers of it.
double largest_depth(const Parabola& f, double width) {
  return width * (f.near + std::abs(f.middle) + f.far) * (1.0 / 3.0);
}

struct Piece {
  double begin;
  double end;
  Parabola depth;  ///< rho along the piece, times the length of the segment
  [[nodiscard]] double width() const { return end - begin; }
};

Piece piece_of(const Parabola& depth, double begin, double end) {
  return {.begin = begin, .end = end, .depth = part_of(depth, begin, end)};
}

/// From s0 to the end, or to where the depth is little below kPieceDepth.
/// @param first  the first width to try
Piece next_piece(const Parabola& depth, double s0, double first) {
  const double rest = 1.0 - s0;
  const Piece all = piece_of(depth, s0, 1.0);
  const Parabola& left = all.depth;
  if (largest_depth(left, rest) <= kPieceDepth) {
    return all;
  }
  double low = 0.0;  // of what is left
  double high = 1.0;
  double x = std::min(first / rest, 0.5);
  constexpr int kMostSteps = 1100;  // halvings of 1 down to the least number
  for (int step = 0; step < kMostSteps && low < high; ++step) {
    const Parabola part = {.near = left.near,
                           .middle = left.near + x * (left.middle - left.near),
                           .far = std::max(0.0, value_at(left, x))};
    const double of_part = largest_depth(part, rest * x);
    if (of_part > kPieceDepth) {
      high = x;
    } else {
      low = x;
      if (of_part >= 0.8 * kPieceDepth) {
        break;
      }
    }
    x = 0.5 * (low + high);
  }
  return piece_of(depth, s0, s0 + rest * low);
}

/// Adds a piece, of which `before` of the light reaches the eye, by the rule of n points.
/// @param exponential  of -tau for the piece's depths
template <std::size_t n, class Exponential>
void add_piece(QuadraticWeights& sums, const Piece& piece, double before,
               const Exponential& exponential) {
  using Rule = segment::GaussRule<n>;
  const double width = piece.width();
  const double scale = width * before;
  std::array<double, n> weights;
  std::array<double, n> extinctions;
  for (std::size_t i = 0; i < n; ++i) {  // apart, so that it becomes vectors
    const double x = Rule::kPoints[i];
    const double tau = std::max(0.0, width * integral_to(piece.depth, x));
    weights[i] = Rule::kWeights[i] * scale * exponential(tau);
    extinctions[i] = std::max(0.0, value_at(piece.depth, x));
  }
  for (std::size_t i = 0; i < n; ++i) {
    const double s = piece.begin + width * Rule::kPoints[i];
    const double rest = 1.0 - s;
    const double of_near = weights[i] * rest;
    const double of_far = weights[i] * s;
    const Parabola glow = {
        .near = of_near * rest, .middle = 2.0 * of_near * s, .far = of_far * s};
    const double extinction = extinctions[i];
    sums.of_glow.near += glow.near;
    sums.of_glow.middle += glow.middle;
    sums.of_glow.far += glow.far;
    sums.of_chromaticity.near += glow.near * extinction;
    sums.of_chromaticity.middle += glow.middle * extinction;
    sums.of_chromaticity.far += glow.far * extinction;
  }
  ++sums.n_pieces;
}

/// rho times the length.
Parabola checked_depths(const Parabola& rho, double length) {
  HAARLIGHT_EXPECTS(length >= 0.0, "a length of 0 or above");
  const Parabola depth = {
      .near = rho.near * length, .middle = rho.middle * length, .far = rho.far * length};
  HAARLIGHT_EXPECTS(
      is_depth(depth.near) && is_depth(depth.far) && std::abs(depth.middle) <= kLargestDepth,
      "optical depths, 0..1e300");
  // A parabola with values >= 0 at the ends is >= 0 between them where middle >= -sqrt(near far).
  constexpr double kRounding = 1e-9;
  const double ends = std::sqrt(depth.near) * std::sqrt(depth.far);
  HAARLIGHT_EXPECTS(depth.middle >= -ends - kRounding * std::max(depth.near, depth.far),
                    "an extinction of 0 or above along the segment");
  return depth;
}

/// Opacity and transparency of all of it.
QuadraticWeights without_colour(const Parabola& depth) {
  const double total = std::max(0.0, (depth.near + depth.middle + depth.far) * (1.0 / 3.0));
  QuadraticWeights weights;
  weights.opacity = -std::expm1(-total);
  weights.transparency = std::exp(-total);
  return weights;
}

}  // namespace

SegmentWeights weights_of_depths(double depth_near, double depth_far) {
  HAARLIGHT_EXPECTS(is_depth(depth_near) && is_depth(depth_far), "optical depths, 0..1e300");
  const segment::Integrals sums = integrals(depth_near, depth_far);
  return {.of_chromaticity = {.near = sums.near_k, .far = sums.far_k},
          .of_glow = {.near = sums.near_g, .far = sums.far_g},
          .opacity = sums.near_k + sums.far_k,
          .transparency = sums.transparency};
}

SegmentWeights segment_weights(double rho_near, double rho_far, double length) {
  HAARLIGHT_EXPECTS(rho_near >= 0.0 && rho_far >= 0.0, "an extinction of 0 or above");
  HAARLIGHT_EXPECTS(length >= 0.0, "a length of 0 or above");
  return weights_of_depths(rho_near * length, rho_far * length);
}

QuadraticWeights quadratic_weights(const Parabola& rho, double length, double least_fraction) {
  HAARLIGHT_EXPECTS(least_fraction > 0.0 && least_fraction < 1.0,
                    "a fraction of the light, 0..1");
  const Parabola depth = checked_depths(rho, length);
  QuadraticWeights weights = without_colour(depth);
  const auto exponential = [](double tau) {
    static_assert(kPieceDepth <= segment::kEightPointsUpTo);
    return segment::exp_for_rule<8>(std::min(tau, kPieceDepth));
  };
  const double largest = -std::log(least_fraction);
  double s = 0.0;
  double step = kPieceDepth / std::max(largest_depth(depth, 1.0), kPieceDepth);
  for (double before = 0.0; s < 1.0 && before <= largest;) {
    const Piece piece = next_piece(depth, s, step);
    if (piece.end <= s) {
      break;  // below the spacing of numbers near s
    }
    add_piece<10>(weights, piece, segment::exp_of_minus(before), exponential);
    step = piece.width();
    before += std::max(0.0, step * integral_to(piece.depth, 1.0));
    s = piece.end;
  }
  return weights;
}

QuadraticWeights five_point_weights(const Parabola& rho, double length) {
  const Parabola depth = checked_depths(rho, length);
  QuadraticWeights weights = without_colour(depth);
  add_piece<5>(weights, piece_of(depth, 0.0, 1.0), 1.0, segment::exp_of_minus);
  return weights;
}

}  // namespace haarlight::render
