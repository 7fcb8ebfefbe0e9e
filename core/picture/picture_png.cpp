// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csetjmp>
#include <cstring>
#include <string>
#include <vector>

#include <png.h>
#include <zlib.h>

#include "core/picture/picture_formats.h"
#include "core/picture/png_tile.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

/// libpng's last error message; libpng leaves its calls by longjmp, skipping destructors, so no
/// C++ object may live between setjmp and longjmp.
struct Complaint {
  char text[200] = {};
};

void jump_back(png_structp png, png_const_charp message) {
  std::strncpy(static_cast<Complaint*>(png_get_error_ptr(png))->text, message,
               sizeof(Complaint::text) - 1);
  png_longjmp(png, 1);
}

void keep_quiet(png_structp /*png*/, png_const_charp /*message*/) {}

/// One PNG being decoded: samples of 8 or 16 bits, 1 or 3 channels, no alpha.
class PngLines {
  static constexpr int kNotOursCount = 4;
  static constexpr png_byte kNotOurs[] = "iCCP\0gAMA\0cHRM\0eXIf";

 public:
  explicit PngLines(const PictureSource& source) : source_(source) {
    png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, &complaint_, jump_back, keep_quiet);
    info_ = png_ != nullptr ? png_create_info_struct(png_) : nullptr;
    open();
  }
  ~PngLines() { png_destroy_read_struct(&png_, &info_, nullptr); }
  PngLines(const PngLines&) = delete;
  PngLines& operator=(const PngLines&) = delete;

  [[nodiscard]] std::uint32_t width() const { return png_get_image_width(png_, info_); }
  [[nodiscard]] std::uint32_t height() const { return png_get_image_height(png_, info_); }
  [[nodiscard]] int channels() const { return png_get_channels(png_, info_); }
  [[nodiscard]] int bits() const { return png_get_bit_depth(png_, info_); }
  [[nodiscard]] bool is_interlaced() const {
    return png_get_interlace_type(png_, info_) != PNG_INTERLACE_NONE;
  }
  /// 16-bit samples big-endian
  void read(std::uint8_t* row) {
    if (setjmp(png_jmpbuf(png_)) != 0) {  // NOLINT(cert-err52-cpp): libpng knows no other way
      refuse();
    }
    png_read_row(png_, row, nullptr);
  }
  void read_all(std::uint8_t** rows) {
    if (setjmp(png_jmpbuf(png_)) != 0) {  // NOLINT(cert-err52-cpp)
      refuse();
    }
    png_read_image(png_, rows);
  }

 private:
  static void take(png_structp png, png_bytep out, png_size_t n) {
    auto* lines = static_cast<PngLines*>(png_get_io_ptr(png));
    if (n > lines->source_.bytes.size() - lines->at_) {
      png_error(png, "ends before the picture does");
    }
    std::memcpy(out, lines->source_.bytes.data() + lines->at_, n);
    lines->at_ += n;
  }

  void open() {
    if (info_ == nullptr || setjmp(png_jmpbuf(png_)) != 0) {  // NOLINT(cert-err52-cpp)
      refuse();
    }
    png_set_read_fn(png_, this, take);
    // picture_tags.h reads these.
    png_set_keep_unknown_chunks(png_, PNG_HANDLE_CHUNK_NEVER, kNotOurs, kNotOursCount);
    png_read_info(png_, info_);
    png_set_expand(png_);
    png_set_strip_alpha(png_);
    png_set_interlace_handling(png_);
    png_read_update_info(png_, info_);
  }

  [[noreturn]] void refuse() {
    const std::string why = complaint_.text;
    png_destroy_read_struct(&png_, &info_, nullptr);
    refuse_damaged(source_, why);
  }

  PictureSource source_;
  std::size_t at_ = 0;
  Complaint complaint_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
};

void to_floats(const std::uint8_t* row, int bits, std::span<float> out) {
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = bits == 16 ? unit_of(static_cast<std::uint16_t>(row[2 * i] << 8U | row[2 * i + 1]))
                        : unit_of(row[i]);
  }
}

}  // namespace

PictureContent read_png(const PictureSource& source, PictureWish wish) {
  PngLines lines(source);
  PictureContent content{.bits_per_sample = lines.bits(),
                         .is_floating = false,
                         .is_linear = false,
                         .tags = png_tags(source.bytes)};
  if (wish == PictureWish::header) {
    return content;
  }
  const auto channels = static_cast<std::size_t>(lines.channels());
  const std::size_t row_bytes =
      std::size_t{lines.width()} * channels * (lines.bits() == 16 ? 2U : 1U);
  require_room(source, lines.width(), lines.height(), channels, row_bytes * lines.height());
  content.pixels = Image<float>(static_cast<int>(lines.height()),
                                static_cast<int>(lines.width()), lines.channels());
  const ImageView<float> pixels = content.pixels.view();
  if (!lines.is_interlaced()) {
    std::vector<std::uint8_t> row(row_bytes);
    for (int y = 0; y < pixels.height(); ++y) {
      lines.read(row.data());
      to_floats(row.data(), lines.bits(), pixels.row(y));
    }
    return content;
  }
  std::vector<std::uint8_t> all(row_bytes * lines.height());
  std::vector<std::uint8_t*> rows(lines.height());
  for (std::size_t y = 0; y < rows.size(); ++y) {
    rows[y] = &all[y * row_bytes];
  }
  lines.read_all(rows.data());
  for (int y = 0; y < pixels.height(); ++y) {
    to_floats(rows[static_cast<std::size_t>(y)], lines.bits(), pixels.row(y));
  }
  return content;
}

