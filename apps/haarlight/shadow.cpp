/// @file
/// `haarlight shadow BASIS --scene SCENE --cubemap ENV -o OUT`: the captured object's shadow on
/// another scene.

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include <fmt/format.h>

#include "apps/haarlight/display_exposure.h"
#include "apps/haarlight/light_options.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/rig.h"
#include "core/tolerance.h"
#include "relight/basis/basis_file.h"
#include "relight/basis/weight_list.h"
#include "relight/light/light_weights.h"
#include "relight/shadow/reproject.h"
#include "relight/shadow/shadow_truth.h"
#include "relight/shadow/stack_visibility.h"
#include "render/rig_lights.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

struct ShadowArguments {
  std::string basis;
  std::string scene;
  std::string output;
  LightOptions light;
  std::string window = "corrected";
  std::vector<double> object_height;
  std::string plane;
  std::string plate = "computed";
  std::string mask;
  std::vector<int> size;
  int subpixels = 2;
  bool has_no_own_shadows = false;
  std::optional<double> exposure;
  std::string spread;
  std::string truth_object;
  std::string truth;
  std::string difference;
};

std::vector<Eigen::Vector3d> read_weights(const ShadowArguments& arguments, const Rig& rig,
                                          Report& report) {
  if (arguments.light.cubemap.empty() == arguments.light.lights.empty()) {
    throw Error("give one of --cubemap and --light", "command line", "name the light once",
                ExitCode::usage);
  }
  Eigen::MatrixXd weights;
  if (arguments.light.cubemap.empty()) {
    weights = weights_from_words(arguments.light.lights, rig.n_lights());
  } else {
    const EnvironmentWeights found =
        rig_weights(read_environment(arguments.light, report), rig);
    report.add_reached("missing_share", found.missing_share);
    weights = found.weights;
  }
  std::vector<Eigen::Vector3d> colours;
  for (Eigen::Index k = 0; k < weights.rows(); ++k) {
    colours.emplace_back(weights(k, 0), weights(k, weights.cols() > 1 ? 1 : 0),
                         weights(k, weights.cols() > 1 ? 2 : 0));
  }
  return colours;
}

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

std::size_t find_plane(const Rig& rig, const std::string& id, const std::string& where) {
  if (id.empty()) {
    return 0;
  }
  const auto it = std::find_if(rig.planes.begin(), rig.planes.end(),
                               [&](const ShadowPlane& plane) { return plane.id == id; });
  if (it == rig.planes.end()) {
    throw Error(fmt::format("the rig has no plane \"{}\"", id), where,
                fmt::format("the first one is \"{}\"", rig.planes[0].id), ExitCode::usage);
  }
  return static_cast<std::size_t>(it - rig.planes.begin());
}

