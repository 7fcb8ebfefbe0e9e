// SPDX-License-Identifier: Apache-2.0
#include "session/light_stack.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "core/error.h"

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
constexpr const char* kCure =
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

std::uint64_t data_offset(const StackShape& shape) {
  const std::size_t end = kHeaderBytes + kHashBytes * static_cast<std::size_t>(shape.n_bands());
  return (end + kAlign - 1) / kAlign * kAlign;
}

int rows_of(const StackShape& shape, int i_band) {
  return std::min(shape.band_rows, shape.height - i_band * shape.band_rows);
}

std::size_t row_values(const StackShape& shape) {
  return static_cast<std::size_t>(shape.width) * static_cast<std::size_t>(shape.channels) *
         static_cast<std::size_t>(shape.n_lights);
}

std::string head_bytes(const StackShape& shape) {
  Head head;
  std::memcpy(head.magic, kMagic, sizeof head.magic);
  head.version = kStackVersion;
  head.width = static_cast<std::uint32_t>(shape.width);
  head.height = static_cast<std::uint32_t>(shape.height);
  head.channels = static_cast<std::uint32_t>(shape.channels);
  head.n_lights = static_cast<std::uint32_t>(shape.n_lights);
  head.band_rows = static_cast<std::uint32_t>(shape.band_rows);
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
/// of 16 lights is read once, and each picture gets whole lines.
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

LightStack::LightStack(std::filesystem::path path, const StackShape& shape, MappedFile file)
    : path_(std::move(path)),
      shape_(shape),
      file_(std::move(file)),
      data_offset_(haarlight::data_offset(shape)) {}

LightStack LightStack::open(const std::filesystem::path& file) {
  MappedFile mapped(file);
  const std::span<const std::byte> bytes = mapped.bytes();
  Head head;
  if (bytes.size() < kHeaderBytes ||
      std::memcmp(bytes.data(), kMagic, sizeof head.magic) != 0) {
    throw Error("not a light stack", file.string(), kCure);
  }
  std::memcpy(&head, bytes.data(), sizeof head);
  if (head.version != kStackVersion) {
    throw Error(fmt::format("light stack of version {}, this program reads {}", head.version,
                            kStackVersion),
                file.string(), kCure);
  }
  if (!is_sane(head)) {
    throw Error("damaged: the header has impossible sizes", file.string(), kCure);
  }
  StackShape shape;
  shape.width = static_cast<int>(head.width);
  shape.height = static_cast<int>(head.height);
  shape.channels = static_cast<int>(head.channels);
  shape.n_lights = static_cast<int>(head.n_lights);
  shape.band_rows = static_cast<int>(head.band_rows);
  const std::uint64_t offset = haarlight::data_offset(shape);
  std::uint64_t wanted = row_values(shape) * sizeof(float);
  if (__builtin_mul_overflow(wanted, std::uint64_t{head.height}, &wanted) ||
      __builtin_add_overflow(wanted, offset, &wanted) || bytes.size() != wanted) {
    throw Error(
        fmt::format("{} bytes, not what the header says: cut short or damaged", bytes.size()),
        file.string(), kCure);
  }
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()),
                              static_cast<std::size_t>(offset));
  const std::size_t table_bytes = kHashBytes * static_cast<std::size_t>(shape.n_bands());
  const std::string hashed = std::string(text.substr(0, sizeof head)) +
                             std::string(text.substr(kHeaderBytes, table_bytes));
  if (content_hash(hashed) != text.substr(sizeof head, kHashBytes)) {
    throw Error("damaged: the header's checksum does not hold", file.string(), kCure);
  }
  return {file, shape, std::move(mapped)};
}

std::span<const float> LightStack::band(int i_band) const {
  HAARLIGHT_EXPECTS(0 <= i_band && i_band < shape_.n_bands(), "a band of the stack");
  const std::size_t values = row_values(shape_);
  const std::size_t first =
      values * static_cast<std::size_t>(i_band) * static_cast<std::size_t>(shape_.band_rows);
  const std::byte* data = file_.bytes().data() + data_offset_ + first * sizeof(float);
  return {reinterpret_cast<const float*>(data),
          values * static_cast<std::size_t>(rows_of(shape_, i_band))};
}

