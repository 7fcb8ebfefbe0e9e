// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/surface_picture.h"

#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/film/film_settings.h"
#include "relight/pipeline/display_exposure.h"
#include "render/film/no_depth.h"
#include "render/surface/surface_layers.h"

namespace haarlight::apps {

namespace {

/// Of the values of a .png, not clipped: what emits is brighter than what it lights.
constexpr double kShownFraction = 0.98;

bool has_layer(const render::Film& film, std::size_t layer) {
  return layer < film.layers().size();
}

/// Features and the standard error beside a picture's colours.
struct FeatureLayers {
  std::vector<Image<float>> images;
  std::vector<PictureLayer> layers;

  void add(std::vector<std::string> channels, Image<float> image) {
    images.push_back(std::move(image));
    layers.push_back({.channels = std::move(channels), .image = images.back().view()});
  }
};
FeatureLayers features_of(const render::Film& film, bool has_error) {
  FeatureLayers features;
  features.images.reserve(4);  // views of them stay
  if (has_error) {
    features.add({"error.R", "error.G", "error.B"},
                 film.standard_error(render::SurfaceLayer::kRadiance));
  }
  if (has_layer(film, render::SurfaceLayer::kCoverage)) {
    features.add({"albedo.R", "albedo.G", "albedo.B"},
                 film.mean(render::SurfaceLayer::kAlbedo));
    features.add({"normal.X", "normal.Y", "normal.Z"},
                 film.mean(render::SurfaceLayer::kNormal));
    Image<float> depth = film.mean(render::SurfaceLayer::kDepth);
    const Image<float> coverage = film.mean(render::SurfaceLayer::kCoverage);
    for (std::size_t i = 0; i < depth.pixels().size(); ++i) {
      float& value = depth.pixels()[i];
      const float seen = coverage.pixels()[i];
      value = seen > 0.0F ? value / seen : static_cast<float>(render::kNoDepth);
    }
    features.add({"Z"}, std::move(depth));
  }
  return features;
}

}  // namespace

PictureWindow window_of(const render::RenderSettings& settings, const std::string& path) {
  const auto value_of = [&settings](std::string_view name) {
    for (const auto& [own, value] : settings) {
      if (own == name) {
        return value;
      }
    }
    return std::string();
  };
  const std::optional<render::Crop> crop = render::parse_crop(value_of(kCropSetting));
  const std::optional<render::Crop> whole = render::parse_crop(value_of(kPictureSetting));
  if (!crop || !whole || !is_within(*crop, whole->width, whole->height)) {
    throw Error("the film does not say which part of a picture it is", path,
                "make it again with this program");
  }
  return {.x = crop->x, .y = crop->y, .full_width = whole->width, .full_height = whole->height};
}

double write_surface_pictures(const render::Film& film, const PictureWindow& window,
                              std::uint32_t samples, const std::string& output,
                              const std::string& error_picture,
                              std::optional<double> asked_exposure) {
  const Image<float> picture = film.mean(render::SurfaceLayer::kRadiance);
  const std::string preview = preview_of(output);
  double exposure = 1.0;
  if (has_ending(output, ".png") || !preview.empty()) {
    const auto values = picture.pixels();
    exposure = asked_exposure.value_or(relight::display_exposure(values, kShownFraction));
  }
  const bool has_error = samples >= 2;
  const FeatureLayers features =
      has_ending(output, ".exr") ? features_of(film, has_error) : FeatureLayers{};
  write_cropped_image(output, picture.view(), exposure, window, features.layers);
  if (!preview.empty()) {
    write_image(preview, picture.view(), exposure);
  }
  if (!error_picture.empty()) {
    write_cropped_image(error_picture,
                        film.stated_error(render::SurfaceLayer::kRadiance).view(), exposure,
                        window);
  }
  return exposure;
}

std::string samples_words(std::uint32_t least, std::uint32_t most) {
  return least == most ? fmt::format("{} each", counted(least, "sample"))
                       : fmt::format("{} to {} samples each", least, most);
}

}  // namespace haarlight::apps
