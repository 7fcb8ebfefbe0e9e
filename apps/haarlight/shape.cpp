// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight shape INPUT -o FOLDER`: normals, albedo, heights and a mesh of a capture.

#include <algorithm>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "apps/haarlight/develop_options.h"
#include "apps/haarlight/display_exposure.h"
#include "apps/haarlight/picture_notes.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/log.h"
#include "core/picture/image_io.h"
#include "relight/reflectance/fit/far_fit.h"
#include "relight/reflectance/fit/recipe_choice.h"
#include "relight/reflectance/formats/reflectance_file.h"
#include "relight/shape/height_bow.h"
#include "relight/shape/near_alternation.h"
#include "relight/shape/normal_picture.h"
#include "relight/shape/object_mask.h"
#include "relight/shape/rti_normals.h"
#include "relight/shape/surface_mesh.h"
#include "session/develop/develop.h"
#include "session/develop/sensor_response.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

struct ShapeArguments {
  std::string input;
  std::string out;
  std::string method;  ///< empty: chosen by lights held out, or what the file holds
  std::string loss = "tukey";
  std::string light = "automatic";
  std::string integrate = "poisson";
  std::string mesh = "both";
  std::string mask = "found";  ///< found, none, or a picture
  std::string transfer;
  PlaneArguments plane;
  double keep = LambertOptions{}.keep;
  double dark_share = LambertOptions{}.dark_share;
  double max_tilt_deg = SurfaceMeshOptions{}.max_tilt_deg;
  int max_rounds = ShapeOptions{}.max_rounds;
  bool is_open_at_cuts = false;
  std::vector<double> preview = {0.5, 0.5, 1.0};
};

constexpr const char* kFoundMask = "found";
constexpr const char* kNoMask = "none";

/// White is the object; empty where no picture was given. @throws Error  another size
Image<std::uint8_t> read_mask(const std::string& file, int width, int height) {
  if (file == kFoundMask || file == kNoMask) {
    return {};
  }
  const PictureFile picture = read_picture(file);
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

StereoLights choose_lights(const ShapeArguments& arguments, const Session& session) {
  CaptureLights all = capture_lights(session);
  StereoLights lights;
  lights.directions = std::move(all.directions);
  lights.near = std::move(all.near);
  if (arguments.light == "near" && !all.are_near) {
    throw Error("only the lights' directions are known", session.folder().string(),
                "import the capture with positions (--places positions), or give --light far");
  }
  lights.are_near = arguments.light == "near" ||
                    (arguments.light == "automatic" && all.are_near &&
                     (session.rig().has_value() || arguments.plane.width_mm > 0.0));
  for (const NearLight& light : lights.near) {
    lights.powers.push_back(light.power);
  }
  return lights;
}

ShapeOptions shape_options(const ShapeArguments& arguments) {
  const std::map<std::string, LambertMethod> methods = {
      {"", LambertOptions{}.method},
      {"least-squares", LambertMethod::least_squares},
      {"trimmed", LambertMethod::trimmed},
      {"m-estimator", LambertMethod::m_estimator}};
  const std::map<std::string, RobustLoss> losses = {{"huber", RobustLoss::huber},
                                                    {"cauchy", RobustLoss::cauchy},
                                                    {"tukey", RobustLoss::tukey}};
  const std::map<std::string, Integrator> integrators = {
      {"poisson", Integrator::poisson},
      {"frankot-chellappa", Integrator::frankot_chellappa},
      {"robust", Integrator::robust}};
  ShapeOptions options;
  if (const auto method = methods.find(arguments.method); method != methods.end()) {
    options.stereo.fit.method = method->second;
  }
  options.chooses_fit = arguments.method.empty();
  options.stereo.fit.has_sigma = true;
  options.stereo.fit.loss = losses.at(arguments.loss);
  options.stereo.fit.keep = arguments.keep;
  options.stereo.fit.dark_share = arguments.dark_share;
  options.integrate.method = integrators.at(arguments.integrate);
  options.max_rounds = arguments.max_rounds;
  return options;
}

std::vector<float> known_values(const Image<float>& picture, const Image<std::uint8_t>& known) {
  std::vector<float> values;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; known(y, x) != 0 && c < picture.channels(); ++c) {
        values.push_back(picture(y, x, c));
      }
    }
  }
  return values;
}

