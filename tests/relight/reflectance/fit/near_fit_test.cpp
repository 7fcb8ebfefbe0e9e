// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/near_fit.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"

namespace haarlight::relight {
namespace {

using testing::field;

constexpr int kWidth = 150;
constexpr int kHeight = 40;
constexpr double kWidthMm = 200.0;

/// A square array of lights above the picture, as a rig has them.
NearGeometry array_above(int side, double height_mm, double mu, double width_mm = kWidthMm) {
  NearGeometry geometry;
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      NearLight light;
      light.position_mm = {600.0 * (j + 0.5) / side - 300.0, 600.0 * (i + 0.5) / side - 300.0,
                           height_mm};
      light.mu = mu;
      geometry.lights.push_back(light);
    }
  }
  geometry.points = PixelPoints::orthographic(kWidth, kHeight, width_mm);
  geometry.reference_mm = height_mm;
  return geometry;
}

double coefficient(int x, int y, int t, int c) {
  return (t == 0 ? 0.6 : 0.0) + 0.03 * field(x / 4, y / 4, t, c);
}

/// What a camera sees of a surface that is in the basis, under lights that are near.
std::vector<Image<float>> near_pictures(const NearGeometry& geometry, ReflectanceBasis basis,
                                        int n_terms) {
  std::vector<Image<float>> pictures(geometry.lights.size(), Image<float>(kHeight, kWidth, 3));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d point = geometry.points.at(x + 0.5, y + 0.5);
      for (std::size_t i = 0; i < geometry.lights.size(); ++i) {
        const NearLight& light = geometry.lights[i];
        const Eigen::Vector3d way = light.position_mm - point;
        const double r2 = way.squaredNorm();
        const Eigen::Vector3d direction = way.normalized();
        const double lobe = std::pow(std::max(0.0, -light.axis.dot(direction)), light.mu);
        const double strength = lobe * geometry.reference_mm * geometry.reference_mm / r2;
        const Eigen::VectorXd terms = terms_of(basis, n_terms, {direction}).row(0);
        for (int c = 0; c < 3; ++c) {
          double value = 0.0;
          for (int t = 0; t < n_terms; ++t) {
            value += terms[t] * coefficient(x, y, t, c);
          }
          pictures[i](y, x, c) = static_cast<float>(strength * value);
        }
      }
    }
  }
  return pictures;
}

NearFitOptions linear_options(NearSolve solve, int n_terms = 9) {
  NearFitOptions options;
  options.n_terms = n_terms;
  options.ridge = 0.0;
  options.solve = solve;
  options.transfer = Transfer::linear;
  options.planes.ends = RangeEnds::extremes;
  return options;
}

/// Largest and rms distance of the planes from the coefficients, in the planes' own steps.
struct Distance {
  double largest_steps = 0.0;
  double rms = 0.0;
};

Distance distance_to_truth(const ReflectanceModel& model, int n_terms) {
  Distance distance;
  double sum = 0.0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) {
        for (int t = 0; t < n_terms; ++t) {
          const int plane = c * n_terms + t;
          const PlaneScale& scale = model.scales[static_cast<std::size_t>(plane)];
          const double found = model.planes(y, x, plane) * scale.scale + scale.offset;
          const double error = found - coefficient(x, y, t, c);
          sum += error * error;
          distance.largest_steps =
              std::max(distance.largest_steps, std::abs(error) / scale.scale);
        }
      }
    }
  }
  distance.rms = std::sqrt(sum / (3.0 * n_terms * kWidth * kHeight));
  return distance;
}

TEST(NearFit, ReachesTheCoefficientsThatTheFarFitMisses) {
  const NearGeometry geometry = array_above(8, 300.0, 1.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 9), Transfer::linear);
  const FitResult exact = fit_near(*rows, geometry, linear_options(NearSolve::exact));
  std::vector<Eigen::Vector3d> directions;
  for (const NearLight& light : geometry.lights) {
    directions.push_back(light.position_mm.normalized());
  }
  FormOptions ridge;
  ridge.ridge = 0.0;
  const FarFit far = make_far_fit(FitForm::hsh9, candidates_of(FitForm::hsh9, ridge).front(),
                                  directions, sample_lights(*rows), ridge);
  FarFitOptions far_options;
  far_options.planes.ends = RangeEnds::extremes;
  const FitResult from_afar = fit_far(*rows, far, far_options);
  const double exact_rms = distance_to_truth(exact.model, 9).rms;
  // A byte's step is about 0.0005 here; inputs are 16-bit codes.
  EXPECT_LT(exact_rms, 5e-4);
  EXPECT_GT(distance_to_truth(from_afar.model, 9).rms, 50.0 * exact_rms);
}

