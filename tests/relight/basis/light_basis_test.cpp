// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/light_basis.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>
#include <numbers>
#include <set>
#include <vector>

#include <Eigen/Core>
#include <gtest/gtest.h>

#include "core/count.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

template <class T>
std::vector<T> noise(int n, std::uint64_t seed) {
  std::vector<T> values(count(n));
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = static_cast<T>(uniform_unit(hash_key(seed, i)) - 0.5);
  }
  return values;
}

using BasisPtr = std::shared_ptr<const FixedBasis>;

/// Every basis that a file can have, over `n_faces` grids.
std::vector<BasisPtr> bases_of(const HaarGrid& grid, int n_faces) {
  std::vector<BasisPtr> all;
  for (const KnownBasis& known : known_bases()) {
    if (known.kind && missing_grid(known.need, grid).empty()) {
      all.push_back(make_basis(*known.kind, grid, grid.size() * n_faces));
    }
  }
  return all;
}

const std::vector<std::pair<HaarGrid, int>> kGrids = {{{8, 8}, 2}, {{32, 32}, 1}, {{5, 7}, 3},
                                                      {{1, 1}, 1}, {{1, 6}, 1},   {{4, 16}, 2}};

template <class T>
void expect_back(double tolerance) {
  for (const auto& [grid, n_faces] : kGrids) {
    for (const BasisPtr& basis : bases_of(grid, n_faces)) {
      const std::vector<T> lights = noise<T>(3 * basis->n_lights(), 5);
      std::vector<T> rows = lights;
      basis->forward(std::span(rows));
      double energy = 0.0;
      for (std::size_t i = 0; i < rows.size(); ++i) {
        energy += double{rows[i]} * double{rows[i]} - double{lights[i]} * double{lights[i]};
      }
      EXPECT_NEAR(energy, 0.0, tolerance * double(rows.size()));
      basis->inverse(std::span(rows));
      for (std::size_t i = 0; i < rows.size(); ++i) {
        EXPECT_NEAR(rows[i], lights[i], tolerance);
      }
    }
  }
}

TEST(LightBasis, AllCoefficientsGiveTheLightsBackAndKeepTheEnergy) {
  // Haar: 4 log2(32) = 20 roundings of sums of at most 32; DCT: 64 terms, in doubles.
  expect_back<float>(4e-6);
  expect_back<double>(1e-14);
}

TEST(LightBasis, TheInverseIsTheTransposeSoThatWeightsTransformAsLightsDo) {
  // w . t = (H w) . (H t): what relighting in coefficients rests on.
  for (const auto& [grid, n_faces] : kGrids) {
    for (const BasisPtr& basis : bases_of(grid, n_faces)) {
      std::vector<double> w = noise<double>(basis->n_lights(), 1);
      std::vector<double> t = noise<double>(basis->n_lights(), 2);
      double before = 0.0;
      double after = 0.0;
      for (std::size_t k = 0; k < w.size(); ++k) {
        before += w[k] * t[k];
      }
      basis->forward(std::span(w));
      basis->forward(std::span(t));
      for (std::size_t k = 0; k < w.size(); ++k) {
        after += w[k] * t[k];
      }
      EXPECT_NEAR(after, before, 1e-13);
    }
  }
}

TEST(LightBasis, FloatsAreTheDoublesRounded) {
  for (const auto& [grid, n_faces] : kGrids) {
    for (const BasisPtr& basis : bases_of(grid, n_faces)) {
      const std::vector<float> lights = noise<float>(basis->n_lights(), 9);
      std::vector<float> coefficients(lights.size());
      basis->analyse(lights, coefficients);
      std::vector<double> exact(lights.begin(), lights.end());
      basis->forward(std::span(exact));
      for (std::size_t i = 0; i < exact.size(); ++i) {
        EXPECT_NEAR(coefficients[i], exact[i], 4e-6);  // as above
      }
    }
  }
}

TEST(LightBasis, SomeValuesOfTheInverseAreItsBits) {
  for (const auto& [grid, n_faces] : kGrids) {
    for (const BasisPtr& basis : bases_of(grid, n_faces)) {
      const int n = basis->n_lights();
      const std::vector<double> row = noise<double>(n, 9);
      std::vector<double> all = row;
      basis->inverse(std::span(all));
      for (const std::vector<int>& lights : {std::vector<int>{n - 1}, {n / 2, 0, n / 2}}) {
        std::vector<double> some(lights.size());
        basis->inverse_at(row, lights, some);
        for (std::size_t i = 0; i < lights.size(); ++i) {
          EXPECT_EQ(some[i], all[count(lights[i])]) << n;
        }
      }
    }
  }
}

