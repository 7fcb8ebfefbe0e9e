// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/basis_file.h"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/basis_header.h"
#include "tests/relight/basis/file_bytes.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;
using test::put_number;
using test::replace;
using test::sign_preamble;

/// A good file's bytes, made once.
const std::string& good_bytes() {
  static const std::string kBytes = [] {
    const test::TemporaryFolder folder;
    const auto path = folder.path() / "good.hlb";
    const MemoryStack stack = make_stack({.width = 34, .height = 33, .grid = 8});
    const MemoryStack plate =
        make_stack({.width = 34, .height = 33, .grid = 8, .has_sphere = false});
    (void)compress_stack(made_source(stack, 8, &plate), path, {.worst_pixel = 0.05});
    return read_file(path);
  }();
  return kBytes;
}

BasisFile from_text(const std::string& bytes) {
  return BasisFile::from_bytes(std::as_bytes(std::span(bytes.data(), bytes.size())),
                               "made.hlb");
}

/// Opens and reads everything.
void read_everything(const std::string& bytes) {
  const BasisFile basis = from_text(bytes);
  for (int t = 0; t < basis.n_tiles(); ++t) {
    for (int c = 0; c < basis.header().dims.channels; ++c) {
      (void)basis.decode_tile(t, c);
    }
  }
  (void)relight(basis, LightWeights::Ones(basis.header().dims.n_lights, 1));
}

std::string with_header(const std::function<std::string(std::string)>& change) {
  return test::with_header(good_bytes(), change);
}

void expect_refused(const std::string& bytes, const std::string& words) {
  try {
    read_everything(bytes);
    FAIL() << "a broken file was taken; expected: " << words;
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), testing::HasSubstr(words));
    EXPECT_THAT(error.where(), testing::HasSubstr("made.hlb"));
    EXPECT_FALSE(error.hint().empty());
  }
}

TEST(BasisFile, GoodOneIsRead) { EXPECT_NO_THROW(read_everything(good_bytes())); }

TEST(BasisFile, ContentKeyTellsFilesApart) {
  const BasisFile basis = from_text(good_bytes());
  EXPECT_EQ(basis.content_key(), from_text(good_bytes()).content_key());
  const test::TemporaryFolder folder;
  const auto path = folder.path() / "other.hlb";
  (void)compress_stack(made_source(make_stack({.width = 34, .height = 33, .grid = 8}), 8), path,
                       {});
  EXPECT_NE(BasisFile::open(path).content_key(), basis.content_key());
}

TEST(BasisFile, OtherFilesAndOtherVersionsAreRefused) {
  expect_refused("", "not a basis file");
  expect_refused("PNG and so on, a long text that is no basis file at all", "not a basis file");
  std::string newer = good_bytes();
  newer[8] = 4;
  expect_refused(newer, "version 4");
  newer[8] = 1;
  expect_refused(newer, "version 1");
}

TEST(BasisFile, CutFilesAreRefused) {
  for (const std::size_t size : {std::size_t{50}, std::size_t{103}, std::size_t{104},
                                 good_bytes().size() / 2, good_bytes().size() - 1}) {
    const std::string cut = good_bytes().substr(0, size);
    EXPECT_THROW(read_everything(cut), Error) << size;
  }
  expect_refused(good_bytes() + "x", "bytes, it was written with");
}

TEST(BasisFile, EveryFlippedByteIsNoticed) {
  // Each byte is under a checksum but the four reserved ones' copy: all are.
  for (std::size_t i = 0; i < good_bytes().size(); i += 1 + good_bytes().size() / 997) {
    std::string bytes = good_bytes();
    bytes[i] = static_cast<char>(bytes[i] ^ 0x20);
    EXPECT_THROW(read_everything(bytes), Error) << "byte " << i;
  }
}

TEST(BasisFile, PartsOutsideTheFileAreRefused) {
  for (const std::size_t field : {24U, 32U, 48U, 56U, 72U, 80U}) {
    std::string bytes = good_bytes();
    put_number(bytes, field, std::uint64_t{1} << 62U);
    sign_preamble(bytes);
    EXPECT_THROW(read_everything(bytes), Error) << field;
  }
}

