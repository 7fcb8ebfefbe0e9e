// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/volume_picture.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <memory>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "apps/volume_numbers.h"
#include "core/npy.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

using render::VolumeRayCaster;

/// What is missing as stripes that no medium has: it must not be taken for black.
Image<float> hatched(const render::Film& film, Image<float> picture, double exposure) {
  constexpr int kStripe = 4;  // pixels
  constexpr std::array<float, 3> kMagenta = {0.8F, 0.0F, 0.8F};
  constexpr std::array<float, 3> kGrey = {0.1F, 0.1F, 0.1F};
  for_each_missing_pixel(film, [&](int x, int y) {
    const std::array<float, 3>& colour = (x + y) / kStripe % 2 == 0 ? kMagenta : kGrey;
    for (int c = 0; c < 3; ++c) {
      picture(y, x, c) = colour.at(static_cast<std::size_t>(c)) / static_cast<float>(exposure);
    }
  });
  return picture;
}

}  // namespace

VolumeFilmFacts facts_of(const render::Film& film) {
  VolumeFilmFacts facts;
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    facts.n_rendered += film.samples_of(i) > 0 ? 1 : 0;
  }
  const Image<float> flags = film.mean(VolumeRayCaster::kFlags);
  for (int y = 0; y < flags.height(); ++y) {
    for (int x = 0; x < flags.width(); ++x) {
      const auto bits = static_cast<unsigned>(flags(y, x, 0));
      facts.ended_pixels += (bits & render::PixelFlag::kEnded) != 0 ? 1 : 0;
      facts.unresolved_pixels += (bits & render::PixelFlag::kUnresolved) != 0 ? 1 : 0;
      if ((bits & render::PixelFlag::kOverlap) != 0 && facts.overlaps++ == 0) {
        facts.overlap_x = x;
        facts.overlap_y = y;
      }
    }
  }
  return facts;
}

void tell_doubts(const VolumeFilmFacts& facts, double left_out) {
  if (facts.unresolved_pixels > 0) {
    fmt::print(
        "{} pixels through badly formed cells, where the field is not known to rounding or a "
        "part is missing\n",
        facts.unresolved_pixels);
  }
  if (facts.ended_pixels > 0) {
    fmt::print("{} rays ended where no more than {:.2g} could come from behind\n",
               facts.ended_pixels, left_out);
  }
}

double left_out_of(const render::RenderSettings& settings, const VolumeFilmFacts& facts) {
  if (facts.ended_pixels > 0) {
    for (const auto& [name, value] : settings) {
      if (name == kMaxErrorSetting) {
        double allowed = 0.0;
        std::from_chars(value.data(), value.data() + value.size(), allowed);
        return allowed;
      }
    }
  }
  return 0.0;
}

void require_volume_outputs(const VolumePictureNames& names, bool force) {
  if (!names.output.empty()) {
    require_outputs(names.output, "", "", force);
  }
  if (!names.float64.empty()) {
    if (names.output.empty()) {
      throw Error("numbers without their picture", "--float64", "give -o PICTURE too",
                  ExitCode::usage);
    }
    if (!has_ending(names.float64, ".npy")) {
      throw Error("no name of a NumPy file", names.float64, "end it in .npy", ExitCode::usage);
    }
    require_absent(names.float64, force);
  }
}

double write_volume_pictures(const render::Film& film, const VolumePictureNames& names) {
  const Image<float> light = layer_of(film, VolumeRayCaster::kLight);
  const std::string preview = preview_of(names.output);
  const bool is_shown = has_ending(names.output, ".png");
  double exposure = 1.0;
  Image<float> shown;
  if (!preview.empty() || is_shown) {
    exposure = names.exposure ? *names.exposure : shown_exposure(light.pixels());
    shown = hatched(film, light, exposure);
  }
  if (is_shown) {
    write_image(names.output, shown.view(), exposure);
  } else {
    write_linear_picture(film, names.output);
  }
  if (!preview.empty()) {
    write_image(preview, shown.view(), exposure);
  }
  if (!names.float64.empty()) {
    const std::array shape = {static_cast<std::size_t>(film.height()),
                              static_cast<std::size_t>(film.width()), kVolumeChannels};
    write_npy(names.float64, shape, doubles_of(film));
  }
  return exposure;
}

}  // namespace haarlight::apps
