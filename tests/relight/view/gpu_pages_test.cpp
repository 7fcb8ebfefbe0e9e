// SPDX-License-Identifier: Apache-2.0
#include "relight/view/gpu_pages.h"

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <span>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/plate/tile_plate.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/relight/view/retiled.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

std::uint32_t u32(const std::string& bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (unsigned i = 0; i < 4; ++i) {
    value |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes.at(at + i)))
             << (8 * i);
  }
  return value;
}

/// Values of every (picture, tile), digits put together, as a page's user reads them.
using Pages = std::map<std::pair<int, int>, std::vector<double>>;

double value_at(const std::string& bytes, std::size_t at, std::size_t size, bool is_half) {
  if (size == 1) {
    return static_cast<std::int8_t>(bytes[at]);
  }
  const auto bits =
      static_cast<std::uint16_t>(u32(bytes.substr(at, 2) + std::string(2, '\0'), 0));
  if (!is_half) {
    return static_cast<std::int16_t>(bits);
  }
  const int exponent = (bits >> 10) & 31;
  const double fraction = bits & 1023;
  const double magnitude =
      exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(1024.0 + fraction, exponent - 25);
  return (bits & 0x8000) != 0 ? -magnitude : magnitude;
}

Pages read_pages(const std::string& bytes, int side, std::size_t value_bytes,
                 bool is_half = false) {
  EXPECT_EQ(bytes.substr(0, 4), "HLVP");
  const std::size_t n = u32(bytes, 4);
  const std::size_t page = u32(bytes, 8);
  EXPECT_EQ(page, count(side) * count(side) * value_bytes);
  EXPECT_EQ(bytes.size(), 16 + n * (8 + page));
  const double base = value_bytes == 1 ? 256.0 : 65536.0;
  Pages pages;
  unsigned expected_digit = 0;
  for (std::size_t p = 0; p < n; ++p) {
    const auto picture = static_cast<int>(u32(bytes, 16 + 8 * p));
    const std::uint32_t offset = u32(bytes, 20 + 8 * p);
    const unsigned digit = offset & 0xffU;
    auto& values = pages[{picture, static_cast<int>(offset >> 8U)}];
    expected_digit = values.empty() ? 0 : expected_digit + 1;  // digits of a page follow it
    EXPECT_EQ(digit, expected_digit);
    values.resize(count(side) * count(side));
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] +=
          std::pow(base, digit) *
          value_at(bytes, 16 + 8 * n + p * page + i * value_bytes, value_bytes, is_half);
    }
  }
  return pages;
}