/// The scene's camera, or the capture's own where the scene has none; resized when asked.
CameraModel view_of(const ShadowArguments& arguments, const SceneFile& scene, const Rig& rig) {
  CameraModel camera = scene.has_camera ? scene.camera : rig.cameras[0].model;
  if (!arguments.size.empty()) {
    const double sx = static_cast<double>(arguments.size[0]) / camera.width;
    const double sy = static_cast<double>(arguments.size[1]) / camera.height;
    camera.width = arguments.size[0];
    camera.height = arguments.size[1];
    camera.fx *= sx;
    camera.cx *= sx;
    camera.fy *= sy;
    camera.cy *= sy;
  }
  return camera;
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

void add_to_report(const ReprojectReport& found, Report& report) {
  report.add_reached("unknown_share", found.unknown_share);
  report.add_reached("affected_receivers", found.affected_receivers);
  report.add_reached("spread_relative_l2", found.spread_relative);
  report.add_detail("lights", std::int64_t{found.n_lights});
  report.add_detail("receivers", found.n_receivers);
  report.add_detail("on_plane_share", found.on_share);
  report.add_detail("above_plane_share", found.above_share);
  report.add_detail("below_plane_share", found.below_share);
  report.add_detail("no_point_share", found.no_point_share);
  report.add_detail("outside_plane_picture_share", found.outside_share);
  report.add_detail("receivers_over_object_bottom", found.under_object_share);
  report.add_detail("receivers_over_object_top", found.over_object_share);
  report.add_detail("worst_widening_above", found.worst_widening);
  report.add_detail("visibility_over_one", static_cast<std::int64_t>(found.count.n_excess));
  report.add_detail("worst_visibility_excess", found.count.worst_excess);
  report.add_detail("dark_plate_values", static_cast<std::int64_t>(found.count.n_no_plate));
  report.add_detail("gloss_left_out", found.has_glossy);
}

void print_notes(const ReprojectReport& found, bool has_height) {
  const auto note = [](double share, const char* text) {
    if (share > 0.0005) {
      fmt::print("  {:.1f} % {}\n", 100.0 * share, text);
    }
  };
  note(
      found.affected_receivers,
      "of the receivers look into the region that the object hides from the camera: the middle "
      "of the bounds is drawn (--spread shows the rest)");
  note(found.outside_share, "of the light comes through beyond the plane picture: drawn lit");
  note(found.no_point_share, "of the light has no point on the plane: drawn lit");
  note(
      found.under_object_share,
      "of the receivers lie between the object's bottom and top: parts of it below them darken "
      "them falsely");
  note(found.above_share,
       "of the light falls on receivers above the plane: shadow edges there "
       "are too wide");
  if (has_height && found.worst_widening > 1.0) {
    fmt::print("  above the plane a shadow's edge is up to {:.2g} times too wide\n",
               found.worst_widening);
  }
  if (!has_height && found.below_share > 0.0) {
    fmt::print(
        "  below the plane edges are up to 29 % too narrow; --object-height corrects it\n");
  }
  if (found.has_glossy) {
    fmt::print("  the scene's gloss is left out: only its diffuse part is drawn\n");
  }
}

ExitCode run_shadow(const ShadowArguments& arguments, const CommonOptions& common,
                    Report& report) {
  for (const std::string& file :
       {arguments.output, arguments.spread, arguments.truth, arguments.difference}) {
    if (!file.empty()) {
      require_picture_name(file);
      require_absent(file, common.force);
    }
  }
  if (arguments.truth.empty() != arguments.truth_object.empty() ||
      (arguments.truth.empty() && !arguments.difference.empty())) {
    throw Error("--truth and --truth-object go together, --difference needs both",
                "command line", "name the object's scene and the picture", ExitCode::usage);
  }
  report.add_input(arguments.basis);
  report.add_input(arguments.scene);
  const BasisFile basis = BasisFile::open(arguments.basis);
  const Rig rig = rig_of(basis);
  const std::size_t i_plane = find_plane(rig, arguments.plane, arguments.basis);
  const PlaneFrame frame = make_plane_frame(rig.planes[i_plane]);
  const std::vector<Eigen::Vector3d> weights = read_weights(arguments, rig, report);
  const SceneFile scene = read_scene(arguments.scene);
  Scene object;  // read before anything is written, as every input
  if (!arguments.truth_object.empty()) {
    report.add_input(arguments.truth_object);
    object = read_scene(arguments.truth_object).scene;
    remove_plane_triangles(object, frame);
  }
  const CameraModel view = view_of(arguments, scene, rig);
  const std::vector<SquareLight> lights = rig_lights(rig);

  ReprojectOptions options;
  options.rule = arguments.window == "none"    ? WindowRule::none
                 : arguments.window == "plain" ? WindowRule::plain
                                               : WindowRule::corrected;
  if (!arguments.object_height.empty()) {
    options.object = HeightRange{arguments.object_height[0], arguments.object_height[1]};
    if (!(options.object->low_mm <= options.object->high_mm)) {
      throw Error("the object's lowest point is above its highest", "--object-height",
                  "write LOW,HIGH in mm over the plane", ExitCode::usage);
    }
    report.add_asked("object_height_mm", arguments.object_height);
  }
  options.n_subpixels = arguments.subpixels;
  options.has_own_shadows = !arguments.has_no_own_shadows;
  options.memory_bytes = common.memory_bytes / 2;
  options.progress = common.progress();
  report.add_asked("window", arguments.window);

  std::vector<int> wanted;
  for (std::size_t k = 0; k < weights.size(); ++k) {
    if (!weights[k].isZero(0.0)) {
      wanted.push_back(static_cast<int>(k));
    }
  }
  const BasisSource stack(basis);
  const CameraModel& eye = rig.cameras[0].model;
  std::optional<BasisFile> plate_file;
  std::unique_ptr<StackSource> plate;
  if (arguments.plate == "computed") {
    plate = std::make_unique<RigPlate>(eye, frame.plane, lights, PlateKind::squares);
  } else if (arguments.plate == "falloff") {
    plate = std::make_unique<RigPlate>(eye, frame.plane, lights, PlateKind::points);
  } else {
    report.add_input(arguments.plate);
    plate_file = BasisFile::open(arguments.plate);
    plate = std::make_unique<BasisSource>(*plate_file);
  }
  report.add_detail("plate", arguments.plate);
  StackVisibilityOptions visibility_options;
  visibility_options.shows_plane = read_mask(arguments.mask);
  const Image<std::uint8_t>& mask = visibility_options.shows_plane;
  if (!mask.is_empty() && (mask.width() != eye.width || mask.height() != eye.height)) {
    throw Error(fmt::format("the mask is {} x {}, the camera {} x {}", mask.width(),
                            mask.height(), eye.width, eye.height),
                arguments.mask, "draw it on one of the camera's pictures");
  }
  visibility_options.memory_bytes = common.memory_bytes / 4;
  std::optional<StackVisibility> visibility;
  if (!wanted.empty()) {
    visibility.emplace(stack, *plate, eye, frame, wanted, std::move(visibility_options));
    report.add_detail("plate_scale", visibility->scale());
    report.add_reached("plane_known_share", visibility->known_share());
  }
  const ReprojectResult result = reproject_shadow(
      scene.scene, view, frame, lights, weights,
      [&](int k) { return visibility->visibility(k); }, options);
  add_to_report(result.report, report);
  fmt::print("{}: {} lights, {} receivers\n", arguments.output, result.report.n_lights,
             result.report.n_receivers);
  if (arguments.plate != "computed" && !plate_file) {
    fmt::print("  no clean plate: a fitted cos^4/r^2 takes its place\n");
  }
  print_notes(result.report, options.object.has_value());

  // Of the unshadowed picture, so that a shadow never changes the exposure.
  const std::span<const float> unshadowed = result.unshadowed.pixels();
  const double exposure = arguments.exposure.value_or(
      fs::path(arguments.output).extension() == ".png"
          ? display_exposure({unshadowed.begin(), unshadowed.end()}, kDisplayShare)
          : 1.0);
  report.add_detail("exposure", exposure);
  write_image(arguments.output, result.picture.view(), exposure);
  std::uint64_t bytes = fs::file_size(arguments.output);
  if (!arguments.spread.empty()) {
    write_image(arguments.spread, result.spread.view(), exposure);
    bytes += fs::file_size(arguments.spread);
  }
  if (!arguments.truth.empty()) {
    const Image<float> truth = trace_shadow(scene.scene, object, view, lights, weights,
                                            arguments.subpixels, common.progress());
    const Achieved found = compare(result.picture.pixels(), truth.pixels());
    const ShadowError error = compare_shadow(result, truth);
    report.add_reached("relative_l2", found.relative_l2);
    report.add_reached("worst_pixel", found.worst_pixel);
    report.add_reached("psnr_db", found.psnr_db);
    report.add_reached("shadow_wrong_share", error.wrong_share);
    report.add_reached("relative_l2_where_known", error.known_relative_l2);
    report.add_reached("shadow_wrong_share_where_known", error.known_wrong_share);
    report.add_reached("known_share", error.known_share);
    fmt::print(
        "  against the ray-traced shadow: relative error {:.3g}, {:.1f} dB, {:.1f} % of the "
        "shadow wrong\n  on the {:.0f} % of the receivers that look at known places only: "
        "{:.3g}, "
        "{:.1f} %\n",
        found.relative_l2, found.psnr_db, 100.0 * error.wrong_share, 100.0 * error.known_share,
        error.known_relative_l2, 100.0 * error.known_wrong_share);
    write_image(arguments.truth, truth.view(), exposure);
    bytes += fs::file_size(arguments.truth);
    if (!arguments.difference.empty()) {
      constexpr float kBrighter = 4.0F;
      Image<float> difference = truth;
      for (std::size_t i = 0; i < difference.pixels().size(); ++i) {
        float& d = difference.pixels()[i];
        d = kBrighter * std::abs(result.picture.pixels()[i] - d);
      }
      write_image(arguments.difference, difference.view(), exposure);
      bytes += fs::file_size(arguments.difference);
    }
  }
  report.set_bytes(bytes);
  return ExitCode::done;
}

}  // namespace

