// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/daemon.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <ctime>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>
#include <variant>

#include <fmt/format.h>

#include "capture/camera/measured_camera.h"
#include "capture/daemon/daemon_http.h"
#include "capture/daemon/light_thread.h"
#include "capture/daemon/work_queue.h"
#include "capture/daemon/writer_thread.h"
#include "capture/plan/timing.h"
#include "capture/proof/frame_checks.h"
#include "core/log.h"
#include "core/rig/pixel_format.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "http/json_text.h"
#include "http/server.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr std::size_t kMaxLines = 8192;  // of the event stream, kept for replay
constexpr std::int64_t kRowBits = 24;    // of an event id; above: the session's second
constexpr milliseconds kControlTick{100};
constexpr std::size_t kNameLength = 6;    // of the plan's hash, in a session's name
constexpr std::size_t kMaxDeferred = 16;  // user requests while a session is being opened
constexpr std::int64_t kReopenNs = 2'000'000'000;  // disk full at the start: retry after this

std::string second_name() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  std::array<char, 32> text{};
  (void)std::strftime(text.data(), text.size(), "%Y%m%d-%H%M%S", &parts);
  return text.data();
}

template <class T>
T require_device(Result<T> made, const Rig& rig) {
  if (!made) {
    throw Error(made.error().what, rig.file.string(), "correct the rig file",
                ExitCode::bad_input);
  }
  return *std::move(made);
}

}  // namespace

bool is_session_name(const std::string& name) {
  return !name.empty() && name.size() <= 100 && name.front() != '.' &&
         std::none_of(name.begin(), name.end(),
                      [](char c) { return c == '/' || c == '\\' || (c >= 0 && c < ' '); });
}

void require_drivers(const DaemonConfig& config) {
  const Rig& rig = config.rig;
  (void)require_device(config.make_light(), rig);
  (void)require_device(config.make_camera(), rig);
}

std::shared_ptr<const SequencerPlan> sequencer_plan(const Rig& rig, const Plan& plan) {
  const CameraSpec& camera = rig.cameras.front();
  auto out = std::make_shared<SequencerPlan>();
  for (const session::Shot& shot : plan.shots) {
    out->shots.push_back({.tag = kFirstTag + static_cast<std::uint32_t>(shot.index),
                          .exposure_us = shot.exposure_us,
                          .pattern_id = shot.index,
                          .is_dark = shot.kind == session::ShotKind::dark});
  }
  out->darks_every_c = plan.darks_every_c;
  out->sync = rig.sync;
  out->timestamp = camera.timestamp;
  out->read_us = camera.read_us;
  out->skew_us = camera.skew_us;
  out->frame_us = 1e6 / camera.fps;
  out->settle_ns = settle_ns(rig.controller);
  if (rig.sync == SyncMode::controller_leads) {
    out->trigger_delay_ns = std::chrono::nanoseconds(trigger_delay(rig)).count();
  }
  out->strobe_every = rig.strobe_every;
  // An upload is one call of the light thread: a few seconds at most on a serial line.
  out->table_depth = rig.controller.kind == ControllerKind::modbus_rtu ? 128 : 1024;
  return out;
}

class Daemon::Impl {
 public:
  explicit Impl(DaemonConfig config)
      : config_(std::move(config)),
        clock_(*config_.clock),
        watch_(config_.rig, clock_.now_ns()),
        stream_(std::make_shared<http::EventStream>(
            http::EventStreamOptions{.replay = [this](std::int64_t after, std::size_t max) {
              return replay(after, max);
            }})) {
    require_drivers(config_);
    std::error_code error;
    fs::create_directories(config_.sessions, error);
    if (error) {
      throw Error("cannot make the sessions folder: " + error.message(),
                  config_.sessions.string(), "give a folder that can be written", ExitCode::io);
    }
    auto send = [this](EventBody body) { receive(std::move(body)); };
    auto lights = require_device(config_.make_light(), config_.rig);
    auto camera = require_measured_identity(require_device(config_.make_camera(), config_.rig),
                                            config_.rig);
    writer_ = std::make_unique<WriterThread>(
        WriterThreadConfig{
            .rig = config_.rig,
            .storage = config_.storage,
            .send = send,
            .opened = [this](Result<OpenSession> s) { post(ready(std::move(s))); },
            .logged = [this](const JournalLine& line) { publish(line); },
            .clock = &clock_},
        store_);
    camera_ = std::make_unique<CameraThread>(std::move(camera), config_.rig.cameras.front(),
                                             store_, send, clock_);
    lights_ = std::make_unique<LightThread>(
        std::move(lights),
        LightThreadConfig{.lease = config_.rig.controller.lease,
                          .poll = step_poll(config_.rig),
                          .trigger_delay = config_.rig.sync == SyncMode::controller_leads
                                               ? trigger_delay(config_.rig)
                                               : std::chrono::microseconds(0),
                          .patterns = [this] { return patterns(); },
                          .send = send,
                          .clock = &clock_});
    checker_ = clock_.start([this](const std::stop_token& stop) { check_frames(stop); });
    control_ = clock_.start([this](const std::stop_token& stop) { control(stop); });
    receive(event::Booted{});
    recover();
  }

