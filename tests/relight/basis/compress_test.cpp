// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/compress.h"

#include <algorithm>
#include <atomic>
#include <barrier>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/haar.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/work_folder.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

class Compress : public testing::Test {
 protected:
  [[nodiscard]] std::filesystem::path file(const std::string& name) const {
    return folder_.path() / name;
  }
  /// Nothing may be left when a command fails.
  [[nodiscard]] bool is_folder_empty() const {
    return std::filesystem::is_empty(folder_.path());
  }

  test::TemporaryFolder folder_;
};

float value_at(const MemoryStack& stack, int y, int x, int k) {
  const StackDims dims = stack.dims();
  const std::size_t pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(dims.width) +
                            static_cast<std::size_t>(x);
  return stack
      .values()[pixel * static_cast<std::size_t>(dims.n_lights) + static_cast<std::size_t>(k)];
}

/// ||decoded - truth|| / ||truth||, worst pixel and worst value, measured from outside.
StackError measure_error(const BasisFile& basis, const MemoryStack& truth) {
  const MemoryStack decoded = read_all(BasisSource(basis));
  const auto n_lights = static_cast<std::size_t>(truth.dims().n_lights);
  const std::size_t n_rows = truth.values().size() / n_lights;
  double energy = 0.0;
  double error = 0.0;
  double peak = 0.0;
  double worst = 0.0;
  for (std::size_t i = 0; i < truth.values().size(); ++i) {
    const double t = truth.values()[i];
    const double rest = double{decoded.values()[i]} - t;
    energy += t * t;
    error += rest * rest;
    peak = std::max(peak, std::abs(t));
    worst = std::max(worst, std::abs(rest));
  }
  StackError found{std::sqrt(error / energy), 0.0, worst / peak};
  const double floor = basis.header().dark_norm;
  EXPECT_NEAR(floor, 0.01 * std::sqrt(energy / double(n_rows)), 1e-6 * floor);
  for (std::size_t row = 0; row < n_rows; ++row) {
    double row_energy = 0.0;
    double row_error = 0.0;
    for (std::size_t k = 0; k < n_lights; ++k) {
      const double t = truth.values()[row * n_lights + k];
      const double rest = double{decoded.values()[row * n_lights + k]} - t;
      row_energy += t * t;
      row_error += rest * rest;
    }
    found.worst_pixel = std::max(found.worst_pixel,
                                 std::sqrt(row_error) / std::max(std::sqrt(row_energy), floor));
  }
  return found;
}

TEST_F(Compress, AchievesTheRequestedErrorAndSaysWhatItAchieved) {
  const MemoryStack stack = make_stack({});
  const MemoryStack plate = make_stack({.has_sphere = false});
  for (const StackSource* with :
       {static_cast<const StackSource*>(nullptr), static_cast<const StackSource*>(&plate)}) {
    for (const double requested : {0.05, 1e-3, 1e-5}) {
      const auto path = file("a.hlb");
      const CompressSummary summary =
          compress_stack(made_source(stack, 16, with), path, {.relative_l2 = requested});
      EXPECT_LE(summary.header.achieved.relative_l2, requested);
      EXPECT_GE(summary.header.achieved.relative_l2, 0.9 * requested) << "not wasteful";
      const BasisFile basis = BasisFile::open(path);
      const StackError found = measure_error(basis, stack);
      EXPECT_NEAR(found.relative_l2, summary.header.achieved.relative_l2, 2e-7);
      EXPECT_NEAR(found.worst_pixel, summary.header.achieved.worst_pixel, 1e-5);
      EXPECT_NEAR(found.worst_value, summary.header.achieved.worst_value, 1e-6);
      EXPECT_EQ(summary.bytes, std::filesystem::file_size(path));
    }
  }
}

