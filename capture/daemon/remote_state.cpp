// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/remote_state.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "capture/daemon/remote_json.h"

namespace haarlight::capture {

namespace {

using Json = nlohmann::json;

std::string text_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_string() ? json[key].get<std::string>()
                                                     : std::string();
}
int number_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_number() ? json[key].get<int>() : 0;
}

}  // namespace

RemoteState read_state(const DaemonReply& reply) {
  const Json json = parse_reply<Json>(reply);
  RemoteState state;
  state.phase = text_of(json, "phase");
  state.step = text_of(json, "step");
  state.session = text_of(json, "session");
  state.folder = text_of(json, "folder");
  state.reason = text_of(json, "reason");
  state.is_opening = json.value("is_opening", false);
  state.committed = number_of(json, "committed");
  state.shots = number_of(json, "shots");
  state.frames = number_of(json, "frames");
  state.retries = number_of(json, "retries");
  if (json.contains("seconds_left") && json["seconds_left"].is_number()) {
    state.seconds_left = json["seconds_left"].get<double>();
  }
  if (json.contains("unfinished") && json["unfinished"].is_array()) {
    for (const Json& id : json["unfinished"]) {
      if (id.is_string()) {
        state.unfinished.push_back(id.get<std::string>());
      }
    }
  }
  return state;
}

RemoteState ask_state(DaemonClient& client) { return read_state(client.get("/v1/state")); }

RemoteState request(DaemonClient& client, const std::string& name) {
  return read_state(client.post("/v1/" + name));
}

RemoteState reshoot(DaemonClient& client, const std::vector<int>& shots) {
  return read_state(client.post("/v1/reshoot", Json{{"shots", shots}}.dump()));
}

std::string state_text(const RemoteState& state) {
  std::string text = state.phase;
  if (!state.session.empty()) {
    text += fmt::format("  session {}  {} of {} shots committed", state.session,
                        state.committed, state.shots);
  }
  if (state.seconds_left && state.is_in(Phase::running)) {
    text += fmt::format("  {:.0f} s left", *state.seconds_left);
  }
  if (!state.reason.empty()) {
    text += fmt::format("  ({})", state.reason);
  }
  text += "\n";
  for (const std::string& id : state.unfinished) {
    text += fmt::format(
        "unfinished: {0}  (`haarlight capture --session {0}` goes on with it)\n", id);
  }
  return text;
}

}  // namespace haarlight::capture
