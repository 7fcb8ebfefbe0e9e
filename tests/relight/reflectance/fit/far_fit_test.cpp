// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/far_fit.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/fit_kernel.h"
#include "relight/reflectance/fit/light_haar.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::field;
using testing::spiral_lights;

constexpr int kWidth = 83;  // no multiple of a block
constexpr int kHeight = 37;

/// Pictures of a stack that is in the basis: mean 0.5, each coefficient up to `size`.
std::vector<Image<float>> pictures_in(ReflectanceBasis basis, int n_terms, double size,
                                      const std::vector<Eigen::Vector3d>& lights) {
  const Eigen::MatrixXd terms = terms_of(basis, n_terms, lights);
  const int constant = basis == ReflectanceBasis::ptm ? 5 : 0;
  std::vector<Image<float>> pictures;
  for (Eigen::Index l = 0; l < terms.rows(); ++l) {
    Image<float> picture(kHeight, kWidth, 3);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          double value = 0.5 * terms(l, constant) / terms(0, constant);
          for (int t = 0; t < n_terms; ++t) {
            value += size * field(x, y, t, c) * terms(l, t);
          }
          picture(y, x, c) = static_cast<float>(value);
        }
      }
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

FarFit fit_of(FitForm form, const std::vector<Eigen::Vector3d>& lights, PictureRows& rows,
              double ridge = 0.0) {
  FormOptions options;
  options.ridge = ridge;
  return make_far_fit(form, candidates_of(form, options).front(), lights, sample_lights(rows),
                      options);
}

TEST(FitKernel, IsTheProduct) {
  for (const int n_out : {1, 4, 6, 9, 27}) {
    const Eigen::MatrixXd matrix = Eigen::MatrixXd::Random(n_out, 31);
    const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> in =
        Eigen::MatrixXf::Random(31, 96);
    const FitMatrix fast(matrix);
    std::vector<float> out(fit_rows_padded(static_cast<std::size_t>(n_out)) * 96);
    fast.multiply(in.data(), 96, 96, out.data(), 96);
    const Eigen::MatrixXd truth = matrix * in.cast<double>();
    for (int o = 0; o < n_out; ++o) {
      for (int x = 0; x < 96; ++x) {
        // 31 products of at most 1, each rounded twice.
        EXPECT_NEAR(out[static_cast<std::size_t>(o * 96 + x)], truth(o, x), 31 * 3e-7);
      }
    }
  }
}

TEST(FarFit, CoefficientsInTheBasisComeBackToTheirBytes) {
  const auto lights = spiral_lights(20);
  for (const auto& [form, basis, n] : {std::tuple{FitForm::ptm, ReflectanceBasis::ptm, 6},
                                       std::tuple{FitForm::hsh4, ReflectanceBasis::hsh, 4},
                                       std::tuple{FitForm::hsh9, ReflectanceBasis::hsh, 9},
                                       std::tuple{FitForm::hsh16, ReflectanceBasis::hsh, 16}}) {
    const double size = 0.03;
    const auto rows = image_rows(pictures_in(basis, n, size, lights));
    FarFitOptions options;
    options.planes.ends = RangeEnds::extremes;
    const FitResult result = fit_far(*rows, fit_of(form, lights, *rows), options);
    require_consistent(result.model, "test");
    EXPECT_EQ(result.clipped, 0.0);
    const int constant = basis == ReflectanceBasis::ptm ? 5 : 0;
    const double mean = 0.5 / terms_of(basis, n, lights)(0, constant);
    for (int y = 0; y < kHeight; y += 5) {
      for (int x = 0; x < kWidth; x += 3) {
        for (int c = 0; c < 3; ++c) {
          for (int t = 0; t < n; ++t) {
            const int p = c * n + t;
            const PlaneScale& scale = result.model.scales[static_cast<std::size_t>(p)];
            const double found = result.model.planes(y, x, p) * scale.scale + scale.offset;
            const double truth = size * field(x, y, t, c) + (t == constant ? mean : 0.0);
            // Half a step, and the rounding of inputs and 16-bit planes.
            EXPECT_NEAR(found, truth, 0.5 * scale.scale + 4e-4);
          }
        }
      }
    }
    EXPECT_GT(measure_fit(result.model, *rows, lights).mean_psnr_db(), 50.0);
  }
}