  /// HTTP last: everything it queries exists.
  void serve(Daemon& daemon) {
    if (!config_.has_http) {
      return;
    }
    http::HttpServerConfig http;
    http.address = config_.rig.http.address;
    http.port = config_.rig.http.port;
    http.token = config_.token;
    http.allowed_hosts = config_.rig.http.allowed_hosts;
    server_ = std::make_unique<http::HttpServer>(
        http, make_site(daemon, stream_, config_.sessions, config_.web_folder));
  }

  ~Impl() {
    server_.reset();
    stream_->close();
    // The control thread goes first, so that nothing new is lit; the light thread goes dark.
    clock_.stop(control_);
    lights_.reset();
    camera_.reset();
    clock_.stop(checker_);
    writer_.reset();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[nodiscard]] DaemonState state() const {
    const std::lock_guard lock(mutex_);
    return published_;
  }
  [[nodiscard]] std::vector<ShotState> shot_states() const {
    const std::lock_guard lock(mutex_);
    return shot_states_;
  }
  [[nodiscard]] int port() const { return server_ == nullptr ? 0 : server_->port(); }
  [[nodiscard]] FrameTap& tap() const { return camera_->tap(); }
  [[nodiscard]] const DaemonConfig& config() const { return config_; }
  [[nodiscard]] const RunObserver& observer() const { return observer_; }
  [[nodiscard]] RigWatch& watch() { return watch_; }
  [[nodiscard]] std::size_t n_frames_held() const { return store_.size(); }
  [[nodiscard]] std::uint64_t n_lines_dropped() const { return writer_->n_lines_dropped(); }
  [[nodiscard]] http::HttpCounters http_counters() const {
    return server_ == nullptr ? http::HttpCounters{} : server_->counters();
  }

  [[nodiscard]] Plan expand(const std::string& plan_text, const std::string& name) const {
    const std::size_t first = plan_text.find_first_not_of(" \t\r\n");
    const bool is_json = first != std::string::npos && plan_text[first] == '{';
    const std::string where = name.empty() ? "the plan" : name;
    if (!is_json) {
      return expand_plan(parse_plan_file(plan_text, where), config_.rig);
    }
    Plan plan = plan_from_json(plan_text, where);
    require_limits(plan, config_.rig, where);
    return plan;
  }

  /// Lossy pictures may be viewed, not stored.
  void require_raw_frames() const {
    const CameraSpec& camera = config_.rig.cameras.front();
    if (pixel_use(camera) == PixelUse::preview) {
      throw Error(fmt::format("camera \"{}\": \"{}\" pictures are for looking only", camera.id,
                              camera.format),
                  config_.rig.file.string(), "choose a raw format (docs/reference/cameras.md)");
    }
  }

  RunReceipt run(const std::string& plan_text, const std::string& name) {
    require_raw_frames();
    SessionOrder order;
    order.plan = expand(plan_text, name);
    take_turn();
    order.id = new_session_name(order.plan.hash);
    order.folder = config_.sessions / order.id;
    order.rig_toml = config_.rig.text;
    RunReceipt receipt{order.id, order.folder, order.plan.hash,
                       static_cast<int>(order.plan.shots.size())};
    post(std::move(order));
    return receipt;
  }

  RunReceipt resume_session(const std::string& id) {
    if (!is_session_name(id) || !fs::exists(config_.sessions / id / "start.json")) {
      throw Error("there is no session \"" + id + "\" to go on with", config_.sessions.string(),
                  "GET /v1/sessions lists them");
    }
    require_raw_frames();
    take_turn();
    std::error_code ignored;
    fs::remove(config_.sessions / id / kAbortMark, ignored);
    post(SessionOrder{.folder = config_.sessions / id, .is_new = false, .id = id});
    return RunReceipt{.session = id, .folder = config_.sessions / id};
  }

