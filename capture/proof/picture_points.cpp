// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/picture_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

namespace haarlight::capture {

namespace {

constexpr int kSide = 8;        // points across and down
constexpr int kMostBlock = 16;  // pixels of a block's side

struct Block {
  int y0 = 0;
  int x0 = 0;
  int height = 0;
  int width = 0;
};

/// Even in position and size, so that a mosaic's colours have equal weight.
Block block_at(int i, int height, int width) {
  const auto part = [](int k, int size, int& at, int& length) {
    const int begin = k * size / kSide;
    const int cell = (k + 1) * size / kSide - begin;
    length = std::max(1, std::min(kMostBlock, cell) & ~1);
    at = (begin + (cell - length) / 2) & ~1;
    length = std::min(length, size - at);
  };
  Block block;
  part(i / kSide, height, block.y0, block.height);
  part(i % kSide, width, block.x0, block.width);
  return block;
}

}  // namespace

PointValues block_means(ImageView<const std::uint16_t> active) {
  PointValues means;
  for (int i = 0; i < kProofPoints; ++i) {
    const Block block = block_at(i, active.height(), active.width());
    double sum = 0.0;
    for (int y = block.y0; y < block.y0 + block.height; ++y) {
      for (int x = block.x0; x < block.x0 + block.width; ++x) {
        sum += active(y, x);
      }
    }
    means[i] = sum / (static_cast<double>(block.height) * block.width);
  }
  return means;
}

PointSamples sample_points(ImageView<const std::uint16_t> active,
                           const session::FrameForm& form, const SensorNoise& noise,
                           const PointValues& dark_dn, double exposure_us, double gain_db) {
  const double scale = exposure_us * std::pow(10.0, gain_db / 20.0);
  const PointValues means = block_means(active);
  PointMask good;
  for (int i = 0; i < kProofPoints; ++i) {
    const Block block = block_at(i, active.height(), active.width());
    bool is_good = true;
    for (int y = block.y0; y < block.y0 + block.height; ++y) {
      for (int x = block.x0; x < block.x0 + block.width; ++x) {
        is_good = is_good && active(y, x) < form.saturation_dn();
      }
    }
    good[i] = is_good;
  }
  return samples_of((means - dark_dn) / scale, good, form, noise, exposure_us, gain_db);
}

PointSamples samples_of(const PointValues& mean, const PointMask& is_good,
                        const session::FrameForm& form, const SensorNoise& noise,
                        double exposure_us, double gain_db) {
  PointSamples out{.mean = mean, .is_good = is_good};
  const double gain = std::pow(10.0, gain_db / 20.0);
  const double scale = exposure_us * gain;
  const double dn_per_e = gain / noise.gain_e_per_dn;
  const double read = noise.read_e * dn_per_e;
  for (int i = 0; i < kProofPoints; ++i) {
    const Block block = block_at(i, form.height, form.width);
    const double n = static_cast<double>(block.height) * block.width;
    const double one =
        std::max(mean[i] * scale, 0.0) * dn_per_e + 2.0 * read * read + 1.0 / 6.0;
    out.noise[i] = one / (n * scale * scale);
  }
  return out;
}

double robust_square(const PointValues& z2, const PointMask& counts, bool is_everywhere) {
  std::array<double, kProofPoints> values{};
  std::size_t n = 0;
  for (int i = 0; i < kProofPoints; ++i) {
    if (counts[i]) {
      values[n++] = z2[i];
    }
  }
  if (n == 0) {
    return 0.0;
  }
  const auto rank = static_cast<std::ptrdiff_t>(is_everywhere ? n - 1 - n / 10 : n / 2);
  std::nth_element(values.begin(), values.begin() + rank,
                   values.begin() + static_cast<std::ptrdiff_t>(n));
  return values[static_cast<std::size_t>(rank)] / (is_everywhere ? 2.706 : 0.4549);
}

std::vector<int> same_lights(const std::vector<session::Shot>& shots) {
  std::map<std::vector<std::pair<int, int>>, int> numbers;
  std::vector<int> number_of;
  for (const session::Shot& shot : shots) {
    std::vector<std::pair<int, int>> lit;
    for (const session::LightLevel& light : shot.lit) {
      if (light.level > 0) {
        lit.emplace_back(light.light, light.level);
      }
    }
    if (shot.kind == session::ShotKind::dark || lit.empty()) {
      number_of.push_back(-1);
      continue;
    }
    number_of.push_back(
        numbers.emplace(std::move(lit), static_cast<int>(numbers.size())).first->second);
  }
  return number_of;
}

}  // namespace haarlight::capture
