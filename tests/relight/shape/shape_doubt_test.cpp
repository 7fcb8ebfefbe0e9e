// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/shape/fit_choice.h"
#include "relight/shape/height_bow.h"
#include "relight/shape/light_groups.h"
#include "relight/shape/near_alternation.h"
#include "relight/shape/normal_unevenness.h"
#include "relight/shape/part_heights.h"
#include "tests/relight/shape/made_lights.h"

/// What shape says about its own errors: standard errors of normals and of parts' heights, the
/// choice of a fit, the bow.

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::degrees_between;
using testing::dome_directions;
using testing::far_capture;
using testing::light_array;
using testing::MadeSurface;
using testing::near_capture;
using testing::vector_at;

constexpr int kSize = 24;

std::uint64_t pixel_number(int y, int x) {
  return static_cast<std::uint64_t>(y) * kSize + static_cast<std::uint64_t>(x);
}

Vector3d bowl_normal(int y, int x) {
  return Vector3d(0.03 * (x - 11.5), 0.03 * (11.5 - y), 1.0).normalized();
}

MadeSurface bowl() {
  return {[](int, int) { return Vector3d(Vector3d::Zero()); }, bowl_normal,
          [](int) { return 0.7; }};
}

double normal_noise(int y, int x, int k) {
  const auto at = pixel_number(y, x);
  const double u =
      uniform_unit(hash_key(11, at, std::uint64_t{2} * static_cast<std::uint64_t>(k)));
  const double v =
      uniform_unit(hash_key(11, at, std::uint64_t{2} * static_cast<std::uint64_t>(k) + 1));
  return std::sqrt(-2.0 * std::log(1.0 - u)) * std::cos(2.0 * std::numbers::pi * v);
}

struct Coverage {
  double fraction = 0.0;  ///< of the pixels within two standard errors
  double mean_error = 0.0;
  double mean_sigma = 0.0;
};

Coverage coverage(const SurfaceEstimate& found) {
  Coverage result;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const double error = degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x));
      const auto sigma = double{found.sigma_deg(y, x)};
      result.fraction += error <= 2.0 * sigma ? 1.0 : 0.0;
      result.mean_error += error;
      result.mean_sigma += sigma;
    }
  }
  const double n = kSize * kSize;
  return {result.fraction / n, result.mean_error / n, result.mean_sigma / n};
}

StereoOptions with(LambertMethod method) {
  StereoOptions options;
  options.fit.method = method;
  options.fit.has_sigma = true;
  return options;
}

constexpr LambertMethod kMethods[] = {LambertMethod::least_squares, LambertMethod::trimmed,
                                      LambertMethod::m_estimator};

TEST(NormalSigma, HoldsForNoiseAndIsNotMuchTooLarge) {
  StereoLights lights;
  lights.directions = dome_directions(60);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < 60; ++k) {
        stack.at(0, y, x, k) += static_cast<float>(0.01 * normal_noise(y, x, k));
      }
    }
  }
  for (const LambertMethod method : kMethods) {
    const Coverage found = coverage(photometric_stereo(stack, lights, {}, {}, with(method)));
    std::printf("%s: error %.3f, sigma %.3f degrees, within two %.3f\n",
                std::string(to_string(method)).c_str(), found.mean_error, found.mean_sigma,
                found.fraction);
    // Two of an rms angle of two components: 0.98, less what twelve groups leave in doubt.
    EXPECT_GE(found.fraction, 0.92);
    EXPECT_LE(found.mean_sigma, 3.0 * found.mean_error);
  }
}

TEST(NormalSigma, HoldsWhereTheModelIsWrong) {
  // A glossy lobe on every pixel, as wide as a tenth of the lights, and stray light.
  StereoLights lights;
  lights.directions = dome_directions(60);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < 60; ++k) {
        const Vector3d half =
            (lights.directions[static_cast<std::size_t>(k)] + Vector3d::UnitZ()).normalized();
        stack.at(0, y, x, k) += static_cast<float>(
            0.4 * std::pow(std::max(0.0, half.dot(bowl_normal(y, x))), 20.0) + 0.03);
      }
    }
  }
  for (const LambertMethod method : kMethods) {
    const Coverage found = coverage(photometric_stereo(stack, lights, {}, {}, with(method)));
    std::printf("glossy, %s: error %.3f, sigma %.3f degrees, within two %.3f\n",
                std::string(to_string(method)).c_str(), found.mean_error, found.mean_sigma,
                found.fraction);
    EXPECT_GT(found.mean_error, 0.3);
    EXPECT_GE(found.fraction, 0.9);
  }
}

