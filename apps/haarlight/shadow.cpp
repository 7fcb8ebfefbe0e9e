// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight shadow BASIS --scene SCENE --cubemap ENV -o OUT`: the captured object's shadow on
/// another scene.

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include <fmt/format.h>

#include "apps/haarlight/light_options.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/picture/image_io.h"
#include "core/rig/rig.h"
#include "core/tolerance.h"
#include "relight/basis/basis_file.h"
#include "relight/basis/relight.h"
#include "relight/basis/weight_list.h"
#include "relight/light/light_weights.h"
#include "relight/pipeline/display_exposure.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/shadow/composite.h"
#include "relight/shadow/reproject.h"
#include "relight/shadow/shadow_truth.h"
#include "relight/shadow/stack_visibility.h"
#include "render/picture.h"
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
  std::vector<std::string> planes;
  std::vector<std::string> also;
  std::optional<double> max_error;
  std::optional<double> worst_point;
  bool with_object = false;
  std::optional<double> plane_albedo;
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

/// One capture of the object: a basis file, its rig, and the shadow pictures of its planes.
struct Capture {
  explicit Capture(const std::string& file)
      : basis(BasisFile::open(file)), rig(rig_of(basis)), stack(basis) {}
  ~Capture() = default;
  Capture(const Capture&) = delete;
  Capture& operator=(const Capture&) = delete;
  Capture(Capture&&) = delete;  // the source refers to the file
  Capture& operator=(Capture&&) = delete;

  BasisFile basis;
  Rig rig;
  BasisSource stack;
  std::vector<PlaneFrame> frames;  ///< of all the rig's planes
  std::vector<std::size_t> chosen;
  std::vector<std::unique_ptr<StackSource>> plates;       ///< of the chosen ones
  std::vector<std::unique_ptr<StackVisibility>> shadows;  ///< the same
};

/// Heights over another plane, where it is parallel to the one they were given over.
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

