// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/formats/jpeg.h"

#include <algorithm>
#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <jpeglib.h>

#include "core/error.h"

namespace haarlight {

namespace {

/// A block of 64 pixels takes at least one bit; a fill of ones and a one-code table come near
/// that. A picture larger than its bytes can hold is damaged or malicious.
constexpr std::uint64_t kMostPixelsPerByte = 512;
constexpr int kLongestSide = 65500;  // libjpeg's JPEG_MAX_DIMENSION

struct JumpError {
  jpeg_error_mgr base;
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX];
};

[[noreturn]] void leave(j_common_ptr info) {
  auto* error = reinterpret_cast<JumpError*>(info->err);
  info->err->format_message(info, error->message);
  std::longjmp(error->jump, 1);
}

/// A warning means damage: the rows after it are invented.
void leave_at_warning(j_common_ptr info, int level) {
  if (level < 0) {
    leave(info);
  }
}

void be_silent(j_common_ptr /*info*/) {}

jpeg_error_mgr* set_up(JumpError& error) {
  jpeg_error_mgr* manager = jpeg_std_error(&error.base);
  manager->error_exit = leave;
  manager->emit_message = leave_at_warning;
  manager->output_message = be_silent;
  error.message[0] = '\0';
  return manager;
}

/// Runs calls of libjpeg. They hold plain data only, since errors leave them by longjmp.
template <class Call>
bool is_done(JumpError& error, const Call& call) {
  if (setjmp(error.jump) != 0) {  // NOLINT(cert-err52-cpp): libjpeg knows no other way
    return false;
  }
  call();
  return true;
}

class Decoder {
 public:
  Decoder(std::string_view source, std::string where) : where_(std::move(where)) {
    info_.err = set_up(error_);
    const bool is_good = is_done(error_, [&] {
      jpeg_create_decompress(&info_);
      jpeg_mem_src(&info_, reinterpret_cast<const unsigned char*>(source.data()),
                   source.size());
      jpeg_read_header(&info_, TRUE);
    });
    if (!is_good) {
      const std::string message = error_.message;
      jpeg_destroy_decompress(&info_);
      throw damaged(message);
    }
    const std::uint64_t n_pixels =
        std::uint64_t{info_.image_width} * std::uint64_t{info_.image_height};
    if (n_pixels > kMostPixelsPerByte * source.size()) {
      const std::string message = fmt::format("{} x {} pixels in {} bytes", info_.image_width,
                                              info_.image_height, source.size());
      jpeg_destroy_decompress(&info_);
      throw damaged(message);
    }
  }
  ~Decoder() { jpeg_destroy_decompress(&info_); }
  Decoder(const Decoder&) = delete;
  Decoder& operator=(const Decoder&) = delete;

  [[nodiscard]] JpegShape shape() const {
    return {static_cast<int>(info_.image_height), static_cast<int>(info_.image_width)};
  }

  void decode(int channels, const TakeRow& take) {
    require(is_done(error_, [&] {
      info_.out_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
      jpeg_start_decompress(&info_);
    }));
    std::vector<std::uint8_t> row(static_cast<std::size_t>(info_.output_width) *
                                  static_cast<std::size_t>(channels));
    std::uint8_t* samples = row.data();
    while (info_.output_scanline < info_.output_height) {
      const auto y = static_cast<int>(info_.output_scanline);
      require(is_done(error_, [&] { jpeg_read_scanlines(&info_, &samples, 1); }));
      take(y, row);
    }
    require(is_done(error_, [&] { jpeg_finish_decompress(&info_); }));
  }

 private:
  [[nodiscard]] Error damaged(const std::string& message) const {
    return {fmt::format("not a sound JPEG picture: {}", message), where_,
            "copy the file again from its source"};
  }
  void require(bool is_good) const {
    if (!is_good) {
      throw damaged(error_.message);
    }
  }

  std::string where_;
  jpeg_decompress_struct info_{};
  JumpError error_{};
};

class Encoder {
 public:
  explicit Encoder(std::string where) : where_(std::move(where)) { info_.err = set_up(error_); }
  ~Encoder() {
    jpeg_destroy_compress(&info_);
    std::free(data_);
  }
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;

  std::string encode(JpegShape shape, int channels, int quality, const GiveRow& give) {
    start(shape, channels, [&] {
      jpeg_set_quality(&info_, quality, TRUE);
      for (int i = 0; i < channels; ++i) {  // 4:4:4
        info_.comp_info[i].h_samp_factor = 1;
        info_.comp_info[i].v_samp_factor = 1;
      }
    });
    return rows(shape, channels, give);
  }

