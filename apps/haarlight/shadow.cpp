// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight shadow BASIS --scene SCENE --cubemap ENV -o OUT`: the captured object's shadow on
/// another scene.

#include "apps/haarlight/options/captured_options.h"
#include "apps/haarlight/options/light_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/shadow_pipeline.h"

namespace haarlight::apps {

namespace {

struct ShadowArguments {
  CapturedArguments object;
  relight::ShadowOptions options;
  bool has_no_own_shadows = false;
};

ExitCode run_shadow(const ShadowArguments& arguments, const CommonOptions& common,
                    Report& report) {
  relight::ShadowOptions options = arguments.options;
  options.captured = captured_object(arguments.object, "shadow");
  options.hull_voxel_mm = arguments.object.voxel_mm;
  options.has_own_shadows = !arguments.has_no_own_shadows;
  options.settings = pipeline_settings(common);
  const relight::ShadowSummary summary = relight::cast_shadow(options);
  relight::add_to_report(options, summary, report);
  return ExitCode::done;
}

}  // namespace

void add_shadow(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ShadowArguments>();
  relight::ShadowOptions& options = arguments->options;
  Command verb = root.add_verb("shadow", "Cast the captured object's shadow on a scene");
  verb.option("--scene", &options.scene, "Scene that receives the shadow, and its camera",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &options.output, "Picture: .exr linear, .png for display",
              {.type = "OUT", .is_required = true});
  add_captured_options(verb, arguments->object);
  add_light_options(verb, options.light);
  verb.option(
      "--method", &options.method,
      "Where visibility comes from: plane (the shadow pictures alone), hull (the occluder "
      "carved from them), or both: the pictures where they are known, on and below the "
      "plane; elsewhere the hull",
      {.shows_default = true});
  verb.option("--window", &options.window,
              "What the shadow is averaged over: none, plain (the paper's), or corrected",
              {.shows_default = true});
  verb.option("--max-error", &options.max_error,
              "Relative L2 error of the light that the scene receives: blocks of lights are "
              "taken together (default: exact)",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option("--worst-point", &options.worst_point,
              "The same for the worst point, as a fraction of the brightest",
              {.bounds = Bounds{0.0, 1.0}});
  verb.flag("--with-object", &options.with_object,
            "Lay the relit object itself over the scene, seen by the capture's camera");
  verb.option("--plane-albedo", &options.plane_albedo,
              "What the captured plane reflects: brings the object to the scene's brightness",
              {.bounds = Bounds{0.001, 1.0}});
  verb.option(
      "--background", &options.background,
      "Show the environment where the camera looks past the scene, out of focus: the mean "
      "over a disc of this radius, degrees (0: sharp)",
      {.bounds = Bounds{0.0, 45.0}});
  verb.option("--size", &options.size, "Picture size (default: the scene's camera)",
              {.type = "WxH", .bounds = Bounds{1, 16384}, .delimiter = 'x', .count = 2});
  verb.option("--subpixels", &options.subpixels, "N x N samples per pixel",
              {.bounds = Bounds{1, 16}, .shows_default = true});
  verb.flag("--no-own-shadows", &arguments->has_no_own_shadows,
            "Leave out the shadows that the scene casts on itself");
  verb.option("--exposure", &options.exposure,
              "Factor before display (default for .png: unshadowed 99.5th percentile white)");
  verb.option(
      "--spread", &options.spread,
      "Also write how far the picture may be from the truth: because of what was not "
      "seen, of resolution and of noise (nine times the look-ups); with --truth: how often "
      "that holds",
      {.type = "OUT"});
  verb.option("--unseen", &options.unseen, "The same because of what was not seen alone",
              {.type = "OUT"});
  verb.option("--truth-object", &options.truth_object,
              "Scene of the object itself, where it is known", {.type = "SCENE.toml"});
  verb.option("--truth", &options.truth,
              "Also ray-trace that object's shadow, and measure the error against it",
              {.type = "OUT"});
  verb.option("--difference", &options.difference,
              "Also write the absolute difference to that truth, four times brighter",
              {.type = "OUT"});
  verb.footer(
      "Examples:\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml \\\n"
      "      --cubemap apartment.hdr --object-height 76,128 -o shadow.exr\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml --light 528 \\\n"
      "      --truth-object configs/scenes/airplane.toml --truth truth.png -o shadow.png\n"
      "  haarlight shadow airplane.hlb --scene configs/scenes/stairs.toml --max-error 0.01 \\\n"
      "      --cubemap apartment.hdr --with-object --plane-albedo 0.8 --background 1 \\\n"
      "      -o together.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shadow(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
