// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/captured_hull.h"

#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/hull/hull_file.h"
#include "relight/pipeline/shadow_captures.h"

namespace haarlight::relight {

namespace {

HullOptions hull_options(const CapturedObject& captured, double voxel_mm,
                         const PipelineSettings& settings) {
  HullOptions hull;
  if (captured.height) {
    hull.highest_mm = captured.height->high_mm;
  }
  hull.voxel_mm = voxel_mm;
  hull.carve.memory_bytes = settings.memory_bytes / 4;
  hull.carve.progress = settings.progress;
  return hull;
}

/// All that the hull is made from, as one hash.
std::string hull_key(const ShadowCaptures& captures, const CapturedObject& captured,
                     double voxel_mm) {
  std::string text = fmt::format("hull {}\n", kHullVersion);
  for (const auto& capture : captures.all()) {
    text += capture->basis.content_key() + "\n";
    for (const std::size_t plane : capture->chosen) {
      text += fmt::format("plane {}\n", plane);
    }
  }
  if (captured.height) {
    text += fmt::format("highest {}\n", captured.height->high_mm);
  }
  text += fmt::format("voxel {}\n", voxel_mm);
  text += is_plate_captured(captured) ? BasisFile::open(captured.plate).content_key()
                                      : captured.plate;
  if (!captured.mask.empty()) {
    text += "\n" + content_hash(read_file(captured.mask));
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

CapturedHull captured_hull(const CapturedObject& captured, double voxel_mm,
                           const PipelineSettings& settings, PipelineNotes& told) {
  ShadowCaptures captures(captured, settings.memory_bytes);
  const std::string key = hull_key(captures, captured, voxel_mm);
  const std::string file = captured.basis + ".hull";
  if (std::optional<ShadowHull> kept = read_hull_of(file, key);
      kept && captures.fits(kept->planes)) {
    const HullSummary summary = kept->summary;
    tell_offset(summary.offset_plane, summary.offset, told);
    return {std::move(*kept), {summary, file, false}};
  }
  captures.read_plate_and_mask();
  const std::vector<render::SquareLight> lights = render::rig_lights(captures.rig());
  std::vector<int> all(lights.size());
  std::iota(all.begin(), all.end(), 0);
  std::vector<ShadowPlate> plates;
  const std::vector<SamplingPlane> planes = captures.sample(all, plates);
  CapturedHull found;
  found.hull = build_hull(planes, lights, views_of(captures),
                          hull_options(captured, voxel_mm, settings));
  found.hull.planes = captures.found();
  HullSummary& summary = found.hull.summary;
  for (const ShadowPlate& plate : plates) {
    const auto weight = [](const PlaneOffset& offset) {  // one to be told comes first
      return std::pair(offset.is_noticeable, offset.most_mm);
    };
    if (summary.offset_plane.empty() || weight(plate.offset) > weight(summary.offset)) {
      summary.offset = plate.offset;
      summary.offset_plane = plate.plane;
    }
  }
  tell_offset(summary.offset_plane, summary.offset, told);
  found.source.hull = summary;
  try {
    write_hull(found.hull, key, file);
    found.source.file = file;
  } catch (const Error& error) {
    told.add(NoteKind::note,
             fmt::format("the hull is not kept, it will be carved again: {}", error.what()));
  }
  return found;
}

std::string hull_words(const HullSource& hull) {
  const HullSummary& s = hull.hull;
  std::string text = fmt::format(
      "  the hull: {} voxels of {:.2g} mm are taken as matter, {:.0f} to {:.0f} mm over the "
      "plane; too few lights saw {} of these to be sure, and {} others that may be matter "
      "({})\n",
      s.n_matter + s.n_assumed_full, s.voxel_mm, s.low_mm, s.high_mm, s.n_assumed_full,
      s.n_assumed_empty,
      hull.file.empty()
          ? "not kept"
          : fmt::format("{} {}", hull.is_carved ? "kept in" : "read from", hull.file));
  if (s.touches_border) {
    text +=
        "  the object reaches the border of the plane's picture: what is beyond is not in it\n";
  }
  if (s.leaves_camera) {
    text +=
        "  the border of the camera's picture cuts the object: what is beyond is not in the "
        "hull\n";
  }
  return text;
}

void add_to_report(const HullSource& source, Report& report) {
  const HullSummary& hull = source.hull;
  report.add_detail("hull_voxel_mm", hull.voxel_mm);
  report.add_detail("hull_voxels", hull.n_voxels);
  report.add_detail("hull_matter_voxels", hull.n_matter);
  report.add_detail("hull_assumed_full_voxels", hull.n_assumed_full);
  report.add_detail("hull_assumed_empty_voxels", hull.n_assumed_empty);
  report.add_detail("hull_low_mm", hull.low_mm);
  report.add_detail("hull_high_mm", hull.high_mm);
  report.add_achieved("hull_plane_off_mm", hull.offset.most_mm);
  report.add_detail("hull_is_carved", source.is_carved);
}

}  // namespace haarlight::relight
