// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/stack/light_stack.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

// Layout, little-endian:
//   0  "HLSTACK1"
//   8  version, width, height, channels, n_lights, band_rows: uint32 each
//  32  content_hash of bytes 0..31 and of the band table, 32 characters
//  64  band table: content_hash of each band's bytes, 32 characters each
//      zeros up to a multiple of 4096
//      bands, floats (channels, rows, width, n_lights)
constexpr char kMagic[9] = "HLSTACK1";
constexpr std::uint32_t kStackVersion = 1;
constexpr std::size_t kHeaderBytes = 64;
constexpr std::size_t kHashBytes = 32;
constexpr std::size_t kAlign = 4096;
constexpr const char* kHint =
    "delete the file: it is a cache, `haarlight develop` makes it again";

struct Head {
  char magic[8] = {};
  std::uint32_t version = 0;
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t channels = 0;
  std::uint32_t n_lights = 0;
  std::uint32_t band_rows = 0;
};
static_assert(sizeof(Head) == 32);

std::uint64_t data_offset(const StackBands& bands) {
  const std::size_t end = kHeaderBytes + kHashBytes * static_cast<std::size_t>(bands.n());
  return (end + kAlign - 1) / kAlign * kAlign;
}

std::string head_bytes(const StackDims& dims, int band_rows) {
  Head head;
  std::memcpy(head.magic, kMagic, sizeof head.magic);
  head.version = kStackVersion;
  head.width = static_cast<std::uint32_t>(dims.width);
  head.height = static_cast<std::uint32_t>(dims.height);
  head.channels = static_cast<std::uint32_t>(dims.channels);
  head.n_lights = static_cast<std::uint32_t>(dims.n_lights);
  head.band_rows = static_cast<std::uint32_t>(band_rows);
  std::string bytes(sizeof head, '\0');
  std::memcpy(bytes.data(), &head, sizeof head);
  return bytes;
}

bool is_sane(const Head& head) {
  constexpr std::uint32_t kMaxSide = 1U << 20U;
  constexpr std::uint32_t kMaxLights = 1U << 24U;
  return head.width >= 1 && head.width <= kMaxSide && head.height >= 1 &&
         head.height <= kMaxSide && (head.channels == 1 || head.channels == 3) &&
         head.n_lights >= 1 && head.n_lights <= kMaxLights && head.band_rows >= 1 &&
         head.band_rows <= head.height;
}

/// Distributes one row of one channel to the lights' pictures.
/// @param values  (width, n_lights) from the first picture's light on In blocks: a cache line
///                of 16 lights is read once, and each picture gets whole lines.
void scatter_row(std::span<const float> values, std::size_t n_lights, int y, int c,
                 std::vector<Image<float>>& images) {
  constexpr std::size_t kLights = 16;
  constexpr std::size_t kPixels = 32;
  const auto width = static_cast<std::size_t>(images.front().width());
  const auto channels = static_cast<std::size_t>(images.front().channels());
  for (std::size_t x0 = 0; x0 < width; x0 += kPixels) {
    const std::size_t x1 = std::min(width, x0 + kPixels);
    for (std::size_t k0 = 0; k0 < images.size(); k0 += kLights) {
      const std::size_t k1 = std::min(images.size(), k0 + kLights);
      for (std::size_t k = k0; k < k1; ++k) {
        float* out = images[k].view().row(y).data() + c;
        for (std::size_t x = x0; x < x1; ++x) {
          out[x * channels] = values[x * n_lights + k];
        }
      }
    }
  }
}

}  // namespace

LightStack::LightStack(std::filesystem::path path, const StackDims& dims, int band_rows,
                       MappedFile file)
    : path_(std::move(path)),
      dims_(dims),
      bands_{dims.height, band_rows},
      file_(std::move(file)),
      data_offset_(haarlight::data_offset(bands_)) {}

