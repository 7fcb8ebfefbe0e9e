// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shape/shape_pipeline.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "relight/hull/camera_depths.h"
#include "relight/hull/hull_file.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/pipeline/session_stack.h"
#include "relight/pipeline/shape/shape_output.h"
#include "relight/reflectance/fit/far_fit.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "relight/shape/rti_normals.h"
#include "session/develop/sensor_response.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

/// Rows of the stack being made that are held at a time.
constexpr std::uint64_t kDevelopBytes = std::uint64_t{1} << 30U;

bool is_rti(ShapeMethod method) {
  return method == ShapeMethod::ptm || method == ShapeMethod::hsh;
}

/// White is the object; empty if no picture was given. @throws Error  another size
Image<std::uint8_t> read_mask(const ShapePipelineOptions& options, int width, int height) {
  if (options.mask != MaskChoice::picture) {
    return {};
  }
  const std::string file = options.mask_picture.string();
  const PictureFile picture = read_picture(options.mask_picture);
  if (picture.pixels.width() != width || picture.pixels.height() != height) {
    throw Error(fmt::format("a mask of {} x {} for pictures of {} x {}", picture.pixels.width(),
                            picture.pixels.height(), width, height),
                file, "draw the mask on one of the capture's own pictures");
  }
  Image<std::uint8_t> mask(height, width, 1);
  bool is_any = false;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      mask(y, x) = picture.pixels(y, x) > 0.5F ? 1 : 0;
      is_any = is_any || mask(y, x) != 0;
    }
  }
  if (!is_any) {
    throw Error("the mask leaves no pixel", file, "white is the object, black is left out");
  }
  return mask;
}

StereoLights choose_lights(const ShapePipelineOptions& options,
                           const session::Session& session) {
  CaptureLights all = capture_lights(session);
  StereoLights lights;
  lights.directions = std::move(all.directions);
  lights.near = std::move(all.near);
  if (options.light == ShapeLight::near && !all.are_near) {
    throw Error("only the lights' directions are known", session.folder().string(),
                "import the capture with positions (--places positions), or give --light far");
  }
  lights.are_near = options.light == ShapeLight::near ||
                    (options.light == ShapeLight::automatic && all.are_near &&
                     (session.rig().has_value() || options.width_mm > 0.0));
  for (const NearLight& light : lights.near) {
    lights.powers.push_back(light.power);
  }
  return lights;
}

ShapeOptions stereo_options(const ShapePipelineOptions& options) {
  ShapeOptions shape = options.shape;
  shape.stereo.fit.has_sigma = true;
  shape.stereo.progress = options.settings.progress;
  shape.chooses_fit = options.method == ShapeMethod::automatic;
  if (options.method == ShapeMethod::least_squares) {
    shape.stereo.fit.method = LambertMethod::least_squares;
  } else if (options.method == ShapeMethod::m_estimator) {
    shape.stereo.fit.method = LambertMethod::m_estimator;
  } else if (options.method == ShapeMethod::trimmed) {
    shape.stereo.fit.method = LambertMethod::trimmed;
  }
  return shape;
}

/// A picture without a scale: one unit per pixel.
PixelPoints pixels_without_scale(int width, int height) {
  return PixelPoints::orthographic(width, height, width);
}

/// Normals as derived by RTI viewers.
void find_rti_shape(const ShapePipelineOptions& options, const ReflectanceModel& model,
                    const Image<std::uint8_t>& mask, ShapeSummary& summary) {
  summary.shape = shape_of(rti_surface(model, mask.view(), summary.pixels.picture_from_world()),
                           summary.pixels, options.shape.integrate);
  summary.is_measured = false;
}

ShapeSummary shape_of_file(const ShapePipelineOptions& options) {
  if (!options.hull.empty()) {
    throw Error("a hull belongs to a session's pictures, not to a file of normals",
                options.hull.string(), "give the session", ExitCode::usage);
  }
  ReflectanceReading reading;
  reading.transfer = options.transfer.value_or(Transfer::srgb);
  reading.most_bytes = options.settings.memory_bytes / 2;
  const ReflectanceModel model = read_reflectance(options.input, reading);
  const std::string basis(to_string(model.basis));
  if (options.method != ShapeMethod::automatic && to_string(options.method) != basis) {
    throw Error(fmt::format("the file holds {}: its normals are not found by {}", basis,
                            to_string(options.method)),
                options.input.string(), "leave --method out, or give the session",
                ExitCode::usage);
  }
  if (model.colour == ReflectanceColour::pca) {
    throw Error(fmt::format("normals are taken from a PTM or an HSH, not from {}", basis),
                options.input.string(), "make one of it: haarlight convert IN OUT.ptm");
  }
  const int width = model.planes.width();
  const int height = model.planes.height();
  const Image<std::uint8_t> mask = read_mask(options, width, height);
  ShapeSummary summary;
  summary.method = basis;
  summary.by = basis;
  summary.has_scale = options.width_mm > 0.0;
  summary.pixels = summary.has_scale
                       ? PixelPoints::orthographic(width, height, options.width_mm)
                       : pixels_without_scale(width, height);
  find_rti_shape(options, model, mask, summary);
  return summary;
}