  void show_preview(std::vector<session::LightLevel> lit, double exposure_us) {
    std::sort(lit.begin(), lit.end(),
              [](const session::LightLevel& a, const session::LightLevel& b) {
                return a.light < b.light;
              });
    PlanSettings settings;
    settings.name = "preview";
    settings.where = "preview";
    settings.patterns = PlanPatterns::list;
    settings.list = {std::move(lit)};
    if (exposure_us > 0.0) {
      settings.exposures_us = {exposure_us};
    }
    auto plan = std::make_shared<const Plan>(expand_plan(settings, config_.rig));
    take_turn();
    post(PreviewOrder{std::move(plan)});
  }

  void receive(EventBody body) { post(std::move(body)); }

  [[nodiscard]] std::string hanging_thread() const {
    for (const ThreadPulse* pulse : {&lights_->pulse(), &camera_->pulse(), &writer_->pulse(),
                                     &checker_pulse_, &control_pulse_}) {
      const int patience = pulse == &writer_->pulse() ? 4 : 1;
      if (pulse->busy_for() > patience * config_.hang_limit) {
        return std::string(pulse->name());
      }
    }
    return {};
  }

 private:
  struct PreviewOrder {
    std::shared_ptr<const Plan> plan;
  };
  /// What grows with a plan, built before the control thread receives it.
  struct ReadySession {
    OpenSession session;
    std::shared_ptr<const SequencerPlan> plan;
    std::shared_ptr<const std::vector<std::vector<firmware_iface::ElementLevel>>> patterns;
    std::shared_ptr<FrameChecker> checker;
    std::vector<session::ShotKind> kinds;
    std::vector<int> doubted;  ///< a crash came between their being doubted and being withdrawn
  };
  using Message = std::variant<EventBody, SessionOrder, Result<ReadySession>, PreviewOrder>;

  /// Called by the writer thread.
  [[nodiscard]] Result<ReadySession> ready(Result<OpenSession> opened) const {
    if (!opened) {
      return tl::unexpected<Fault>(std::move(opened.error()));
    }
    ReadySession out;
    out.session = *std::move(opened);
    out.plan = sequencer_plan(config_.rig, *out.session.plan);
    out.patterns = patterns_of(*out.session.plan);
    out.checker =
        std::make_shared<FrameChecker>(*out.session.plan, out.session.form,
                                       light_layout(config_.rig, config_.rig.cameras.front()));
    std::sort(out.session.evidence.begin(), out.session.evidence.end(),
              [](const auto& a, const auto& b) {
                return a.second.t_exposure_start_ns < b.second.t_exposure_start_ns;
              });
    for (const auto& [shot, evidence] : out.session.evidence) {
      const std::vector<int> doubted = out.checker->remember(shot, evidence);
      out.doubted.insert(out.doubted.end(), doubted.begin(), doubted.end());
    }
    out.session.evidence.clear();
    out.kinds = kinds_of(*out.session.plan);
    return out;
  }

  void post(Message message) {
    (void)inbox_.push(std::move(message), control_stop_.get_token());
  }

  /// One session at a time. @throws Error(interrupted)
  void take_turn() {
    const std::lock_guard lock(mutex_);
    const Phase phase = published_.phase;
    // The steps out of these two phases are in the inbox before any request can be: an order
    // comes behind them.
    const bool is_starting = phase == Phase::boot || phase == Phase::recover;
    if (!(is_free(phase) || is_starting) || published_.is_opening) {
      throw Error(fmt::format("the daemon is busy: {}{}", to_string(phase),
                              published_.session.empty() ? "" : " with " + published_.session),
                  "run",
                  phase == Phase::safe_off ? "resume first: all is off by request"
                                           : "wait for it, or abort it first",
                  ExitCode::interrupted);
    }
    published_.is_opening = true;
  }

  [[nodiscard]] std::string new_session_name(const std::string& plan_hash) const {
    const std::string base = second_name() + "-" + plan_hash.substr(0, kNameLength);
    std::string name = base;
    std::error_code ignored;
    for (int i = 2; fs::exists(config_.sessions / name, ignored); ++i) {
      name = fmt::format("{}-{}", base, i);
    }
    return name;
  }

