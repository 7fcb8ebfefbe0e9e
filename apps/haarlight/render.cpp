// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render surface SCENE.toml -o PICTURE`: a scene's own lights, by light paths.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/end_signals.h"
#include "apps/haarlight/render_explain.h"
#include "apps/haarlight/render_film.h"
#include "apps/haarlight/render_join.h"
#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/render_smooth.h"
#include "apps/haarlight/render_soft_shadow.h"
#include "apps/haarlight/render_volume.h"
#include "apps/haarlight/surface_auto.h"
#include "apps/haarlight/surface_integrators.h"
#include "apps/haarlight/surface_picture.h"
#include "apps/haarlight/verb.h"
#include "apps/program_version.h"
#include "core/log.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_window.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "relight/pipeline/display_exposure.h"
#include "render/film/film_file.h"
#include "render/light/environment_light.h"
#include "render/light/scene_lights.h"
#include "render/scene/texture_files.h"
#include "render/surface/surface_layers.h"

namespace haarlight::apps {

namespace {

struct RenderArguments {
  std::string scene;
  std::string output;
  std::string error_picture;
  FilmArguments kept;
  IntegratorArguments integrator;
  std::vector<int> size;
  std::string crop;
  bool explains = false;
  std::optional<int> samples;
  std::optional<double> max_error;
  std::optional<double> seconds;
  std::optional<double> exposure;
};

/// Whether what is written keeps the layers after the first.
bool has_features(const RenderArguments& arguments) {
  return !arguments.kept.film.empty() || has_ending(arguments.output, ".exr");
}

/// The pixels of `picture` to render: as --crop says, else as the scene file.
render::Crop crop_of(const std::string& text, const render::FilmSettings& film,
                     const CameraModel& picture) {
  if (text.empty()) {
    const render::Crop crop =
        film.crop.value_or(render::Crop{.width = picture.width, .height = picture.height});
    if (!is_within(crop, picture.width, picture.height)) {
      throw Error(fmt::format("the crop {} is outside of the picture of {} x {} pixels",
                              crop_text(crop), picture.width, picture.height),
                  film.crop_where, "give --crop, too, or no --size", ExitCode::usage);
    }
    return crop;
  }
  const std::optional<render::Crop> crop = render::parse_crop(text);
  if (!crop || !is_within(*crop, picture.width, picture.height)) {
    throw Error(fmt::format("no part of a picture of {} x {} pixels: {}", picture.width,
                            picture.height, text),
                "--crop",
                "give WxH+X+Y: width and height, and the first column and row, from 0",
                ExitCode::usage);
  }
  return *crop;
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
  options.keep_seconds = arguments.kept.keep_seconds.value_or(options.keep_seconds);
  options.part = part_of(arguments.kept, arguments.output);
  options.progress = common.progress();
  return options;
}

/// All that a sample's value depends on.
render::RenderSettings settings_of(const RenderArguments& arguments,
                                   const render::SceneFile& file,
                                   const std::optional<render::Environment>& environment,
                                   const render::PathOptions& options, const render::Crop& crop,
                                   const render::Part& part) {
  render::RenderSettings settings = {
      {"program", program_version()},
      {"scene", hash_of(file)},
      {"environment", environment ? environment->content_hash() : "none"}};
  for (const auto& setting : integrator_settings(arguments.integrator, options)) {
    settings.push_back(setting);
  }
  settings.insert(settings.end(),
                  {{kPictureSetting, render::crop_text({.width = file.camera.width,
                                                        .height = file.camera.height})},
                   {kCropSetting, crop_text(crop)},
                   {"parts", std::to_string(part.n_parts)}});
  return settings;
}

/// The sums need their own memory again while pictures are made of them.
std::uint64_t film_bytes(int width, int height, const std::vector<render::FilmLayer>& layers) {
  return 2 * render::Film::bytes_needed(width, height, layers);
}

std::vector<render::FilmLayer> film_layers(const RenderArguments& arguments) {
  return render::surface_layers(has_features(arguments), has_splats(arguments.integrator));
}

void require_memory(int width, int height, const RenderArguments& arguments,
                    const CommonOptions& common, std::uint64_t scene_bytes) {
  const std::uint64_t own_bytes = film_bytes(width, height, film_layers(arguments));
  if (own_bytes + scene_bytes > common.memory_bytes) {
    constexpr std::uint64_t kMega = 1'000'000;
    throw Error(
        fmt::format("{} x {} pixels need {} MB, surfaces, textures and the environment {} MB; "
                    "--memory allows {}",
                    width, height, own_bytes / kMega, scene_bytes / kMega,
                    common.memory_bytes / kMega),
        arguments.scene,
        "give a smaller --size or --crop, the scene fewer triangles or a smaller environment, "
        "fewer --patches, or more --memory",
        ExitCode::usage);
  }
}

/// Refuses lights that no direction of a BSDF meets, where only those are followed.
void require_met_lights(const render::Scene& scene, render::DirectSampling sampling,
                        const std::string& path) {
  if (sampling == render::DirectSampling::bsdf &&
      !(scene.point_lights.empty() && scene.directional_lights.empty())) {
    throw Error("--sampling bsdf never finds a [[light]]: it has no extent", path,
                "render with --sampling mis or light", ExitCode::usage);
  }
}

AutoRequest auto_request(const RenderArguments& arguments, std::uint64_t memory_bytes) {
  return {.integrator = arguments.integrator,
          .max_error = arguments.max_error,
          .seconds = arguments.seconds,
          .film = arguments.kept.film,
          .has_features = has_features(arguments),
          .memory_bytes = memory_bytes};
}

/// Refuses options that another one leaves without a meaning.
void require_words_that_fit(const RenderArguments& arguments) {
  const auto refuse = [](const char* what, const char* option, const char* hint) {
    throw Error(what, option, hint, ExitCode::usage);
  };
  require_film_words(arguments.kept, arguments.output, arguments.explains);
  if (!arguments.error_picture.empty() && arguments.output.empty()) {
    refuse("an error without its picture", "--error", "give -o PICTURE too");
  }
  if (!arguments.error_picture.empty() && arguments.samples == 1) {
    refuse("one sample has no standard error", "--error", "give --spp 2 or more");
  }
  require_integrator_words(arguments.integrator, arguments.explains);
  require_auto_words(auto_request(arguments, 0), !arguments.kept.part.empty(),
                     arguments.explains);
  if (!arguments.kept.part.empty() && arguments.max_error) {
    refuse("the error of a part is not the picture's: parts would end with other samples",
           "--max-error", "give all parts the same --spp");
  }
}

/// @param prepared_seconds  of what the integrator made before the picture
void report_run(const render::RunResult& result, double prepared_seconds, Report& report) {
  report.add_achieved("relative_l2", result.error.relative_l2);
  report.add_achieved("samples_per_pixel", std::int64_t{result.samples});
  report.add_achieved("ended_by", std::string(to_string(result.end)));
  report.add_detail("rays", static_cast<std::int64_t>(result.n_rays));
  report.add_detail("prepare_seconds", prepared_seconds);
  report.add_detail("render_seconds", result.seconds);
}

/// Says why not.
bool is_error_reached(std::optional<double> max_error, const render::RunResult& result) {
  if (!max_error || result.error.relative_l2 <= *max_error) {
    return true;
  }
  log_error(fmt::format("a standard error of {:.3g} was requested and is not reached: {}",
                        *max_error,
                        result.end == render::RunEnd::time   ? "give more --seconds"
                        : result.end == render::RunEnd::dark ? "no light was found"
                                                             : "give more --spp"));
  return false;
}

ExitCode run_surface(RenderArguments arguments, const CommonOptions& common, Report& report) {
  take_given(arguments.integrator);
  report.add_input(arguments.scene);
  report_integrator(arguments.integrator, report);
  report.add_requested("relative_l2", arguments.max_error.value_or(0.0));
  render::RunOptions run = run_options(arguments, common);
  require_words_that_fit(arguments);
  require_outputs(arguments.output, arguments.error_picture, "--error", common.force);
  render::SceneFile file = read_lit_scene(arguments.scene, arguments.size);
  require_met_lights(file.scene, arguments.integrator.sampling, arguments.scene);
  const render::LoadedTextures textures =
      render::load_textures(file.scene, common.memory_bytes);
  for (const std::vector<std::string>& files : {file.files, textures.files}) {
    for (const std::string& input : files) {
      report.add_input(input);
    }
  }
  const std::optional<render::Environment> environment = render::read_environment(file.scene);
  const render::Crop crop = crop_of(arguments.crop, file.film, file.camera);
  const std::uint64_t scene_bytes =
      textures.bytes + render::RayCaster::bytes_needed(file.scene) +
      render::SceneLights::bytes_needed(file.scene) +
      integrator_bytes(arguments.integrator, file.scene, arguments.scene) +
      (environment ? render::EnvironmentLight::bytes_needed(*environment) : 0);
  require_memory(crop.width, crop.height, arguments, common, scene_bytes);
  const render::RayCaster caster(file.scene);
  const render::Environment* const light_from_afar = environment ? &*environment : nullptr;
  const AutoRequest request = auto_request(arguments, common.memory_bytes - scene_bytes);
  std::optional<AutoChoice> choice;
  if (arguments.integrator.kind == IntegratorKind::automatic) {
    choice = choose_integrator(request, file, caster, light_from_afar, crop, report);
    arguments.integrator = choice->integrator;
    run.seconds = std::max(1e-3, run.seconds - choice->seconds);
  }
  auto film = std::make_unique<render::Film>(crop.width, crop.height, film_layers(arguments));
  const render::PathOptions options =
      path_options(arguments.integrator, file.film, crop, request.has_features);
  const render::RenderSettings settings =
      settings_of(arguments, file, environment, options, crop, run.part);
  const Preparation preparation{
      .crop = crop,
      .memory_bytes = common.memory_bytes -
                      std::min(common.memory_bytes,
                               scene_bytes + 2 * render::Film::bytes_needed(
                                                     crop.width, crop.height, film->layers())),
      .is_stopped =
          arguments.kept.film.empty() ? nullptr : std::function<bool()>(EndSignals::have_come),
      .report = &report};
  std::optional<FilmKeeper> keeper;
  std::optional<EndSignals> signals;
  if (!arguments.kept.film.empty()) {
    signals.emplace();  // before there is a film: from then on it can go on
    keeper.emplace(arguments.kept.film, run.part, settings, common.memory_bytes, film);
    run.keep = [&keeper] { keeper->keep(); };
    run.is_stopped = EndSignals::have_come;
  }
  if (arguments.explains) {
    explain_terms(file, crop.width, crop.height, caster, light_from_afar, options, report);
    if (arguments.output.empty() && arguments.kept.film.empty()) {
      return ExitCode::done;
    }
  }
  const auto start = std::chrono::steady_clock::now();
  const std::unique_ptr<render::TileRenderer> integrator = make_integrator(
      arguments.integrator, file, caster, light_from_afar, options, preparation);
  const std::chrono::duration<double> prepared = std::chrono::steady_clock::now() - start;
  const render::RunResult result = render::run(*integrator, run, *film);
  if (keeper) {
    keeper->keep_last();
  }
  report_run(result, prepared.count(), report);
  const std::string& made = arguments.output.empty() ? arguments.kept.film : arguments.output;
  if (result.end == render::RunEnd::stopped) {
    fmt::print("{}: interrupted, {}; the same command goes on\n", arguments.kept.film,
               samples_words(result.samples, result.most_samples));
    return ExitCode::interrupted;
  }
  if (!arguments.output.empty()) {
    report.add_detail(
        "exposure",
        write_surface_pictures(*film, window_of(settings, arguments.scene), result.samples,
                               arguments.output, arguments.error_picture, arguments.exposure));
  }
  report.set_bytes(std::filesystem::file_size(made));
  fmt::print(
      "{}: {} x {} pixels, {}, standard error {:.2g} of the picture (L2), "
      "{:.1f} million rays in {:.1f} s\n",
      made, film->width(), film->height(), samples_words(result.samples, result.most_samples),
      result.error.relative_l2, 1e-6 * static_cast<double>(result.n_rays), result.seconds);
  if (choice) {
    tell_outcome(request, *choice, result, report);
  }
  return is_error_reached(arguments.max_error, result) ? ExitCode::done
                                                       : ExitCode::target_missed;
}

void add_render_surface(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<RenderArguments>();
  Command verb = root.add_verb("surface", "Render a scene under its own lights");
  verb.option("SCENE", &arguments->scene,
              "Scene file with a [camera] and lights; or glTF, .glb",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Picture to write: .exr linear, with standard error, albedo, normal and depth as "
              "further channels; .tif linear; .png for display",
              {.type = "PICTURE"});
  verb.option("--error", &arguments->error_picture,
              "Also write the standard error of each pixel, as a picture", {.type = "PICTURE"});
  add_exposure_option(verb, arguments->exposure);
  add_integrator_options(verb, arguments->integrator);
  verb.option("--spp", &arguments->samples,
              "Samples per pixel (default: 64, where no error or time is given)",
              {.bounds = Bounds{1, 1 << 20}});
  verb.option("--max-error", &arguments->max_error,
              "Samples until the picture's standard error, relative L2, is at most E",
              {.type = "E", .bounds = Bounds{1e-6, 1.0}});
  verb.option("--seconds", &arguments->seconds,
              "End after T seconds, with two samples per pixel at least",
              {.type = "T", .bounds = Bounds{0.01}});
  verb.option("--size", &arguments->size,
              "Picture size (default: the scene's [film], else its [camera])",
              {.type = "WxH", .bounds = Bounds{1, 1 << 16}, .delimiter = 'x', .count = 2});
  verb.option("--crop", &arguments->crop,
              "Only W x H pixels of the picture, from column X and row Y on: the same as there "
              "(default: the scene's [film], else all)",
              {.type = "WxH+X+Y"});
  verb.flag("--explain", &arguments->explains,
            "Tell what the scene requires, and what the rest would have cost; without -o or "
            "--film nothing else");
  add_film_options(verb, arguments->kept, "the samples' sums");
  verb.footer(
      "Examples:\n  haarlight render surface configs/scenes/cornell.toml -o cornell.png --spp "
      "16\n  haarlight render surface configs/scenes/balls.glb -o balls.exr --spp 16");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_surface(*arguments, common, report);
  });
}

}  // namespace

void add_render(Command root, Invocation& invocation) {
  Command render = root.add_verb("render", "Render a scene file under its own lights");
  render.require_verb();
  add_render_surface(render, invocation);
  add_render_join(render, invocation);
  add_render_smooth(render, invocation);
  add_render_soft_shadow(render, invocation);
  add_render_volume(render, invocation);
  render.footer("haarlight render VERB --help tells the options of each.");
}

}  // namespace haarlight::apps