/// The scene's camera, or the capture's own where the scene has none; resized when asked.
CameraModel view_of(const ShadowArguments& arguments, const SceneFile& scene, const Rig& rig) {
  CameraModel camera =
      scene.has_camera && !arguments.with_object ? scene.camera : rig.cameras[0].model;
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
  const PointsReport& points = found.points;
  report.add_reached("irradiance_relative_l2", points.reached.relative_l2);
  report.add_reached("irradiance_relative_l2_limit", points.relative_l2_limit);
  report.add_reached("irradiance_worst_point", points.reached.worst_pixel);
  report.add_detail("is_exact", points.is_exact);
  report.add_detail("checked_receivers", points.n_checked);
  report.add_detail("lookups_a_receiver", points.lookups_a_point);
  report.add_detail("block_side", std::int64_t{points.block_side});
  report.add_detail("table_bytes", static_cast<std::int64_t>(points.table_bytes));
  report.add_detail("receiver_bytes", static_cast<std::int64_t>(points.totals_bytes));
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

/// Lays the relit object over the scene. @return  where it is drawn
Image<std::uint8_t> add_object(const ShadowArguments& arguments, const Capture& capture,
                               std::span<const Eigen::Vector3d> weights, const Scene& scene,
                               const std::optional<HeightRange>& object, Image<float>& picture,
                               Report& report) {
  const CameraModel& eye = capture.rig.cameras[0].model;
  const PlaneFrame& frame = capture.frames[capture.chosen[0]];
  const SquareLight one = rig_lights(capture.rig)[0];
  // To the scale of a computed plate; a captured one stands in between.
  double plate_scale = capture.shadows[0]->scale();
  if (arguments.plate != "computed" && arguments.plate != "falloff") {
    const RigPlate computed(eye, frame.plane, rig_lights(capture.rig), PlateKind::squares);
    plate_scale *= StackVisibility(*capture.plates[0], computed, eye, frame, {}, {}).scale();
  }
  Image<std::uint8_t> shows_object = capture.shadows[0]->shows_object();
  for (const auto& shadow : capture.shadows) {
    for (std::size_t i = 0; i < shows_object.pixels().size(); ++i) {
      // What shows any of the planes is not the object; what one plate does not see may be.
      const bool is_plane = shadow->shows_plane().pixels()[i] != 0;
      shows_object.pixels()[i] = !is_plane && (shows_object.pixels()[i] != 0 ||
                                               shadow->shows_object().pixels()[i] != 0)
                                     ? 1
                                     : 0;
    }
  }
  LightWeights drives(static_cast<Eigen::Index>(weights.size()), 3);
  for (std::size_t k = 0; k < weights.size(); ++k) {
    drives.row(static_cast<Eigen::Index>(k)) = weights[k].transpose();
  }
  const RelitPicture relit = relight(capture.basis, drives);
  CompositeOptions options;
  options.object = object;
  options.scale = scene_scale(plate_scale, capture.stack.dims().channels,
                              *arguments.plane_albedo, one.width_mm * one.height_mm);
  CompositeCount count =
      draw_object(picture, relit.picture, shows_object, RayCaster(scene), eye, frame, options);
  report.add_asked("plane_albedo", *arguments.plane_albedo);
  report.add_detail("object_pixels", count.n_object);
  report.add_detail("object_pixels_behind_scene", count.n_hidden);
  report.add_detail("object_scale", options.scale);
  fmt::print(
      "  the object covers {} pixels{}\n", count.n_object,
      count.n_hidden > 0 ? fmt::format(", {} more are behind the scene", count.n_hidden) : "");
  return std::move(count.drawn);
}

/// What the ray-traced truth needs beside the arguments.
struct Truth {
  const Scene& scene;
  const Scene& object;
  const CameraModel& view;
  std::span<const SquareLight> lights;
  std::span<const Eigen::Vector3d> weights;
};

/// The shadow alone, against ray-traced receivers.
Image<float> judge_shadow(const Truth& scene, const ReprojectResult& result, int subpixels,
                          const CommonOptions& common, Report& report) {
  Image<float> truth = trace_shadow(scene.scene, scene.object, scene.view, scene.lights,
                                    scene.weights, subpixels, common.progress());
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
  return truth;
}

/// Scene and object together, against both ray-traced.
Image<float> judge_composite(const Truth& scene, const Image<float>& picture,
                             const Image<std::uint8_t>& drawn, int subpixels,
                             const CommonOptions& common, Report& report) {
  Scene all = scene.scene;
  append_scene(all, scene.object);
  LitOptions options;
  options.n_subpixels = subpixels;
  options.progress = common.progress();
  Image<float> truth =
      render_lit(all, scene.view, scene.lights, scene.weights, options).radiance;
  const Achieved found = compare(picture.pixels(), truth.pixels());
  const Achieved of_object = compare_drawn(picture, truth, drawn);
  report.add_reached("relative_l2", found.relative_l2);
  report.add_reached("psnr_db", found.psnr_db);
  report.add_reached("object_relative_l2", of_object.relative_l2);
  fmt::print(
      "  against scene and object ray-traced: relative error {:.3g}, {:.1f} dB; on the "
      "object's pixels {:.3g}\n",
      found.relative_l2, found.psnr_db, of_object.relative_l2);
  return truth;
}

std::uint64_t write_truth(const ShadowArguments& arguments, const Image<float>& picture,
                          Image<float> truth, double exposure, const PictureNotes& notes) {
  write_image(arguments.truth, truth.view(), exposure, notes);
  std::uint64_t bytes = fs::file_size(arguments.truth);
  if (!arguments.difference.empty()) {
    constexpr float kBrighter = 4.0F;
    for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
      float& d = truth.pixels()[i];
      d = kBrighter * std::abs(picture.pixels()[i] - d);
    }
    write_image(arguments.difference, truth.view(), exposure, notes);
    bytes += fs::file_size(arguments.difference);
  }
  return bytes;
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
  if (arguments.with_object && (!arguments.plane_albedo || !arguments.size.empty())) {
    throw Error(arguments.plane_albedo ? "--with-object is seen by the capture's camera"
                                       : "--with-object needs --plane-albedo",
                "command line",
                arguments.plane_albedo
                    ? "leave out --size"
                    : "say how much light the captured plane reflects, for example 0.8: "
                      "object and scene have one brightness through it",
                ExitCode::usage);
  }
  refuse_not_basis(arguments.basis, "shadow");
  report.add_input(arguments.basis);
  report.add_input(arguments.scene);
  std::vector<std::unique_ptr<Capture>> captures;
  captures.push_back(std::make_unique<Capture>(arguments.basis));
  const Rig& rig = captures[0]->rig;
  for (const std::string& file : arguments.also) {
    report.add_input(file);
    captures.push_back(std::make_unique<Capture>(file));
    require_same_lights(rig, captures.back()->rig, file);
  }
  std::size_t n_planes = 0;
  for (const auto& capture : captures) {
    for (const ShadowPlane& plane : capture->rig.planes) {
      capture->frames.push_back(make_plane_frame(plane));
    }
    capture->chosen = find_planes(capture->rig, arguments.planes, capture->basis.name());
    n_planes += capture->chosen.size();
  }
  constexpr std::size_t kMaxPlanes = 8;
  if (n_planes > kMaxPlanes) {
    throw Error(fmt::format("{} planes; at most {} are joined", n_planes, kMaxPlanes),
                "command line", "name some with --plane", ExitCode::usage);
  }
  const PlaneFrame& frame = captures[0]->frames[captures[0]->chosen[0]];
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
  options.tolerance.relative_l2 =
      arguments.max_error.value_or(arguments.worst_point ? 1.0 : 0.0);
  if (arguments.worst_point) {
    options.tolerance.worst_pixel = *arguments.worst_point;
    report.add_asked("irradiance_worst_point", *arguments.worst_point);
  }
  report.add_asked("irradiance_relative_l2", options.tolerance.relative_l2);
  report.add_asked("window", arguments.window);

  const std::vector<int> wanted = visiting_order(lights, weights);
  std::optional<BasisFile> plate_file;
  if (arguments.plate != "computed" && arguments.plate != "falloff") {
    report.add_input(arguments.plate);
    plate_file = BasisFile::open(arguments.plate);
    if (n_planes > 1) {
      throw Error("a captured plate is of one plane, here are several", "--plate",
                  "name one plane with --plane, or leave --plate out", ExitCode::usage);
    }
  }
  report.add_detail("plate", arguments.plate);
  const Image<std::uint8_t> mask = read_mask(arguments.mask);
  const CameraModel& first_eye = rig.cameras[0].model;
  if (!mask.is_empty() &&
      (mask.width() != first_eye.width || mask.height() != first_eye.height)) {
    throw Error(fmt::format("the mask is {} x {}, the camera {} x {}", mask.width(),
                            mask.height(), first_eye.width, first_eye.height),
                arguments.mask, "draw it on one of the camera's pictures");
  }
  if (!mask.is_empty() && n_planes > 1) {
    throw Error("a mask is of one plane, here are several", "--mask",
                "name one plane with --plane", ExitCode::usage);
  }
  std::vector<SamplingPlane> planes;
  for (const auto& capture : captures) {
    const CameraModel& eye = capture->rig.cameras[0].model;
    for (const std::size_t i : capture->chosen) {
      const PlaneFrame& here = capture->frames[i];
      if (plate_file) {
        capture->plates.push_back(std::make_unique<BasisSource>(*plate_file));
      } else {
        capture->plates.push_back(std::make_unique<RigPlate>(
            eye, capture->frames, i, rig_lights(capture->rig),
            arguments.plate == "falloff" ? PlateKind::points : PlateKind::squares));
      }
      StackVisibility* shadow = nullptr;
      if (!wanted.empty()) {
        StackVisibilityOptions visibility_options;
        visibility_options.shows_plane = mask;
        visibility_options.memory_bytes = common.memory_bytes / (4 * n_planes);
        capture->shadows.push_back(
            std::make_unique<StackVisibility>(capture->stack, *capture->plates.back(), eye,
                                              here, wanted, std::move(visibility_options)));
        shadow = capture->shadows.back().get();
        const std::string suffix = planes.empty() ? "" : fmt::format("_{}", planes.size() + 1);
        report.add_detail("plate_scale" + suffix, shadow->scale());
        report.add_reached("plane_known_share" + suffix, shadow->known_share());
      }
      planes.push_back({here, [shadow](int k) { return shadow->visibility(k); },
                        over_plane(options.object, frame, here)});
    }
  }
  report.add_detail("planes", static_cast<std::int64_t>(planes.size()));
  ReprojectResult result =
      reproject_shadow(scene.scene, view, planes, lights, weights, options);
  add_to_report(result.report, report);
  fmt::print("{}: {} lights, {} receivers\n", arguments.output, result.report.n_lights,
             result.report.n_receivers);
  if (options.tolerance.relative_l2 > 0.0) {
    const PointsReport& points = result.report.points;
    fmt::print(
        "{}",
        points.is_exact
            ? std::string("  every light was looked up: no error\n")
            : fmt::format("  relative error of the light received {:.2g} "
                          "(at most {:.2g}), worst point {:.2g}, on {} receivers "
                          "checked; {:.0f} look-ups each instead of {}\n",
                          points.reached.relative_l2, points.relative_l2_limit,
                          points.reached.worst_pixel, points.n_checked, points.lookups_a_point,
                          static_cast<std::size_t>(points.n_lights) * planes.size()));
  }
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
  PictureNotes notes = notes_of(captures[0]->basis.header());
  LightWeights drives(static_cast<Eigen::Index>(weights.size()), 3);
  for (std::size_t k = 0; k < weights.size(); ++k) {
    drives.row(static_cast<Eigen::Index>(k)) = weights[k].transpose();
  }
  add_weights(drives, notes);
  if (options.tolerance.relative_l2 > 0.0) {
    add_error(options.tolerance.relative_l2, result.report.points.reached.relative_l2, notes);
  }
  std::uint64_t bytes = 0;
  if (!arguments.spread.empty()) {
    write_image(arguments.spread, result.spread.view(), exposure, notes);
    bytes += fs::file_size(arguments.spread);
  }
  const Truth truth{scene.scene, object, view, lights, weights};
  const bool is_judged = !arguments.truth.empty();
  Image<float> judge;
  if (arguments.with_object && !wanted.empty()) {
    const Image<std::uint8_t> drawn = add_object(arguments, *captures[0], weights, scene.scene,
                                                 options.object, result.picture, report);
    if (is_judged) {
      judge =
          judge_composite(truth, result.picture, drawn, arguments.subpixels, common, report);
    }
  } else if (is_judged) {
    judge = judge_shadow(truth, result, arguments.subpixels, common, report);
  }
  if (is_judged) {
    bytes += write_truth(arguments, result.picture, std::move(judge), exposure, notes);
  }
  write_image(arguments.output, result.picture.view(), exposure, notes);
  report.set_bytes(bytes + fs::file_size(arguments.output));
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
  verb.option("--plane", &arguments->planes,
              "The rig's planes to use (default: all); between planes it interpolates",
              {.type = "ID"});
  verb.option("--also", &arguments->also,
              "Further captures of the object, the plane moved between them",
              {.type = "BASIS.hlb"});
  verb.option("--max-error", &arguments->max_error,
              "Relative L2 error of the light that the scene receives: blocks of lights are "
              "taken together (default: exact)",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option("--worst-point", &arguments->worst_point,
              "The same for the worst point, as a share of the brightest",
              {.bounds = Bounds{0.0, 1.0}});
  verb.flag("--with-object", &arguments->with_object,
            "Lay the relit object itself over the scene, seen by the capture's camera");
  verb.option("--plane-albedo", &arguments->plane_albedo,
              "What the captured plane reflects: brings the object to the scene's brightness",
              {.bounds = Bounds{0.001, 1.0}});
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
      "      --truth-object configs/scenes/airplane.toml --truth truth.png -o shadow.png\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml --max-error 0.01 \\\n"
      "      --cubemap apartment.hdr --with-object --plane-albedo 0.8 -o together.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shadow(*arguments, common, report);
  });
}

}  // namespace haarlight
