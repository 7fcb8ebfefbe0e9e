// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/part_heights.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <utility>

#include "core/count.h"
#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shape/lambert_fit.h"
#include "relight/shape/light_groups.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr int kPixels = 64;   // of a part: enough for a smooth median cost
constexpr int kLights = 128;  // of all lights
constexpr int kGrid = 28;
constexpr int kGolden = 14;     // 0.618^14: 1/1000 of the grid's step
constexpr int kFewGolden = 10;  // with a group of lights left out
constexpr int kGroups = 6;
constexpr double kLow = -0.1;  // of the lights' height above the plane
constexpr double kHigh = 0.6;
constexpr double kLeastTold = 0.05;  // of it: a larger standard error is uninformative

struct SampledPixel {
  Vector3d point = Vector3d::Zero();
  std::vector<float> values;  ///< (channels, 1, n_lights)
};

struct Part {
  std::vector<SampledPixel> pixels;
  double mean_mm = 0.0;
  std::int64_t n = 0;
};

/// One part under candidates of its height.
class HeightSearch {
 public:
  HeightSearch(const StackDims& dims, const StereoLights& lights, const PixelPoints& pixels,
               const Part& part, const std::vector<int>& use)
      : pixels_(pixels),
        part_(part),
        samples_(dims, lights, use),
        fitter_(samples_.n(), fit()) {
    normal_ = pixels.plane_normal();
    if (pixels.camera() != nullptr) {
      eye_ = pixels.camera()->centre_world();
      eye_height_ = pixels.height_of(eye_);
    }
  }

  /// The mean over the pixels of their lights' median relative residual.
  [[nodiscard]] double cost(double height) {
    double sum = 0.0;
    double n = 0.0;
    for (std::size_t i = 0; i < part_.pixels.size(); ++i) {
      if (static_cast<int>(i * kGroups / part_.pixels.size()) == left_out_) {
        continue;
      }
      const SampledPixel& pixel = part_.pixels[i];
      n += 1.0;
      samples_.aim(moved(pixel.point, height));
      samples_.take(pixel.values, 0, 1);
      samples_.give(fitter_);
      const LambertFit found = fitter_.fit();
      sum +=
          found.state == PixelState::good ? std::min(1.0, fitter_.median_residual(found)) : 1.0;
    }
    return sum / n;
  }

  /// The pixels have as many groups as the lights; leaves out one from now on.
  void leave_out(int group) noexcept { left_out_ = group; }

  /// The position of the least cost among kGrid + 1 from `low` on.
  [[nodiscard]] double best_of_grid(double low, double step) {
    double best = low;
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i <= kGrid; ++i) {
      const double at = low + i * step;
      const double cost_here = cost(at);
      if (cost_here < least) {
        least = cost_here;
        best = at;
      }
    }
    return best;
  }

  /// The least cost between low and high, by golden-section search.
  [[nodiscard]] double least(double low, double high, int n_steps) {
    constexpr double kGoldenFraction = 0.6180339887498949;
    double a = high - kGoldenFraction * (high - low);
    double b = low + kGoldenFraction * (high - low);
    double cost_a = cost(a);
    double cost_b = cost(b);
    for (int step = 0; step < n_steps; ++step) {
      if (cost_a <= cost_b) {
        high = b;
        b = a;
        cost_b = cost_a;
        a = high - kGoldenFraction * (high - low);
        cost_a = cost(a);
      } else {
        low = a;
        a = b;
        cost_a = cost_b;
        b = low + kGoldenFraction * (high - low);
        cost_b = cost(b);
      }
    }
    return 0.5 * (low + high);
  }

 private:
  static LambertOptions fit() {
    LambertOptions options;
    options.method = LambertMethod::m_estimator;
    options.max_rounds = 8;
    return options;
  }

  /// Moves the part as a whole along the view: for a camera, it scales about the eye.
  [[nodiscard]] Vector3d moved(const Vector3d& point, double height) const {
    if (pixels_.camera() == nullptr) {
      return point + (height - part_.mean_mm) * normal_;
    }
    const double scale = (eye_height_ - height) / (eye_height_ - part_.mean_mm);
    return eye_ + scale * (point - eye_);
  }

  const PixelPoints& pixels_;
  const Part& part_;
  PixelSamples samples_;
  LambertFitter fitter_;
  Vector3d normal_ = Vector3d::UnitZ();
  Vector3d eye_ = Vector3d::Zero();
  double eye_height_ = 0.0;
  int left_out_ = -1;
};

