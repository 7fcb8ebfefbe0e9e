// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight develop SESSION`: raw frames to the light stack, and one EXR per light for
/// viewing.

#include <algorithm>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/develop_pipeline.h"

namespace haarlight::apps {

namespace {

struct DevelopArguments {
  relight::DevelopSessionOptions options;
  std::string demosaic = "bilinear";
  std::string transfer;
  std::vector<std::string> without;
  std::string flat;
  std::string flat_kind = "whole";
  std::string bad_pixels = "inpaint";
};

ExitCode run_develop(const DevelopArguments& arguments, const CommonOptions& common,
                     Report& report) {
  relight::DevelopSessionOptions options = arguments.options;
  options.demosaic = arguments.demosaic == "none"         ? session::Demosaic::none
                     : arguments.demosaic == "edge-aware" ? session::Demosaic::edge_aware
                                                          : session::Demosaic::bilinear;
  const auto has = [&](const char* step) {
    return std::find(arguments.without.begin(), arguments.without.end(), step) ==
           arguments.without.end();
  };
  session::RadiometryOptions& steps = options.radiometry;
  steps.has_dark = has("dark");
  steps.has_flat = has("flat");
  steps.has_drift = has("drift");
  steps.flat_session = arguments.flat;
  steps.flat =
      arguments.flat_kind == "fine" ? session::FlatKind::fine : session::FlatKind::whole;
  steps.bad_pixels =
      arguments.bad_pixels == "keep" ? session::BadPixels::keep : session::BadPixels::inpaint;
  options.unknown_as = transfer_requested(arguments.transfer);
  options.settings = pipeline_settings(common);
  const relight::DevelopSummary summary = relight::develop_session(options);
  relight::add_to_report(options, summary, report);
  return ExitCode::done;
}

}  // namespace

void add_develop(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<DevelopArguments>();
  relight::DevelopSessionOptions& options = arguments->options;
  Command verb = root.add_verb("develop", "Turn a session's raw frames into linear pictures");
  verb.option("SESSION", &options.session, "Session folder", {.is_required = true});
  verb.option("--demosaic", &arguments->demosaic, "How a Bayer mosaic becomes colour",
              {.choices = {"bilinear", "edge-aware", "none"}, .shows_default = true});
  verb.option("--exr", &options.exr, "Also write one OpenEXR picture per light here",
              {.type = "DIR"});
  verb.option("--cache", &options.cache,
              "Keep the result here instead of SESSION/cache (a read-only session)",
              {.type = "DIR"});
  add_transfer_option(verb, arguments->transfer);
  verb.option(
      "--plate", &options.plate,
      "Captures of several lights at once: the clean plate that distributes their light, "
      "a .hlb or a session of the empty rig; even: alike (default: computed from the rig)",
      {.type = "P.hlb|DIR|even"});
  verb.option("--without", &arguments->without, "Leave a step out (may be repeated)",
              {.type = "STEP", .choices = {"dark", "flat", "drift"}});
  verb.option("--flat", &arguments->flat,
              "Flat field from this session of an evenly lit target instead of its own",
              {.type = "DIR"});
  verb.option("--flat-kind", &arguments->flat_kind,
              "whole: the target was lit evenly; fine: only what is not smooth is sensitivity",
              {.choices = {"whole", "fine"}, .shows_default = true});
  verb.option("--bad-pixels", &arguments->bad_pixels,
              "Hot and dead pixels: the median of their neighbours, or as measured",
              {.choices = {"inpaint", "keep"}, .shows_default = true});
  verb.option("--max-drift", &options.radiometry.max_drift,
              "Refuse a session whose sentinel light drifts by more than this fraction",
              {.shows_default = true});
  verb.option("--max-level-error", &options.radiometry.max_level_error,
              "Refuse exposures whose levels contradict each other by more than this fraction",
              {.shows_default = true});
  verb.flag("--standard-error", &options.has_standard_error,
            "Also make the values' standard errors (with --exr: light_0000.error.exr); -1: "
            "clipped in every exposure. Of shots of several lights: their noise through the "
            "demultiplexing, not what the clean plate distributes wrongly");
  verb.footer(
      "Values are linear fractions of the camera's range per second at full drive and unit "
      "power.\n"
      "The result is a cache that compress and relight use; --force makes it again.\n"
      "Example:\n  haarlight develop door.session --exr door.exr/");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_develop(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
