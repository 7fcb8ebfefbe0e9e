// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shadow_pipeline.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/relight/shadow/composite.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/basis/weight_list.h"
#include "relight/hull/hull_caster.h"
#include "relight/pipeline/display_exposure.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/pipeline/result_lines.h"
#include "relight/pipeline/shadow_words.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

/// Called before anything is read.
void check_options(const ShadowOptions& options) {
  for (const std::string& file :
       {options.output, options.spread, options.unseen, options.truth, options.difference}) {
    if (!file.empty()) {
      require_picture_name(file);
      require_absent(file, options.settings.overwrites);
    }
  }
  if (options.truth.empty() != options.truth_object.empty() ||
      (options.truth.empty() && !options.difference.empty())) {
    throw Error("--truth and --truth-object go together, --difference needs both",
                "command line", "name the object's scene and the picture", ExitCode::usage);
  }
  if (options.with_object && (!options.plane_albedo || !options.size.empty())) {
    throw Error(options.plane_albedo ? "--with-object is seen by the capture's camera"
                                     : "--with-object needs --plane-albedo",
                "command line",
                options.plane_albedo
                    ? "leave out --size"
                    : "say how much light the captured plane reflects, for example 0.8: "
                      "object and scene have one brightness through it",
                ExitCode::usage);
  }
  if (options.background && options.light.cubemap.empty()) {
    throw Error("--background shows the environment, and none is given", "command line",
                "give --cubemap", ExitCode::usage);
  }
  require_heights(options.captured);
}

std::vector<Eigen::Vector3d> read_weights(const ShadowOptions& options, const Rig& rig,
                                          ShadowSummary& summary) {
  if (options.light.cubemap.empty() == options.light.lights.empty()) {
    throw Error("give one of --cubemap and --light", "command line", "name the light once",
                ExitCode::usage);
  }
  Eigen::MatrixXd weights;
  if (options.light.cubemap.empty()) {
    weights = weights_from_words(options.light.lights, rig.n_lights());
  } else {
    const render::Environment environment = read_environment(options.light);
    const EnvironmentWeights found = rig_weights(environment, rig);
    summary.layout = std::string(to_string(environment.layout()));
    summary.missing_fraction = found.missing_fraction;
    weights = found.weights;
  }
  std::vector<Eigen::Vector3d> colours;
  for (Eigen::Index k = 0; k < weights.rows(); ++k) {
    colours.emplace_back(weights(k, 0), weights(k, weights.cols() > 1 ? 1 : 0),
                         weights(k, weights.cols() > 1 ? 2 : 0));
  }
  return colours;
}

/// The scene's camera, or the capture's own where the scene has none; resized on request.
CameraModel view_of(const ShadowOptions& options, const render::SceneFile& scene,
                    const Rig& rig) {
  CameraModel camera =
      scene.has_camera && !options.with_object ? scene.camera : rig.cameras[0].model;
  return options.size.empty() ? camera
                              : render::resized(camera, options.size[0], options.size[1]);
}

LightWeights drive_levels_of(std::span<const Eigen::Vector3d> weights) {
  LightWeights light_weights(static_cast<Eigen::Index>(weights.size()), 3);
  for (std::size_t k = 0; k < weights.size(); ++k) {
    light_weights.row(static_cast<Eigen::Index>(k)) = weights[k].transpose();
  }
  return light_weights;
}

/// Common to all steps: the inputs, as read.
struct ShadowJob {
  const ShadowOptions& options;
  const ShadowCaptures& captures;
  const render::Scene& scene;
  const render::Scene& object;  ///< the truth's, empty: none
  const CameraModel& view;
  std::span<const render::SquareLight> lights;
  std::span<const Eigen::Vector3d> weights;
};

/// Composites the relit object over the scene. @return  where it is drawn
Image<std::uint8_t> add_object(const ShadowJob& job, Image<float>& picture,
                               ShadowSummary& summary) {
  const ShadowCapture& capture = job.captures.first();
  const CameraModel& eye = capture.rig.cameras[0].model;
  const PlaneFrame& frame = job.captures.frame();
  const render::SquareLight one = render::rig_lights(capture.rig)[0];
  // To the scale of a computed clean plate, by way of a captured one.
  double plate_scale = capture.shadows[0]->scale();
  if (is_plate_captured(job.options.captured)) {
    const RigPlate computed(eye, frame.plane, render::rig_lights(capture.rig),
                            PlateKind::squares);
    StackVisibilityOptions only_scale;
    only_scale.shows_plane = Image<std::uint8_t>(eye.height, eye.width, 1);  // not looked for
    plate_scale *=
        StackVisibility(*capture.plates[0], computed, eye, frame, {}, std::move(only_scale))
            .scale();
  }
  const RelitPicture relit = relight(capture.basis, drive_levels_of(job.weights));
  CompositeOptions composite;
  composite.object = job.options.captured.height;
  composite.scale = scene_scale(plate_scale, capture.stack.dims().channels,
                                *job.options.plane_albedo, one.width_mm * one.height_mm);
  CompositeCount count = draw_object(picture, relit.picture, object_pixels(capture),
                                     render::RayCaster(job.scene), eye, frame, composite);
  summary.object = ShadowObject{count.n_object, count.n_hidden, composite.scale};
  return std::move(count.drawn);
}

