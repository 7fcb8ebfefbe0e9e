// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/picture_rows.h"

#include <cstdio>
#include <fstream>

#include <gtest/gtest.h>
#include <jpeglib.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/import/import.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 45;
constexpr int kHeight = 71;

void write_jpeg(const fs::path& path, int n_channels, bool is_progressive, int phase) {
  jpeg_compress_struct info{};
  jpeg_error_mgr errors{};
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  std::FILE* file = std::fopen(path.c_str(), "wb");
  jpeg_stdio_dest(&info, file);
  info.image_width = kWidth;
  info.image_height = kHeight;
  info.input_components = n_channels;
  info.in_color_space = n_channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, 90, TRUE);
  if (is_progressive) {
    jpeg_simple_progression(&info);
  }
  jpeg_start_compress(&info, TRUE);
  for (int y = 0; y < kHeight; ++y) {
    std::vector<JSAMPLE> row;
    for (int i = 0; i < kWidth * n_channels; ++i) {
      row.push_back(static_cast<JSAMPLE>(128 + 100 * testing::field(i / 6, y, phase, 0)));
    }
    JSAMPROW rows[1] = {row.data()};
    jpeg_write_scanlines(&info, rows, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  std::fclose(file);
}

/// All rows, some passed over, then all again: (height, n_lights, width, 3).
std::vector<std::uint16_t> read_all(PictureRows& rows) {
  const StackDims shape = rows.dims();
  const int n_of_row = shape.n_lights * shape.width * 3;
  const auto n_row = static_cast<std::size_t>(n_of_row);
  std::vector<std::uint16_t> all(n_row * static_cast<std::size_t>(shape.height));
  rows.rewind();
  for (int y = 0; y < shape.height;) {
    const int n = std::min(13, shape.height - y);
    rows.read(n, std::span(all).subspan(static_cast<std::size_t>(y) * n_row,
                                        static_cast<std::size_t>(n) * n_row));
    y += n;
  }
  return all;
}

void expect_skipping_changes_nothing(PictureRows& rows) {
  const std::vector<std::uint16_t> all = read_all(rows);
  const std::size_t n_row = all.size() / static_cast<std::size_t>(rows.dims().height);
  std::vector<std::uint16_t> row(n_row);
  for (int round = 0; round < 2; ++round) {
    rows.rewind();
    int y = 0;
    for (const int next : {0, 5, 6, 30, 70}) {
      if (next > y) {
        rows.skip(next - y);
      }
      rows.read(1, row);
      y = next + 1;
      EXPECT_TRUE(std::equal(
          row.begin(), row.end(),
          all.begin() + static_cast<std::ptrdiff_t>(static_cast<std::size_t>(next) * n_row)))
          << next;
    }
  }
}

TEST(JpegRows, AreThePicturesAnotherReaderSees) {
  const testing::TemporaryFolder folder;
  write_jpeg(folder / "a.jpg", 3, false, 0);
  write_jpeg(folder / "b.jpg", 1, false, 1);
  const auto rows = jpeg_rows({folder / "a.jpg", folder / "b.jpg"});
  const std::vector<std::uint16_t> all = read_all(*rows);
  const PictureFile a = read_picture(folder / "a.jpg");
  const PictureFile b = read_picture(folder / "b.jpg");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) {
        const int index = ((y * 2) * kWidth + x) * 3 + c;
        const auto at = static_cast<std::size_t>(index);
        EXPECT_NEAR(all[at] / 65535.0F, a.pixels(y, x, c), 1e-5F);
        EXPECT_NEAR(all[at + std::size_t{3} * kWidth] / 65535.0F, b.pixels(y, x, 0), 1e-5F);
      }
    }
  }
  expect_skipping_changes_nothing(*rows);
}

TEST(JpegRows, RefuseWhatTheyCannotStream) {
  const testing::TemporaryFolder folder;
  write_jpeg(folder / "whole.jpg", 3, false, 0);
  write_jpeg(folder / "progressive.jpg", 3, true, 0);
  const std::string bytes = read_file(folder / "whole.jpg");
  write_file_atomically(folder / "cut.jpg", bytes.substr(0, bytes.size() / 2));
  write_file_atomically(folder / "text.jpg", std::string_view("not a picture"));
  write_file_atomically(folder / "empty.jpg", std::string_view());
  EXPECT_THROW((void)jpeg_rows({folder / "progressive.jpg"}), Error);
  EXPECT_THROW((void)jpeg_rows({folder / "text.jpg"}), Error);
  EXPECT_THROW((void)jpeg_rows({folder / "empty.jpg"}), Error);
  EXPECT_THROW((void)jpeg_rows({folder / "missing.jpg"}), Error);
  const auto rows = jpeg_rows({folder / "cut.jpg"});
  EXPECT_THROW((void)read_all(*rows), Error);
}

