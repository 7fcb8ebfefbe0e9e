// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/rectify.h"

#include <algorithm>
#include <cmath>

namespace haarlight::relight {
namespace {

constexpr int kMaxSamples = 8;

double measure_pixels_per_texel(const CameraModel& camera, const PlaneFrame& frame) {
  const double x = 0.5 * frame.width;
  const double y = 0.5 * frame.height;
  const auto middle = project(camera, frame.world_of(x, y));
  const auto right = project(camera, frame.world_of(x + 1.0, y));
  const auto below = project(camera, frame.world_of(x, y + 1.0));
  if (!middle || !right || !below) {
    return 1.0;
  }
  return std::max((*right - *middle).norm(), (*below - *middle).norm());
}

}  // namespace

void PlaneSampler::add_sample(double x, double y, float weight, std::vector<Tap>& taps) const {
  // Bilinear between pixel centres; the outer half pixel is clamped to the border.
  const double sx = std::clamp(x - 0.5, 0.0, camera_width_ - 1.0);
  const double sy = std::clamp(y - 0.5, 0.0, camera_height_ - 1.0);
  const int i = std::min(static_cast<int>(sx), std::max(0, camera_width_ - 2));
  const int j = std::min(static_cast<int>(sy), std::max(0, camera_height_ - 2));
  const auto fx = static_cast<float>(sx - i);
  const auto fy = static_cast<float>(sy - j);
  const auto add = [&](int column, int row, float fraction) {
    if (fraction <= 0.0F) {
      return;
    }
    const auto pixel = static_cast<std::uint32_t>(row * camera_width_ + column);
    const auto same = std::find_if(taps.begin(), taps.end(),
                                   [pixel](const Tap& tap) { return tap.pixel == pixel; });
    if (same != taps.end()) {
      same->weight += weight * fraction;
    } else {
      taps.push_back({pixel, weight * fraction});
    }
  };
  add(i, j, (1.0F - fx) * (1.0F - fy));
  add(i + 1, j, fx * (1.0F - fy));
  add(i, j + 1, (1.0F - fx) * fy);
  add(i + 1, j + 1, fx * fy);
}

PlaneSampler::PlaneSampler(const CameraModel& camera, const PlaneFrame& frame,
                           ImageView<const std::uint8_t> shows_plane)
    : camera_width_(camera.width),
      camera_height_(camera.height),
      known_(frame.height, frame.width, 1) {
  HAARLIGHT_EXPECTS(camera.width > 0 && camera.height > 0, "a camera with pixels");
  HAARLIGHT_EXPECTS(shows_plane.is_empty() || (shows_plane.width() == camera.width &&
                                               shows_plane.height() == camera.height),
                    "a mask of the camera's size");
  pixels_per_texel_ = measure_pixels_per_texel(camera, frame);
  n_samples_ =
      std::clamp(static_cast<int>(std::ceil(pixels_per_texel_ - 0.25)), 1, kMaxSamples);
  const float weight = 1.0F / static_cast<float>(n_samples_ * n_samples_);
  first_tap_.reserve(
      static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(frame.height) + 1);
  first_tap_.push_back(0);
  std::vector<Tap> taps;
  for (int row = 0; row < frame.height; ++row) {
    for (int column = 0; column < frame.width; ++column) {
      taps.clear();
      bool is_known = true;
      for (int s = 0; s < n_samples_ * n_samples_ && is_known; ++s) {
        const double x = column + (s % n_samples_ + 0.5) / n_samples_;
        const double y =
            row + (s / n_samples_ + 0.5) / n_samples_;  // NOLINT(bugprone-integer-division)
        const auto at = project(camera, frame.world_of(x, y));
        is_known = at && at->x() >= 0.0 && at->x() <= camera.width && at->y() >= 0.0 &&
                   at->y() <= camera.height;
        if (is_known) {
          add_sample(at->x(), at->y(), weight, taps);
        }
      }
      if (is_known && !shows_plane.is_empty()) {
        is_known = std::all_of(taps.begin(), taps.end(), [&](const Tap& tap) {
          const auto pixel = static_cast<int>(tap.pixel);
          return shows_plane(pixel / camera_width_, pixel % camera_width_) != 0;
        });
      }
      if (is_known) {
        known_(row, column) = 1;
        taps_.insert(taps_.end(), taps.begin(), taps.end());
      }
      first_tap_.push_back(static_cast<std::uint32_t>(taps_.size()));
    }
  }
}

Image<float> PlaneSampler::rectify(ImageView<const float> picture) const {
  HAARLIGHT_EXPECTS(picture.width() == camera_width_ && picture.height() == camera_height_,
                    "a picture of the camera's size");
  const int n_channels = picture.channels();
  Image<float> out(known_.height(), known_.width(), n_channels);
  float* target = out.pixels().data();
  for (std::size_t i = 0; i + 1 < first_tap_.size(); ++i) {
    for (std::uint32_t t = first_tap_[i]; t < first_tap_[i + 1]; ++t) {
      const auto pixel = static_cast<int>(taps_[t].pixel);
      for (int c = 0; c < n_channels; ++c) {
        target[i * static_cast<std::size_t>(n_channels) + static_cast<std::size_t>(c)] +=
            taps_[t].weight * picture(pixel / camera_width_, pixel % camera_width_, c);
      }
    }
  }
  return out;
}

double PlaneSampler::known_fraction() const {
  const auto pixels = known_.pixels();
  return static_cast<double>(std::count(pixels.begin(), pixels.end(), std::uint8_t{1})) /
         static_cast<double>(pixels.size());
}

}  // namespace haarlight::relight