LightStack LightStack::open(const std::filesystem::path& file) {
  MappedFile mapped(file);
  const std::span<const std::byte> bytes = mapped.bytes();
  Head head;
  if (bytes.size() < kHeaderBytes ||
      std::memcmp(bytes.data(), kMagic, sizeof head.magic) != 0) {
    throw Error("not a light stack", file.string(), kHint);
  }
  std::memcpy(&head, bytes.data(), sizeof head);
  if (head.version != kStackVersion) {
    throw Error(fmt::format("light stack of version {}, this program reads {}", head.version,
                            kStackVersion),
                file.string(), kHint);
  }
  if (!is_sane(head)) {
    throw Error("damaged: the header has impossible sizes", file.string(), kHint);
  }
  StackDims dims;
  dims.width = static_cast<int>(head.width);
  dims.height = static_cast<int>(head.height);
  dims.channels = static_cast<int>(head.channels);
  dims.n_lights = static_cast<int>(head.n_lights);
  const StackBands bands{dims.height, static_cast<int>(head.band_rows)};
  const std::uint64_t offset = haarlight::data_offset(bands);
  std::uint64_t wanted = std::uint64_t{dims.row_values()} * sizeof(float);
  if (__builtin_mul_overflow(wanted, std::uint64_t{head.height}, &wanted) ||
      __builtin_add_overflow(wanted, offset, &wanted) || bytes.size() != wanted) {
    throw Error(
        fmt::format("{} bytes, not what the header says: cut short or damaged", bytes.size()),
        file.string(), kHint);
  }
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()),
                              static_cast<std::size_t>(offset));
  const std::size_t table_bytes = kHashBytes * static_cast<std::size_t>(bands.n());
  const std::string hashed = std::string(text.substr(0, sizeof head)) +
                             std::string(text.substr(kHeaderBytes, table_bytes));
  if (content_hash(hashed) != text.substr(sizeof head, kHashBytes)) {
    throw Error("damaged: the header's checksum does not hold", file.string(), kHint);
  }
  return {file, dims, bands.rows, std::move(mapped)};
}

std::span<const float> LightStack::band(int i_band) const {
  HAARLIGHT_EXPECTS(0 <= i_band && i_band < bands_.n(), "a band of the stack");
  const std::size_t values = dims_.row_values();
  const std::size_t first = values * static_cast<std::size_t>(bands_.first_row(i_band));
  const std::byte* data = file_.bytes().data() + data_offset_ + first * sizeof(float);
  return {reinterpret_cast<const float*>(data),
          values * static_cast<std::size_t>(bands_.n_rows(i_band))};
}

void LightStack::read_tile(const TileRect& rect, std::span<float> out) const {
  require_tile(dims_, rect, out.size());
  const std::size_t row_values = count(rect.width) * count(dims_.n_lights);
  for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
    const int i_band = y / bands_.rows;
    const int band_y0 = bands_.first_row(i_band);
    const int band_rows = bands_.n_rows(i_band);
    const std::span<const float> values = band(i_band);
    for (int c = 0; c < dims_.channels; ++c) {
      const std::size_t row = count(c) * count(band_rows) + count(y - band_y0);
      const std::size_t from =
          (row * count(dims_.width) + count(rect.x0)) * count(dims_.n_lights);
      const std::size_t to = (count(c) * count(rect.height) + count(y - rect.y0)) * row_values;
      const std::span<const float> row_of_tile(values.data() + from, row_values);
      std::copy(row_of_tile.begin(), row_of_tile.end(),
                out.begin() + static_cast<std::ptrdiff_t>(to));
      // A stack may be larger than memory: what was copied need not stay.
      drop_pages(std::as_bytes(row_of_tile));
    }
  }
}

void LightStack::check() const {
  for (int i = 0; i < bands_.n(); ++i) {
    const std::string_view stored(reinterpret_cast<const char*>(file_.bytes().data()) +
                                      kHeaderBytes + kHashBytes * static_cast<std::size_t>(i),
                                  kHashBytes);
    if (content_hash(std::as_bytes(band(i))) != stored) {
      throw Error(fmt::format("band {} of {} is damaged", i, bands_.n()), path_.string(),
                  kHint);
    }
  }
}

