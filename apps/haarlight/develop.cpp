/// @file
/// `haarlight develop SESSION`: raw frames to the light stack, and one EXR a light for people.

#include "session/develop.h"

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/image_io.h"
#include "relight/basis/compress_session.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

struct DevelopArguments {
  std::string session;
  std::string demosaic = "bilinear";
  std::string exr;
  std::string cache;
  std::string transfer;
  std::string plate;
};

std::uint64_t write_pictures(const LightStack& stack, const fs::path& folder, bool force,
                             ProgressStyle style) {
  require_absent(folder, force);
  fs::create_directories(folder);
  Progress progress("write EXR", static_cast<std::size_t>(stack.shape().n_lights), style);
  std::uint64_t bytes = 0;
  for (int k = 0; k < stack.shape().n_lights; ++k) {
    const fs::path file = folder / fmt::format("light_{:04}.exr", k);
    write_image(file, stack.light_image(k).view());
    bytes += fs::file_size(file);
    progress.advance();
  }
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
  if (!arguments.transfer.empty()) {
    options.unknown_as = arguments.transfer == "srgb" ? Transfer::srgb : Transfer::linear;
  }
  if (arguments.demosaic != "bilinear") {
    options.demosaic = arguments.demosaic == "none" ? Demosaic::none : Demosaic::edge_aware;
  }
  const Session session = Session::open(arguments.session);
  options.share_evenly = arguments.plate == "even";
  if (!options.share_evenly) {
    options.plate = sharing_plate(session, PlateChoice::parse(arguments.plate));
  }
  const LightStack stack = develop(session, options);
  const StackShape& shape = stack.shape();
  std::uint64_t bytes = sizeof(float) * static_cast<std::uint64_t>(shape.width) *
                        static_cast<std::uint64_t>(shape.height) *
                        static_cast<std::uint64_t>(shape.channels) *
                        static_cast<std::uint64_t>(shape.n_lights);
  report.add_reached("lights", std::int64_t{shape.n_lights});
  report.add_reached("bands", std::int64_t{shape.n_bands()});
  if (!arguments.exr.empty()) {
    bytes += write_pictures(stack, arguments.exr, common.force, options.progress);
  }
  report.set_bytes(bytes);
  fmt::print("{}: {} x {} x {} under {} lights, {} bands\n", arguments.session, shape.width,
             shape.height, shape.channels, shape.n_lights, shape.n_bands());
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
  verb.option(
      "--transfer", &arguments->transfer,
      "What stands in for the unknown curve of a camera's YUYV or NV12 (default: refuse)",
      {.choices = {"srgb", "linear"}});
  verb.option(
      "--plate", &arguments->plate,
      "Captures of several lights at once: the clean plate that shares their light out, "
      "a .hlb or a session of the empty rig; even: alike (default: computed from the rig)",
      {.type = "P.hlb|DIR|even"});
  verb.footer(
      "Values are linear shares of the camera's range a second at full drive and unit power.\n"
      "The result is a cache that compress and relight use; --force makes it again.\n"
      "Example:\n  haarlight develop door.session --exr door.exr/");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_develop(*arguments, common, report);
  });
}

}  // namespace haarlight
