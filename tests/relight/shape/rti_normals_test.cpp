// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/rti_normals.h"

#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using Coefficients = Eigen::Matrix<double, 6, 1>;

/// -(p - p0)^T H (p - p0) with H positive definite: its peak is p0.
Coefficients hill(double u0, double v0) {
  const double a = 1.3;
  const double b = 0.7;
  const double c = 0.4;
  Coefficients k;
  k << -a, -b, -2.0 * c, 2.0 * (a * u0 + c * v0), 2.0 * (b * v0 + c * u0), 0.5;
  return k;
}

TEST(PtmPeak, IsTheTopOfTheHill) {
  for (const auto& [u, v] : {std::pair{0.0, 0.0}, std::pair{0.3, -0.6}, std::pair{-0.8, 0.1}}) {
    const PtmPeak peak = ptm_peak(hill(u, v));
    EXPECT_EQ(peak.state, PeakState::peak);
    EXPECT_NEAR(peak.normal.x(), u, 1e-12);
    EXPECT_NEAR(peak.normal.y(), v, 1e-12);
    EXPECT_NEAR(peak.normal.norm(), 1.0, 1e-12);
  }
}

TEST(PtmPeak, BeyondTheCircleIsTheHorizon) {
  const PtmPeak peak = ptm_peak(hill(3.0, 4.0));
  EXPECT_EQ(peak.state, PeakState::outside);
  EXPECT_LT((peak.normal - Vector3d(0.6, 0.8, 0.0)).norm(), 1e-12);
}

TEST(PtmPeak, SaddlesValleysRampsAndBlackHaveNone) {
  Coefficients saddle;
  saddle << -1.0, 1.0, 0.2, 0.3, 0.1, 0.5;
  EXPECT_EQ(ptm_peak(saddle).state, PeakState::no_peak);
  EXPECT_EQ(ptm_peak(-hill(0.1, 0.1)).state, PeakState::no_peak);
  Coefficients ramp;
  ramp << 0.0, 0.0, 0.0, 1.0, 0.0, 0.0;
  EXPECT_EQ(ptm_peak(ramp).state, PeakState::no_peak);
  EXPECT_EQ(ptm_peak(Coefficients::Zero()).state, PeakState::no_peak);
  EXPECT_EQ(ptm_peak(saddle).normal, Vector3d(Vector3d::UnitZ()));
}

ReflectanceModel model_of(ReflectanceBasis basis, ReflectanceColour colour, int n_terms) {
  ReflectanceModel model;
  model.basis = basis;
  model.colour = colour;
  model.n_terms = n_terms;
  const int n_planes = n_planes_of(colour, n_terms);
  model.scales.assign(static_cast<std::size_t>(n_planes), {4.0 / 255.0, -2.0});
  model.planes = Image<std::uint8_t>(2, 3, n_planes);
  return model;
}

std::uint8_t byte_of(double value) {
  return static_cast<std::uint8_t>(std::lround((value + 2.0) * 255.0 / 4.0));
}

TEST(RtiNormals, OfAPtmAreItsPeaks) {
  for (const ReflectanceColour colour : {ReflectanceColour::rgb, ReflectanceColour::lrgb}) {
    ReflectanceModel model = model_of(ReflectanceBasis::ptm, colour, 6);
    const Coefficients k = hill(0.2, -0.3);
    for (int plane = 0; plane < model.n_planes(); ++plane) {
      model.planes(1, 2, plane) = byte_of(k[plane % 6]);
    }
    const RtiNormals found = rti_normals(model);
    EXPECT_EQ(found.is_known(1, 2), 1);
    // Coefficients in steps of 1/64.
    EXPECT_NEAR(found.normal(1, 2, 0), 0.2, 0.02);
    EXPECT_NEAR(found.normal(1, 2, 1), -0.3, 0.02);
  }
}

