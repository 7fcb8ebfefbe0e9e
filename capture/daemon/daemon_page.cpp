// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/daemon_page.h"

#include <algorithm>
#include <charconv>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "capture/daemon/daemon.h"
#include "capture/daemon/daemon_view.h"
#include "capture/daemon/device_report.h"
#include "capture/daemon/frame_words.h"
#include "capture/daemon/run_observer.h"
#include "capture/daemon/writer_thread.h"
#include "core/report.h"
#include "core/thread_pulse.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"
#include "session/rig_session.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr std::uintmax_t kMaxFrameFile = std::uintmax_t{1} << 28U;
constexpr int kManyLights = -2;  // in a layout: the shot lights more than one light
constexpr int kNoLight = -1;

http::HttpResponse json_response(const Json& json) {
  return {.body = json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n",
          .headers = {{"Cache-Control", "no-store"}}};
}

http::HttpResponse missing(const std::string& what, const std::string& hint) {
  return http::error_response(404, what, "the request's path", hint);
}

/// A session as shown on the page: the running one from memory, any other from its folder.
struct ShownSession {
  std::shared_ptr<const Plan> plan;  ///< or
  std::shared_ptr<const session::SessionInfo> info;
  session::FrameForm form;
  std::string marks;
  bool is_active = false;

  [[nodiscard]] const std::vector<session::Shot>& shots() const {
    const Plan* const running = plan.get();
    return running != nullptr ? running->shots : info->shots;
  }
};

std::string marks_from_info(const session::SessionInfo& info) {
  std::string marks(info.shots.size(), static_cast<char>(ShotMark::pending));
  for (const session::FrameRecord& frame : info.frames) {
    const auto i = static_cast<std::size_t>(frame.shot);
    if (frame.shot >= 0 && i < marks.size()) {
      marks[i] = static_cast<char>(mark_of_committed(
          frame.attempt, doubt_of(frame.evidence, info.form, info.shots[i].kind)));
    }
  }
  return marks;
}

/// Of a session that was never finished: a frame's file marks its shot.
std::string marks_from_files(const fs::path& folder, std::size_t n_shots) {
  std::string marks(n_shots, static_cast<char>(ShotMark::pending));
  std::error_code error;
  for (fs::directory_iterator it(folder / "frames", error), end; !error && it != end;
       it.increment(error)) {
    int shot = 0;
    int attempt = 0;
    if (session::parse_frame_file_name(it->path().filename().string(), shot, attempt) &&
        shot >= 0 && static_cast<std::size_t>(shot) < n_shots) {
      char& mark = marks[static_cast<std::size_t>(shot)];
      mark = static_cast<char>(
          mark_of_committed(mark == static_cast<char>(ShotMark::reshot) ? 1 : attempt, {}));
    }
  }
  return marks;
}

std::optional<fs::path> newest_file(const fs::path& session, int shot, int& attempt) {
  std::optional<fs::path> found;
  std::error_code ignored;
  int newest = -1;
  for (int i = 0; i < newest + 33; ++i) {
    fs::path file = session / session::frame_file_name(shot, i);
    if (fs::exists(file, ignored)) {
      newest = i;
      found = std::move(file);
    }
  }
  attempt = newest;
  return found;
}

class PageHandlers {
 public:
  PageHandlers(Daemon& daemon, fs::path sessions)
      : daemon_(daemon), sessions_(std::move(sessions)) {}

  [[nodiscard]] http::HttpResponse rig() const {
    const Rig& rig = daemon_.rig();
    Json faces = Json::array();
    int first = 0;
    for (const Face& face : rig.faces) {
      faces.push_back({{"id", face.id},
                       {"rows", face.rows},
                       {"cols", face.cols},
                       {"first_light", first},
                       {"watts", face.element_power.value()},
                       {"max_watts", face.max_power.value()}});
      first += face.n_lights();
    }
    Json cameras = Json::array();
    for (const CameraSpec& camera : rig.cameras) {
      cameras.push_back({{"id", camera.id},
                         {"width", camera.frame_width},
                         {"height", camera.active_rows},
                         {"bits", camera.bits},
                         {"fps", camera.fps},
                         {"exposure_us", camera.exposure_us}});
    }
    return json_response({{"name", rig.name},
                          {"version", std::string(kVersion)},
                          {"lights", rig.n_lights()},
                          {"faces", std::move(faces)},
                          {"cameras", std::move(cameras)},
                          {"sync", std::string(to_string(rig.sync))}});
  }

