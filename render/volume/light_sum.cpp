// SPDX-License-Identifier: Apache-2.0
#include "render/volume/light_sum.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "render/volume/segment.h"
#include "render/volume/segment_kernel.h"

namespace haarlight::render {

using Eigen::Array3d;

namespace {

constexpr std::size_t kBatch = 4096;  ///< pieces whose weights are found together
constexpr double kPieceDepth =
    0.5;  ///< within which Gauss' rule of 10 points is exact to rounding
constexpr std::size_t kNodes = 10;
using Rule = segment::GaussRule<kNodes>;

/// Of values at the rule's points the integrals from 0 to each point: of the polynomial of degree 9
/// through them.
const Eigen::Matrix<double, kNodes, kNodes>& integrals_to_points() {
  static const Eigen::Matrix<double, kNodes, kNodes> kMatrix = [] {
    // Of each Legendre polynomial its values and its integrals, in x = 2 s - 1.
    Eigen::Matrix<double, kNodes, kNodes> values;
    Eigen::Matrix<double, kNodes, kNodes> integrals;
    for (Eigen::Index i = 0; i < Eigen::Index{kNodes}; ++i) {
      const double x = 2.0 * Rule::kPoints.at(static_cast<std::size_t>(i)) - 1.0;
      std::array<double, kNodes + 1> p{1.0, x};
      for (std::size_t k = 1; k < kNodes; ++k) {
        const auto n = static_cast<double>(k);
        p.at(k + 1) = ((2.0 * n + 1.0) * x * p.at(k) - n * p.at(k - 1)) / (n + 1.0);
      }
      for (std::size_t k = 0; k < kNodes; ++k) {
        const auto column = static_cast<Eigen::Index>(k);
        values(i, column) = p.at(k);
        integrals(i, column) =
            k == 0 ? 0.5 * (x + 1.0)
                   : 0.5 * (p.at(k + 1) - p.at(k - 1)) / (2.0 * static_cast<double>(k) + 1.0);
      }
    }
    return Eigen::Matrix<double, kNodes, kNodes>(integrals * values.inverse());
  }();
  return kMatrix;
}

/// The parabola of a function that is linear in a part of a piecewise linear function of a curve of
/// degree 2, from u to v.
template <class Value, class Part>
std::array<Value, 3> parabola_of(const Part& in_part, const Curve& curve, double u, double v) {
  const double near = curve(u);
  const double far = curve(v);
  // f(u) + f'(u)(v - u)/2 of each end, and their mean: rounding of both.
  const double middle = 0.5 * (near + 0.5 * curve.slope(u) * (v - u)) +
                        0.5 * (far - 0.5 * curve.slope(v) * (v - u));
  return {in_part(near), in_part(middle), in_part(far)};
}

/// Whether two values are in a part of a piecewise linear function, its ends included.
bool are_within(std::span<const double> breakpoints, std::size_t part, double a, double b) {
  return (part == 0 || std::min(a, b) >= breakpoints[part - 1]) &&
         (part == breakpoints.size() || std::max(a, b) <= breakpoints[part]);
}

}  // namespace

LightSum::LightSum(const VolumeScene& scene, std::size_t n_pixels, const VolumeRule& rule,
                   double most_depth)
    : scene_(scene),
      is_glowing_(scene.glow == Glow::own),
      most_depth_(most_depth),
      light_(n_pixels) {
  if (rule.mode != VolumeMode::exact) {
    rule_.emplace(rule);
  }
  depths_near_.reserve(kBatch);
  depths_far_.reserve(kBatch);
  pieces_.reserve(kBatch);
}

void LightSum::begin_ray(std::uint32_t pixel) {
  pixel_ = pixel;
  depth_ = 0.0;
}

void LightSum::add(const Stretch& stretch) {
  if (is_unsliced()) {
    add_unsliced(stretch);
    return;
  }
  const PiecewiseLinear<double>& density = scene_.density;
  const PiecewiseLinear<Array3d>& colour = scene_.colour;
  // Of small cells nearly all stay within the parts that the one before ended in.
  if (are_within(density.breakpoints(), density_part_, stretch.density_near,
                 stretch.density_far) &&
      are_within(colour.breakpoints(), colour_part_, stretch.colour_near, stretch.colour_far)) {
    add_linear_piece(stretch.length, density.in_part(density_part_, stretch.density_near),
                     density.in_part(density_part_, stretch.density_far),
                     colour.in_part(colour_part_, stretch.colour_near),
                     colour.in_part(colour_part_, stretch.colour_far));
    return;
  }
  PartsAlong densities(density.breakpoints(), stretch.density_near, stretch.density_far);
  PartsAlong colours(colour.breakpoints(), stretch.colour_near, stretch.colour_far);
  double s = 0.0;
  double density_at = stretch.density_near;
  double colour_at = stretch.colour_near;
  while (true) {
    const double next = std::min(densities.next(), colours.next());
    const bool is_last = !(next <= 1.0);
    const double end = is_last ? 1.0 : next;
    const auto value_at_end = [&](const PartsAlong& parts, double first, double last) {
      if (is_last) {
        return last;
      }
      return parts.next() == next ? parts.next_value() : (1.0 - end) * first + end * last;
    };
    const double density_end =
        value_at_end(densities, stretch.density_near, stretch.density_far);
    const double colour_end = value_at_end(colours, stretch.colour_near, stretch.colour_far);
    if (end > s) {
      add_linear_piece((end - s) * stretch.length,
                       density.in_part(densities.part(), density_at),
                       density.in_part(densities.part(), density_end),
                       colour.in_part(colours.part(), colour_at),
                       colour.in_part(colours.part(), colour_end));
    }
    if (is_last) {
      density_part_ = densities.part();
      colour_part_ = colours.part();
      return;
    }
    s = end;
    density_at = density_end;
    colour_at = colour_end;
    if (densities.next() == next) {
      densities.advance();
    }
    if (colours.next() == next) {
      colours.advance();
    }
  }
}

void LightSum::add_linear_piece(double length, double rho_near, double rho_far,
                                const Array3d& near, const Array3d& far) {
  // What a part of a transfer function gives is 0 or more, but for rounding.
  const double depth_near = std::max(rho_near * length, 0.0);
  const double depth_far = std::max(rho_far * length, 0.0);
  if (depth_near == 0.0 && depth_far == 0.0 && !is_glowing_) {
    return;
  }
  ++n_segments_;
  depth_ += 0.5 * depth_near + 0.5 * depth_far;
  depths_near_.push_back(depth_near);
  depths_far_.push_back(depth_far);
  pieces_.push_back({.near = near, .far = far, .length = length, .pixel = pixel_});
  if (pieces_.size() == kBatch) {
    composite();
  }
}

void LightSum::add(double length, const Curve& density, const Curve& colour, double from,
                   double to) {
  if ((density.degree() < 2 && colour.degree() < 2) || is_unsliced()) {
    add({.length = (to - from) * length,
         .density_near = density(from),
         .density_far = density(to),
         .colour_near = colour(from),
         .colour_far = colour(to)});
    return;
  }
  splits_.clear();
  density.add_turns(splits_);
  colour.add_turns(splits_);
  for (double& split : splits_) {
    split = std::clamp(split, from, to);
  }
  splits_.push_back(from);
  splits_.push_back(to);
  std::ranges::sort(splits_);
  for (std::size_t i = 0; i + 1 < splits_.size(); ++i) {
    if (splits_[i + 1] > splits_[i]) {
      add_parts(length, density, colour, splits_[i], splits_[i + 1]);
    }
  }
}

void LightSum::add(const SurfaceLight& surface) {
  add_summed({.light = surface.light,
              .opacity = surface.opacity,
              .transparency = 1.0 - surface.opacity});
}

/// Between two turns both only rise or only fall.
void LightSum::add_parts(double length, const Curve& density, const Curve& colour, double from,
                         double to) {
  cuts_.assign({from, to});
  const auto add_crossings = [&](std::span<const double> breakpoints, const Curve& curve) {
    const auto [low, high] = std::minmax({curve(from), curve(to)});
    for (auto value = std::ranges::upper_bound(breakpoints, low);
         value != breakpoints.end() && *value < high; ++value) {
      cuts_.push_back(crossing_of(curve, *value, from, to));
    }
  };
  add_crossings(scene_.density.breakpoints(), density);
  add_crossings(scene_.colour.breakpoints(), colour);
  std::ranges::sort(cuts_);
  for (std::size_t i = 0; i + 1 < cuts_.size(); ++i) {
    if (cuts_[i + 1] > cuts_[i]) {
      add_part(length, density, colour, cuts_[i], cuts_[i + 1]);
    }
  }
}

void LightSum::add_part(double length, const Curve& density, const Curve& colour, double from,
                        double to) {
  const double middle = 0.5 * (from + to);
  const std::size_t part = scene_.density.part_of(density(middle));
  const bool is_empty = scene_.density.in_part(part, density(from)) <= 0.0 &&
                        scene_.density.in_part(part, density(middle)) <= 0.0 &&
                        scene_.density.in_part(part, density(to)) <= 0.0;
  if (is_empty && !is_glowing_) {
    return;
  }
  ++n_segments_;
  if (rule_) {
    add_curved_by_rule(length, density, colour, from, to);
  } else if (density.degree() <= 2 && colour.degree() <= 2) {
    add_quadratic(length, density, colour, from, to);
  } else {
    add_smooth(length, density, colour, from, to);
  }
}

void LightSum::add_quadratic(double length, const Curve& density, const Curve& colour,
                             double from, double to) {
  const double middle = 0.5 * (from + to);
  const std::size_t density_part = scene_.density.part_of(density(middle));
  const std::size_t colour_part = scene_.colour.part_of(colour(middle));
  const std::array<double, 3> rho = parabola_of<double>(
      [&](double x) { return scene_.density.in_part(density_part, x); }, density, from, to);
  const std::array<Array3d, 3> k = parabola_of<Array3d>(
      [&](double x) { return scene_.colour.in_part(colour_part, x); }, colour, from, to);
  // Nowhere negative, but for rounding.
  const double near = std::max(rho[0], 0.0);
  const double far = std::max(rho[2], 0.0);
  const double own_length = (to - from) * length;
  constexpr double kLeastFraction = 1e-17;
  const QuadraticWeights weights = quadratic_weights(
      {.near = near, .middle = std::max(rho[1], -std::sqrt(near) * std::sqrt(far)), .far = far},
      own_length, std::max(std::exp(-depth_left()), kLeastFraction));
  const Parabola& of_ends = is_glowing_ ? weights.of_glow : weights.of_chromaticity;
  const double scale = is_glowing_ ? own_length : 1.0;
  add_summed(
      {.light = scale * (of_ends.near * k[0] + of_ends.middle * k[1] + of_ends.far * k[2]),
       .opacity = weights.opacity,
       .transparency = weights.transparency});
}

/// By Gauss' rule on steps of little depth.
void LightSum::add_smooth(double length, const Curve& density, const Curve& colour, double from,
                          double to) {
  constexpr double kLeastStep = 1e-9;
  const double middle = 0.5 * (from + to);
  const std::size_t density_part = scene_.density.part_of(density(middle));
  const std::size_t colour_part = scene_.colour.part_of(colour(middle));
  const auto rho_at = [&](double s) {
    return std::max(0.0, scene_.density.in_part(density_part, density(s)));
  };
  const auto k_at = [&](double s) -> Array3d {
    return scene_.colour.in_part(colour_part, colour(s));
  };
  PixelLight sum;
  double depth = 0.0;
  double step = to - from;
  const double deepest = std::min(depth_left(), kNoLight);
  for (double s = from; s < to && depth < deepest;) {
    step = std::min(step, to - s);
    Eigen::Matrix<double, kNodes, 1> rho;
    double of_step = 0.0;
    while (true) {
      of_step = 0.0;
      for (std::size_t i = 0; i < kNodes; ++i) {
        const double extinction = rho_at(s + step * Rule::kPoints.at(i));
        rho[static_cast<Eigen::Index>(i)] = extinction;
        of_step += Rule::kWeights.at(i) * extinction;
      }
      of_step *= step * length;
      if (of_step <= kPieceDepth || step <= kLeastStep) {
        break;
      }
      step *= 0.5;
    }
    const double scale = step * length;
    if (of_step > kPieceDepth) {  // so short that it is linear
      const SegmentWeights weights = segment_weights(rho_at(s), rho_at(s + step), scale);
      const EndWeights& of_ends = is_glowing_ ? weights.of_glow : weights.of_chromaticity;
      sum.light += sum.transparency * (is_glowing_ ? scale : 1.0) *
                   (of_ends.near * k_at(s) + of_ends.far * k_at(s + step));
      sum.opacity += sum.transparency * weights.opacity;
      sum.transparency *= weights.transparency;
    } else {
      const Eigen::Matrix<double, kNodes, 1> depths = scale * (integrals_to_points() * rho);
      for (std::size_t i = 0; i < kNodes; ++i) {
        const auto row = static_cast<Eigen::Index>(i);
        const double weight = sum.transparency * scale * Rule::kWeights.at(i) *
                              std::exp(-std::max(depths[row], 0.0)) *
                              (is_glowing_ ? 1.0 : rho[row]);
        sum.light += weight * k_at(s + step * Rule::kPoints.at(i));
      }
      sum.opacity += sum.transparency * -std::expm1(-of_step);
      sum.transparency *= std::exp(-of_step);
    }
    depth += of_step;
    s += step;
    step *= 2.0;
  }
  add_summed(sum);
}

void LightSum::add_summed(const PixelLight& sum) {
  depth_ += sum.transparency > 0.0 ? -std::log(sum.transparency) : kNoLight;
  depths_near_.push_back(0.0);
  depths_far_.push_back(0.0);
  pieces_.push_back({.near = sum.light,
                     .far = Array3d::Zero(),
                     .length = 0.0,
                     .opacity = sum.opacity,
                     .transparency = sum.transparency,
                     .pixel = pixel_});
  if (pieces_.size() == kBatch) {
    composite();
  }
}

/// The pieces so far, which of each pixel come from the eye on.
void LightSum::composite() {
  if (rule_) {
    composite_by_rule();
    return;
  }
  const std::size_t n = pieces_.size();
  for (std::vector<double>& column : weights_) {
    column.resize(n);
  }
  find_weights(depths_near_, depths_far_,
               {.chromaticity_near = weights_[0],
                .chromaticity_far = weights_[1],
                .glow_near = weights_[2],
                .glow_far = weights_[3],
                .transparency = weights_[4]});
  const std::size_t first = is_glowing_ ? 2 : 0;
  for (std::size_t i = 0; i < n; ++i) {
    const Piece& piece = pieces_[i];
    PixelLight& pixel = light_[piece.pixel];
    if (piece.opacity >= 0.0) {
      pixel.light += pixel.transparency * piece.near;
      pixel.opacity += pixel.transparency * piece.opacity;
      pixel.transparency *= piece.transparency;
      continue;
    }
    const double scale = pixel.transparency * (is_glowing_ ? piece.length : 1.0);
    pixel.light += scale * weights_.at(first)[i] * piece.near +
                   scale * weights_.at(first + 1)[i] * piece.far;
    pixel.opacity += pixel.transparency * (weights_[0][i] + weights_[1][i]);
    pixel.transparency *= weights_[4][i];
  }
  depths_near_.clear();
  depths_far_.clear();
  pieces_.clear();
}

const std::vector<PixelLight>& LightSum::finish() {
  composite();
  return light_;
}

}  // namespace haarlight::render
