// SPDX-License-Identifier: Apache-2.0
#include "render/volume/contours.h"

#include <algorithm>
#include <cmath>

namespace haarlight::render {

namespace {

std::int8_t sign_of(double x, double noise) {
  return static_cast<std::int8_t>((x > noise) - (x < -noise));
}

}  // namespace

SurfaceLight seen_of(const Contour& contour, double cosine) {
  constexpr double kLeastCosine = 1e-6;
  const double c = std::clamp(cosine, kLeastCosine, 1.0);
  SurfaceLight seen;
  seen.opacity = contour.opacity < 1.0 ? -std::expm1(std::log1p(-contour.opacity) / c) : 1.0;
  // Of light from the eye the mirror's direction is 2 theta off it.
  const double mirrored = std::max(0.0, 2.0 * c * c - 1.0);
  seen.light = seen.opacity * (contour.colour * (contour.ambient + contour.diffuse * c) +
                               contour.specular * std::pow(mirrored, contour.exponent));
  return seen;
}

ContourTracker::ContourTracker(const std::vector<Contour>& contours)
    : contours_(contours), sides_(contours.size(), 0) {}

/// From `begin` to `end` along a stretch the field only rises or only falls; find(value) is where it
/// has a value.
template <class Find>
void ContourTracker::add_hits(double at_begin, double at_end, double begin, double end,
                              double noise, const Find& find) {
  for (std::size_t i = 0; i < contours_.size(); ++i) {
    const double value = contours_[i].value;
    const std::int8_t before = is_new_ ? sign_of(at_begin - value, noise) : sides_[i];
    const std::int8_t after = sign_of(at_end - value, noise);
    if (before * after < 0) {
      const bool is_between = sign_of(at_begin - value, noise) * after < 0;
      hits_.push_back({.s = is_between ? find(value) : begin, .contour = i});
    } else if (before != 0 && after == 0) {
      hits_.push_back({.s = end, .contour = i});
    } else if (before == 0 && after != 0 && is_new_) {
      hits_.push_back({.s = begin, .contour = i});
    }
    sides_[i] = after;
  }
  is_new_ = false;
}

const std::vector<ContourTracker::Hit>& ContourTracker::between(double from, double to) {
  hits_.clear();
  add_hits(from, to, 0.0, 1.0, 0.0,
           [&](double value) { return std::clamp((value - from) / (to - from), 0.0, 1.0); });
  std::ranges::stable_sort(hits_, {}, &Hit::s);
  return hits_;
}

const std::vector<ContourTracker::Hit>& ContourTracker::along(const Curve& curve,
                                                              double noise) {
  hits_.clear();
  turns_.assign({0.0, 1.0});
  curve.add_turns(turns_);
  std::ranges::sort(turns_);
  for (std::size_t i = 0; i + 1 < turns_.size(); ++i) {
    const double begin = turns_[i];
    const double end = turns_[i + 1];
    add_hits(curve(begin), curve(end), begin, end, noise,
             [&](double value) { return crossing_of(curve, value, begin, end); });
  }
  std::ranges::stable_sort(hits_, {}, &Hit::s);
  return hits_;
}

}  // namespace haarlight::render