  /// Of the sessions begun but neither finished nor aborted, resumes the one written last and
  /// reports the others. Cleans up what an interrupted creation left behind.
  void recover() {
    std::vector<std::pair<fs::file_time_type, std::string>> unfinished;
    std::error_code error;
    for (fs::directory_iterator it(config_.sessions, error), end; !error && it != end;
         it.increment(error)) {
      const fs::path& folder = it->path();
      std::error_code ignored;
      if (session::SessionWriter::discard_unmade(folder, *config_.storage)) {
        log_warning("cleared away " + folder.string() + ": its making was stopped half-way");
      } else if (fs::exists(folder / "start.json", ignored) &&
                 !fs::exists(folder / "session.json", ignored) &&
                 !fs::exists(folder / kAbortMark, ignored)) {
        unfinished.emplace_back(last_written(folder), folder.filename().string());
      }
    }
    std::sort(unfinished.begin(), unfinished.end());
    std::string last;
    if (config_.resumes && !unfinished.empty()) {
      last = unfinished.back().second;
      unfinished.pop_back();
      log_info("going on with the unfinished session " + last);
    }
    {
      const std::lock_guard lock(mutex_);
      published_.is_opening = !last.empty();
      for (const auto& [time, id] : unfinished) {
        log_warning(
            fmt::format("session {} is unfinished too: `haarlight capture --session {}` "
                        "goes on with it",
                        id, id));
        published_.unfinished.push_back(id);
      }
    }
    receive(event::Recovered{});
    if (!last.empty()) {
      post(SessionOrder{
          .folder = config_.sessions / last, .is_new = false, .is_recovery = true, .id = last});
    }
  }

  /// A name says when a session was begun, not which one was active last.
  [[nodiscard]] static fs::file_time_type last_written(const fs::path& folder) {
    fs::file_time_type last = fs::file_time_type::min();
    for (const char* part :
         {"start.json", "journal.sqlite", "journal.sqlite-wal", "frames", "aside"}) {
      std::error_code error;
      const fs::file_time_type time = fs::last_write_time(folder / part, error);
      last = error ? last : std::max(last, time);
    }
    return last;
  }

  [[nodiscard]] static bool is_free(Phase phase) {
    return phase == Phase::idle || phase == Phase::done;
  }

  // ---- the control thread ----

  void control(const std::stop_token& stop) {
    SequencerState state;
    while (!stop.stop_requested()) {
      const std::int64_t now_ns = clock_.now_ns();
      const std::int64_t wait_ns = std::clamp<std::int64_t>(
          state.deadline_ns == kNever ? kNever : state.deadline_ns - now_ns, 0,
          std::chrono::nanoseconds(kControlTick).count());
      std::optional<Message> message =
          inbox_.pop(clock_.now() + std::chrono::nanoseconds(wait_ns), stop);
      const ThreadPulse::Busy busy(control_pulse_);
      lights_->feed_deadman();
      if (config_.on_turn) {
        config_.on_turn("control");
      }
      try {
        if (message && std::holds_alternative<SessionOrder>(*message)) {
          open(state, std::get<SessionOrder>(*std::move(message)));
        } else if (message && std::holds_alternative<Result<ReadySession>>(*message)) {
          begin(state, std::get<Result<ReadySession>>(*std::move(message)));
        } else if (message && std::holds_alternative<PreviewOrder>(*message)) {
          begin_preview(state, *std::get<PreviewOrder>(*message).plan);
        } else if (message) {
          take_event(state, std::get<EventBody>(*std::move(message)));
        } else if (state.deadline_ns <= clock_.now_ns()) {
          do_step(state, event::Tick{});
        }
        if (recovery_ && clock_.now_ns() >= reopen_ns_) {
          reopen_ns_ = kNever;
          writer_->open(*recovery_);
        }
      } catch (const std::exception& error) {
        log_error(std::string("our own bug in the control thread: ") + error.what());
        std::abort();  // the lease and the service's stop action turn the lights off
      }
    }
    control_stop_.request_stop();
  }

  /// The writer opens one session at a time, and none while the sequencer is busy with another.
  void open(const SequencerState& state, SessionOrder order) {
    if (!is_free(state.phase)) {
      refuse_order(fmt::format("the daemon is busy: {}", to_string(state.phase)));
      return;
    }
    is_opening_ = true;
    if (order.is_recovery) {
      recovery_ = order;
    }
    writer_->open(std::move(order));
  }

  void refuse_order(const std::string& why) {
    log_error("the session cannot be opened: " + why);
    {
      const std::lock_guard lock(mutex_);
      published_.is_opening = false;
      published_.reason_text = why;
    }
    stream_->publish(0, "error", fmt::format(R"({{"text": {}}})", http::json_quote(why)));
  }