std::vector<float> floats(const std::string& bytes) {
  std::vector<float> values(bytes.size() / sizeof(float));
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

/// A page's value of pixel p of a tile; 0 where there is no page.
double page_value(const Pages& pages, int picture, int tile, const TileRect& rect, int side,
                  int p) {
  const auto found = pages.find({picture, tile});
  return found == pages.end() ? 0.0
                              : found->second[count(p / rect.width * side + p % rect.width)];
}

class GpuPages : public ::testing::Test {
 protected:
  BasisFile compress(const CompressSource& source, const CompressOptions& options) {
    const auto file = folder_.path() / "made.hlb";
    (void)compress_stack(source, file, options);
    return BasisFile::open(file);
  }
  /// Every value of the file from pages alone, against decode_tile. @param tolerance  of the
  /// peak
  static void expect_decodes(const BasisFile& basis, double tolerance) {
    const BasisHeader& header = basis.header();
    const int side = page_side(header);
    const bool is_lossless = header.coding == BasisCoding::lossless;
    const TileRun all{0, basis.n_tiles() - 1};
    for (int c = 0; c < header.dims.channels; ++c) {
      const Pages gains = read_pages(gain_pages(basis, c, all), side, 2);
      const std::vector<float> polynomials = floats(plate_polynomials(basis, c, all));
      const std::size_t n_plate = count(header.n_plate());
      ASSERT_EQ(polynomials.size(), count(basis.n_tiles()) * n_plate);
      const Pages shifts = read_pages(shift_pages(basis, c, all), side, 1);
      Pages pages;
      for (int g = 0; g < basis.n_groups(); ++g) {
        pages.merge(read_pages(coefficient_pages(basis, c, g, all), side, is_lossless ? 2 : 1,
                               is_lossless));
      }
      for (int t = 0; t < basis.n_tiles(); ++t) {
        expect_tile(basis, c, t, pages,
                    {gains, std::span(polynomials).subspan(count(t) * n_plate, n_plate)},
                    shifts, tolerance);
      }
    }
  }

  testing::TemporaryFolder folder_;

 private:
  struct TilePlate {
    const Pages& gains;
    std::span<const float> polynomial;
  };

  static void expect_tile(const BasisFile& basis, int channel, int tile, const Pages& pages,
                          const TilePlate& plate, const Pages& shifts, double tolerance) {
    const BasisHeader& header = basis.header();
    const TileRect rect = basis.tile_rect(tile);
    const int side = page_side(header);
    const std::vector<float> truth = basis.decode_tile(tile, channel);
    const bool is_lossless = header.coding == BasisCoding::lossless;
    std::vector<double> row(count(header.dims.n_lights));
    std::vector<double> direction(row.size());
    const std::vector<double> terms = plate_terms(rect, header.plate_degree);
    const std::size_t n_terms = terms.size() / count(rect.n_pixels());
    for (int p = 0; p < rect.n_pixels(); ++p) {
      const double factor =
          is_lossless ? half_scale(header)
                      : header.step * std::exp2(-page_value(shifts, 0, tile, rect, side, p));
      for (int i = 0; i < header.dims.n_lights; ++i) {
        row[count(i)] = factor * page_value(pages, i, tile, rect, side, p);
      }
      basis.basis().inverse(std::span(row));
      plate_direction<double>(plate.polynomial,
                              std::span(terms).subspan(count(p) * n_terms, n_terms),
                              basis.tables().plate_vectors, direction);
      const double gain = header.gain_step * page_value(plate.gains, 0, tile, rect, side, p);
      for (std::size_t k = 0; k < row.size(); ++k) {
        row[k] += gain * direction[k];
      }
      for (int k = 0; k < header.dims.n_lights; ++k) {
        ASSERT_NEAR(row[count(k)],
                    double{truth[count(p) * count(header.dims.n_lights) + count(k)]},
                    tolerance * header.peak)
            << "tile " << tile << ", pixel " << p << ", light " << k;
      }
    }
  }
};

// decode_tile rounds coefficients and values to float: 2^-23 of the peak, 16 terms.
constexpr double kFloat = 2e-6;

TEST_F(GpuPages, GiveEveryValueOfAHaarFileWithPlate) {
  const BasisFile basis =
      compress(made_source(make_stack({}), 16, &make_stack({.has_sphere = false})), {});
  ASSERT_GT(basis.header().plate_rank, 0);
  expect_decodes(basis, kFloat);
}

TEST_F(GpuPages, GiveShiftsWhereDarkPixelsHaveFinerSteps) {
  CompressOptions options;
  options.worst_pixel = 0.01;
  const BasisFile basis = compress(made_source(make_stack({}), 16), options);
  const std::string shifts = shift_pages(basis, 0, {0, basis.n_tiles() - 1});
  ASSERT_GT(u32(shifts, 4), 0U) << "the test needs a file with shifts";
  expect_decodes(basis, kFloat);
}

TEST_F(GpuPages, GiveThreeChannelsOfLightsThemselves) {
  CompressOptions options;
  options.basis = BasisKind::direct;
  const BasisFile basis =
      compress(made_source(make_stack({.grid = 4, .channels = 3}), 0), options);
  expect_decodes(basis, kFloat);
}

TEST_F(GpuPages, SplitLargeValuesIntoDigitsWithoutRounding) {
  const BasisFile basis = compress(
      made_source(make_stack({.grid = 8}), 8, &make_stack({.grid = 8, .has_sphere = false})),
      {.relative_l2 = 1e-6});
  const std::string pages = coefficient_pages(basis, 0, 0, {0, 0});
  unsigned digits = 0;
  for (std::size_t p = 0; p < u32(pages, 4); ++p) {
    digits = std::max(digits, u32(pages, 20 + 8 * p) & 0xffU);
  }
  ASSERT_GE(digits, 1U) << "the test needs values beyond 8 bits";
  expect_decodes(basis, kFloat);
}

TEST_F(GpuPages, HoldLosslessValuesToHalfPrecision) {
  const BasisFile basis = compress(made_source(make_stack({.grid = 4}), 0),
                                   {.relative_l2 = 0.0, .basis = BasisKind::direct});
  ASSERT_EQ(basis.header().coding, BasisCoding::lossless);
  EXPECT_EQ(half_scale(basis.header()),
            std::exp2(std::floor(std::log2(basis.header().peak)) + 1));
  expect_decodes(basis, std::exp2(-11.0));  // half a unit in the last place of the largest
}

TEST_F(GpuPages, HoldTilesOfAnySize) {
  for (const int tile : {7, 30, 64}) {
    test::write_retiled(make_stack({.grid = 4, .channels = 3}), tile,
                        folder_.path() / "made.hlb");
    const BasisFile basis = BasisFile::open(folder_.path() / "made.hlb");
    ASSERT_EQ(basis.header().tile, tile);
    expect_decodes(basis, std::exp2(-11.0));
  }
}

TEST_F(GpuPages, LeaveOutWhatIsEmpty) {
  MemoryStack stack({64, 32, 1, 16});
  for (int k = 0; k < 16; ++k) {
    stack.at(0, 3, 40, k) = 1.0F + static_cast<float>(k % 3);  // in the second tile alone
  }
  const BasisFile basis = compress(made_source(stack, 4), {});
  for (int g = 0; g < basis.n_groups(); ++g) {
    EXPECT_EQ(u32(coefficient_pages(basis, 0, g, {0, 0}), 4), 0U);
  }
  EXPECT_GT(u32(coefficient_pages(basis, 0, 0, {0, 1}), 4), 0U);
  EXPECT_EQ(u32(shift_pages(basis, 0, {0, 1}), 4), 0U);
  EXPECT_EQ(u32(gain_pages(basis, 0, {0, 1}), 4), 0U);
}

TEST_F(GpuPages, RefuseWhatIsNotThere) {
  const BasisFile basis = compress(made_source(make_stack({.grid = 4}), 4), {});
  const int last = basis.n_tiles() - 1;
  EXPECT_THROW((void)coefficient_pages(basis, 1, 0, {0, 0}), Error);
  EXPECT_THROW((void)coefficient_pages(basis, -1, 0, {0, 0}), Error);
  EXPECT_THROW((void)coefficient_pages(basis, 0, basis.n_groups(), {0, 0}), Error);
  EXPECT_THROW((void)coefficient_pages(basis, 0, -1, {0, 0}), Error);
  for (const TileRun tiles : {TileRun{0, last + 1}, TileRun{-1, 0}, TileRun{1, 0},
                              TileRun{0, std::numeric_limits<int>::max()}}) {
    EXPECT_THROW((void)coefficient_pages(basis, 0, 0, tiles), Error);
    EXPECT_THROW((void)gain_pages(basis, 0, tiles), Error);
    EXPECT_THROW((void)plate_polynomials(basis, 0, tiles), Error);
    EXPECT_THROW((void)shift_pages(basis, 0, tiles), Error);
  }
}

TEST_F(GpuPages, SayWhichBlockIsDamaged) {
  const auto file = folder_.path() / "made.hlb";
  (void)compress_stack(made_source(make_stack({.grid = 4}), 4), file, {});
  std::string bytes = read_file(file);
  bytes[120] = static_cast<char>(bytes[120] ^ 1);  // the first block begins at 104
  const BasisFile basis = BasisFile::from_bytes(
      std::as_bytes(std::span(bytes.data(), bytes.size())), "damaged.hlb");
  try {
    for (int g = 0; g < basis.n_groups(); ++g) {
      (void)coefficient_pages(basis, 0, g, {0, basis.n_tiles() - 1});
    }
    (void)shift_pages(basis, 0, {0, basis.n_tiles() - 1});
    FAIL() << "a damaged block must be refused";
  } catch (const Error& error) {
    EXPECT_NE(error.where().find("damaged.hlb, tile 0"), std::string::npos) << error.what();
  }
}

TEST(PageSide, IsTheTileRoundedUpToFour) {
  BasisHeader header;
  for (const auto& [tile, side] : {std::pair(32, 32), std::pair(30, 32), std::pair(1, 4)}) {
    header.tile = tile;
    EXPECT_EQ(page_side(header), side);
  }
}

}  // namespace
}  // namespace haarlight::relight
