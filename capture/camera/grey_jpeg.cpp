// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/grey_jpeg.h"

#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <jpeglib.h>

#include "core/error.h"

namespace haarlight {

namespace {

struct JumpError {
  jpeg_error_mgr base;
  std::jmp_buf jump;
};

[[noreturn]] void leave(j_common_ptr info) {
  std::longjmp(reinterpret_cast<JumpError*>(info->err)->jump, 1);
}

/// Only plain data between setjmp and longjmp.
struct JpegBuffer {
  unsigned char* data = nullptr;
  unsigned long size = 0;  // libjpeg's type
};

bool compress(ImageView<const std::uint8_t> grey, int quality, JpegBuffer& out) {
  jpeg_compress_struct info{};
  JumpError error{};
  info.err = jpeg_std_error(&error.base);
  error.base.error_exit = leave;
  if (setjmp(error.jump) != 0) {  // NOLINT(cert-err52-cpp): libjpeg knows no other way
    jpeg_destroy_compress(&info);
    return false;
  }
  jpeg_create_compress(&info);
  jpeg_mem_dest(&info, &out.data, &out.size);
  info.image_width = static_cast<JDIMENSION>(grey.width());
  info.image_height = static_cast<JDIMENSION>(grey.height());
  info.input_components = 1;
  info.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, quality, TRUE);
  jpeg_start_compress(&info, TRUE);
  while (info.next_scanline < info.image_height) {
    auto* row = const_cast<JSAMPLE*>(grey.row(static_cast<int>(info.next_scanline)).data());
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  return true;
}

/// `row` holds one row of samples; both buffers belong to the caller.
bool decompress(std::span<const std::byte> source, ImageView<std::uint16_t> words,
                JSAMPLE* row) {
  jpeg_decompress_struct info{};
  JumpError error{};
  info.err = jpeg_std_error(&error.base);
  error.base.error_exit = leave;
  error.base.output_message = [](j_common_ptr) {};
  if (setjmp(error.jump) != 0) {  // NOLINT(cert-err52-cpp): libjpeg knows no other way
    jpeg_destroy_decompress(&info);
    return false;
  }
  jpeg_create_decompress(&info);
  jpeg_mem_src(&info, reinterpret_cast<const unsigned char*>(source.data()), source.size());
  bool is_good = jpeg_read_header(&info, TRUE) == JPEG_HEADER_OK &&
                 info.image_width == static_cast<JDIMENSION>(words.width()) &&
                 info.image_height == static_cast<JDIMENSION>(words.height());
  if (is_good) {
    info.out_color_space = JCS_GRAYSCALE;
    jpeg_start_decompress(&info);
    while (info.output_scanline < info.output_height) {
      const int y = static_cast<int>(info.output_scanline);
      jpeg_read_scanlines(&info, &row, 1);
      for (int x = 0; x < words.width(); ++x) {
        words(y, x) = row[x];
      }
    }
    jpeg_finish_decompress(&info);
    is_good = error.base.num_warnings == 0;
  }
  jpeg_destroy_decompress(&info);
  return is_good;
}

}  // namespace

bool decode_grey_jpeg(std::span<const std::byte> source, ImageView<std::uint16_t> words) {
  if (source.empty() || words.is_empty()) {
    return false;
  }
  std::vector<JSAMPLE> row(static_cast<std::size_t>(words.width()));
  return decompress(source, words, row.data());
}

std::string encode_grey_jpeg(ImageView<const std::uint8_t> grey, int quality) {
  HAARLIGHT_EXPECTS(!grey.is_empty() && grey.channels() == 1, "a grey picture");
  JpegBuffer buffer;
  const bool is_good = compress(grey, quality, buffer);
  std::string text(reinterpret_cast<const char*>(buffer.data), is_good ? buffer.size : 0);
  std::free(buffer.data);
  if (!is_good) {
    throw Error("the picture cannot be encoded as JPEG", "preview", "report it",
                ExitCode::internal);
  }
  return text;
}

}  // namespace haarlight