  [[nodiscard]] http::HttpResponse map(const http::HttpRequest& request) {
    const auto session = session_of(request);
    if (!session) {
      return missing("no such session", "GET /v1/sessions lists them");
    }
    const http::PageOfList page = http::page_of(request, session->marks.size());
    return json_response({{"session", request.captures.at("id")},
                          {"is_active", session->is_active},
                          {"count", session->marks.size()},
                          {"marks", session->marks.substr(page.first, page.end - page.first)}});
  }

  [[nodiscard]] http::HttpResponse layout(const http::HttpRequest& request) {
    const auto session = session_of(request);
    if (!session) {
      return missing("no such session", "GET /v1/sessions lists them");
    }
    std::string kinds;
    Json lights = Json::array();
    Json exposures = Json::array();
    const http::PageOfList page = http::page_of(request, session->shots().size());
    for (std::size_t i = page.first; i < page.end; ++i) {
      const session::Shot& shot = session->shots()[i];
      kinds += to_string(shot.kind).front();
      lights.push_back(shot.lit.empty()       ? kNoLight
                       : shot.lit.size() == 1 ? shot.lit.front().light
                                              : kManyLights);
      exposures.push_back(shot.exposure_us);
    }
    return json_response({{"session", request.captures.at("id")},
                          {"count", session->shots().size()},
                          {"kinds", std::move(kinds)},
                          {"light", std::move(lights)},
                          {"exposure_us", std::move(exposures)}});
  }

  [[nodiscard]] http::HttpResponse story(const http::HttpRequest& request) {
    const auto session = session_of(request);
    const auto index = shot_of(request);
    if (!session || !index || *index >= static_cast<int>(session->shots().size())) {
      return missing("no such shot", "GET /v1/sessions/ID/shots lists them");
    }
    const session::Shot& shot = session->shots()[static_cast<std::size_t>(*index)];
    Json lights = Json::array();
    for (const session::LightLevel& light : shot.lit) {
      lights.push_back(Json::array({light.light, light.level}));
    }
    Json json = {{"shot", *index},
                 {"kind", std::string(to_string(shot.kind))},
                 {"mark", std::string(1, session->marks[static_cast<std::size_t>(*index)])},
                 {"exposure_us", shot.exposure_us},
                 {"lights", std::move(lights)}};
    const ShotNote note = session->is_active ? daemon_.observer().note(*index) : ShotNote{};
    if (!note.problem.empty()) {
      json["problem"] = note.problem;
    }
    int attempt = -1;
    const auto file = newest_file(folder_of(request), *index, attempt);
    if (!file) {
      return json_response(json);
    }
    const MappedFile mapped(*file);
    const session::FrameDescription frame = session::frame_description_from_json(
        session::read_frame_tiff_header(mapped.bytes(), file->string()).description,
        file->string());
    json["attempt"] = frame.attempt;
    json["file"] = session::frame_file_name(*index, attempt);
    if (const std::string doubt = doubt_of(frame.evidence, session->form, shot.kind);
        !doubt.empty()) {
      json["doubt"] = doubt;
    }
    json["words"] = describe_evidence(frame.evidence, session->form);
    json["evidence"] = Json::parse(session::evidence_to_json(frame.evidence));
    return json_response(json);
  }

