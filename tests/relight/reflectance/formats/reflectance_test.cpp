// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/reflectance.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

namespace haarlight::relight {
namespace {

/// The harmonics are orthonormal over the hemisphere: a product rule that is exact for them
/// (Gauss-Legendre in cos theta needs q^2 only; odd powers of q pair up over the azimuth).
TEST(Reflectance, HemisphericalHarmonicsAreOrthonormal) {
  constexpr int kRings = 2000;
  constexpr int kSlices = 32;
  Eigen::Matrix<double, 16, 16> gram = Eigen::Matrix<double, 16, 16>::Zero();
  for (int i = 0; i < kRings; ++i) {
    const double c = (i + 0.5) / kRings;
    const double s = std::sqrt(1.0 - c * c);
    for (int j = 0; j < kSlices; ++j) {
      const double phi = 2.0 * std::numbers::pi * (j + 0.25) / kSlices;
      const auto h = hsh_terms({s * std::cos(phi), s * std::sin(phi), c}, 16);
      const Eigen::Map<const Eigen::Matrix<double, 16, 1>> v(h.data());
      gram += v * v.transpose() * (2.0 * std::numbers::pi / (kRings * kSlices));
    }
  }
  // The midpoint rule's own error at 2000 rings is below 1e-5.
  EXPECT_LT((gram - Eigen::Matrix<double, 16, 16>::Identity()).cwiseAbs().maxCoeff(), 1e-5);
}

TEST(Reflectance, RoundedExponentChangesTwoTermsOnly) {
  const Eigen::Vector3d at = Eigen::Vector3d(0.5, 0.3, 0.6).normalized();
  const auto exact = hsh_terms(at, 16);
  const auto rounded = hsh_terms(at, 16, HshOrder4::chi_rounding);
  const double q = std::sqrt(at.z() - at.z() * at.z());
  for (std::size_t i = 0; i < 16; ++i) {
    EXPECT_DOUBLE_EQ(rounded[i], i == 9 || i == 15 ? exact[i] / q : exact[i]) << i;
  }
}

ReflectanceModel one_pixel(ReflectanceColour colour) {
  ReflectanceModel model;
  model.colour = colour;
  const int n = n_planes_of(colour, 6);
  model.planes = Image<std::uint8_t>(1, 1, n);
  model.scales.resize(static_cast<std::size_t>(n));
  for (int p = 0; p < n; ++p) {
    model.planes(0, 0, p) = static_cast<std::uint8_t>(10 * p + 3);
    model.scales[static_cast<std::size_t>(p)] = {0.01 * (p + 1), -0.2};
  }
  return model;
}

TEST(Reflectance, RelitIsThePolynomialOfTheDequantisedPlanes) {
  const Eigen::Vector3d at = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();
  const double u = at.x();
  const double v = at.y();
  const std::array<double, 6> terms{u * u, v * v, u * v, u, v, 1.0};
  const auto value = [](const ReflectanceModel& m, int p) {
    return m.planes(0, 0, p) * m.scales[static_cast<std::size_t>(p)].scale - 0.2;
  };
  const ReflectanceModel rgb = one_pixel(ReflectanceColour::rgb);
  const ReflectanceModel lrgb = one_pixel(ReflectanceColour::lrgb);
  const Image<float> from_rgb = relit(rgb, at);
  const Image<float> from_lrgb = relit(lrgb, at);
  for (int c = 0; c < 3; ++c) {
    double expected = 0.0;
    double luminance = 0.0;
    for (int j = 0; j < 6; ++j) {
      expected += terms[static_cast<std::size_t>(j)] * value(rgb, 6 * c + j);
      luminance += terms[static_cast<std::size_t>(j)] * value(lrgb, j);
    }
    EXPECT_NEAR(from_rgb(0, 0, c), expected, 1e-4);
    EXPECT_NEAR(from_lrgb(0, 0, c), luminance * value(lrgb, 6 + c), 1e-4);
  }
}

TEST(Reflectance, InconsistentModelsAreRefused) {
  ReflectanceModel model = one_pixel(ReflectanceColour::rgb);
  EXPECT_NO_THROW(require_consistent(model, "here"));
  model.n_terms = 7;
  EXPECT_THROW(require_consistent(model, "here"), Error);
  model = one_pixel(ReflectanceColour::rgb);
  model.scales[3].scale = std::nan("");
  EXPECT_THROW(require_consistent(model, "here"), Error);
}

}  // namespace
}  // namespace haarlight::relight