std::vector<Image<float>> LightStack::light_images(int first, int n) const {
  HAARLIGHT_EXPECTS(0 <= first && n >= 1 && first + n <= dims_.n_lights, "lights of the stack");
  const auto n_lights = static_cast<std::size_t>(dims_.n_lights);
  const std::size_t row = static_cast<std::size_t>(dims_.width) * n_lights;
  std::vector<Image<float>> images(static_cast<std::size_t>(n),
                                   Image<float>(dims_.height, dims_.width, dims_.channels));
  for (int i = 0; i < bands_.n(); ++i) {
    std::span<const float> rest = band(i);
    for (int c = 0; c < dims_.channels; ++c) {
      for (int y = 0; y < bands_.n_rows(i); ++y) {
        scatter_row(rest.subspan(static_cast<std::size_t>(first),
                                 row - static_cast<std::size_t>(first)),
                    n_lights, bands_.first_row(i) + y, c, images);
        drop_pages(std::as_bytes(rest.first(row)));
        rest = rest.subspan(row);
      }
    }
  }
  return images;
}

void for_each_light_image(const LightStack& stack, std::uint64_t memory_bytes,
                          const std::function<void(int, const Image<float>&)>& visit) {
  const StackDims dims = stack.dims();
  const std::uint64_t picture_bytes =
      dims.n_pixels() * static_cast<std::uint64_t>(dims.channels) * sizeof(float);
  const int most = static_cast<int>(std::clamp<std::uint64_t>(
      memory_bytes / picture_bytes, 1, static_cast<std::uint64_t>(dims.n_lights)));
  for (int first = 0; first < dims.n_lights; first += most) {
    const int n = std::min(most, dims.n_lights - first);
    const std::vector<Image<float>> images = stack.light_images(first, n);
    for (int k = 0; k < n; ++k) {
      visit(first + k, images[static_cast<std::size_t>(k)]);
    }
  }
}

LightStackWriter::LightStackWriter(const std::filesystem::path& file, const StackDims& dims,
                                   int band_rows)
    : dims_(dims), bands_{dims.height, band_rows}, path_(file), file_(file) {
  HAARLIGHT_EXPECTS(dims.width >= 1 && dims.height >= 1 && dims.n_lights >= 1,
                    "a stack with pixels and lights");
  HAARLIGHT_EXPECTS(dims.channels == 1 || dims.channels == 3, "1 or 3 channels");
  HAARLIGHT_EXPECTS(band_rows >= 1 && band_rows <= dims.height, "rows of a band");
  const std::vector<std::byte> zeros(static_cast<std::size_t>(data_offset(bands_)));
  file_.append(zeros);
}

void LightStackWriter::append_band(std::span<const float> values) {
  HAARLIGHT_EXPECTS(next_band_ < bands_.n(), "no more bands than the shape has");
  const int rows = bands_.n_rows(next_band_);
  HAARLIGHT_EXPECTS(values.size() == dims_.row_values() * static_cast<std::size_t>(rows),
                    "the values of one band");
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      const auto n_lights = static_cast<std::size_t>(dims_.n_lights);
      const auto width = static_cast<std::size_t>(dims_.width);
      const std::size_t y = i / n_lights / width % static_cast<std::size_t>(rows) +
                            static_cast<std::size_t>(bands_.first_row(next_band_));
      throw Error(fmt::format("light {}, pixel (x {}, y {}) is not a finite number",
                              i % n_lights, i / n_lights % width, y),
                  path_.string(), "repair or replace this light's picture");
    }
  }
  file_.append(std::as_bytes(values));
  band_hashes_ += content_hash(std::as_bytes(values));
  ++next_band_;
}

void LightStackWriter::finish() {
  HAARLIGHT_EXPECTS(next_band_ == bands_.n(), "every band of the shape");
  std::string head = head_bytes(dims_, bands_.rows);
  head += content_hash(head + band_hashes_);
  head += band_hashes_;
  file_.rewrite(0, std::as_bytes(std::span(head)));
  file_.commit();
}

}  // namespace haarlight
