// SPDX-License-Identifier: Apache-2.0
#include "core/picture/jpeg.h"

#include <algorithm>
#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <jpeglib.h>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

/// A block of 64 pixels takes at least one bit; a fill of ones and a one-code table come near
/// that. A picture larger than its bytes can hold is damaged or malicious.
constexpr std::uint64_t kMostPixelsPerByte = 512;
constexpr int kLongestSide = 65500;  // libjpeg's JPEG_MAX_DIMENSION
constexpr int kMostScans = 100;

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

/// Opens a JPEG whose size its bytes can actually hold.
JpegDecoder open_sound(std::string_view source) {
  JpegDecoder decoder(std::as_bytes(std::span(source)));
  const auto width = static_cast<std::uint64_t>(decoder.width());
  const auto height = static_cast<std::uint64_t>(decoder.height());
  if (width * height > kMostPixelsPerByte * source.size()) {
    throw JpegDamage(fmt::format("{} x {} pixels in {} bytes", width, height, source.size()));
  }
  return decoder;
}

Error unsound(const JpegDamage& damage, const std::string& where) {
  return {fmt::format("not a sound JPEG picture: {}", damage.what()), where,
          "copy the file again from its source"};
}

class Encoder {
 public:
  explicit Encoder(std::string where) : where_(std::move(where)) { info_.err = set_up(error_); }
  ~Encoder() {
    jpeg_destroy_compress(&info_);
    std::free(data_);
  }
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;

  std::string encode(JpegShape shape, const JpegQuality& quality, const GiveRow& give) {
    start(shape, quality.channels, [&] {
      jpeg_set_quality(&info_, quality.quality, TRUE);
      for (int i = 0; i < quality.channels; ++i) {  // 4:4:4
        info_.comp_info[i].h_samp_factor = 1;
        info_.comp_info[i].v_samp_factor = 1;
      }
      info_.optimize_coding = quality.has_own_tables ? TRUE : FALSE;
    });
    return rows(shape, quality.channels, give);
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
      info_.optimize_coding = TRUE;
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

struct JpegDecoder::Impl {
  jpeg_decompress_struct info{};
  jpeg_progress_mgr progress{};
  JumpError error{};

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() { jpeg_destroy_decompress(&info); }

  template <class Call>
  void require(const Call& call) {
    if (!is_done(error, call)) {
      throw JpegDamage(error.message);
    }
  }
};

namespace {

/// libjpeg's progress monitor: called often while scans are read.
void count_scans(j_common_ptr info) {
  if (reinterpret_cast<j_decompress_ptr>(info)->input_scan_number > kMostScans) {
    auto* error = reinterpret_cast<JumpError*>(info->err);
    std::snprintf(error->message, sizeof error->message, "more than %d scans", kMostScans);
    std::longjmp(error->jump, 1);
  }
}

}  // namespace

JpegDecoder::JpegDecoder(std::span<const std::byte> source) : impl_(std::make_unique<Impl>()) {
  Impl& impl = *impl_;
  impl.info.err = set_up(impl.error);
  impl.progress.progress_monitor = count_scans;
  impl.require([&] {
    jpeg_create_decompress(&impl.info);
    impl.info.progress = &impl.progress;
    jpeg_mem_src(&impl.info, reinterpret_cast<const unsigned char*>(source.data()),
                 static_cast<unsigned long>(source.size()));
    jpeg_read_header(&impl.info, TRUE);
  });
}

JpegDecoder::~JpegDecoder() = default;
JpegDecoder::JpegDecoder(JpegDecoder&&) noexcept = default;
JpegDecoder& JpegDecoder::operator=(JpegDecoder&&) noexcept = default;

int JpegDecoder::width() const { return static_cast<int>(impl_->info.image_width); }
int JpegDecoder::height() const { return static_cast<int>(impl_->info.image_height); }
int JpegDecoder::n_components() const { return impl_->info.num_components; }
bool JpegDecoder::has_multiple_scans() const {
  return jpeg_has_multiple_scans(&impl_->info) != 0;
}
int JpegDecoder::next_row() const { return static_cast<int>(impl_->info.output_scanline); }
std::size_t JpegDecoder::n_bytes_left() const { return impl_->info.src->bytes_in_buffer; }

void JpegDecoder::start(int channels) {
  HAARLIGHT_EXPECTS(channels == 1 || channels == 3, "grey or RGB");
  impl_->require([&] {
    impl_->info.out_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_start_decompress(&impl_->info);
  });
}

void JpegDecoder::read(std::span<std::uint8_t> row) {
  const jpeg_decompress_struct& info = impl_->info;
  HAARLIGHT_EXPECTS(row.size() == std::size_t{info.output_width} *
                                      static_cast<std::size_t>(info.output_components) &&
                        info.output_scanline < info.output_height,
                    "one row of the picture");
  std::uint8_t* samples = row.data();
  impl_->require([&] { jpeg_read_scanlines(&impl_->info, &samples, 1); });
}

void JpegDecoder::skip(int n_rows) {
  impl_->require([&] { jpeg_skip_scanlines(&impl_->info, static_cast<JDIMENSION>(n_rows)); });
}

void JpegDecoder::finish() {
  impl_->require([&] { jpeg_finish_decompress(&impl_->info); });
}

JpegShape jpeg_shape(std::string_view source, const std::string& where) {
  try {
    const JpegDecoder decoder = open_sound(source);
    return {decoder.height(), decoder.width()};
  } catch (const JpegDamage& damage) {
    throw unsound(damage, where);
  }
}

void decode_jpeg(std::string_view source, int channels, const std::string& where,
                 const TakeRow& take) {
  try {
    JpegDecoder decoder = open_sound(source);
    decoder.start(channels);
    std::vector<std::uint8_t> row(static_cast<std::size_t>(decoder.width()) *
                                  static_cast<std::size_t>(channels));
    for (int y = 0; y < decoder.height(); ++y) {
      decoder.read(row);
      take(y, row);
    }
    decoder.finish();
  } catch (const JpegDamage& damage) {
    throw unsound(damage, where);
  }
}

namespace {

void require_shape(JpegShape shape, const std::string& where) {
  HAARLIGHT_EXPECTS(shape.width >= 1 && shape.height >= 1, "a picture");
  if (shape.width > kLongestSide || shape.height > kLongestSide) {
    throw Error(fmt::format("{} x {}: JPEG has at most {} pixels per side", shape.width,
                            shape.height, kLongestSide),
                where, "write a .ptm without --jpeg, or a .rti");
  }
}

}  // namespace

std::string encode_jpeg(JpegShape shape, const JpegQuality& quality, const std::string& where,
                        const GiveRow& give) {
  HAARLIGHT_EXPECTS(quality.channels == 1 || quality.channels == 3, "grey or RGB");
  HAARLIGHT_EXPECTS(quality.quality >= 1 && quality.quality <= 100, "quality 1 to 100");
  require_shape(shape, where);
  return Encoder(where).encode(shape, quality, give);
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
