#include "apps/viewer/png_bytes.h"

#include <array>
#include <cstdlib>
#include <string_view>
#include <vector>

#include <zlib.h>

#include "core/error.h"

namespace haarlight {

namespace {

constexpr std::size_t kPixel = 3;  ///< bytes

void add_u32(std::string& out, std::uint32_t value) {
  for (const unsigned shift : {24U, 16U, 8U, 0U}) {
    out += static_cast<char>(static_cast<unsigned char>(value >> shift));
  }
}

void add_chunk(std::string& png, std::string_view kind, std::string_view body) {
  add_u32(png, static_cast<std::uint32_t>(body.size()));
  const std::size_t start = png.size();
  png += kind;
  png += body;
  add_u32(png, static_cast<std::uint32_t>(
                   ::crc32(0, reinterpret_cast<const Bytef*>(png.data() + start),
                           static_cast<uInt>(png.size() - start))));
}

/// PNG's filter 4: what the left, upper and upper left neighbour let expect.
int paeth(int left, int up, int corner) {
  const int guess = left + up - corner;
  const int to_left = std::abs(guess - left);
  const int to_up = std::abs(guess - up);
  const int to_corner = std::abs(guess - corner);
  if (to_left <= to_up && to_left <= to_corner) {
    return left;
  }
  return to_up <= to_corner ? up : corner;
}

}  // namespace

std::string encode_png(int height, int width, const GiveTileRow& give) {
  HAARLIGHT_EXPECTS(height > 0 && width > 0, "a tile of pixels");
  const std::size_t row_bytes = kPixel * static_cast<std::size_t>(width);
  std::string lines;
  lines.reserve(static_cast<std::size_t>(height) * (row_bytes + 1));
  std::vector<std::uint8_t> above(row_bytes, 0);
  std::vector<std::uint8_t> row(row_bytes, 0);
  for (int y = 0; y < height; ++y) {
    give(y, row);
    lines += '\4';
    for (std::size_t i = 0; i < row_bytes; ++i) {
      const int left = i >= kPixel ? row[i - kPixel] : 0;
      const int corner = i >= kPixel ? above[i - kPixel] : 0;
      lines +=
          static_cast<char>(static_cast<unsigned char>(row[i] - paeth(left, above[i], corner)));
    }
    above.swap(row);
  }
  uLongf size = ::compressBound(static_cast<uLong>(lines.size()));
  std::string packed(size, '\0');
  constexpr int kLevel = 3;  // noise packs no better at 6, which takes three times as long
  if (::compress2(reinterpret_cast<Bytef*>(packed.data()), &size,
                  reinterpret_cast<const Bytef*>(lines.data()),
                  static_cast<uLong>(lines.size()), kLevel) != Z_OK) {
    throw Error("the tile cannot be packed", "publish", "report it", ExitCode::internal);
  }
  packed.resize(size);
  std::string header;
  add_u32(header, static_cast<std::uint32_t>(width));
  add_u32(header, static_cast<std::uint32_t>(height));
  header += std::string("\x08\x02\x00\x00\x00", 5);  // 8 bits, R G B
  std::string png = "\x89PNG\r\n\x1a\n";
  add_chunk(png, "IHDR", header);
  add_chunk(png, "IDAT", packed);
  add_chunk(png, "IEND", {});
  return png;
}

}  // namespace haarlight