  /// Of a shot's newest frame. @param make  from its rows and their scale
  template <class Make>
  [[nodiscard]] http::HttpResponse of_frame(const http::HttpRequest& request,
                                            const Make& make) {
    const auto session = session_of(request);
    const auto index = shot_of(request);
    int attempt = -1;
    const auto file =
        session && index ? newest_file(folder_of(request), *index, attempt) : std::nullopt;
    if (!file) {
      return missing("no frame of this shot yet", "GET /v1/sessions/ID/map shows the marks");
    }
    const MappedFile mapped(*file);
    const session::FrameTiffHeader header =
        session::read_frame_tiff_header(mapped.bytes(), file->string());
    const session::FrameForm& form = session->form;
    if (header.sample != session::SampleType::u16 || header.channels != 1 ||
        header.width != form.width) {
      throw Error("the frame has another form than the session", file->string(),
                  "run haarlight verify");
    }
    const std::vector<std::byte> bytes =
        session::read_frame_tiff_rows(mapped.bytes(), header, 0, form.height, file->string());
    const ImageView<const std::uint16_t> words(
        reinterpret_cast<const std::uint16_t*>(bytes.data()), form.height, form.width, 1);
    return make(words, WordScale{.black_dn = form.black_level,
                                 .clip_dn = form.saturation_dn(),
                                 .white_dn = form.white_level,
                                 .bayer = form.bayer,
                                 .noise = daemon_.rig().cameras.front().noise});
  }

  [[nodiscard]] http::HttpResponse history(const http::HttpRequest& request) const {
    const std::string word = request.query_or("span", "minutes");
    const std::optional<HistorySpan> span = value_of<HistorySpan>(word);
    if (!span) {
      throw Error(fmt::format("span = \"{}\" is not known", word), request.path,
                  "write minutes or hours");
    }
    const RigHistory history = daemon_.watch().history(daemon_.clock().now_ns(), *span);
    Json temperatures = Json::array();
    for (const std::optional<double>& one : history.temperature_c) {
      temperatures.push_back(one ? Json(*one) : Json(nullptr));
    }
    double max_duty = 0.0;
    double max_watts = 0.0;
    for (const Face& face : daemon_.rig().faces) {
      max_duty = std::max(max_duty, face.max_duty);
      max_watts += face.max_power.value();
    }
    return json_response({{"step_s", history.step_s},
                          {"temperature_c", std::move(temperatures)},
                          {"watts", history.watts},
                          {"duty", history.duty},
                          {"frames", history.frames},
                          {"max_watts", max_watts},
                          {"max_duty", max_duty}});
  }

  [[nodiscard]] http::HttpResponse devices() const {
    Json lines = Json::array();
    for (const DoctorLine& line :
         report_devices(daemon_.rig(), sessions_, daemon_.watch().controller(),
                        daemon_.watch().camera(), daemon_.clock().now_ns())) {
      lines.push_back({{"subject", line.subject},
                       {"finding", std::string(to_string(line.finding))},
                       {"expected", line.expected},
                       {"found", line.found},
                       {"cure", line.hint.text()}});
    }
    return json_response({{"devices", std::move(lines)}});
  }

  [[nodiscard]] http::HttpResponse price(const http::HttpRequest& request) const {
    const Plan plan = daemon_.expand(request.body, request.query_or("name", "the plan"));
    const DryRun run = dry_run(plan, daemon_.rig());
    std::error_code error;
    const fs::space_info disk = fs::space(sessions_, error);
    return json_response({{"name", plan.name},
                          {"hash", plan.hash},
                          {"shots", run.n_shots},
                          {"light_shots", run.n_light_shots},
                          {"seconds", run.seconds},
                          {"flashes_a_second", run.seconds > 0 ? run.n_shots / run.seconds : 0},
                          {"bytes", run.bytes},
                          {"bytes_a_second", run.bytes_a_second},
                          {"bytes_free", error ? Json(nullptr) : Json(disk.available)},
                          {"peak_watts", run.peak_watts},
                          {"mean_watts", run.mean_watts},
                          {"highest_duty", run.highest_duty},
                          {"busiest_light", run.busiest_light}});
  }

 private:
  [[nodiscard]] fs::path folder_of(const http::HttpRequest& request) const {
    return sessions_ / request.captures.at("id");
  }

