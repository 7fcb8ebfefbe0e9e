// SPDX-License-Identifier: Apache-2.0
#include "render/light/light_bvh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;
constexpr unsigned kDeep = 40;  // from there on halves are split, so that 64 levels are enough

double sine(double cosine) { return std::sqrt(std::max(0.0, 1.0 - cosine * cosine)); }

/// Cosine of max(0, a - b), of angles from 0 to pi.
double cos_less(double cos_a, double cos_b) {
  return cos_a >= cos_b ? 1.0 : cos_a * cos_b + sine(cos_a) * sine(cos_b);
}

double angle(double cosine) { return std::acos(std::clamp(cosine, -1.0, 1.0)); }

/// The smallest cone around two [Conty18].
void join_cones(const LightBounds& a, const LightBounds& b, LightBounds& joined) {
  const bool is_a_wide = a.cos_normals < b.cos_normals;
  const LightBounds& wide = is_a_wide ? a : b;
  const LightBounds& narrow = is_a_wide ? b : a;
  const double between = angle(wide.axis.dot(narrow.axis));
  const double wide_angle = angle(wide.cos_normals);
  const double narrow_angle = angle(narrow.cos_normals);
  joined.axis = wide.axis;
  joined.cos_normals = wide.cos_normals;
  if (between + narrow_angle <= wide_angle) {
    return;
  }
  const double whole = 0.5 * (wide_angle + between + narrow_angle);
  const Vector3d across = wide.axis.cross(narrow.axis);
  if (whole >= kPi || !(across.norm() > 1e-12)) {
    joined.cos_normals = -1.0;
    return;
  }
  joined.axis = Eigen::AngleAxisd(whole - wide_angle, across.normalized()) * wide.axis;
  joined.cos_normals = std::cos(std::min(kPi, whole + 1e-9));  // rounding loses no light
}

LightBounds join(const LightBounds& a, const LightBounds& b) {
  if (a.intensity == 0.0) {
    return b;
  }
  if (b.intensity == 0.0) {
    return a;
  }
  LightBounds joined;
  joined.box = a.box.merged(b.box);
  join_cones(a, b, joined);
  joined.has_cosine = a.has_cosine || b.has_cosine;
  joined.intensity = a.intensity + b.intensity;
  return joined;
}

/// Cost of a group of lights: its intensity times how far they are apart and how differently they
/// shine.
double cost(const LightBounds& bounds) {
  if (bounds.intensity == 0.0) {
    return 0.0;
  }
  const Vector3d size = bounds.box.sizes();
  const double area = size.x() * size.y() + size.y() * size.z() + size.z() * size.x() +
                      1e-6 * size.squaredNorm();  // of lights in a row, too
  const double normals = angle(bounds.cos_normals);
  const double end = std::min(kPi, normals + (bounds.has_cosine ? 0.5 * kPi : 0.0));
  const double solid = 2.0 * kPi * (1.0 - std::cos(normals)) +
                       0.5 * kPi *
                           (2.0 * end * std::sin(normals) - std::cos(normals - 2.0 * end) -
                            2.0 * normals * std::sin(normals) + std::cos(normals));
  return bounds.intensity * area * std::max(solid, 1e-3);
}

}  // namespace

double importance(const LightBounds& bounds, const Vector3d& point, const Vector3d& normal) {
  const Vector3d way = bounds.box.center() - point;
  const double radius_squared = 0.25 * bounds.box.sizes().squaredNorm();
  const double squared = way.squaredNorm();
  double cos_extent = -1.0;  // of the angle that the box takes up, from within it all
  double cos_point = 1.0;
  double cos_light = 1.0;
  if (squared > radius_squared) {
    const Vector3d direction = way / std::sqrt(squared);
    cos_extent = std::sqrt(1.0 - radius_squared / squared);
    cos_point = cos_less(normal.dot(direction), cos_extent);
    const double cos_axis = -bounds.axis.dot(direction);
    // Angles that are taken off one after the other, none below 0.
    cos_light = cos_less(cos_less(cos_axis, bounds.cos_normals), cos_extent);
    if (!bounds.has_cosine) {
      cos_light = cos_light > 1.0 - 1e-9 ? 1.0 : 0.0;
    }
  }
  if (!(cos_point > 0.0) || !(cos_light > 0.0)) {
    return 0.0;
  }
  // Within a box, and near it, its lights are much nearer than its middle is far; a fourth of its
  // radius is measured to be best (docs/numerics/surface.md).
  constexpr double kNearest = 1.0 / 16.0;
  return bounds.intensity * cos_point * cos_light /
         std::max(squared, kNearest * radius_squared);
}

LightBvh::LightBvh(std::span<const LightBounds> lights) : trails_(lights.size()) {
  if (lights.empty()) {
    return;
  }
  nodes_.reserve(2 * lights.size());
  std::vector<std::size_t> which(lights.size());
  std::iota(which.begin(), which.end(), std::size_t{0});
  build(lights, which, 0, 0);
}

