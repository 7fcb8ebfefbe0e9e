// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/integrate_normals.h"

#include <cmath>
#include <cstdio>
#include <functional>
#include <numbers>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "relight/shape/cosine_transform.h"
#include "relight/shape/grid_laplacian.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;

TEST(CosineTransform, IsTheSumThatDefinesIt) {
  // 37 and 101 are primes beyond the direct form: Bluestein's chirp.
  for (const int n : {1, 2, 3, 8, 12, 31, 37, 74, 101}) {
    const auto length = static_cast<std::size_t>(n);
    std::vector<double> x(3 * length);
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = uniform_unit(hash_key(1, i)) - 0.3;
    }
    std::vector<double> cosine = x;
    std::vector<double> sine = x;
    transform_rows(cosine, 3, n, RowTransform::cosine);
    transform_rows(sine, 3, n, RowTransform::sine);
    for (std::size_t row = 0; row < 3; ++row) {
      for (int k = 0; k < n; ++k) {
        double c = 0.0;
        double s = 0.0;
        for (int j = 0; j < n; ++j) {
          const double value = x[row * length + static_cast<std::size_t>(j)];
          c += value * std::cos(kPi * k * (j + 0.5) / n);
          s += value * std::sin(kPi * (k + 1) * (j + 0.5) / n);
        }
        const std::size_t i = row * length + static_cast<std::size_t>(k);
        EXPECT_NEAR(cosine[i], c, 1e-13 * n) << n << ' ' << k;
        EXPECT_NEAR(sine[i], s, 1e-13 * n) << n << ' ' << k;
      }
    }
    transform_rows(cosine, 3, n, RowTransform::inverse_cosine);
    for (std::size_t i = 0; i < x.size(); ++i) {
      EXPECT_NEAR(cosine[i], x[i], 1e-14 * n);
    }
  }
}

/// A surface by its height and slopes in mm, over [-1, 1] x [-1, 1] mm.
struct Closed {
  std::function<double(double x, double y)> height;
  std::function<double(double x, double y)> along_x;
  std::function<double(double x, double y)> along_y;
};

Closed sphere_cap() {
  constexpr double kR2 = 4.0;
  const auto z = [](double x, double y) { return std::sqrt(kR2 - x * x - y * y); };
  return {z, [z](double x, double y) { return -x / z(x, y); },
          [z](double x, double y) { return -y / z(x, y); }};
}

Closed sine_surface() {
  return {
      [](double x, double y) { return 0.1 * std::sin(4.0 * x + 1.0) * std::cos(3.0 * y); },
      [](double x, double y) { return 0.4 * std::cos(4.0 * x + 1.0) * std::cos(3.0 * y); },
      [](double x, double y) { return -0.3 * std::sin(4.0 * x + 1.0) * std::sin(3.0 * y); }};
}

/// Paper that is cut from the middle to the border, one flap bent up.
Closed cut_paper() {
  const auto is_flap = [](double x, double y) { return x > 0.0 && y > 0.0; };
  return {[=](double x, double y) { return is_flap(x, y) ? 0.5 * y * y : 0.0; },
          [](double, double) { return 0.0; },
          [=](double x, double y) { return is_flap(x, y) ? y : 0.0; }};
}

struct Sampled {
  Image<float> normals;
  Image<std::uint8_t> known;
  Image<double> heights;
  double mm_per_pixel = 1.0;
};

Sampled sample(const Closed& surface, int n) {
  Sampled s{Image<float>(n, n, 3), Image<std::uint8_t>(n, n, 1), Image<double>(n, n, 1),
            2.0 / n};
  for (int row = 0; row < n; ++row) {
    for (int col = 0; col < n; ++col) {
      const double x = -1.0 + (col + 0.5) * s.mm_per_pixel;
      const double y = 1.0 - (row + 0.5) * s.mm_per_pixel;
      const Vector3d normal =
          Vector3d(-surface.along_x(x, y), -surface.along_y(x, y), 1.0).normalized();
      for (int c = 0; c < 3; ++c) {
        s.normals(row, col, c) = static_cast<float>(normal[c]);
      }
      s.known(row, col) = 1;
      s.heights(row, col) = surface.height(x, y);
    }
  }
  return s;
}

/// rms difference of the heights, each with its mean taken off, over known pixels.
double height_error(const Image<float>& found, const Sampled& truth) {
  double mean = 0.0;
  double n = 0.0;
  for (int y = 0; y < found.height(); ++y) {
    for (int x = 0; x < found.width(); ++x) {
      if (truth.known(y, x) != 0) {
        mean += truth.heights(y, x) - double{found(y, x)};
        n += 1.0;
      }
    }
  }
  mean /= n;
  double sum = 0.0;
  for (int y = 0; y < found.height(); ++y) {
    for (int x = 0; x < found.width(); ++x) {
      if (truth.known(y, x) != 0) {
        sum += std::pow(truth.heights(y, x) - double{found(y, x)} - mean, 2);
      }
    }
  }
  return std::sqrt(sum / n);
}

