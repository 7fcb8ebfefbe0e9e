// SPDX-License-Identifier: Apache-2.0
#include "sim/transport_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>
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
constexpr std::size_t kPieceBytes = std::size_t{16} << 20U;
constexpr std::size_t kQuickBytes = std::size_t{1} << 30U;
constexpr const char* kMakeAgain = "delete the file: it is a cache and is made again";

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

/// The median over pixels of the mean over lights. Reorders.
double median_mean(std::vector<double>& sums, int n_lights) {
  const auto median_or_0 = [](std::vector<double>& values) {
    return values.empty() ? 0.0 : median(std::span(values));
  };
  double value = median_or_0(sums);
  if (!(value > 0.0)) {
    std::erase_if(sums, [](double sum) { return !(sum > 0.0); });
    value = median_or_0(sums);
  }
  return value > 0.0 ? value / n_lights : 1.0;
}

}  // namespace

Transport Transport::map(const std::filesystem::path& file) {
  Transport transport;
  transport.file_ = MappedFile(file);
  const auto bytes = transport.file_.bytes();
  const auto refuse = [&](const std::string& what) {
    throw Error(what, file.string(), kMakeAgain);
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

Transport Transport::open(const std::filesystem::path& file, ProgressStyle progress) {
  Transport transport = map(file);
  if (transport.hash_planes(progress) != text_at(transport.file_.bytes(), kHashOffset)) {
    throw Error("a damaged transport file: its planes don't have their hash", file.string(),
                kMakeAgain);
  }
  return transport;
}

std::string Transport::hash_planes(ProgressStyle style) const {
  const auto planes = file_.bytes().subspan(kDataOffset);
  // A bar for less than a second's work would only flicker.
  Progress progress("checking the transport", planes.size(),
                    planes.size() < kQuickBytes ? ProgressStyle::none : style);
  ContentHash hash;
  for (std::size_t begin = 0; begin < planes.size(); begin += kPieceBytes) {
    const auto piece = planes.subspan(begin, std::min(kPieceBytes, planes.size() - begin));
    hash.add(piece);
    drop_pages(piece);
    progress.advance(piece.size());
  }
  return hash.text();
}

ImageView<const float> Transport::plane(int k) const {
  HAARLIGHT_EXPECTS(k >= 0 && k < n_lights_, "a light of the transport matrix");
  const std::size_t size = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  const auto* planes = reinterpret_cast<const float*>(file_.bytes().data() + kDataOffset);
  return {planes + static_cast<std::size_t>(k) * size, height_, width_, 1};
}

TransportWriter::TransportWriter(std::filesystem::path file, const TransportData& data)
    : path_(std::move(file)), data_(data), file_(path_) {
  HAARLIGHT_EXPECTS(data.width > 0 && data.height > 0 && data.n_lights > 0,
                    "a transport matrix with pixels and lights");
  HAARLIGHT_EXPECTS(data.key.size() == kHashSize, "a key of 32 characters");
  data_.planes = {};
  const std::size_t n_pixels =
      static_cast<std::size_t>(data.width) * static_cast<std::size_t>(data.height);
  file_.append_zeros(kDataOffset +
                     sizeof(float) * n_pixels * static_cast<std::uint64_t>(data.n_lights));
  sums_.assign(n_pixels, 0.0);
}

void TransportWriter::append_rows(std::span<const float> strip) {
  const auto width = static_cast<std::size_t>(data_.width);
  const auto height = static_cast<std::size_t>(data_.height);
  const auto n_lights = static_cast<std::size_t>(data_.n_lights);
  const std::size_t n_values = strip.size() / n_lights;  // of each plane
  HAARLIGHT_EXPECTS(
      strip.size() % (n_lights * width) == 0 && n_rows_ + n_values / width <= height,
      "whole rows of every plane, no more than the picture has");
  for (std::size_t k = 0; k < n_lights; ++k) {
    const auto rows = strip.subspan(k * n_values, n_values);
    file_.rewrite(kDataOffset + sizeof(float) * width * (k * height + n_rows_),
                  std::as_bytes(rows));
    double* sum = sums_.data() + n_rows_ * width;
    for (const float value : rows) {
      *sum++ += value;
    }
  }
  n_rows_ += n_values / width;
}

Transport TransportWriter::finish(std::uint64_t n_rays, double seconds,
                                  ProgressStyle progress) {
  HAARLIGHT_EXPECTS(n_rows_ == static_cast<std::size_t>(data_.height), "every row appended");
  std::array<std::byte, kDataOffset> head{};
  std::memcpy(head.data(), kMagic.data(), kMagic.size());
  put(head, 8, static_cast<std::uint32_t>(data_.width));
  put(head, 12, static_cast<std::uint32_t>(data_.height));
  put(head, 16, static_cast<std::uint32_t>(data_.n_lights));
  put(head, 24, median_mean(sums_, data_.n_lights));
  put(head, 32, n_rays);
  put(head, 40, seconds);
  std::memcpy(head.data() + kKeyOffset, data_.key.data(), kHashSize);
  file_.rewrite(0, head);
  Transport transport = Transport::map(file_.temporary());
  const std::string hash = transport.hash_planes(progress);
  file_.rewrite(kHashOffset, std::as_bytes(std::span(hash)));
  file_.commit();
  return transport;
}

void write_transport(const std::filesystem::path& file, const TransportData& data) {
  TransportWriter writer(file, data);
  writer.append_rows(data.planes);
  (void)writer.finish(data.n_rays, data.seconds);
}

}  // namespace haarlight::sim