/// What was found, and where its pixels are.
struct Found {
  Shape shape;
  PixelPoints pixels;
  std::string by;  ///< what the normals come from, for people
  bool has_scale = false;
  bool is_measured = true;  ///< albedo and errors are there
  bool are_near = false;
  ObjectMask mask{};        ///< where it was looked for, and the one that counts
  std::string mask_by;      ///< found by plane, found by darkness, given, every pixel
  PictureNotes notes = {};  ///< the session, where it is one
};

constexpr double kWhiteSigmaDeg = 20.0;  // sigma.png: white is this or more

Image<float> as_picture(const Image<std::uint8_t>& mask) {
  Image<float> picture(mask.height(), mask.width(), 1);
  std::transform(mask.pixels().begin(), mask.pixels().end(), picture.pixels().begin(),
                 [](std::uint8_t value) { return value != 0 ? 1.0F : 0.0F; });
  return picture;
}

void write_shape(const ShapeArguments& arguments, const Found& found, const fs::path& folder) {
  const PictureNotes& notes = found.notes;
  const Shape& shape = found.shape;
  const PixelPoints& pixels = found.pixels;
  const std::string picture = found.is_measured ? "albedo.png" : "front.png";
  const Image<float> normals =
      turned_normals(shape.surface.normal.view(), pixels.picture_from_world());
  write_image(folder / "normals.png", normal_map(normals.view()).view(), 1.0, notes);
  write_image(folder / "normals.exr", normals.view(), 1.0, notes);
  const Image<std::uint8_t> good = shape.surface.is_good();
  const double exposure = display_exposure(known_values(shape.surface.albedo, good), 0.99);
  write_image(folder / picture, shape.surface.albedo.view(), exposure, notes);
  if (found.is_measured) {
    write_image(folder / "albedo.exr", shape.surface.albedo.view(), 1.0, notes);
    write_image(folder / "error.exr", shape.surface.error.view(), 1.0, notes);
    write_image(folder / "error.png", shape.surface.error.view(),
                display_exposure(known_values(shape.surface.error, good), 0.99), notes);
    write_image(folder / "sigma.exr", shape.surface.sigma_deg.view(), 1.0, notes);
    write_image(folder / "sigma.png", shape.surface.sigma_deg.view(), 1.0 / kWhiteSigmaDeg,
                notes);
    write_image(folder / "mask.png", as_picture(found.mask.mask).view(), 1.0, notes);
  }
  write_image(folder / "height.tif", shape.height.view());
  write_image(folder / "height.exr", shape.height.view(), 1.0, notes);
  EnhancedLook look;
  look.light = {arguments.preview[0], arguments.preview[1], arguments.preview[2]};
  write_image(folder / "preview.png",
              enhanced_picture(normals.view(), shape.surface.albedo.view(), look).view(), 1.0,
              notes);
  if (arguments.mesh == "none") {
    return;
  }
  SurfaceMeshOptions options;
  options.max_tilt_deg = arguments.max_tilt_deg;
  options.towards = pixels.picture_from_world().transpose() * Vector3d::UnitZ();
  Image<float> colour = shape.surface.albedo;
  for (float& value : colour.pixels()) {
    value *= static_cast<float>(exposure);
  }
  const ImageView<const std::uint8_t> cuts =
      arguments.is_open_at_cuts ? shape.map.is_cut.view() : ImageView<const std::uint8_t>();
  const SurfaceMesh mesh =
      make_surface_mesh(shape.points.view(), shape.map.is_known.view(), cuts,
                        shape.surface.normal.view(), colour.view(), options);
  if (arguments.mesh != "obj") {
    write_ply(mesh, folder / "mesh.ply");
  }
  if (arguments.mesh != "ply") {
    write_obj(mesh, folder / "mesh.obj", picture);
  }
}

/// What this share of the known normals' standard errors lies below, degrees.
double sigma_below(const Found& found, double share) {
  std::vector<float> values =
      known_values(found.shape.surface.sigma_deg, found.shape.surface.is_good());
  const auto at = values.begin() +
                  static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return double{*at};
}