TEST_F(Compress, PlateSavesCoefficients) {
  const MemoryStack stack = make_stack({});
  const MemoryStack plate = make_stack({.has_sphere = false});
  const auto without = compress_stack(made_source(stack, 16), file("a.hlb"), {});
  const auto with = compress_stack(made_source(stack, 16, &plate), file("b.hlb"), {});
  EXPECT_LT(with.header.mean_coefficients, 0.3 * without.header.mean_coefficients);
  EXPECT_LT(with.bytes, without.bytes);
}

TEST_F(Compress, BoundsEachPixelsOwnError) {
  MemoryStack stack = make_stack({});
  for (int k = 0; k < 256; ++k) {
    stack.at(0, 5, 7, k) *= 0.02F;  // a dark pixel, which a global threshold would erase
  }
  const auto loose = compress_stack(made_source(stack, 16), file("a.hlb"), {});
  const auto bound = compress_stack(made_source(stack, 16), file("b.hlb"),
                                    {.relative_l2 = 0.01, .worst_pixel = 0.03});
  EXPECT_GT(loose.header.achieved.worst_pixel, 0.1);
  EXPECT_LE(bound.header.achieved.worst_pixel, 0.03);
  EXPECT_LE(measure_error(BasisFile::open(file("b.hlb")), stack).worst_pixel, 0.03 + 1e-6);
}

TEST_F(Compress, ErrorZeroIsExactBitForBit) {
  MemoryStack stack = make_stack({.width = 34, .height = 9, .channels = 3, .noise = 0.01});
  stack.at(0, 0, 0, 0) = -0.0F;
  stack.at(1, 3, 4, 5) = std::numeric_limits<float>::denorm_min();
  stack.at(2, 8, 8, 8) = -std::numeric_limits<float>::max() / 2e9F;
  const auto summary =
      compress_stack(made_source(stack, 16), file("a.hlb"), {.relative_l2 = 0.0});
  EXPECT_EQ(summary.header.coding, BasisCoding::lossless);
  EXPECT_EQ(summary.header.achieved.relative_l2, 0.0);
  const MemoryStack decoded = read_all(BasisSource(BasisFile::open(file("a.hlb"))));
  EXPECT_EQ(
      std::memcmp(decoded.values().data(), stack.values().data(), stack.values().size_bytes()),
      0);
}

TEST_F(Compress, ErrorBelowFloatsRoundingBecomesExact) {
  const MemoryStack stack = make_stack({.width = 33, .height = 9, .grid = 8});
  const auto summary =
      compress_stack(made_source(stack, 8), file("a.hlb"), {.relative_l2 = 1e-17});
  EXPECT_TRUE(summary.is_achieved());
  EXPECT_EQ(measure_error(BasisFile::open(file("a.hlb")), stack).relative_l2, 0.0);
}

TEST_F(Compress, ValuesOfAnyScaleMakeAFileThatOpens) {
  const MemoryStack& made = make_stack({.width = 33, .height = 9, .grid = 8});
  for (const double scale : {1e-40, 1e-36, 1e-30, 1e-20, 1e20, 1e30}) {
    std::vector<float> values(made.values().begin(), made.values().end());
    for (float& v : values) {
      v = static_cast<float>(v * scale);
    }
    const MemoryStack stack(made.dims(), std::move(values));
    const auto summary = compress_stack(made_source(stack, 8), file("a.hlb"), {});
    EXPECT_EQ(summary.header.coding, BasisCoding::quantised) << scale;
    const MemoryStack decoded = read_all(BasisSource(BasisFile::open(file("a.hlb"))));
    double energy = 0.0;
    double error = 0.0;
    for (std::size_t i = 0; i < stack.values().size(); ++i) {
      const double t = stack.values()[i];
      energy += t * t;
      error += std::pow(double{decoded.values()[i]} - t, 2);
    }
    // Readers' floats: 2^-24 of a value, or half of the smallest float, 7e-6 of 1e-40.
    EXPECT_LE(std::sqrt(error / energy), 0.01 + 1e-5) << scale;
    std::filesystem::remove(file("a.hlb"));
  }
}

