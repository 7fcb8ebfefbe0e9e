// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/metadata_rows.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"

namespace haarlight::capture {
namespace {

void add_noise(Image<std::uint16_t>& rows, double sigma_dn, std::uint64_t seed) {
  std::uint64_t i = 0;
  for (std::uint16_t& word : rows.pixels()) {
    const double noisy = word + sigma_dn * standard_normal(hash_key(seed, ++i));
    word = static_cast<std::uint16_t>(std::clamp(std::round(noisy), 0.0, 65535.0));
  }
}

TEST(MetadataRows, BlocksAreAsLargeAsTheRowsAllow) {
  EXPECT_EQ(tag_block_side(64, 8), 2);
  EXPECT_EQ(tag_block_side(320, 8), 4);
  EXPECT_EQ(tag_block_side(48, 4), 0) << "48 x 4 has 48 blocks of 2 x 2";
  EXPECT_EQ(tag_block_side(48, 0), 0);
}

TEST(MetadataRows, FirstBlocksSpellTheSyncWord) {
  Image<std::uint16_t> rows(8, 64, 1);
  encode_metadata_rows(rows.view(), {.tag = 7}, 100, 900);
  const int expected[] = {900, 100, 900, 900, 100, 100, 900, 100};  // 0xB2
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(rows(0, 2 * i), expected[i]) << "block " << i;
    EXPECT_EQ(rows(1, 2 * i + 1), expected[i]) << "block " << i;
  }
}

RC_GTEST_PROP(MetadataRows, ReadBackWhatWasWrittenUnderNoise,
              (std::uint32_t tag, bool is_mixed, std::uint64_t seed)) {
  Image<std::uint16_t> rows(8, 64, 1);
  encode_metadata_rows(rows.view(), {.tag = tag, .is_mixed = is_mixed}, 256, 12000);
  add_noise(rows, (12000.0 - 256.0) / 6.0, seed);
  const auto read = decode_metadata_rows(rows.view());
  RC_ASSERT(read.has_value());
  RC_ASSERT((*read == FrameTag{.tag = tag, .is_mixed = is_mixed}));
}

RC_GTEST_PROP(MetadataRows, AFlippedBlockIsNeverReadAsAnotherTag, (std::uint32_t tag)) {
  const int flipped = *rc::gen::inRange(0, 96);
  Image<std::uint16_t> rows(8, 64, 1);
  encode_metadata_rows(rows.view(), {.tag = tag}, 0, 1000);
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 2; ++x) {
      std::uint16_t& word = rows((flipped / 32) * 2 + y, (flipped % 32) * 2 + x);
      word = word == 0 ? 1000 : 0;
    }
  }
  RC_ASSERT(!decode_metadata_rows(rows.view()).has_value());
}

TEST(MetadataRows, NoiseAloneHasNoTag) {
  for (std::uint64_t seed = 0; seed < 1000; ++seed) {
    Image<std::uint16_t> rows(8, 64, 1);
    add_noise(rows, 500.0, seed);
    EXPECT_FALSE(decode_metadata_rows(rows.view()).has_value()) << "seed " << seed;
  }
}

}  // namespace
}  // namespace haarlight::capture