/// A curve that is not the camera's bends brightness as one smooth function: most of it is a
/// normal turned away from the lights' middle, little is left to be seen. Lights all round show
/// enough of it; few lights from above do not (docs/numerics/shape.md, "Standard errors").
TEST(NormalSigma, AWrongCurveShowsUnderLightsAllRound) {
  StereoLights lights;
  lights.directions = dome_directions(12);
  StereoLights high;
  for (const Vector3d& direction : lights.directions) {
    high.directions.push_back((direction + 1.5 * Vector3d::UnitZ()).normalized());
  }
  for (const bool is_high : {false, true}) {
    const StereoLights& used = is_high ? high : lights;
    MemoryStack stack = far_capture(kSize, kSize, 1, used.directions, bowl());
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        for (int k = 0; k < 12; ++k) {
          stack.at(0, y, x, k) = std::pow(stack.at(0, y, x, k), 2.2F);
        }
      }
    }
    for (const LambertMethod method : kMethods) {
      const Coverage found = coverage(photometric_stereo(stack, used, {}, {}, with(method)));
      std::printf("wrong curve, %s, %s: error %.2f, sigma %.2f degrees, within two %.3f\n",
                  is_high ? "high lights" : "lights all round",
                  std::string(to_string(method)).c_str(), found.mean_error, found.mean_sigma,
                  found.fraction);
      if (!is_high) {
        EXPECT_GE(found.fraction, 0.9);
      }
    }
  }
}

/// Of twelve mean residuals the fit has taken three: what they share is larger than they look.
TEST(NormalSigma, CountsWhatTheFitTookFromTheGroupsMeans) {
  // Each group of neighbouring lights is off by its own amount, drawn anew for each pixel.
  constexpr int kLights = 240;
  StereoLights lights;
  lights.directions = dome_directions(kLights);
  const LightGroups groups = group_lights(lights.directions);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < kLights; ++k) {
        const int group = groups.group[static_cast<std::size_t>(k)];
        stack.at(0, y, x, k) += static_cast<float>(0.03 * normal_noise(y, x, group));
      }
    }
  }
  LambertOptions options;
  options.method = LambertMethod::least_squares;
  options.has_sigma = true;
  double shared = 0.0;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      LambertFitter fitter(kLights, options);
      fitter.set_groups(groups.group);
      for (const int k : groups.order) {
        fitter.add(lights.directions[static_cast<std::size_t>(k)], double{stack.at(0, y, x, k)},
                   k);
      }
      const double found = fitter.common_residual(fitter.fit());
      shared += found * found / (kSize * kSize);
    }
  }
  std::printf("shared by neighbours: 0.03, found %.5f\n", std::sqrt(shared));
  // 576 pixels of 9 degrees of freedom: 1 % of the rms; groups are not of one size: 3 %.
  EXPECT_NEAR(std::sqrt(shared), 0.03, 0.04 * 0.03);
}

TEST(NormalSigma, ThreeLightsCheckNothing) {
  StereoLights lights;
  lights.directions = dome_directions(3);
  const MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  const SurfaceEstimate found =
      photometric_stereo(stack, lights, {}, {}, with(LambertMethod::trimmed));
  EXPECT_EQ(found.sigma_deg(5, 5), 90.0F);
}

/// A sheet with a ridge along a column: 40 degrees between its sides.
TEST(NormalUnevenness, IsTheAngleToTheMeanOfOppositeNeighboursBeyondWhatIsStated) {
  SurfaceEstimate surface{Image<float>(5, 8, 3),        Image<float>(5, 8, 1),
                          Image<float>(5, 8, 1),        Image<std::uint16_t>(5, 8, 1),
                          Image<std::uint8_t>(5, 8, 1), Image<float>(5, 8, 1)};
  const double tilt = 20.0 * std::numbers::pi / 180.0;
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 8; ++x) {
      surface.normal(y, x, 0) = static_cast<float>(x < 4 ? -std::sin(tilt) : std::sin(tilt));
      surface.normal(y, x, 2) = static_cast<float>(std::cos(tilt));
      surface.state(y, x) = static_cast<std::uint8_t>(PixelState::good);
      surface.sigma_deg(y, x) = 3.0F;
    }
  }
  surface.state(0, 7) = static_cast<std::uint8_t>(PixelState::too_dark);
  surface.sigma_deg(0, 7) = 0.0F;
  surface.sigma_deg(2, 4) = 17.0F;
  add_unevenness(surface);
  // Beside the ridge 20 degrees from the middle of its row's neighbours, none in its column; of
  // three pixels of 3 degrees 1.5 x 9 are to be expected. Corners have nothing to compare.
  EXPECT_NEAR(surface.sigma_deg(2, 3), std::sqrt(9.0 + 0.5 * 400.0 - 13.5), 1e-4);
  EXPECT_NEAR(surface.sigma_deg(0, 3), std::sqrt(9.0 + 400.0 - 13.5), 1e-4);  // its row only
  EXPECT_EQ(surface.sigma_deg(2, 1), 3.0F);
  EXPECT_EQ(surface.sigma_deg(4, 7), 3.0F);
  EXPECT_EQ(surface.sigma_deg(2, 4), 17.0F);  // says as much already
  EXPECT_EQ(surface.sigma_deg(0, 7), 0.0F);   // not known
}