TEST(BasisFile, BrokenHeadersAreRefusedByField) {
  const auto refuse = [](const std::string& from, const std::string& to,
                         const std::string& words) {
    expect_refused(with_header([&](const std::string& h) { return replace(h, from, to); }),
                   words);
  };
  refuse("{", "[", "not JSON");
  refuse("\"width\":34", "\"width\":0", "'picture.width'");
  refuse("\"width\":34", "\"width\":99999999999", "'picture.width'");
  refuse("\"width\":34", "\"width\":340", "index");
  refuse("\"width\":34", "\"breadth\":34", "'picture.width' is missing");
  refuse("\"basis\":\"haar\"", "\"basis\":\"fourier\"", "fourier");
  refuse("\"basis\":\"haar\",\"", "\"basis\":\"unbalanced haar\",\"",
         "basis 'unbalanced haar' over a grid of 8 x 8");
  refuse("\"grid\":8", "\"grid\":7", "no grids");
  refuse("\"grid\":8", "\"grid\":0", "without a grid");
  refuse("\"grid\":8", "\"grid\":-8", "'lights.grid'");
  refuse("\"grid\":8", "\"grid\":8,\"rows\":8,\"cols\":8", "'lights.rows'");
  refuse("\"grid\":8", "\"grid\":0,\"rows\":8,\"cols\":8", "'lights.rows'");
  refuse("\"grid\":8", "\"grid\":0,\"rows\":4,\"cols\":16",
         "basis 'haar' over a grid of 4 x 16");
  refuse("\"count\":64", "\"count\":63", "group_ends");
  refuse("\"tile\":32", "\"tile\":\"x\"", "'tile'");
  refuse("\"tile\":32", "\"tile\":16", "index");
  refuse("\"rank\":", "\"rank\":1", "");
  refuse("{", "{\"photographed\":{\"iso\":0},", "0 is outside");
  refuse("\"dead_zone\":0.6", "\"dead_zone\":-1", "'dead_zone'");
  refuse("\"group_ends\":[64", "\"group_ends\":[65", "group_ends");
}

TEST(BasisFile, BrokenGridsOfOtherSidesAreRefusedByField) {
  const test::TemporaryFolder folder;
  const auto path = folder.path() / "wide.hlb";
  const MemoryStack stack = make_stack({.width = 9, .height = 8, .grid = 5, .rows = 3});
  (void)compress_stack(made_source(stack, HaarGrid{3, 5}), path, {});
  const std::string good = read_file(path);
  const auto changed = [&](const std::string& from, const std::string& to) {
    return test::with_header(good, [&](const std::string& h) { return replace(h, from, to); });
  };
  EXPECT_NO_THROW(read_everything(good));
  // Fewer lights than rows * cols, 15 lights that are no grids of 3 x 4, other ranges.
  expect_refused(changed("\"rows\":3", "\"rows\":4"), "15 lights are no grids of 4 x 5");
  expect_refused(changed("\"cols\":5", "\"cols\":1024"), "15 lights are no grids of 3 x 1024");
  for (const char* const rows :
       {"0", "-3", "1025", "2147483648", "4294967299", "\"3\"", "3.0"}) {
    expect_refused(changed("\"rows\":3", std::string("\"rows\":") + rows), "'lights.rows'");
  }
  expect_refused(changed("\"cols\":5", "\"columns\":5"), "'lights.cols' is missing");
  expect_refused(changed("\"rows\":3", "\"height\":3"), "'lights.rows' is missing");
  expect_refused(changed("\"grid\":0", "\"grid\":3"), "'lights.grid' = 3");
  expect_refused(changed("\"basis\":\"unbalanced haar\"", "\"basis\":\"haar\""),
                 "basis 'haar' over a grid of 3 x 5");
  expect_refused(changed("\"basis\":\"unbalanced haar\"", "\"basis\":\"haar-standard\""),
                 "basis 'haar-standard' over a grid of 3 x 5");
  const std::string whole_dct = test::with_header(good, [](const std::string& h) {
    return replace(replace(h, "\"basis\":\"unbalanced haar\"", "\"basis\":\"dct\""),
                   "\"coding\":\"quantised\"", "\"coding\":\"integers\"");
  });
  expect_refused(whole_dct, "basis 'dct' with coding 'integers' is not known here");
}

