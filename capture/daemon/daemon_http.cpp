// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/daemon_http.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "capture/daemon/daemon.h"
#include "capture/daemon/daemon_page.h"
#include "core/report.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/evidence.h"
#include "session/frame_tiff.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr std::size_t kMaxListed = 20;
constexpr std::size_t kMaxPreviewLights = 100000;
constexpr std::uintmax_t kMaxFrameFile = std::uintmax_t{1} << 28U;

http::HttpResponse json_response(const Json& json, int status = 200) {
  return {.status = status,
          .body = json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n"};
}

http::HttpResponse missing(const std::string& what, const std::string& hint) {
  return http::error_response(404, what, "the request's path", hint);
}

std::optional<int> whole_number(const std::string& text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || value < 0) {
    return std::nullopt;
  }
  return value;
}

/// The body as JSON; an empty one is an empty object. @throws Error
Json body_of(const http::HttpRequest& request) {
  if (request.body.find_first_not_of(" \t\r\n") == std::string::npos) {
    return Json::object();
  }
  Json json = parse_json<Json>(request.body, request.path);
  if (!json.is_object()) {
    throw Error("the body is not a JSON object", request.path,
                "see docs/reference/http-api.md");
  }
  return json;
}

/// The state is reported on the HTTP thread: no list in it may grow with a session.
std::vector<std::string> first_of(const std::vector<std::string>& list) {
  return {list.begin(),
          list.begin() + static_cast<std::ptrdiff_t>(std::min(list.size(), kMaxListed))};
}

Json state_json(const DaemonState& s) {
  Json reasons = Json::array();
  constexpr std::array<std::pair<std::uint32_t, const char*>, 7> kReasons{
      {{kCameraLost, "camera"},
       {kControllerLost, "controller"},
       {kDiskFull, "disk"},
       {kNoEvidence, "no_clean_frame"},
       {kHeldBack, "held_back"},
       {kFolderGone, "session_folder"},
       {kWrongLight, "wrong_light"}}};
  for (const auto& [bit, word] : kReasons) {
    if ((s.reasons & bit) != 0) {
      reasons.push_back(word);
    }
  }
  Json json = {
      {"version", std::string(kVersion)},
      {"phase", std::string(to_string(s.phase))},
      {"step", std::string(to_string(s.step))},
      {"lights", s.lights == LightsKnown::off  ? "off"
                 : s.lights == LightsKnown::on ? "on"
                                               : "unknown"},
      {"is_opening", s.is_opening},
      {"is_preview", s.is_preview},
      {"reasons", std::move(reasons)},
      {"reason", s.reason_text},
      {"session", s.session.empty() ? Json(nullptr) : Json(s.session)},
      {"folder", s.session.empty() ? Json(nullptr) : Json(s.folder.string())},
      {"plan", s.plan == nullptr ? Json(nullptr)
                                 : Json{{"name", s.plan->name}, {"hash", s.plan->hash}}},
      {"shots", s.n_shots},
      {"committed", s.n_committed},
      {"current", s.current < 0 ? Json(nullptr) : Json(s.current)},
      {"seconds_left", s.seconds_left < 0 ? Json(nullptr) : Json(s.seconds_left)},
      {"frames", s.counters.frames},
      {"retries", s.counters.retries}};
  if (s.recovery) {
    json["recovery"] = {{"committed", s.recovery->n_committed},
                        {"adopted", s.recovery->n_adopted},
                        {"returned", s.recovery->n_returned},
                        {"set_aside", first_of(s.recovery->set_aside)},
                        {"n_set_aside", s.recovery->set_aside.size()}};
  }
  if (!s.unfinished.empty()) {
    json["unfinished"] = first_of(s.unfinished);
  }
  return json;
}

Json session_json(const fs::path& folder, const DaemonState& state) {
  std::error_code ignored;
  return {{"id", folder.filename().string()},
          {"folder", folder.string()},
          {"is_finished", fs::exists(folder / "session.json", ignored)},
          {"is_aborted", fs::exists(folder / "aborted.txt", ignored)},
          {"is_active", folder.filename() == state.session && state.phase != Phase::idle &&
                            state.phase != Phase::done}};
}

