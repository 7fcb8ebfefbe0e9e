// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include "core/picture/picture_formats.h"

/// @file
/// Radiance's RGBE pictures. Source: G. Ward, "Real pixels", Graphics Gems II (1991) 80-83; the
/// later row-wise run-length code as in Radiance's documentation of picture files.

namespace haarlight {

namespace {

using Rgbe = std::array<std::uint8_t, 4>;

/// Walks over the file; refuses to read past its end.
class HdrBytes {
 public:
  explicit HdrBytes(const PictureSource& source) : source_(source) {}

  std::uint8_t next() {
    if (at_ == source_.bytes.size()) {
      refuse_damaged(source_, "it ends before the picture does");
    }
    return std::to_integer<std::uint8_t>(source_.bytes[at_++]);
  }
  Rgbe next_pixel() {
    Rgbe pixel{};
    for (std::uint8_t& value : pixel) {
      value = next();
    }
    return pixel;
  }
  std::string_view next_line() {
    const std::string_view rest(reinterpret_cast<const char*>(source_.bytes.data()) + at_,
                                source_.bytes.size() - at_);
    const std::size_t end = rest.find('\n');
    if (end == std::string_view::npos) {
      refuse_damaged(source_, "it ends within its header");
    }
    at_ += end + 1;
    return rest.substr(0, end);
  }

 private:
  const PictureSource& source_;
  std::size_t at_ = 0;
};

struct HdrSize {
  int n_rows = 0;
  int n_columns = 0;
  int orientation = 1;
};

/// "-Y 512 +X 1024": rows first, downwards; the seven other orders and directions are EXIF's
/// orientations 2 to 8.
std::optional<HdrSize> size_of(std::string_view line) {
  constexpr std::array<std::string_view, 8> kOrders{"-Y+X", "-Y-X", "+Y-X", "+Y+X",
                                                    "+X-Y", "+X+Y", "-X+Y", "-X-Y"};
  std::string order;
  std::array<int, 2> numbers{};
  const auto skip_spaces = [&line] {
    line.remove_prefix(std::min(line.find_first_not_of(' '), line.size()));
  };
  for (int& number : numbers) {
    skip_spaces();
    if (line.size() < 2) {
      return std::nullopt;
    }
    order += line.substr(0, 2);
    line.remove_prefix(2);
    skip_spaces();
    const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), number);
    if (error != std::errc() || number < 1) {
      return std::nullopt;
    }
    line.remove_prefix(static_cast<std::size_t>(end - line.data()));
  }
  const auto* const found = std::find(kOrders.begin(), kOrders.end(), order);
  if (found == kOrders.end()) {
    return std::nullopt;
  }
  return HdrSize{numbers[0], numbers[1], static_cast<int>(found - kOrders.begin()) + 1};
}

HdrSize read_header(const PictureSource& source, HdrBytes& bytes) {
  std::string format;
  bytes.next_line();  // the magic
  for (std::string_view line = bytes.next_line(); !line.empty(); line = bytes.next_line()) {
    constexpr std::string_view kFormat = "FORMAT=";
    if (line.starts_with(kFormat)) {
      format = line.substr(kFormat.size());
    }
  }
  if (format != "32-bit_rle_rgbe") {
    refuse_picture(source,
                   format.empty() ? "its header has no FORMAT"
                                  : fmt::format("its FORMAT is {:.40}", format),
                   "only FORMAT=32-bit_rle_rgbe is read: convert it");
  }
  const std::string_view line = bytes.next_line();
  const std::optional<HdrSize> size = size_of(line);
  if (!size) {
    refuse_damaged(source, fmt::format("its size reads \"{:.40}\"", line));
  }
  return *size;
}

/// A row whose four components are run-length coded one after another; its four-byte header has
/// been read already.
void read_coded_row(const PictureSource& source, HdrBytes& bytes, std::span<Rgbe> row) {
  for (std::size_t c = 0; c < 4; ++c) {
    std::size_t x = 0;
    while (x < row.size()) {
      constexpr std::size_t kRun = 128;
      const std::size_t code = bytes.next();
      const bool is_run = code > kRun;
      const std::size_t n = is_run ? code - kRun : code;
      if (n == 0 || n > row.size() - x) {
        refuse_damaged(source, "a run of pixels is longer than its row");
      }
      const std::uint8_t value = is_run ? bytes.next() : std::uint8_t{0};
      for (const std::size_t end = x + n; x < end; ++x) {
        row[x][c] = is_run ? value : bytes.next();
      }
    }
  }
}

/// A row of whole pixels; (1, 1, 1, n) repeats the pixel before it n times, further ones 256 n
/// times, and so on.
void read_plain_row(const PictureSource& source, HdrBytes& bytes, Rgbe pixel,
                    std::span<Rgbe> row) {
  unsigned shift = 0;
  for (std::size_t x = 0; x < row.size();) {
    if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1) {
      const std::size_t n = shift < 32 ? std::size_t{pixel[3]} << shift : row.size();
      if (x == 0 || n > row.size() - x) {
        refuse_damaged(source, "a run of pixels leaves its row");
      }
      std::fill_n(row.begin() + static_cast<std::ptrdiff_t>(x), n, row[x - 1]);
      x += n;
      shift += 8;
    } else {
      row[x++] = pixel;
      shift = 0;
    }
    if (x < row.size()) {
      pixel = bytes.next_pixel();
    }
  }
}

void read_row(const PictureSource& source, HdrBytes& bytes, std::span<Rgbe> row) {
  constexpr std::size_t kLeast = 8;
  constexpr std::size_t kMost = 0x7fff;
  const Rgbe first = bytes.next_pixel();
  const bool is_coded = first[0] == 2 && first[1] == 2 && (first[2] & 0x80U) == 0 &&
                        row.size() >= kLeast && row.size() <= kMost;
  if (!is_coded) {
    read_plain_row(source, bytes, first, row);
    return;
  }
  if (first[2] * std::size_t{256} + first[3] != row.size()) {
    refuse_damaged(source, "a row has another width than the picture");
  }
  read_coded_row(source, bytes, row);
}

}  // namespace

PictureContent read_hdr(const PictureSource& source, PictureWish wish) {
  HdrBytes bytes(source);
  const HdrSize size = read_header(source, bytes);
  PictureContent content;
  content.tags.facts.orientation = size.orientation;
  if (wish == PictureWish::header) {
    return content;
  }
  const auto n_columns = static_cast<std::uint64_t>(size.n_columns);
  const auto n_rows = static_cast<std::uint64_t>(size.n_rows);
  require_room(source, n_columns, n_rows, 3,
               std::min(n_columns, std::uint64_t{1} << 20U) * n_rows * sizeof(Rgbe));
  content.pixels = Image<float>(size.n_rows, size.n_columns, 3);
  std::vector<Rgbe> row(n_columns);
  const ImageView<float> pixels = content.pixels.view();
  for (int y = 0; y < size.n_rows; ++y) {
    read_row(source, bytes, row);
    for (int x = 0; x < size.n_columns; ++x) {
      const Rgbe& pixel = row[static_cast<std::size_t>(x)];
      // Without Ward's half-step offset: 128 is to give 0.5 exactly.
      const float scale = pixel[3] == 0 ? 0.0F : std::ldexp(1.0F, int{pixel[3]} - (128 + 8));
      for (int c = 0; c < 3; ++c) {
        pixels(y, x, c) = scale * static_cast<float>(pixel[static_cast<std::size_t>(c)]);
      }
    }
  }
  return content;
}

}  // namespace haarlight
