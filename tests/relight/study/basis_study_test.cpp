// SPDX-License-Identifier: Apache-2.0
#include "relight/study/basis_study.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/basis/coder/quantiser.h"
#include "relight/study/array_binning.h"
#include "tests/relight/basis/made_stack.h"

namespace haarlight::relight {
namespace {

using test::MadeScene;
using test::make_stack;

constexpr int kGrid = 16;
const MadeScene kScene{24, 20, kGrid, 1, true, 0.0};
const MadeScene kEmpty{24, 20, kGrid, 1, false, 0.0};

/// The made array: squares 900 mm above the plane.
std::vector<StudyLight> made_study_lights(int grid) {
  std::vector<StudyLight> lights;
  const double pitch = 960.0 / grid;
  for (int k = 0; k < grid * grid; ++k) {
    StudyLight light;
    light.is_position = true;
    const int row = k / grid;
    light.coordinates = {(k % grid - 0.5 * (grid - 1)) * pitch,
                         (row - 0.5 * (grid - 1)) * pitch, 900.0};
    light.emits = -Eigen::Vector3d::UnitZ();
    light.strength = pitch * pitch;
    lights.push_back(light);
  }
  return lights;
}

StudyCapture made_capture(const MemoryStack& stack, const StackSource* plate = nullptr) {
  StudyCapture capture;
  capture.stack = &stack;
  capture.plate = plate;
  capture.grid = {kGrid, kGrid, 1};
  capture.lights = made_study_lights(kGrid);
  capture.lightings = default_lightings(
      light_directions_from(capture.lights, capture.object_centre), capture.grid);
  return capture;
}

const BasisResult& result_of(const BasisStudy& study, const std::string& name, bool has_plate) {
  const auto found = std::find_if(
      study.results.begin(), study.results.end(),
      [&](const BasisResult& r) { return r.name == name && r.has_plate == has_plate; });
  EXPECT_NE(found, study.results.end()) << name;
  return *found;
}

const BasisPoint& point_of(const BasisResult& result, PointKind kind, double requested) {
  const auto found = std::find_if(
      result.points.begin(), result.points.end(),
      [&](const BasisPoint& p) { return p.kind == kind && p.requested == requested; });
  EXPECT_NE(found, result.points.end()) << result.title << " " << requested;
  return *found;
}

/// One study for most tests: every basis, with and without plate.
const BasisStudy& whole_study() {
  static const BasisStudy study = [] {
    const StudyCapture capture = made_capture(make_stack(kScene), &make_stack(kEmpty));
    BasisStudyOptions options;
    options.errors = {0.05, 0.01};
    options.sizes = {8.0, 40.0};
    options.sh_order = 7;
    options.pca_rank = 64;
    return study_bases(capture, options);
  }();
  return study;
}

TEST(BasisStudy, ComparesEveryBasisWithAndWithoutPlate) {
  EXPECT_EQ(whole_study().results.size(), 2 * known_bases().size());
  EXPECT_TRUE(whole_study().left_out.empty());
  EXPECT_EQ(whole_study().n_pixels, 24U * 20U);
  EXPECT_EQ(whole_study().lightings.size(), 5U);
}

TEST(BasisStudy, CompleteBasesAchieveTheRequestedError) {
  for (const BasisResult& result : whole_study().results) {
    for (const double requested : {0.05, 0.01}) {
      if (result.name == "sh" || (result.name == "pca" && result.floor_error > requested)) {
        continue;
      }
      const BasisPoint& point = point_of(result, PointKind::error, requested);
      EXPECT_TRUE(point.is_achieved) << result.title << " " << requested;
      // Few coefficients: one more or less is more than the 1 % that is aimed at.
      EXPECT_LE(point.stack_error[0], 1.01 * requested) << result.title;
      EXPECT_GE(point.stack_error[0], 0.9 * requested) << result.title;
    }
  }
}

TEST(BasisStudy, SpendsTheSizeThatWasGiven) {
  for (const BasisResult& result : whole_study().results) {
    for (const double requested : {8.0, 40.0}) {
      const auto found =
          std::find_if(result.points.begin(), result.points.end(), [&](const BasisPoint& p) {
            return p.kind == PointKind::size && p.requested == requested;
          });
      if (found == result.points.end() || result.n_patterns < requested) {
        continue;
      }
      EXPECT_LE(found->numbers(), 1.005 * requested) << result.title;
      // Where less than that is not 0 anyway, everything is kept.
      const bool has_all = found->stack_error[0] < std::max(1e-3, 1.01 * result.floor_error);
      EXPECT_TRUE(has_all || found->numbers() >= 0.95 * requested)
          << result.title << " " << found->numbers() << " " << found->stack_error[0];
    }
  }
}

TEST(BasisStudy, HarmonicsAreAProjectionWithAFloor) {
  const BasisResult& sh = result_of(whole_study(), "sh", false);
  EXPECT_EQ(sh.n_patterns, 64);
  EXPECT_GT(sh.floor_error, 0.02);  // shadow edges
  const BasisPoint& point = point_of(sh, PointKind::error, 0.01);
  EXPECT_FALSE(point.is_achieved);
  EXPECT_GE(point.stack_error[0], 0.999 * sh.floor_error);
  EXPECT_LE(point.stack_error[0], 1.02 * sh.floor_error);
  EXPECT_LT(point.threshold_numbers, 0.0);
}

TEST(BasisStudy, BareThresholdOfHaarIsThatOfTheSortedCoefficients) {
  // By hand: all Haar coefficients, the smallest dropped while their energy allows it.
  const MemoryStack& stack = make_stack(kScene);
  std::vector<double> squares;
  double total = 0.0;
  std::vector<double> pixel(std::size_t{kGrid} * kGrid);
  for (std::size_t p = 0; p < stack.dims().n_pixels(); ++p) {
    for (std::size_t k = 0; k < pixel.size(); ++k) {
      pixel[k] = double{stack.values()[p * pixel.size() + k]};
    }
    haar_forward(std::span<double>(pixel), HaarGrid{kGrid, kGrid});
    for (const double c : pixel) {
      squares.push_back(c * c);
      total += c * c;
    }
  }
  std::sort(squares.begin(), squares.end());
  double lost = 0.0;
  std::size_t n_dropped = 0;
  while (lost + squares[n_dropped] <= 0.01 * 0.01 * total) {
    lost += squares[n_dropped++];
  }
  const double numbers = double(squares.size() - n_dropped) / double(stack.dims().n_pixels());
  const BasisPoint& point =
      point_of(result_of(whole_study(), "haar", false), PointKind::error, 0.01);
  EXPECT_NEAR(point.threshold_numbers / numbers, 1.0, 0.01);  // a bin is 1/64 octave
}

TEST(BasisStudy, PlateMakesHaarSmaller) {
  const double with =
      point_of(result_of(whole_study(), "haar", true), PointKind::error, 0.01).numbers();
  const double without =
      point_of(result_of(whole_study(), "haar", false), PointKind::error, 0.01).numbers();
  EXPECT_LT(with, 0.5 * without);
}

TEST(BasisStudy, CountsTheTablesOfPca) {
  const BasisPoint& point =
      point_of(result_of(whole_study(), "pca", false), PointKind::error, 0.05);
  EXPECT_GT(point.n_patterns, 0);
  EXPECT_EQ(point.table_bytes, static_cast<std::uint64_t>(point.n_patterns) * 256 * 2);
  EXPECT_DOUBLE_EQ(point.table_numbers, point.n_patterns * 256.0 / 480.0);
  EXPECT_GE(point.bytes, point.table_bytes);
}

TEST(BasisStudy, FloorOfPcaIsTheEnergyOfTheVectorsItHasNot) {
  // Against the eigenvalues themselves: a bright capture whose first vector has nearly all
  // energy, so that rounded vectors' energies would not tell a floor of a thousandth.
  const StudyCapture capture = made_capture(make_stack(kScene));
  BasisStudyOptions options;
  options.bases = {"pca"};
  options.errors = {0.05};
  options.sizes = {};
  options.pca_rank = 40;
  const BasisStudy study = study_bases(capture, options);
  const MemoryStack& stack = make_stack(kScene);
  using RowsOfFloat = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Eigen::MatrixXd rows =
      Eigen::Map<const RowsOfFloat>(stack.values().data(), 480, 256).cast<double>();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(rows.transpose() * rows);
  const double rest = eigen.eigenvalues().head(216).sum();
  EXPECT_NEAR(study.results[0].floor_error / std::sqrt(rest / rows.squaredNorm()), 1.0, 0.01);
}

TEST(BasisStudy, PicturesOfOneLightAreThatLightsOwn) {
  // The lights themselves, thresholded: what one light's picture misses, counted by hand.
  const MemoryStack& stack = make_stack(kScene);
  const BasisPoint& point =
      point_of(result_of(whole_study(), "direct", false), PointKind::size, 40.0);
  const std::size_t light = kGrid * (kGrid * 13 / 32) + kGrid * 19 / 32;
  double lost = 0.0;
  double all = 0.0;
  for (std::size_t p = 0; p < stack.dims().n_pixels(); ++p) {
    const float t = stack.values()[p * kGrid * kGrid + light];
    const auto step = static_cast<float>(point.step);
    const auto kept = static_cast<double>(static_cast<float>(quantise(t, 1.0F / step)) * step);
    lost += (kept - double{t}) * (kept - double{t});
    all += double{t} * double{t};
  }
  EXPECT_NEAR(point.pictures[0].relative_l2[0], std::sqrt(lost / all), 1e-6);
}

TEST(BasisStudy, RegionsAddUpToTheWhole) {
  const BasisStudy& study = whole_study();
  std::uint64_t n = 0;
  for (const std::uint64_t some : study.region_pixels) {
    n += some;
  }
  EXPECT_EQ(n, study.n_pixels);
  EXPECT_GT(study.region_pixels[static_cast<std::size_t>(Region::cast)], 20U);
  EXPECT_GT(study.region_pixels[static_cast<std::size_t>(Region::diffuse)], 20U);
}

TEST(BasisStudy, BinnedArrayOfTheStackIsWhatItsLightsAreOff) {
  const MemoryStack& stack = make_stack(kScene);
  double off = 0.0;
  double all = 0.0;
  for (std::size_t p = 0; p < stack.dims().n_pixels(); ++p) {
    const std::span<const float> row = stack.values().subspan(p * 256, 256);
    off += binned_energy(row, {kGrid, kGrid, 1}, {2, true, 0, 0});
    for (const float v : row) {
      all += double{v} * double{v};
    }
  }
  const auto& binned = whole_study().binned;
  const auto found = std::find_if(binned.begin(), binned.end(), [](const BinningResult& b) {
    return b.is_area && b.side == 2;
  });
  ASSERT_NE(found, binned.end());
  EXPECT_NEAR(found->stack_error[0], std::sqrt(off / all), 1e-9);
}

TEST(BasisStudy, DoesNotDependOnThreads) {
  const StudyCapture capture = made_capture(make_stack(kScene), &make_stack(kEmpty));
  BasisStudyOptions options;
  options.bases = {"haar", "pca", "haar-cdf53"};
  options.errors = {0.02};
  options.sizes = {10.0};
  std::vector<BasisStudy> studies;
  for (const int n : {1, 2, 7}) {
    const ThreadLimit limit(n);
    studies.push_back(study_bases(capture, options));
  }
  for (std::size_t i = 1; i < studies.size(); ++i) {
    for (std::size_t r = 0; r < studies[0].results.size(); ++r) {
      const auto& a = studies[0].results[r].points;
      const auto& b = studies[i].results[r].points;
      ASSERT_EQ(a.size(), b.size());
      for (std::size_t p = 0; p < a.size(); ++p) {
        EXPECT_EQ(a[p].bytes, b[p].bytes);
        EXPECT_EQ(a[p].stack_error[0], b[p].stack_error[0]);
        EXPECT_EQ(a[p].pictures[3].relative_l2[0], b[p].pictures[3].relative_l2[0]);
      }
    }
  }
}

TEST(BasisStudy, WorksTileByTileInLittleMemory) {
  // 8 pixels per side: per pixel 256 lights x 4 bytes x 7 buffers; twice 64 of them.
  const StudyCapture capture = made_capture(make_stack(kScene), &make_stack(kEmpty));
  BasisStudyOptions options;
  options.bases = {"haar", "dct"};
  options.errors = {0.01};
  options.sizes = {};
  options.memory_bytes = 1000000;
  const BasisStudy tiled = study_bases(capture, options);
  EXPECT_EQ(tiled.tile, 8);
  EXPECT_EQ(tiled.n_tiles, 9);
  EXPECT_EQ(tiled.n_pixels, 480U);
  const BasisPoint& whole =
      point_of(result_of(whole_study(), "haar", true), PointKind::error, 0.01);
  const BasisPoint& parts = point_of(result_of(tiled, "haar", true), PointKind::error, 0.01);
  EXPECT_NEAR(parts.coefficients, whole.coefficients, 0.02 * whole.coefficients);
  EXPECT_NEAR(parts.stack_error[0], whole.stack_error[0], 0.02 * whole.stack_error[0]);
  options.memory_bytes = 100000;
  EXPECT_THROW((void)study_bases(capture, options), Error);
}

TEST(BasisStudy, StudiesSomeTilesAndSaysSo) {
  const StudyCapture capture = made_capture(make_stack(kScene));
  BasisStudyOptions options;
  options.bases = {"haar"};
  options.errors = {0.01};
  options.memory_bytes = 1000000;
  options.n_tiles = 2;
  const BasisStudy some = study_bases(capture, options);
  EXPECT_EQ(some.n_tiles_studied, 2);
  EXPECT_LT(some.n_pixels, 480U);
  EXPECT_EQ(some.results.size(), 1U);
  ASSERT_EQ(some.left_out.size(), 1U);  // no plate
}

TEST(BasisStudy, WithoutAGridLeavesOutWhatNeedsOneByName) {
  const MemoryStack& stack = make_stack(kScene);
  StudyCapture capture = made_capture(stack);
  capture.grid = {};
  BasisStudyOptions options;
  options.errors = {0.05};
  options.sizes = {8.0};
  options.sh_order = 3;
  options.pca_rank = 32;
  const BasisStudy study = study_bases(capture, options);
  EXPECT_EQ(study.results.size(), 3U);  // harmonics, PCA, the lights themselves
  EXPECT_EQ(study.left_out.size(), known_bases().size() - 3 + 1);
  EXPECT_EQ(study.left_out.front().title, "Haar");
  EXPECT_EQ(study.left_out.front().reason, "the lights form no grid");
  EXPECT_TRUE(study.binned.empty());
  options.bases = {"haar"};
  EXPECT_THROW((void)study_bases(capture, options), Error);
}

TEST(BasisStudy, HaarTakesGridsOfAnySidesAndStandardHaarSaysWhyNot) {
  const MemoryStack& stack = make_stack({.width = 12, .height = 10, .grid = 7, .rows = 5});
  StudyCapture capture = made_capture(stack);
  capture.grid = {5, 7, 1};
  capture.lights = made_study_lights(7);
  capture.lights.resize(35);  // 5 rows of 7
  capture.lightings = default_lightings(
      light_directions_from(capture.lights, capture.object_centre), capture.grid);
  BasisStudyOptions options;
  options.errors = {0.05};
  options.sizes = {8.0};
  options.bases = {"haar", "haar-haar", "haar-standard", "direct"};
  const BasisStudy study = study_bases(capture, options);
  EXPECT_EQ(study.results.size(), 3U);
  EXPECT_LT(point_of(result_of(study, "haar", false), PointKind::error, 0.05).numbers(),
            point_of(result_of(study, "direct", false), PointKind::error, 0.05).numbers());
  EXPECT_EQ(study.left_out.front().reason,
            "5 x 7 lights: rows and columns must be powers of two");
}

TEST(BasisStudy, TakesOneLight) {
  MemoryStack stack({6, 5, 1, 1});
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 6; ++x) {
      stack.at(0, y, x, 0) = static_cast<float>(1 + x * y);
    }
  }
  StudyCapture capture;
  capture.stack = &stack;
  capture.grid = {1, 1, 1};
  capture.lights.resize(1);
  capture.lightings = default_lightings({Eigen::Vector3d::UnitZ()}, capture.grid);
  BasisStudyOptions options;
  options.errors = {0.05};
  options.sizes = {0.5};
  const BasisStudy study = study_bases(capture, options);
  EXPECT_EQ(study.results.size(), known_bases().size());
  for (const BasisResult& result : study.results) {
    EXPECT_TRUE(point_of(result, PointKind::error, 0.05).is_achieved) << result.title;
  }
}

