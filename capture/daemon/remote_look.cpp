// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/remote_look.h"

#include <chrono>
#include <cmath>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "capture/daemon/remote_json.h"
#include "capture/daemon/remote_state.h"
#include "core/counted.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{100};
constexpr int kPreviewPolls = 300;  // a camera that opens slowly takes seconds
constexpr double kFullLevel = 65535.0;

/// The named session, or the daemon's current one. @throws Error  there is none
std::string session_of(DaemonClient& client, const std::string& session) {
  if (!session.empty()) {
    return session;
  }
  const Json state = parse_reply<Json>(client.get("/v1/state"));
  if (!state.contains("session") || !state["session"].is_string()) {
    throw Error("the daemon has had no session since its start", "haarlight shot",
                "name one with --session; `haarlight sessions` lists them",
                ExitCode::interrupted);
  }
  return state["session"].get<std::string>();
}

std::string text_of(const Json& story) {
  std::string text =
      fmt::format("shot {}: {}, {}\n", story.value("shot", 0), story.value("kind", ""),
                  counted(story.at("lights").size(), "light"));
  if (story.contains("problem")) {
    text += fmt::format("the last try failed: {}\n", story.value("problem", ""));
  }
  if (!story.contains("words")) {
    return text + "no frame yet\n";
  }
  const std::string doubt = story.value("doubt", "");
  text += fmt::format("{}, attempt {}, {}\n", doubt.empty() ? "good" : "look at it: " + doubt,
                      story.value("attempt", 0) + 1, story.value("file", ""));
  for (const Json& sentence : story.at("words")) {
    text += fmt::format("- {}\n", sentence.get<std::string>());
  }
  return text;
}

}  // namespace

std::vector<RemoteSession> list_sessions(DaemonClient& client) {
  const Json reply = parse_reply<Json>(client.get("/v1/sessions"));
  std::vector<RemoteSession> sessions;
  for (const Json& session : reply.at("sessions")) {
    const char* state = session.value("is_active", false)     ? "active"
                        : session.value("is_finished", false) ? "finished"
                        : session.value("is_aborted", false)  ? "aborted"
                                                              : "unfinished";
    sessions.push_back({session.value("id", ""), state, session.value("folder", "")});
  }
  return sessions;
}

ShotStory tell_shot(DaemonClient& client, const std::string& session, int shot) {
  ShotStory told;
  told.path = fmt::format("/v1/sessions/{}/shots/{}",
                          DaemonClient::escape(session_of(client, session)), shot);
  const Json story = parse_reply<Json>(client.get(told.path + "/story"));
  told.text = text_of(story);
  told.mark = story.value("mark", "");
  return told;
}

std::string frame_picture(DaemonClient& client, const ShotStory& story) {
  DaemonReply picture = client.get(story.path + "/frame.png");
  DaemonClient::require_good(picture);
  return std::move(picture.body);
}

void light_preview(DaemonClient& client, const PreviewOptions& options) {
  Json body = {{"lights", options.lights},
               {"level", std::lround(kFullLevel * options.level_percent / 100.0)}};
  if (options.exposure_us > 0.0) {
    body["exposure_us"] = options.exposure_us;
  }
  RemoteState state = read_state(client.post("/v1/preview", body.dump()));
  // The state's "collect": the light has settled, and frames arrive.
  for (int i = 0; i < kPreviewPolls && !state.is_at(ShotStep::collect); ++i) {
    std::this_thread::sleep_for(kPoll);
    state = ask_state(client);
    if (state.is_in(Phase::idle)) {
      throw Error("the light went out again: " + state.reason, "haarlightd",
                  "ask `haarlight status`", ExitCode::interrupted);
    }
  }
  if (!state.is_at(ShotStep::collect)) {
    throw Error("the light does not come on: " + state.reason, "haarlightd",
                "check camera and controller: `haarlight status`", ExitCode::unavailable);
  }
}

std::string preview_picture(DaemonClient& client) {
  // The first request makes the daemon copy a frame; a slow camera's comes later.
  DaemonReply picture = client.get("/v1/preview.png");
  for (int i = 0; i < kPreviewPolls && picture.status == 404; ++i) {
    std::this_thread::sleep_for(kPoll);
    picture = client.get("/v1/preview.png");
  }
  DaemonClient::require_good(picture);
  return std::move(picture.body);
}

}  // namespace haarlight::capture
