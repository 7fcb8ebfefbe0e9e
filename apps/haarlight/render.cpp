// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render surface SCENE.toml -o PICTURE`: a scene's own lights, by light paths.

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "relight/pipeline/display_exposure.h"
#include "render/surface/path_integrator.h"

namespace haarlight::apps {

namespace {

enum class IntegratorKind : std::uint8_t { direct, path };
constexpr auto kIntegratorWords = std::to_array<std::string_view>({"direct", "path"});
constexpr std::span<const std::string_view> words_of(IntegratorKind) {
  return kIntegratorWords;
}

/// Of the values of a .png, not clipped: what emits is brighter than what it lights.
constexpr double kShownFraction = 0.98;

struct RenderArguments {
  std::string scene;
  std::string output;
  std::string error_picture;
  IntegratorKind integrator = IntegratorKind::path;
  render::SamplerKind sampler = render::SamplerKind::sobol;
  std::optional<int> samples;
  std::optional<double> max_error;
  std::optional<double> seconds;
  int most_bounces = render::PathOptions{}.most_bounces;
  std::uint64_t seed = 0;
  std::optional<double> exposure;
};

bool is_for_display(const std::string& file) {
  return std::filesystem::path(file).extension() == ".png";
}

render::RunOptions run_options(const RenderArguments& arguments, const CommonOptions& common) {
  render::RunOptions options;
  if (arguments.samples) {
    options.samples = static_cast<std::uint32_t>(*arguments.samples);
  } else if (!arguments.max_error && !arguments.seconds) {
    options.samples = 64;
  }
  options.relative_l2 = arguments.max_error.value_or(0.0);
  options.seconds = arguments.seconds.value_or(options.seconds);
  options.progress = common.progress();
  return options;
}

ExitCode run_surface(const RenderArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.scene);
  report.add_requested("integrator", std::string(to_string(arguments.integrator)));
  report.add_requested("sampler", std::string(to_string(arguments.sampler)));
  report.add_requested("relative_l2", arguments.max_error.value_or(0.0));
  require_absent(arguments.output, common.force);
  require_picture_name(arguments.output);
  if (!arguments.error_picture.empty()) {
    require_absent(arguments.error_picture, common.force);
    require_picture_name(arguments.error_picture);
    if (arguments.error_picture == arguments.output) {
      throw Error("the picture and its error would be one file", arguments.output,
                  "give --error another name", ExitCode::usage);
    }
    if (arguments.samples == 1) {
      throw Error("one sample has no standard error", "--error", "give --spp 2 or more",
                  ExitCode::usage);
    }
  }
  const render::SceneFile file = render::read_scene(arguments.scene);
  if (!file.has_camera) {
    throw Error("the scene has no camera", arguments.scene,
                "add a [camera]: docs/reference/scene-file.md");
  }
  const bool is_lit = std::any_of(
      file.scene.meshes.begin(), file.scene.meshes.end(), [&](const render::Mesh& mesh) {
        return file.scene.materials[static_cast<std::size_t>(mesh.material)].emits.maxCoeff() >
               0.0;
      });
  if (!is_lit) {
    throw Error("nothing in the scene emits light", arguments.scene,
                "give the [[material]] of a shape emits = [red, green, blue]: "
                "docs/reference/scene-file.md");
  }
  const render::RayCaster caster(file.scene);
  render::PathOptions options;
  options.most_bounces =
      arguments.integrator == IntegratorKind::direct ? 1 : arguments.most_bounces;
  options.sampler = arguments.sampler;
  options.seed = arguments.seed;
  const render::PathIntegrator integrator(file.scene, caster, file.camera, options);
  render::Film film(file.camera.width, file.camera.height);
  const render::RunResult result =
      render::run(integrator, run_options(arguments, common), film);
  const Image<float> picture = film.mean();
  double exposure = 1.0;
  if (is_for_display(arguments.output)) {
    const auto values = picture.pixels();
    exposure = arguments.exposure.value_or(
        relight::display_exposure({values.begin(), values.end()}, kShownFraction));
  }
  write_image(arguments.output, picture.view(), exposure);
  if (!arguments.error_picture.empty()) {
    write_image(arguments.error_picture, film.standard_error().view(), exposure);
  }
  report.add_achieved("relative_l2", result.error.relative_l2);
  report.add_achieved("samples_per_pixel", std::int64_t{result.samples});
  report.add_detail("rays", static_cast<std::int64_t>(result.n_rays));
  report.add_detail("render_seconds", result.seconds);
  report.add_detail("exposure", exposure);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  fmt::print(
      "{}: {} x {} pixels, {} samples each, standard error {:.2g} of the picture (L2), "
      "{:.1f} million rays in {:.1f} s\n",
      arguments.output, picture.width(), picture.height(), result.samples,
      result.error.relative_l2, 1e-6 * static_cast<double>(result.n_rays), result.seconds);
  const bool is_missed =
      arguments.max_error && !(result.error.relative_l2 <= *arguments.max_error);
  return is_missed ? ExitCode::target_missed : ExitCode::done;
}

void add_render_surface(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<RenderArguments>();
  Command verb = root.add_verb("surface", "Render a scene under its own lights");
  verb.option("SCENE", &arguments->scene,
              "Scene file with a [camera] and a material that emits",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Picture to write: .exr or .tif linear, .png for display",
              {.type = "PICTURE", .is_required = true});
  verb.option("--error", &arguments->error_picture,
              "Also write the standard error of each pixel, as a picture", {.type = "PICTURE"});
  verb.option("--integrator", &arguments->integrator,
              "direct: light that arrives without a bounce; path: all of it",
              {.choices = choices_of({IntegratorKind::direct, IntegratorKind::path}),
               .shows_default = true});
  verb.option("--spp", &arguments->samples,
              "Samples per pixel (default: 64, where no error or time is given)",
              {.bounds = Bounds{1, 1 << 20}});
  verb.option("--max-error", &arguments->max_error,
              "Samples until the picture's standard error, relative L2, is at most E",
              {.type = "E", .bounds = Bounds{1e-6, 1.0}});
  verb.option("--seconds", &arguments->seconds, "No new pass of samples after T seconds",
              {.type = "T", .bounds = Bounds{0.01}});
  verb.option("--bounces", &arguments->most_bounces,
              "Longest paths of --integrator path; longer ones are left out",
              {.bounds = Bounds{0, 1 << 16}, .shows_default = true});
  verb.option(
      "--sampler", &arguments->sampler,
      "How samples are spread: sobol evenly, independent at random",
      {.choices = choices_of({render::SamplerKind::independent, render::SamplerKind::sobol}),
       .shows_default = true});
  verb.option("--seed", &arguments->seed, "Of the samples", {.shows_default = true});
  verb.option("--exposure", &arguments->exposure,
              "Factor for a .png (default: 98 % of the values are not clipped)",
              {.bounds = Bounds{1e-9, 1e9}});
  verb.footer(
      "Example:\n  haarlight render surface configs/scenes/cornell.toml -o cornell.png --spp "
      "16");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_surface(*arguments, common, report);
  });
}

}  // namespace

void add_render(Command root, Invocation& invocation) {
  Command render = root.add_verb("render", "Render a scene file under its own lights");
  render.require_verb();
  add_render_surface(render, invocation);
  render.footer("haarlight render VERB --help tells the options of each.");
}

}  // namespace haarlight::apps