  [[nodiscard]] static std::optional<int> shot_of(const http::HttpRequest& request) {
    const std::string& text = request.captures.at("shot");
    int value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || value < 0) {
      return std::nullopt;
    }
    return value;
  }

  [[nodiscard]] std::optional<ShownSession> session_of(const http::HttpRequest& request) {
    const std::string& id = request.captures.at("id");
    const fs::path folder = folder_of(request);
    std::error_code ignored;
    if (!is_session_name(id) || !fs::is_directory(folder, ignored)) {
      return std::nullopt;
    }
    const DaemonState state = daemon_.state();
    if (state.session == id && state.plan != nullptr) {
      return ShownSession{.plan = state.plan,
                          .form = session::frame_form_of(daemon_.rig()),
                          .marks = daemon_.observer().marks(daemon_.shot_states()),
                          .is_active = true};
    }
    const std::shared_ptr<const session::SessionInfo> info = info_of(folder);
    return ShownSession{.info = info,
                        .form = info->form,
                        .marks = is_finished_ ? marks_from_info(*info)
                                              : marks_from_files(folder, info->shots.size())};
  }

  /// The last one read is cached: a page requests the same one again and again, and parsing
  /// thousands of frames takes time. @throws Error
  std::shared_ptr<const session::SessionInfo> info_of(const fs::path& folder) {
    std::error_code ignored;
    const bool is_finished = fs::exists(folder / "session.json", ignored);
    const fs::path file = folder / (is_finished ? "session.json" : "start.json");
    const auto changed = fs::last_write_time(file, ignored);
    if (cached_ == nullptr || cached_file_ != file || cached_time_ != changed) {
      cached_ = std::make_shared<const session::SessionInfo>(
          session::session_info_from_json(read_file(file, kMaxFrameFile), file.string()));
      cached_file_ = file;
      cached_time_ = changed;
    }
    is_finished_ = is_finished;
    return cached_;
  }

  Daemon& daemon_;
  fs::path sessions_;
  // Used only by the thread of Lane::look.
  std::shared_ptr<const session::SessionInfo> cached_;
  fs::path cached_file_;
  fs::file_time_type cached_time_;
  bool is_finished_ = false;
};

}  // namespace

void add_page_routes(http::HttpSite& site, Daemon& daemon, const fs::path& sessions) {
  const auto h = std::make_shared<PageHandlers>(daemon, sessions);
  site.get("/v1/rig", [h](const http::HttpRequest&) { return h->rig(); });
  site.get("/v1/sessions/{id}/map", [h](const http::HttpRequest& r) { return h->map(r); });
  site.get("/v1/sessions/{id}/layout",
           [h](const http::HttpRequest& r) { return h->layout(r); });
  site.get("/v1/sessions/{id}/shots/{shot}/story",
           [h](const http::HttpRequest& r) { return h->story(r); });
  site.get("/v1/sessions/{id}/shots/{shot}/frame.png", [h](const http::HttpRequest& r) {
    return h->of_frame(r, [&r](auto words, const WordScale& scale) {
      return png_response(words, scale, region_of(r, words.width(), words.height()));
    });
  });
  site.get("/v1/sessions/{id}/shots/{shot}/preview.jpg",
           [h](const http::HttpRequest& r) { return h->of_frame(r, jpeg_response); });
  site.get("/v1/sessions/{id}/shots/{shot}/facts", [h](const http::HttpRequest& r) {
    return h->of_frame(r, [&r](auto words, const WordScale& scale) {
      return facts_response(words, scale, region_of(r, words.width(), words.height()));
    });
  });
  site.get("/v1/history", [h](const http::HttpRequest& r) { return h->history(r); });
  site.get("/v1/devices", [h](const http::HttpRequest&) { return h->devices(); });
  add_view_routes(site, daemon);
  site.add({.method = "POST",
            .pattern = "/v1/dry-run",
            .handler = [h](const http::HttpRequest& r) { return h->price(r); },
            .access = http::Access::read,
            .lane = http::Lane::work});
}

}  // namespace haarlight::capture
