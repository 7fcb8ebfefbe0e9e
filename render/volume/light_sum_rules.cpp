// SPDX-License-Identifier: Apache-2.0
/// @file
/// LightSum by the rules that the exact one is compared with.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/LU>

#include "render/volume/light_sum.h"

namespace haarlight::render {

using Eigen::Array3d;

namespace {

/// Where 0 is taken to be reached: parts of a cell below it are straight.
constexpr double kLeastStep = 1e-9;
/// Of a piece of a series 2 (|r_0| + |r_1| + ...), which bounds its depth; and its rounding, more
/// where values at nine points give the powers.
constexpr double kSeriesDepth = 1.0;
constexpr double kParabolaRounding = 1e-13;
constexpr double kCurveRounding = 1e-11;
constexpr int kMostTerms = 96;
/// Of any rule, beside the exact picture and its own rounding.
constexpr double kRounding = 1e-13;
constexpr int kPaperPoints = 5;

/// A polynomial of x = -1..1 by its powers.
struct Powers {
  std::array<double, Curve::kPoints> c{};
  std::size_t degree = 0;

  [[nodiscard]] double operator()(double x) const {
    double sum = 0.0;
    for (std::size_t k = degree + 1; k > 0; --k) {
      sum = sum * x + c.at(k - 1);
    }
    return sum;
  }
  /// From -1 to x.
  [[nodiscard]] double integral_to(double x) const {
    double sum = 0.0;
    double at_begin = 0.0;
    for (std::size_t k = degree + 1; k > 0; --k) {
      const double over = c.at(k - 1) / static_cast<double>(k);
      sum = (sum + over) * x;
      at_begin = -(at_begin + over);
    }
    return sum - at_begin;
  }
  [[nodiscard]] double size() const {
    double sum = 0.0;
    for (std::size_t k = 0; k <= degree; ++k) {
      sum += std::abs(c.at(k));
    }
    return sum;
  }
};

/// Through the values of a function at as many points as its degree takes.
template <class Function>
Powers powers_of(const Function& value_at, std::size_t degree, double from, double to) {
  Powers powers{.c = {}, .degree = degree};
  if (degree <= 2) {
    const double near = value_at(from);
    const double far = value_at(to);
    const double middle = degree == 2 ? value_at(0.5 * (from + to)) : 0.5 * (near + far);
    powers.c[0] = middle;
    powers.c[1] = 0.5 * (far - near);
    powers.c[2] = 0.5 * (near + far) - middle;
    return powers;
  }
  constexpr auto kN = static_cast<Eigen::Index>(Curve::kPoints);
  using Matrix = Eigen::Matrix<double, kN, kN>;
  static const Matrix kInverse = [] {
    Matrix of_powers;
    for (Eigen::Index i = 0; i < kN; ++i) {
      const double x = 2.0 * Curve::points().at(static_cast<std::size_t>(i)) - 1.0;
      double power = 1.0;
      for (Eigen::Index k = 0; k < kN; ++k) {
        of_powers(i, k) = power;
        power *= x;
      }
    }
    return Matrix(of_powers.inverse());
  }();
  Eigen::Matrix<double, kN, 1> values;
  for (Eigen::Index i = 0; i < kN; ++i) {
    values[i] = value_at(from + (to - from) * Curve::points().at(static_cast<std::size_t>(i)));
  }
  const Eigen::Matrix<double, kN, 1> found = kInverse * values;
  for (std::size_t k = 0; k <= degree; ++k) {
    powers.c.at(k) = found[static_cast<Eigen::Index>(k)];
  }
  return powers;
}

/// Integrals of rho E, or of E, over a piece: alone, and times the colour's field.
struct FieldWeights {
  double of_one = 0.0;
  double of_field = 0.0;
};

/// @param depth  extinction times half the piece's length @param half  that half
FieldWeights gauss_of(const GaussPoints& rule, const Powers& depth, const Powers& field,
                      double half, bool is_glowing) {
  FieldWeights sums;
  for (std::size_t i = 0; i < rule.points.size(); ++i) {
    const double x = 2.0 * rule.points[i] - 1.0;
    const double tau = std::max(depth.integral_to(x), 0.0);
    const double weight =
        2.0 * rule.weights[i] * std::exp(-tau) * (is_glowing ? half : std::max(depth(x), 0.0));
    sums.of_one += weight;
    sums.of_field += weight * field(x);
  }
  return sums;
}

/// The same by the power series of E, (n + 1) e_(n+1) = -(r_0 e_n + ... + r_p e_(n-p)); the bound of
/// what follows as in segment_rule.cpp, with the p + 1 terms last found.
struct SeriesWeights {
  FieldWeights weights;
  double tail = 0.0;  ///< of E over E(begin)
  int n_terms = 0;
};
SeriesWeights series_of(const Powers& depth, const Powers& field, double half, bool is_glowing,
                        double tolerance) {
  const std::size_t p = depth.degree;
  std::array<double, kMostTerms + Curve::kPoints> e{};  // e_n at n + p
  e.at(p) = 1.0;
  const double size = depth.size();
  SeriesWeights result;
  int n = 0;
  while (true) {
    double most = 0.0;
    for (std::size_t j = 0; j <= p; ++j) {
      most = std::max(most, std::abs(e.at(static_cast<std::size_t>(n) + p - j)));
    }
    const double q = size / (n + 1.0);
    result.tail = q < 1.0 ? (static_cast<double>(p) + 1.0) * q * most / (1.0 - q)
                          : std::numeric_limits<double>::infinity();
    if (result.tail <= tolerance || n + 1 >= kMostTerms) {
      break;
    }
    double next = 0.0;
    for (std::size_t j = 0; j <= p; ++j) {
      next -= depth.c.at(j) * e.at(static_cast<std::size_t>(n) + p - j);
    }
    ++n;
    e.at(static_cast<std::size_t>(n) + p) = next / n;
  }
  result.n_terms = n + 1;
  const auto moment = [&](std::size_t k) {
    double sum = 0.0;
    for (std::size_t i = k % 2; i <= static_cast<std::size_t>(n); i += 2) {
      sum += e.at(i + p) * 2.0 / static_cast<double>(i + k + 1);
    }
    return sum;
  };
  std::array<double, 2 * Curve::kPoints> moments{};
  const std::size_t n_moments = (is_glowing ? 0 : p) + field.degree + 1;
  for (std::size_t k = 0; k < n_moments; ++k) {
    moments.at(k) = moment(k);
  }
  const double at_middle = std::exp(-std::max(depth.integral_to(0.0), 0.0));
  const Powers one{.c = {half}, .degree = 0};
  const Powers& factor = is_glowing ? one : depth;
  for (std::size_t j = 0; j <= factor.degree; ++j) {
    const double scaled = at_middle * factor.c.at(j);
    result.weights.of_one += scaled * moments.at(j);
    for (std::size_t k = 0; k <= field.degree; ++k) {
      result.weights.of_field += scaled * field.c.at(k) * moments.at(j + k);
    }
  }
  result.tail *= at_middle;
  return result;
}

}  // namespace

void RuleCounts::add(const RuleCounts& other) {
  pieces += other.pieces;
  terms += other.terms;
  not_finite += other.not_finite;
  negative += other.negative;
  relative_bound = std::max(relative_bound, other.relative_bound);
  linear_peak = std::max(linear_peak, other.linear_peak);
  curved_peak = std::max(curved_peak, other.curved_peak);
  curved_excess = std::max(curved_excess, other.curved_excess);
  density_degree = std::max(density_degree, other.density_degree);
  colour_degree = std::max(colour_degree, other.colour_degree);
}

std::optional<double> relative_bound(const VolumeRule& rule, Glow glow,
                                     const RuleCounts& counts) {
  double bound = kRounding;
  if (rule.mode == VolumeMode::series) {
    bound += counts.relative_bound;
  } else if (rule.mode == VolumeMode::gauss) {
    // Over all pieces of a ray what reaches the eye from each, times its opacity, adds up to 1; times
    // its depth t to at most t/(1 - e^-t), t the largest.
    const GaussBound of_linear = gauss_bound(rule.points, counts.linear_peak, 1, 1);
    const GaussBound of_curved = gauss_bound(rule.points, counts.curved_peak,
                                             counts.density_degree, counts.colour_degree);
    const double depth = rule.piece_depth;
    bound += glow == Glow::own ? 0.5 * std::max(of_linear.of_glow, of_curved.of_glow)
                               : depth / -std::expm1(-depth) *
                                     std::max(of_linear.of_chromaticity,
                                              counts.curved_excess * of_curved.of_chromaticity);
  } else {
    return std::nullopt;
  }
  return bound < 1.0 ? std::optional(bound) : std::nullopt;
}

/// Between breakpoints.
struct LightSum::CurvedPart {
  double length;  ///< from s = 0 to 1
  const Curve& density;
  const Curve& colour;
  double from;
  double to;
  std::size_t density_part;
  std::size_t colour_part;
  const VolumeScene& scene;

