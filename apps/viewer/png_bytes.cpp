#include "apps/viewer/png_bytes.h"

#include <csetjmp>
#include <utility>
#include <vector>

#include <png.h>

#include "core/error.h"

namespace haarlight {

namespace {

/// libpng leaves its calls by longjmp: no C++ object may live between guard and jump.
class TileWriter {
 public:
  TileWriter() {
    png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, keep_quiet);
    info_ = png_ != nullptr ? png_create_info_struct(png_) : nullptr;
  }
  ~TileWriter() { png_destroy_write_struct(&png_, &info_); }
  TileWriter(const TileWriter&) = delete;
  TileWriter& operator=(const TileWriter&) = delete;

  std::string write(int height, int width, std::uint8_t** rows) {
    if (info_ == nullptr || setjmp(png_jmpbuf(png_)) != 0) {  // NOLINT(cert-err52-cpp)
      throw Error("the tile cannot be packed", "publish", "report it", ExitCode::internal);
    }
    png_set_write_fn(png_, &bytes_, put, nullptr);
    png_set_IHDR(png_, info_, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height),
                 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_compression_level(png_, kLevel);
    png_set_filter(png_, PNG_FILTER_TYPE_BASE, PNG_FILTER_PAETH);
    png_write_info(png_, info_);
    png_write_image(png_, rows);
    png_write_end(png_, nullptr);
    return std::move(bytes_);
  }

 private:
  static constexpr int kLevel =
      3;  // noise packs no better at 6, which takes three times as long

  static void keep_quiet(png_structp /*png*/, png_const_charp /*message*/) {}
  static void put(png_structp png, png_bytep data, png_size_t n) {
    static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<char*>(data), n);
  }

  std::string bytes_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
};

}  // namespace

std::string encode_png(int height, int width, const GiveTileRow& give) {
  HAARLIGHT_EXPECTS(height > 0 && width > 0, "a tile of pixels");
  const std::size_t row_bytes = 3 * static_cast<std::size_t>(width);
  std::vector<std::uint8_t> samples(row_bytes * static_cast<std::size_t>(height));
  std::vector<std::uint8_t*> rows;
  rows.reserve(static_cast<std::size_t>(height));
  for (int y = 0; y < height; ++y) {
    rows.push_back(&samples[row_bytes * static_cast<std::size_t>(y)]);
    give(y, std::span(rows.back(), row_bytes));
  }
  return TileWriter().write(height, width, rows.data());
}

}  // namespace haarlight
