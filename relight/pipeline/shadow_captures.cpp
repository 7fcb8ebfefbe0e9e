// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shadow_captures.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/shadow/plane_views.h"

namespace haarlight::relight {

namespace {

Rig rig_of(const BasisFile& basis) {
  if (basis.header().rig_toml.empty()) {
    throw Error("the basis file has no rig: neither camera nor shadow plane is known",
                basis.name(),
                "capture with a calibrated rig; an import without one cannot cast shadows");
  }
  Rig rig = parse_rig(basis.header().rig_toml, basis.name() + " (rig)");
  if (rig.planes.empty() || rig.cameras.empty()) {
    throw Error("the rig has no [[plane]] or no [[camera]]", basis.name() + " (rig)",
                "add the shadow plane and the calibrated camera to the rig file");
  }
  return rig;
}

/// The rig's planes of these names; all without names.
std::vector<std::size_t> find_planes(const Rig& rig, const std::vector<std::string>& ids,
                                     const std::string& where) {
  std::vector<std::size_t> found;
  for (std::size_t i = 0; i < rig.planes.size(); ++i) {
    if (ids.empty() || std::find(ids.begin(), ids.end(), rig.planes[i].id) != ids.end()) {
      found.push_back(i);
    }
  }
  for (const std::string& id : ids) {
    if (std::none_of(rig.planes.begin(), rig.planes.end(),
                     [&](const ShadowPlane& plane) { return plane.id == id; })) {
      throw Error(fmt::format("the rig has no plane \"{}\"", id), where,
                  fmt::format("the first one is \"{}\"", rig.planes[0].id), ExitCode::usage);
    }
  }
  return found;
}

/// Heights over another plane, if parallel to the one over which they were given.
std::optional<HeightRange> over_plane(const std::optional<HeightRange>& object,
                                      const PlaneFrame& given, const PlaneFrame& other) {
  constexpr double kParallel = 1e-6;
  if (!object || (given.plane.n - other.plane.n).norm() > kParallel) {
    return std::nullopt;
  }
  const double shift = other.plane.d - given.plane.d;
  return HeightRange{object->low_mm + shift, object->high_mm + shift};
}

void require_same_lights(const Rig& rig, const Rig& other, const std::string& file) {
  const std::vector<LightElement> a = light_elements(rig);
  const std::vector<LightElement> b = light_elements(other);
  constexpr double kMoved = 1.0;  // mm
  bool is_same = a.size() == b.size();
  for (std::size_t k = 0; is_same && k < a.size(); ++k) {
    is_same = (a[k].centre - b[k].centre).norm() < kMoved;
  }
  if (!is_same) {
    throw Error("its lights are not those of the first capture", file,
                "captures are joined when only the plane has moved between them");
  }
}

Image<std::uint8_t> read_mask(const std::string& file) {
  if (file.empty()) {
    return {};
  }
  const Image<float> picture = read_linear_image(file);
  Image<std::uint8_t> mask(picture.height(), picture.width(), 1);
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      mask(y, x) = picture(y, x) > 0.2F ? 1 : 0;  // sRGB middle grey
    }
  }
  return mask;
}

/// Of each light's picture, as the file states it.
struct CodingErrors {
  std::vector<double> relative_l2;
  std::vector<double> rms;  ///< of a value summed over the channels, unit of the stack
};

CodingErrors coding_errors(const BasisFile& basis) {
  const BasisTables& tables = basis.tables();
  const auto n = static_cast<std::size_t>(basis.header().dims.n_lights);
  const auto n_pixels = static_cast<double>(basis.header().dims.n_pixels());
  CodingErrors errors{std::vector<double>(n), std::vector<double>(n)};
  for (std::size_t k = 0; k < n; ++k) {
    double error = 0.0;
    double norm = 0.0;
    for (std::size_t i = k; i < tables.light_errors.size(); i += n) {
      error = std::hypot(error, static_cast<double>(tables.light_errors[i]));
      norm = std::hypot(norm, static_cast<double>(tables.light_norms[i]));
    }
    errors.relative_l2[k] = norm > 0.0 ? error / norm : 0.0;
    errors.rms[k] = error / std::sqrt(n_pixels);
  }
  return errors;
}

/// How much of one plane's picture each capture knows, and all together.
JoinedPlane join_known(std::span<StackVisibility* const> views) {
  JoinedPlane joined;
  Image<std::uint8_t> known = views[0]->known();
  for (const StackVisibility* view : views) {
    joined.known_fractions.push_back(view->known_fraction());
    std::transform(known.pixels().begin(), known.pixels().end(), view->known().pixels().begin(),
                   known.pixels().begin(), std::bit_or<>());
  }
  const auto pixels = known.pixels();
  joined.known_fraction =
      static_cast<double>(std::count(pixels.begin(), pixels.end(), std::uint8_t{1})) /
      static_cast<double>(pixels.size());
  return joined;
}

