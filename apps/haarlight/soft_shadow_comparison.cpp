// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/soft_shadow_comparison.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace haarlight::apps {

namespace {

/// A float's rounding of 1: as light as that is lit.
constexpr float kLit = 1.0F - 1e-6F;

enum class Side : std::uint8_t { unseen, outside, inside };

/// Calls `function(neighbour)` for the pixels around one, at most eight.
template <class Function>
void for_neighbours(std::size_t pixel, int width, int height, const Function& function) {
  const int x = static_cast<int>(pixel % static_cast<std::size_t>(width));
  const int y = static_cast<int>(pixel / static_cast<std::size_t>(width));
  for (int v = std::max(0, y - 1); v <= std::min(height - 1, y + 1); ++v) {
    for (int u = std::max(0, x - 1); u <= std::min(width - 1, x + 1); ++u) {
      const auto other = static_cast<std::size_t>(v) * static_cast<std::size_t>(width) +
                         static_cast<std::size_t>(u);
      if (other != pixel) {
        function(other);
      }
    }
  }
}

/// How far the pixels that `values` has on another side than `exact` are from the exact border.
int border_distance(const std::vector<Side>& values, const std::vector<Side>& exact, int width,
                    int height) {
  constexpr int kFar = -1;
  std::vector<int> steps(exact.size(), kFar);
  std::vector<std::size_t> reached;
  for (std::size_t i = 0; i < exact.size(); ++i) {
    bool is_border = false;
    for_neighbours(i, width, height, [&](std::size_t other) {
      is_border = is_border || (exact[i] != Side::unseen && exact[other] != Side::unseen &&
                                exact[i] != exact[other]);
    });
    if (is_border) {
      steps[i] = 1;
      reached.push_back(i);
    }
  }
  int farthest = 0;
  for (std::size_t next = 0; next < reached.size(); ++next) {
    const std::size_t i = reached[next];
    if (values[i] != exact[i]) {
      farthest = std::max(farthest, steps[i]);
    }
    for_neighbours(i, width, height, [&](std::size_t other) {
      if (steps[other] == kFar) {
        steps[other] = steps[i] + 1;
        reached.push_back(other);
      }
    });
  }
  // No border at all: as far as the picture goes.
  return reached.empty() && values != exact ? std::max(width, height) : farthest;
}

}  // namespace

ShadowComparison::ShadowComparison(std::vector<std::size_t> pixels, int width, int height)
    : pixels_(std::move(pixels)), width_(width), height_(height) {}

Image<float> ShadowComparison::add(const std::vector<render::LightShadow>& values,
                                   const std::vector<render::LightShadow>& exact) {
  Image<float> difference(height_, width_, 1);
  const std::size_t n = difference.pixels().size();
  std::vector<Side> umbra(n);
  std::vector<Side> exact_umbra(n);
  std::vector<Side> lit(n);
  std::vector<Side> exact_lit(n);
  const auto side = [](bool is_inside) { return is_inside ? Side::inside : Side::outside; };
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (exact[i].kind == render::ShadowKind::unsure ||
        exact[i].kind == render::ShadowKind::traced) {
      continue;
    }
    const float error = values[i].visibility - exact[i].visibility;
    const std::size_t pixel = pixels_[i];
    difference.pixels()[pixel] = error;
    umbra[pixel] = side(values[i].visibility <= 1.0F - kLit);
    exact_umbra[pixel] = side(exact[i].visibility <= 1.0F - kLit);
    lit[pixel] = side(values[i].visibility >= kLit);
    exact_lit[pixel] = side(exact[i].visibility >= kLit);
    ++all_.n_compared;
    all_.worst = std::max(all_.worst, static_cast<double>(std::abs(error)));
    if (exact_umbra[pixel] == Side::outside && exact_lit[pixel] == Side::outside) {
      penumbra_errors_.push_back(std::abs(error));
      sum_ += error;
    }
  }
  all_.umbra_border_pixels =
      std::max(all_.umbra_border_pixels, border_distance(umbra, exact_umbra, width_, height_));
  all_.penumbra_border_pixels =
      std::max(all_.penumbra_border_pixels, border_distance(lit, exact_lit, width_, height_));
  return difference;
}

ShadowErrors ShadowComparison::errors() const {
  ShadowErrors errors = all_;
  std::vector<float> sorted = penumbra_errors_;
  std::ranges::sort(sorted);
  errors.n_penumbra = static_cast<std::int64_t>(sorted.size());
  if (!sorted.empty()) {
    double sum = 0.0;
    for (const float error : sorted) {
      sum += error;
    }
    errors.mean = sum / static_cast<double>(sorted.size());
    errors.mean_error = sum_ / static_cast<double>(sorted.size());
    errors.at_99 = sorted[(sorted.size() * 99 + 99) / 100 - 1];
  }
  return errors;
}

}  // namespace haarlight::apps