std::string name_of(const LambertOptions& fit) {
  const std::map<RobustLoss, const char*> losses = {{RobustLoss::huber, "huber"},
                                                    {RobustLoss::cauchy, "cauchy"},
                                                    {RobustLoss::tukey, "tukey"}};
  return fit.method == LambertMethod::m_estimator
             ? fmt::format("m-estimator, {}", losses.at(fit.loss))
             : std::string(to_string(fit.method));
}

void add_fit(const Shape& shape, Report& report) {
  report.add_detail("fit", name_of(shape.fit));
  std::vector<double> held_out;
  std::string names;
  for (const FitScore& score : shape.scores) {
    held_out.push_back(score.held_out);
    names += (names.empty() ? "" : "; ") + score.name;
  }
  if (!held_out.empty()) {
    report.add_detail("fits_tried", names);
    report.add_detail("held_out_residuals", held_out);
  }
}

void add_doubts(const Shape& shape, Report& report) {
  const HeightBow bow = height_bow(shape.height.view(), shape.map.is_known.view());
  report.add_detail("heights_bow", bow.bow);
  report.add_detail("heights_without_bow", bow.rest);
  report.add_detail("light_nearness", shape.nearness.inverse);  // 1 / picture widths
  report.add_detail("light_nearness_sigma", shape.nearness.sigma);
}

void add_parts(const Shape& shape, Report& report) {
  std::vector<double> pixels;
  std::vector<double> heights;
  for (const PartHeight& part : shape.parts) {
    pixels.push_back(static_cast<double>(part.n_pixels));
    // Not known: null.
    heights.push_back(part.is_known ? part.mean_mm : std::numeric_limits<double>::infinity());
  }
  report.add_detail("part_pixels", pixels);
  report.add_detail("part_heights", heights);
}

void add_results(const Found& found, Report& report) {
  const Shape& shape = found.shape;
  const SurfaceEstimate& surface = shape.surface;
  report.add_reached("good_pixels", surface.n_in(PixelState::good));
  report.add_detail("masked_pixels", surface.n_in(PixelState::masked));
  if (found.is_measured) {
    report.add_detail("dark_pixels", surface.n_in(PixelState::too_dark));
    report.add_detail("saturated_pixels", surface.n_in(PixelState::saturated));
    report.add_detail("ambiguous_pixels", surface.n_in(PixelState::ambiguous));
    report.add_reached("sigma_deg_median", sigma_below(found, 0.5));
    report.add_reached("sigma_deg_nine_tenths", sigma_below(found, 0.9));
    report.add_detail("mask_by", found.mask_by);
    report.add_detail("mask_pixels", found.mask.n_object);
    add_fit(shape, report);
    add_doubts(shape, report);
  } else {
    report.add_detail("pixels_without_a_peak", surface.n_in(PixelState::too_dark));
  }
  report.add_reached("heights_range", shape.bow_mm);
  report.add_reached("is_settled", shape.is_settled);
  report.add_detail("height_changes", shape.changes);
  report.add_detail("parts", std::int64_t{shape.map.n_parts});
  add_parts(shape, report);
  report.add_detail("cuts", shape.map.n_cuts);
  report.add_detail("step_error", shape.map.step_error);
  report.add_detail("worst_step_error", shape.map.worst_step_error);
  report.add_detail("solver_residual", shape.map.solver_residual);
  report.add_detail("solver_iterations", std::int64_t{shape.map.iterations});
}

/// A picture without a scale: one unit a pixel.
PixelPoints pixels_without_scale(int width, int height) {
  return PixelPoints::orthographic(width, height, width);
}

/// Normals as RTI viewers take them.
void find_rti_shape(const ShapeArguments& arguments, const ReflectanceModel& model,
                    const Image<std::uint8_t>& mask, Found& found) {
  found.shape = shape_of(rti_surface(model, mask.view(), found.pixels.picture_from_world()),
                         found.pixels, shape_options(arguments).integrate);
  found.is_measured = false;
}

