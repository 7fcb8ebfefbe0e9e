// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/shape_methods.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/random.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "relight/shape/near_alternation.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr double kWidthMm = 400.0;

/// Heights of a surface over the middle of the picture, and their unit normals.
struct Surface {
  double (*height)(double x, double y);
  Vector3d (*normal)(double x, double y);
};

/// 8 mm of waves.
constexpr Surface kWaves{
    [](double x, double y) { return 4.0 * std::sin(0.03 * x) * std::cos(0.025 * y); },
    [](double x, double y) {
      return Vector3d(-0.12 * std::cos(0.03 * x) * std::cos(0.025 * y),
                      0.1 * std::sin(0.03 * x) * std::sin(0.025 * y), 1.0)
          .normalized();
    }};

/// A paraboloid: steps between pixels are the mean of both slopes, without error.
constexpr Surface kBowl{[](double x, double y) { return (x * x + 0.5 * y * y) / 1000.0; },
                        [](double x, double y) {
                          return Vector3d(-2.0 * x / 1000.0, -y / 1000.0, 1.0).normalized();
                        }};

/// The values of `of` at the pixels.
template <class T, int channels, class Of>
Image<T> picture_of(const PixelPoints& pixels, int side, const Of& of) {
  Image<T> picture(side, side, channels);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const Vector3d p = pixels.at(x + 0.5, y + 0.5);
      const auto value = of(p.x(), p.y());
      if constexpr (channels == 3) {
        for (int c = 0; c < 3; ++c) {
          picture(y, x, c) = static_cast<T>(value[c]);
        }
      } else {
        picture(y, x) = static_cast<T>(value);
      }
    }
  }
  return picture;
}

Image<float> normals_of(const Surface& surface, const PixelPoints& pixels, int side) {
  return picture_of<float, 3>(pixels, side, surface.normal);
}
Image<float> heights_of(const Surface& surface, const PixelPoints& pixels, int side) {
  return picture_of<float, 1>(pixels, side, surface.height);
}

/// Mean angle between normals, degrees, over the pixels that have one.
double mean_degrees(const Image<float>& found, const Image<float>& truth) {
  double sum = 0.0;
  std::int64_t n = 0;
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      const auto at = [&](const Image<float>& picture) {
        return Vector3d(double{picture(y, x, 0)}, double{picture(y, x, 1)},
                        double{picture(y, x, 2)});
      };
      if (at(found) != Vector3d::Zero()) {
        sum += std::atan2(at(found).cross(at(truth)).norm(), at(found).dot(at(truth)));
        ++n;
      }
    }
  }
  return sum / static_cast<double>(n) * 180.0 / std::numbers::pi;
}

/// Rms distance of heights where `mask` is not 0, both about their mean, over the truth's.
double relative_heights(const Image<float>& found, const Image<float>& truth,
                        const Image<std::uint8_t>& mask) {
  std::array<double, 2> mean{};
  double n = 0.0;
  const auto each = [&](const auto& visit) {
    for (int y = 0; y < truth.height(); ++y) {
      for (int x = 0; x < truth.width(); ++x) {
        if (mask(y, x) != 0) {
          visit(double{found(y, x)}, double{truth(y, x)});
        }
      }
    }
  };
  each([&](double f, double t) {
    mean[0] += f;
    mean[1] += t;
    n += 1.0;
  });
  double square = 0.0;
  double norm = 0.0;
  each([&](double f, double t) {
    const double off = f - mean[0] / n;
    const double true_height = t - mean[1] / n;
    square += std::pow(off - true_height, 2);
    norm += true_height * true_height;
  });
  return std::sqrt(square / norm);
}

Image<std::uint8_t> all_pixels(int side) {
  Image<std::uint8_t> mask(side, side, 1);
  std::fill(mask.pixels().begin(), mask.pixels().end(), std::uint8_t{1});
  return mask;
}

/// `n` directions over a dome, 25 to 80 degrees up.
StereoLights dome(int n) {
  StereoLights lights;
  for (int k = 0; k < n; ++k) {
    const double up = (25.0 + 55.0 * k / (n - 1)) * std::numbers::pi / 180.0;
    const double round = 2.399963 * k;  // the golden angle
    lights.directions.emplace_back(std::cos(up) * std::cos(round),
                                   std::cos(up) * std::sin(round), std::sin(up));
  }
  return lights;
}

/// A ceiling of Lambertian lights.
StereoLights ceiling(int side) {
  StereoLights lights;
  lights.are_near = true;
  for (int k = 0; k < side * side; ++k) {
    const int row = k / side;
    const int col = k % side;
    NearLight light;
    light.position_mm = {930.0 * (col / (side - 1.0) - 0.5), 930.0 * (row / (side - 1.0) - 0.5),
                         900.0};
    light.mu = 1.0;
    lights.near.push_back(light);
    lights.directions.push_back(light.position_mm.normalized());
  }
  return lights;
}

/// Waves under `lights`, `shadowed` of the samples at a fifth.
MemoryStack capture(const StereoLights& lights, const PixelPoints& pixels, int side,
                    double shadowed) {
  const auto n = static_cast<int>(lights.directions.size());
  MemoryStack stack({side, side, 1, n});
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      Vector3d p = pixels.at(x + 0.5, y + 0.5);
      const Vector3d normal = kWaves.normal(p.x(), p.y());
      p.z() = kWaves.height(p.x(), p.y());
      for (int k = 0; k < n; ++k) {
        const auto i = static_cast<std::size_t>(k);
        const double shade = lights.are_near ? 1e6 * light_stencil(lights.near[i], p, normal)
                                             : std::max(0.0, normal.dot(lights.directions[i]));
        const std::uint64_t key =
            hash_key(static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(side) +
                         static_cast<std::uint64_t>(x),
                     i);
        stack.at(0, y, x, k) =
            static_cast<float>(shade * (uniform_unit(key) < shadowed ? 0.2 : 1.0));
      }
    }
  }
  return stack;
}

