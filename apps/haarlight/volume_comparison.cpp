// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/volume_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace haarlight::apps {

namespace {

constexpr std::size_t kChannels = 4;

bool is_empty(std::span<const double> pixel, std::span<const double> behind) {
  return pixel[3] == 0.0 && std::ranges::equal(pixel.first(3), behind);
}

}  // namespace

VolumeErrors compare_pictures(std::span<const double> picture, std::span<const double> exact,
                              std::span<const double> behind) {
  std::array<std::vector<double>, kChannels> off;
  for (std::size_t i = 0; i + kChannels <= exact.size(); i += kChannels) {
    const std::span<const double> empty = behind.subspan(i / kChannels * 3, 3);
    if (is_empty(exact.subspan(i, kChannels), empty) &&
        is_empty(picture.subspan(i, kChannels), empty)) {
      continue;
    }
    for (std::size_t k = 0; k < kChannels; ++k) {
      off.at(k).push_back(std::abs(picture[i + k] - exact[i + k]));
    }
  }
  VolumeErrors errors;
  errors.n_compared = static_cast<std::int64_t>(off[0].size());
  if (off[0].empty()) {
    return errors;
  }
  for (std::size_t k = 0; k < kChannels; ++k) {
    std::vector<double>& values = off.at(k);
    ChannelErrors& of = errors.channels.at(k);
    for (const double value : values) {
      of.mean += value;
      of.worst = std::max(of.worst, value);
    }
    of.mean /= static_cast<double>(values.size());
    constexpr double kShare = 0.99;
    const auto rank =
        static_cast<std::size_t>(std::ceil(kShare * static_cast<double>(values.size())) - 1.0);
    std::ranges::nth_element(values, values.begin() + static_cast<std::ptrdiff_t>(rank));
    of.at_99 = values[rank];
  }
  return errors;
}

Image<float> difference_of(std::span<const double> picture, std::span<const double> exact,
                           int width, int height) {
  Image<float> difference(height, width, 3);
  const std::span<float> values = difference.pixels();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::size_t from = i / 3 * kChannels + i % 3;
    values[i] = static_cast<float>(std::abs(picture[from] - exact[from]));
  }
  return difference;
}

}  // namespace haarlight::apps