Found shape_of_file(const ShapeArguments& arguments, const CommonOptions& common,
                    Report& report) {
  ReflectanceReading reading;
  reading.transfer = transfer_asked(arguments.transfer).value_or(Transfer::srgb);
  reading.most_bytes = common.memory_bytes / 2;
  const ReflectanceModel model = read_reflectance(arguments.input, reading);
  const std::string basis(to_string(model.basis));
  if (!arguments.method.empty() && arguments.method != basis) {
    throw Error(fmt::format("the file holds {}: its normals are not found by {}", basis,
                            arguments.method),
                arguments.input, "leave --method out, or give the session", ExitCode::usage);
  }
  if (model.colour == ReflectanceColour::pca) {
    throw Error(fmt::format("normals are taken from a PTM or an HSH, not from {}", basis),
                arguments.input, "make one of it: haarlight convert IN OUT.ptm");
  }
  report.add_asked("method", basis);
  const int width = model.planes.width();
  const int height = model.planes.height();
  const Image<std::uint8_t> mask = read_mask(arguments.mask, width, height);
  Found found;
  found.has_scale = arguments.plane.width_mm > 0.0;
  found.pixels = found.has_scale
                     ? PixelPoints::orthographic(width, height, arguments.plane.width_mm)
                     : pixels_without_scale(width, height);
  found.by = basis;
  report.add_detail("light", "far");
  find_rti_shape(arguments, model, mask, found);
  return found;
}

/// Plain least squares on the coded values, as the programs of RTI fit them.
ReflectanceModel fit_rti(const ShapeArguments& arguments, const CommonOptions& common,
                         const Session& session) {
  const bool is_ptm = arguments.method == "ptm";
  SessionRowsOptions rows;
  rows.develop.memory_bytes = common.memory_bytes;
  rows.develop.unknown_as = transfer_asked(arguments.transfer);
  LightRecipe recipe;
  recipe.basis = is_ptm ? ReflectanceBasis::ptm : ReflectanceBasis::hsh;
  recipe.n_terms = is_ptm ? 6 : 9;
  FarFitOptions options;
  options.planes.memory_bytes = common.memory_bytes / 4;
  options.planes.work_folder = fs::absolute(arguments.out).parent_path();
  options.progress = common.progress();
  const std::vector<Vector3d> directions = picture_directions(session);
  for (const std::string& warning : light_warnings(directions)) {
    log_warning(warning);
  }
  const FarFit fit =
      make_far_fit(is_ptm ? FitForm::ptm : FitForm::hsh9, recipe, directions, {}, {});
  return fit_far(*session_rows(session, rows), fit, options).model;
}

/// The mask that counts: given, found, or every pixel.
void choose_mask(const ShapeArguments& arguments, const Session& session,
                 const StackSource& stack, const StereoLights& lights,
                 Image<std::uint8_t> given, Found& found) {
  const StackDims dims = stack.dims();
  if (!given.is_empty()) {
    const auto n = std::count_if(given.pixels().begin(), given.pixels().end(),
                                 [](std::uint8_t value) { return value != 0; });
    found.mask = {std::move(given), MaskOrigin::whole, n};
    found.mask_by = "given";
    return;
  }
  found.mask_by = "every pixel";
  if (arguments.mask == kNoMask) {
    found.mask.mask = Image<std::uint8_t>(dims.height, dims.width, 1);
    std::fill(found.mask.mask.pixels().begin(), found.mask.mask.pixels().end(),
              std::uint8_t{1});
    found.mask.n_object = static_cast<std::int64_t>(dims.n_pixels());
    return;
  }
  if (session.rig().has_value()) {
    StereoLights near = lights;
    near.are_near = true;
    found.mask = mask_by_plane(stack, near, pixel_points(session, arguments.plane.width_mm));
  } else {
    found.mask = mask_by_darkness(stack, lights);
  }
  if (found.mask.origin != MaskOrigin::whole) {
    found.mask_by = fmt::format("found by {}", to_string(found.mask.origin));
  }
}

/// Rows of the stack being made that are held at a time.
constexpr std::uint64_t kDevelopBytes = std::uint64_t{256} << 20U;