HeightMap integrate(const Sampled& s, Integrator method) {
  IntegrateOptions options;
  options.method = method;
  return integrate_slopes(orthographic_slopes(s.normals.view(), s.known.view(), s.mm_per_pixel),
                          options);
}

TEST(Integrate, ClosedFormsConvergeWithTheSquareOfThePixel) {
  for (const auto& [name, surface] :
       {std::pair{"sphere cap", sphere_cap()}, std::pair{"sine", sine_surface()}}) {
    for (const Integrator method : {Integrator::poisson, Integrator::robust}) {
      const double coarse =
          height_error(integrate(sample(surface, 32), method).height, sample(surface, 32));
      const double fine =
          height_error(integrate(sample(surface, 64), method).height, sample(surface, 64));
      const double order = std::log2(coarse / fine);
      std::printf("%s, %s: rms %.2e at 32, %.2e at 64: order %.2f\n", name,
                  std::string(to_string(method)).c_str(), coarse, fine, order);
      EXPECT_GT(order, 1.8);
      EXPECT_LT(order, 2.4);
      EXPECT_LT(fine, 2e-4);
    }
  }
}

TEST(Integrate, FrankotChellappaIsExactForItsOwnCosines) {
  const Closed surface{
      [](double x, double y) {
        return std::cos(kPi * (x + 1.0)) * std::cos(1.5 * kPi * (1.0 - y));
      },
      [](double x, double y) {
        return -kPi * std::sin(kPi * (x + 1.0)) * std::cos(1.5 * kPi * (1.0 - y));
      },
      [](double x, double y) {
        return 1.5 * kPi * std::cos(kPi * (x + 1.0)) * std::sin(1.5 * kPi * (1.0 - y));
      }};
  const Sampled s = sample(surface, 40);
  // Normals in float: 6e-8 of slopes up to 5.
  EXPECT_LT(height_error(integrate(s, Integrator::frankot_chellappa).height, s), 3e-6);
}

TEST(Integrate, FrankotChellappaConvergesOnOtherSurfaces) {
  for (const auto& [name, surface] :
       {std::pair{"sphere cap", sphere_cap()}, std::pair{"sine", sine_surface()}}) {
    const double coarse =
        height_error(integrate(sample(surface, 32), Integrator::frankot_chellappa).height,
                     sample(surface, 32));
    const double fine =
        height_error(integrate(sample(surface, 64), Integrator::frankot_chellappa).height,
                     sample(surface, 64));
    std::printf("%s, frankot-chellappa: rms %.2e at 32, %.2e at 64: order %.2f\n", name, coarse,
                fine, std::log2(coarse / fine));
    EXPECT_GT(std::log2(coarse / fine), 0.9);  // slopes do not vanish at the borders
  }
}

TEST(Integrate, RobustKeepsACutAndLeastSquaresSmearsIt) {
  const Sampled s = sample(cut_paper(), 64);
  const HeightMap smeared = integrate(s, Integrator::poisson);
  const HeightMap kept = integrate(s, Integrator::robust);
  const double step = 0.5;
  const double of_poisson = height_error(smeared.height, s);
  const double of_robust = height_error(kept.height, s);
  std::printf("cut paper: poisson %.2e, robust %.2e of a step of %.1f; %lld cuts, %d solves\n",
              of_poisson, of_robust, step, static_cast<long long>(kept.n_cuts), kept.n_solves);
  EXPECT_GT(of_poisson, 0.02);
  EXPECT_LT(of_robust, 0.01 * of_poisson);
  // Found where it is: between the columns 31 and 32, in the upper half, nowhere else.
  EXPECT_GE(kept.n_cuts, 20);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      EXPECT_EQ(kept.is_cut(y, x, 1), 0);
      if (x != 31 || y > 32) {
        EXPECT_EQ(kept.is_cut(y, x, 0), 0) << y << ' ' << x;
      }
    }
  }
  EXPECT_EQ(smeared.n_cuts, 0);
}

TEST(Integrate, AFullMaskAndTheCosinesAgree) {
  const Sampled s = sample(sine_surface(), 53);
  const SlopeField slopes =
      orthographic_slopes(s.normals.view(), s.known.view(), s.mm_per_pixel);
  const HeightMap exact = integrate_slopes(slopes);
  EXPECT_EQ(exact.iterations, 0);
  const std::size_t n = std::size_t{53} * 53;
  const GridLaplacian laplacian(53, 53, std::vector<float>(n, 1.0F),
                                std::vector<float>(n, 1.0F));
  std::vector<double> z(n);
  const GridSolve solve = laplacian.solve(
      laplacian.divergence(slopes.step_right.pixels(), slopes.step_down.pixels()), z, 1e-9,
      200);
  EXPECT_TRUE(solve.is_converged);
  std::printf("multigrid: %d iterations to 1e-9\n", solve.iterations);
  EXPECT_LT(solve.iterations, 60);
  double mean = 0.0;
  for (const double value : z) {
    mean += value / static_cast<double>(n);
  }
  for (std::size_t i = 0; i < n; ++i) {
    EXPECT_NEAR(z[i] - mean, double{exact.height.pixels()[i]}, 1e-7);
  }
}