TEST(LightGroups, EachLightIsInOneGroupAndTheOrderGoesGroupByGroup) {
  const LightGroups groups = group_lights(dome_directions(50));
  EXPECT_EQ(groups.n_groups, kLightGroups);
  std::vector<int> seen(50, 0);
  for (std::size_t i = 0; i < groups.order.size(); ++i) {
    ++seen[static_cast<std::size_t>(groups.order[i])];
    if (i > 0) {
      EXPECT_LE(groups.group[static_cast<std::size_t>(groups.order[i - 1])],
                groups.group[static_cast<std::size_t>(groups.order[i])]);
    }
  }
  EXPECT_EQ(seen, std::vector<int>(50, 1));
  EXPECT_EQ(thinned(groups, 10).size(), 10U);
  EXPECT_EQ(thinned(groups, 100).size(), 50U);
  // Coinciding lights: fewer directions than lights, yet each is its own group.
  EXPECT_EQ(group_lights({Vector3d::UnitZ(), Vector3d::UnitZ(), Vector3d::UnitX()}).n_groups,
            3);
}

TEST(FitChoice, TheBestScoredFitIsTheMostExactOrNearlySo) {
  // Stray light in shadows on a third of the lights; then highlights on few.
  StereoLights lights;
  lights.directions = dome_directions(48);
  for (const bool is_shadow : {true, false}) {
    MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        for (int k = 0; k < 48; ++k) {
          const double dice =
              uniform_unit(hash_key(3, pixel_number(y, x), static_cast<std::uint64_t>(k)));
          float& value = stack.at(0, y, x, k);
          value += static_cast<float>(0.005 * normal_noise(y, x, k));
          if (is_shadow && dice < 0.3) {
            value *= 0.4F;
          } else if (!is_shadow && dice < 0.1) {
            value += 0.8F;
          }
        }
      }
    }
    const std::vector<FitScore> scores = score_fits(stack, lights, {}, {}, {});
    ASSERT_EQ(scores.size(), 4U);
    double least = 90.0;
    double chosen = 0.0;
    for (std::size_t i = 0; i < scores.size(); ++i) {
      StereoOptions options;
      options.fit = scores[i].fit;
      options.fit.has_sigma = true;
      const double error =
          coverage(photometric_stereo(stack, lights, {}, {}, options)).mean_error;
      std::printf("%s, %s: held out %.5f, error %.3f degrees\n",
                  is_shadow ? "shadows" : "highlights", scores[i].name.c_str(),
                  scores[i].held_out, error);
      least = std::min(least, error);
      chosen = i == 0 ? error : chosen;
    }
    EXPECT_LE(chosen, 1.5 * least);
  }
}

TEST(HeightBow, AQuadraticIsAllBowAndDetailIsNone) {
  Image<float> height(20, 30, 1);
  Image<std::uint8_t> known(20, 30, 1);
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 30; ++x) {
      known(y, x) = 1;
      height(y, x) = static_cast<float>(0.02 * (x - 14.5) * (x - 14.5) + 0.1 * y);
    }
  }
  const HeightBow bow = height_bow(height.view(), known.view());
  EXPECT_LT(bow.rest, 1e-4);  // floats of up to 6
  EXPECT_NEAR(bow.bow, 0.02 * (14.5 * 14.5 - 0.25) + 0.1 * 19, 1e-4);
  height(10, 15) += 3.0F;
  EXPECT_GT(height_bow(height.view(), known.view()).rest, 2.5);
}