/// Photometric stereo.
void measure_shape(const ShapeArguments& arguments, const CommonOptions& common,
                   const Session& session, const StereoLights& lights,
                   Image<std::uint8_t> given, Found& found) {
  DevelopOptions develop = develop_options(session, common, arguments.transfer);
  develop.memory_bytes = std::min(develop.memory_bytes, kDevelopBytes);
  Developed developed = develop_all(session, develop);
  if (developed.n_saturated > 0 && sensor_response(session).is_measured) {
    develop.has_standard_error = true;
    developed = develop_all(session, develop);
  }
  ShapeOptions options = shape_options(arguments);
  options.stereo.progress = common.progress();
  options.stereo.saturation = clip_levels(session);
  options.finds_part_heights =
      session.rig().has_value() && !arguments.plane.height_mm.has_value();
  if (developed.standard_error) {
    options.stereo.errors = &*developed.standard_error;
  }
  choose_mask(arguments, session, developed.stack, lights, std::move(given), found);
  found.shape =
      recover_shape(developed.stack, lights, found.pixels, found.mask.mask.view(), options);
}

Found shape_of_session(const ShapeArguments& arguments, const CommonOptions& common,
                       Report& report) {
  const bool is_rti = arguments.method == "ptm" || arguments.method == "hsh";
  report.add_asked("method", arguments.method.empty() ? "automatic" : arguments.method);
  if (is_rti && arguments.light == "near") {
    throw Error(fmt::format("{} knows lights by their directions alone", arguments.method),
                "--light near", "leave it out, or choose another --method", ExitCode::usage);
  }
  const Session session = Session::open(arguments.input);
  const FrameForm& form = session.info().form;
  StereoLights lights = choose_lights(arguments, session);
  lights.are_near = lights.are_near && !is_rti;
  Image<std::uint8_t> mask = read_mask(arguments.mask, form.width, form.height);
  Found found;
  found.are_near = lights.are_near;
  found.notes = notes_of(session.info());
  found.has_scale = session.rig().has_value() || arguments.plane.width_mm > 0.0;
  found.pixels = lights.are_near || found.has_scale
                     ? pixel_points(session, arguments.plane.width_mm,
                                    arguments.plane.height_mm.value_or(0.0))
                     : pixels_without_scale(form.width, form.height);
  const char* model = lights.are_near ? "near" : "far";
  report.add_detail("light", model);
  found.by = fmt::format("{} lights, {}", lights.directions.size(),
                         is_rti ? arguments.method.c_str() : model);
  if (is_rti) {
    find_rti_shape(arguments, fit_rti(arguments, common, session), mask, found);
  } else {
    measure_shape(arguments, common, session, lights, std::move(mask), found);
  }
  if (lights.are_near) {
    found.by += fmt::format(", {} rounds", found.shape.changes.size());
  }
  return found;
}

/// The sizes of the largest parts, for people.
std::string sizes_of(const std::vector<PartHeight>& parts) {
  constexpr std::size_t kNamed = 5;
  std::string text;
  for (std::size_t i = 0; i < std::min(kNamed, parts.size()); ++i) {
    text += fmt::format("{}{}", i == 0 ? "" : ", ", parts[i].n_pixels);
  }
  return parts.size() > kNamed ? text + ", ..." : text;
}

void print_shape(const ShapeArguments& arguments, const Found& found) {
  const Shape& shape = found.shape;
  const SurfaceEstimate& surface = shape.surface;
  const char* unit = found.has_scale ? "mm" : "pixel widths";
  const std::int64_t n_dark = surface.n_in(PixelState::too_dark);
  fmt::print("{}: {}; normals of {} pixels ({}), heights over {:.4g} {}\n", arguments.out,
             found.by, surface.n_in(PixelState::good),
             found.is_measured ? fmt::format("{} too dark, {} saturated, {} ambiguous", n_dark,
                                             surface.n_in(PixelState::saturated),
                                             surface.n_in(PixelState::ambiguous))
                               : fmt::format("{} have none", n_dark),
             shape.bow_mm, unit);
  if (!found.is_measured) {
    return;
  }
  fmt::print("  mask: {}, {} of {} pixels (mask.png)\n", found.mask_by, found.mask.n_object,
             surface.state.pixels().size());
  fmt::print("  fit: {}{}\n", name_of(shape.fit),
             shape.scores.empty() ? "" : ", which foretells lights held out best");
  fmt::print(
      "  normals: +- {:.2g} degrees in the median, nine tenths within {:.2g} "
      "(sigma.png, sigma.exr)\n",
      sigma_below(found, 0.5), sigma_below(found, 0.9));
  for (const PartHeight& part : shape.parts) {
    if (part.is_known) {
      fmt::print(
          "  a part of {} pixels stands about {:.3g} {} above the plane, by the lights' "
          "fall-off\n",
          part.n_pixels, part.mean_mm, unit);
    }
  }
  fmt::print("  heights have no standard error{}\n",
             found.are_near ? fmt::format("; the last round moved them by {:.2g} mm (rms)",
                                          shape.changes.back())
                            : "");
}