/// One plane's pictures, from all captures that show it. A finer camera counts more.
/// @param views  outlive the source
VisibilitySource source_of(const std::vector<StackVisibility*>& views) {
  return [&views](int k) {
    if (views.size() == 1) {
      return views[0]->visibility(k);
    }
    std::vector<Visibility> pictures;
    std::vector<double> weights;
    for (StackVisibility* view : views) {
      pictures.push_back(view->visibility(k));
      weights.push_back(view->pixels_per_texel() * view->pixels_per_texel());
    }
    return join_views(pictures, weights);
  };
}

}  // namespace

void require_heights(const CapturedObject& captured) {
  if (captured.height && !(captured.height->low_mm <= captured.height->high_mm)) {
    throw Error("the object's lowest point is above its highest", "--object-height",
                "write LOW,HIGH in mm over the plane", ExitCode::usage);
  }
}

void tell_offset(const std::string& plane, const PlaneOffset& offset, PipelineNotes& told) {
  if (!offset.is_noticeable) {
    return;
  }
  told.add(
      NoteKind::warning,
      fmt::format("{} does not fit the rig file: over what most pixels show the light falls "
                  "off as over a plane {:.1f} mm {} the lights, tilted by {:.2f} degrees, up "
                  "to {:.1f} mm off within its picture (a pixel's error {:.1f} mm). The "
                  "position of the plane or the lights, or lobe_mu, is wrong, or a flat "
                  "object fills most of the picture. Shadows and hull are wrong by it: "
                  "measure plane and lights (haarlight rig calibrate) and capture again",
                  plane, std::abs(offset.mm), offset.mm > 0.0 ? "nearer to" : "farther from",
                  offset.tilt_deg, offset.most_mm, offset.error_mm));
}

bool is_plate_captured(const CapturedObject& captured) {
  return captured.plate != "computed" && captured.plate != "falloff";
}

/// Where the camera sees the object: pixels that show any of the planes are not the object;
/// those that one plate does not see may be.
Image<std::uint8_t> object_pixels(const ShadowCapture& capture) {
  Image<std::uint8_t> shows_object = capture.shadows[0]->shows_object();
  for (const auto& shadow : capture.shadows) {
    for (std::size_t i = 0; i < shows_object.pixels().size(); ++i) {
      const bool is_plane = shadow->shows_plane().pixels()[i] != 0;
      shows_object.pixels()[i] = !is_plane && (shows_object.pixels()[i] != 0 ||
                                               shadow->shows_object().pixels()[i] != 0)
                                     ? 1
                                     : 0;
    }
  }
  return shows_object;
}

ShadowCapture::ShadowCapture(const std::string& file)
    : basis(BasisFile::open(file)), rig(rig_of(basis)), stack(basis) {}

ShadowCaptures::ShadowCaptures(const CapturedObject& captured, std::uint64_t memory_bytes)
    : captured_(captured), memory_bytes_(memory_bytes) {
  captures_.push_back(std::make_unique<ShadowCapture>(captured.basis));
  for (const std::string& file : captured.also) {
    captures_.push_back(std::make_unique<ShadowCapture>(file));
    require_same_lights(rig(), captures_.back()->rig, file);
  }
  for (const auto& capture : captures_) {
    for (const ShadowPlane& plane : capture->rig.planes) {
      capture->frames.push_back(make_plane_frame(plane));
    }
    capture->chosen = find_planes(capture->rig, captured.planes, capture->basis.name());
    n_views_ += capture->chosen.size();
  }
  find_views();
  constexpr std::size_t kMaxPlanes = 8;
  if (planes_.size() > kMaxPlanes) {
    throw Error(fmt::format("{} planes; at most {} are joined", planes_.size(), kMaxPlanes),
                "command line", "name some with --plane", ExitCode::usage);
  }
}

void ShadowCaptures::find_views() {
  for (std::size_t c = 0; c < captures_.size(); ++c) {
    const ShadowCapture& capture = *captures_[c];
    const std::size_t n_before = planes_.size();  // planes of one rig are distinct
    for (const std::size_t i : capture.chosen) {
      const auto relation_to = [&](const std::vector<View>& views) {
        return relate_planes(captures_[views[0].capture]->frames[views[0].plane],
                             capture.frames[i]);
      };
      const auto end = planes_.begin() + static_cast<std::ptrdiff_t>(n_before);
      const auto same = std::find_if(planes_.begin(), end, [&](const auto& views) {
        return relation_to(views) == PlaneRelation::same;
      });
      if (same != end) {
        same->push_back({c, i});
        continue;
      }
      if (std::any_of(planes_.begin(), end, [&](const auto& views) {
            return relation_to(views) == PlaneRelation::reaches_out;
          })) {
        throw Error(
            fmt::format("its plane \"{}\" is one of the other captures', but reaches beyond "
                        "the picture there",
                        capture.rig.planes[i].id),
            capture.basis.name(),
            "give both rigs the same [[plane]] origin, u, v and extent, or name the capture "
            "with the larger picture first");
      }
      planes_.push_back({{c, i}});
    }
  }
}

