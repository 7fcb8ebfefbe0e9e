// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight develop SESSION`: raw frames to the light stack, and one EXR per light for
/// viewing.

#include <algorithm>
#include <array>
#include <span>
#include <string_view>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/develop_pipeline.h"

namespace haarlight::apps {

namespace {

/// What --without leaves out.
enum class Step { dark, flat, drift };
constexpr auto kStepWords = std::to_array<std::string_view>({"dark", "flat", "drift"});
constexpr std::span<const std::string_view> words_of(Step) { return kStepWords; }

struct DevelopArguments {
  relight::DevelopSessionOptions options;
  std::vector<std::string> without;
  std::string flat;
};

ExitCode run_develop(const DevelopArguments& arguments, const CommonOptions& common,
                     Report& report) {
  relight::DevelopSessionOptions options = arguments.options;
  const auto has = [&](Step step) {
    return std::find(arguments.without.begin(), arguments.without.end(), to_string(step)) ==
           arguments.without.end();
  };
  session::RadiometryOptions& steps = options.radiometry;
  steps.has_dark = has(Step::dark);
  steps.has_flat = has(Step::flat);
  steps.has_drift = has(Step::drift);
  steps.flat_session = arguments.flat;
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
  verb.option("--demosaic", &options.demosaic, "How a Bayer mosaic becomes colour",
              {.shows_default = true});
  verb.option("--exr", &options.exr, "Also write one OpenEXR picture per light here",
              {.type = "DIR"});
  verb.option("--cache", &options.cache,
              "Keep the result here instead of SESSION/cache (a read-only session)",
              {.type = "DIR"});
  add_transfer_option(verb, options.unknown_as);
  verb.option(
      "--plate", &options.plate,
      "Captures of several lights at once: the clean plate that distributes their light, "
      "a .hlb or a session of the empty rig; even: alike (default: computed from the rig)",
      {.type = "P.hlb|DIR|even"});
  verb.option("--without", &arguments->without, "Leave a step out (may be repeated)",
              {.type = "STEP", .choices = choices_of<Step>()});
  verb.option("--flat", &arguments->flat,
              "Flat field from this session of an evenly lit target instead of its own",
              {.type = "DIR"});
  verb.option("--flat-kind", &options.radiometry.flat,
              "whole: the target was lit evenly; fine: only what is not smooth is sensitivity",
              {.shows_default = true});
  verb.option("--bad-pixels", &options.radiometry.bad_pixels,
              "Hot and dead pixels: the median of their neighbours, or as measured",
              {.shows_default = true});
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
