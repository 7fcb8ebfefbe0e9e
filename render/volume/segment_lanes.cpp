// SPDX-License-Identifier: Apache-2.0
/// @file
/// find_weights(): segments sorted by the rule that they need, then each rule over full vectors.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/vector_clones.h"
#include "haarlight/core/error.h"
#include "render/volume/segment.h"
#include "render/volume/segment_kernel.h"

namespace haarlight::render {

namespace {

constexpr std::size_t kLanes = 16;
using Lane = std::array<double, kLanes>;

struct alignas(64) Lanes {
  Lane a{};
  Lane b{};
  Lane near_k{};
  Lane far_k{};
  Lane near_g{};
  Lane far_g{};
  Lane transparency{};
};

/// Those of a rule, in the order of the points, as segment::by_gauss().
template <std::size_t n>
inline void add_points(Lanes& lanes) {
  constexpr const std::array<double, n>& kS = segment::GaussRule<n>::kPoints;
  const Lane a = lanes.a;
  const Lane b = lanes.b;
  Lane near_k{};
  Lane far_k{};
  Lane near_g{};
  Lane far_g{};
  for (std::size_t i = 0; i < n; ++i) {
    const double s = kS[i];
    const double rest = kS[n - 1 - i];
    const double of_a = 0.5 * s * (1.0 + rest);
    const double of_b = 0.5 * s * s;
    const double of_rule = segment::GaussRule<n>::kWeights[i];
    for (std::size_t l = 0; l < kLanes; ++l) {
      const double weight = of_rule * segment::exp_for_rule<n>(of_a * a[l] + of_b * b[l]);
      const double of_near = rest * weight;
      const double of_far = s * weight;
      const double rho = rest * a[l] + s * b[l];
      near_g[l] += of_near;
      far_g[l] += of_far;
      near_k[l] += of_near * rho;
      far_k[l] += of_far * rho;
    }
  }
  lanes.near_k = near_k;
  lanes.far_k = far_k;
  lanes.near_g = near_g;
  lanes.far_g = far_g;
  for (std::size_t l = 0; l < kLanes; ++l) {
    lanes.transparency[l] = 1.0 - (near_k[l] + far_k[l]);
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")
void five_points(Lanes& lanes) { add_points<5>(lanes); }

HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")
void eight_points(Lanes& lanes) { add_points<8>(lanes); }

HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")
void ten_points(Lanes& lanes) { add_points<10>(lanes); }

HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")
void closed_form(Lanes& lanes) {
  for (std::size_t l = 0; l < kLanes; ++l) {
    const segment::Integrals value = segment::by_closed_form(lanes.a[l], lanes.b[l]);
    lanes.near_k[l] = value.near_k;
    lanes.far_k[l] = value.far_k;
    lanes.near_g[l] = value.near_g;
    lanes.far_g[l] = value.far_g;
    lanes.transparency[l] = value.transparency;
  }
}

struct Rule {
  double up_to;   ///< max(a, b), and above that of the rule before
  double filler;  ///< depths of lanes without a segment
  void (*find)(Lanes&);
};

constexpr std::array<Rule, 4> kRules = {{
    {segment::kFivePointsUpTo, 0.0, &five_points},
    {segment::kEightPointsUpTo, 0.0, &eight_points},
    {segment::kTenPointsUpTo, 0.0, &ten_points},
    {kLargestDepth, 3.0, &closed_form},
}};

/// So many are sorted by their rules at a time.
constexpr std::size_t kBlock = 256;

/// Which segments of a block are a rule's.
struct Members {
  std::array<std::uint16_t, kBlock> of{};
  std::size_t n = 0;
};

void find_members(const Rule& rule, std::span<const std::uint16_t> members,
                  std::span<const double> near, std::span<const double> far,
                  const SegmentSpans& weights, std::size_t begin) {
  Lanes lanes;
  for (std::size_t first = 0; first < members.size(); first += kLanes) {
    const auto some = members.subspan(first, std::min(kLanes, members.size() - first));
    for (std::size_t l = 0; l < some.size(); ++l) {
      lanes.a[l] = near[begin + some[l]];
      lanes.b[l] = far[begin + some[l]];
    }
    for (std::size_t l = some.size(); l < kLanes; ++l) {
      lanes.a[l] = rule.filler;
      lanes.b[l] = rule.filler;
    }
    rule.find(lanes);
    for (std::size_t l = 0; l < some.size(); ++l) {
      const std::size_t i = begin + some[l];
      weights.chromaticity_near[i] = lanes.near_k[l];
      weights.chromaticity_far[i] = lanes.far_k[l];
      weights.glow_near[i] = lanes.near_g[l];
      weights.glow_far[i] = lanes.far_g[l];
      weights.transparency[i] = lanes.transparency[l];
    }
  }
}

void find_block(std::span<const double> near, std::span<const double> far,
                const SegmentSpans& weights, std::size_t begin, std::size_t n) {
  std::array<Members, kRules.size()> members;
  for (std::size_t i = 0; i < n; ++i) {
    const double m = std::max(near[begin + i], far[begin + i]);
    std::size_t of_rule = 0;
    for (std::size_t rule = 0; rule + 1 < kRules.size(); ++rule) {
      of_rule += m > kRules[rule].up_to ? 1 : 0;
    }
    Members& ours = members[of_rule];
    ours.of[ours.n++] = static_cast<std::uint16_t>(i);
  }
  for (std::size_t rule = 0; rule < kRules.size(); ++rule) {
    find_members(kRules[rule], std::span(members[rule].of).first(members[rule].n), near, far,
                 weights, begin);
  }
}

bool are_depths(std::span<const double> depths) {
  return std::ranges::all_of(depths, [](double x) { return x >= 0.0 && x <= kLargestDepth; });
}

}  // namespace

void find_weights(std::span<const double> depths_near, std::span<const double> depths_far,
                  const SegmentSpans& weights) {
  const std::size_t n = depths_near.size();
  HAARLIGHT_EXPECTS(depths_far.size() == n && weights.chromaticity_near.size() == n &&
                        weights.chromaticity_far.size() == n && weights.glow_near.size() == n &&
                        weights.glow_far.size() == n && weights.transparency.size() == n,
                    "as many results as segments");
  HAARLIGHT_EXPECTS(are_depths(depths_near) && are_depths(depths_far),
                    "optical depths, 0..1e300");
  for (std::size_t begin = 0; begin < n; begin += kBlock) {
    find_block(depths_near, depths_far, weights, begin, std::min(kBlock, n - begin));
  }
}

}  // namespace haarlight::render