TEST(LightBasis, OrderNamesEveryPlaceOnceAndGroupsCoverThem) {
  for (const auto& [grid, n_faces] : kGrids) {
    for (const BasisPtr& basis : bases_of(grid, n_faces)) {
      const std::vector<int> order = basis->order();
      EXPECT_EQ(std::set<int>(order.begin(), order.end()).size(), count(basis->n_lights()));
      const std::vector<int> ends = basis->group_ends();
      EXPECT_EQ(std::adjacent_find(ends.begin(), ends.end(), std::greater_equal<>()),
                ends.end());
      EXPECT_EQ(ends.back(), basis->n_lights());
    }
  }
}

TEST(LightBasis, FrequenciesAscendAndGroupsAreTheirLevels) {
  // Over n x n with n = 2^m: Haar's order and groups.
  for (const BasisKind kind : {BasisKind::dct, BasisKind::haar_standard}) {
    const BasisPtr basis = make_basis(kind, {32, 32}, 1024);
    EXPECT_EQ(basis->order(), haar_order({32, 32}));
    EXPECT_EQ(basis->group_ends(), (std::vector<int>{64, 256, 1024}));
  }
  const BasisPtr wide = make_basis(BasisKind::dct, {5, 19}, 190);
  const std::vector<int> order = wide->order();
  const auto bits = [](int i) {
    return std::bit_width(static_cast<unsigned>(std::max(i % 95 / 19, i % 19)));
  };
  for (std::size_t i = 1; i < 95; ++i) {
    EXPECT_GE(bits(order[i]), bits(order[i - 1]));
    EXPECT_EQ(order[i + 95], order[i] + 95);
  }
  EXPECT_EQ(wide->group_ends(), (std::vector<int>{40, 80, 95, 135, 175, 190}));
}

TEST(LightBasis, PatternsAreOrthonormal) {
  for (const BasisPtr& basis : bases_of({8, 8}, 2)) {
    Eigen::MatrixXd patterns(128, 128);
    for (Eigen::Index i = 0; i < 128; ++i) {
      patterns.col(i).setZero();
      patterns(i, i) = 1.0;
      basis->inverse(std::span(patterns.col(i).data(), 128));
    }
    const Eigen::MatrixXd gram = patterns.transpose() * patterns;
    EXPECT_LT((gram - Eigen::MatrixXd::Identity(128, 128)).cwiseAbs().maxCoeff(), 1e-14);
  }
}

TEST(LightBasis, HaarIsTheHaarOfHaarH) {
  std::vector<float> wide = noise<float>(30, 4);  // two faces
  std::vector<float> of_wide(wide.size());
  make_basis(BasisKind::haar, {3, 5}, 30)->analyse(wide, of_wide);
  haar_forward(std::span<float>(wide), HaarGrid{3, 5});
  EXPECT_EQ(of_wide, wide);
}

TEST(LightBasis, StandardHaarIsTheProductOfLines) {
  // Of a product f(row) g(col) the coefficients are products of the lines' own: a ramp's line
  // of four has mean 2 m, one coarse detail, and two equal fine ones.
  std::vector<double> x(16);
  for (std::size_t i = 0; i < 16; ++i) {
    x[i] = double(i % 4) * (i / 4 == 0 ? 1.0 : 0.0);
  }
  make_basis(BasisKind::haar_standard, {4, 4}, 16)->forward(std::span(x));
  const double r = std::numbers::sqrt2;
  const double line[] = {3.0, -2.0, -1.0 / r, -1.0 / r};  // of 0 1 2 3
  const double impulse[] = {0.5, 0.5, 1.0 / r, 0.0};      // of 1 0 0 0
  for (std::size_t y = 0; y < 4; ++y) {
    for (std::size_t k = 0; k < 4; ++k) {
      EXPECT_NEAR(x[4 * y + k], impulse[y] * line[k], 1e-14);
    }
  }
}

TEST(LightBasis, DctIsTheDirectSum) {
  const int rows = 5;
  const int cols = 6;
  const std::vector<double> x = noise<double>(30, 11);
  std::vector<double> c = x;
  make_basis(BasisKind::dct, {rows, cols}, 30)->forward(std::span(c));
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < cols; ++j) {
      double sum = 0.0;
      for (int y = 0; y < rows; ++y) {
        for (int k = 0; k < cols; ++k) {
          sum += x[count(y * cols + k)] * std::cos(std::numbers::pi * (y + 0.5) * i / rows) *
                 std::cos(std::numbers::pi * (k + 0.5) * j / cols);
        }
      }
      sum *= std::sqrt((i == 0 ? 1.0 : 2.0) / rows) * std::sqrt((j == 0 ? 1.0 : 2.0) / cols);
      EXPECT_NEAR(c[count(i * cols + j)], sum, 1e-14);
    }
  }
}