namespace {

/// How a PNG is to be written.
struct PngStyle {
  int level = 6;  ///< zlib's own choice between time and size
  int strategy = Z_DEFAULT_STRATEGY;
  int filters = PNG_NO_FILTERS;
  bool is_srgb = true;  ///< else no colour information
  std::span<std::byte> exif = {};
};

/// One PNG being written into memory.
class PngWriter {
 public:
  PngWriter() {
    png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, &complaint_, jump_back, keep_quiet);
    info_ = png_ != nullptr ? png_create_info_struct(png_) : nullptr;
  }
  ~PngWriter() { png_destroy_write_struct(&png_, &info_); }
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;

  /// @param rows  of 8-bit samples
  std::vector<std::byte> write(ImageView<const std::uint8_t> image, std::uint8_t** rows,
                               std::span<png_text> texts, const PngStyle& style) {
    if (info_ == nullptr || setjmp(png_jmpbuf(png_)) != 0) {  // NOLINT(cert-err52-cpp)
      refuse_encoding(complaint_.text);
    }
    png_set_write_fn(png_, this, put, nullptr);
    png_set_IHDR(png_, info_, static_cast<png_uint_32>(image.width()),
                 static_cast<png_uint_32>(image.height()), 8,
                 image.channels() == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_compression_level(png_, style.level);
    png_set_compression_strategy(png_, style.strategy);
    png_set_filter(png_, PNG_FILTER_TYPE_BASE, style.filters);
    if (style.is_srgb) {
      png_set_sRGB_gAMA_and_cHRM(png_, info_, PNG_sRGB_INTENT_RELATIVE);
    }
    if (!style.exif.empty()) {
      png_set_eXIf_1(png_, info_, static_cast<png_uint_32>(style.exif.size()),
                     reinterpret_cast<png_bytep>(style.exif.data()));
    }
    png_set_text(png_, info_, texts.data(), static_cast<int>(texts.size()));
    png_write_info(png_, info_);
    png_write_image(png_, rows);
    png_write_end(png_, info_);
    return std::move(bytes_);
  }

 private:
  static void put(png_structp png, png_bytep data, png_size_t n) {
    auto& bytes = static_cast<PngWriter*>(png_get_io_ptr(png))->bytes_;
    const auto* first = reinterpret_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), first, first + n);
  }

  Complaint complaint_;
  std::vector<std::byte> bytes_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
};

std::vector<std::byte> write_png(ImageView<const std::uint8_t> image, std::span<png_text> texts,
                                 const PngStyle& style) {
  std::vector<std::uint8_t*> rows;
  rows.reserve(static_cast<std::size_t>(image.height()));
  for (int y = 0; y < image.height(); ++y) {  // libpng reads them only
    rows.push_back(const_cast<std::uint8_t*>(image.row(y).data()));
  }
  return PngWriter().write(image, rows.data(), texts, style);
}

}  // namespace

std::vector<std::byte> png_bytes(ImageView<const std::uint8_t> image, const PictureNotes& notes,
                                 PngPacking packing) {
  // libpng takes non-const pointers to what it only reads.
  std::vector<PictureNote> own = notes.texts;
  std::vector<png_text> texts;
  texts.reserve(own.size());
  for (PictureNote& note : own) {
    png_text text{};
    text.compression = PNG_TEXT_COMPRESSION_NONE;
    text.key = note.name.data();
    text.text = note.text.data();
    texts.push_back(text);
  }
  std::vector<std::byte> exif = exif_block(notes.facts);
  PngStyle style{.exif = exif};
  if (packing == PngPacking::photograph) {
    style.level = 1;
    style.strategy = Z_RLE;
  }
  return write_png(image, texts, style);
}

std::string encode_png(int height, int width, const GiveTileRow& give) {
  HAARLIGHT_EXPECTS(height > 0 && width > 0, "a tile of pixels");
  Image<std::uint8_t> tile(height, width, 3);
  const ImageView<std::uint8_t> samples = tile.view();
  for (int y = 0; y < height; ++y) {
    give(y, samples.row(y));
  }
  // Noise compresses no better at 6, which takes three times as long.
  const std::vector<std::byte> bytes = write_png(
      samples, {}, {.level = 3, .filters = PNG_FILTER_PAETH, .is_srgb = false, .exif = {}});
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace haarlight
