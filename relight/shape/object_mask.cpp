// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/object_mask.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include <Eigen/Cholesky>

#include "core/count.h"
#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "relight/shape/light_groups.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr std::size_t kRowsATask = 4;
constexpr int kLights = 128;           // enough to resolve fractions of a twentieth
constexpr double kLeastFacing = 0.05;  // of the plane to a light: below, not compared
constexpr double kShadow = 0.35;       // of the plane's brightness: below, it is occluded
constexpr double kBlack = 0.05;        // of it: below, nothing reflects
constexpr double kLeastLit = 0.05;     // fraction of lights needed for a decision
constexpr double kAgree = 0.75;        // fraction of the lights that reach the pixel
constexpr double kLeastPlane = 0.02;   // fraction of pixels that show the bare plane
constexpr double kLeastTolerance = 0.04;
constexpr double kMostTolerance = 0.08;

/// Calls visit(y, x, samples) for every pixel, its samples corrected for its point and loaded.
void for_each_pixel(
    const StackSource& stack, const StereoLights& lights, const std::vector<int>& use,
    const PixelPoints* plane,
    const std::function<void(int y, int x, const PixelSamples& samples)>& visit) {
  const StackDims dims = stack.dims();
  parallel_for(count(dims.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    constexpr int kSegment = 256;
    PixelSamples samples(dims, lights, use);
    std::vector<float> values;
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
      for (int x0 = 0; x0 < dims.width; x0 += kSegment) {
        const int width = std::min(kSegment, dims.width - x0);
        values.resize(count(width) * count(dims.channels) * count(dims.n_lights));
        stack.read_tile({x0, y, width, 1}, values);
        for (int i = 0; i < width; ++i) {
          if (plane != nullptr) {
            samples.aim(plane->at(x0 + i + 0.5, y + 0.5));
          }
          samples.take(values, i, width);
          visit(y, x0 + i, samples);
        }
      }
    }
  });
}

/// The value exceeded by a fraction `above` of them. Reorders.
float exceeded_by(std::vector<float>& values, double above) {
  if (values.empty()) {
    return 0.0F;
  }
  return quantile(std::span(values), 1.0 - above);
}

/// A pixel's brightness over that of a plane of albedo 1, by light.
void plane_ratios(const PixelSamples& samples, const Vector3d& normal,
                  std::vector<float>& ratios) {
  ratios.clear();
  for (int j = 0; j < samples.n(); ++j) {
    const double facing = samples.direction(j).dot(normal);
    if (samples.scale(j) > 0.0 && facing > kLeastFacing) {
      ratios.push_back(static_cast<float>(samples.value(j) / facing));
    }
  }
}

/// Each pixel's evidence for the plane, (height, width, 2): its albedo if it is the plane (the
/// ratio exceeded by a fifth of its lights), and the spread of its lights (1.4826 times the
/// median |ratio / albedo - 1|).
Image<float> plane_signs(const StackSource& stack, const StereoLights& lights,
                         const std::vector<int>& use, const PixelPoints& plane) {
  const StackDims dims = stack.dims();
  Image<float> signs(dims.height, dims.width, 2);
  const Vector3d normal = plane.plane_normal();
  for_each_pixel(stack, lights, use, &plane, [&](int y, int x, const PixelSamples& samples) {
    std::vector<float> ratios;
    plane_ratios(samples, normal, ratios);
    const float level = exceeded_by(ratios, 0.2);
    signs(y, x, 0) = level;
    signs(y, x, 1) = 1.0F;
    if (level > 0.0F) {
      for (float& ratio : ratios) {
        ratio = std::abs(ratio / level - 1.0F);
      }
      signs(y, x, 1) = 1.4826F * exceeded_by(ratios, 0.5);
    }
  });
  return signs;
}

/// A quadratic in picture position, of logarithms.
struct Albedo {
  Vector6d a = Vector6d::Zero();
  int width = 1;
  int height = 1;
  [[nodiscard]] Vector6d terms(int y, int x) const {
    const double u = (2.0 * x + 1.0) / width - 1.0;
    const double v = (2.0 * y + 1.0) / height - 1.0;
    Vector6d t;
    t << 1.0, u, v, u * u, u * v, v * v;
    return t;
  }
  [[nodiscard]] double log_at(int y, int x) const { return a.dot(terms(y, x)); }
};

/// The most common level among pixels whose lights agree: the mode over bins 2 % wide, three
/// together.
double common_level(const std::vector<float>& logs) {
  constexpr double kBin = 0.02;
  const auto [least, most] = std::minmax_element(logs.begin(), logs.end());
  const auto n = static_cast<std::size_t>((double{*most} - double{*least}) / kBin) + 3;
  std::vector<int> bins(n, 0);
  for (const float value : logs) {
    ++bins[static_cast<std::size_t>((double{value} - double{*least}) / kBin) + 1];
  }
  std::size_t best = 1;
  int fullest = -1;
  for (std::size_t i = 1; i + 1 < n; ++i) {
    const int sum = bins[i - 1] + bins[i] + bins[i + 1];
    if (sum > fullest) {
      fullest = sum;
      best = i;
    }
  }
  return double{*least} + kBin * (static_cast<double>(best) - 0.5);
}

