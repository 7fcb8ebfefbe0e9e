// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight develop SESSION`: raw frames to the light stack, and one EXR a light for people.

#include "session/develop/develop.h"

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/develop_options.h"
#include "apps/haarlight/picture_notes.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/picture/image_io.h"
#include "relight/basis/compress_session.h"
#include "relight/light/near_light.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

constexpr double kMuchMoved = 1e-3;  // of the values: noise alone gives 1e-8

struct DevelopArguments {
  std::string session;
  std::string demosaic = "bilinear";
  std::string exr;
  std::string cache;
  std::string transfer;
  std::string plate;
  std::vector<std::string> without;
  std::string flat;
  std::string flat_kind = "whole";
  std::string bad_pixels = "inpaint";
  double max_drift = 0.25;
  double max_level_error = 0.1;
  bool has_standard_error = false;
};

/// One EXR a light; with standard errors light_0000.error.exr beside it.
std::uint64_t write_pictures(const Session& session, const LightStack& stack,
                             const std::string& ending, const fs::path& folder,
                             const CommonOptions& common) {
  fs::create_directories(folder);
  Progress progress("write EXR", static_cast<std::size_t>(stack.dims().n_lights),
                    common.progress());
  std::uint64_t bytes = 0;
  const std::vector<SessionLight> seen = lights_in_picture(session);
  for_each_light_image(stack, common.memory_bytes / 2, [&](int k, const Image<float>& picture) {
    const fs::path file = folder / fmt::format("light_{:04}{}.exr", k, ending);
    PictureNotes notes = notes_of(session.info());
    add_light(session.info(), k, notes);
    if (ending.empty()) {  // standard errors are no light's picture
      add_seen_light(session.info(), seen, k, notes);
    }
    write_image(file, picture.view(), 1.0, notes);
    bytes += fs::file_size(file);
    progress.advance();
  });
  return bytes;
}

ExitCode run_develop(const DevelopArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.session);
  report.add_asked("demosaic", arguments.demosaic);
  report.add_asked("memory_bytes", static_cast<std::int64_t>(common.memory_bytes));
  DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  options.use_cache = !common.force;
  options.cache_folder = arguments.cache;
  options.unknown_as = transfer_asked(arguments.transfer);
  if (arguments.demosaic != "bilinear") {
    options.demosaic = arguments.demosaic == "none" ? Demosaic::none : Demosaic::edge_aware;
  }
  RadiometryOptions& steps = options.radiometry;
  const auto is_left_out = [&](const char* step) {
    return std::find(arguments.without.begin(), arguments.without.end(), step) !=
           arguments.without.end();
  };
  steps.has_dark = !is_left_out("dark");
  steps.has_flat = !is_left_out("flat");
  steps.has_drift = !is_left_out("drift");
  steps.flat_session = arguments.flat;
  steps.flat = arguments.flat_kind == "fine" ? FlatKind::fine : FlatKind::whole;
  steps.bad_pixels = arguments.bad_pixels == "keep" ? BadPixels::keep : BadPixels::inpaint;
  steps.max_drift = arguments.max_drift;
  steps.max_level_error = arguments.max_level_error;
  options.has_standard_error = arguments.has_standard_error;
  const Session session = Session::open(arguments.session);
  options.share_evenly = arguments.plate == "even";
  if (!options.share_evenly) {
    options.plate = sharing_plate(session, PlateChoice::parse(arguments.plate));
  }
  const Developed developed = develop_all(session, options);
  const LightStack& stack = developed.stack;
  const StackDims shape = stack.dims();
  std::uint64_t bytes = sizeof(float) * static_cast<std::uint64_t>(shape.width) *
                        static_cast<std::uint64_t>(shape.height) *
                        static_cast<std::uint64_t>(shape.channels) *
                        static_cast<std::uint64_t>(shape.n_lights);
  report.add_reached("lights", std::int64_t{shape.n_lights});
  report.add_reached("bands", std::int64_t{stack.bands().n()});
  if (!arguments.exr.empty()) {
    require_absent(arguments.exr, common.force);
    bytes += write_pictures(session, stack, "", arguments.exr, common);
    if (developed.standard_error) {
      bytes +=
          write_pictures(session, *developed.standard_error, ".error", arguments.exr, common);
    }
  }
  report.add_reached("saturated_in_all", static_cast<std::int64_t>(developed.n_saturated));
  report.add_reached("moved_share", developed.moved_share);
  report.add_detail("steps", developed.record);
  report.set_bytes(bytes);
  fmt::print("{}: {} x {} x {} under {} lights, {} band{}\n", arguments.session, shape.width,
             shape.height, shape.channels, shape.n_lights, stack.bands().n(),
             stack.bands().n() == 1 ? "" : "s");
  fmt::print("  kept in {} for compress, relight and the others{}\n",
             arguments.cache.empty() ? (session.folder() / "cache").string() : arguments.cache,
             arguments.exr.empty() ? "; --exr DIR writes pictures" : "");
  if (developed.n_saturated > 0) {
    fmt::print("{} values are clipped in every exposure: lower bounds, not measurements\n",
               developed.n_saturated);
  }
  if (developed.moved_share > kMuchMoved) {
    fmt::print(
        "{:.2g} of the compared values contradict each other between exposures: did "
        "something move?\n",
        developed.moved_share);
  }
  return ExitCode::done;
}

}  // namespace

void add_develop(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<DevelopArguments>();
  Command verb = root.add_verb("develop", "Turn a session's raw frames into linear pictures");
  verb.option("SESSION", &arguments->session, "Session folder", {.is_required = true});
  verb.option("--demosaic", &arguments->demosaic, "How a Bayer mosaic becomes colour",
              {.choices = {"bilinear", "edge-aware", "none"}, .shows_default = true});
  verb.option("--exr", &arguments->exr, "Also write one OpenEXR picture a light here",
              {.type = "DIR"});
  verb.option("--cache", &arguments->cache,
              "Keep the result here instead of SESSION/cache (a read-only session)",
              {.type = "DIR"});
  add_transfer_option(verb, arguments->transfer);
  verb.option(
      "--plate", &arguments->plate,
      "Captures of several lights at once: the clean plate that shares their light out, "
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
  verb.option("--max-drift", &arguments->max_drift,
              "Refuse a session whose sentinel light drifts by more than this share",
              {.shows_default = true});
  verb.option("--max-level-error", &arguments->max_level_error,
              "Refuse exposures whose levels contradict each other by more than this share",
              {.shows_default = true});
  verb.flag("--standard-error", &arguments->has_standard_error,
            "Also make the values' standard errors (with --exr: light_0000.error.exr); -1: "
            "clipped in every exposure. Of shots of several lights: their noise through the "
            "demultiplexing, not what the plate shares out wrongly");
  verb.footer(
      "Values are linear shares of the camera's range a second at full drive and unit power.\n"
      "The result is a cache that compress and relight use; --force makes it again.\n"
      "Example:\n  haarlight develop door.session --exr door.exr/");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_develop(*arguments, common, report);
  });
}

}  // namespace haarlight
