/// @file
/// `haarlight shape SESSION --out FOLDER`: normals, albedo, heights and a mesh of a capture.

#include <algorithm>
#include <map>
#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/display_exposure.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/log.h"
#include "relight/basis/compress_session.h"
#include "relight/shape/near_alternation.h"
#include "relight/shape/normal_picture.h"
#include "relight/shape/surface_mesh.h"
#include "session/develop.h"
#include "session/sensor_response.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

struct ShapeArguments {
  std::string session;
  std::string out;
  std::string method = "trimmed";
  std::string loss = "tukey";
  std::string light = "automatic";
  std::string integrate = "poisson";
  std::string mesh = "both";
  std::string mask;
  std::string transfer;
  double width_mm = 0.0;
  double height_mm = 0.0;
  double keep = LambertOptions{}.keep;
  double dark_share = LambertOptions{}.dark_share;
  double max_tilt_deg = SurfaceMeshOptions{}.max_tilt_deg;
  int max_rounds = ShapeOptions{}.max_rounds;
  bool is_open_at_cuts = false;
  std::vector<double> preview = {0.5, 0.5, 1.0};
};

/// White is the object. @throws Error  another size
Image<std::uint8_t> read_mask(const std::string& file, const FrameForm& shape) {
  if (file.empty()) {
    return {};
  }
  const PictureFile picture = read_picture(file);
  if (picture.pixels.width() != shape.width || picture.pixels.height() != shape.height) {
    throw Error(fmt::format("a mask of {} x {} for pictures of {} x {}", picture.pixels.width(),
                            picture.pixels.height(), shape.width, shape.height),
                file, "draw the mask on one of the capture's own pictures");
  }
  Image<std::uint8_t> mask(shape.height, shape.width, 1);
  bool is_any = false;
  for (int y = 0; y < shape.height; ++y) {
    for (int x = 0; x < shape.width; ++x) {
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
  lights.are_near =
      arguments.light == "near" || (arguments.light == "automatic" && all.are_near &&
                                    (session.rig().has_value() || arguments.width_mm > 0.0));
  for (const NearLight& light : lights.near) {
    lights.powers.push_back(light.power);
  }
  return lights;
}

/// Where a picture's values end, as develop has them; empty where pictures are no integers.
std::vector<float> clip_levels(const Session& session) {
  const FrameForm& form = session.info().form;
  if (session.rig().has_value() || form.sample == SampleType::f32) {
    return {};
  }
  constexpr float kJustBelow = 0.9995F;  // rounding of the decoded value
  const double coded =
      (form.saturation_dn() - form.black_level) / (form.white_level - form.black_level);
  const float top = form.transfer == Transfer::srgb
                        ? linear_from_srgb(static_cast<float>(coded))
                        : static_cast<float>(coded);
  std::vector<float> levels;
  for (const SessionLight& light : session.info().lights) {
    levels.push_back(kJustBelow * top / static_cast<float>(light.relative_power));
  }
  return levels;
}

ShapeOptions shape_options(const ShapeArguments& arguments) {
  const std::map<std::string, LambertMethod> methods = {
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
  options.stereo.fit.method = methods.at(arguments.method);
  options.stereo.fit.loss = losses.at(arguments.loss);
  options.stereo.fit.keep = arguments.keep;
  options.stereo.fit.dark_share = arguments.dark_share;
  options.integrate.method = integrators.at(arguments.integrate);
  options.max_rounds = arguments.max_rounds;
  return options;
}

/// In the picture's frame: x right, y up, z to the camera.
Image<float> picture_normals(const Shape& shape, const PixelPoints& pixels) {
  Image<float> out = shape.surface.normal;
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      const Vector3d n =
          pixels.picture_from_world() *
          Vector3d(double{out(y, x, 0)}, double{out(y, x, 1)}, double{out(y, x, 2)});
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = static_cast<float>(n[c]);
      }
    }
  }
  return out;
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

void write_shape(const ShapeArguments& arguments, const Shape& shape, const PixelPoints& pixels,
                 const fs::path& folder) {
  const Image<float> normals = picture_normals(shape, pixels);
  write_image(folder / "normals.png", normal_map(normals.view()).view());
  write_image(folder / "normals.exr", normals.view());
  const Image<std::uint8_t> good = shape.surface.is_good();
  const double exposure = display_exposure(known_values(shape.surface.albedo, good), 0.99);
  write_image(folder / "albedo.png", shape.surface.albedo.view(), exposure);
  write_image(folder / "albedo.exr", shape.surface.albedo.view());
  write_image(folder / "error.exr", shape.surface.error.view());
  write_image(folder / "error.png", shape.surface.error.view(),
              display_exposure(known_values(shape.surface.error, good), 0.99));
  write_image(folder / "height.tif", shape.height.view());
  write_image(folder / "height.exr", shape.height.view());
  EnhancedLook look;
  look.light = {arguments.preview[0], arguments.preview[1], arguments.preview[2]};
  write_image(folder / "preview.png",
              enhanced_picture(normals.view(), shape.surface.albedo.view(), look).view());
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
    write_obj(mesh, folder / "mesh.obj", "albedo.png");
  }
}