TEST(SessionRows, OfDisplayPicturesAreTheirCodes) {
  const testing::TemporaryFolder folder;
  std::string list = "2\n";
  std::vector<Image<float>> pictures;
  for (int k = 0; k < 2; ++k) {
    Image<float> picture(kHeight, kWidth, 3);
    for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
      picture.pixels()[i] =
          static_cast<float>((i * (7 + 4 * static_cast<std::size_t>(k))) % 256) / 255.0F;
    }
    Image<float> linear = picture;
    for (float& value : linear.pixels()) {
      value = linear_from_srgb(value);
    }
    const std::string name = k == 0 ? "a.png" : "b.png";
    write_image(folder / name, linear.view());
    list += name + (k == 0 ? " 0 0 1\n" : " 0.6 0 0.8\n");
    pictures.push_back(std::move(picture));
  }
  write_file_atomically(folder / "lights.lp", list);
  (void)session::import_pictures(folder.path(), folder / "lights.lp", folder / "s", {});
  const session::Session session = session::Session::open(folder / "s");
  const auto truth = image_rows(pictures);
  const std::vector<std::uint16_t> codes = read_all(*session_rows(session, {}));
  EXPECT_EQ(codes, read_all(*truth));
  expect_skipping_changes_nothing(*session_rows(session, {}));

  // The long way round: developed to linear light and coded again, or left linear.
  SessionRowsOptions options;
  options.white = 1.0;
  const std::vector<std::uint16_t> developed = read_all(*session_rows(session, options));
  options.transfer = Transfer::linear;
  const auto linear_rows = session_rows(session, options);
  EXPECT_EQ(linear_rows->transfer(), Transfer::linear);
  const std::vector<std::uint16_t> linear = read_all(*linear_rows);
  for (std::size_t i = 0; i < codes.size(); ++i) {
    EXPECT_NEAR(developed[i] / 65535.0, codes[i] / 65535.0, 4e-5);
    EXPECT_NEAR(linear[i] / 65535.0F, linear_from_srgb(codes[i] / 65535.0F), 2e-5F);
  }
}

TEST(SelectedRows, AreTheLightsRequested) {
  std::vector<Image<float>> pictures;
  for (int k = 0; k < 4; ++k) {
    Image<float> picture(3, 5, 1);
    std::fill(picture.pixels().begin(), picture.pixels().end(), 0.2F * static_cast<float>(k));
    pictures.push_back(std::move(picture));
  }
  const auto all = image_rows(pictures);
  const auto some = selected_rows(*all, {3, 1});
  const auto truth = image_rows({pictures[3], pictures[1]});
  EXPECT_EQ(read_all(*some), read_all(*truth));
}

TEST(CroppedRows, AreARectangleOfTheWhole) {
  const testing::TemporaryFolder folder;
  write_jpeg(folder / "a.jpg", 3, false, 0);
  write_jpeg(folder / "b.jpg", 3, false, 1);
  const auto whole = jpeg_rows({folder / "a.jpg", folder / "b.jpg"});
  const std::vector<std::uint16_t> all = read_all(*whole);
  constexpr PixelRectangle kPart{7, 11, 20, 60};  // to the last row
  const auto part = cropped_rows(jpeg_rows({folder / "a.jpg", folder / "b.jpg"}), kPart);
  EXPECT_EQ(part->dims().width, 20);
  EXPECT_EQ(part->dims().height, 60);
  for (int round = 0; round < 2; ++round) {
    const std::vector<std::uint16_t> found = read_all(*part);
    std::size_t at = 0;
    for (int y = 0; y < 60; ++y) {
      for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < 20 * 3; ++i) {
          const int from = (((y + 11) * 2 + k) * kWidth + 7) * 3 + i;
          ASSERT_EQ(found[at++], all[static_cast<std::size_t>(from)]) << y << " " << i;
        }
      }
    }
  }
  part->rewind();
  part->skip(59);
  std::vector<std::uint16_t> last(std::size_t{2} * 20 * 3);
  part->read(1, last);
  EXPECT_EQ(last[0], all[static_cast<std::size_t>(((70 * 2) * kWidth + 7) * 3)]);
}

/// What a fit reads of a session with a white reference is neutral where the card is; without,
/// the same codes come straight from the frames.
TEST(SessionRows, HaveTheGainsOfTheWhiteReference) {
  const testing::TemporaryFolder folder;
  const fs::path set = HAARLIGHT_SOURCE_DIR "/tests/data/small_rti";
  (void)session::import_pictures(set, set / "relief.lp", folder / "s",
                                 {.white = session::WhitePatch{{75, 51, 14, 14}, {}}});
  const session::Session session = session::Session::open(folder / "s");
  const auto rows = session_rows(session, {});
  const StackDims shape = rows->dims();
  const std::vector<std::uint16_t> all = read_all(*rows);
  ASSERT_EQ(shape.n_lights, 16);
  for (int k = 0; k < shape.n_lights; ++k) {
    const int at = ((58 * shape.n_lights + k) * shape.width + 82) * 3;
    for (int c = 1; c < 3; ++c) {
      // A code of 8 bits and the JPEG's own rounding, of 255.
      EXPECT_NEAR(all[static_cast<std::size_t>(at)], all[static_cast<std::size_t>(at + c)],
                  3 * 257)
          << k;
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
