// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/hull_parts.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/count.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"
#include "relight/shape/min_cut.h"
#include "relight/shape/part_heights.h"

namespace haarlight::relight {

namespace {

constexpr double kMostCost = 10.0;  // of a pixel, in sigmas: a wrong bound counts no more
constexpr double kOfLikely = 0.02;  // weight of the likely bounds where the picture is divided
constexpr double kOfLikelyPlace = 0.2;  // and where a part is placed
constexpr double kOutside = 3.0;        // sigmas beyond the bounds: the surface is not there
constexpr double kSmooth = 5.0;         // cost of a step between two pixels that look alike
constexpr double kLeastSmooth = 0.05;   // between two that do not
constexpr double kAngleDeg = 15.0;      // between normals: they do not look alike
constexpr double kAlbedo = 0.15;        // relative difference: the same
constexpr double kSpare = 0.25;         // of a move
constexpr int kMostRegions = 32;
constexpr double kNearlyAsWell = 0.05;  // of kMostCost, per pixel
constexpr double kTimesBest = 3.0;

/// Beyond a bound: > 0 too far, < 0 too near; 0 within, or without any.
double excess_of(const DepthBounds& bounds, std::size_t i, double depth) {
  const double low = bounds.low.pixels()[i];
  const double high = bounds.high.pixels()[i];
  return low < high ? depth - std::clamp(depth, low, high) : 0.0;
}

/// @param spare  so far beyond a bound costs nothing
double cost_of(const HullBounds& bounds, std::size_t i, double depth, double of_likely,
               double spare = 0.0) {
  const auto one = [&](const DepthBounds& of) {
    const double excess = std::max(0.0, std::abs(excess_of(of, i, depth)) - spare);
    return std::min(excess / bounds.sigma, kMostCost);
  };
  return one(bounds.possible) + of_likely * one(bounds.likely);
}

/// The largest connected set of pixels that lie outside on one side.
std::vector<std::size_t> largest_outside(const HullBounds& bounds, const Image<float>& depth,
                                         const Image<std::uint8_t>& is_known) {
  const int h = depth.height();
  const int w = depth.width();
  std::vector<std::size_t> largest;
  for (const double side : {1.0, -1.0}) {
    Image<std::uint8_t> is_outside(h, w, 1);
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = count(y) * count(w) + count(x);
        is_outside(y, x) =
            is_known(y, x) != 0 &&
            side * excess_of(bounds.possible, i, double{depth(y, x)}) > kOutside * bounds.sigma;
      }
    }
    const Parts parts = find_parts(is_outside.view());
    std::vector<std::vector<std::size_t>> sets(count(parts.n_parts));
    for (std::size_t i = 0; i < parts.label.pixels().size(); ++i) {
      if (parts.label.pixels()[i] >= 0) {
        sets[count(parts.label.pixels()[i])].push_back(i);
      }
    }
    for (std::vector<std::size_t>& set : sets) {
      if (set.size() > largest.size()) {
        largest = std::move(set);
      }
    }
  }
  return largest;
}

double median_excess(const HullBounds& bounds, std::span<const float> depth,
                     const std::vector<std::size_t>& pixels) {
  std::vector<double> all;
  all.reserve(pixels.size());
  for (const std::size_t i : pixels) {
    all.push_back(excess_of(bounds.possible, i, double{depth[i]}));
  }
  return upper_median(all);
}

/// What parting two neighbours costs: less where normals or albedo change.
float step_cost(const SurfaceEstimate& surface, int y0, int x0, int y1, int x1) {
  double dot = 0.0;
  for (int c = 0; c < 3; ++c) {
    dot += double{surface.normal(y0, x0, c)} * double{surface.normal(y1, x1, c)};
  }
  const double angle = std::acos(std::clamp(dot, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  double difference = 0.0;
  double sum = 0.0;
  for (int c = 0; c < surface.albedo.channels(); ++c) {
    difference +=
        std::abs(double{surface.albedo(y0, x0, c)} - double{surface.albedo(y1, x1, c)});
    sum += double{surface.albedo(y0, x0, c)} + double{surface.albedo(y1, x1, c)};
  }
  const double albedo = sum > 0.0 ? 2.0 * difference / sum : 0.0;
  const double unlike = std::pow(angle / kAngleDeg, 2) + std::pow(albedo / kAlbedo, 2);
  return static_cast<float>(kLeastSmooth + kSmooth * std::exp(-unlike));
}

struct StepCosts {
  Image<float> right;
  Image<float> down;
};

StepCosts step_costs(const SurfaceEstimate& surface, const Image<std::uint8_t>& is_known) {
  const int h = is_known.height();
  const int w = is_known.width();
  StepCosts costs{Image<float>(h, w, 1), Image<float>(h, w, 1)};
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (is_known(y, x) == 0) {
        continue;
      }
      if (x + 1 < w && is_known(y, x + 1) != 0) {
        costs.right(y, x) = step_cost(surface, y, x, y, x + 1);
      }
      if (y + 1 < h && is_known(y + 1, x) != 0) {
        costs.down(y, x) = step_cost(surface, y, x, y + 1, x);
      }
    }
  }
  return costs;
}

/// Evenly spread pixels of a part: enough for a mean over it, whatever the picture's size.
std::vector<std::size_t> sampled(const std::vector<std::size_t>& part) {
  constexpr std::size_t kMost = 4096;
  const std::size_t stride = (part.size() + kMost - 1) / kMost;
  std::vector<std::size_t> some;
  for (std::size_t i = 0; i < part.size(); i += stride) {
    some.push_back(part[i]);
  }
  return some;
}

