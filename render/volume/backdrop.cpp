// SPDX-License-Identifier: Apache-2.0
#include "render/volume/backdrop.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_depth.h"

namespace haarlight::render {

using Eigen::Array3d;

namespace {

/// What reading a named file throws, where the scene names it.
template <class Read>
auto read_named(const char* what, const std::string& where, const Read& read) {
  try {
    return read();
  } catch (const Error& error) {
    throw Error(fmt::format("{}: {} ({})", what, error.problem(), error.where()), where,
                error.hint(), error.code());
  }
}

double largest_of(const Image<float>& picture) {
  double largest = 0.0;
  for (const float value : picture.pixels()) {
    largest = std::max(largest, std::abs(static_cast<double>(value)));
  }
  return largest;
}

}  // namespace

Array3d light_of(const Background& background, int x, int y, int height) {
  switch (background.kind) {
    case BackgroundKind::colour:
      break;
    case BackgroundKind::gradient: {
      const double of_bottom = (y + 0.5) / height;
      return (1.0 - of_bottom) * background.colour + of_bottom * background.other;
    }
    case BackgroundKind::checker:
      return (x / background.square_px + y / background.square_px) % 2 == 0 ? background.colour
                                                                            : background.other;
    case BackgroundKind::picture: {
      const int last = background.picture.channels() - 1;
      return {background.picture(y, x, 0), background.picture(y, x, std::min(1, last)),
              background.picture(y, x, last)};
    }
  }
  return background.colour;
}

double brightest_of(const Background& background) {
  return std::max({background.colour.maxCoeff(), background.other.maxCoeff(),
                   largest_of(background.picture)});
}

double brightest_of(const SurfacesBehind& surfaces) { return largest_of(surfaces.light); }

SurfacesBehind read_surfaces(const std::filesystem::path& file, const std::string& where) {
  PictureWithDepth picture = read_named("the picture of [behind]", where,
                                        [&] { return read_picture_with_depth(file); });
  for (int y = 0; y < picture.depth.height(); ++y) {
    for (int x = 0; x < picture.depth.width(); ++x) {
      if (std::isnan(picture.depth(y, x))) {
        throw Error(fmt::format("channel Z of pixel (x {}, y {}) of {} is not a number", x, y,
                                file.string()),
                    where, "render the surfaces again: 1e10 stands for no surface");
      }
    }
  }
  return {.file = file,
          .light = std::move(picture.light),
          .depth = std::move(picture.depth),
          .where = where};
}

void read_background(Background& background) {
  background.picture = read_named("the picture of [background]", background.where,
                                  [&] { return read_linear_image(background.file); });
}

}  // namespace haarlight::render