TEST(BasisStudy, TakesColours) {
  const MadeScene scene{16, 16, kGrid, 3, true, 0.0};
  StudyCapture capture = made_capture(make_stack(scene));
  BasisStudyOptions options;
  options.bases = {"haar"};
  options.errors = {0.02};
  options.sizes = {};
  const BasisStudy study = study_bases(capture, options);
  const MadeScene grey{16, 16, kGrid, 1, true, 0.0};
  const StudyCapture one = made_capture(make_stack(grey));
  const BasisStudy alone = study_bases(one, options);
  // The colours are fractions of one picture: a threshold keeps a little less of the darker
  // ones.
  EXPECT_NEAR(study.results[0].points[0].coefficients, alone.results[0].points[0].coefficients,
              0.15 * alone.results[0].points[0].coefficients);
  EXPECT_EQ(study.n_pixels, 256U);
}

TEST(BasisStudy, RefusesBlackAndBrokenCapturesByName) {
  const MemoryStack black({8, 8, 1, kGrid * kGrid});
  EXPECT_THROW((void)study_bases(made_capture(black), {}), Error);
  MemoryStack broken = make_stack(kScene);
  broken.at(0, 7, 11, 42) = std::numeric_limits<float>::quiet_NaN();
  try {
    (void)study_bases(made_capture(broken), {});
    FAIL() << "a NaN went through";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("light 42 at pixel (11, 7)"), std::string::npos)
        << error.problem();
  }
  const MemoryStack small({8, 8, 1, kGrid * kGrid});
  EXPECT_THROW((void)study_bases(made_capture(make_stack(kScene), &small), {}), Error);
  BasisStudyOptions unknown;
  unknown.bases = {"fourier"};
  EXPECT_THROW((void)study_bases(made_capture(make_stack(kScene)), unknown), Error);
}

}  // namespace
}  // namespace haarlight::relight