/// What the capture cannot tell, and what would.
void warn_of_parts(const Found& found) {
  const std::vector<PartHeight>& parts = found.shape.parts;
  const bool is_asked = std::any_of(parts.begin(), parts.end(),
                                    [](const PartHeight& part) { return part.is_known; });
  if (parts.size() > 1 && !is_asked) {
    log_warning(fmt::format(
        "{} parts do not touch ({} pixels): how high one stands above another is not known, "
        "each has a mean height of 0. Measure one part at a time, or draw a --mask that joins "
        "them where the surface does",
        parts.size(), sizes_of(parts)));
    return;
  }
  std::vector<PartHeight> unknown;
  std::copy_if(parts.begin(), parts.end(), std::back_inserter(unknown),
               [](const PartHeight& part) { return !part.is_known; });
  if (is_asked && !unknown.empty()) {
    log_warning(fmt::format(
        "{} of {} parts that do not touch ({} pixels) are too small or too plain to tell how "
        "high they stand: they are put at the largest one's height. Leave them out by a --mask",
        unknown.size(), parts.size(), sizes_of(unknown)));
  }
}

void warn_of_shape(const Found& found) {
  const Shape& shape = found.shape;
  if (!shape.is_settled) {
    log_warning(fmt::format("the heights still move by {:.3g} mm (rms) after {} rounds",
                            shape.changes.back(), shape.changes.size()));
  }
  if (!shape.map.is_converged) {
    log_warning(fmt::format("the integration stopped at a residual of {:.3g}",
                            shape.map.solver_residual));
  }
  if (!found.is_measured) {
    return;
  }
  warn_of_parts(found);
  if (found.are_near) {
    return;
  }
  const char* cure =
      "to know, import the lights' places (--places positions) and give --width-mm";
  if (shape.nearness.is_near()) {
    log_warning(
        fmt::format("the lights are taken as far but look about {:.2g} picture widths away: "
                    "normals far from "
                    "the picture's middle are turned (their standard errors say how far) and "
                    "heights bow; {}",
                    1.0 / shape.nearness.inverse, cure));
  }
  const HeightBow bow = height_bow(shape.height.view(), shape.map.is_known.view());
  if (bow.bow > bow.rest) {
    log_warning(fmt::format(
        "of the heights {:.3g} {} are one slow bow, {:.3g} are left without it: lights that "
        "are "
        "known by direction only bow any surface when they stand near, and the heights do not "
        "tell that bow from a real one. Trust the detail, not the bow; {}",
        bow.bow, found.has_scale ? "mm" : "pixel widths", bow.rest, cure));
  }
}