/// Plain least squares on the coded values, as RTI software fits them.
ReflectanceModel fit_rti(const ShapePipelineOptions& options, const session::Session& session,
                         PipelineNotes& notes) {
  const bool is_ptm = options.method == ShapeMethod::ptm;
  SessionRowsOptions rows;
  rows.develop.memory_bytes = options.settings.memory_bytes;
  rows.develop.unknown_as = options.transfer;
  LightInterpolation interpolation;
  interpolation.basis = is_ptm ? ReflectanceBasis::ptm : ReflectanceBasis::hsh;
  interpolation.n_terms = is_ptm ? 6 : 9;
  FarFitOptions fit_options;
  fit_options.planes.memory_bytes = options.settings.memory_bytes / 4;
  fit_options.planes.work_folder = fs::absolute(options.out).parent_path();
  fit_options.progress = options.settings.progress;
  const std::vector<Vector3d> directions = picture_directions(session);
  for (const std::string& warning : light_warnings(directions)) {
    notes.add(NoteKind::warning, warning);
  }
  const FarFit fit =
      make_far_fit(is_ptm ? FitForm::ptm : FitForm::hsh9, interpolation, directions, {}, {});
  return fit_far(*session_rows(session, rows), fit, fit_options).model;
}

/// The mask in use: given, detected, or every pixel.
void choose_mask(const ShapePipelineOptions& options, const session::Session& session,
                 const StackSource& stack, const StereoLights& lights,
                 Image<std::uint8_t> given, ShapeSummary& summary) {
  const StackDims dims = stack.dims();
  if (!given.is_empty()) {
    const auto n = std::count_if(given.pixels().begin(), given.pixels().end(),
                                 [](std::uint8_t value) { return value != 0; });
    summary.mask = {std::move(given), MaskOrigin::whole, n};
    summary.mask_by = "given";
    return;
  }
  summary.mask_by = "every pixel";
  if (options.mask == MaskChoice::every) {
    summary.mask.mask = Image<std::uint8_t>(dims.height, dims.width, 1);
    std::fill(summary.mask.mask.pixels().begin(), summary.mask.mask.pixels().end(),
              std::uint8_t{1});
    summary.mask.n_object = static_cast<std::int64_t>(dims.n_pixels());
    return;
  }
  if (session.rig().has_value()) {
    StereoLights near = lights;
    near.are_near = true;
    summary.mask = mask_by_plane(stack, near, pixel_points(session, options.width_mm));
  } else {
    summary.mask = mask_by_darkness(stack, lights);
  }
  if (summary.mask.origin != MaskOrigin::whole) {
    summary.mask_by = fmt::format("found by {}", to_string(summary.mask.origin));
  }
}

DepthBounds log_of(const DepthRange& depths) {
  const int h = depths.nearest.height();
  const int w = depths.nearest.width();
  DepthBounds bounds{Image<float>(h, w, 1), Image<float>(h, w, 1)};
  for (std::size_t i = 0; i < depths.nearest.pixels().size(); ++i) {
    if (depths.nearest.pixels()[i] > 0.0F) {
      bounds.low.pixels()[i] = std::log(depths.nearest.pixels()[i]);
      bounds.high.pixels()[i] = std::log(depths.furthest.pixels()[i]);
    }
  }
  return bounds;
}

/// @throws Error  no hull, or not of this object
HullBounds read_hull_bounds(const ShapePipelineOptions& options, const CameraModel& camera,
                            ShapeSummary& summary) {
  // Four objects against their own hulls: 0.85 and more, 0.32 and less; against each other's:
  // 0.65 and less, or 0.86 and more.
  constexpr double kLeastMet = 0.75;      // of the object's pixels
  constexpr double kMostElsewhere = 0.5;  // pixels beside the object, of its own number
  const ShadowHull hull = read_hull(options.hull);
  const CameraDepths depths = camera_depths(hull, camera, summary.mask.mask.view());
  const auto n = static_cast<double>(depths.n_wanted);
  if (depths.n_met == 0 || static_cast<double>(depths.n_met) < kLeastMet * n) {
    throw Error(fmt::format("of {} pixels that show the object only {} look at the hull: it is "
                            "of another object or rig",
                            depths.n_wanted, depths.n_met),
                options.hull.string(), "give the hull of this capture, or a --mask");
  }
  // A mask that is drawn may leave out part of the object.
  if (options.mask == MaskChoice::found &&
      static_cast<double>(depths.n_elsewhere) > kMostElsewhere * n) {
    throw Error(
        fmt::format("{} pixels look at the hull and do not show the object, which has {}: "
                    "it is of another object or rig",
                    depths.n_elsewhere, depths.n_wanted),
        options.hull.string(), "give the hull of this capture, or a --mask");
  }
  summary.n_met_hull = depths.n_met;
  HullBounds bounds{log_of(depths.possible), log_of(depths.likely), 0.0};
  double sum = 0.0;
  for (const float nearest : depths.possible.nearest.pixels()) {
    sum += nearest > 0.0F ? 1.0 / double{nearest} : 0.0;
  }
  bounds.sigma = hull.grid.voxel_mm * sum / static_cast<double>(depths.n_met);
  return bounds;
}