TEST(LightNearness, DirectionsOfNearLightsGiveThemselvesAway) {
  const double width = 100.0;
  const double pitch = width / kSize;
  MadeSurface sheet = bowl();
  sheet.point = [=](int y, int x) -> Vector3d {
    return {pitch * (x - 11.5), pitch * (11.5 - y), 0.0};
  };
  StereoLights lights;
  lights.directions = dome_directions(48);
  const PixelPoints pixels = PixelPoints::orthographic(kSize, kSize, width);
  ShapeOptions options;
  options.stereo.fit.has_sigma = true;
  for (const double widths : {5.0, 10.0}) {
    std::vector<NearLight> near;
    for (const Vector3d& direction : lights.directions) {
      near.push_back({direction * widths * width, -direction});
    }
    const MemoryStack stack = near_capture(kSize, kSize, near, sheet);
    const Shape shape = recover_shape(stack, lights, pixels, {}, options);
    const Coverage found = coverage(shape.surface);
    std::printf("lights at %.0f widths: 1 / %.2f, error %.2f, sigma %.2f, within two %.3f\n",
                widths, 1.0 / shape.nearness.inverse, found.mean_error, found.mean_sigma,
                found.fraction);
    EXPECT_TRUE(shape.nearness.is_near());
    // Of first order: what it leaves out is (0.7 / widths)^2.
    EXPECT_NEAR(shape.nearness.inverse * widths, 1.0, 0.2);
    EXPECT_GE(found.fraction, 0.9);
  }
  const MemoryStack far = far_capture(kSize, kSize, 1, lights.directions, bowl());
  const Shape shape = recover_shape(far, lights, pixels, {}, options);
  EXPECT_FALSE(shape.nearness.is_near());
  EXPECT_LT(shape.nearness.inverse, 1e-4);
}

/// A cap 17 mm high whose mean lies `lift` above the plane z = 0; mm, parallel projection.
constexpr double kPitch = 5.0;
double cap_height(int y, int x) {
  const double u = (x - 11.5) / 12.0;
  const double v = (y - 11.5) / 12.0;
  return 12.0 * (1.0 - 0.7 * (u * u + v * v));
}

MadeSurface cap(double lift) {
  double mean = 0.0;
  for (int i = 0; i < kSize * kSize; ++i) {
    mean += cap_height(i / kSize, i % kSize) / (kSize * kSize);
  }
  return {[=](int y, int x) -> Vector3d {
            return {kPitch * (x - 11.5), kPitch * (11.5 - y), cap_height(y, x) - mean + lift};
          },
          [](int y, int x) -> Vector3d {
            const double slope = 12.0 * 0.7 * 2.0 / (12.0 * 12.0 * kPitch);
            return Vector3d(slope * (x - 11.5), slope * (11.5 - y), 1.0).normalized();
          },
          [](int) { return 0.5; }};
}

TEST(PartHeights, FallOffTellsHowHighAPartStands) {
  StereoLights lights;
  lights.are_near = true;
  lights.near = light_array(8, 90.0, 600.0, 1.0);
  for (const double lift : {0.0, 40.0, 90.0}) {
    MemoryStack stack = near_capture(kSize, kSize, lights.near, cap(lift));
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        for (int k = 0; k < stack.dims().n_lights; ++k) {
          stack.at(0, y, x, k) *= static_cast<float>(1.0 + 0.01 * normal_noise(y, x, k));
        }
      }
    }
    ShapeOptions options;
    options.finds_part_heights = true;
    options.stereo.fit.has_sigma = true;
    const PixelPoints pixels = PixelPoints::orthographic(kSize, kSize, kPitch * kSize);
    const Shape shape = recover_shape(stack, lights, pixels, {}, options);
    ASSERT_EQ(shape.parts.size(), 1U);
    const PartHeight& part = shape.parts[0];
    std::printf("lift %.0f: found %.2f +- %.2f mm\n", lift, part.mean_mm, part.sigma_mm);
    EXPECT_TRUE(part.is_known);
    EXPECT_GT(part.sigma_mm, 0.0);
    EXPECT_LE(std::abs(part.mean_mm - lift), 2.0 * part.sigma_mm);
    EXPECT_LE(part.sigma_mm, 10.0);
    double mean = 0.0;
    for (const float height : shape.height.pixels()) {
      mean += double{height} / (kSize * kSize);
    }
    EXPECT_NEAR(mean, part.mean_mm, 0.1);
  }
}

TEST(PartHeights, ByDefaultEachPartsMeanIsThePlane) {
  StereoLights lights;
  lights.are_near = true;
  lights.near = light_array(6, 90.0, 600.0, 1.0);
  const MemoryStack stack = near_capture(kSize, kSize, lights.near, cap(0.0));
  Image<std::uint8_t> mask(kSize, kSize, 1);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      mask(y, x) = x < 10 || x > 15 ? 1 : 0;
    }
  }
  const PixelPoints pixels = PixelPoints::orthographic(kSize, kSize, kPitch * kSize);
  const Shape shape = recover_shape(stack, lights, pixels, mask.view());
  ASSERT_EQ(shape.parts.size(), 2U);
  EXPECT_EQ(shape.parts[0].n_pixels, 10 * kSize);
  EXPECT_EQ(shape.parts[1].n_pixels, 8 * kSize);
  for (const PartHeight& part : shape.parts) {
    EXPECT_FALSE(part.is_known);
    EXPECT_NEAR(part.mean_mm, 0.0, 1e-3);
  }
}

}  // namespace
}  // namespace haarlight::relight
