// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/integer_coding.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/coder/block_codec.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/prepared_basis.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::MadeScene;
using test::TemporaryFolder;

std::vector<std::int32_t> normal_numbers(std::size_t n, double sigma) {
  std::vector<std::int32_t> numbers(n);
  for (std::size_t i = 0; i < n; ++i) {
    numbers[i] =
        static_cast<std::int32_t>(std::lround(sigma * standard_normal(hash_key(5, i))));
  }
  return numbers;
}

TEST(IntegerBlock, GivesEveryNumberBack) {
  for (const std::size_t n_pixels : {std::size_t{1}, std::size_t{7}, std::size_t{1024}}) {
    for (const double sigma : {0.0, 0.3, 4.0, 60.0, 3e4, 1e7}) {
      const std::vector<std::int32_t> numbers = normal_numbers(3 * n_pixels, sigma);
      const std::vector<std::byte> bytes = encode_integers(numbers, n_pixels);
      EXPECT_EQ(decode_integers(bytes, 3, n_pixels, "test"), numbers) << sigma;
    }
  }
  const std::vector<std::int32_t> extremes = {
      std::numeric_limits<std::int32_t>::min(), -1, 0, 1,
      std::numeric_limits<std::int32_t>::max(), 5};
  EXPECT_EQ(decode_integers(encode_integers(extremes, 3), 2, 3, "test"), extremes);
}

TEST(IntegerBlock, TakesHardlyMoreThanTheEntropyOfNoise) {
  for (const double sigma : {3.0, 8.0, 20.0, 55.0, 300.0}) {
    const std::vector<std::int32_t> numbers = normal_numbers(std::size_t{1} << 18U, sigma);
    const double bits = 8.0 * static_cast<double>(encode_integers(numbers, 1024).size()) /
                        static_cast<double>(numbers.size());
    const double entropy = std::log2(sigma * std::sqrt(2.0 * 3.14159265358979 * std::exp(1.0)));
    // Rows whose low bits differ in number share one Huffman table: up to 0.2 bits.
    EXPECT_LT(bits, entropy + 0.22) << sigma;
  }
}

TEST(IntegerBlock, RefusesDamage) {
  const std::vector<std::int32_t> numbers = normal_numbers(512, 60.0);
  std::vector<std::byte> bytes = encode_integers(numbers, 64);
  for (std::size_t n = 1; n < bytes.size(); n += 7) {
    EXPECT_THROW((void)decode_integers(std::span(bytes).first(n), 8, 64, "test"), Error) << n;
  }
  bytes[0] = std::byte{200};
  EXPECT_THROW((void)decode_integers(bytes, 8, 64, "test"), Error);
}

/// A made stack in whole units, units of its own for each light.
MemoryStack whole_stack(const MadeScene& scene, const std::vector<double>& units) {
  MemoryStack stack = test::make_stack(scene);
  const StackDims dims = stack.dims();
  for (int c = 0; c < dims.channels; ++c) {
    for (int y = 0; y < dims.height; ++y) {
      for (int x = 0; x < dims.width; ++x) {
        for (int k = 0; k < dims.n_lights; ++k) {
          const double unit = units[static_cast<std::size_t>(k)];
          float& value = stack.at(c, y, x, k);
          value = static_cast<float>(std::round(double{value} / unit) * unit);
        }
      }
    }
  }
  return stack;
}

std::vector<double> made_units(int n) {
  std::vector<double> units;
  for (int k = 0; k < n; ++k) {
    units.push_back((1.0 + 0.01 * (k % 7)) / 6000.0);
  }
  return units;
}

CompressSummary compress_whole(const CompressSource& source, const std::filesystem::path& file,
                               BasisKind basis = BasisKind::haar) {
  CompressOptions options;
  options.is_integer = true;
  options.basis = basis;
  return compress_stack(source, file, options);
}

