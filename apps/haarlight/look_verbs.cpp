// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight sessions|shot|preview`: what the page shows of a daemon, for the command.

#include <fmt/format.h>

#include "apps/haarlight/daemon_address.h"
#include "apps/haarlight/verb.h"
#include "capture/daemon/remote_look.h"
#include "haarlight/core/files.h"

namespace haarlight::apps {

namespace {

struct LookArguments {
  DaemonAddress address;
  std::string session;
  std::string output;
  capture::PreviewOptions preview;
  int shot = 0;
};

ExitCode run_sessions(const LookArguments& arguments) {
  capture::DaemonClient client(client_config(arguments.address));
  for (const capture::RemoteSession& session : capture::list_sessions(client)) {
    fmt::print("{}  {}  {}\n", session.id, session.state, session.folder);
  }
  return ExitCode::done;
}

ExitCode run_shot(const LookArguments& arguments, const CommonOptions& common, Report& report) {
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  capture::DaemonClient client(client_config(arguments.address));
  const capture::ShotStory story =
      capture::tell_shot(client, arguments.session, arguments.shot);
  fmt::print("{}", story.text);
  report.add_detail("mark", story.mark);
  if (!arguments.output.empty()) {
    const std::string picture = capture::frame_picture(client, story);
    write_file_atomically(arguments.output, picture);
    report.set_bytes(picture.size());
  }
  return ExitCode::done;
}

ExitCode run_preview(const LookArguments& arguments, const CommonOptions& common,
                     Report& report) {
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  capture::DaemonClient client(client_config(arguments.address));
  capture::light_preview(client, arguments.preview);
  fmt::print("lit for a minute; `haarlight abort` turns it off\n");
  if (!arguments.output.empty()) {
    const std::string picture = capture::preview_picture(client);
    write_file_atomically(arguments.output, picture);
    report.set_bytes(picture.size());
  }
  return ExitCode::done;
}

}  // namespace

void add_sessions(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<LookArguments>();
  Command verb = root.add_verb("sessions", "List the daemon's sessions");
  add_daemon_options(verb, arguments->address);
  verb.footer("Example:\n  haarlight sessions");
  finish_verb(verb, invocation,
              [arguments](const CommonOptions&, Report&) { return run_sessions(*arguments); });
}

void add_shot(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<LookArguments>();
  Command verb = root.add_verb("shot", "Say in words what proves a shot's frame");
  verb.option("SHOT", &arguments->shot, "Number of the shot",
              {.type = "N", .bounds = Bounds{0, 1e6}, .is_required = true});
  verb.option("--session", &arguments->session, "Of this session (default: the present one)",
              {.type = "ID"});
  verb.option("-o", &arguments->output, "Write the frame, small, clipping marked",
              {.type = "FRAME.png"});
  add_daemon_options(verb, arguments->address);
  verb.footer(
      "Red is saturated, blue at or below black.\n"
      "Example:\n  haarlight shot 17 -o shot17.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shot(*arguments, common, report);
  });
}

void add_preview(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<LookArguments>();
  Command verb =
      root.add_verb("preview", "Light some lights for aiming and focusing; store nothing");
  verb.option("LIGHTS", &arguments->preview.lights, "Numbers of lights",
              {.type = "N...", .is_required = true});
  verb.option("--level", &arguments->preview.level_percent, "Drive level, percent of full",
              {.bounds = Bounds{0, 100}, .shows_default = true});
  verb.option("--exposure-us", &arguments->preview.exposure_us,
              "Exposure (default: the rig file's)", {.bounds = Bounds{1, 1e9}});
  verb.option("-o", &arguments->output, "Write what the camera sees, clipping marked",
              {.type = "FRAME.png"});
  add_daemon_options(verb, arguments->address);
  verb.footer(
      "`haarlight abort` turns the light off; by itself it goes off after a minute.\n"
      "Example:\n  haarlight preview 528 --level 50 -o focus.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_preview(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
