// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight view FILE`: serves the page that relights in the browser, or turns a volume.

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>

#include <fmt/format.h>

#include "apps/haarlight/end_signals.h"
#include "apps/haarlight/file_kind.h"
#include "apps/haarlight/options/captured_options.h"
#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "apps/page_folder.h"
#include "apps/viewer/reflectance_site.h"
#include "apps/viewer/viewer_site.h"
#include "apps/viewer/volume_site.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "http/server.h"

namespace haarlight::apps {

namespace {

struct ViewArguments {
  std::string file;
  CapturedArguments object;
  std::string web;
  int port = 0;
};

bool is_volume(const std::string& file) {
  return has_ending(file, ".toml") && recognise_file(file) == FileKind::volume;
}

void refuse_hull_options(const std::vector<std::string>& given, const char* what,
                         const std::string& file) {
  if (!given.empty()) {
    throw Error(fmt::format("{} has no shadow hull", what), file,
                fmt::format("leave out {}", given.front()), ExitCode::usage);
  }
}

/// What the file's page needs: of a basis file, a picture that is lit by direction, or the scene of a
/// volume.
http::HttpSite site_of(const ViewArguments& arguments, const ViewerConfig& config,
                       const CommonOptions& common) {
  const std::string& file = arguments.file;
  const std::vector<std::string> hull_options = hull_words(arguments.object);
  if (relight::recognise_reflectance(file)) {
    refuse_hull_options(hull_options, "a picture lit by direction", file);
    return reflectance_site(
        std::make_shared<const relight::ReflectanceModel>(
            relight::read_reflectance(file, {.most_bytes = common.memory_bytes})),
        std::filesystem::path(file).filename().string(), config);
  }
  if (is_volume(file)) {
    refuse_hull_options(hull_options, "a volume", file);
    return volume_site(file, common.memory_bytes, config);
  }
  refuse_step_before(file, "view");
  const auto basis = std::make_shared<const relight::BasisFile>(relight::BasisFile::open(file));
  HullRequest request;
  request.captured = arguments.object.captured;
  request.captured.basis = file;
  if (!arguments.object.height.empty()) {
    request.captured.height =
        relight::HeightRange{arguments.object.height[0], arguments.object.height[1]};
  }
  relight::require_heights(request.captured);
  request.voxel_mm = arguments.object.voxel_mm;
  request.options = hull_options;
  request.settings.memory_bytes = common.memory_bytes;
  const auto hull = std::make_shared<HullCache>(std::move(request));
  if (const auto problem = hull->look().problem; problem && !hull_options.empty()) {
    throw Error(*problem);
  }
  return viewer_site(basis, std::make_shared<EnvironmentCache>(*basis), hull, config);
}

ExitCode run_view(const ViewArguments& arguments, const CommonOptions& common, Report& report) {
  report.add_input(arguments.file);
  const EndSignals signals;
  (void)std::signal(SIGPIPE, SIG_IGN);  // a browser that goes away
  ViewerConfig config;
  config.web_folder =
      arguments.web.empty() ? find_page_folder() : std::filesystem::path(arguments.web);
  if (config.web_folder.empty()) {
    throw Error("the folder of the page's files is missing", "haarlight view",
                "install the program whole, or name the folder with --web", ExitCode::io);
  }
  config.texture_bytes = std::min(config.texture_bytes, common.memory_bytes / 4);
  http::HttpServerConfig http;
  http.port = arguments.port;
  if (!is_volume(arguments.file)) {
    http.max_body_bytes = kMostEnvironmentBytes;
  }
  const http::HttpServer server(http, site_of(arguments, config, common));
  fmt::print("{} on http://127.0.0.1:{}/  (Ctrl-C ends it)\n", arguments.file, server.port());
  std::fflush(stdout);
  signals.wait();
  report.add_detail("requests", static_cast<std::int64_t>(server.counters().requests));
  return ExitCode::done;
}

}  // namespace

void add_view(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ViewArguments>();
  Command verb = root.add_verb("view", "Relight, or turn a volume, in the browser");
  verb.option(
      "FILE", &arguments->file,
      "Basis file; picture lit by direction: .ptm, .rti, folder with info.json; or the scene "
      "of a volume: .toml",
      {.type = "FILE", .is_required = true});
  verb.option("--port", &arguments->port, "Port on 127.0.0.1 (default: any free one)",
              {.bounds = Bounds{0, 65535}});
  verb.option("--web", &arguments->web,
              "Folder of the pages (default: the one installed with the program)",
              {.type = "DIR"});
  add_hull_options(verb, arguments->object);
  verb.footer(
      "Prints the page's address and serves it until Ctrl-C. --memory: the page loads at most "
      "a\n"
      "quarter of it, and at most 1 GB. --voxel to --mask: of the object's hull, which casts\n"
      "the shadow on a receiver; as for haarlight hull.\n"
      "Example:\n  haarlight view airplane.hlb --port 8481\n"
      "  haarlight view configs/volumes/cube.toml");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_view(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