/// The shadow alone, against ray-traced receivers.
Image<float> compare_shadow_with_truth(const ShadowJob& job, const ReprojectResult& result,
                                       ShadowSummary& summary) {
  Image<float> truth = trace_shadow(job.scene, job.object, job.view, job.lights, job.weights,
                                    job.options.subpixels, job.options.settings.progress);
  summary.truth = ShadowAgreement{.achieved = compare(result.picture.pixels(), truth.pixels()),
                                  .shadow = compare_shadow(result, truth),
                                  .object = {}};
  return truth;
}

/// Scene and object together, against both ray-traced.
Image<float> compare_composite(const ShadowJob& job, const Image<float>& picture,
                               const Image<std::uint8_t>& drawn, ShadowSummary& summary) {
  render::Scene all = job.scene;
  render::append_scene(all, job.object);
  render::LitOptions lit;
  lit.n_subpixels = job.options.subpixels;
  lit.progress = job.options.settings.progress;
  Image<float> truth = render::render_lit(all, job.view, job.lights, job.weights, lit).radiance;
  summary.truth = ShadowAgreement{.achieved = compare(picture.pixels(), truth.pixels()),
                                  .shadow = {},
                                  .object = compare_drawn(picture, truth, drawn)};
  return truth;
}

/// The environment behind the picture and behind its truth, once they have been compared.
void add_background(const ShadowJob& job, const Image<std::uint8_t>& drawn,
                    Image<float>& picture, Image<float>& truth, ShadowSummary& summary,
                    PipelineNotes& told) {
  const render::Environment environment = read_environment(job.options.light);
  summary.background_fraction =
      draw_background(picture, environment, render::RayCaster(job.scene), job.view, drawn,
                      job.options.subpixels, *job.options.background);
  told.add(NoteKind::result, fmt::format("  {:.1f} % of the picture shows the environment",
                                         100.0 * *summary.background_fraction));
  if (!truth.is_empty()) {
    render::Scene all = job.scene;
    if (job.options.with_object) {
      render::append_scene(all, job.object);
    }
    (void)draw_background(truth, environment, render::RayCaster(all), job.view, {},
                          job.options.subpixels, *job.options.background);
  }
}

/// Truth and difference. @return  bytes
std::uint64_t write_truth(const ShadowOptions& options, const Image<float>& picture,
                          Image<float> truth, double exposure, const PictureNotes& notes) {
  write_image(options.truth, truth.view(), exposure, notes);
  std::uint64_t bytes = fs::file_size(options.truth);
  if (!options.difference.empty()) {
    constexpr float kBrighter = 4.0F;
    for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
      float& d = truth.pixels()[i];
      d = kBrighter * std::abs(picture.pixels()[i] - d);
    }
    write_image(options.difference, truth.view(), exposure, notes);
    bytes += fs::file_size(options.difference);
  }
  return bytes;
}

PictureNotes shadow_notes(const ShadowJob& job, const ReprojectReport& found) {
  PictureNotes notes = notes_of(job.captures.first().basis.header());
  add_weights(drive_levels_of(job.weights), notes);
  const double requested = shadow_tolerance(job.options).relative_l2;
  if (requested > 0.0) {
    add_error(requested, found.points.achieved.relative_l2, notes);
  }
  return notes;
}