  /// While a session is being opened, which takes seconds where space is reserved, user
  /// requests are meant for it: they wait for its Run. All-off does not wait.
  void take_event(SequencerState& state, EventBody body) {
    const bool is_for_later = std::holds_alternative<event::Pause>(body) ||
                              std::holds_alternative<event::Resume>(body) ||
                              std::holds_alternative<event::Abort>(body);
    if (is_opening_ && is_for_later) {
      if (deferred_.size() < kMaxDeferred) {
        deferred_.push_back(std::move(body));
      }
      if (reopen_ns_ != kNever) {
        reopen_ns_ = 0;  // answers at once: the session opens now, or not at all
      }
    } else if (is_opening_ && std::holds_alternative<event::Reshoot>(body)) {
      log_warning("nothing is taken again while another session is opened");
    } else {
      do_step(state, std::move(body));
    }
  }

  void take_deferred(SequencerState& state) {
    is_opening_ = false;
    for (EventBody& body : std::exchange(deferred_, {})) {
      do_step(state, std::move(body));
    }
  }

  void begin(SequencerState& state, Result<ReadySession> ready) {
    const bool is_disk =
        !ready && (ready.error().code == Errc::no_space || ready.error().code == Errc::io);
    if (is_disk && recovery_ && deferred_.empty()) {
      const std::string why = "the disk, goes on by itself: " + ready.error().what;
      log_warning(why);
      reopen_ns_ = clock_.now_ns() + kReopenNs;
      const std::lock_guard lock(mutex_);
      published_.reason_text = why;
      return;
    }
    recovery_.reset();
    if (!ready) {
      refuse_order(ready.error().what);
      take_deferred(state);
      return;
    }
    OpenSession& opened = ready->session;
    watch_.begin(ready->patterns);
    checker_of_session_ = std::move(ready->checker);
    observer_.begin(std::move(ready->kinds), opened.form, opened.next_attempt);
    run_ns_ = 0;
    n_commits_before_ = state.counters.commits;
    {
      const std::lock_guard lock(mutex_);
      patterns_ = std::move(ready->patterns);
    }
    do_step(state, event::Run{std::move(ready->plan), std::move(opened.committed),
                              std::move(opened.next_attempt)});
    if (!ready->doubted.empty()) {
      do_step(state, event::Reshoot{std::move(ready->doubted)});
    }
    {
      // After the step: the new session's name must never appear with the old one's "done".
      const std::lock_guard lock(mutex_);
      published_.session = opened.id;
      published_.folder = opened.folder;
      published_.plan = std::move(opened.plan);
      published_.recovery =
          std::make_shared<const session::RecoveryReport>(std::move(opened.recovery));
      std::erase(published_.unfinished, opened.id);
      published_.is_opening = false;
      published_.reason_text.clear();
    }
    take_deferred(state);
  }

  void begin_preview(SequencerState& state, const Plan& plan) {
    if (!is_free(state.phase) || is_opening_) {
      refuse_order(fmt::format("the daemon is busy: {}", to_string(state.phase)));
      return;
    }
    auto lit = patterns_of(plan);
    watch_.begin(lit);
    {
      const std::lock_guard lock(mutex_);
      patterns_ = std::move(lit);
      published_.is_opening = false;
      published_.reason_text.clear();
    }
    auto shown = std::make_shared<SequencerPlan>(*sequencer_plan(config_.rig, plan));
    shown->is_preview = true;
    do_step(state, event::Run{std::move(shown), {false}, {0}});
  }

  [[nodiscard]] static std::vector<session::ShotKind> kinds_of(const Plan& plan) {
    std::vector<session::ShotKind> kinds;
    for (const session::Shot& shot : plan.shots) {
      kinds.push_back(shot.kind);
    }
    return kinds;
  }

  [[nodiscard]] static std::shared_ptr<
      const std::vector<std::vector<firmware_iface::ElementLevel>>>
  patterns_of(const Plan& plan) {
    auto patterns = std::make_shared<std::vector<std::vector<firmware_iface::ElementLevel>>>();
    for (const session::Shot& shot : plan.shots) {
      std::vector<firmware_iface::ElementLevel> pattern;
      for (const session::LightLevel& light : shot.lit) {
        pattern.push_back(
            firmware_iface::ElementLevel{.element = light.light, .level = light.level});
      }
      patterns->push_back(std::move(pattern));
    }
    return patterns;
  }

  void do_step(SequencerState& state, EventBody body) {
    const std::int64_t now_ns = clock_.now_ns();
    run_ns_ += state.phase == Phase::running ? now_ns - stepped_ns_ : 0;
    stepped_ns_ = now_ns;
    observer_.see(now_ns, body);
    watch_.see(now_ns, body);
    StepResult result = step(std::move(state), TimedEvent{now_ns, std::move(body)});
    state = std::move(result.state);
    for (Action& action : result.actions) {
      observer_.see(now_ns, action);
      watch_.see(now_ns, action);
      perform(std::move(action));
    }
    show(state);
  }