TEST(NearFit, TheReferenceIsExactInEveryBasis) {
  const NearGeometry geometry = array_above(7, 280.0, 1.0);
  for (const auto& [basis, n] :
       {std::pair{ReflectanceBasis::ptm, 6}, std::pair{ReflectanceBasis::hsh, 4},
        std::pair{ReflectanceBasis::hsh, 9}, std::pair{ReflectanceBasis::hsh, 16}}) {
    NearFitOptions options = linear_options(NearSolve::exact, n);
    options.basis = basis;
    for (const auto& [x, y] : {std::pair{0, 0}, std::pair{149, 39}, std::pair{80, 20}}) {
      const Eigen::Vector3d point = geometry.points.at(x + 0.5, y + 0.5);
      Eigen::VectorXd values(3 * 49);
      for (std::size_t i = 0; i < 49; ++i) {
        const Eigen::Vector3d way = geometry.lights[i].position_mm - point;
        const Eigen::Vector3d direction = way.normalized();
        const Eigen::VectorXd terms = terms_of(basis, n, {direction}).row(0);
        const double strength = direction.z() * 280.0 * 280.0 / way.squaredNorm();
        for (int c = 0; c < 3; ++c) {
          values[static_cast<Eigen::Index>(3 * i) + c] =
              strength * terms.dot(Eigen::VectorXd::LinSpaced(n, 1.0, 2.0 + c));
        }
      }
      const Eigen::VectorXd planes =
          near_planes_of(geometry, options, values, x + 0.5, y + 0.5);
      for (int c = 0; c < 3; ++c) {
        // 16 terms over +-50 degrees: condition 1e4, squared by the normal equations.
        EXPECT_LT((planes.segment(Eigen::Index{c} * n, n) -
                   Eigen::VectorXd::LinSpaced(n, 1.0, 2.0 + c))
                      .cwiseAbs()
                      .maxCoeff(),
                  n == 16 ? 1e-4 : 1e-7);
      }
    }
  }
}

TEST(NearFit, FastLoopsAreTheReference) {
  const NearGeometry geometry = array_above(8, 300.0, 0.7);
  const auto pictures = near_pictures(geometry, ReflectanceBasis::hsh, 9);
  const auto rows = image_rows(pictures, Transfer::linear);
  for (const Transfer transfer : {Transfer::linear, Transfer::srgb}) {
    for (const auto& [basis, n] :
         {std::pair{ReflectanceBasis::ptm, 6}, std::pair{ReflectanceBasis::hsh, 4},
          std::pair{ReflectanceBasis::hsh, 9}}) {
      NearFitOptions options = linear_options(NearSolve::exact, n);
      options.basis = basis;
      options.transfer = transfer;
      options.ridge = 1e-4;
      const FitResult result = fit_near(*rows, geometry, options);
      for (const auto& [x, y] : {std::pair{0, 0}, std::pair{149, 39}, std::pair{70, 33}}) {
        Eigen::VectorXd values(3 * 64);
        for (int i = 0; i < 64; ++i) {
          for (int c = 0; c < 3; ++c) {
            values[3 * i + c] = static_cast<double>(
                std::clamp(pictures[static_cast<std::size_t>(i)](y, x, c), 0.0F, 1.0F));
          }
        }
        const Eigen::VectorXd planes =
            near_planes_of(geometry, options, values, x + 0.5, y + 0.5);
        for (int p = 0; p < 3 * n; ++p) {
          const PlaneScale& scale = result.model.scales[static_cast<std::size_t>(p)];
          const double found = result.model.planes(y, x, p) * scale.scale + scale.offset;
          EXPECT_NEAR(found, planes[p], 0.6 * scale.scale + 1e-3) << p;
        }
      }
    }
  }
}