TEST_F(Compress, DirectBasisTakesLightsWithoutAGrid) {
  const MemoryStack full = make_stack({.width = 20, .height = 20, .grid = 8});
  MemoryStack stack({20, 20, 1, 47});
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 20; ++x) {
      for (int k = 0; k < 47; ++k) {
        stack.at(0, y, x, k) = value_at(full, y, x, k);
      }
    }
  }
  try {
    (void)compress_stack(made_source(stack, 0), file("a.hlb"), {});
    FAIL() << "a Haar basis without a grid";
  } catch (const Error& error) {
    EXPECT_THAT(error.hint(), testing::HasSubstr("--basis direct"));
  }
  EXPECT_TRUE(is_folder_empty());
  const auto summary =
      compress_stack(made_source(stack, 0), file("a.hlb"), {.basis = BasisKind::direct});
  EXPECT_TRUE(summary.is_achieved());
  EXPECT_LE(measure_error(BasisFile::open(file("a.hlb")), stack).relative_l2, 0.01);
}

// A rectangle of lights: as many coefficients as lights, most of them small.
TEST_F(Compress, GridsOfAnySidesAreWavelets) {
  const MemoryStack stack = make_stack({.width = 16, .height = 12, .grid = 30, .rows = 17});
  const HaarGrid grid{17, 30};
  const auto haar = compress_stack(made_source(stack, grid), file("haar.hlb"), {});
  const auto direct =
      compress_stack(made_source(stack, 0), file("direct.hlb"), {.basis = BasisKind::direct});
  EXPECT_TRUE(haar.is_achieved());
  // 2.35 times as few; 32 x 32 lights of this scene, plain Haar: 2.26.
  EXPECT_LT(2.3 * haar.header.mean_coefficients, direct.header.mean_coefficients);
  const BasisFile basis = BasisFile::open(file("haar.hlb"));
  EXPECT_EQ(basis.header().grid, grid);
  EXPECT_LE(measure_error(basis, stack).relative_l2, 0.01 + 1e-6);
  for (const RelightOptions& options : {RelightOptions{}, RelightOptions{.terms = 60}}) {
    LightWeights w(17 * 30, 1);
    for (Eigen::Index k = 0; k < w.rows(); ++k) {
      w(k, 0) = uniform_unit(hash_key(3, static_cast<std::uint64_t>(k)));
    }
    const RelitPicture relit = relight(basis, w, options);
    const Image<float> truth = relight_stack(stack, w);
    EXPECT_LE(compare(relit.picture.pixels(), truth.pixels()).relative_l2,
              relit.bound.relative_l2 * (1.0 + 1e-6));
  }
}

/// Coefficients per pixel that a threshold keeps for a relative error of 2 %.
double kept_for_two_percent(std::vector<double> coefficients, double energy, double n_pixels) {
  std::sort(coefficients.begin(), coefficients.end(),
            [](double a, double b) { return std::abs(a) < std::abs(b); });
  double dropped = 0.0;
  std::size_t n = 0;
  while (dropped + coefficients[n] * coefficients[n] <= 4e-4 * energy) {
    dropped += coefficients[n] * coefficients[n];
    ++n;
  }
  return static_cast<double>(coefficients.size() - n) / n_pixels;
}