/// Normals of waves under far lights, a tenth of the samples shadowed.
class ShadowedDome {
 public:
  using Result = Image<float>;  ///< normals

  explicit ShadowedDome(MethodSize size)
      : side_(by_size(size, 12, 128, 512)),
        pixels_(PixelPoints::orthographic(side_, side_, kWidthMm)),
        lights_(dome(50)),
        stack_(capture(lights_, pixels_, side_, 0.1)) {}
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<LambertMethod, 2> kMethods{LambertMethod::least_squares,
                                                    LambertMethod::trimmed};
    StereoOptions options;
    options.fit.method = kMethods.at(setting);
    return photometric_stereo(stack_, lights_, {}, {}, options).normal;
  }
  [[nodiscard]] Result truth() const { return normals_of(kWaves, pixels_, side_); }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return mean_degrees(found, truth);
  }
  [[nodiscard]] MethodScale scale() const {
    return {stack_.dims().n_lights, static_cast<long long>(stack_.dims().n_pixels())};
  }
  [[nodiscard]] double bytes(std::size_t /*setting*/) const {
    return static_cast<double>(stack_.values().size_bytes());
  }

 private:
  int side_;
  PixelPoints pixels_;
  StereoLights lights_;
  MemoryStack stack_;
};

/// Heights of waves under near lights, which need the heights.
class NearCeiling {
 public:
  using Result = Image<float>;  ///< heights

  explicit NearCeiling(MethodSize size)
      : side_(by_size(size, 32, 128, 512)),
        pixels_(PixelPoints::orthographic(side_, side_, kWidthMm)),
        lights_(ceiling(5)),
        stack_(capture(lights_, pixels_, side_, 0.0)) {}
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<int, 3> kRounds{1, 2, 20};
    ShapeOptions options;
    options.stereo.fit.method = LambertMethod::least_squares;
    options.max_rounds = kRounds.at(setting);
    return recover_shape(stack_, lights_, pixels_, {}, options).height;
  }
  [[nodiscard]] Result truth() const { return heights_of(kWaves, pixels_, side_); }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_heights(found, truth, all_pixels(side_));
  }
  [[nodiscard]] MethodScale scale() const {
    return {stack_.dims().n_lights, static_cast<long long>(stack_.dims().n_pixels())};
  }

 private:
  int side_;
  PixelPoints pixels_;
  StereoLights lights_;
  MemoryStack stack_;
};

/// Heights of a bowl from its normals, within a disc: multigrid.
class Bowl {
 public:
  using Result = Image<float>;  ///< heights

  explicit Bowl(MethodSize size)
      : side_(by_size(size, 48, 256, 1024)),
        pixels_(PixelPoints::orthographic(side_, side_, kWidthMm)),
        disc_(picture_of<std::uint8_t, 1>(
            pixels_, side_,
            [](double x, double y) { return std::hypot(x, y) < 0.49 * kWidthMm ? 1 : 0; })),
        slopes_(orthographic_slopes(normals_of(kBowl, pixels_, side_).view(), disc_.view(),
                                    pixels_.mm_per_pixel())) {}
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<double, 3> kTolerances{1e-1, 1e-3, 1e-7};
    IntegrateOptions options;
    options.tolerance = kTolerances.at(setting);
    return integrate_slopes(slopes_, options).height;
  }
  [[nodiscard]] Result truth() const { return heights_of(kBowl, pixels_, side_); }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_heights(found, truth, disc_);
  }
  [[nodiscard]] MethodScale scale() const { return {0, static_cast<long long>(side_) * side_}; }

 private:
  int side_;
  PixelPoints pixels_;
  Image<std::uint8_t> disc_;
  SlopeField slopes_;
};

}  // namespace

std::vector<Method> shape_methods() {
  const std::string module = "relight/shape";
  return {
      Method::of<ShadowedDome>(
          {.module = module,
           .name = "photometric stereo, a tenth of the samples shadowed",
           .settings = {"least squares", "least trimmed squares"},
           .error_norm = "mean angle of the normals, degrees",
           .truth = "closed form: the normals that were lit",
           .exact_error = 0.006,
           .exact_error_from = "trimming ends when a step moves b by less than 1e-4"}),
      Method::of<NearCeiling>(
          {.module = module,
           .name = "near-light photometric stereo by alternation",
           .settings = {"1 round", "2 rounds", "until it settles"},
           .error_norm = "rms height over the truth's",
           .truth = "closed form: the heights that were lit",
           .exact_error = 0.012,
           .exact_error_from =
               "steps are means of two slopes: (k h)^2/12 of waves, pixels of 12.5 mm"}),
      Method::of<Bowl>({.module = module,
                        .name = "heights from slopes by multigrid",
                        .settings = {"tolerance 1e-1", "tolerance 1e-3", "tolerance 1e-7"},
                        .error_norm = "rms height over the truth's",
                        .truth = "closed form: a paraboloid",
                        .exact_error = 1e-6,
                        .exact_error_from = "slopes and heights are floats"}),
  };
}

}  // namespace haarlight::relight