TEST(FarFit, ALuminanceTimesAColourIsLrgb) {
  const auto lights = spiral_lights(20);
  std::vector<Image<float>> pictures = pictures_in(ReflectanceBasis::ptm, 6, 0.03, lights);
  for (Image<float>& picture : pictures) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        picture(y, x, 1) = 0.6F * picture(y, x, 0);
        picture(y, x, 2) = 0.2F * picture(y, x, 0);
      }
    }
  }
  const auto rows = image_rows(std::move(pictures));
  const FitResult result = fit_far(*rows, fit_of(FitForm::lptm, lights, *rows));
  EXPECT_EQ(result.model.n_planes(), 9);
  EXPECT_EQ(result.model.planes(3, 4, 6), 255);
  EXPECT_EQ(result.model.planes(3, 4, 7), 153);
  EXPECT_GT(measure_fit(result.model, *rows, lights).mean_psnr_db(), 48.0);
}

TEST(FarFit, BytesAreThePlanesOfEachPixel) {
  const auto lights = spiral_lights(18);
  const auto pictures = pictures_in(ReflectanceBasis::hsh, 9, 0.04, lights);
  const auto rows = image_rows(pictures);
  for (const FitForm form : all_values<FitForm>()) {
    const FarFit fit = fit_of(form, lights, *rows, 0.01);
    FarFitOptions options;
    options.planes.ends = RangeEnds::extremes;
    const FitResult result = fit_far(*rows, fit, options);
    for (const auto& [y, x] : {std::pair{0, 0}, std::pair{36, 82}, std::pair{17, 64}}) {
      Eigen::VectorXd values(3 * 18);
      for (int k = 0; k < 18; ++k) {
        for (int c = 0; c < 3; ++c) {
          values[3 * k + c] =
              static_cast<double>(pictures[static_cast<std::size_t>(k)](y, x, c));
        }
      }
      const Eigen::VectorXd planes = planes_of(fit, values);
      for (int p = 0; p < result.model.n_planes(); ++p) {
        const PlaneScale& scale = result.model.scales[static_cast<std::size_t>(p)];
        const double found = result.model.planes(y, x, p) * scale.scale + scale.offset;
        EXPECT_NEAR(found, planes[p], 0.51 * scale.scale + 4e-4)
            << to_string(form) << " plane " << p;
      }
    }
  }
}

TEST(FarFit, DoesNotDependOnThreadsNorOnWherePlanesWait) {
  const testing::TemporaryFolder folder;
  const auto lights = spiral_lights(12);
  const auto rows = image_rows(pictures_in(ReflectanceBasis::hsh, 4, 0.05, lights));
  const FarFit fit = fit_of(FitForm::bilinear, lights, *rows, 0.01);
  std::vector<FitResult> results;
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    FarFitOptions options;
    options.planes.memory_bytes = threads == 2 ? 0 : std::uint64_t{1} << 28U;
    options.planes.work_folder = folder.path();
    results.push_back(fit_far(*rows, fit, options));
  }
  for (const FitResult& result : results) {
    EXPECT_TRUE(std::equal(result.model.planes.pixels().begin(),
                           result.model.planes.pixels().end(),
                           results[0].model.planes.pixels().begin()));
    EXPECT_EQ(result.model.scales, results[0].model.scales);
  }
}

TEST(FarFit, BlackAndWhitePixelsStaySo) {
  const auto lights = spiral_lights(15);
  std::vector<Image<float>> pictures;
  for (const Eigen::Vector3d& light : lights) {
    Image<float> picture(8, 70, 3);
    for (int y = 0; y < 8; ++y) {
      for (int x = 0; x < 70; ++x) {
        for (int c = 0; c < 3; ++c) {
          // Columns: always dark (no light reaches it, or no albedo), saturated, and matte.
          const double matte = std::max(0.0, light.z());
          picture(y, x, c) = x < 20 ? 0.0F : (x < 40 ? 1.0F : static_cast<float>(matte));
        }
      }
    }
    pictures.push_back(std::move(picture));
  }
  const auto rows = image_rows(std::move(pictures));
  for (const FitForm form : all_values<FitForm>()) {
    const FitResult result = fit_far(*rows, fit_of(form, lights, *rows, 0.001));
    const Image<float> found =
        relit(result.model, Eigen::Vector3d(0.3, 0.2, 0.93).normalized());
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(found(4, 10, c), 0.0F, 0.02F) << to_string(form);
      EXPECT_NEAR(found(4, 30, c), 1.0F, 0.02F) << to_string(form);
    }
  }
}