void add_shadow(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ShadowArguments>();
  Command verb = root.add_verb("shadow", "Cast the captured object's shadow on a scene");
  verb.option("BASIS", &arguments->basis, "Basis file",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("--scene", &arguments->scene, "Scene that receives the shadow, and its camera",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output, "Picture: .exr linear, .png for display",
              {.type = "OUT", .is_required = true});
  add_light_options(verb, arguments->light);
  verb.option("--window", &arguments->window,
              "What the shadow is averaged over: none, plain (the paper's), or corrected",
              {.choices = {"none", "plain", "corrected"}, .shows_default = true});
  verb.option("--object-height", &arguments->object_height,
              "Lowest and highest point of the object over the plane, mm",
              {.type = "LOW,HIGH", .delimiter = ',', .count = 2});
  verb.option("--plane", &arguments->plane, "The rig's plane to use (default: the first)",
              {.type = "ID"});
  verb.option("--plate", &arguments->plate,
              "Clean plate: a captured one, computed from the rig, or falloff (cos^4/r^2)",
              {.type = "FILE.hlb|computed|falloff", .shows_default = true});
  verb.option("--mask", &arguments->mask,
              "Camera picture that is white where the plane is seen, black on the object",
              {.type = "FILE"});
  verb.option("--size", &arguments->size, "Picture size (default: the scene's camera)",
              {.type = "WxH", .bounds = Bounds{1, 16384}, .delimiter = 'x', .count = 2});
  verb.option("--subpixels", &arguments->subpixels, "N x N samples a pixel",
              {.bounds = Bounds{1, 16}, .shows_default = true});
  verb.flag("--no-own-shadows", &arguments->has_no_own_shadows,
            "Leave out the shadows that the scene casts on itself");
  verb.option("--exposure", &arguments->exposure,
              "Factor before display (default for .png: unshadowed 99.5th percentile white)");
  verb.option("--spread", &arguments->spread,
              "Also write how far the hidden region lets the picture vary", {.type = "OUT"});
  verb.option("--truth-object", &arguments->truth_object,
              "Scene of the object itself, where it is known", {.type = "SCENE.toml"});
  verb.option("--truth", &arguments->truth,
              "Also ray-trace that object's shadow, and measure the error against it",
              {.type = "OUT"});
  verb.option("--difference", &arguments->difference,
              "Also write the absolute difference to that truth, four times brighter",
              {.type = "OUT"});
  verb.footer(
      "Examples:\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml \\\n"
      "      --cubemap apartment.hdr --object-height 76,128 -o shadow.exr\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml --light 528 \\\n"
      "      --truth-object configs/scenes/airplane.toml --truth truth.png -o shadow.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shadow(*arguments, common, report);
  });
}

}  // namespace haarlight