// docs/numerics/haar.md: 84 of 510 on this scene at 120 x 100 pixels; padded 124, lights 491.
TEST(UnbalancedHaarGain, FewerCoefficientsThanPaddingWithZeros) {
  const MemoryStack stack = make_stack({.width = 16, .height = 12, .grid = 30, .rows = 17});
  const std::vector<double> lights(stack.values().begin(), stack.values().end());
  constexpr std::size_t kLights = std::size_t{17} * 30;
  constexpr std::size_t kPadded = std::size_t{32} * 32;
  const std::size_t n_pixels = lights.size() / kLights;
  std::vector<double> padded(n_pixels * kPadded, 0.0);
  double energy = 0.0;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const std::size_t k = i % kLights;
    padded[i / kLights * kPadded + k / 30 * 32 + k % 30] = lights[i];
    energy += lights[i] * lights[i];
  }
  std::vector<double> unbalanced = lights;
  haar_forward(std::span(unbalanced), HaarGrid{17, 30});
  haar_forward(std::span(padded), HaarGrid{32, 32});
  const auto kept = [&](const std::vector<double>& x) {
    return kept_for_two_percent(x, energy, static_cast<double>(n_pixels));
  };
  const double own = kept(unbalanced);
  EXPECT_LT(1.3 * own, kept(padded)) << own;
  EXPECT_LT(5.0 * own, kept(lights)) << own;
}

TEST_F(Compress, PromisesHoldOnGridsOfExtremeSides) {
  for (const HaarGrid grid :
       {HaarGrid{1, 1}, {1, 9}, {9, 1}, {2, 3}, {3, 3}, {31, 33}, {1024, 1}}) {
    const MemoryStack stack = make_stack(
        {.width = 5, .height = 4, .grid = grid.cols, .noise = 0.02, .rows = grid.rows});
    const std::string name = std::to_string(grid.rows) + "x" + std::to_string(grid.cols);
    const auto summary = compress_stack(made_source(stack, grid), file(name + ".hlb"),
                                        {.relative_l2 = 0.03, .worst_pixel = 0.05});
    EXPECT_TRUE(summary.is_achieved()) << name;
    const BasisFile basis = BasisFile::open(file(name + ".hlb"));
    EXPECT_EQ(basis.header().grid, grid);
    EXPECT_EQ(basis.header().basis, BasisKind::haar);
    const StackError error = measure_error(basis, stack);
    EXPECT_LE(error.relative_l2, 0.03 + 1e-6) << name;
    EXPECT_LE(error.worst_pixel, 0.05 + 1e-6) << name;
    (void)compress_stack(made_source(stack, grid), file(name + "-all.hlb"),
                         {.relative_l2 = 0.0});
    const MemoryStack all = read_all(BasisSource(BasisFile::open(file(name + "-all.hlb"))));
    EXPECT_TRUE(std::equal(all.values().begin(), all.values().end(), stack.values().begin(),
                           stack.values().end()))
        << name;
  }
}

TEST_F(Compress, RefusesNanByLightAndPixel) {
  MemoryStack stack = make_stack({});
  stack.at(0, 33, 35, 200) = std::numeric_limits<float>::quiet_NaN();
  try {
    (void)compress_stack(made_source(stack, 16), file("a.hlb"), {});
    FAIL() << "NaN was taken";
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), testing::HasSubstr("light 200 at pixel (35, 33)"));
  }
  EXPECT_TRUE(is_folder_empty());
}

TEST_F(Compress, PlateWithZerosIsNoTrouble) {
  const MemoryStack stack = make_stack({});
  MemoryStack plate = make_stack({.has_sphere = false});
  for (int k = 0; k < 256; ++k) {
    plate.at(0, 4, 4, k) = 0.0F;  // a pixel that does not see the plane
    plate.at(0, 9, k % 40, k) = 0.0F;
  }
  const auto summary = compress_stack(made_source(stack, 16, &plate), file("a.hlb"), {});
  EXPECT_LE(measure_error(BasisFile::open(file("a.hlb")), stack).relative_l2, 0.01);
  EXPECT_EQ(summary.header.plate, PlateOrigin::captured);
  const MemoryStack black({40, 36, 1, 256});
  const auto none = compress_stack(made_source(stack, 16, &black), file("b.hlb"), {});
  EXPECT_EQ(none.header.plate_rank, 0);
  EXPECT_TRUE(none.is_achieved());
}