  [[nodiscard]] double extinction(double s) const {
    return std::max(scene.density.in_part(density_part, density(s)), 0.0);
  }
  /// Extinction times half the length.
  [[nodiscard]] Powers depth_between(double begin, double end) const {
    const double half = 0.5 * (end - begin) * length;
    return powers_of(
        [&](double s) { return half * scene.density.in_part(density_part, density(s)); },
        density.degree(), begin, end);
  }
  [[nodiscard]] Powers field_between(double begin, double end) const {
    return powers_of([&](double s) { return colour(s); }, colour.degree(), begin, end);
  }
  /// The colour is linear in its field here.
  [[nodiscard]] Array3d light(const FieldWeights& weights) const {
    if (!(weights.of_one > 0.0)) {
      return Array3d::Zero();
    }
    return weights.of_one *
           scene.colour.in_part(colour_part, weights.of_field / weights.of_one);
  }
};

void LightSum::add_unsliced(const Stretch& stretch) {
  add_linear_piece(stretch.length, scene_.density.at(stretch.density_near),
                   scene_.density.at(stretch.density_far),
                   scene_.colour.at(stretch.colour_near), scene_.colour.at(stretch.colour_far));
}

void LightSum::add_curved_by_rule(double length, const Curve& density, const Curve& colour,
                                  double from, double to) {
  const double middle = 0.5 * (from + to);
  const CurvedPart part = {.length = length,
                           .density = density,
                           .colour = colour,
                           .from = from,
                           .to = to,
                           .density_part = scene_.density.part_of(density(middle)),
                           .colour_part = scene_.colour.part_of(colour(middle)),
                           .scene = scene_};
  switch (rule_->rule().mode) {
    case VolumeMode::gauss:
    case VolumeMode::series:
      add_in_pieces(part);
      return;
    case VolumeMode::paper:
      add_in_one_piece(part);
      return;
    case VolumeMode::exact:
    case VolumeMode::approximate:
    case VolumeMode::approximate_unsliced:
      add_ends(part);
      return;
  }
}

void LightSum::add_ends(const CurvedPart& part) {
  --n_segments_;  // counted where it is added
  add_linear_piece((part.to - part.from) * part.length, part.extinction(part.from),
                   part.extinction(part.to),
                   scene_.colour.in_part(part.colour_part, part.colour(part.from)),
                   scene_.colour.in_part(part.colour_part, part.colour(part.to)));
}

void LightSum::add_in_one_piece(const CurvedPart& part) {
  static const GaussPoints kRule = gauss_points(kPaperPoints);
  const double half = 0.5 * (part.to - part.from) * part.length;
  const Powers depth = part.depth_between(part.from, part.to);
  const FieldWeights weights =
      gauss_of(kRule, depth, part.field_between(part.from, part.to), half, is_glowing_);
  const double total = std::max(depth.integral_to(1.0), 0.0);
  ++rule_counts_.pieces;
  rule_counts_.terms += kPaperPoints;
  add_summed({.light = part.light(weights),
              .opacity = -std::expm1(-total),
              .transparency = std::exp(-total)});
}

void LightSum::add_in_pieces(const CurvedPart& part) {
  const VolumeRule& rule = rule_->rule();
  const bool is_series = rule.mode == VolumeMode::series;
  const double most = is_series ? kSeriesDepth : rule.piece_depth;
  const bool is_curve = std::max(part.density.degree(), part.colour.degree()) > 2;
  PixelLight sum;
  double depth_before = 0.0;
  double step = part.to - part.from;
  const double deepest = std::min(depth_left(), kNoLight);
  for (double s = part.from; s < part.to && depth_before < deepest;) {
    step = std::min(step, part.to - s);
    Powers depth = part.depth_between(s, s + step);
    double total = depth.integral_to(1.0);
    double size = depth.size();
    while ((is_series ? 2.0 * size : total) > most && step > kLeastStep) {
      step *= 0.5;
      depth = part.depth_between(s, s + step);
      total = depth.integral_to(1.0);
      size = depth.size();
    }
    total = std::max(total, 0.0);
    const double half = 0.5 * step * part.length;
    const double end = s + step;
    FieldWeights weights;
    if ((is_series ? 2.0 * size : total) > most) {  // so short that it is straight
      const RuledWeights linear =
          rule_->of_depths(2.0 * half * part.extinction(s), 2.0 * half * part.extinction(end));
      const EndWeights& ends =
          is_glowing_ ? linear.weights.of_glow : linear.weights.of_chromaticity;
      const double scale = is_glowing_ ? 2.0 * half : 1.0;
      weights = {
          .of_one = scale * (ends.near + ends.far),
          .of_field = scale * (ends.near * part.colour(s) + ends.far * part.colour(end))};
      rule_counts_.relative_bound =
          std::max(rule_counts_.relative_bound, linear.relative_bound);
      rule_counts_.linear_peak = std::max(rule_counts_.linear_peak, linear.peak);
      rule_counts_.terms += static_cast<std::uint64_t>(linear.n_terms);
    } else if (is_series) {
      const SeriesWeights series =
          series_of(depth, part.field_between(s, end), half, is_glowing_,
                    0.5 * rule.tolerance / std::numbers::e);
      weights = series.weights;
      // Over the opacity tau/(1 - e^-tau) of it, over a glow's P0 e^tau: below e.
      rule_counts_.relative_bound = std::max(
          rule_counts_.relative_bound,
          std::numbers::e * series.tail + (is_curve ? kCurveRounding : kParabolaRounding));
      rule_counts_.terms += static_cast<std::uint64_t>(series.n_terms);
    } else {
      weights = gauss_of(rule_->gauss(), depth, part.field_between(s, end), half, is_glowing_);
      rule_counts_.curved_peak = std::max(rule_counts_.curved_peak, size);
      if (size > 0.0) {
        rule_counts_.curved_excess =
            std::max(rule_counts_.curved_excess, size / std::max(total, 0.0));
      }
      rule_counts_.density_degree =
          std::max(rule_counts_.density_degree, part.density.degree());
      rule_counts_.colour_degree = std::max(rule_counts_.colour_degree, part.colour.degree());
      rule_counts_.terms += rule_->gauss().points.size();
    }
    ++rule_counts_.pieces;
    sum.light += sum.transparency * part.light(weights);
    sum.opacity += sum.transparency * -std::expm1(-total);
    sum.transparency *= std::exp(-total);
    depth_before += total;
    s = end;
    step *= 2.0;
  }
  add_summed(sum);
}

void LightSum::composite_by_rule() {
  for (std::size_t i = 0; i < pieces_.size(); ++i) {
    const Piece& piece = pieces_[i];
    PixelLight& pixel = light_[piece.pixel];
    if (piece.opacity >= 0.0) {
      pixel.light += pixel.transparency * piece.near;
      pixel.opacity += pixel.transparency * piece.opacity;
      pixel.transparency *= piece.transparency;
      continue;
    }
    const RuledWeights found = rule_->of_depths(depths_near_[i], depths_far_[i]);
    rule_counts_.pieces += static_cast<std::uint64_t>(found.n_pieces);
    rule_counts_.terms += static_cast<std::uint64_t>(found.n_terms);
    rule_counts_.not_finite += found.is_finite ? 0 : 1;
    rule_counts_.negative += found.is_negative ? 1 : 0;
    rule_counts_.relative_bound = std::max(rule_counts_.relative_bound, found.relative_bound);
    rule_counts_.linear_peak = std::max(rule_counts_.linear_peak, found.peak);
    const EndWeights& ends =
        is_glowing_ ? found.weights.of_glow : found.weights.of_chromaticity;
    const double scale = pixel.transparency * (is_glowing_ ? piece.length : 1.0);
    pixel.light += scale * ends.near * piece.near + scale * ends.far * piece.far;
    pixel.opacity += pixel.transparency * found.weights.opacity;
    pixel.transparency *= found.weights.transparency;
  }
  depths_near_.clear();
  depths_far_.clear();
  pieces_.clear();
}

}  // namespace haarlight::render
