// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/captured_hull.h"

#include <numeric>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/rig_lights.h"
#include "relight/hull/hull_file.h"
#include "relight/pipeline/shadow_captures.h"

namespace haarlight::relight {

namespace {

HullOptions hull_options(const ShadowOptions& options) {
  HullOptions hull;
  if (options.object) {
    hull.highest_mm = options.object->high_mm;
  }
  hull.voxel_mm = options.hull_voxel_mm;
  hull.carve.memory_bytes = options.settings.memory_bytes / 4;
  hull.carve.progress = options.settings.progress;
  return hull;
}

/// All that the hull is made from, as one hash.
std::string hull_key(const ShadowCaptures& captures, const ShadowOptions& options) {
  std::string text = fmt::format("hull {}\n", kHullVersion);
  for (const auto& capture : captures.all()) {
    text += capture->basis.content_key() + "\n";
    for (const std::size_t plane : capture->chosen) {
      text += fmt::format("plane {}\n", plane);
    }
  }
  if (options.object) {
    text += fmt::format("highest {}\n", options.object->high_mm);
  }
  text += fmt::format("voxel {}\n", options.hull_voxel_mm);
  text +=
      is_plate_captured(options) ? BasisFile::open(options.plate).content_key() : options.plate;
  if (!options.mask.empty()) {
    text += "\n" + content_hash(read_file(options.mask));
  }
  return content_hash(text);
}

/// A mask without the pixels next to its zeros: those on an outline show both.
Image<std::uint8_t> without_rim(const Image<std::uint8_t>& mask) {
  return grow_hidden(mask.view());
}

/// What each capture's camera sees through.
std::vector<CarvingView> views_of(const ShadowCaptures& captures) {
  std::vector<CarvingView> views;
  for (const auto& capture : captures.all()) {
    CarvingView view{capture->rig.cameras[0].model, capture->shadows[0]->shows_plane(), {}};
    for (const auto& shadow : capture->shadows) {
      const auto& shown = shadow->shows_plane().pixels();
      for (std::size_t i = 0; i < shown.size(); ++i) {
        view.shows_plane.pixels()[i] =
            view.shows_plane.pixels()[i] != 0 || shown[i] != 0 ? 1 : 0;
      }
    }
    view.shows_object = without_rim(object_pixels(*capture));
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace

CapturedHull captured_hull(const ShadowOptions& options) {
  ShadowCaptures captures(options);
  const std::string key = hull_key(captures, options);
  CapturedHull found;
  found.file = options.basis + ".hull";
  if (std::optional<ShadowHull> kept = read_hull_of(found.file, key)) {
    found.hull = std::move(*kept);
    found.is_carved = false;
    return found;
  }
  captures.read_plate_and_mask();
  const std::vector<render::SquareLight> lights = render::rig_lights(captures.rig());
  std::vector<int> all(lights.size());
  std::iota(all.begin(), all.end(), 0);
  std::vector<ShadowPlate> plates;
  const std::vector<SamplingPlane> planes = captures.sample(all, plates);
  found.hull = build_hull(planes, lights, views_of(captures), hull_options(options));
  try {
    write_hull(found.hull, key, found.file);
  } catch (const Error& error) {
    found.why_not_kept = error.what();
    found.file.clear();
  }
  return found;
}

}  // namespace haarlight::relight