/// The costs of a part at each move along the view, half a voxel apart, and what they allow.
PartMoves moves_of(const HullBounds& bounds, const Image<float>& depth,
                   const std::vector<std::size_t>& part) {
  PartMoves moves;
  if (part.empty()) {
    return moves;
  }
  moves.is_known = true;
  double least = std::numeric_limits<double>::infinity();
  double most = -least;
  for (const std::size_t i : part) {
    const double here = depth.pixels()[i];
    least = std::min(least, double{bounds.possible.low.pixels()[i]} - here);
    most = std::max(most, double{bounds.possible.high.pixels()[i]} - here);
  }
  // Half a voxel apart: the bounds are no finer.
  constexpr int kMostSteps = 2000;
  const int n =
      std::clamp(static_cast<int>((most - least) / (0.5 * bounds.sigma)), 1, kMostSteps);
  const double step = (most - least) / n;
  std::vector<double> costs;
  for (int k = 0; k <= n; ++k) {
    double sum = 0.0;
    for (const std::size_t i : part) {
      sum += cost_of(bounds, i, double{depth.pixels()[i]} + least + k * step, kOfLikelyPlace);
    }
    costs.push_back(sum / static_cast<double>(part.size()));
  }
  const auto best = std::min_element(costs.begin(), costs.end());
  // A surface that fits badly everywhere is misshapen: it says less about where it is.
  const double limit = kTimesBest * *best + kNearlyAsWell * kMostCost;
  const auto is_over = [&](double cost) { return cost > limit; };
  const auto end = std::find_if(best, costs.end(), is_over);
  const auto begin =
      std::find_if(std::make_reverse_iterator(best), costs.rend(), is_over).base();
  // Of equal ones the middle.
  const auto same =
      std::find_if(best, costs.end(), [&](double cost) { return cost > *best + 1e-9; });
  moves.best =
      least +
      step * 0.5 * static_cast<double>((best - costs.begin()) + (same - 1 - costs.begin()));
  moves.nearest = least + step * static_cast<double>(begin - costs.begin());
  moves.furthest = least + step * static_cast<double>(end - 1 - costs.begin());
  return moves;
}

}  // namespace

int divide_by_hull(const HullBounds& bounds, const Image<float>& depth,
                   const SurfaceEstimate& surface, const Image<std::uint8_t>& is_known,
                   Image<int>& region) {
  const int h = depth.height();
  const int w = depth.width();
  HAARLIGHT_EXPECTS(bounds.sigma > 0.0 && bounds.possible.low.height() == h &&
                        bounds.possible.low.width() == w && region.height() == h &&
                        region.width() == w,
                    "bounds and regions of the same picture");
  Image<float> at = depth;
  TwoLabels costs{Image<float>(h, w, 1), Image<float>(h, w, 1), {}, {}};
  StepCosts steps = step_costs(surface, is_known);
  costs.right = std::move(steps.right);
  costs.down = std::move(steps.down);
  Image<std::uint8_t> open = is_known;
  int n_regions = *std::max_element(region.pixels().begin(), region.pixels().end()) + 1;
  int n_added = 0;
  while (n_added < kMostRegions) {
    const std::vector<std::size_t> outside = largest_outside(bounds, at, open);
    if (outside.size() < kLeastPartPixels) {
      break;
    }
    const double move = -median_excess(bounds, at.pixels(), outside);
    // Pixels that are off by less than a part of the move do not ask for it: smooth heights lean
    // towards the step.
    const double spare = kSpare * std::abs(move);
    for (std::size_t i = 0; i < at.pixels().size(); ++i) {
      const bool is_in = is_known.pixels()[i] != 0;
      const double here = at.pixels()[i];
      costs.stays.pixels()[i] =
          is_in ? static_cast<float>(cost_of(bounds, i, here, kOfLikely, spare)) : 0.0F;
      costs.moves.pixels()[i] =
          is_in ? static_cast<float>(cost_of(bounds, i, here + move, kOfLikely, spare)) : 1.0F;
    }
    const Image<std::uint8_t> moves = best_division(costs);
    std::int64_t n_moved = 0;
    for (std::size_t i = 0; i < at.pixels().size(); ++i) {
      if (moves.pixels()[i] != 0 && is_known.pixels()[i] != 0) {
        at.pixels()[i] += static_cast<float>(move);
        region.pixels()[i] = n_regions;
        ++n_moved;
      }
    }
    n_added += n_moved > 0 ? 1 : 0;
    n_regions += n_moved > 0 ? 1 : 0;
    for (const std::size_t i : outside) {  // looked at once, whatever came of it
      open.pixels()[i] = 0;
    }
  }
  return n_added;
}

std::vector<PartMoves> part_moves(const HullBounds& bounds, const Image<float>& depth,
                                  const Parts& parts) {
  std::vector<std::vector<std::size_t>> pixels(count(parts.n_parts));
  for (std::size_t i = 0; i < parts.label.pixels().size(); ++i) {
    const int label = parts.label.pixels()[i];
    if (label >= 0 && bounds.possible.low.pixels()[i] < bounds.possible.high.pixels()[i]) {
      pixels[count(label)].push_back(i);
    }
  }
  std::vector<PartMoves> all;
  all.reserve(pixels.size());
  for (const std::vector<std::size_t>& part : pixels) {
    all.push_back(moves_of(bounds, depth, sampled(part)));
  }
  return all;
}

}  // namespace haarlight::relight