TEST(ParameterChoice, TakesTheBasisThatTheStackIsIn) {
  const auto lights = spiral_lights(40);
  const auto rows = image_rows(pictures_in(ReflectanceBasis::hsh, 9, 0.08, lights));
  const std::vector<FormScore> scores = score_forms(
      {FitForm::ptm, FitForm::hsh4, FitForm::hsh9}, lights, sample_lights(*rows), {});
  EXPECT_EQ(scores.front().form, FitForm::hsh9);
  EXPECT_EQ(scores.front().interpolation.ridge, 0.0);
  // Inputs are 16-bit codes: up to 107 dB; products are float sums.
  EXPECT_GT(scores.front().psnr_db, 75.0);
  EXPECT_LT(scores.back().psnr_db, 45.0);
}

TEST(ParameterChoice, PredictsWhatHeldOutPicturesSay) {
  // A matte relief with attached shadows under 36 lights; every fourth is held out.
  const auto all = spiral_lights(48, 0.15);
  std::vector<Eigen::Vector3d> kept;
  std::vector<Eigen::Vector3d> held;
  std::vector<int> kept_lights;
  std::vector<int> held_lights;
  std::vector<Image<float>> pictures;
  for (std::size_t k = 0; k < all.size(); ++k) {
    (k % 4 == 1 ? held : kept).push_back(all[k]);
    (k % 4 == 1 ? held_lights : kept_lights).push_back(static_cast<int>(k));
    Image<float> picture(kHeight, kWidth, 3);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const Eigen::Vector3d n =
            Eigen::Vector3d(0.8 * field(x, y, 0, 0), 0.8 * field(x, y, 1, 0), 1.0).normalized();
        const auto value = static_cast<float>(0.9 * std::max(0.0, n.dot(all[k])));
        for (int c = 0; c < 3; ++c) {
          picture(y, x, c) = srgb_from_linear(value);
        }
      }
    }
    pictures.push_back(std::move(picture));
  }
  const auto rows = image_rows(std::move(pictures));
  const auto kept_rows = selected_rows(*rows, kept_lights);
  const auto held_rows = selected_rows(*rows, held_lights);
  const LightSample sample = sample_lights(*kept_rows);
  const std::vector<FormScore> scores = score_forms(all_values<FitForm>(), kept, sample, {});
  double last = 1e9;
  for (const FormScore& score : scores) {
    const FitResult result =
        fit_far(*kept_rows, make_far_fit(score.form, score.interpolation, kept, sample, {}));
    const double psnr = measure_fit(result.model, *held_rows, held).mean_psnr_db();
    // The rule of the choice: nobody who stands later is better by 1.5 dB.
    EXPECT_LT(psnr, last + 1.5) << to_string(score.form);
    last = std::max(psnr, score.form == scores.front().form ? 0.0 : last);
    EXPECT_NEAR(psnr, score.psnr_db, 4.0) << to_string(score.form);
  }
}

TEST(LightHaar, KeepsAsMuchAsItIsAllowed) {
  LightSample sample;
  sample.values.resize(48, 2);
  for (Eigen::Index k = 0; k < 16; ++k) {
    for (Eigen::Index c = 0; c < 3; ++c) {
      sample.values(3 * k + c, 0) = 0.5F;                   // one coefficient per channel
      sample.values(3 * k + c, 1) = k < 8 ? 0.25F : 0.75F;  // two
    }
  }
  EXPECT_GT(measure_light_haar(sample, {4, 4}, 6).psnr_db, 99.0);
  EXPECT_EQ(measure_light_haar(sample, {4, 4}, 6).bytes_per_pixel, 18.0);
  // Three numbers: the means, and 0.25 is missing everywhere in half of the pixels.
  EXPECT_NEAR(measure_light_haar(sample, {4, 4}, 3).psnr_db, -10.0 * std::log10(0.5 * 0.0625),
              0.01);
  // One column: the two values are the pair of the last step again.
  EXPECT_GT(measure_light_haar(sample, {16, 1}, 6).psnr_db, 99.0);
}

TEST(ParameterChoice, OneThreeOrFewLightsGiveAFit) {
  for (const int n : {1, 2, 3, 5}) {
    const auto lights = spiral_lights(n, 0.5);
    const auto rows = image_rows(pictures_in(ReflectanceBasis::hsh, 4, 0.05, lights));
    const LightSample sample = sample_lights(*rows);
    for (const FormScore& score : score_forms(all_values<FitForm>(), lights, sample, {})) {
      const FitResult result =
          fit_far(*rows, make_far_fit(score.form, score.interpolation, lights, sample, {}));
      // Under its own lights the picture is there, whatever lies between.
      EXPECT_GT(measure_fit(result.model, *rows, lights).mean_psnr_db(), 24.0)
          << to_string(score.form) << " of " << n;
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