/// Draws the object, compares with the truth, and writes every picture.
void finish_pictures(const ShadowJob& job, ReprojectResult& result, bool is_lit,
                     ShadowSummary& summary, PipelineNotes& told) {
  const ShadowOptions& options = job.options;
  // Of the unshadowed picture, so that a shadow never changes the exposure.
  const std::span<const float> unshadowed = result.unshadowed.pixels();
  summary.exposure =
      options.exposure.value_or(fs::path(options.output).extension() == ".png"
                                    ? display_exposure(unshadowed, kDisplayFraction)
                                    : 1.0);
  const PictureNotes notes = shadow_notes(job, result.report);
  if (!options.spread.empty()) {
    write_image(options.spread, result.spread.view(), summary.exposure, notes);
    summary.bytes += fs::file_size(options.spread);
  }
  if (!options.unseen.empty()) {
    write_image(options.unseen, result.unseen.view(), summary.exposure, notes);
    summary.bytes += fs::file_size(options.unseen);
  }
  const bool is_assessed = !options.truth.empty();
  Image<float> truth;
  Image<std::uint8_t> drawn;
  if (options.with_object && is_lit) {
    drawn = add_object(job, result.picture, summary);
    tell_lines(object_words(*summary.object), told);
    if (is_assessed) {
      truth = compare_composite(job, result.picture, drawn, summary);
    }
  } else if (is_assessed) {
    truth = compare_shadow_with_truth(job, result, summary);
  }
  if (is_assessed) {
    tell_lines(truth_words(*summary.truth), told);
  }
  if (options.background) {
    add_background(job, drawn, result.picture, truth, summary, told);
  }
  if (is_assessed) {
    summary.bytes +=
        write_truth(options, result.picture, std::move(truth), summary.exposure, notes);
  }
  write_image(options.output, result.picture.view(), summary.exposure, notes);
  summary.bytes += fs::file_size(options.output);
}

}  // namespace

Tolerance shadow_tolerance(const ShadowOptions& options) {
  Tolerance tolerance{
      .relative_l2 = options.max_error.value_or(options.worst_point ? 1.0 : 0.0),
      .worst_pixel = std::numeric_limits<double>::infinity()};
  if (options.worst_point) {
    tolerance.worst_pixel = *options.worst_point;
  }
  return tolerance;
}

ShadowSummary cast_shadow(const ShadowOptions& options) {
  check_options(options);
  ShadowSummary summary;
  ShadowCaptures captures(options.captured, options.settings.memory_bytes);
  const std::vector<Eigen::Vector3d> weights = read_weights(options, captures.rig(), summary);
  render::SceneFile scene = render::read_scene(options.scene);
  if (scene.optics != render::CameraOptics{}) {
    throw Error(
        "the scene's camera is no plain pinhole: it has a lens, is orthographic, or has "
        "near_mm "
        "or far_mm",
        options.scene,
        "leave lens_radius_mm, width_mm (give fov_y_deg), near_mm and far_mm out of [camera]: "
        "haarlight render alone knows them");
  }
  render::require_for_direct_light(scene.scene, options.scene, "haarlight shadow");
  scene.scene = render::with_instances_expanded(std::move(scene.scene), options.scene);
  render::Scene object;  // read before anything is written, like every input
  if (!options.truth_object.empty()) {
    object = render::read_scene(options.truth_object).scene;
    render::require_for_direct_light(object, options.truth_object, "haarlight shadow");
    object = render::with_instances_expanded(std::move(object), options.truth_object);
    remove_plane_triangles(object, captures.frame());
  }
  const CameraModel view = view_of(options, scene, captures.rig());
  const std::vector<render::SquareLight> lights = render::rig_lights(captures.rig());
  ReprojectOptions reproject;
  reproject.rule = options.window;
  reproject.object = options.captured.height;
  reproject.n_subpixels = options.subpixels;
  reproject.has_own_shadows = options.has_own_shadows;
  reproject.has_spread = !options.spread.empty();
  reproject.memory_bytes = options.settings.memory_bytes / 2;
  reproject.progress = options.settings.progress;
  reproject.tolerance = shadow_tolerance(options);
  const std::vector<int> wanted = visiting_order(lights, weights);
  captures.read_plate_and_mask();
  PipelineNotes told(options.settings.tell);
  std::optional<HullCaster> caster;
  std::vector<FoundPlane> found_planes;  // by whoever carved the hull
  if (options.method != ShadowMethod::plane && !wanted.empty()) {
    CapturedHull found =
        captured_hull(options.captured, options.hull_voxel_mm, options.settings, told);
    summary.hull = std::move(found.source);
    found_planes = std::move(found.hull.planes);
    caster.emplace(std::move(found.hull));
    reproject.occluder = &*caster;
    reproject.method = options.method;
  }
  const std::vector<SamplingPlane> planes =
      captures.sample(wanted, summary.plates, std::move(found_planes));
  summary.n_planes = planes.size();
  summary.joined = captures.joined();
  if (options.method == ShadowMethod::plane) {  // with a hull that one tells
    for (const ShadowPlate& plate : summary.plates) {
      tell_offset(plate.plane, plate.offset, told);
    }
  }
  ReprojectResult result =
      reproject_shadow(scene.scene, view, planes, lights, weights, reproject);
  summary.reprojected = result.report;
  tell_lines(shadow_words(options, summary), told);
  finish_pictures({options, captures, scene.scene, object, view, lights, weights}, result,
                  !wanted.empty(), summary, told);
  summary.notes = told.all();
  return summary;
}

}  // namespace haarlight::relight
