// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/preview_png.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>
#include <vector>

#include <zlib.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr int kPreviewWidth = 640;
constexpr int kTableSize = 4096;

/// Codes for kTableSize equal steps from black to white.
const std::array<std::uint8_t, kTableSize>& code_table() {
  static const std::array<std::uint8_t, kTableSize> kTable = [] {
    std::array<std::uint8_t, kTableSize> table{};
    for (int i = 0; i < kTableSize; ++i) {
      const double linear = (i + 0.5) / kTableSize;
      const double encoded =
          linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1.0 / 2.4) - 0.055;
      table[static_cast<std::size_t>(i)] =
          static_cast<std::uint8_t>(std::lround(encoded * kCodeWhitest));
    }
    return table;
  }();
  return kTable;
}

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
  const auto checksum = ::crc32(0, reinterpret_cast<const Bytef*>(png.data() + start),
                                static_cast<uInt>(png.size() - start));
  add_u32(png, static_cast<std::uint32_t>(checksum));
}

std::string palette() {
  std::string colours;
  for (int code = 0; code <= kCodeWhitest; ++code) {
    const auto grey =
        static_cast<char>(static_cast<unsigned char>(std::lround(255.0 * code / kCodeWhitest)));
    colours.append(3, grey);
  }
  colours += "\x1e\x50\xff";  // black: blue
  colours += "\xff\x20\x20";  // saturated: red
  return colours;
}

}  // namespace

GreyCurve::GreyCurve(double black, double white)
    : black_(black), scale_(kTableSize / (white - black)) {
  HAARLIGHT_EXPECTS(black < white, "two levels");
}

std::uint8_t GreyCurve::operator()(double word) const {
  const double position = std::clamp((word - black_) * scale_, 0.0, kTableSize - 1.0);
  return code_table()[static_cast<std::size_t>(position)];
}

int preview_step(int width, int height, BayerPattern bayer) {
  const int step = std::max(1, (std::max(width, height) + kPreviewWidth - 1) / kPreviewWidth);
  return bayer == BayerPattern::none || step == 1 ? step : step + step % 2;
}

Image<std::uint8_t> make_preview_codes(ImageView<const std::uint16_t> words, double black,
                                       double white, int step) {
  HAARLIGHT_EXPECTS(step >= 1, "a picture of step >= 1");
  const GreyCurve curve(black, white);
  Image<std::uint8_t> codes((words.height() + step - 1) / step,
                            (words.width() + step - 1) / step, 1);
  const auto width = static_cast<std::size_t>(codes.width());
  const auto block = static_cast<std::size_t>(step);
  std::vector<std::uint16_t> greatest(width);
  std::vector<std::uint64_t> sums(width);
  for (int y = 0; y < codes.height(); ++y) {
    std::fill(greatest.begin(), greatest.end(), std::uint16_t{0});
    std::fill(sums.begin(), sums.end(), std::uint64_t{0});
    const int end_row = std::min((y + 1) * step, words.height());
    for (int row = y * step; row < end_row; ++row) {
      const auto line = words.row(row);
      for (std::size_t x = 0; x < width; ++x) {
        const std::size_t end = std::min((x + 1) * block, line.size());
        std::uint16_t most = greatest[x];
        std::uint64_t sum = 0;
        for (std::size_t i = x * block; i < end; ++i) {
          most = std::max(most, line[i]);
          sum += line[i];
        }
        greatest[x] = most;
        sums[x] += sum;
      }
    }
    for (std::size_t x = 0; x < width; ++x) {
      const std::size_t columns = std::min((x + 1) * block, words.row(0).size()) - x * block;
      const double n = static_cast<double>(columns) * (end_row - y * step);
      codes(y, static_cast<int>(x)) = greatest[x] >= white ? kCodeSaturated
                                      : greatest[x] <= black
                                          ? kCodeBlack
                                          : curve(static_cast<double>(sums[x]) / n);
    }
  }
  return codes;
}

double saturated_fraction_of(ImageView<const std::uint8_t> codes) {
  std::ptrdiff_t n = 0;
  for (int y = 0; y < codes.height(); ++y) {
    const auto row = codes.row(y);
    n += std::count(row.begin(), row.end(), kCodeSaturated);
  }
  return static_cast<double>(n) /
         std::max(1.0, static_cast<double>(codes.height()) * codes.width());
}

std::string encode_preview_png(ImageView<const std::uint8_t> codes) {
  HAARLIGHT_EXPECTS(!codes.is_empty() && codes.channels() == 1, "a picture of codes");
  std::string lines;
  lines.reserve(static_cast<std::size_t>(codes.height()) *
                (static_cast<std::size_t>(codes.width()) + 1));
  for (int y = 0; y < codes.height(); ++y) {
    const auto row = codes.row(y);
    lines += '\0';  // no filter
    lines.append(reinterpret_cast<const char*>(row.data()), row.size());
  }
  uLongf size = ::compressBound(static_cast<uLong>(lines.size()));
  std::string packed(size, '\0');
  if (::compress2(reinterpret_cast<Bytef*>(packed.data()), &size,
                  reinterpret_cast<const Bytef*>(lines.data()),
                  static_cast<uLong>(lines.size()), Z_BEST_SPEED) != Z_OK) {
    throw Error("the picture cannot be packed", "preview", "report it", ExitCode::internal);
  }
  packed.resize(size);
  std::string header;
  add_u32(header, static_cast<std::uint32_t>(codes.width()));
  add_u32(header, static_cast<std::uint32_t>(codes.height()));
  header += std::string("\x08\x03\x00\x00\x00", 5);  // 8 bits, indexed
  std::string png = "\x89PNG\r\n\x1a\n";
  add_chunk(png, "IHDR", header);
  add_chunk(png, "PLTE", palette());
  add_chunk(png, "IDAT", packed);
  add_chunk(png, "IEND", {});
  return png;
}

}  // namespace haarlight::capture
