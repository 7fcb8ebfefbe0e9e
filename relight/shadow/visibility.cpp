// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/visibility.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/order_statistics.h"

namespace haarlight::relight {
namespace {

constexpr double kStandardErrors = 3.0;  // of a mean that is lit
constexpr double kExcess = 0.02;  // about the noise of a camera value, spec/relight.md: 1 %

/// A pixel and its eight neighbours, as far as they are in the picture.
template <class Visit>
void for_each_around(int height, int width, int y, int x, Visit visit) {
  for (int j = std::max(0, y - 1); j <= std::min(height - 1, y + 1); ++j) {
    for (int i = std::max(0, x - 1); i <= std::min(width - 1, x + 1); ++i) {
      visit(j, i);
    }
  }
}

}  // namespace

void VisibilityCount::add(const VisibilityCount& other) {
  n_values += other.n_values;
  n_excess += other.n_excess;
  n_no_plate += other.n_no_plate;
  worst_excess = std::max(worst_excess, other.worst_excess);
}

void VisibilityCount::add_value(double v) {
  ++n_values;
  n_excess += v > 1.0 + kExcess ? 1 : 0;
  worst_excess = std::max(worst_excess, v - 1.0);
}

double plate_falloff(const render::SquareLight& light, const Eigen::Vector3d& point,
                     const Eigen::Vector3d& normal) {
  const Eigen::Vector3d to_light = light.centre - point;
  const double r2 = to_light.squaredNorm();
  if (r2 == 0.0) {
    return 0.0;
  }
  const double r = std::sqrt(r2);
  const double cos_surface = normal.dot(to_light) / r;
  const double cos_light = -light.emits.dot(to_light) / r;
  if (cos_surface <= 0.0 || cos_light <= 0.0) {
    return 0.0;
  }
  return cos_surface * std::pow(cos_light, light.lobe_mu) / r2;
}

double fit_plate_scale(std::span<const float> values, std::span<const double> falloffs) {
  HAARLIGHT_EXPECTS(values.size() == falloffs.size(), "one falloff per value");
  std::vector<double> ratios;
  ratios.reserve(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (falloffs[i] > 0.0) {
      ratios.push_back(static_cast<double>(values[i]) / falloffs[i]);
    }
  }
  if (ratios.empty()) {
    return 0.0;
  }
  const double rough = upper_median(std::span(ratios));
  std::erase_if(ratios, [rough](double r) { return std::abs(r - rough) > 0.25 * rough; });
  return ratios.empty() ? rough : upper_median(std::span(ratios));
}

bool shows_plane(std::span<const float> values, std::span<const float> plate,
                 const PlaneTest& test) {
  HAARLIGHT_EXPECTS(values.size() == plate.size(), "one plate value per light");
  std::size_t n_usable = 0;
  std::size_t n_lit = 0;
  std::size_t n_bright = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const auto b = double{plate[k]};
    if (b <= 0.0) {
      continue;
    }
    const double ratio = static_cast<double>(values[k]) / b;
    ++n_usable;
    n_lit += std::abs(ratio - 1.0) <= test.tolerance ? 1 : 0;
    n_bright += ratio > 1.0 + test.tolerance ? 1 : 0;
  }
  const auto usable = static_cast<double>(n_usable);
  return n_usable > 0 && static_cast<double>(n_lit) >= test.min_lit_fraction * usable &&
         static_cast<double>(n_bright) <= test.max_bright_fraction * usable;
}

double falloff_slope(const render::SquareLight& light, const Eigen::Vector3d& point,
                     const Eigen::Vector3d& normal, const Eigen::Vector3d& step) {
  const Eigen::Vector3d to_light = light.centre - point;
  const double over_surface = normal.dot(to_light);
  const double before_light = -light.emits.dot(to_light);
  if (over_surface <= 0.0 || before_light <= 0.0) {
    return 0.0;
  }
  // falloff = over_surface before_light^mu / r^(3 + mu); to_light moves by -step.
  return -normal.dot(step) / over_surface +
         light.lobe_mu * light.emits.dot(step) / before_light +
         (3.0 + light.lobe_mu) * to_light.dot(step) / to_light.squaredNorm();
}

SurfaceHeight height_from_falloff(std::span<const float> values, std::span<const float> plate,
                                  std::span<const double> slopes, double tolerance) {
  HAARLIGHT_EXPECTS(values.size() == plate.size() && values.size() == slopes.size(),
                    "one plate value and one slope per light");
  Eigen::Vector3d sums = Eigen::Vector3d::Zero();  // of 1, slope, excess
  Eigen::Vector3d squares =
      Eigen::Vector3d::Zero();  // slope slope, slope excess, excess excess
  for (std::size_t k = 0; k < values.size(); ++k) {
    const auto b = double{plate[k]};
    const double excess = b > 0.0 ? double{values[k]} / b - 1.0 : 2.0 * tolerance;
    if (std::abs(excess) <= tolerance) {
      sums += Eigen::Vector3d(1.0, slopes[k], excess);
      squares += Eigen::Vector3d(slopes[k] * slopes[k], slopes[k] * excess, excess * excess);
    }
  }
  const double n = sums[0];
  const double spread = squares[0] - sums[1] * sums[1] / n;
  if (!(n > 2.0) || !(spread > 1e-12 * squares[0])) {
    return {0.0, std::numeric_limits<double>::infinity()};
  }
  const double height = (squares[1] - sums[1] * sums[2] / n) / spread;
  const double left = squares[2] - sums[2] * sums[2] / n - height * height * spread;
  return {height, std::sqrt(std::max(0.0, left) / ((n - 2.0) * spread))};
}

double settle_lit(Image<float>& value, ImageView<const std::uint8_t> usable, double tolerance) {
  HAARLIGHT_EXPECTS(usable.height() == value.height() && usable.width() == value.width(),
                    "one flag per pixel");
  std::vector<float> off;
  for (int y = 0; y < value.height(); ++y) {
    for (int x = 0; x < value.width(); ++x) {
      const float distance = std::abs(value(y, x) - 1.0F);
      if (usable(y, x) != 0 && static_cast<double>(distance) <= tolerance) {
        off.push_back(distance);
      }
    }
  }
  if (off.empty()) {
    return 0.0;
  }
  const double sigma = kSigmaPerMad * static_cast<double>(upper_median(std::span(off)));
  const Image<float> noisy = value;
  for (int y = 0; y < value.height(); ++y) {
    for (int x = 0; x < value.width(); ++x) {
      if (usable(y, x) == 0) {
        continue;
      }
      double sum = 0.0;
      int n = 0;
      for_each_around(value.height(), value.width(), y, x, [&](int j, int i) {
        if (usable(j, i) != 0) {
          sum += static_cast<double>(noisy(j, i));
          ++n;
        }
      });
      if (sum / n >= 1.0 - kStandardErrors * sigma / std::sqrt(n)) {
        value(y, x) = 1.0F;
      }
    }
  }
  return sigma;
}

Image<std::uint8_t> grow_hidden(ImageView<const std::uint8_t> shows_plane) {
  Image<std::uint8_t> out(shows_plane.height(), shows_plane.width(), 1);
  for (int y = 0; y < shows_plane.height(); ++y) {
    for (int x = 0; x < shows_plane.width(); ++x) {
      bool is_clear = true;
      for_each_around(shows_plane.height(), shows_plane.width(), y, x,
                      [&](int j, int i) { is_clear = is_clear && shows_plane(j, i) != 0; });
      out(y, x) = is_clear ? 1 : 0;
    }
  }
  return out;
}

}  // namespace haarlight::relight