void ShadowCaptures::read_plate_and_mask() {
  if (is_plate_captured(captured_)) {
    plate_file_ = BasisFile::open(captured_.plate);
    if (n_views_ > 1) {
      throw Error("a captured clean plate is of one capture's one plane, here are several",
                  "--plate",
                  "name one plane with --plane and leave --also out, or leave --plate out",
                  ExitCode::usage);
    }
  }
  mask_ = read_mask(captured_.mask);
  const CameraModel& eye = rig().cameras[0].model;
  if (!mask_.is_empty() && (mask_.width() != eye.width || mask_.height() != eye.height)) {
    throw Error(fmt::format("the mask is {} x {}, the camera {} x {}", mask_.width(),
                            mask_.height(), eye.width, eye.height),
                captured_.mask, "draw it on one of the camera's pictures");
  }
  if (!mask_.is_empty() && n_views_ > 1) {
    throw Error("a mask is of one capture's one plane, here are several", "--mask",
                "name one plane with --plane and leave --also out", ExitCode::usage);
  }
}

StackVisibility* ShadowCaptures::open_view(const View& view, const PlaneFrame& frame,
                                           const std::vector<int>& wanted,
                                           std::optional<FoundPlane> found,
                                           std::vector<ShadowPlate>& plates) {
  ShadowCapture& capture = *captures_[view.capture];
  const CameraModel& eye = capture.rig.cameras[0].model;
  if (plate_file_) {
    capture.plates.push_back(std::make_unique<BasisSource>(*plate_file_));
  } else {
    capture.plates.push_back(std::make_unique<RigPlate>(
        eye, capture.frames, view.plane, render::rig_lights(capture.rig),
        captured_.plate == "falloff" ? PlateKind::points : PlateKind::squares));
  }
  if (wanted.empty()) {
    return nullptr;
  }
  StackVisibilityOptions visibility_options;
  visibility_options.shows_plane = mask_;
  visibility_options.lights = render::rig_lights(capture.rig);
  CodingErrors errors = coding_errors(capture.basis);
  visibility_options.coding_errors = std::move(errors.relative_l2);
  visibility_options.value_errors = std::move(errors.rms);
  visibility_options.memory_bytes = memory_bytes_ / (4 * n_views_);
  visibility_options.found = std::move(found);
  capture.shadows.push_back(
      std::make_unique<StackVisibility>(capture.stack, *capture.plates.back(), eye, frame,
                                        wanted, std::move(visibility_options)));
  const StackVisibility& shadows = *capture.shadows.back();
  plates.push_back(
      {shadows.scale(), shadows.known_fraction(),
       fmt::format("{}: plane \"{}\"", capture.basis.name(), capture.rig.planes[view.plane].id),
       shadows.offset()});
  return capture.shadows.back().get();
}

std::vector<FoundPlane> ShadowCaptures::found() const {
  std::vector<FoundPlane> found;
  for (const std::vector<StackVisibility*>& views : opened_) {
    for (const StackVisibility* view : views) {
      if (view != nullptr) {
        found.push_back(view->found());
      }
    }
  }
  return found;
}

bool ShadowCaptures::fits(std::span<const FoundPlane> found) const {
  if (found.size() != n_views_) {
    return false;
  }
  std::size_t i = 0;
  for (const std::vector<View>& views : planes_) {
    for (const View& view : views) {
      const StackDims dims = captures_[view.capture]->stack.dims();
      for (const Image<std::uint8_t>* mask : {&found[i].shows_plane, &found[i].shows_object}) {
        if (mask->width() != dims.width || mask->height() != dims.height) {
          return false;
        }
      }
      ++i;
    }
  }
  return true;
}

std::vector<SamplingPlane> ShadowCaptures::sample(const std::vector<int>& wanted,
                                                  std::vector<ShadowPlate>& plates,
                                                  std::vector<FoundPlane> found) {
  HAARLIGHT_EXPECTS(found.empty() || fits(found), "one for each view, of its size");
  std::size_t n_taken = 0;
  std::vector<SamplingPlane> planes;
  joined_.clear();
  opened_.clear();
  planes.reserve(planes_.size());
  for (const std::vector<View>& views : planes_) {
    const PlaneFrame& here = captures_[views[0].capture]->frames[views[0].plane];
    std::vector<StackVisibility*>& opened = opened_.emplace_back();
    opened.reserve(views.size());
    for (const View& view : views) {
      opened.push_back(open_view(
          view, here, wanted,
          found.empty() ? std::optional<FoundPlane>() : std::move(found[n_taken++]), plates));
    }
    if (opened.size() > 1 && !wanted.empty()) {
      joined_.push_back(join_known(opened));
    }
    double resolution = here.texel_mm;
    double lookups = 0.0;
    for (const StackVisibility* view : opened) {
      if (view != nullptr) {
        resolution = std::max(resolution, here.texel_mm / view->pixels_per_texel());
        lookups += view->lookups_a_picture();
      }
    }
    planes.push_back({here, source_of(opened), over_plane(captured_.height, frame(), here),
                      resolution, lookups});
  }
  return planes;
}

}  // namespace haarlight::relight