TEST(Integrate, EachPartOfAMaskHasItsOwnMean) {
  Sampled s = sample(sphere_cap(), 48);
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 48; ++x) {
      const bool left = std::hypot(y - 20.0, x - 12.0) < 9.0;
      const bool right = x > 26 && x < 44 && y > 10 && !(x == 30 && y < 40);
      s.known(y, x) = left || right ? 1 : 0;
    }
  }
  const HeightMap map = integrate(s, Integrator::poisson);
  EXPECT_EQ(map.parts.n_parts, 2);
  EXPECT_TRUE(map.is_converged);
  const Parts parts = find_parts(s.known.view());
  std::vector<double> sum(2);
  std::vector<double> offset(2, std::numeric_limits<double>::quiet_NaN());
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 48; ++x) {
      const int part = parts.label(y, x);
      if (part < 0) {
        EXPECT_EQ(map.height(y, x), 0.0F);
        continue;
      }
      const auto i = static_cast<std::size_t>(part);
      sum[i] += double{map.height(y, x)};
      const double off = s.heights(y, x) - double{map.height(y, x)};
      if (std::isnan(offset[i])) {
        offset[i] = off;
      }
      EXPECT_NEAR(off, offset[i], 2e-3);  // 0.04 mm pixels of a sphere of radius 2 mm
    }
  }
  EXPECT_NEAR(sum[0], 0.0, 1e-4);
  EXPECT_NEAR(sum[1], 0.0, 1e-4);
}

TEST(Integrate, APlaneInPerspectiveIsExact) {
  CameraModel camera;
  camera.width = 64;
  camera.height = 48;
  camera.fx = camera.fy = 60.0;  // 56 degrees wide
  camera.cx = 31.0;
  camera.cy = 25.0;
  camera.distortion << -0.1, 0.02, 0.001, 0.002, 0.0;
  camera.world_from_cam = look_at({100, -400, 500}, {0, 0, 0}, {0, 1, 0});
  Image<float> normals(48, 64, 3);
  Image<std::uint8_t> known(48, 64, 1);
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      normals(y, x, 2) = 1.0F;
      known(y, x) = 1;
    }
  }
  const HeightMap map =
      integrate_slopes(perspective_slopes(normals.view(), known.view(), camera));
  double offset = 0.0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
      const double distance = -ray.origin_world.z() / ray.direction_world.z();
      const double off = std::log(distance) - double{map.height(y, x)};
      if (x + y == 0) {
        offset = off;
      }
      EXPECT_NEAR(off, offset, 1e-6);  // steps in float
    }
  }
}

TEST(Integrate, IsTheSameOnOneTwoAndSevenThreads) {
  Sampled s = sample(sine_surface(), 70);
  s.known(20, 33) = 0;
  std::vector<std::vector<float>> found;
  for (const int n : {1, 2, 7}) {
    const ThreadLimit limit(n);
    const HeightMap map = integrate(s, Integrator::robust);
    found.emplace_back(map.height.pixels().begin(), map.height.pixels().end());
  }
  EXPECT_EQ(found[0], found[1]);
  EXPECT_EQ(found[0], found[2]);
}

RC_GTEST_PROP(IntegrateProperty, StepsOfAnyHeightsGiveThemBack, (std::uint64_t seed)) {
  const int h = 1 + static_cast<int>(hash_key(seed, 1) % 20);
  const int w = 1 + static_cast<int>(hash_key(seed, 2) % 20);
  SlopeField field;
  field.step_right = Image<float>(h, w, 1);
  field.step_down = Image<float>(h, w, 1);
  field.slope_right = Image<float>(h, w, 1);
  field.slope_down = Image<float>(h, w, 1);
  field.is_known = Image<std::uint8_t>(h, w, 1);
  Image<double> z(h, w, 1);
  std::uint64_t i = 10;
  for (double& value : z.pixels()) {
    value = static_cast<double>(hash_key(seed, i++) % 64);  // differences are exact in float
  }
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      field.is_known(y, x) = hash_key(seed, i++) % 8 != 0 ? 1 : 0;
      if (x + 1 < w) {
        field.step_right(y, x) = static_cast<float>(z(y, x + 1) - z(y, x));
      }
      if (y + 1 < h) {
        field.step_down(y, x) = static_cast<float>(z(y + 1, x) - z(y, x));
      }
    }
  }
  const HeightMap map = integrate_slopes(field);
  const Parts parts = find_parts(field.is_known.view());
  std::vector<double> mean(static_cast<std::size_t>(parts.n_parts));
  std::vector<double> count(mean.size());
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (parts.label(y, x) >= 0) {
        mean[static_cast<std::size_t>(parts.label(y, x))] += z(y, x);
        count[static_cast<std::size_t>(parts.label(y, x))] += 1.0;
      }
    }
  }
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (parts.label(y, x) >= 0) {
        const auto part = static_cast<std::size_t>(parts.label(y, x));
        RC_ASSERT(std::abs(double{map.height(y, x)} - z(y, x) + mean[part] / count[part]) <
                  1e-3);
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
