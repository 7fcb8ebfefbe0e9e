// SPDX-License-Identifier: Apache-2.0
#include "apps/volume_numbers.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>
#include <utility>

#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/display_exposure.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

using render::VolumeRayCaster;

constexpr double kShownFraction = 0.98;  ///< of the values of a .png, not clipped

/// Sums of each pixel of a volume's film.
std::size_t sums_per_pixel() {
  std::size_t n = 0;
  for (const render::FilmLayer& layer : VolumeRayCaster::layers()) {
    n += static_cast<std::size_t>(layer.channels);
  }
  return n;
}

bool is_empty(std::span<const double> pixel, std::span<const double> behind) {
  return pixel[3] == 0.0 && std::ranges::equal(pixel.first(3), behind);
}

}  // namespace

void for_each_missing_pixel(const render::Film& film,
                            const std::function<void(int x, int y)>& visit) {
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    if (film.samples_of(i) == 0) {
      const render::Tile area = film.area_of(i);
      for (int y = area.y0; y < area.y1; ++y) {
        for (int x = area.x0; x < area.x1; ++x) {
          visit(x, y);
        }
      }
    }
  }
}

std::vector<double> doubles_of(const render::Film& film) {
  const auto width = static_cast<std::size_t>(film.width());
  std::vector<double> values(kVolumeChannels * width * static_cast<std::size_t>(film.height()),
                             std::numeric_limits<double>::quiet_NaN());
  const std::size_t stride = sums_per_pixel();
  for (const std::shared_ptr<const render::FilmTile>& tile : film.tiles()) {
    if (tile == nullptr) {
      continue;
    }
    const render::Tile& area = tile->area();
    const double* sums = tile->sums().data();
    for (int y = area.y0; y < area.y1; ++y) {
      for (int x = area.x0; x < area.x1; ++x, sums += stride) {
        std::copy_n(
            sums, kVolumeChannels,
            values.begin() + static_cast<std::ptrdiff_t>(kVolumeChannels *
                                                         (static_cast<std::size_t>(y) * width +
                                                          static_cast<std::size_t>(x))));
      }
    }
  }
  return values;
}

Image<float> layer_of(const render::Film& film, std::size_t layer) {
  Image<float> picture = film.mean(layer);
  for_each_missing_pixel(film, [&](int x, int y) {
    for (int c = 0; c < picture.channels(); ++c) {
      picture(y, x, c) = std::numeric_limits<float>::quiet_NaN();
    }
  });
  return picture;
}

double shown_exposure(std::span<const float> values) {
  std::vector<float> rendered;
  rendered.reserve(values.size());
  std::ranges::copy_if(values, std::back_inserter(rendered),
                       [](float value) { return !std::isnan(value); });
  return rendered.empty() ? 1.0 : relight::display_exposure(rendered, kShownFraction);
}

void write_linear_picture(const render::Film& film, const std::filesystem::path& path) {
  const Image<float> light = layer_of(film, VolumeRayCaster::kLight);
  const Image<float> opacity = layer_of(film, VolumeRayCaster::kOpacity);
  const Image<float> depth = layer_of(film, VolumeRayCaster::kDepth);
  const std::array layers = {PictureLayer{.channels = {"A"}, .image = opacity.view()},
                             PictureLayer{.channels = {"Z"}, .image = depth.view()}};
  write_image(path, light.view(), 1.0, {}, layers);
}

std::vector<double> lights_behind(const render::VolumeScene& scene) {
  std::vector<double> light;
  for (int y = 0; y < scene.camera.height; ++y) {
    for (int x = 0; x < scene.camera.width; ++x) {
      const Eigen::Array3d rgb = light_behind(scene, x, y);
      light.insert(light.end(), rgb.begin(), rgb.end());
    }
  }
  return light;
}

VolumeErrors compare_pictures(std::span<const double> picture, std::span<const double> exact,
                              std::span<const double> behind) {
  std::array<std::vector<double>, kVolumeChannels> off;
  for (std::size_t i = 0; i + kVolumeChannels <= exact.size(); i += kVolumeChannels) {
    const std::span<const double> empty = behind.subspan(i / kVolumeChannels * 3, 3);
    if (is_empty(exact.subspan(i, kVolumeChannels), empty) &&
        is_empty(picture.subspan(i, kVolumeChannels), empty)) {
      continue;
    }
    for (std::size_t k = 0; k < kVolumeChannels; ++k) {
      off.at(k).push_back(std::abs(picture[i + k] - exact[i + k]));
    }
  }
  VolumeErrors errors;
  errors.n_compared = static_cast<std::int64_t>(off[0].size());
  if (off[0].empty()) {
    return errors;
  }
  for (std::size_t k = 0; k < kVolumeChannels; ++k) {
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

}  // namespace haarlight::apps