http::HttpResponse list_sessions(const fs::path& sessions, const DaemonState& state,
                                 const http::HttpRequest& request) {
  std::vector<fs::path> folders;
  std::error_code error;
  for (fs::directory_iterator it(sessions, error), end; !error && it != end;
       it.increment(error)) {
    std::error_code ignored;
    if (fs::exists(it->path() / "start.json", ignored) ||
        fs::exists(it->path() / "session.json", ignored)) {
      folders.push_back(it->path());
    }
  }
  std::sort(folders.begin(), folders.end());
  Json list = Json::array();
  const http::PageOfList page = http::page_of(request, folders.size());
  for (std::size_t i = page.first; i < page.end; ++i) {
    list.push_back(session_json(folders[i], state));
  }
  return json_response({{"sessions", std::move(list)}, {"count", folders.size()}});
}

/// The newest attempt of a shot that is on the disk.
std::optional<fs::path> newest_frame(const fs::path& session, int shot) {
  std::optional<fs::path> found;
  int newest = -1;
  std::error_code ignored;
  for (int attempt = 0; attempt < newest + 33; ++attempt) {
    fs::path file = session / session::frame_file_name(shot, attempt);
    if (fs::exists(file, ignored)) {
      newest = attempt;
      found = std::move(file);
    }
  }
  return found;
}

class Handlers {
 public:
  Handlers(Daemon& daemon, fs::path sessions)
      : daemon_(daemon), sessions_(std::move(sessions)) {}

  [[nodiscard]] http::HttpResponse health() const {
    const std::string hanging = daemon_.hanging_thread();
    if (!hanging.empty()) {
      return http::error_response(503, "the " + hanging + " thread hangs", "healthz",
                                  "the service manager restarts the daemon");
    }
    return json_response({{"status", "good"}});
  }

  [[nodiscard]] http::HttpResponse session(const http::HttpRequest& request) const {
    const auto folder = folder_of(request);
    if (!folder) {
      return missing("no such session", "GET /v1/sessions lists them");
    }
    const DaemonState state = daemon_.state();
    Json json = session_json(*folder, state);
    if (state.session == folder->filename() && state.plan != nullptr) {
      json["shots"] = state.n_shots;
      json["committed"] = state.n_committed;
      json["plan_hash"] = state.plan->hash;
    } else {
      const session::SessionInfo info = info_of(*folder);
      json["shots"] = info.shots.size();
      json["committed"] = info.frames.size();
      json["plan_hash"] = info.plan_hash;
    }
    return json_response(json);
  }

  [[nodiscard]] http::HttpResponse shots(const http::HttpRequest& request) const {
    const auto folder = folder_of(request);
    if (!folder) {
      return missing("no such session", "GET /v1/sessions lists them");
    }
    const DaemonState state = daemon_.state();
    const Plan* const plan = state.session == folder->filename() ? state.plan.get() : nullptr;
    const bool is_active = plan != nullptr;
    const session::SessionInfo info = is_active ? session::SessionInfo{} : info_of(*folder);
    const std::vector<session::Shot>& shots = plan != nullptr ? plan->shots : info.shots;
    const std::vector<ShotState> states =
        is_active ? daemon_.shot_states() : std::vector<ShotState>();
    const http::PageOfList page = http::page_of(request, shots.size());
    Json list = Json::array();
    for (std::size_t i = page.first; i < page.end; ++i) {
      const session::Shot& shot = shots[i];
      Json lit = Json::array();
      for (const session::LightLevel& light : shot.lit) {
        lit.push_back(light.light);
      }
      list.push_back({{"shot", shot.index},
                      {"kind", std::string(to_string(shot.kind))},
                      {"lights", std::move(lit)},
                      {"state", i < states.size() ? std::string(to_string(states[i]))
                                                  : std::string("committed")}});
    }
    return json_response({{"shots", std::move(list)}, {"count", shots.size()}});
  }

  [[nodiscard]] http::HttpResponse shot(const http::HttpRequest& request) const {
    const auto found = frame_of(request);
    if (!found) {
      return no_frame_yet();
    }
    const auto& [folder, file] = *found;
    const MappedFile mapped(file);
    const session::FrameTiffHeader header =
        session::read_frame_tiff_header(mapped.bytes(), file.string());
    const session::FrameDescription description =
        session::frame_description_from_json(header.description, file.string());
    return json_response(
        {{"shot", description.shot},
         {"attempt", description.attempt},
         {"file", fs::relative(file, folder).string()},
         {"evidence", Json::parse(session::evidence_to_json(description.evidence))}});
  }