TEST(NearFit, InterpolatingBetweenFinePixelsLosesLittle) {
  // 0.2 mm per pixel: grid nodes are 13 mm apart, 0.043 of the lights' distance.
  const NearGeometry geometry = array_above(8, 300.0, 1.0, 30.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 9), Transfer::linear);
  NearFitOptions options = linear_options(NearSolve::exact);
  options.ridge = 1e-4;
  options.transfer = Transfer::srgb;
  const FitResult exact = fit_near(*rows, geometry, options);
  options.solve = NearSolve::interpolated;
  const FitResult between = fit_near(*rows, geometry, options);
  double sum = 0.0;
  int n = 0;
  for (const Eigen::Vector3d& direction : testing::spiral_lights(9, 0.6)) {
    const Image<float> a = relit(exact.model, direction);
    const Image<float> b = relit(between.model, direction);
    for (std::size_t i = 0; i < a.pixels().size(); ++i) {
      sum += std::pow(static_cast<double>(a.pixels()[i] - b.pixels()[i]), 2);
      ++n;
    }
  }
  // 58 dB apart: a picture at 35 dB loses 0.02 dB (errors add as squares).
  EXPECT_LT(std::sqrt(sum / n), 0.00126);
}

/// Mean square distance of a model's pictures from the exact solution's.
double mean_square(const ReflectanceModel& model, const NearGeometry& geometry,
                   const NearFitOptions& options, const std::vector<Image<float>>& pictures) {
  const Eigen::MatrixXd terms =
      terms_of(options.basis, options.n_terms, testing::spiral_lights(9, 0.6));
  double sum = 0.0;
  int n = 0;
  for (int y = 1; y < kHeight; y += 3) {
    for (int x = 1; x < kWidth; x += 3) {
      Eigen::VectorXd values(3 * static_cast<Eigen::Index>(pictures.size()));
      for (Eigen::Index i = 0; i < values.size(); ++i) {
        values[i] = static_cast<double>(
            pictures[static_cast<std::size_t>(i / 3)](y, x, static_cast<int>(i % 3)));
      }
      Eigen::VectorXd planes = near_planes_of(geometry, options, values, x + 0.5, y + 0.5);
      for (Eigen::Index p = 0; p < planes.size(); ++p) {
        const PlaneScale& scale = model.scales[static_cast<std::size_t>(p)];
        planes[p] -= model.planes(y, x, static_cast<int>(p)) * scale.scale + scale.offset;
      }
      for (int c = 0; c < 3; ++c) {
        sum += (terms * planes.segment(Eigen::Index{c} * options.n_terms, options.n_terms))
                   .squaredNorm();
        n += 9;
      }
    }
  }
  return sum / n;
}

TEST(NearFit, InterpolatingOverAsMuchAsIsAllowedLosesLittle) {
  // 0.9 mm per pixel: grid nodes are 45 mm apart, 0.15 of the lights' distance; straight lines
  // 0.048.
  const NearGeometry geometry = array_above(8, 300.0, 1.0, 135.0);
  const auto pictures = near_pictures(geometry, ReflectanceBasis::hsh, 9);
  const auto rows = image_rows(pictures, Transfer::linear);
  for (const Transfer transfer : {Transfer::linear, Transfer::srgb}) {
    NearFitOptions options = linear_options(NearSolve::exact);
    options.ridge = 1e-4;
    options.transfer = transfer;
    const FitResult exact = fit_near(*rows, geometry, options);
    options.solve = NearSolve::interpolated;
    const FitResult between = fit_near(*rows, geometry, options);
    // Beyond what the exact fit's bytes are off: a picture 37 dB from the truth loses 0.02 dB.
    EXPECT_LT(mean_square(between.model, geometry, options, pictures) -
                  mean_square(exact.model, geometry, options, pictures),
              0.0046 * std::pow(10.0, -3.7));
  }
}