TEST_F(Compress, SameBytesWhateverThreadsAndMemory) {
  // One tile: 1024 pixels, 64 lights, 39 bytes per value.
  constexpr std::uint64_t kOneTile = std::uint64_t{1024} * 64 * 39;
  const MemoryStack stack = make_stack({.width = 40, .height = 34, .grid = 8, .noise = 0.01});
  const MemoryStack plate =
      make_stack({.width = 40, .height = 34, .grid = 8, .has_sphere = false});
  std::string first;
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    for (const std::uint64_t memory : {kOneTile + 1000, std::uint64_t{1} << 30U}) {
      (void)compress_stack(made_source(stack, 8, &plate), file("a.hlb"),
                           {.worst_pixel = 0.1, .memory_bytes = memory});
      const std::string bytes = read_file(file("a.hlb"));
      if (first.empty()) {
        first = bytes;
      }
      EXPECT_EQ(bytes, first) << threads << " threads, " << memory << " bytes";
    }
  }
}

TEST_F(Compress, RefusesAPlateOfAnotherShapeAndTooLittleMemory) {
  const MemoryStack stack = make_stack({});
  const MemoryStack plate({40, 35, 1, 256});
  EXPECT_THROW((void)compress_stack(made_source(stack, 16, &plate), file("a.hlb"), {}), Error);
  EXPECT_THROW(
      (void)compress_stack(made_source(stack, 16), file("a.hlb"), {.memory_bytes = 1000}),
      Error);
  EXPECT_TRUE(is_folder_empty());
}

TEST_F(Compress, LightImageIsTheStacksWithinTheStatedError) {
  const MemoryStack stack = make_stack({});
  const auto summary = compress_stack(made_source(stack, 16), file("a.hlb"), {});
  const BasisFile basis = BasisFile::open(file("a.hlb"));
  for (const int k : {0, 77, 255}) {
    const Image<float> image = relight_stack(BasisSource(basis), Eigen::VectorXd::Unit(256, k));
    double energy = 0.0;
    double error = 0.0;
    for (int y = 0; y < 36; ++y) {
      for (int x = 0; x < 40; ++x) {
        const double t = value_at(stack, y, x, k);
        energy += t * t;
        error += (double{image(y, x)} - t) * (double{image(y, x)} - t);
      }
    }
    EXPECT_LE(std::sqrt(error / energy), summary.worst_light + 1e-6);
  }
}

/// A stack whose medium fails once after some tiles.
class FailingStack final : public StackSource {
 public:
  FailingStack(const MemoryStack& stack, int n_good) : stack_(stack), n_left_(n_good) {}
  [[nodiscard]] StackDims dims() const override { return stack_.dims(); }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    if (n_left_-- <= 0) {
      throw Error("the disk is full", "made", "make room", ExitCode::io);
    }
    stack_.read_tile(rect, out);
  }

 private:
  const MemoryStack& stack_;
  mutable std::atomic<int> n_left_;
};

/// Five rows of two tiles.
const MemoryStack& tall_stack() { return make_stack({.width = 40, .height = 150, .grid = 8}); }
constexpr int kTilesSampled = 10;
/// 39 bytes per value: one tile after the other.
CompressOptions one_by_one(double error = 0.01) {
  CompressOptions options;
  options.relative_l2 = error;
  options.memory_bytes = std::uint64_t{1024} * 64 * 39;
  return options;
}

CompressSource keyed(const StackSource& stack) {
  CompressSource source = made_source(tall_stack(), 8);
  source.stack = &stack;
  source.key = "tall";
  return source;
}