struct PlaneModel {
  Albedo albedo;
  double tolerance = 0.0;  ///< of a light's brightness, relative
  bool is_found = false;
};

PlaneModel fit_plane(const Image<float>& signs) {
  const int h = signs.height();
  const int w = signs.width();
  PlaneModel model;
  model.albedo.width = w;
  model.albedo.height = h;
  std::vector<float> spreads;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      spreads.push_back(signs(y, x, 1));
    }
  }
  // The plane's own noise is that of the most uniform pixels.
  model.tolerance =
      std::clamp(4.0 * double{exceeded_by(spreads, 0.9)}, kLeastTolerance, kMostTolerance);
  const auto is_even = [&](int y, int x) {
    return signs(y, x, 0) > 0.0F && double{signs(y, x, 1)} < model.tolerance;
  };
  std::vector<float> logs;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (is_even(y, x)) {
        logs.push_back(std::log(signs(y, x, 0)));
      }
    }
  }
  const double least = kLeastPlane * h * w;
  if (static_cast<double>(logs.size()) < least) {
    return model;
  }
  model.albedo.a[0] = common_level(logs);
  int n_used = 0;
  for (int round = 0; round < 4; ++round) {
    Eigen::Matrix<double, 6, 6> matrix = Eigen::Matrix<double, 6, 6>::Zero();
    Vector6d right = Vector6d::Zero();
    n_used = 0;
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        if (!is_even(y, x)) {
          continue;
        }
        const double value = std::log(double{signs(y, x, 0)});
        if (std::abs(value - model.albedo.log_at(y, x)) > 2.0 * model.tolerance) {
          continue;
        }
        const Vector6d t = model.albedo.terms(y, x);
        matrix += t * t.transpose();
        right += value * t;
        ++n_used;
      }
    }
    if (n_used < least) {
      return model;
    }
    // A small regularisation towards the level stabilises it where only part of the picture
    // shows the plane.
    matrix.diagonal().tail<5>().array() += 1e-3 * n_used;
    model.albedo.a = matrix.ldlt().solve(right);
  }
  model.is_found = true;
  return model;
}

bool shows_plane(const std::vector<float>& ratios, double albedo, double tolerance) {
  const auto n = static_cast<double>(ratios.size());
  int n_agree = 0;
  int n_lit = 0;
  int n_grey = 0;
  for (const float ratio : ratios) {
    const double q = double{ratio} / albedo;
    n_agree += std::abs(q - 1.0) <= tolerance ? 1 : 0;
    n_lit += q > kShadow ? 1 : 0;
    n_grey += q > kBlack ? 1 : 0;
  }
  if (n_lit < std::max(3.0, kLeastLit * n)) {
    return n_grey < std::max(3.0, kLeastLit * n);  // shadow; else a dark object
  }
  return n_agree >= std::max(3.0, kAgree * n_lit);
}

/// Parts smaller than this, of the object or of the background, are taken for noise.
int least_part(int h, int w) { return std::max(8, h * w / 5000); }

void drop_small_parts(Image<std::uint8_t>& mask, std::uint8_t value, int least) {
  Image<std::uint8_t> like(mask.height(), mask.width(), 1);
  for (std::size_t i = 0; i < mask.pixels().size(); ++i) {
    like.pixels()[i] = mask.pixels()[i] == value ? 1 : 0;
  }
  const Parts parts = find_parts(like.view());
  std::vector<int> sizes(count(parts.n_parts), 0);
  for (const int label : parts.label.pixels()) {
    if (label >= 0) {
      ++sizes[count(label)];
    }
  }
  for (std::size_t i = 0; i < mask.pixels().size(); ++i) {
    const int label = parts.label.pixels()[i];
    if (label >= 0 && sizes[count(label)] < least) {
      mask.pixels()[i] = value == 0 ? 1 : 0;
    }
  }
}

/// Without pixels next to the plane: they show some of it.
Image<std::uint8_t> without_rim(const Image<std::uint8_t>& mask) {
  const int h = mask.height();
  const int w = mask.width();
  Image<std::uint8_t> inner(h, w, 1);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      bool is_inner = true;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          const int v = std::clamp(y + dy, 0, h - 1);
          const int u = std::clamp(x + dx, 0, w - 1);
          is_inner = is_inner && mask(v, u) != 0;
        }
      }
      inner(y, x) = is_inner ? 1 : 0;
    }
  }
  return inner;
}

ObjectMask whole(const StackDims& dims) {
  ObjectMask all;
  all.mask = Image<std::uint8_t>(dims.height, dims.width, 1);
  std::fill(all.mask.pixels().begin(), all.mask.pixels().end(), std::uint8_t{1});
  all.n_object = static_cast<std::int64_t>(dims.n_pixels());
  return all;
}

