// SPDX-License-Identifier: Apache-2.0
#include "sim/transport_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <vector>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::sim {

namespace {

constexpr std::string_view kMagic = "HLTRANS1";
constexpr std::size_t kDataOffset = 4096;
constexpr std::size_t kHashOffset = 48;
constexpr std::size_t kKeyOffset = 80;
constexpr std::size_t kHashSize = 32;

template <class T>
void put(std::span<std::byte> head, std::size_t offset, T value) {
  std::memcpy(head.data() + offset, &value, sizeof(T));
}

template <class T>
T get(std::span<const std::byte> head, std::size_t offset) {
  T value{};
  std::memcpy(&value, head.data() + offset, sizeof(T));
  return value;
}

std::string text_at(std::span<const std::byte> head, std::size_t offset) {
  return {reinterpret_cast<const char*>(head.data()) + offset, kHashSize};
}

/// The median over pixels of the mean over lights.
double median_mean(const TransportData& data) {
  const auto n_pixels =
      static_cast<std::size_t>(data.width) * static_cast<std::size_t>(data.height);
  std::vector<double> means(n_pixels, 0.0);
  for (std::size_t k = 0; k < static_cast<std::size_t>(data.n_lights); ++k) {
    for (std::size_t p = 0; p < n_pixels; ++p) {
      means[p] += data.planes[k * n_pixels + p];
    }
  }
  const auto median_or_0 = [](std::vector<double>& values) {
    return values.empty() ? 0.0 : median(values);
  };
  double value = median_or_0(means);
  if (!(value > 0.0)) {
    std::erase_if(means, [](double mean) { return !(mean > 0.0); });
    value = median_or_0(means);
  }
  return value > 0.0 ? value / data.n_lights : 1.0;
}

}  // namespace

Transport Transport::open(const std::filesystem::path& file) {
  Transport transport;
  transport.file_ = MappedFile(file);
  const auto bytes = transport.file_.bytes();
  const auto refuse = [&](const std::string& what) {
    throw Error(what, file.string(), "delete the file: it is a cache and is made again");
  };
  if (bytes.size() < kDataOffset ||
      std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) != 0) {
    refuse("not a transport file");
  }
  const auto width = get<std::uint32_t>(bytes, 8);
  const auto height = get<std::uint32_t>(bytes, 12);
  const auto n_lights = get<std::uint32_t>(bytes, 16);
  constexpr std::uint32_t kMost = 1U << 20U;
  if (width == 0 || height == 0 || n_lights == 0 || width > kMost || height > kMost ||
      n_lights > kMost ||
      bytes.size() != kDataOffset + sizeof(float) * std::uint64_t{width} * height * n_lights) {
    refuse("a transport file whose size does not fit its header");
  }
  if (content_hash(bytes.subspan(kDataOffset)) != text_at(bytes, kHashOffset)) {
    refuse("a damaged transport file: its planes don't have their hash");
  }
  transport.width_ = static_cast<int>(width);
  transport.height_ = static_cast<int>(height);
  transport.n_lights_ = static_cast<int>(n_lights);
  transport.scale_ = get<double>(bytes, 24);
  transport.n_rays_ = get<std::uint64_t>(bytes, 32);
  transport.seconds_ = get<double>(bytes, 40);
  transport.key_ = text_at(bytes, kKeyOffset);
  if (!(transport.scale_ > 0.0) || !std::isfinite(transport.scale_)) {
    refuse("a transport file without a scale");
  }
  return transport;
}

ImageView<const float> Transport::plane(int k) const {
  HAARLIGHT_EXPECTS(k >= 0 && k < n_lights_, "a light of the transport matrix");
  const std::size_t size = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  const auto* planes = reinterpret_cast<const float*>(file_.bytes().data() + kDataOffset);
  return {planes + static_cast<std::size_t>(k) * size, height_, width_, 1};
}

void write_transport(const std::filesystem::path& file, const TransportData& data) {
  HAARLIGHT_EXPECTS(data.key.size() == kHashSize, "a key of 32 characters");
  HAARLIGHT_EXPECTS(data.planes.size() == static_cast<std::size_t>(data.n_lights) *
                                              static_cast<std::size_t>(data.height) *
                                              static_cast<std::size_t>(data.width),
                    "n_lights planes of height x width");
  std::array<std::byte, kDataOffset> head{};
  std::memcpy(head.data(), kMagic.data(), kMagic.size());
  put(head, 8, static_cast<std::uint32_t>(data.width));
  put(head, 12, static_cast<std::uint32_t>(data.height));
  put(head, 16, static_cast<std::uint32_t>(data.n_lights));
  put(head, 24, median_mean(data));
  put(head, 32, data.n_rays);
  put(head, 40, data.seconds);
  const std::string hash = content_hash(std::as_bytes(data.planes));
  std::memcpy(head.data() + kHashOffset, hash.data(), kHashSize);
  std::memcpy(head.data() + kKeyOffset, data.key.data(), kHashSize);
  PendingFile out(file);
  out.append(head);
  out.append(std::as_bytes(data.planes));
  out.commit();
}

}  // namespace haarlight::sim