ExitCode run_shape(const ShapeArguments& arguments, const CommonOptions& common,
                   Report& report) {
  report.add_input(arguments.input);
  report.add_asked("integrate", arguments.integrate);
  if (Vector3d(arguments.preview[0], arguments.preview[1], arguments.preview[2]).norm() ==
      0.0) {
    throw Error("--preview 0,0,0 is no direction", "", "for example: --preview 0.5,0.5,1",
                ExitCode::usage);
  }
  require_absent(arguments.out, common.force);
  const bool is_file =
      fs::is_regular_file(arguments.input) ||
      (fs::exists(arguments.input) && recognise_reflectance(arguments.input).has_value());
  report.add_asked("mask", arguments.mask);
  const Found found = is_file ? shape_of_file(arguments, common, report)
                              : shape_of_session(arguments, common, report);
  const Shape& shape = found.shape;
  if (shape.surface.n_in(PixelState::good) == 0) {
    throw Error("no pixel has a normal", arguments.input,
                "look at the pictures' exposure, the mask and the list of lights");
  }
  const fs::path folder = arguments.out;
  fs::create_directories(folder);
  write_shape(arguments, found, folder);
  add_results(found, report);
  report.add_detail("unit", found.has_scale ? "mm" : "pixels");
  std::uint64_t bytes = 0;
  for (const fs::directory_entry& file : fs::directory_iterator(folder)) {
    bytes += file.file_size();
  }
  report.set_bytes(bytes);
  print_shape(arguments, found);
  warn_of_shape(found);
  return shape.is_settled && shape.map.is_converged ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_shape(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ShapeArguments>();
  Command verb =
      root.add_verb("shape", "Recover normals, albedo, heights and a mesh of a capture");
  verb.option("INPUT", &arguments->input,
              "Session folder; or a .ptm, .rti or web folder, for the normals that RTI viewers "
              "take from it",
              {.type = "SESSION|FILE", .is_required = true});
  verb.option("-o,--output", &arguments->out, "Folder to write",
              {.type = "FOLDER", .is_required = true});
  verb.option(
      "--method", &arguments->method,
      "Fit of each pixel; trimmed and m-estimator leave shadows and highlights out; ptm "
      "and hsh: as RTI viewers take normals, for comparison (default: whichever robust fit "
      "foretells lights held out best; of a file what it holds)",
      {.choices = {"least-squares", "trimmed", "m-estimator", "ptm", "hsh"}});
  verb.option("--loss", &arguments->loss, "How the m-estimator weighs what fits badly",
              {.choices = {"huber", "cauchy", "tukey"}, .shows_default = true});
  verb.option("--keep", &arguments->keep, "trimmed: the share of a pixel's lights that count",
              {.bounds = Bounds{0.05, 1.0}, .shows_default = true});
  verb.option("--dark", &arguments->dark_share,
              "Below this share of the pixel's bright level a light counts as shadowed",
              {.bounds = Bounds{0.0, 0.9}, .shows_default = true});
  verb.option("--light", &arguments->light,
              "near: each pixel's own light directions and distances (default: where the "
              "lights' positions and the picture's size are known)",
              {.choices = {"automatic", "near", "far"}});
  add_plane_options(verb, arguments->plane);
  verb.option("--mask", &arguments->mask,
              "White: the object; black is left out. found: looked for in the capture, by the "
              "rig's bare plane or by darkness; none: every pixel",
              {.type = "PICTURE|found|none", .shows_default = true});
  verb.option("--integrate", &arguments->integrate,
              "From normals to heights; robust keeps edges",
              {.choices = {"poisson", "frankot-chellappa", "robust"}, .shows_default = true});
  verb.option("--rounds", &arguments->max_rounds,
              "near: at most so many rounds of normals and heights",
              {.bounds = Bounds{1, 1000}, .shows_default = true});
  verb.option("--mesh", &arguments->mesh, "Which mesh files to write",
              {.choices = {"ply", "obj", "both", "none"}, .shows_default = true});
  verb.option("--max-tilt", &arguments->max_tilt_deg,
              "Leave out triangles steeper than this, degrees",
              {.bounds = Bounds{0.0, 90.0}, .shows_default = true});
  verb.flag("--open-cuts", &arguments->is_open_at_cuts,
            "Leave the mesh open where --integrate robust found cuts");
  verb.option("--preview", &arguments->preview, "Direction of the preview's light",
              {.type = "X,Y,Z", .delimiter = ',', .count = 3});
  add_transfer_option(verb, arguments->transfer);
  verb.footer(
      "Writes normals (.png, .exr), their standard errors in degrees (sigma.exr; sigma.png, "
      "white: 20\nor more), albedo (.png, .exr), error (.png, .exr), height (.tif, .exr), "
      "mask.png, mesh.ply,\nmesh.obj and preview.png. Of a rig's capture each part's height "
      "above the plane is found from\nthe lights' fall-off unless --height-mm gives it; else "
      "each part's mean height is 0. Normals of\nptm and hsh are not measured: instead of "
      "albedo, errors and mask there is front.png, the\npicture lit from the camera.\n\n"
      "Examples:\n"
      "  haarlight shape sessions/airplane -o airplane.shape\n"
      "  haarlight shape sessions/coin -o coin.shape --light far --integrate robust\n"
      "  haarlight shape sessions/coin -o coin.hsh --method hsh\n"
      "  haarlight shape coin.ptm -o coin.peaks");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shape(*arguments, common, report);
  });
}

}  // namespace haarlight