/// What a later program adds is skipped; what this one knows must be what it says.
TEST(BasisFile, UnknownSectionsAndKeysAreSkippedAndKnownOnesChecked) {
  const BasisFile good = from_text(good_bytes());
  ASSERT_EQ(good.header().sections.size(), 2U);
  ASSERT_FALSE(good.tables().coded_bound.is_empty());
  const std::string unknown = with_header([](const std::string& h) {
    return replace(replace(h, "\"coded_bound\"", "\"of_later_years\""), "{",
                   "{\"a_later_key\":[1,{}],");
  });
  EXPECT_NO_THROW(read_everything(unknown));
  EXPECT_TRUE(from_text(unknown).tables().coded_bound.is_empty());
  const auto refuse = [](const std::string& from, const std::string& to,
                         const std::string& words) {
    expect_refused(with_header([&](const std::string& h) { return replace(h, from, to); }),
                   words);
  };
  refuse("\"values\":", "\"values\":1", "no bound");
  refuse("\"values\":", "\"values\":-1", "'sections[].values'");
  refuse("\"checksum\":\"", "\"checksum\":\"1\",\"x\":\"", "damaged");
  refuse("\"checksum\":\"", "\"checksum\":\"x", "hexadecimal");
  refuse("\"offset\":", "\"offset\":9999999", "belong to nothing");
  refuse("\"sections\":[", "\"sections\":[7,", "sections");
  refuse("\"sections\":[{", "\"sections\":3,\"x\":[{", "'sections' is not a list");
  refuse("{", "{\"clipped\":{\"values\":1e9,\"least_norm\":0},", "more values are clipped");
  refuse("{", "{\"clipped\":{\"values\":1},", "'clipped.least_norm' is missing");
}

TEST(BasisFile, HeaderSurvivesTheRoundTrip) {
  const BasisFile basis = from_text(good_bytes());
  BasisHeader header = basis.header();
  const std::string json = basis_header_to_json(header);
  EXPECT_EQ(basis_header_to_json(basis_header_from_json(json, "x")), json);
  header.photographed.model = "CamX";
  header.photographed.exposure_s = 0.5;
  const std::string more = basis_header_to_json(header);
  EXPECT_EQ(basis_header_from_json(more, "x").photographed, header.photographed);
  EXPECT_EQ(basis.header().lights.size(), 64U);
}

TEST(BasisFile, FileAppearsOnlyWhenFinished) {
  const test::TemporaryFolder folder;
  const auto path = folder.path() / "unfinished.hlb";
  {
    BasisWriter writer(path);
    writer.append({});
    EXPECT_FALSE(std::filesystem::exists(path));
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

RC_GTEST_PROP(BlockCodecProperty, SparseRoundTrips, (const std::vector<std::uint8_t>& gaps)) {
  SparseBlock block;
  std::uint32_t cell = 0;
  for (const std::uint8_t gap : gaps) {
    cell += gap;
    block.cell.push_back(cell++);
    block.value.push_back(*rc::gen::arbitrary<std::int32_t>());
  }
  for (const BlockContent content : {BlockContent::repeats, BlockContent::dense}) {
    RC_ASSERT(decode_sparse(encode_sparse(block, content), block.cell.size(), cell, "x") ==
              block);
  }
}

RC_GTEST_PROP(BlockCodecProperty, PixelsAndFloatsRoundTrip,
              (std::uint8_t n, std::uint8_t rank)) {
  const std::size_t n_pixels = 1 + n % 40;
  const std::size_t n_rows = rank % 5;
  PixelBlock block;
  for (std::size_t p = 0; p < n_pixels; ++p) {
    block.shift.push_back(*rc::gen::inRange<std::uint8_t>(0, 64));
    block.gain.push_back(*rc::gen::arbitrary<std::int32_t>());
  }
  block.gain.front() |= 1;  // without any gain the plate is not kept
  std::vector<float> floats;
  for (std::size_t i = 0; i < n_rows * n_pixels; ++i) {
    floats.push_back(static_cast<float>(*rc::gen::arbitrary<std::int32_t>()) * 1e-20F);
  }
  block.plate.assign(floats.begin(), floats.begin() + static_cast<std::ptrdiff_t>(n_rows));
  RC_ASSERT(decode_pixels(encode_pixels(block), n_pixels, n_rows, "x") == block);
  RC_ASSERT(decode_floats(encode_floats(floats, n_pixels), n_rows, n_pixels, "x") == floats);
}

}  // namespace
}  // namespace haarlight::relight
