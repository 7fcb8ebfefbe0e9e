// SPDX-License-Identifier: Apache-2.0
#include "session/develop/radiance_row.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/line_allocator.h"
#include "haarlight/session/session.h"
#include "session/develop/interleave.h"
#include "session/develop/merge_exposures.h"
#include "session/frame_reader.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

double draw(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(a, b)); }

/// What develop's general way makes of a sample that is alone.
struct Single {
  float value = 0.0F;
  bool is_clipped = false;
};
Single single_of(const FrameScale& scale, float dn, float linear, double dark, double flat) {
  const double clip = (scale.clip_linear - dark) * scale.electrons_per_step;
  const double electrons = (double{linear} - dark) * scale.electrons_per_step;
  const ExposureSample sample{
      double{dn} >= scale.clip_dn ? std::max(electrons, clip) : electrons,
      scale.per_unit * flat, 1.0, clip};
  return {static_cast<float>(sample.electrons / sample.per_unit), sample.is_clipped()};
}

TEST(RadianceRow, IsThatOfTheGeneralWay) {
  const FrameScale scale{0.25, 1.7e4, 60000.0, 58976.0};
  for (const std::size_t n : {1U, 7U, 16U, 33U, 480U}) {
    std::vector<float> dn(n);
    std::vector<float> linear(n);
    std::vector<float> dark(n);
    std::vector<double> flat(n);
    for (std::size_t i = 0; i < n; ++i) {
      dn[i] = std::floor(static_cast<float>(65536.0 * draw(n, i)));
      dn[i] = i % 5 == 3 ? 60000.0F : dn[i];  // the clip level itself
      linear[i] = dn[i] - 1024.0F;
      dark[i] = static_cast<float>(3.0 * draw(n + 1, i) - 1.0);
      flat[i] = 0.5 + draw(n + 2, i);
    }
    for (const bool has_dark : {false, true}) {
      for (const bool has_flat : {false, true}) {
        SampleRow row{dn, linear, {}, {}};
        row.dark = has_dark ? std::span<const float>(dark) : row.dark;
        row.flat = has_flat ? std::span<const double>(flat) : row.flat;
        std::vector<float> values(n);
        std::vector<std::uint8_t> marks(n);
        const std::size_t n_clipped = radiance_of_row(scale, row, values.data());
        mark_clipped(scale, row, marks.data());
        std::size_t n_expected = 0;
        for (std::size_t i = 0; i < n; ++i) {
          const Single one =
              single_of(scale, dn[i], linear[i], has_dark ? double{dark[i]} : 0.0,
                        has_flat ? flat[i] : 1.0);
          EXPECT_EQ(values[i], one.value) << "sample " << i << " of " << n;
          EXPECT_EQ(marks[i] != 0, one.is_clipped) << "sample " << i << " of " << n;
          n_expected += one.is_clipped ? 1U : 0U;
        }
        EXPECT_EQ(n_clipped, n_expected);
      }
    }
  }
}

TEST(RadianceRow, WidensEverySample) {
  std::vector<std::uint8_t> bytes(256);
  std::vector<std::uint16_t> words(65536);
  for (std::size_t i = 0; i < words.size(); ++i) {
    words[i] = static_cast<std::uint16_t>(i);
    bytes[i % 256] = static_cast<std::uint8_t>(i);
  }
  std::vector<float> of_bytes(bytes.size());
  std::vector<float> of_words(words.size());
  widen(bytes, of_bytes.data());
  widen(words, of_words.data());
  for (std::size_t i = 0; i < words.size(); ++i) {
    EXPECT_EQ(of_words[i], static_cast<float>(i));
    EXPECT_EQ(of_bytes[i % 256], static_cast<float>(i % 256));
  }
}

