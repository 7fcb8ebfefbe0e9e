// SPDX-License-Identifier: Apache-2.0
#include "render/volume/segment_rule.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "haarlight/core/error.h"
#include "render/volume/segment_kernel.h"

namespace haarlight::render {

namespace {

/// Beyond this depth within a segment nothing changes a double.
constexpr double kDeepest = 42.0;
/// Within which a power series about the middle of a piece has few terms, none of which cancel much.
constexpr double kSeriesDepth = 1.0;
constexpr double kLeastTolerance = 1e-16;
/// Of the series: S + 3 roundings of each term at most, e^S their sum, S <= 1; and those of the sums.
constexpr double kSeriesRounding = 2e-14;
constexpr int kMostTerms = 64;

/// A part of a segment from the eye on.
struct Piece {
  double begin = 0.0;
  double width = 1.0;
  double a = 0.0;       ///< depth per length of the piece at its beginning
  double b = 0.0;       ///< and at its end
  double before = 0.0;  ///< depth from the eye to it
};

/// Calls `add(piece)` for parts of equal depth, at most `piece_depth` each, until `deepest`.
/// @return  the depth that was passed
template <class Add>
double for_pieces(double a, double b, double piece_depth, double deepest, const Add& add) {
  const double total = 0.5 * a + 0.5 * b;
  if (total <= piece_depth) {
    add(Piece{.a = a, .b = b});
    return total;
  }
  const double step = total / std::ceil(total / piece_depth);
  const double most = std::max(a, b);
  const double near = a / most;
  const double change = b / most - near;
  // Where the depth from the eye is t, of which rounding must not make more than the whole.
  const auto place_of = [&](double t) {
    const double scaled = t / most;
    const double root = std::sqrt(std::max(near * near + 2.0 * change * scaled, 0.0));
    return std::min(2.0 * scaled / (near + root), 1.0);
  };
  const auto depth_at = [&](double s) { return (1.0 - s) * a + s * b; };
  double begin = 0.0;
  double before = 0.0;
  for (int i = 1; before < deepest && before < total; ++i) {
    const double passed = step * i;
    const bool is_last = passed > total - 0.5 * step;
    const double end = is_last ? 1.0 : place_of(passed);
    const double width = end - begin;
    add(Piece{.begin = begin,
              .width = width,
              .a = depth_at(begin) * width,
              .b = depth_at(end) * width,
              .before = before});
    begin = end;
    before = is_last ? total : passed;
  }
  return before;
}

void finish(RuledWeights& result, double a, double b) {
  const double depth = 0.5 * a + 0.5 * b;
  result.weights.transparency = std::exp(-depth);
  result.weights.opacity = -std::expm1(-depth);
}

/// Rybicki's weights e^-((2i + 1) h)^2.
constexpr double kStep = 0.4;
constexpr std::size_t kPairs = 6;
const std::array<double, kPairs>& rybicki_weights() {
  static const std::array<double, kPairs> kWeights = [] {
    std::array<double, kPairs> weights{};
    for (std::size_t i = 0; i < kPairs; ++i) {
      const double at = kStep * (2.0 * static_cast<double>(i) + 1.0);
      weights.at(i) = std::exp(-at * at);
    }
    return weights;
  }();
  return kWeights;
}

/// ln(e^(x^2) erfc(x)/u) by its values at ten Chebyshev points of u, 0..1: coefficients of T_k(2u - 1).
constexpr std::size_t kFitted = 10;
const std::array<double, kFitted>& tail_coefficients() {
  static const std::array<double, kFitted> kCoefficients = [] {
    std::array<double, kFitted> values{};
    std::array<double, kFitted> angles{};
    for (std::size_t i = 0; i < kFitted; ++i) {
      angles.at(i) = std::numbers::pi * (static_cast<double>(i) + 0.5) / kFitted;
      const double u = 0.5 * (1.0 + std::cos(angles.at(i)));
      const double x = 2.0 * (1.0 - u) / u;
      const double table_u = kTableScale / (kTableScale + x);
      // F = phi u/(2 c) = (sqrt(pi)/2) erfcx.
      const double erfcx = segment::look_up(table_u, 0).phi * table_u / kTableScale /
                           std::sqrt(std::numbers::pi);
      values.at(i) = std::log(erfcx / u);
    }
    std::array<double, kFitted> c{};
    for (std::size_t k = 0; k < kFitted; ++k) {
      for (std::size_t i = 0; i < kFitted; ++i) {
        c.at(k) += (k == 0 ? 1.0 : 2.0) / kFitted * values.at(i) *
                   std::cos(static_cast<double>(k) * angles.at(i));
      }
    }
    return c;
  }();
  return kCoefficients;
}

/// Eq. (8) and Appendix B of [Williams98] as they stand.
segment::Integrals by_paper(double a, double b) {
  const double d = b - a;
  const double transparency = std::exp(-(0.5 * a + 0.5 * b));
  double p0 = 0.0;
  double p1 = 0.0;
  if (d == 0.0) {
    p0 = (1.0 - transparency) / a;
    p1 = (p0 - transparency) / a;
  } else {
    const double w = std::sqrt(2.0 * std::abs(d));
    const double p = a / w;
    const double q = b / w;
    // The square of the nearer end less that of the farther one, which is never positive for erfc, and
    // the other way round for Dawson's: either way -tau.
    const double passed = std::exp(d > 0.0 ? p * p - q * q : q * q - p * p);
    const double integral = d > 0.0 ? 0.5 * std::sqrt(std::numbers::pi) *
                                          (fitted_erfcx(p) - passed * fitted_erfcx(q))
                                    : rybicki_dawson(p) - passed * rybicki_dawson(q);
    p0 = 2.0 / w * integral;
    p1 = (1.0 - transparency - a * p0) / d;
  }
  return {.near_k = 1.0 - p0,
          .far_k = p0 - transparency,
          .near_g = p0 - p1,
          .far_g = p1,
          .transparency = transparency};
}

RuledWeights paper_weights(double a, double b) {
  const segment::Integrals sums = by_paper(a, b);
  RuledWeights result{.n_pieces = 1, .n_terms = 1};
  const std::array<double, 4> four = {sums.near_k, sums.far_k, sums.near_g, sums.far_g};
  result.is_finite = std::ranges::all_of(four, [](double x) { return std::isfinite(x); });
  if (!result.is_finite) {
    result.weights = mean_colour_weights(a, b);
    return result;
  }
  result.is_negative = std::ranges::any_of(four, [](double x) { return x < 0.0; });
  result.weights.of_chromaticity = {.near = sums.near_k, .far = sums.far_k};
  result.weights.of_glow = {.near = sums.near_g, .far = sums.far_g};
  finish(result, a, b);
  return result;
}

/// 1/n.
const std::array<double, kMostTerms + 8>& inverses() {
  static const std::array<double, kMostTerms + 8> kInverses = [] {
    std::array<double, kMostTerms + 8> table{};
    for (std::size_t i = 1; i < table.size(); ++i) {
      table.at(i) = 1.0 / static_cast<double>(i);
    }
    return table;
  }();
  return kInverses;
}

/// Of E = e^{-(r0 x + r1 x^2/2)} = sum e_n x^n, x = -1..1: its integrals with 1, x and x^2.
struct Moments {
  std::array<double, 3> of{};
  double tail = 0.0;  ///< by how much the sum may be off E, anywhere
  int n_terms = 0;
};

/// (n + 1) e_(n+1) = -(r0 e_n + r1 e_(n-1)). So |e_(m+1)| <= q max(|e_m|, |e_(m-1)|) for all m >= n,
/// q = (|r0| + |r1|)/(n + 1), and what follows e_n is below 2 q max(|e_n|, |e_(n-1)|)/(1 - q).
Moments moments_of(double r0, double r1, double tolerance) {
  const std::array<double, kMostTerms + 8>& inverse = inverses();
  const double s = std::abs(r0) + std::abs(r1);
  Moments moments;
  double e = 1.0;
  double before = 0.0;
  for (std::size_t n = 0; n < kMostTerms; ++n) {
    if (n % 2 == 0) {
      moments.of[0] += 2.0 * e * inverse[n + 1];
      moments.of[2] += 2.0 * e * inverse[n + 3];
    } else {
      moments.of[1] += 2.0 * e * inverse[n + 2];
    }
    ++moments.n_terms;
    const double q = s * inverse[n + 1];
    const double most = std::max(std::abs(e), std::abs(before));
    moments.tail =
        q < 1.0 ? 2.0 * q * most / (1.0 - q) : std::numeric_limits<double>::infinity();
    if (moments.tail <= tolerance) {
      break;
    }
    const double next = -(r0 * e + r1 * before) * inverse[n + 1];
    before = e;
    e = next;
  }
  return moments;
}

}  // namespace

GaussPoints gauss_points(int n) {
  HAARLIGHT_EXPECTS(n >= 1 && n <= VolumeRule::kMostPoints, "1 to 32 points");
  GaussPoints rule;
  constexpr int kSteps = 12;
  for (int i = 0; i < n; ++i) {
    double x = -std::cos(std::numbers::pi * (i + 0.75) / (n + 0.5));
    double slope = 1.0;
    for (int step = 0; step < kSteps; ++step) {  // Newton's method for the root of P_n
      double p = x;
      double before = 1.0;
      for (int k = 2; k <= n; ++k) {
        const double next = ((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k;
        before = p;
        p = next;
      }
      slope = n * (x * p - before) / (x * x - 1.0);
      x -= p / slope;
    }
    rule.points.push_back(0.5 * (1.0 + x));
    rule.weights.push_back(1.0 / ((1.0 - x * x) * slope * slope));
  }
  return rule;
}

SegmentWeights mean_colour_weights(double depth_near, double depth_far) {
  const double depth = 0.5 * depth_near + 0.5 * depth_far;
  const double opacity = -std::expm1(-depth);
  const double of_glow = depth > 0.0 ? 0.5 * (opacity / depth) : 0.5;
  return {.of_chromaticity = {.near = 0.5 * opacity, .far = 0.5 * opacity},
          .of_glow = {.near = of_glow, .far = of_glow},
          .opacity = opacity,
          .transparency = std::exp(-depth)};
}

double rybicki_dawson(double x) {
  constexpr double kSmall = 0.2;
  if (x < kSmall) {  // its own series: the sum below loses digits there
    const double x2 = x * x;
    return x * (1.0 - 2.0 / 3.0 * x2 * (1.0 - 0.4 * x2 * (1.0 - 2.0 / 7.0 * x2)));
  }
  const double half_index = 0.5 * x / kStep + 0.5;
  if (!(2.0 * half_index < std::numeric_limits<int>::max())) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const int n0 = 2 * static_cast<int>(half_index);  // the even number next to x/h
  const double off = x - n0 * kStep;
  const double factor = std::exp(2.0 * off * kStep);
  double power = factor;
  double sum = 0.0;
  for (std::size_t i = 0; i < kPairs; ++i) {
    const double odd = 2.0 * static_cast<double>(i) + 1.0;
    sum += rybicki_weights().at(i) * (power / (n0 + odd) + 1.0 / ((n0 - odd) * power));
    power *= factor * factor;
  }
  return std::numbers::inv_sqrtpi * std::exp(-off * off) * sum;
}

double fitted_erfcx(double x) {
  const double u = 1.0 / (1.0 + 0.5 * x);
  const double t = 2.0 * u - 1.0;
  const std::array<double, kFitted>& c = tail_coefficients();
  double next = 0.0;  // Clenshaw's recurrence
  double after = 0.0;
  for (std::size_t k = kFitted - 1; k > 0; --k) {
    const double value = c.at(k) + 2.0 * t * next - after;
    after = next;
    next = value;
  }
  return u * std::exp(c[0] + t * next - after);
}

SegmentRule::SegmentRule(const VolumeRule& rule) : rule_(rule) {
  HAARLIGHT_EXPECTS(rule.mode != VolumeMode::exact, "a rule other than the exact one");
  HAARLIGHT_EXPECTS(rule.piece_depth >= VolumeRule::kLeastPieceDepth &&
                        rule.piece_depth <= VolumeRule::kLargestPieceDepth,
                    "an optical depth of a piece, 1e-6..1e3");
  HAARLIGHT_EXPECTS(rule.tolerance >= 0.0, "a tolerance of 0 or above");
  rule_.tolerance = std::max(rule.tolerance, kLeastTolerance);
  gauss_ = gauss_points(rule.points);
}

RuledWeights SegmentRule::of_depths(double depth_near, double depth_far) const {
  const auto is_depth = [](double depth) { return depth >= 0.0 && depth <= kLargestDepth; };
  HAARLIGHT_EXPECTS(is_depth(depth_near) && is_depth(depth_far), "optical depths, 0..1e300");
  switch (rule_.mode) {
    case VolumeMode::gauss:
      return by_gauss(depth_near, depth_far);
    case VolumeMode::series:
      return by_series(depth_near, depth_far);
    case VolumeMode::paper:
      return paper_weights(depth_near, depth_far);
    case VolumeMode::exact:
    case VolumeMode::approximate:
    case VolumeMode::approximate_unsliced:
      break;
  }
  return {.weights = mean_colour_weights(depth_near, depth_far), .n_pieces = 1, .n_terms = 1};
}

RuledWeights SegmentRule::by_gauss(double a, double b) const {
  RuledWeights result;
  const std::size_t n = gauss_.points.size();
  for_pieces(a, b, rule_.piece_depth, kDeepest, [&](const Piece& piece) {
    const double seen = segment::exp_of_minus(piece.before);
    for (std::size_t i = 0; i < n; ++i) {
      const double x = gauss_.points[i];
      const double rest = 1.0 - x;
      const double tau = 0.5 * x * ((1.0 + rest) * piece.a + x * piece.b);
      const double weight = gauss_.weights[i] * seen * segment::exp_of_minus(tau);
      const double s = piece.begin + piece.width * x;
      const double of_near = weight * (1.0 - s);
      const double of_far = weight * s;
      const double rho = rest * piece.a + x * piece.b;
      result.weights.of_chromaticity.near += of_near * rho;
      result.weights.of_chromaticity.far += of_far * rho;
      result.weights.of_glow.near += of_near * piece.width;
      result.weights.of_glow.far += of_far * piece.width;
    }
    result.peak = std::max({result.peak, 0.5 * piece.a, 0.5 * piece.b});
    ++result.n_pieces;
  });
  result.n_terms = result.n_pieces * static_cast<int>(n);
  finish(result, a, b);
  return result;
}

RuledWeights SegmentRule::by_series(double a, double b) const {
  RuledWeights result;
  // Of a piece E(middle) tail tau over E(begin) (1 - e^-tau), or of a glow E(middle) tail over
  // E(end): below e tail, tau <= 1.
  const double tolerance = 0.5 * rule_.tolerance / std::numbers::e;
  // Behind the end there is e^-passed of the opacity; of P0, where the extinction falls to 0 there,
  // at most 2 sqrt(passed + 1) as much.
  constexpr double kBehind = 16.0;
  const double deepest =
      std::min(kDeepest, -std::log(std::min(0.25 / kBehind * rule_.tolerance, 0.5)));
  double tail = 0.0;
  const double passed = for_pieces(a, b, kSeriesDepth, deepest, [&](const Piece& piece) {
    const double r0 = 0.25 * (piece.a + piece.b);
    const double r1 = 0.25 * (piece.b - piece.a);
    const Moments m = moments_of(r0, r1, tolerance);
    const double to_middle = 0.375 * piece.a + 0.125 * piece.b;
    const double seen = segment::exp_of_minus(piece.before + to_middle);
    const double half = 0.5 * piece.width;
    const double middle = piece.begin + half;
    const auto add = [&](EndWeights& weights, double of_one, double of_x) {
      weights.near += seen * ((1.0 - middle) * of_one - half * of_x);
      weights.far += seen * (middle * of_one + half * of_x);
    };
    add(result.weights.of_chromaticity, r0 * m.of[0] + r1 * m.of[1],
        r0 * m.of[1] + r1 * m.of[2]);
    add(result.weights.of_glow, half * m.of[0], half * m.of[1]);
    tail = std::max(tail, m.tail);
    result.n_terms += m.n_terms;
    ++result.n_pieces;
  });
  finish(result, a, b);
  const bool is_ended = passed < 0.5 * a + 0.5 * b;
  result.relative_bound =
      std::numbers::e * tail + kSeriesRounding + (is_ended ? kBehind * std::exp(-passed) : 0.0);
  return result;
}

GaussBound gauss_bound(int n, double peak, std::size_t p, std::size_t q) {
  // |R| = gamma_n |f^(2n)(x)|/(2n)! for some x in -1..1, gamma_n = 2^(2n+1) (n!)^4/((2n+1) ((2n)!)^2),
  // and |f^(2n)|/(2n)! <= r^-2n max |f| on the circle of radius r about x. There a polynomial of degree
  // p that is between 0 and 1 on -1..1 is at most G_p(r) = (1 + T_p(1 + r))/2.
  double log_gamma = (2.0 * n + 1.0) * std::numbers::ln2 - std::log(2.0 * n + 1.0);
  log_gamma += 4.0 * std::lgamma(n + 1.0) - 2.0 * std::lgamma(2.0 * n + 1.0);
  const auto largest = [](std::size_t degree, double r) {
    const double x = 1.0 + r;
    return 0.5 + 0.5 * std::cosh(static_cast<double>(degree) * std::acosh(x));
  };
  // The integral of G_p from 0 to r: that of T_p is (T_(p+1)/(p+1) - T_(p-1)/(p-1))/2.
  const auto integral = [&](double r) {
    if (p == 1) {
      return r + 0.25 * r * r;
    }
    const auto degree = static_cast<double>(p);
    const auto primitive = [&](double x) {
      const double angle = std::acosh(x);
      return 0.5 * (std::cosh((degree + 1.0) * angle) / (degree + 1.0) -
                    std::cosh((degree - 1.0) * angle) / (degree - 1.0));
    };
    return 0.5 * r + 0.5 * (primitive(1.0 + r) - primitive(1.0));
  };
  GaussBound best{.of_chromaticity = std::numeric_limits<double>::infinity(),
                  .of_glow = std::numeric_limits<double>::infinity()};
  if (!std::isfinite(peak)) {
    return best;
  }
  if (peak == 0.0 && q < 2 * static_cast<std::size_t>(n)) {
    return {};
  }
  constexpr int kRadii = 240;
  for (int i = 0; i < kRadii; ++i) {
    const double r = std::exp2(-4.0 + 0.125 * i);
    const double log_of_glow =
        log_gamma - 2.0 * n * std::log(r) + peak * integral(r) + std::log(largest(q, r));
    best.of_glow = std::min(best.of_glow, std::exp(log_of_glow));
    best.of_chromaticity =
        std::min(best.of_chromaticity, std::exp(log_of_glow + std::log(largest(p, r))));
  }
  return best;
}

}  // namespace haarlight::render