/// The first four hemispherical harmonics hold a Lambertian surface's tilt in the terms 1 to 3.
TEST(RtiNormals, OfAnHshLeanAsItsTermsDo) {
  ReflectanceModel model = model_of(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4);
  model.transfer = Transfer::linear;
  const auto set = [&](int x, const std::array<double, 4>& terms) {
    for (int plane = 0; plane < 12; ++plane) {
      model.planes(0, x, plane) = byte_of(terms[static_cast<std::size_t>(plane % 4)]);
    }
  };
  // Which term leans to +x, +y: ask the basis itself.
  const auto at = [](double x, double y) {
    return hsh_terms(Vector3d(x, y, std::sqrt(0.5)), 4);
  };
  std::array<double, 4> to_x{};
  std::array<double, 4> to_y{};
  for (std::size_t t = 0; t < 4; ++t) {
    to_x[t] = 0.15 * (at(std::sqrt(0.5), 0.0)[t] - at(-std::sqrt(0.5), 0.0)[t]);
    to_y[t] = 0.15 * (at(0.0, std::sqrt(0.5))[t] - at(0.0, -std::sqrt(0.5))[t]);
  }
  to_x[0] = to_y[0] = 1.0;
  set(0, {1.0, 0.0, 0.0, 0.0});
  set(1, to_x);
  set(2, to_y);
  const RtiNormals found = rti_normals(model);
  EXPECT_NEAR(found.normal(0, 0, 0), 0.0, 0.02);
  EXPECT_NEAR(found.normal(0, 0, 1), 0.0, 0.02);
  EXPECT_GT(found.normal(0, 1, 0), 0.1);
  EXPECT_NEAR(found.normal(0, 1, 1), 0.0, 0.02);
  EXPECT_GT(found.normal(0, 2, 1), 0.1);
  EXPECT_NEAR(found.normal(0, 2, 0), 0.0, 0.02);
  for (int x = 0; x < 3; ++x) {
    EXPECT_NEAR(testing::vector_at(found.normal, 0, x).norm(), 1.0, 1e-6);
  }
}

TEST(RtiSurface, HasNormalsInTheLightsFrameAndNoneUnderTheMask) {
  ReflectanceModel model = model_of(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  model.transfer = Transfer::linear;
  const Coefficients k = hill(0.2, -0.3);
  for (int x = 0; x < 3; ++x) {
    for (int plane = 0; plane < model.n_planes(); ++plane) {
      model.planes(1, x, plane) = byte_of(x == 2 ? 0.0 : k[plane % 6]);
    }
  }
  Image<std::uint8_t> mask(2, 3, 1);
  mask(1, 1) = 1;
  mask(1, 2) = 1;
  Eigen::Matrix3d turn;  // world x to the picture's y, y to z, z to x
  turn << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  const SurfaceEstimate found = rti_surface(model, mask.view(), turn);
  EXPECT_EQ(found.n_in(PixelState::good), 1);
  EXPECT_EQ(found.n_in(PixelState::masked), 4);
  EXPECT_EQ(found.n_in(PixelState::too_dark), 1) << "no peak";
  const Vector3d normal = turn * testing::vector_at(found.normal, 1, 1);
  EXPECT_NEAR(normal.x(), 0.2, 0.02);  // coefficients in steps of 1/64
  EXPECT_NEAR(normal.y(), -0.3, 0.02);
  EXPECT_NEAR(found.albedo(1, 1, 0), 0.5, 0.01) << "the constant: lit from the camera";
  EXPECT_EQ(testing::vector_at(found.normal, 1, 0), Vector3d(Vector3d::Zero()));
  EXPECT_EQ(testing::vector_at(found.normal, 1, 2), Vector3d(Vector3d::Zero()));
}

TEST(RtiNormals, RefuseOtherBases) {
  ReflectanceModel model = model_of(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  model.basis = ReflectanceBasis::bilinear;
  EXPECT_THROW(static_cast<void>(rti_normals(model)), Error);
}

}  // namespace
}  // namespace haarlight::relight