  void perform(Action action) {
    std::visit(
        [this](auto& a) {
          using T = std::decay_t<decltype(a)>;
          if constexpr (std::is_same_v<T, action::ConnectLight> ||
                        std::is_same_v<T, action::ShowShot> ||
                        std::is_same_v<T, action::UploadTable> ||
                        std::is_same_v<T, action::ArmBlock> ||
                        std::is_same_v<T, action::ExtendBlock> ||
                        std::is_same_v<T, action::LightsOff>) {
            lights_->post(a);
          } else if constexpr (std::is_same_v<T, action::StartCamera> ||
                               std::is_same_v<T, action::StopCamera> ||
                               std::is_same_v<T, action::TriggerCamera> ||
                               std::is_same_v<T, action::SetExposure>) {
            camera_->post(a);
          } else if constexpr (std::is_same_v<T, action::DropFrame>) {
            store_.drop(a.frame);
          } else if constexpr (std::is_same_v<T, action::CheckFrame>) {
            if (!checks_.try_push(Check{std::move(a), checker_of_session_})) {
              log_error("the queue of checks is full");  // more than max_held: an internal bug
              std::abort();
            }
          } else {
            if constexpr (std::is_same_v<T, action::LogEvent>) {
              log_line(a);
            }
            writer_->post(a);
          }
        },
        action);
  }

  /// The service's log: what happened, with the session and the shot it concerns.
  void log_line(const action::LogEvent& line) const {
    std::string text = fmt::format("{}: {}", to_string(line.kind), line.text);
    if (line.shot >= 0) {
      text = fmt::format("shot {}: {}", line.shot, text);
    }
    {
      const std::lock_guard lock(mutex_);
      if (!published_.session.empty()) {
        text = fmt::format("[{}] {}", published_.session, text);
      }
    }
    if (line.kind == session::EventKind::fault || line.kind == session::EventKind::retry) {
      log_warning(text);
    } else {
      log_info(text);
    }
  }

  void show(const SequencerState& state) {
    const std::lock_guard lock(mutex_);
    published_.phase = state.phase;
    published_.step = state.step;
    published_.reasons = state.reasons;
    if (!state.reason_text.empty() || state.phase == Phase::running) {
      published_.reason_text = state.reason_text;
    }
    published_.is_preview = state.plan != nullptr && state.plan->is_preview;
    if (state.plan != nullptr &&
        !published_.is_preview) {  // after an abort the last state stays published
      shot_states_ = state.shots;
      published_.n_shots = static_cast<int>(state.shots.size());
      published_.n_committed = state.n_committed;
    }
    published_.current = state.current;
    published_.lights = !state.is_light_connected             ? LightsKnown::unknown
                        : state.is_dark && !state.is_job_open ? LightsKnown::off
                                                              : LightsKnown::on;
    published_.counters = state.counters;
    const std::uint64_t n_new = state.counters.commits - n_commits_before_;
    const int n_left = static_cast<int>(state.shots.size()) - state.n_committed;
    published_.seconds_left =
        n_new < 1 ? -1.0
                  : static_cast<double>(run_ns_) * 1e-9 * n_left / static_cast<double>(n_new);
  }

  // ---- the checking worker ----

  struct Check {
    action::CheckFrame frame;
    std::shared_ptr<FrameChecker> checker;
  };