/// Parts with pixels spread evenly over each.
std::vector<Part> sampled(const StackSource& stack, const PixelPoints& pixels,
                          const Parts& parts, ImageView<const float> points) {
  const StackDims dims = stack.dims();
  std::vector<Part> all(count(parts.n_parts));
  for (const int label : parts.label.pixels()) {
    if (label >= 0) {
      ++all[count(label)].n;
    }
  }
  std::vector<std::int64_t> seen(all.size(), 0);
  for (int y = 0; y < dims.height; ++y) {
    for (int x = 0; x < dims.width; ++x) {
      const int label = parts.label(y, x);
      if (label < 0) {
        continue;
      }
      Part& part = all[count(label)];
      const Vector3d point(double{points(y, x, 0)}, double{points(y, x, 1)},
                           double{points(y, x, 2)});
      part.mean_mm += pixels.height_of(point) / static_cast<double>(part.n);
      const std::int64_t i = seen[count(label)]++;
      const std::int64_t wanted = std::min<std::int64_t>(kPixels, part.n);
      if ((i + 1) * wanted / part.n > i * wanted / part.n && part.n >= kLeastPartPixels) {
        SampledPixel pixel;
        pixel.point = point;
        pixel.values.resize(count(dims.channels) * count(dims.n_lights));
        stack.read_tile({x, y, 1, 1}, pixel.values);
        part.pixels.push_back(std::move(pixel));
      }
    }
  }
  return all;
}

double height_of_lights(const StereoLights& lights, const PixelPoints& pixels) {
  std::vector<double> heights;
  for (const NearLight& light : lights.near) {
    heights.push_back(pixels.height_of(light.position_mm));
  }
  return upper_median(heights);
}

}  // namespace

std::vector<PartHeight> find_part_heights(const StackSource& stack, const StereoLights& lights,
                                          const PixelPoints& pixels, const Parts& parts,
                                          ImageView<const float> points,
                                          const PartSearch& options) {
  HAARLIGHT_EXPECTS(lights.are_near, "lights with positions");
  const StackDims dims = stack.dims();
  const std::vector<Part> all = sampled(stack, pixels, parts, points);
  std::vector<PartHeight> found(all.size());
  std::vector<std::size_t> largest(all.size());
  std::iota(largest.begin(), largest.end(), std::size_t{0});
  std::stable_sort(largest.begin(), largest.end(),
                   [&](std::size_t a, std::size_t b) { return all[a].n > all[b].n; });
  largest.resize(std::min(largest.size(), count(kMostParts)));
  double top = height_of_lights(lights, pixels);
  if (pixels.camera() != nullptr) {
    top = std::min(top, 1.5 * pixels.height_of(pixels.camera()->centre_world()));
  }
  const LightGroups groups = group_lights(
      directions_from(lights, pixels.at(0.5 * dims.width, 0.5 * dims.height)), kGroups);
  const std::vector<int> use = thinned(groups, kLights);
  const double step = (kHigh - kLow) * top / kGrid;
  for (std::size_t i = 0; i < all.size(); ++i) {
    found[i].n_pixels = all[i].n;
    found[i].mean_mm = all[i].mean_mm;
  }
  parallel_for(largest.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Part& part = all[largest[i]];
      PartHeight& height = found[largest[i]];
      if (part.pixels.empty() || !(top > 0.0)) {
        continue;
      }
      HeightSearch search(dims, lights, pixels, part, use);
      const double start =
          options.is_first ? search.best_of_grid(kLow * top, step) : part.mean_mm;
      height.mean_mm = search.least(start - step, start + step, kGolden);
      height.is_known = height.mean_mm > kLow * top && height.mean_mm < kHigh * top;
      height.source = HeightSource::fall_off;
      if (!options.has_sigma || !height.is_known) {
        continue;
      }
      // Lights and pixels are left out separately: either can contribute error.
      double sum = 0.0;
      const double reach = 2.0 * step;
      for (int g = 0; g < groups.n_groups; ++g) {
        std::vector<int> rest;
        std::copy_if(use.begin(), use.end(), std::back_inserter(rest),
                     [&](int k) { return groups.group[count(k)] != g; });
        HeightSearch without(dims, lights, pixels, part, rest);
        const double by_lights =
            without.least(height.mean_mm - reach, height.mean_mm + reach, kFewGolden);
        search.leave_out(g);
        const double by_pixels =
            search.least(height.mean_mm - reach, height.mean_mm + reach, kFewGolden);
        sum +=
            std::pow(by_lights - height.mean_mm, 2) + std::pow(by_pixels - height.mean_mm, 2);
      }
      height.sigma_mm = std::sqrt(sum * (groups.n_groups - 1) / groups.n_groups);
      height.is_known = height.sigma_mm < kLeastTold * top;
    }
  });
  return found;
}

}  // namespace haarlight::relight