std::size_t LightBvh::build(std::span<const LightBounds> lights, std::span<std::size_t> which,
                            std::uint64_t trail, unsigned depth) {
  const std::size_t node = nodes_.size();
  nodes_.emplace_back();
  if (which.size() == 1) {
    HAARLIGHT_EXPECTS(lights[which[0]].intensity > 0.0, "lights that shine");
    nodes_[node] = {.bounds = lights[which[0]], .light = which[0]};
    trails_[which[0]] = trail;
    return node;
  }
  Eigen::AlignedBox3d centres;
  for (const std::size_t light : which) {
    centres.extend(lights[light].box.center());
  }
  constexpr int kBuckets = 12;
  double best = std::numeric_limits<double>::infinity();
  int best_axis = 0;
  double best_limit = 0.0;
  const auto coordinate = [&](std::size_t light, int axis) {
    return lights[light].box.center()[axis];
  };
  for (int axis = 0; axis < 3; ++axis) {
    const double low = centres.min()[axis];
    const double width = centres.max()[axis] - low;
    if (!(width > 0.0)) {
      continue;
    }
    std::array<LightBounds, kBuckets> buckets;
    const auto bucket_of = [&](std::size_t light) {
      return std::min(kBuckets - 1,
                      static_cast<int>((coordinate(light, axis) - low) / width * kBuckets));
    };
    for (const std::size_t light : which) {
      LightBounds& bucket = buckets.at(static_cast<std::size_t>(bucket_of(light)));
      bucket = join(bucket, lights[light]);
    }
    std::array<double, kBuckets> below{};
    LightBounds sum;
    for (std::size_t i = 0; i + 1 < kBuckets; ++i) {
      sum = join(sum, buckets.at(i));
      below.at(i) = cost(sum);
    }
    sum = {};
    for (std::size_t i = kBuckets - 1; i > 0; --i) {
      sum = join(sum, buckets.at(i));
      // A long box is not cut along its short sides.
      const double whole = (below.at(i - 1) + cost(sum)) * (centres.sizes().maxCoeff() / width);
      if (whole < best) {
        best = whole;
        best_axis = axis;
        best_limit = low + width * static_cast<double>(i) / kBuckets;
      }
    }
  }
  auto middle = std::partition(which.begin(), which.end(), [&](std::size_t light) {
    return coordinate(light, best_axis) < best_limit;
  });
  if (depth >= kDeep || middle == which.begin() || middle == which.end()) {
    middle = which.begin() + static_cast<std::ptrdiff_t>(which.size() / 2);
    std::nth_element(which.begin(), middle, which.end(), [&](std::size_t a, std::size_t b) {
      const double at_a = coordinate(a, best_axis);
      const double at_b = coordinate(b, best_axis);
      return at_a < at_b || (at_a == at_b && a < b);
    });
  }
  const auto n_first = static_cast<std::size_t>(middle - which.begin());
  const std::size_t first = build(lights, which.first(n_first), trail, depth + 1);
  const std::size_t second =
      build(lights, which.subspan(n_first), trail | (std::uint64_t{1} << depth), depth + 1);
  nodes_[node] = {.bounds = join(nodes_[first].bounds, nodes_[second].bounds),
                  .second = second};
  return node;
}

std::optional<double> LightBvh::first_probability(std::size_t node, const Vector3d& point,
                                                  const Vector3d& normal) const {
  const double first = importance(nodes_[node + 1].bounds, point, normal);
  const double second = importance(nodes_[nodes_[node].second].bounds, point, normal);
  const double sum = first + second;
  return sum > 0.0 ? std::optional(first / sum) : std::nullopt;
}

std::optional<LightBvh::Choice> LightBvh::choose(const Vector3d& point, const Vector3d& normal,
                                                 double number) const {
  if (nodes_.empty()) {
    return std::nullopt;
  }
  double probability = 1.0;
  std::size_t node = 0;
  while (nodes_[node].second != 0) {
    const std::optional<double> first = first_probability(node, point, normal);
    if (!first) {
      return std::nullopt;
    }
    if (number < *first) {
      number /= *first;
      probability *= *first;
      node = node + 1;
    } else {
      number = (number - *first) / (1.0 - *first);
      probability *= 1.0 - *first;
      node = nodes_[node].second;
    }
    number = std::clamp(number, 0.0, 0x1.fffffffffffffp-1);
  }
  if (nodes_.size() == 1 && !(importance(nodes_[0].bounds, point, normal) > 0.0)) {
    return std::nullopt;
  }
  return Choice{.light = nodes_[node].light, .probability = probability, .within = number};
}

double LightBvh::probability(std::size_t light, const Vector3d& point,
                             const Vector3d& normal) const {
  double probability = 1.0;
  std::size_t node = 0;
  for (std::uint64_t trail = trails_[light]; nodes_[node].second != 0; trail >>= 1U) {
    const std::optional<double> first = first_probability(node, point, normal);
    if (!first) {
      return 0.0;
    }
    const bool is_second = (trail & 1U) != 0;
    probability *= is_second ? 1.0 - *first : *first;
    node = is_second ? nodes_[node].second : node + 1;
  }
  return probability;
}

}  // namespace haarlight::render
