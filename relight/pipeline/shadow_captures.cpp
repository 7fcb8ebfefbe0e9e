// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shadow_captures.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/rig_lights.h"

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

}  // namespace

bool is_plate_captured(const ShadowOptions& options) {
  return options.plate != "computed" && options.plate != "falloff";
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

ShadowCaptures::ShadowCaptures(const ShadowOptions& options) : options_(options) {
  captures_.push_back(std::make_unique<ShadowCapture>(options.basis));
  for (const std::string& file : options.also) {
    captures_.push_back(std::make_unique<ShadowCapture>(file));
    require_same_lights(rig(), captures_.back()->rig, file);
  }
  for (const auto& capture : captures_) {
    for (const ShadowPlane& plane : capture->rig.planes) {
      capture->frames.push_back(make_plane_frame(plane));
    }
    capture->chosen = find_planes(capture->rig, options.planes, capture->basis.name());
    n_planes_ += capture->chosen.size();
  }
  constexpr std::size_t kMaxPlanes = 8;
  if (n_planes_ > kMaxPlanes) {
    throw Error(fmt::format("{} planes; at most {} are joined", n_planes_, kMaxPlanes),
                "command line", "name some with --plane", ExitCode::usage);
  }
}

void ShadowCaptures::read_plate_and_mask() {
  if (is_plate_captured(options_)) {
    plate_file_ = BasisFile::open(options_.plate);
    if (n_planes_ > 1) {
      throw Error("a captured clean plate is of one plane, here are several", "--plate",
                  "name one plane with --plane, or leave --plate out", ExitCode::usage);
    }
  }
  mask_ = read_mask(options_.mask);
  const CameraModel& eye = rig().cameras[0].model;
  if (!mask_.is_empty() && (mask_.width() != eye.width || mask_.height() != eye.height)) {
    throw Error(fmt::format("the mask is {} x {}, the camera {} x {}", mask_.width(),
                            mask_.height(), eye.width, eye.height),
                options_.mask, "draw it on one of the camera's pictures");
  }
  if (!mask_.is_empty() && n_planes_ > 1) {
    throw Error("a mask is of one plane, here are several", "--mask",
                "name one plane with --plane", ExitCode::usage);
  }
}

std::vector<SamplingPlane> ShadowCaptures::sample(const std::vector<int>& wanted,
                                                  std::vector<ShadowPlate>& plates) {
  std::vector<SamplingPlane> planes;
  for (const auto& capture : captures_) {
    const CameraModel& eye = capture->rig.cameras[0].model;
    for (const std::size_t i : capture->chosen) {
      const PlaneFrame& here = capture->frames[i];
      if (plate_file_) {
        capture->plates.push_back(std::make_unique<BasisSource>(*plate_file_));
      } else {
        capture->plates.push_back(std::make_unique<RigPlate>(
            eye, capture->frames, i, render::rig_lights(capture->rig),
            options_.plate == "falloff" ? PlateKind::points : PlateKind::squares));
      }
      StackVisibility* shadow = nullptr;
      if (!wanted.empty()) {
        StackVisibilityOptions visibility_options;
        visibility_options.shows_plane = mask_;
        visibility_options.memory_bytes = options_.settings.memory_bytes / (4 * n_planes_);
        capture->shadows.push_back(
            std::make_unique<StackVisibility>(capture->stack, *capture->plates.back(), eye,
                                              here, wanted, std::move(visibility_options)));
        shadow = capture->shadows.back().get();
        plates.push_back({shadow->scale(), shadow->known_fraction()});
      }
      planes.push_back({here, [shadow](int k) { return shadow->visibility(k); },
                        over_plane(options_.object, frame(), here)});
    }
  }
  return planes;
}

}  // namespace haarlight::relight