/// Photometric stereo.
void measure_shape(const ShapePipelineOptions& options, const session::Session& session,
                   const StereoLights& lights, Image<std::uint8_t> given,
                   ShapeSummary& summary) {
  session::DevelopOptions develop =
      develop_options(session, options.settings, options.transfer);
  develop.memory_bytes = std::min(develop.memory_bytes, kDevelopBytes);
  session::Developed developed = session::develop_all(session, develop);
  if (developed.n_saturated > 0 && session::sensor_response(session).is_measured) {
    develop.has_standard_error = true;
    developed = session::develop_all(session, develop);
  }
  ShapeOptions shape = stereo_options(options);
  shape.stereo.saturation = clip_levels(session);
  shape.finds_part_heights = session.rig().has_value() && !options.height_mm.has_value();
  if (developed.standard_error) {
    shape.stereo.errors = &*developed.standard_error;
  }
  const LightStack& stack = developed.stack;
  choose_mask(options, session, stack, lights, std::move(given), summary);
  HullBounds bounds;
  if (!options.hull.empty()) {
    bounds = read_hull_bounds(options, *summary.pixels.camera(), summary);
    shape.hull = &bounds;
  }
  summary.shape = recover_shape(stack, lights, summary.pixels, summary.mask.mask.view(), shape);
}

ShapeSummary shape_of_session(const ShapePipelineOptions& options, PipelineNotes& notes) {
  if (is_rti(options.method) && options.light == ShapeLight::near) {
    throw Error(
        fmt::format("{} knows lights by their directions alone", to_string(options.method)),
        "--light near", "leave it out, or choose another --method", ExitCode::usage);
  }
  const session::Session session = session::Session::open(options.input);
  if (!options.hull.empty() && !session.rig().has_value()) {
    throw Error("the hull is in a rig's frame: this session has no rig", options.hull.string(),
                "leave --hull out", ExitCode::usage);
  }
  const session::FrameForm& form = session.info().form;
  StereoLights lights = choose_lights(options, session);
  lights.are_near = lights.are_near && !is_rti(options.method);
  if (!options.hull.empty() && (!lights.are_near || options.height_mm)) {
    throw Error(options.height_mm
                    ? "the hull and --height-mm both say how high the object stands"
                    : "heights in mm need near lights",
                "--hull",
                options.height_mm ? "leave one of them out"
                                  : "leave out --light far and --method ptm or hsh",
                ExitCode::usage);
  }
  Image<std::uint8_t> mask = read_mask(options, form.width, form.height);
  ShapeSummary summary;
  summary.method = to_string(options.method);
  summary.are_near = lights.are_near;
  summary.photographed = notes_of(session.info());
  summary.has_scale = session.rig().has_value() || options.width_mm > 0.0;
  summary.pixels =
      lights.are_near || summary.has_scale
          ? pixel_points(session, options.width_mm, options.height_mm.value_or(0.0))
          : pixels_without_scale(form.width, form.height);
  const char* model = lights.are_near ? "near" : "far";
  summary.by = fmt::format("{}, {}", counted(lights.directions.size(), "light"),
                           is_rti(options.method) ? to_string(options.method) : model);
  if (is_rti(options.method)) {
    find_rti_shape(options, fit_rti(options, session, notes), mask, summary);
  } else {
    measure_shape(options, session, lights, std::move(mask), summary);
  }
  if (lights.are_near) {
    summary.by += ", " + counted(summary.shape.changes.size(), "round");
  }
  return summary;
}

}  // namespace

ShapeSummary recover_capture_shape(const ShapePipelineOptions& options) {
  if (options.preview.isZero(0.0)) {
    throw Error("--preview 0,0,0 is no direction", "", "for example: --preview 0.5,0.5,1",
                ExitCode::usage);
  }
  require_absent(options.out, options.settings.overwrites);
  const bool is_file =
      fs::is_regular_file(options.input) ||
      (fs::exists(options.input) && recognise_reflectance(options.input).has_value());
  PipelineNotes notes(options.settings.tell);
  ShapeSummary summary = is_file ? shape_of_file(options) : shape_of_session(options, notes);
  if (summary.shape.surface.n_in(PixelState::good) == 0) {
    throw Error("no pixel has a normal", options.input.string(),
                "look at the pictures' exposure, the mask and the list of lights");
  }
  summary.bytes = write_shape(options, summary);
  summary.notes = notes.all();
  return summary;
}

}  // namespace haarlight::relight