void add_results(const Shape& shape, Report& report) {
  const SurfaceEstimate& surface = shape.surface;
  report.add_reached("good_pixels", surface.n_in(PixelState::good));
  report.add_detail("masked_pixels", surface.n_in(PixelState::masked));
  report.add_detail("dark_pixels", surface.n_in(PixelState::too_dark));
  report.add_detail("saturated_pixels", surface.n_in(PixelState::saturated));
  report.add_detail("ambiguous_pixels", surface.n_in(PixelState::ambiguous));
  report.add_reached("heights_range", shape.bow_mm);
  report.add_reached("is_settled", shape.is_settled);
  report.add_detail("height_changes", shape.changes);
  report.add_detail("parts", std::int64_t{shape.map.n_parts});
  report.add_detail("cuts", shape.map.n_cuts);
  report.add_detail("step_error", shape.map.step_error);
  report.add_detail("worst_step_error", shape.map.worst_step_error);
  report.add_detail("solver_residual", shape.map.solver_residual);
  report.add_detail("solver_iterations", std::int64_t{shape.map.iterations});
}

ExitCode run_shape(const ShapeArguments& arguments, const CommonOptions& common,
                   Report& report) {
  report.add_input(arguments.session);
  report.add_asked("method", arguments.method);
  report.add_asked("integrate", arguments.integrate);
  if (Vector3d(arguments.preview[0], arguments.preview[1], arguments.preview[2]).norm() ==
      0.0) {
    throw Error("--preview 0,0,0 is no direction", "", "for example: --preview 0.5,0.5,1",
                ExitCode::usage);
  }
  require_absent(arguments.out, common.force);
  const Session session = Session::open(arguments.session);
  const StereoLights lights = choose_lights(arguments, session);
  const Image<std::uint8_t> mask = read_mask(arguments.mask, session.info().form);
  const bool has_scale = session.rig().has_value() || arguments.width_mm > 0.0;
  const PixelPoints pixels =
      lights.are_near || has_scale
          ? pixel_points(session, arguments.width_mm, arguments.height_mm)
          : PixelPoints::orthographic(session.info().form.width, session.info().form.height,
                                      session.info().form.width);
  DevelopOptions develop_options;
  develop_options.memory_bytes = common.memory_bytes;
  develop_options.progress = common.progress();
  develop_options.plate = sharing_plate(session, {});
  if (!arguments.transfer.empty()) {
    develop_options.unknown_as =
        arguments.transfer == "srgb" ? Transfer::srgb : Transfer::linear;
  }
  Developed developed = develop_all(session, develop_options);
  if (developed.n_saturated > 0 && sensor_response(session).is_measured) {
    develop_options.has_standard_error = true;
    developed = develop_all(session, develop_options);
  }
  ShapeOptions options = shape_options(arguments);
  options.stereo.progress = common.progress();
  options.stereo.saturation = clip_levels(session);
  std::optional<LightStackSource> errors;
  if (developed.standard_error) {
    errors.emplace(*developed.standard_error);
    options.stereo.errors = &*errors;
  }
  const Shape shape =
      recover_shape(LightStackSource(developed.stack), lights, pixels, mask.view(), options);
  if (shape.surface.n_in(PixelState::good) == 0) {
    throw Error("no pixel has a normal", arguments.session,
                "look at the pictures' exposure, the mask and the list of lights");
  }
  const fs::path folder = arguments.out;
  fs::create_directories(folder);
  write_shape(arguments, shape, pixels, folder);
  add_results(shape, report);
  report.add_detail("light", lights.are_near ? "near" : "far");
  report.add_detail("unit", has_scale ? "mm" : "pixels");
  std::uint64_t bytes = 0;
  for (const fs::directory_entry& file : fs::directory_iterator(folder)) {
    bytes += file.file_size();
  }
  report.set_bytes(bytes);
  if (!shape.is_settled) {
    log_warning(fmt::format("the heights still move by {:.3g} mm (rms) after {} rounds",
                            shape.changes.back(), shape.changes.size()));
  }
  if (!shape.map.is_converged) {
    log_warning(fmt::format("the integration stopped at a residual of {:.3g}",
                            shape.map.solver_residual));
  }
  fmt::print(
      "{}: {} lights, {}; normals of {} pixels ({} too dark, {} saturated, {} ambiguous), "
      "heights over {:.4g} {}{}\n",
      arguments.out, lights.directions.size(), lights.are_near ? "near" : "far",
      shape.surface.n_in(PixelState::good), shape.surface.n_in(PixelState::too_dark),
      shape.surface.n_in(PixelState::saturated), shape.surface.n_in(PixelState::ambiguous),
      shape.bow_mm, has_scale ? "mm" : "pixel widths",
      lights.are_near ? fmt::format(", {} rounds", shape.changes.size()) : "");
  return shape.is_settled && shape.map.is_converged ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_shape(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ShapeArguments>();
  Command verb =
      root.add_verb("shape", "Recover normals, albedo, heights and a mesh of a capture");
  verb.option("SESSION", &arguments->session, "Session folder", {.is_required = true});
  verb.option("-o,--out", &arguments->out, "Folder to write",
              {.type = "FOLDER", .is_required = true});
  verb.option("--method", &arguments->method,
              "Fit of each pixel; trimmed and m-estimator leave shadows and highlights out",
              {.choices = {"least-squares", "trimmed", "m-estimator"}, .shows_default = true});
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
  verb.option("--width-mm", &arguments->width_mm,
              "What the picture shows across, for an imported capture",
              {.type = "MM", .bounds = Bounds{0.0, 1e6}});
  verb.option("--height-mm", &arguments->height_mm,
              "Mean height of the object above the rig's plane",
              {.type = "MM", .bounds = Bounds{-1e5, 1e5}});
  verb.option("--mask", &arguments->mask, "White: the object; black is left out",
              {.type = "PICTURE"});
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
  verb.option(
      "--transfer", &arguments->transfer,
      "What stands in for the unknown curve of a camera's YUYV or NV12 (default: refuse)",
      {.choices = {"srgb", "linear"}});
  verb.footer(
      "Writes normals (.png, .exr), albedo (.png, .exr), error (.png, .exr), height (.tif, "
      ".exr),\nmesh.ply, mesh.obj and preview.png. The mean height is 0.\n\n"
      "Examples:\n"
      "  haarlight shape sessions/airplane --out airplane.shape\n"
      "  haarlight shape sessions/coin --out coin.shape --light far --integrate robust");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shape(*arguments, common, report);
  });
}

}  // namespace haarlight
