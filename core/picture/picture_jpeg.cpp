// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csetjmp>
#include <cstdio>
#include <vector>

#include <fmt/format.h>
#include <jpeglib.h>

#include "core/picture/picture_formats.h"

namespace haarlight {

namespace {

/// A scan costs time for every pixel and may be 10 bytes long; encoders write about 10.
constexpr int kMostScans = 100;

/// libjpeg reports errors through a call that must not return: it jumps back to the last
/// setjmp, and the caller throws from there. No C++ object lives between setjmp and longjmp.
struct ErrorJump {
  jpeg_error_mgr manager{};  // first: libjpeg hands back a pointer to it
  std::jmp_buf back{};
};

void jump_back(j_common_ptr info) {
  std::longjmp(reinterpret_cast<ErrorJump*>(info->err)->back, 1);
}

void keep_quiet(j_common_ptr /*info*/) {}

void count_scans(j_common_ptr info) {
  if (reinterpret_cast<j_decompress_ptr>(info)->input_scan_number > kMostScans) {
    jump_back(info);
  }
}

/// One JPEG being decoded.
class JpegLines {
 public:
  explicit JpegLines(const PictureSource& source) : source_(source) {
    info_.err = jpeg_std_error(&jump_.manager);
    jump_.manager.error_exit = jump_back;
    jump_.manager.output_message = keep_quiet;
    progress_.progress_monitor = count_scans;
    open();
  }
  ~JpegLines() { jpeg_destroy_decompress(&info_); }
  JpegLines(const JpegLines&) = delete;
  JpegLines& operator=(const JpegLines&) = delete;

  [[nodiscard]] const jpeg_decompress_struct& info() const { return info_; }
  [[nodiscard]] bool is_whole_in_memory() { return jpeg_has_multiple_scans(&info_) != 0; }

  void start() {
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp): libjpeg knows no other way
      refuse();
    }
    jpeg_start_decompress(&info_);
  }
  void read(std::uint8_t* row) {
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp)
      refuse();
    }
    JSAMPROW rows[1] = {row};
    jpeg_read_scanlines(&info_, rows, 1);
    if (info_.err->num_warnings > 0) {  // libjpeg invents data and continues
      jump_back(reinterpret_cast<j_common_ptr>(&info_));
    }
  }

 private:
  void open() {
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp)
      refuse();
    }
    jpeg_create_decompress(&info_);
    info_.progress = &progress_;
    jpeg_mem_src(&info_, reinterpret_cast<const unsigned char*>(source_.bytes.data()),
                 static_cast<unsigned long>(source_.bytes.size()));
    jpeg_read_header(&info_, TRUE);
  }

  [[noreturn]] void refuse() {
    char text[JMSG_LENGTH_MAX] = {};
    if (info_.input_scan_number > kMostScans) {
      std::snprintf(text, sizeof text, "more than %d scans", kMostScans);
    } else {
      info_.err->format_message(reinterpret_cast<j_common_ptr>(&info_), text);
    }
    const std::string why = text;
    jpeg_destroy_decompress(&info_);  // harmless if repeated; may run in the constructor
    refuse_damaged(source_, why);
  }

  PictureSource source_;
  jpeg_decompress_struct info_{};
  jpeg_progress_mgr progress_{};
  ErrorJump jump_;
};

}  // namespace

PictureContent read_jpeg(const PictureSource& source, PictureWish wish) {
  JpegLines lines(source);
  const jpeg_decompress_struct& info = lines.info();
  PictureContent content{.bits_per_sample = 8,
                         .is_floating = false,
                         .is_linear = false,
                         .tags = jpeg_tags(source.bytes)};
  const int channels = info.num_components;
  if (channels != 1 && channels != 3) {
    refuse_picture(source,
                   fmt::format("has {} colour components{}", channels,
                               channels == 4 ? ": CMYK, for print" : ""),
                   "give a grey or an RGB picture: convert it to sRGB first");
  }
  if (wish == PictureWish::header) {
    return content;
  }
  const std::uint64_t samples = std::uint64_t{info.image_width} * info.image_height *
                                static_cast<std::uint64_t>(channels);
  // A multi-scan picture is held as 16-bit coefficients.
  const std::uint64_t raw_bytes = lines.is_whole_in_memory() ? 3 * samples : samples;
  require_room(source, info.image_width, info.image_height,
               static_cast<std::uint64_t>(channels), raw_bytes);
  lines.start();
  content.pixels = Image<float>(static_cast<int>(info.output_height),
                                static_cast<int>(info.output_width), channels);
  std::vector<std::uint8_t> row(std::size_t{info.output_width} *
                                static_cast<std::size_t>(info.output_components));
  const ImageView<float> pixels = content.pixels.view();
  for (int y = 0; y < pixels.height(); ++y) {
    lines.read(row.data());
    std::transform(row.begin(), row.end(), pixels.row(y).begin(), unit_of<std::uint8_t>);
  }
  return content;
}

}  // namespace haarlight