  [[nodiscard]] http::HttpResponse run(const http::HttpRequest& request) const {
    const std::string session = request.query_or("session", "");
    const RunReceipt receipt = session.empty()
                                   ? daemon_.run(request.body, request.query_or("name", ""))
                                   : daemon_.resume_session(session);
    return json_response({{"session", receipt.session},
                          {"folder", receipt.folder.string()},
                          {"plan_hash", receipt.plan_hash},
                          {"shots", receipt.n_shots}},
                         202);
  }

  [[nodiscard]] http::HttpResponse ask(EventBody body) const {
    daemon_.request(std::move(body));
    return json_response(state_json(daemon_.state()), 202);
  }

  [[nodiscard]] http::HttpResponse show_preview(const http::HttpRequest& request) const {
    const Json body = body_of(request);
    const auto number = [&](const char* key, double fallback, double most) {
      const auto it = body.find(key);
      if (it == body.end()) {
        return fallback;
      }
      if (!it->is_number() || !(it->get<double>() >= 0.0 && it->get<double>() <= most)) {
        throw Error(fmt::format("\"{}\" is no number from 0 to {}", key, most), request.path,
                    "see docs/reference/http-api.md");
      }
      return it->get<double>();
    };
    const auto level = static_cast<std::uint16_t>(number("level", 65535.0, 65535.0));
    const double exposure_us = number("exposure_us", 0.0, 1e9);
    const auto lights = body.find("lights");
    if (lights == body.end() || !lights->is_array() || lights->empty() ||
        lights->size() > kMaxPreviewLights) {
      throw Error("the body has no list \"lights\"", request.path, "send {\"lights\": [528]}");
    }
    std::vector<session::LightLevel> lit;
    for (const Json& light : *lights) {
      if (!light.is_number_integer() || light.get<std::int64_t>() < 0 ||
          light.get<std::int64_t>() > static_cast<std::int64_t>(kMaxPreviewLights)) {
        throw Error(light.dump() + " is no number of a light", request.path,
                    "write whole numbers from 0");
      }
      lit.push_back(session::LightLevel{.light = light.get<int>(), .level = level});
    }
    daemon_.show_preview(std::move(lit), exposure_us);
    return json_response(state_json(daemon_.state()), 202);
  }

  [[nodiscard]] http::HttpResponse reshoot(const http::HttpRequest& request) const {
    const Json body = body_of(request);
    const auto it = body.find("shots");
    if (it == body.end() || !it->is_array() || it->empty()) {
      throw Error("the body has no list \"shots\"", request.path, "send {\"shots\": [3, 17]}");
    }
    const DaemonState state = daemon_.state();
    const bool has_run = state.phase == Phase::done || state.phase == Phase::running ||
                         state.phase == Phase::preflight || state.phase == Phase::paused ||
                         state.phase == Phase::suspended || state.phase == Phase::safe_off;
    if (!has_run || state.is_preview || state.is_opening) {
      throw Error("no session is open to take a shot again", request.path,
                  "POST /v1/run?session=ID opens one again", ExitCode::interrupted);
    }
    std::error_code error;
    if (!fs::is_regular_file(state.folder / "start.json", error)) {
      throw Error("the session's folder is not there any more", state.folder.string(),
                  "put it back where it was, or begin a new run", ExitCode::interrupted);
    }
    event::Reshoot reshoot;
    for (const Json& shot : *it) {
      if (!shot.is_number_integer() || shot.get<std::int64_t>() < 0 ||
          shot.get<std::int64_t>() >= state.n_shots) {
        throw Error(fmt::format("{} is no shot: the session has shots 0 to {}", shot.dump(),
                                state.n_shots - 1),
                    request.path, "GET /v1/sessions/ID/shots lists them");
      }
      reshoot.shots.push_back(shot.get<int>());
    }
    return ask(std::move(reshoot));
  }

