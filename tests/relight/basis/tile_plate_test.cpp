// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/tile_plate.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "tests/relight/basis/made_stack.h"

namespace haarlight::relight {
namespace {

/// (rank, terms) of some polynomials.
std::vector<float> made_polynomials(int rank, int degree) {
  std::vector<float> numbers;
  const int n_terms = (degree + 1) * (degree + 1);
  for (int i = 0; i < rank * n_terms; ++i) {
    numbers.push_back(static_cast<float>(std::sin(1.7 * i + 0.3) / (1.0 + i % n_terms)));
  }
  return numbers;
}

TEST(TilePlate, SumsRowByRowAreTheTermsOneByOne) {
  constexpr int kRank = 3;
  for (const TileRect& rect :
       {TileRect{0, 0, 32, 32}, TileRect{64, 32, 7, 1}, TileRect{0, 0, 1, 5}}) {
    for (const int degree : {0, 1, 4, kMaxPlateDegree}) {
      const std::vector<float> polynomials = made_polynomials(kRank, degree);
      const std::vector<double> factors = {0.5, -2.0, 3.0};
      const auto n_pixels = static_cast<std::size_t>(rect.n_pixels());
      std::vector<double> sums(n_pixels);
      plate_sums(rect, degree, polynomials, factors, sums);
      const std::vector<double> terms = plate_terms(rect, degree);
      const std::size_t n_terms = terms.size() / n_pixels;
      for (std::size_t p = 0; p < n_pixels; ++p) {
        double expected = 0.0;
        for (std::size_t j = 0; j < factors.size(); ++j) {
          for (std::size_t t = 0; t < n_terms; ++t) {
            expected +=
                factors[j] * double{polynomials[j * n_terms + t]} * terms[p * n_terms + t];
          }
        }
        EXPECT_NEAR(sums[p], expected, 1e-12) << "degree " << degree << ", pixel " << p;
      }
    }
  }
}

TEST(TilePlate, ChebyshevTermsAreCosines) {
  constexpr int kDegree = 5;
  const TileRect rect{32, 0, 16, 8};
  const std::vector<double> terms = plate_terms(rect, kDegree);
  for (int y = 0; y < rect.height; ++y) {
    for (int x = 0; x < rect.width; ++x) {
      const double along_x = std::acos((2.0 * x + 1.0) / rect.width - 1.0);
      const double along_y = std::acos((2.0 * y + 1.0) / rect.height - 1.0);
      for (int b = 0; b <= kDegree; ++b) {
        for (int a = 0; a <= kDegree; ++a) {
          const int i =
              (y * rect.width + x) * (kDegree + 1) * (kDegree + 1) + b * (kDegree + 1) + a;
          EXPECT_NEAR(terms[static_cast<std::size_t>(i)],
                      std::cos(a * along_x) * std::cos(b * along_y), 1e-13);
        }
      }
    }
  }
}

/// Largest sine of the angle between a pixel's stored direction and its row of the plate.
double worst_sine(MemoryStack& plate, const PlateVectors& vectors, const TileRect& rect,
                  int degree) {
  const std::vector<float> tile_plate = fit_tile_plate(plate, 0, rect, vectors, degree);
  const std::vector<double> terms = plate_terms(rect, degree);
  const std::size_t n_terms = terms.size() / static_cast<std::size_t>(rect.n_pixels());
  std::vector<double> direction(static_cast<std::size_t>(plate.dims().n_lights));
  double worst = 0.0;
  for (int p = 0; p < rect.n_pixels(); ++p) {
    plate_direction<double>(
        tile_plate, std::span(terms).subspan(static_cast<std::size_t>(p) * n_terms, n_terms),
        vectors.vectors, direction);
    double along = 0.0;
    double stored = 0.0;
    double whole = 0.0;
    for (std::size_t k = 0; k < direction.size(); ++k) {
      const double b =
          plate.at(0, rect.y0 + p / rect.width, rect.x0 + p % rect.width, static_cast<int>(k));
      along += direction[k] * b;
      stored += direction[k] * direction[k];
      whole += b * b;
    }
    if (whole > 0.0) {
      worst = std::max(worst, std::sqrt(std::max(0.0, 1.0 - along * along / (stored * whole))));
    }
  }
  return worst;
}

TEST(TilePlate, MoreDegreesMissLess) {
  test::MadeScene scene;
  scene.has_sphere = false;
  MemoryStack plate = test::make_stack(scene);
  const PlateVectors vectors = fit_plate_vectors(plate, 1e-5);
  const TileRect rect{0, 0, 32, 32};
  const double constant = worst_sine(plate, vectors, rect, 0);
  const double linear = worst_sine(plate, vectors, rect, 1);
  const double quartic = worst_sine(plate, vectors, rect, 4);
  EXPECT_GT(constant, 0.05);
  EXPECT_LT(linear, 0.3 * constant);
  EXPECT_LT(quartic, 1e-3 * constant);
}

TEST(TilePlate, PixelsThatDoNotSeeThePlateDoNotBendTheFit) {
  test::MadeScene scene;
  scene.has_sphere = false;
  MemoryStack plate = test::make_stack(scene);
  const TileRect rect{0, 0, 32, 32};
  const PlateVectors vectors = fit_plate_vectors(plate, 1e-5);
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 20; ++x) {
      for (int k = 0; k < plate.dims().n_lights; ++k) {
        plate.at(0, y, x, k) = 0.0F;
      }
    }
  }
  EXPECT_LT(worst_sine(plate, vectors, rect, 4), 1e-4);
  // Three pixels carry a constant and no more; none at all carry nothing.
  for (int y = 0; y < 32; ++y) {
    for (int x = 20; x < 32; ++x) {
      for (int k = 0; k < plate.dims().n_lights && (y > 0 || x > 22); ++k) {
        plate.at(0, y, x, k) = 0.0F;
      }
    }
  }
  EXPECT_LT(worst_sine(plate, vectors, rect, 4), 0.05);
  const std::vector<float> black = fit_tile_plate(plate, 0, {0, 0, 16, 16}, vectors, 4);
  EXPECT_TRUE(std::all_of(black.begin(), black.end(), [](float v) { return v == 0.0F; }));
}

}  // namespace
}  // namespace haarlight::relight