/// Without small parts; the whole picture if no object or no background is left.
ObjectMask cleaned(Image<std::uint8_t> mask, MaskOrigin origin, const StackDims& dims) {
  const int least = least_part(dims.height, dims.width);
  drop_small_parts(mask, 1, least);
  drop_small_parts(mask, 0, least);
  const auto n = std::count(mask.pixels().begin(), mask.pixels().end(), std::uint8_t{1});
  if (n == 0 || n == static_cast<std::ptrdiff_t>(dims.n_pixels())) {
    return whole(dims);
  }
  return {std::move(mask), origin, n};
}

/// The threshold that splits the levels into a dark and a bright class with few in between; 0:
/// none.
double gap_of(const std::vector<float>& levels) {
  std::vector<float> sorted = levels;
  std::sort(sorted.begin(), sorted.end());
  const std::size_t n = sorted.size();
  const auto bright = double{sorted[n - 1 - n / 20]};
  constexpr double kDark = 0.1;            // of the bright pixels' level, at most
  constexpr double kStep = 1.1;            // between thresholds tried
  constexpr double kBetween = 0.01;        // fraction of pixels within a factor of 1.5 of it
  constexpr double kLeastFraction = 0.02;  // of the picture in each class
  double best = 0.0;
  double fewest = kBetween;
  const auto fraction_below = [&](double level) {
    return static_cast<double>(
               std::lower_bound(sorted.begin(), sorted.end(), static_cast<float>(level)) -
               sorted.begin()) /
           static_cast<double>(n);
  };
  constexpr int kSteps = 49;  // down to a thousandth
  double level = kDark * bright;
  for (int step = 0; step < kSteps; ++step, level /= kStep) {
    const double below = fraction_below(level);
    const double between = fraction_below(1.5 * level) - fraction_below(level / 1.5);
    if (below >= kLeastFraction && below <= 1.0 - kLeastFraction && between < fewest) {
      fewest = between;
      best = level;
    }
  }
  return best;
}

}  // namespace

ObjectMask mask_by_plane(const StackSource& stack, const StereoLights& lights,
                         const PixelPoints& plane) {
  HAARLIGHT_EXPECTS(lights.are_near, "lights with positions");
  const StackDims dims = stack.dims();
  const Vector3d middle = plane.at(0.5 * dims.width, 0.5 * dims.height);
  const std::vector<int> use = thinned(group_lights(directions_from(lights, middle)), kLights);
  const PlaneModel model = fit_plane(plane_signs(stack, lights, use, plane));
  if (!model.is_found) {
    return whole(dims);
  }
  Image<std::uint8_t> mask(dims.height, dims.width, 1);
  const Vector3d normal = plane.plane_normal();
  for_each_pixel(stack, lights, use, &plane, [&](int y, int x, const PixelSamples& samples) {
    std::vector<float> ratios;
    plane_ratios(samples, normal, ratios);
    const double albedo = std::exp(model.albedo.log_at(y, x));
    mask(y, x) = shows_plane(ratios, albedo, model.tolerance) ? 0 : 1;
  });
  return cleaned(without_rim(mask), MaskOrigin::plane, dims);
}

ObjectMask mask_by_darkness(const StackSource& stack, const StereoLights& lights) {
  const StackDims dims = stack.dims();
  // Levels as in the pictures: for near lights without distance correction.
  StereoLights plain;
  plain.powers = lights.powers;
  plain.directions.assign(count(dims.n_lights), Vector3d::UnitZ());
  Image<float> level(dims.height, dims.width, 1);
  for_each_pixel(stack, plain, {}, nullptr, [&](int y, int x, const PixelSamples& samples) {
    std::vector<float> values;
    values.reserve(count(samples.n()));
    for (int j = 0; j < samples.n(); ++j) {
      values.push_back(static_cast<float>(samples.value(j)));
    }
    level(y, x) = exceeded_by(values, 0.1);
  });
  const double gap = gap_of({level.pixels().begin(), level.pixels().end()});
  if (!(gap > 0.0)) {
    return whole(dims);
  }
  Image<std::uint8_t> dark(dims.height, dims.width, 1);
  for (std::size_t i = 0; i < dark.pixels().size(); ++i) {
    dark.pixels()[i] = double{level.pixels()[i]} < gap ? 1 : 0;
  }
  const Parts parts = find_parts(dark.view());
  std::vector<char> is_outside(count(parts.n_parts), 0);
  const auto touch = [&](int y, int x) {
    if (parts.label(y, x) >= 0) {
      is_outside[count(parts.label(y, x))] = 1;
    }
  };
  for (int x = 0; x < dims.width; ++x) {
    touch(0, x);
    touch(dims.height - 1, x);
  }
  for (int y = 0; y < dims.height; ++y) {
    touch(y, 0);
    touch(y, dims.width - 1);
  }
  Image<std::uint8_t> mask(dims.height, dims.width, 1);
  for (std::size_t i = 0; i < mask.pixels().size(); ++i) {
    const int label = parts.label.pixels()[i];
    mask.pixels()[i] = label >= 0 && is_outside[count(label)] != 0 ? 0 : 1;
  }
  return cleaned(std::move(mask), MaskOrigin::darkness, dims);
}

}  // namespace haarlight::relight