TEST_F(Compress, GoesOnWithWhatAnEarlierRunHasCoded) {
  (void)compress_stack(keyed(tall_stack()), file("whole.hlb"), {});
  const std::string whole = read_file(file("whole.hlb"));
  for (const int n_good : {0, 3, kTilesSampled, kTilesSampled + 5, kTilesSampled + 9}) {
    const FailingStack broken(tall_stack(), n_good);
    EXPECT_THROW((void)compress_stack(keyed(broken), file("a.hlb"), one_by_one()), Error);
    EXPECT_FALSE(std::filesystem::exists(file("a.hlb")));
    const CompressSummary rest = compress_stack(keyed(tall_stack()), file("a.hlb"), {});
    EXPECT_EQ(rest.n_rows_found, std::max(0, n_good - kTilesSampled) / 2) << n_good;
    EXPECT_EQ(read_file(file("a.hlb")), whole) << n_good;
    EXPECT_FALSE(std::filesystem::exists(file("a.hlb.part")));
    std::filesystem::remove(file("a.hlb"));
  }
}

TEST_F(Compress, PiecesOfOtherSettingsOrDamagedOnesAreMadeAgain) {
  (void)compress_stack(keyed(tall_stack()), file("whole.hlb"), {});
  const std::string whole = read_file(file("whole.hlb"));
  const auto stop_half_way = [this](double error) {
    const FailingStack broken(tall_stack(), kTilesSampled + 9);
    EXPECT_THROW((void)compress_stack(keyed(broken), file("a.hlb"), one_by_one(error)), Error);
  };
  stop_half_way(0.02);
  EXPECT_EQ(compress_stack(keyed(tall_stack()), file("a.hlb"), {}).n_rows_found, 0);
  EXPECT_EQ(read_file(file("a.hlb")), whole);
  stop_half_way(0.01);
  int n_damaged = 0;
  for (const auto& entry : std::filesystem::directory_iterator(file("a.hlb.part"))) {
    if (entry.path().filename() == "blocks-00001" || entry.path().filename() == "sums-00002") {
      std::fstream piece(entry.path(), std::ios::in | std::ios::out | std::ios::binary);
      piece.seekp(60);
      piece.put('x');
      ++n_damaged;
    }
  }
  EXPECT_EQ(n_damaged, 2);
  EXPECT_EQ(compress_stack(keyed(tall_stack()), file("a.hlb"), {}).n_rows_found, 2);
  EXPECT_EQ(read_file(file("a.hlb")), whole);
}

TEST_F(Compress, WithoutAKeyNothingIsKept) {
  const FailingStack broken(tall_stack(), kTilesSampled + 9);
  CompressSource source = keyed(broken);
  source.key.clear();
  EXPECT_THROW((void)compress_stack(source, file("a.hlb"), {}), Error);
  EXPECT_TRUE(is_folder_empty());
}

TEST_F(Compress, TwoProcessesDoNotWriteTheSameFile) {
  WorkFolder work(file("a.hlb.part"), "other");
  work.own();
  try {
    (void)compress_stack(keyed(tall_stack()), file("a.hlb"), {});
    FAIL() << "the folder is another's";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::interrupted);
  }
  EXPECT_TRUE(std::filesystem::exists(file("a.hlb.part"))) << "another's work was deleted";
}

TEST_F(Compress, SeveralRanksWriteTheBytesOfOne) {
  (void)compress_stack(keyed(tall_stack()), file("whole.hlb"), {});
  const std::string whole = read_file(file("whole.hlb"));
  for (const int n : {2, 3, 7}) {
    std::barrier gate(n);
    std::vector<std::thread> ranks;
    std::vector<CompressSummary> summaries(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      ranks.emplace_back([&, i] {
        CompressOptions options;
        options.rank = {i, n, [&gate] { gate.arrive_and_wait(); }};
        summaries[static_cast<std::size_t>(i)] =
            compress_stack(keyed(tall_stack()), file("a.hlb"), options);
      });
    }
    for (std::thread& rank : ranks) {
      rank.join();
    }
    EXPECT_EQ(read_file(file("a.hlb")), whole) << n << " ranks";
    for (const CompressSummary& summary : summaries) {
      EXPECT_EQ(summary.bytes, whole.size());
      EXPECT_EQ(summary.header.achieved.relative_l2,
                summaries.front().header.achieved.relative_l2);
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