  std::string encode(JpegShape shape, const JpegSteps& steps, const GiveRow& give) {
    start(shape, 3, [&] {
      jpeg_set_colorspace(&info_, steps.is_ycc ? JCS_YCbCr : JCS_RGB);
      for (int i = 0; i < 3; ++i) {
        std::array<unsigned, DCTSIZE2> flat{};
        flat.fill(static_cast<unsigned>(steps.step[static_cast<std::size_t>(i)]));
        jpeg_add_quant_table(&info_, i, flat.data(), 100, TRUE);
        jpeg_component_info& part = info_.comp_info[i];
        part.h_samp_factor = 1;
        part.v_samp_factor = 1;
        part.quant_tbl_no = i;
        // Every decoder supports two code tables.
        part.dc_tbl_no = i == 0 ? 0 : 1;
        part.ac_tbl_no = i == 0 ? 0 : 1;
      }
    });
    return rows(shape, 3, give);
  }

 private:
  template <class Call>
  void start(JpegShape shape, int channels, const Call& set_up_coding) {
    require(is_done(error_, [&] {
      jpeg_create_compress(&info_);
      jpeg_mem_dest(&info_, &data_, &size_);
      info_.image_width = static_cast<JDIMENSION>(shape.width);
      info_.image_height = static_cast<JDIMENSION>(shape.height);
      info_.input_components = channels;
      info_.in_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
      jpeg_set_defaults(&info_);
      set_up_coding();
      info_.optimize_coding = TRUE;
      jpeg_start_compress(&info_, TRUE);
    }));
  }

  std::string rows(JpegShape shape, int channels, const GiveRow& give) {
    std::vector<std::uint8_t> row(static_cast<std::size_t>(shape.width) *
                                  static_cast<std::size_t>(channels));
    std::uint8_t* samples = row.data();
    for (int y = 0; y < shape.height; ++y) {
      give(y, row);
      require(is_done(error_, [&] { jpeg_write_scanlines(&info_, &samples, 1); }));
    }
    require(is_done(error_, [&] { jpeg_finish_compress(&info_); }));
    return {reinterpret_cast<const char*>(data_), size_};
  }

  void require(bool is_good) const {
    if (!is_good) {
      throw Error(fmt::format("the picture cannot be written as JPEG: {}", error_.message),
                  where_, "report it", ExitCode::internal);
    }
  }

  std::string where_;
  jpeg_compress_struct info_{};
  JumpError error_{};
  unsigned char* data_ = nullptr;
  unsigned long size_ = 0;  // NOLINT(google-runtime-int): libjpeg's type
};

}  // namespace

JpegShape jpeg_shape(std::string_view source, const std::string& where) {
  return Decoder(source, where).shape();
}

void decode_jpeg(std::string_view source, int channels, const std::string& where,
                 const TakeRow& take) {
  HAARLIGHT_EXPECTS(channels == 1 || channels == 3, "grey or RGB");
  Decoder(source, where).decode(channels, take);
}

namespace {

void require_shape(JpegShape shape, const std::string& where) {
  HAARLIGHT_EXPECTS(shape.width >= 1 && shape.height >= 1, "a picture");
  if (shape.width > kLongestSide || shape.height > kLongestSide) {
    throw Error(fmt::format("{} x {}: JPEG has at most {} pixels a side", shape.width,
                            shape.height, kLongestSide),
                where, "write a .ptm without --jpeg, or a .rti");
  }
}

}  // namespace

std::string encode_jpeg(JpegShape shape, int channels, int quality, const std::string& where,
                        const GiveRow& give) {
  HAARLIGHT_EXPECTS(channels == 1 || channels == 3, "grey or RGB");
  HAARLIGHT_EXPECTS(quality >= 1 && quality <= 100, "quality 1 to 100");
  require_shape(shape, where);
  return Encoder(where).encode(shape, channels, quality, give);
}

std::string encode_jpeg(JpegShape shape, const JpegSteps& steps, const std::string& where,
                        const GiveRow& give) {
  HAARLIGHT_EXPECTS(std::all_of(steps.step.begin(), steps.step.end(),
                                [](int step) { return step >= 1 && step <= 255; }),
                    "steps of 1 to 255");
  require_shape(shape, where);
  return Encoder(where).encode(shape, steps, give);
}

}  // namespace haarlight