TEST(LightBasis, LightsWithoutTheGridAreTheCallersBug) {
  EXPECT_THROW((void)make_basis(BasisKind::haar, {0, 7}, 7), ContractViolation);
  EXPECT_THROW((void)make_basis(BasisKind::haar, {4, 1025}, 4100), ContractViolation);
  EXPECT_THROW((void)make_basis(BasisKind::haar_standard, {6, 6}, 36), ContractViolation);
  EXPECT_THROW((void)make_basis(BasisKind::dct, {}, 36), ContractViolation);
  EXPECT_THROW((void)make_basis(BasisKind::dct, {4, 4}, 30), ContractViolation);
  std::vector<std::int64_t> whole(36);
  const BasisPtr dct = make_basis(BasisKind::dct, {6, 6}, 36);
  EXPECT_THROW(dct->forward_integers(whole), ContractViolation);
}

TEST(LightBasis, TheTableSaysWhatCompressCanWriteOrWhyNot) {
  std::set<BasisKind> kinds;
  for (const KnownBasis& known : known_bases()) {
    EXPECT_NE(known.kind.has_value(), !known.why_not.empty()) << known.word;
    if (known.kind) {
      EXPECT_EQ(known.word, to_string(*known.kind));
      kinds.insert(*known.kind);
    }
  }
  EXPECT_EQ(kinds.size(), kBasisKindWords.size());
}

/// Some lights of a rectangle are the same as among all, to the last bit.
void expect_the_same_of_some(const StackSource& source, MemoryStack all) {
  const StackDims dims = source.dims();
  const TileRect rect{3, 5, dims.width - 4, dims.height - 6};
  const std::vector<int> lights{dims.n_lights - 1, 7, 0};
  std::vector<float> some(count(dims.channels) * count(rect.n_pixels()) * lights.size());
  source.read_lights(rect, lights, some);
  std::size_t at = 0;
  for (int c = 0; c < dims.channels; ++c) {
    for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
      for (int x = rect.x0; x < rect.x0 + rect.width; ++x) {
        for (const int k : lights) {
          ASSERT_EQ(some[at++], all.at(c, y, x, k)) << c << " " << y << " " << x << " " << k;
        }
      }
    }
  }
}

/// What a file of each kind decodes to is, within what it says, the stack that was compressed,
/// and its pictures are the stack's own sums within their bound.
TEST(LightBasis, FilesOfEveryKindKeepTheirError) {
  const testing::TemporaryFolder folder;
  const auto file = folder / "a.hlb";
  for (const HaarGrid grid : {HaarGrid{8, 8}, {5, 7}}) {
    const test::MadeScene scene{
        .width = 34, .height = 33, .grid = grid.cols, .rows = grid.rows};
    const MemoryStack& stack = test::make_stack(scene);
    test::MadeScene empty = scene;
    empty.has_sphere = false;
    const MemoryStack& plate = test::make_stack(empty);
    for (const KnownBasis& known : known_bases()) {
      if (!known.kind || !missing_grid(known.need, grid).empty()) {
        continue;
      }
      SCOPED_TRACE(::testing::Message()
                   << known.word << " " << grid.rows << " x " << grid.cols);
      const CompressSummary summary =
          compress_stack(test::made_source(stack, grid, &plate), file,
                         {.relative_l2 = 0.01, .basis = *known.kind});
      EXPECT_EQ(summary.header.coding, BasisCoding::quantised);
      const BasisFile basis = BasisFile::open(file);
      EXPECT_EQ(basis.header().basis, *known.kind);
      const MemoryStack found = read_all(BasisSource(basis));
      double error = 0.0;
      double energy = 0.0;
      for (std::size_t i = 0; i < found.values().size(); ++i) {
        const double truth = stack.values()[i];
        error += std::pow(double{found.values()[i]} - truth, 2);
        energy += truth * truth;
      }
      // Decoding rounds to float: 2^-24 of a value.
      EXPECT_NEAR(std::sqrt(error / energy), summary.header.achieved.relative_l2, 1e-6);
      EXPECT_LE(summary.header.achieved.relative_l2, 0.01);
      expect_the_same_of_some(BasisSource(basis), found);
    }
  }
}

TEST(LightBasis, WholeNumbersAreRefusedByTheOptionsName) {
  const testing::TemporaryFolder folder;
  const MemoryStack& stack = test::make_stack({.width = 9, .height = 8, .grid = 4});
  CompressSource source = test::made_source(stack, 4);
  source.units.assign(16, 1.0 / 6000.0);
  for (const BasisKind kind : {BasisKind::dct, BasisKind::haar_standard}) {
    try {
      (void)compress_stack(source, folder / "a.hlb", {.is_integer = true, .basis = kind});
      FAIL() << "a basis without an integer form";
    } catch (const Error& error) {
      const std::string text = error.what();
      EXPECT_NE(text.find("--basis " + std::string(to_string(kind))), std::string::npos)
          << text;
      EXPECT_NE(text.find("--whole-steps"), std::string::npos) << text;
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
