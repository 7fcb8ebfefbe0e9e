// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "relight/reflectance/fit/light_interpolation.h"
#include "tests/extremes.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::refused;
using extremes::stated;
using testing::empty_model;
using testing::spiral_lights;

// ---- fitting terms ----

EXTREMES_OF(terms, "relight/reflectance: fit", "PTM and HSH terms by least squares, kriging")

constexpr std::pair<ReflectanceBasis, int> kBases[] = {{ReflectanceBasis::ptm, 6},
                                                       {ReflectanceBasis::hsh, 4},
                                                       {ReflectanceBasis::hsh, 9},
                                                       {ReflectanceBasis::hsh, 16}};

/// A constant picture predicted under other lights: largest error.
double constant_error(const std::vector<Vector3d>& lights, double ridge, double value = 1.0) {
  double worst = 0.0;
  for (const auto& [basis, n_terms] : kBases) {
    LightInterpolation interpolation;
    interpolation.basis = basis;
    interpolation.n_terms = n_terms;
    interpolation.ridge = ridge;
    const Eigen::MatrixXd matrix = term_matrix(interpolation, lights);
    EXPECT_TRUE(matrix.allFinite());
    const Eigen::VectorXd found =
        terms_of(basis, n_terms, lights) *
        (matrix * Eigen::VectorXd::Constant(static_cast<Eigen::Index>(lights.size()), value));
    worst = std::max(worst, (found.array() / value - 1.0).abs().maxCoeff());
  }
  return worst;
}
constexpr const char* kConstant = "a constant picture under its own lights: relative error";
constexpr const char* kSolve = "2^-53 times the condition of the terms";

LightInterpolation kriging() {
  LightInterpolation interpolation;
  interpolation.kind = InterpolationKind::kriging;
  interpolation.ridge = 0.01;
  return interpolation;
}

NO_EXTREME(terms, dark, "linear in the pictures: black stays black")
EXTREME(terms, one) {
  return bounded(
      std::max(constant_error(spiral_lights(1), 1e-4), constant_error(spiral_lights(3), 1e-4)),
      1e-6, std::string("one or three lights, ridge 1e-4: ") + kConstant,
      "the ridge does not bend a constant");
}
EXTREME(terms, largest) {
  return bounded(constant_error(spiral_lights(4096), 0.0), 1e-9,
                 std::string("4096 lights: ") + kConstant, kSolve);
}
NO_EXTREME(terms, odd_size, "any number of lights")
EXTREME(terms, scale) {
  return bounded(std::max(constant_error(spiral_lights(40), 0.0, 1e-30),
                          constant_error(spiral_lights(40), 0.0, 1e30)),
                 1e-10, std::string("values of 1e±30: ") + kConstant, kSolve);
}
NO_EXTREME(terms, subnormal, "pictures of 8 to 16 bits")
NO_EXTREME(terms, not_finite, "pictures and lists of lights refuse it")
EXTREME(terms, degenerate) {
  std::vector<Vector3d> fan;
  std::vector<Vector3d> ring;
  for (int i = 1; i < 13; ++i) {
    const double a = i * std::numbers::pi / 13.0;
    fan.emplace_back(std::cos(a), 0.0, std::sin(a));
    ring.emplace_back(0.8 * std::cos(2.0 * a), 0.8 * std::sin(2.0 * a), 0.6);
  }
  const double worst = std::max(constant_error(fan, 1e-4), constant_error(ring, 1e-4));
  for (const auto& lights : {fan, ring}) {
    EXPECT_EQ(light_warnings(lights).size(), 1U);
    EXPECT_TRUE(interpolation_weights(kriging(), lights, spiral_lights(9)).allFinite());
    EXPECT_LT(terms_condition(ReflectanceBasis::ptm, 6, lights).rank, 6);
  }
  return both(
      bounded(worst, 1e-6,
              std::string("lights in one plane or on a circle, ridge 1e-4: ") + kConstant,
              "the ridge does not bend a constant"),
      stated("a warning that names the plane or the circle, the rank and the combination that "
             "no light sees"));
}
EXTREME(terms, grazing) {
  std::vector<Vector3d> lights = spiral_lights(30);
  lights.emplace_back(1.0, 0.0, 0.0);
  lights.emplace_back(0.0, -1.0, 1e-12);
  lights.emplace_back(0.6, 0.0, -0.8);
  EXPECT_FALSE(light_warnings(lights).empty());
  EXPECT_TRUE(interpolation_weights(kriging(), lights, spiral_lights(9)).allFinite());
  return both(bounded(constant_error(lights, 1e-4), 1e-6,
                      std::string("lights on and below the horizon: ") + kConstant,
                      "the ridge does not bend a constant"),
              stated("a light below the horizon is named in a warning"));
}
NO_EXTREME(terms, far_near, "directions alone")
EXTREME(terms, duplicate) {
  std::vector<Vector3d> lights = spiral_lights(12);
  lights.push_back(lights[3]);
  Eigen::VectorXd values = Eigen::VectorXd::Constant(13, 0.5);
  values[3] = 0.4;
  values[12] = 0.6;
  const double found = interpolation_weights(kriging(), lights, {lights[3]}).row(0) * values;
  const std::vector<std::string> warnings = light_warnings(lights);
  EXPECT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings.at(0).find("3 and 12"), std::string::npos);
  const std::vector<Vector3d> all_same(7, lights[3]);
  const double worst = constant_error(all_same, 1e-4);
  EXPECT_LT(worst, 1e-6);
  return both(bounded(std::abs(found - 0.5), 1e-9,
                      "two lights at the same position count as their mean, kriging: error",
                      "a system of 16, 2^-53 times its condition"),
              stated("a warning names the two"));
}
NO_EXTREME(terms, clipped, "clipped pictures are bytes of 255: a value as any other")