TEST(IntegerCoding, WholeStepsComeBackToTheBit) {
  struct Case {
    MadeScene scene;
    HaarGrid grid;
    bool has_plate;
  };
  for (const Case& c :
       {Case{{.noise = 0.02}, {16, 16}, true},
        Case{{.grid = 8, .channels = 3, .noise = 0.02}, {8, 8}, true},
        Case{{.width = 33, .height = 35, .grid = 8, .noise = 0.5}, {4, 4}, false},
        Case{{.grid = 9, .noise = 0.02, .rows = 5}, {5, 9}, true},
        Case{{.grid = 1, .noise = 0.02, .rows = 70}, {70, 1}, false},
        Case{{.grid = 8, .noise = 0.02}, {}, true}}) {
    const TemporaryFolder folder;
    const int n_lights = c.scene.n_lights();
    const std::vector<double> units = made_units(n_lights);
    const MemoryStack stack = whole_stack(c.scene, units);
    MadeScene empty = c.scene;
    empty.has_sphere = false;
    empty.noise = 0.0;
    empty.channels = 1;
    const MemoryStack& plate = test::make_stack(empty);
    CompressSource source = test::made_source(stack, c.grid, c.has_plate ? &plate : nullptr);
    source.units = units;
    const auto file = folder.path() / "whole.hlb";
    const CompressSummary summary =
        compress_whole(source, file, c.grid.size() == 0 ? BasisKind::direct : BasisKind::haar);
    EXPECT_TRUE(summary.is_achieved());
    EXPECT_EQ(summary.header.achieved.worst_value, 0.0);
    const BasisFile basis = BasisFile::open(file);
    EXPECT_EQ(basis.header().coding, BasisCoding::integers);
    const MemoryStack decoded = read_all(BasisSource(basis));
    EXPECT_TRUE(std::equal(decoded.values().begin(), decoded.values().end(),
                           stack.values().begin(), stack.values().end()));
    // The same picture from the file, and unpacked.
    LightWeights w = LightWeights::Zero(n_lights, 1);
    w(5, 0) = 1.0;
    w(n_lights / 2, 0) = 0.25;
    const Image<float> truth = relight_stack(stack, w);
    EXPECT_LE(compare(relight(basis, w).picture.pixels(), truth.pixels()).worst_pixel, 1e-7);
    const PreparedBasis prepared(basis);
    const RelitPicture fast = prepared.relight(std::span(&w, 1)).front();
    const Achieved found = compare(fast.picture.pixels(), truth.pixels());
    EXPECT_LE(found.relative_l2, fast.bound.relative_l2);
    EXPECT_LE(found.relative_l2, 1e-3);
  }
}

TEST(IntegerCoding, ValuesBetweenStepsAreRoundedAndThatIsTold) {
  const TemporaryFolder folder;
  const MemoryStack& stack = test::make_stack({.noise = 0.02});
  CompressSource source = test::made_source(stack, 16);
  source.units.assign(256, 1.0 / 4096.0);
  const CompressSummary summary = compress_whole(source, folder.path() / "a.hlb");
  const MemoryStack decoded = read_all(BasisSource(BasisFile::open(folder.path() / "a.hlb")));
  const Achieved found = compare(decoded.values(), stack.values());
  EXPECT_NEAR(summary.header.achieved.relative_l2, found.relative_l2, 1e-7);
  EXPECT_GT(found.relative_l2, 0.0);
  EXPECT_LE(found.worst_pixel * summary.header.peak, 0.5 / 4096.0 * (1.0 + 1e-4));
}

TEST(IntegerCoding, BlackAndOneLightAreStacksToo) {
  const TemporaryFolder folder;
  const MemoryStack black({40, 36, 1, 16}, std::vector<float>(std::size_t{40} * 36 * 16));
  CompressSource source = test::made_source(black, 4);
  source.units.assign(16, 0.001);
  (void)compress_whole(source, folder.path() / "black.hlb");
  const MemoryStack decoded =
      read_all(BasisSource(BasisFile::open(folder.path() / "black.hlb")));
  EXPECT_THAT(decoded.values(), testing::Each(0.0F));
  const MemoryStack one({5, 3, 1, 1}, std::vector<float>(15, -0.25F));
  source = test::made_source(one, 1);
  source.units.assign(1, 0.25);
  (void)compress_whole(source, folder.path() / "one.hlb");
  EXPECT_THAT(read_all(BasisSource(BasisFile::open(folder.path() / "one.hlb"))).values(),
              testing::Each(-0.25F));
}

TEST(IntegerCoding, RefusesWhatHasNoSteps) {
  const TemporaryFolder folder;
  MemoryStack stack = test::make_stack({});
  CompressSource source = test::made_source(stack, 16);
  try {
    (void)compress_whole(source, folder.path() / "a.hlb");
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.hint(), testing::HasSubstr("--max-error 0"));
  }
  source.units.assign(256, 1e-9);
  try {
    (void)compress_whole(source, folder.path() / "a.hlb");
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), testing::HasSubstr("at pixel ("));
  }
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "a.hlb"));
}

}  // namespace
}  // namespace haarlight::relight