 private:
  struct ShotFrame {
    fs::path folder;  ///< of its session
    fs::path file;
  };
  /// The newest frame of the requested shot.
  [[nodiscard]] std::optional<ShotFrame> frame_of(const http::HttpRequest& request) const {
    const auto folder = folder_of(request);
    const auto shot = whole_number(request.captures.at("shot"));
    auto file = folder && shot ? newest_frame(*folder, *shot) : std::nullopt;
    if (!file) {
      return std::nullopt;
    }
    return ShotFrame{*folder, *std::move(file)};
  }
  static http::HttpResponse no_frame_yet() {
    return missing("no frame of this shot yet", "GET /v1/sessions/ID/shots lists their states");
  }
  [[nodiscard]] std::optional<fs::path> folder_of(const http::HttpRequest& request) const {
    const std::string& id = request.captures.at("id");
    std::error_code ignored;
    if (!is_session_name(id) || !fs::is_directory(sessions_ / id, ignored)) {
      return std::nullopt;
    }
    return sessions_ / id;
  }

  /// session.json when finished, else start.json. @throws Error
  [[nodiscard]] static session::SessionInfo info_of(const fs::path& folder) {
    std::error_code ignored;
    const fs::path file = fs::exists(folder / "session.json", ignored) ? folder / "session.json"
                                                                       : folder / "start.json";
    return session::session_info_from_json(read_file(file, kMaxFrameFile), file.string());
  }

  Daemon& daemon_;
  fs::path sessions_;
};

}  // namespace

std::string daemon_state_json(const DaemonState& state) {
  return state_json(state).dump(-1, ' ', false, Json::error_handler_t::replace);
}

http::HttpSite make_site(Daemon& daemon, std::shared_ptr<http::EventStream> events,
                         const fs::path& sessions, const fs::path& web_folder) {
  const auto h = std::make_shared<const Handlers>(daemon, sessions);
  http::HttpSite site;
  // Lane::here: like all-off, on the thread that nothing may block.
  site.get(
      "/v1/state",
      [&daemon](const http::HttpRequest&) { return json_response(state_json(daemon.state())); },
      http::Lane::here);
  site.add_events("/v1/events", std::move(events));
  site.get("/v1/sessions", [&daemon, sessions](const http::HttpRequest& r) {
    return list_sessions(sessions, daemon.state(), r);
  });
  site.get("/v1/sessions/{id}", [h](const http::HttpRequest& r) { return h->session(r); });
  site.get("/v1/sessions/{id}/shots", [h](const http::HttpRequest& r) { return h->shots(r); });
  site.get("/v1/sessions/{id}/shots/{shot}",
           [h](const http::HttpRequest& r) { return h->shot(r); });
  const auto metrics = [&daemon](const http::HttpRequest&) {
    return http::HttpResponse{.content_type = "text/plain; version=0.0.4",
                              .body = daemon.metrics()};
  };
  for (const char* pattern : {"/v1/metrics", "/metrics"}) {
    site.add({.method = "GET",
              .pattern = pattern,
              .handler = metrics,
              .access = http::Access::open,
              .lane = http::Lane::here});
  }
  const auto health = [h](const http::HttpRequest&) { return h->health(); };
  for (const char* pattern : {"/v1/healthz", "/healthz"}) {
    site.add({.method = "GET",
              .pattern = pattern,
              .handler = health,
              .access = http::Access::open,
              .is_always = true,
              .lane = http::Lane::here});
  }
  site.post(
      "/v1/run", [h](const http::HttpRequest& r) { return h->run(r); }, http::Lane::work);
  site.post(
      "/v1/pause", [h](const http::HttpRequest&) { return h->ask(event::Pause{}); },
      http::Lane::here);
  site.post(
      "/v1/resume", [h](const http::HttpRequest&) { return h->ask(event::Resume{}); },
      http::Lane::here);
  site.post(
      "/v1/abort", [h](const http::HttpRequest&) { return h->ask(event::Abort{}); },
      http::Lane::here);
  site.post("/v1/preview", [h](const http::HttpRequest& r) { return h->show_preview(r); });
  site.post("/v1/reshoot", [h](const http::HttpRequest& r) { return h->reshoot(r); });
  site.add({.method = "POST",
            .pattern = "/v1/all-off",
            .handler = [h](const http::HttpRequest&) { return h->ask(event::SafeOff{}); },
            .access = http::Access::write,
            .is_always = true,
            .lane = http::Lane::here});
  add_page_routes(site, daemon, sessions);
  if (!web_folder.empty()) {
    site.set_static_files("/", web_folder);
  }
  return site;
}

}  // namespace haarlight::capture