/// Every value comes from where it belongs, of lights and pixels that fill no block.
TEST(Interleave, OfOddShapes) {
  for (const int width : {1, 15, 16, 17, 40}) {
    for (const int channels : {1, 3}) {
      for (const std::size_t n_lights : {1U, 15U, 16U, 17U, 35U}) {
        constexpr int kHeight = 4;
        constexpr std::size_t kSkip = 1;
        constexpr std::size_t kRows = 2;
        const auto value = [&](std::size_t k, std::size_t y, std::size_t x, std::size_t c) {
          return static_cast<float>(((k * 10 + y) * 100 + x) * 4 + c);
        };
        const auto w = static_cast<std::size_t>(width);
        const auto n_channels = static_cast<std::size_t>(channels);
        std::vector<Image<float>> pictures;
        std::vector<Image<std::uint8_t>> marks(n_lights);
        for (std::size_t k = 0; k < n_lights; ++k) {
          Image<float>& picture = pictures.emplace_back(kHeight, width, channels);
          for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
            picture.pixels()[i] =
                value(k, i / (w * n_channels), i / n_channels % w, i % n_channels);
          }
          if (k % 3 == 1) {
            marks[k] = Image<std::uint8_t>(kHeight, width, channels);
            marks[k](2, width / 2, channels - 1) = 1;
          }
        }
        std::vector<float> out(n_channels * kRows * w * n_lights, -1.0F);
        for (std::size_t first = 0; first < n_lights; first += kLightBlock) {
          interleave(
              std::span(pictures).subspan(first, std::min(kLightBlock, n_lights - first)),
              kSkip, first, {out.data(), kRows, n_lights});
        }
        const std::vector<std::uint8_t> marked =
            interleave_marks(marks, kSkip, kRows, w, n_channels);
        for (std::size_t at = 0; at < out.size(); ++at) {
          const std::size_t k = at % n_lights;
          const std::size_t x = at / n_lights % w;
          const std::size_t y = at / n_lights / w % kRows;
          const std::size_t c = at / n_lights / w / kRows;
          ASSERT_EQ(out[at], value(k, y + kSkip, x, c)) << at;
          ASSERT_EQ(marked[at] != 0,
                    k % 3 == 1 && y + kSkip == 2 && x == w / 2 && c == n_channels - 1)
              << at;
        }
      }
    }
  }
}

/// So many that they are written past the caches.
TEST(Interleave, OfManyRows) {
  constexpr std::size_t kWidth = 131075;
  const auto value_of = [](std::size_t pixel, std::size_t k) {
    return static_cast<float>(pixel * 40 + k);
  };
  constexpr std::size_t kRows = 2;
  for (const std::size_t n_lights : {32U, 33U}) {
    LineFloats out(kRows * kWidth * n_lights);
    for (std::size_t first = 0; first < n_lights; first += kLightBlock) {
      std::vector<Image<float>> pictures;
      for (std::size_t k = first; k < std::min(n_lights, first + kLightBlock); ++k) {
        Image<float>& picture = pictures.emplace_back(2, static_cast<int>(kWidth), 1);
        for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
          picture.pixels()[i] = value_of(i, k);
        }
      }
      interleave(pictures, 0, first, {out.data(), kRows, n_lights});
    }
    std::size_t n_wrong = 0;
    for (std::size_t at = 0; at < out.size(); ++at) {
      n_wrong += out[at] != value_of(at / n_lights, at % n_lights) ? 1U : 0U;
    }
    EXPECT_EQ(n_wrong, 0U) << n_lights << " lights";
  }
}

TEST(FrameReader, ReadsWhatTheSessionReads) {
  const test::TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", 4);
  const Session session = Session::open(folder.path() / "s");
  const FrameReader reader(session);
  const FrameForm& form = session.info().form;
  for (int pass = 0; pass < 2; ++pass) {  // parsed, then remembered
    for (const FrameRecord& frame : session.info().frames) {
      for (int y0 = 0; y0 < form.height; ++y0) {
        const Image<float> rows = session.read_rows(frame, y0, form.height);
        std::vector<std::byte> bytes(reader.row_bytes() *
                                     static_cast<std::size_t>(form.height - y0));
        reader.expect(frame, y0, form.height);
        reader.read(frame, y0, form.height, bytes);
        std::vector<std::uint16_t> words(rows.pixels().size());
        ASSERT_EQ(bytes.size(), words.size() * sizeof(std::uint16_t));
        std::memcpy(words.data(), bytes.data(), bytes.size());
        EXPECT_TRUE(std::equal(words.begin(), words.end(), rows.pixels().begin()));
      }
    }
  }
}

TEST(FrameReader, NamesAFrameThatIsCutShortOrGone) {
  const test::TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", 2);
  const Session session = Session::open(folder.path() / "s");
  const FrameReader reader(session);
  const int height = session.info().form.height;
  std::vector<std::byte> bytes(reader.row_bytes() * static_cast<std::size_t>(height));
  const auto complaint = [&](const FrameRecord& frame) {
    try {
      reader.read(frame, 0, height, bytes);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  for (const FrameRecord& frame : session.info().frames) {
    const std::filesystem::path file = session.folder() / frame.file;
    const bool was_read = frame.shot == 0;
    if (was_read) {
      EXPECT_EQ(complaint(frame), "");
    }
    std::filesystem::resize_file(file, was_read ? 100 : 1);
    EXPECT_NE(complaint(frame).find(file.string()), std::string::npos) << complaint(frame);
    std::filesystem::remove(file);
    EXPECT_NE(complaint(frame).find(file.string()), std::string::npos) << complaint(frame);
    reader.expect(frame, 0, height);  // only advice
  }
}

}  // namespace
}  // namespace haarlight::session
