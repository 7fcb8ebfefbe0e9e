// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/kept_pictures.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <unordered_map>

namespace haarlight::relight {

namespace {

constexpr std::uint8_t kUnknown = 255;
constexpr float kLevels = 254.0F;

struct BytePicture {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> values;
};

BytePicture rounded(const Visibility& picture) {
  BytePicture kept{picture.value.width(), picture.value.height(), {}};
  kept.values.resize(picture.value.pixels().size());
  for (std::size_t i = 0; i < kept.values.size(); ++i) {
    const float v = picture.value.pixels()[i];
    const bool is_known = picture.known.pixels()[i] != 0 && v >= 0.0F;
    kept.values[i] = is_known
                         ? static_cast<std::uint8_t>(std::lround(kLevels * std::min(v, 1.0F)))
                         : kUnknown;
  }
  return kept;
}

Visibility expanded(const BytePicture& kept) {
  Visibility picture;
  picture.value = Image<float>(kept.height, kept.width, 1);
  picture.known = Image<std::uint8_t>(kept.height, kept.width, 1);
  for (std::size_t i = 0; i < kept.values.size(); ++i) {
    if (kept.values[i] != kUnknown) {
      picture.value.pixels()[i] = static_cast<float>(kept.values[i]) / kLevels;
      picture.known.pixels()[i] = 1;
    }
  }
  return picture;
}

/// The pictures of one plane.
class Keeper {
 public:
  Keeper(VisibilitySource source, std::uint64_t memory_bytes)
      : source_(std::move(source)), free_bytes_(memory_bytes) {}

  Visibility picture(int k) {
    if (const auto found = kept_.find(k); found != kept_.end()) {
      return expanded(found->second);
    }
    BytePicture now = rounded(source_(k));
    Visibility picture = expanded(now);
    if (now.values.size() <= free_bytes_) {
      free_bytes_ -= now.values.size();
      kept_.emplace(k, std::move(now));
    }
    return picture;
  }

 private:
  VisibilitySource source_;
  std::uint64_t free_bytes_;
  std::unordered_map<int, BytePicture> kept_;
};

}  // namespace

std::vector<SamplingPlane> keep_pictures(std::span<const SamplingPlane> planes,
                                         std::uint64_t memory_bytes) {
  std::vector<SamplingPlane> kept;
  for (const SamplingPlane& plane : planes) {
    const auto keeper =
        std::make_shared<Keeper>(plane.visibility, memory_bytes / planes.size());
    kept.push_back({plane.frame, [keeper](int k) { return keeper->picture(k); }, plane.object,
                    plane.resolution_mm});
  }
  return kept;
}

}  // namespace haarlight::relight