// ---- bytes ----

EXTREMES_OF(bytes, "relight/reflectance: formats",
            "quantising planes to bytes, rules of .ptm, .rti and web folders")

constexpr ScaleRule kRules[] = {ScaleRule::any, ScaleRule::rti, ScaleRule::ptm};

/// The largest error in steps, over the rules.
double worst_steps(const Image<float>& coefficients) {
  double worst = 0.0;
  for (const ScaleRule rule : kRules) {
    ReflectanceModel model =
        empty_model(rule == ScaleRule::rti ? ReflectanceBasis::hsh : ReflectanceBasis::ptm,
                    ReflectanceColour::rgb, rule == ScaleRule::rti ? 4 : 6);
    const int n_planes = 3 * model.n_terms;
    Image<float> own(coefficients.height(), coefficients.width(), n_planes);
    for (int y = 0; y < own.height(); ++y) {
      for (int x = 0; x < own.width(); ++x) {
        for (int p = 0; p < n_planes; ++p) {
          own(y, x, p) = coefficients(y, x, p);
        }
      }
    }
    const QuantisationLoss loss = quantise(model, own.view(), rule);
    EXPECT_TRUE(obeys(rule, model));
    for (const PlaneScale& scale : model.scales) {
      EXPECT_GT(scale.scale, 0.0);
      EXPECT_TRUE(std::isfinite(scale.scale) && std::isfinite(scale.offset));
    }
    const double steps = loss.worst_steps();
    worst = std::isnan(steps) ? steps : std::max(worst, steps);
  }
  return worst;
}
Image<float> planes_of(int width, int height, double scale) {
  Image<float> image(height, width, 18);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int p = 0; p < 18; ++p) {
        image(y, x, p) = static_cast<float>(scale * testing::field(x, y, p, 0));
      }
    }
  }
  return image;
}
constexpr const char* kSteps = "largest error in steps";
constexpr const char* kStepsWhy =
    "half a step, and 1e-4 for a scale of 32 bits or six decimals";

EXTREME(bytes, dark) {
  return bounded(worst_steps(planes_of(5, 3, 0.0)), 0.5 + 1e-4,
                 std::string("planes of zeros, no scale is 0: ") + kSteps, kStepsWhy);
}
EXTREME(bytes, one) {
  return bounded(worst_steps(planes_of(1, 1, 3.0)), 0.5 + 1e-4,
                 std::string("one pixel: ") + kSteps, kStepsWhy);
}
NO_EXTREME(bytes, largest, "row by row")
EXTREME(bytes, odd_size) {
  return bounded(worst_steps(planes_of(17, 3, 3.0)), 0.5 + 1e-4,
                 std::string("17 × 3: ") + kSteps, kStepsWhy);
}
EXTREME(bytes, scale) {
  ReflectanceModel model = empty_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4);
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    Image<float> image(7, 9, 12);
    for (int i = 0; i < 63 * 12; ++i) {
      image.pixels()[static_cast<std::size_t>(i)] =
          static_cast<float>(scale * testing::field(i % 9, i / 9, i % 12, 0));
    }
    for (const ScaleRule rule : {ScaleRule::any, ScaleRule::rti}) {
      worst = std::max(worst, quantise(model, image.view(), rule).worst_steps());
    }
  }
  return bounded(worst, 0.5 + 1e-4,
                 std::string("coefficients of 1e±30, .rti and web folders: ") + kSteps,
                 kStepsWhy);
}
EXTREME(bytes, subnormal) {
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  quantise(model, planes_of(9, 7, 1e-40).view(), ScaleRule::any);
  for (const PlaneScale& scale : model.scales) {
    EXPECT_GT(scale.scale, 0.0);
    EXPECT_TRUE(std::isfinite(scale.scale));
  }
  return stated("coefficients of 1e-40: scales above 0");
}
EXTREME(bytes, not_finite) {
  Image<float> image = planes_of(9, 7, 1.0);
  image(3, 4, 5) = std::numeric_limits<float>::infinity();
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  (void)refused("finite", [&] { (void)quantise(model, image.view()); });
  image(3, 4, 5) = std::numeric_limits<float>::quiet_NaN();
  return refused("finite", [&] { (void)quantise(model, image.view()); });
}
NO_GEOMETRY(bytes)
EXTREME(bytes, duplicate) {
  Image<float> image(4, 4, 18);
  std::fill(image.pixels().begin(), image.pixels().end(), 0.7F);
  return bounded(worst_steps(image), 0.5 + 1e-4, std::string("planes of one value: ") + kSteps,
                 kStepsWhy);
}
EXTREME(bytes, clipped) {
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  Image<float> image(2, 2, 9);
  std::fill(image.pixels().begin(), image.pixels().end(), -0.5F);
  quantise(model, image.view());
  return refused("below 0", [&] { (void)with_scales_of(ScaleRule::ptm, model); });
}

}  // namespace
}  // namespace haarlight::relight