TEST(NearFit, InterpolatingBetweenCoarsePixelsIsRefused) {
  const NearGeometry geometry = array_above(4, 300.0, 1.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 4), Transfer::linear);
  EXPECT_THROW((void)fit_near(*rows, geometry, linear_options(NearSolve::interpolated, 4)),
               Error);
  // Fine pixels, but one light is near: its direction turns fast between grid nodes 10 mm
  // apart.
  NearGeometry fine = array_above(4, 300.0, 1.0, 30.0);
  EXPECT_NO_THROW((void)fit_near(*rows, fine, linear_options(NearSolve::interpolated, 4)));
  for (const double height : {0.0, 30.0}) {  // the first on a grid node itself
    fine.lights[5].position_mm = fine.points.at(0.0, kHeight / 3.0);
    fine.lights[5].position_mm.z() = height;
    try {
      (void)fit_near(*rows, fine, linear_options(NearSolve::interpolated, 4));
      ADD_FAILURE() << "taken at " << height;
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find("light 5"), std::string::npos) << error.problem();
    }
  }
}

TEST(NearFit, ALightInAPixelsPositionSaysNothingThere) {
  NearGeometry geometry = array_above(4, 300.0, 1.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 4), Transfer::linear);
  const FitResult before = fit_near(*rows, geometry, linear_options(NearSolve::exact, 4));
  geometry.lights[5].position_mm = geometry.points.at(40.5, 20.5);
  const FitResult result = fit_near(*rows, geometry, linear_options(NearSolve::exact, 4));
  for (int t = 0; t < 12; ++t) {
    const auto value = [t](const ReflectanceModel& model) {
      const PlaneScale& scale = model.scales[static_cast<std::size_t>(t)];
      return model.planes(20, 40, t) * scale.scale + scale.offset;
    };
    EXPECT_NEAR(value(result.model), value(before.model), 0.05);
  }
}

TEST(NearFit, DoesNotDependOnThreads) {
  const NearGeometry geometry = array_above(4, 300.0, 1.0, 30.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 4), Transfer::linear);
  for (const NearSolve solve : {NearSolve::exact, NearSolve::interpolated}) {
    std::vector<FitResult> results;
    for (const int threads : {1, 2, 7}) {
      const ThreadLimit limit(threads);
      results.push_back(fit_near(*rows, geometry, linear_options(solve, 4)));
    }
    for (const FitResult& result : results) {
      EXPECT_TRUE(std::equal(result.model.planes.pixels().begin(),
                             result.model.planes.pixels().end(),
                             results[0].model.planes.pixels().begin()));
    }
  }
}

TEST(NearFit, RefusesWhatItCannotTell) {
  NearGeometry geometry = array_above(2, 300.0, 1.0);
  const auto rows =
      image_rows(near_pictures(geometry, ReflectanceBasis::hsh, 4), Transfer::linear);
  // Four lights, nine terms, no ridge.
  EXPECT_THROW((void)fit_near(*rows, geometry, linear_options(NearSolve::exact, 9)), Error);
  NearFitOptions with_ridge = linear_options(NearSolve::exact, 9);
  with_ridge.ridge = 1e-3;
  EXPECT_NO_THROW((void)fit_near(*rows, geometry, with_ridge));
  geometry.lights[1].position_mm = geometry.points.at(0.5 * kWidth, 0.5 * kHeight);
  EXPECT_THROW((void)fit_near(*rows, geometry, with_ridge), Error);
}

TEST(NearFit, LightsInThePlaneNearAndFarGiveNumbers) {
  for (const double height : {0.2, 200.0, 200000.0}) {
    NearGeometry geometry = array_above(4, height, 0.0);
    for (NearLight& light : geometry.lights) {  // scaled about the picture with the height
      light.position_mm.head<2>() *= std::max(1.0, height / 300.0);
    }
    geometry.lights[0].position_mm.z() = 0.0;
    const auto rows = image_rows(
        std::vector<Image<float>>(16,
                                  [] {
                                    Image<float> grey(kHeight, kWidth, 1);
                                    std::fill(grey.pixels().begin(), grey.pixels().end(), 0.4F);
                                    return grey;
                                  }()),
        Transfer::linear);
    NearFitOptions options = linear_options(NearSolve::exact, 4);
    options.ridge = 1e-3;
    const FitResult result = fit_near(*rows, geometry, options);
    for (const PlaneScale& scale : result.model.scales) {
      EXPECT_TRUE(std::isfinite(scale.scale) && std::isfinite(scale.offset)) << height;
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