  void check_frames(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      std::optional<Check> check = checks_.pop(clock_.now() + milliseconds(250), stop);
      const ThreadPulse::Busy busy(checker_pulse_);
      if (config_.on_turn) {
        config_.on_turn("checks");
      }
      if (!check) {
        continue;
      }
      action::CheckFrame& c = check->frame;
      const std::shared_ptr<const Frame> frame = store_.get(c.frame);
      if (frame == nullptr) {
        continue;  // dropped by an abort
      }
      const ImageView<const std::uint16_t> pixels = frame->pixels();
      FrameFinding finding{session::FrameVerdict::no_picture, "the frame has no pixels"};
      if (!pixels.is_empty()) {
        const ImageView<const std::uint16_t> active(pixels.data(),
                                                    config_.rig.cameras.front().active_rows,
                                                    pixels.width(), 1, pixels.row_stride());
        finding = check->checker->check(c.shot, active, c.evidence);
        if (!finding.is_taken()) {
          writer_->keep_refused({frame, c.shot, c.attempt, c.evidence, finding.problem});
        }
      }
      receive(event::FrameChecked{c.frame, c.shot, std::move(c.evidence),
                                  std::move(finding.problem), finding.verdict,
                                  std::move(finding.doubted), std::move(finding.note)});
    }
  }

  // ---- the event stream ----

  /// Called by the writer thread.
  void publish(const JournalLine& line) {
    const std::string kind(to_string(line.kind));
    std::int64_t id = 0;
    {
      const std::lock_guard lock(lines_mutex_);
      if (line.session != lines_session_) {
        lines_session_ = line.session;
        session_second_ =
            std::max(session_second_ + 1, static_cast<std::int64_t>(std::time(nullptr)));
      }
      if (line.row > 0) {
        id = (session_second_ << kRowBits) + line.row;
        lines_.push_back(http::Event{id, kind, line.json});
        if (lines_.size() > kMaxLines) {
          lines_.pop_front();
        }
      }
    }
    stream_->publish(id, kind, line.json);
  }

  [[nodiscard]] std::vector<http::Event> replay(std::int64_t after, std::size_t max) const {
    const std::lock_guard lock(lines_mutex_);
    auto line = std::upper_bound(
        lines_.begin(), lines_.end(), after,
        [](std::int64_t id, const http::Event& of_line) { return id < of_line.id; });
    std::vector<http::Event> out;
    for (; line != lines_.end() && out.size() < max; ++line) {
      out.push_back(*line);
    }
    return out;
  }

  [[nodiscard]] std::shared_ptr<const std::vector<std::vector<firmware_iface::ElementLevel>>>
  patterns() const {
    const std::lock_guard lock(mutex_);
    return patterns_;
  }

  DaemonConfig config_;
  Clock& clock_;
  FrameStore store_;
  WorkQueue<Message> inbox_{4096, clock_};
  WorkQueue<Check> checks_{256, clock_};
  std::stop_source control_stop_;  ///< the inbox is no longer read
  ThreadPulse control_pulse_{"control", clock_};
  ThreadPulse checker_pulse_{"checks", clock_};
  RunObserver observer_;
  RigWatch watch_;

  mutable std::mutex mutex_;
  DaemonState published_;
  std::vector<ShotState> shot_states_;
  std::shared_ptr<const std::vector<std::vector<firmware_iface::ElementLevel>>> patterns_;

  mutable std::mutex lines_mutex_;
  std::deque<http::Event> lines_;
  std::string lines_session_;
  std::int64_t session_second_ = 0;
  std::shared_ptr<http::EventStream> stream_;

  // Used by the control thread only.
  std::shared_ptr<FrameChecker> checker_of_session_;
  bool is_opening_ = false;  ///< the writer has an order and has not answered
  std::vector<EventBody> deferred_;
  std::optional<SessionOrder> recovery_;  ///< to be reopened once the disk accepts it
  std::int64_t reopen_ns_ = kNever;
  std::int64_t stepped_ns_ = 0;
  std::int64_t run_ns_ = 0;  ///< time spent running since the session was begun
  std::uint64_t n_commits_before_ = 0;

  std::unique_ptr<WriterThread> writer_;
  std::unique_ptr<CameraThread> camera_;
  std::unique_ptr<LightThread> lights_;
  std::jthread checker_;
  std::jthread control_;
  std::unique_ptr<http::HttpServer> server_;
};

Daemon::Daemon(DaemonConfig config) : impl_(std::make_unique<Impl>(std::move(config))) {
  impl_->serve(*this);
}
Daemon::~Daemon() = default;

DaemonState Daemon::state() const { return impl_->state(); }
std::vector<ShotState> Daemon::shot_states() const { return impl_->shot_states(); }
int Daemon::http_port() const { return impl_->port(); }
RunReceipt Daemon::run(const std::string& plan_text, const std::string& name) {
  return impl_->run(plan_text, name);
}
RunReceipt Daemon::resume_session(const std::string& id) { return impl_->resume_session(id); }
void Daemon::show_preview(std::vector<session::LightLevel> lit, double exposure_us) {
  impl_->show_preview(std::move(lit), exposure_us);
}
void Daemon::request(EventBody request) { impl_->receive(std::move(request)); }
std::shared_ptr<const TappedFrame> Daemon::newest_frame() const {
  return impl_->tap().newest();
}
std::uint64_t Daemon::n_frames_shown() const { return impl_->tap().n_copied(); }
const Rig& Daemon::rig() const { return impl_->config().rig; }
const Clock& Daemon::clock() const { return *impl_->config().clock; }
Plan Daemon::expand(const std::string& plan_text, const std::string& name) const {
  return impl_->expand(plan_text, name);
}
const RunObserver& Daemon::observer() const { return impl_->observer(); }
RigWatch& Daemon::watch() const { return impl_->watch(); }
std::string Daemon::hanging_thread() const { return impl_->hanging_thread(); }

