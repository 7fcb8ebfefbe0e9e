// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight sessions|shot|preview`: what the page shows of a daemon, for the command.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/haarlight/daemon_address.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/text_limits.h"

namespace haarlight {

namespace {

using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{100};
constexpr int kPreviewPolls = 300;  // a camera that opens slowly takes seconds
constexpr double kFullLevel = 65535.0;

struct LookArguments {
  DaemonAddress address;
  std::string session;
  std::string output;
  std::vector<int> lights;
  int shot = 0;
  double level_percent = 100.0;
  double exposure_us = 0.0;
};

/// @throws Error  what the daemon's error says, or no JSON
Json parse_reply(const DaemonReply& reply) {
  DaemonClient::require_good(reply);
  Json json = parse_json<Json>(reply.body, "haarlightd");
  if (!json.is_object()) {
    refuse_answer();
  }
  return json;
}

ExitCode run_sessions(const LookArguments& arguments) {
  DaemonClient client(client_config(arguments.address));
  const Json reply = parse_reply(client.get("/v1/sessions"));
  for (const Json& session : reply.at("sessions")) {
    fmt::print("{}  {}  {}\n", session.value("id", ""),
               session.value("is_active", false)     ? "active"
               : session.value("is_finished", false) ? "finished"
               : session.value("is_aborted", false)  ? "aborted"
                                                     : "unfinished",
               session.value("folder", ""));
  }
  return ExitCode::done;
}

/// The session named, or the daemon's present one. @throws Error  there is none
std::string session_of(DaemonClient& client, const LookArguments& arguments) {
  if (!arguments.session.empty()) {
    return arguments.session;
  }
  const Json state = parse_reply(client.get("/v1/state"));
  if (!state.contains("session") || !state["session"].is_string()) {
    throw Error("the daemon has had no session since its start", "haarlight shot",
                "name one with --session; `haarlight sessions` lists them",
                ExitCode::interrupted);
  }
  return state["session"].get<std::string>();
}

void print_story(const Json& story) {
  fmt::print("shot {}: {}, {} light{}\n", story.value("shot", 0), story.value("kind", ""),
             story.at("lights").size(), story.at("lights").size() == 1 ? "" : "s");
  if (story.contains("problem")) {
    fmt::print("the last try failed: {}\n", story.value("problem", ""));
  }
  if (!story.contains("words")) {
    fmt::print("no frame yet\n");
    return;
  }
  const std::string doubt = story.value("doubt", "");
  fmt::print("{}, attempt {}, {}\n", doubt.empty() ? "good" : "look at it: " + doubt,
             story.value("attempt", 0) + 1, story.value("file", ""));
  for (const Json& sentence : story.at("words")) {
    fmt::print("- {}\n", sentence.get<std::string>());
  }
}

ExitCode run_shot(const LookArguments& arguments, const CommonOptions& common, Report& report) {
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  DaemonClient client(client_config(arguments.address));
  const std::string path =
      fmt::format("/v1/sessions/{}/shots/{}",
                  DaemonClient::escape(session_of(client, arguments)), arguments.shot);
  const Json story = parse_reply(client.get(path + "/story"));
  print_story(story);
  report.add_detail("mark", story.value("mark", ""));
  if (!arguments.output.empty()) {
    const DaemonReply picture = client.get(path + "/frame.png");
    DaemonClient::require_good(picture);
    write_file_atomically(arguments.output, std::string_view(picture.body));
    report.set_bytes(picture.body.size());
  }
  return ExitCode::done;
}

ExitCode run_preview(const LookArguments& arguments, const CommonOptions& common,
                     Report& report) {
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  DaemonClient client(client_config(arguments.address));
  Json body = {{"lights", arguments.lights},
               {"level", std::lround(kFullLevel * arguments.level_percent / 100.0)}};
  if (arguments.exposure_us > 0.0) {
    body["exposure_us"] = arguments.exposure_us;
  }
  Json state = parse_reply(client.post("/v1/preview", body.dump()));
  // The state's "collect": the light stands, and frames come.
  for (int i = 0; i < kPreviewPolls && state.value("step", "") != "collect"; ++i) {
    std::this_thread::sleep_for(kPoll);
    state = parse_reply(client.get("/v1/state"));
    if (state.value("phase", "") == "idle") {
      throw Error("the light went out again: " + state.value("reason", ""), "haarlightd",
                  "ask `haarlight status`", ExitCode::interrupted);
    }
  }
  if (state.value("step", "") != "collect") {
    throw Error("the light does not come on: " + state.value("reason", ""), "haarlightd",
                "check camera and controller: `haarlight status`", ExitCode::unavailable);
  }
  fmt::print("lit for a minute; `haarlight abort` puts it out\n");
  if (!arguments.output.empty()) {
    // The first look makes the daemon copy a frame; a slow camera's comes later.
    DaemonReply picture = client.get("/v1/preview.png");
    for (int i = 0; i < kPreviewPolls && picture.status == 404; ++i) {
      std::this_thread::sleep_for(kPoll);
      picture = client.get("/v1/preview.png");
    }
    DaemonClient::require_good(picture);
    write_file_atomically(arguments.output, std::string_view(picture.body));
    report.set_bytes(picture.body.size());
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
  verb.option("LIGHTS", &arguments->lights, "Numbers of lights",
              {.type = "N...", .is_required = true});
  verb.option("--level", &arguments->level_percent, "Drive, percent of full",
              {.bounds = Bounds{0, 100}, .shows_default = true});
  verb.option("--exposure-us", &arguments->exposure_us, "Exposure (default: the rig file's)",
              {.bounds = Bounds{1, 1e9}});
  verb.option("-o", &arguments->output, "Write what the camera sees, clipping marked",
              {.type = "FRAME.png"});
  add_daemon_options(verb, arguments->address);
  verb.footer(
      "The light goes out by `haarlight abort`, or by itself after a minute.\n"
      "Example:\n  haarlight preview 528 --level 50 -o focus.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_preview(*arguments, common, report);
  });
}

}  // namespace haarlight