void LightStack::check() const {
  for (int i = 0; i < shape_.n_bands(); ++i) {
    const std::string_view stored(reinterpret_cast<const char*>(file_.bytes().data()) +
                                      kHeaderBytes + kHashBytes * static_cast<std::size_t>(i),
                                  kHashBytes);
    if (content_hash(std::as_bytes(band(i))) != stored) {
      throw Error(fmt::format("band {} of {} is damaged", i, shape_.n_bands()), path_.string(),
                  kCure);
    }
  }
}

Image<float> LightStack::light_image(int k) const {
  return std::move(light_images(k, 1).front());
}

std::vector<Image<float>> LightStack::light_images(int first, int n) const {
  HAARLIGHT_EXPECTS(0 <= first && n >= 1 && first + n <= shape_.n_lights,
                    "lights of the stack");
  const auto n_lights = static_cast<std::size_t>(shape_.n_lights);
  const std::size_t row = static_cast<std::size_t>(shape_.width) * n_lights;
  std::vector<Image<float>> images(static_cast<std::size_t>(n),
                                   Image<float>(shape_.height, shape_.width, shape_.channels));
  for (int i = 0; i < shape_.n_bands(); ++i) {
    std::span<const float> rest = band(i);
    for (int c = 0; c < shape_.channels; ++c) {
      for (int y = 0; y < rows_of(shape_, i); ++y) {
        scatter_row(rest.subspan(static_cast<std::size_t>(first),
                                 row - static_cast<std::size_t>(first)),
                    n_lights, i * shape_.band_rows + y, c, images);
        drop_pages(std::as_bytes(rest.first(row)));
        rest = rest.subspan(row);
      }
    }
  }
  return images;
}

void for_each_light_image(const LightStack& stack, std::uint64_t memory_bytes,
                          const std::function<void(int, const Image<float>&)>& visit) {
  const StackShape& shape = stack.shape();
  const std::uint64_t picture_bytes = row_values(shape) /
                                      static_cast<std::uint64_t>(shape.n_lights) *
                                      static_cast<std::uint64_t>(shape.height) * sizeof(float);
  const int most = static_cast<int>(std::clamp<std::uint64_t>(
      memory_bytes / picture_bytes, 1, static_cast<std::uint64_t>(shape.n_lights)));
  for (int first = 0; first < shape.n_lights; first += most) {
    const int n = std::min(most, shape.n_lights - first);
    const std::vector<Image<float>> images = stack.light_images(first, n);
    for (int k = 0; k < n; ++k) {
      visit(first + k, images[static_cast<std::size_t>(k)]);
    }
  }
}

LightStackWriter::LightStackWriter(const std::filesystem::path& file, const StackShape& shape)
    : shape_(shape), path_(file), file_(file) {
  HAARLIGHT_EXPECTS(shape.width >= 1 && shape.height >= 1 && shape.n_lights >= 1,
                    "a stack with pixels and lights");
  HAARLIGHT_EXPECTS(shape.channels == 1 || shape.channels == 3, "1 or 3 channels");
  HAARLIGHT_EXPECTS(shape.band_rows >= 1 && shape.band_rows <= shape.height, "rows of a band");
  const std::vector<std::byte> zeros(static_cast<std::size_t>(data_offset(shape)));
  file_.append(zeros);
}

void LightStackWriter::append_band(std::span<const float> values) {
  HAARLIGHT_EXPECTS(next_band_ < shape_.n_bands(), "no more bands than the shape has");
  const int rows = rows_of(shape_, next_band_);
  HAARLIGHT_EXPECTS(values.size() == row_values(shape_) * static_cast<std::size_t>(rows),
                    "the values of one band");
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      const auto n_lights = static_cast<std::size_t>(shape_.n_lights);
      const auto width = static_cast<std::size_t>(shape_.width);
      const std::size_t y = i / n_lights / width % static_cast<std::size_t>(rows) +
                            static_cast<std::size_t>(next_band_ * shape_.band_rows);
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
  HAARLIGHT_EXPECTS(next_band_ == shape_.n_bands(), "every band of the shape");
  std::string head = head_bytes(shape_);
  head += content_hash(head + band_hashes_);
  head += band_hashes_;
  file_.rewrite(0, std::as_bytes(std::span(head)));
  file_.commit();
}

}  // namespace haarlight