void Daemon::put_lights_out() const {
  auto lights = impl_->config().make_light();
  if (!lights) {
    log_error("lights out: " + lights.error().what);
    return;
  }
  const auto connected = (*lights)->connect();
  const auto off = connected ? (*lights)->all_off() : tl::unexpected<Fault>(connected.error());
  if (!off && !firmware_iface::all_off_beside(impl_->config().rig.controller)) {
    log_error("lights out: " + off.error().what + "; the lease will do it");
  }
}

std::string Daemon::metrics() const {
  const DaemonState now = state();
  const SequencerCounters& c = now.counters;
  std::string text;
  const auto add = [&text](std::string_view name, std::string_view type, std::string_view help,
                           double value) {
    text +=
        fmt::format("# HELP haarlight_{0} {2}\n# TYPE haarlight_{0} {1}\nhaarlight_{0} {3}\n",
                    name, type, help, value);
  };
  const auto count = [&add](std::string_view name, std::string_view help, std::uint64_t value) {
    add(name, "counter", help, static_cast<double>(value));
  };
  count("frames_total", "Frames the camera delivered", c.frames);
  count("frames_unused_total", "Frames not wholly under one settled pattern", c.frames_unused);
  count("frames_damaged_total", "Frames marked as damaged or short", c.frames_damaged);
  count("sequence_gaps_total", "Gaps in the camera's frame numbers", c.sequence_gaps);
  count("frames_out_of_order_total", "Frames behind their successor", c.frames_out_of_order);
  count("stamps_ahead_total", "Frames timestamped after they came", c.timestamps_ahead);
  count("off_rhythm_total", "Frames timestamped off their camera's period", c.off_rhythm);
  count("rhythm_unknown_total", "Frames that came before their camera's period was known",
        c.rhythm_unknown);
  count("duplicates_total", "Pictures delivered twice", c.duplicates);
  count("wrong_exposure_total", "Frames in another exposure than requested", c.wrong_exposure);
  count("checks_failed_total", "Frames whose pixels were refused", c.checks_failed);
  count("confirms_failed_total", "Frames during which the light changed", c.confirms_failed);
  count("retries_total", "Shots shown again", c.retries);
  count("shot_timeouts_total", "Shots without a clean frame in time", c.shot_timeouts);
  count("light_faults_total", "Faults of the light controller", c.light_faults);
  count("camera_faults_total", "Faults of the camera", c.camera_faults);
  count("commit_faults_total", "Commits that failed", c.commit_faults);
  count("controller_reboots_total", "Restarts of the light controller", c.controller_reboots);
  count("suspensions_total", "Times a run was suspended", c.suspensions);
  count("blocks_total", "Parts of the pattern table armed for the strobe", c.blocks);
  count("blocks_cut_total", "Parts that ended early for want of free buffers", c.blocks_cut);
  count("strobe_unproven_total", "Frames that the step counter did not prove",
        c.strobe_unproven);
  count("table_mismatches_total", "Steps that showed another tag than the table's",
        c.table_mismatches);
  count("frames_doubted_total", "Frames withdrawn, contradicted by others of their lights",
        c.frames_doubted);
  count("commits_total", "Frames committed", c.commits);
  count("frames_shown_total", "Frames copied for viewers", n_frames_shown());
  count("event_lines_dropped_total", "Event lines lost to a slow disk",
        impl_->n_lines_dropped());
  count("http_requests_total", "Requests answered", impl_->http_counters().requests);
  add("frames_held", "gauge", "Camera buffers in our hands",
      static_cast<double>(impl_->n_frames_held()));
  add("shots", "gauge", "Shots of the session", now.n_shots);
  add("shots_committed", "gauge", "Shots committed", now.n_committed);
  text += "# HELP haarlight_phase 1 for the present phase\n# TYPE haarlight_phase gauge\n";
  for (const Phase phase : all_values<Phase>()) {
    text += fmt::format("haarlight_phase{{phase=\"{}\"}} {}\n", to_string(phase),
                        now.phase == phase ? 1 : 0);
  }
  text += impl_->observer().metrics();
  return text;
}

}  // namespace haarlight::capture
