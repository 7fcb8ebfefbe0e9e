#include "capture/sequencer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "core/error.h"
#include "session/clean_rule.h"

namespace haarlight {

namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kFirstBackoffNs = 100 * kMs;
constexpr std::int64_t kLastBackoffNs = 2000 * kMs;
constexpr std::int64_t kDiskRetryNs = 1000 * kMs;
constexpr std::int64_t kEvidenceRetryNs = 2000 * kMs;
constexpr std::int64_t kHeldRetryNs = 1000 * kMs;
constexpr std::int64_t kAbortLimitNs = 200 * kMs;
constexpr std::int64_t kShotSlackNs =
    300 * kMs;  // beside the frames: late delivery, a busy host
constexpr std::int64_t kPreviewNs = 60'000 * kMs;
constexpr double kShotFrames = 8.0;   // frame times without a clean frame: shown again
constexpr std::size_t kMaxEarly = 4;  // frames kept until the latch's acknowledgement is told
constexpr int kLightFaultsToLose = 3;
constexpr int kFailuresToRotate = 4;             // the next shot is tried first
constexpr int kFailuresToSuspend = 24;           // in a row, without a commit
constexpr std::int64_t kStampAheadNs = 2 * kMs;  // a stamp this far after its arrival is a jump
constexpr double kExposureTol = 0.005;           // frame against read-back: floats on the wire
constexpr double kExposureReadTol = 0.05;  // read-back against asked: sensors step in rows

std::int64_t backoff_ns(int faults) {
  const int doublings = std::clamp(faults - 1, 0, 10);
  return std::min(kFirstBackoffNs << doublings, kLastBackoffNs);
}

/// One event's work on the state.
class Stepper {
 public:
  Stepper(SequencerState& state, std::int64_t t_ns, std::vector<Action>& actions)
      : s_(state), t_(t_ns), out_(actions) {}

  void on(const event::Tick&) {
    if (due(s_.retry_light_ns)) {
      connect_light();
    }
    if (due(s_.retry_camera_ns)) {
      start_camera();
    }
    if (due(s_.retry_disk_ns)) {
      if (s_.phase == Phase::finalise) {
        out_.emplace_back(action::FinishSession{});
      } else {
        out_.emplace_back(action::RetryCommits{});
      }
    }
    if (due(s_.retry_evidence_ns)) {
      s_.failures = 0;
      clear_reason(kNoEvidence);
    }
    if (due(s_.retry_held_ns)) {
      clear_reason(kHeldBack);
    }
    if (s_.shot_deadline_ns <= t_) {
      on_shot_timeout();
    }
    if (s_.phase == Phase::aborting) {
      finish_abort();
    }
  }

  void on(const event::Booted&) {
    if (s_.phase == Phase::boot) {
      enter(Phase::recover, "looking for unfinished sessions");
    }
  }

  void on(const event::Recovered&) {
    if (s_.phase == Phase::recover) {
      enter(Phase::idle, "ready");
    }
  }

  void on(const event::Run& run) {
    const bool is_free =
        s_.phase == Phase::idle || s_.phase == Phase::done || s_.phase == Phase::safe_off;
    if (!is_free || run.plan == nullptr || run.plan->shots.empty() ||
        run.committed.size() != run.plan->shots.size() ||
        run.next_attempt.size() != run.plan->shots.size()) {
      return;
    }
    release_all_frames();
    s_.plan = run.plan;
    s_.shots.assign(run.plan->shots.size(), ShotState::pending);
    s_.attempts = run.next_attempt;
    s_.pending.clear();
    s_.n_committed = 0;
    for (std::size_t i = 0; i < run.committed.size(); ++i) {
      if (run.committed[i]) {
        s_.shots[i] = ShotState::committed;
        ++s_.n_committed;
      } else {
        s_.pending.push_back(static_cast<int>(i));
      }
    }
    s_.is_finished = false;
    s_.failures = 0;
    if (s_.phase == Phase::safe_off) {
      log("state", "safe-off: the run waits for a person");
    } else {
      preflight();
    }
  }

  void on(const event::Pause&) {
    if (is_shooting()) {
      enter(Phase::paused, "by a person");
      leave_shot();
      darken();
    }
  }

  void on(const event::Resume&) {
    if (s_.phase == Phase::safe_off && (s_.plan == nullptr || s_.is_finished)) {
      enter(Phase::idle, "by a person");
    } else if (s_.phase == Phase::safe_off || s_.phase == Phase::paused) {
      preflight();
    }
  }

  void on(const event::Abort&) {
    const bool has_run = is_shooting() || s_.phase == Phase::paused ||
                         (s_.phase == Phase::safe_off && s_.plan != nullptr);
    if (has_run) {
      abort("by a person");
    }
  }

  void on(const event::SafeOff&) {
    if (s_.phase == Phase::finalise || s_.phase == Phase::aborting || s_.phase == Phase::boot ||
        s_.phase == Phase::recover) {
      darken_always();  // they end by themselves, with the lights off
      return;
    }
    if (s_.phase != Phase::safe_off) {
      enter(Phase::safe_off, "all lights off by request");
    }
    leave_shot();
    darken_always();
  }

  void on(const event::Reshoot& reshoot) {
    if (s_.plan == nullptr || s_.plan->is_preview || s_.phase == Phase::aborting ||
        s_.phase == Phase::finalise) {
      return;
    }
    std::vector<int> withdrawn;
    for (const int shot : reshoot.shots) {
      if (shot < 0 || shot >= static_cast<int>(s_.shots.size()) ||
          shot_state(shot) != ShotState::committed) {
        continue;
      }
      shot_state(shot) = ShotState::pending;
      s_.pending.push_back(shot);
      --s_.n_committed;
      withdrawn.push_back(shot);
    }
    if (withdrawn.empty()) {
      return;
    }
    out_.emplace_back(action::WithdrawShots{std::move(withdrawn)});
    if (s_.phase == Phase::done) {
      s_.is_finished = false;
      preflight();
    } else {
      advance(std::nullopt);
    }
  }

  void on(const event::LightConnected& e) {
    if (e.job != s_.job) {
      return;
    }
    if (s_.boot_id != 0 && s_.boot_id != e.boot_id) {
      ++s_.counters.controller_reboots;
      log("controller", fmt::format("started again (boot {} after {})", e.boot_id, s_.boot_id));
    }
    s_.boot_id = e.boot_id;
    s_.is_job_open = false;
    s_.is_light_connected = true;
    s_.is_dark = true;
    became_ready(kControllerLost);
  }

  void on(const event::LightShown& e) {
    if (e.job != s_.job || s_.current < 0 || s_.step != ShotStep::light) {
      return;
    }
    s_.is_job_open = false;
    const std::uint32_t tag = shot_of(s_.current).tag;
    if (e.receipt.tag_echo != tag) {
      on_light_fault(Errc::protocol, fmt::format("the controller shows tag {}, not {}",
                                                 e.receipt.tag_echo, tag));
      return;
    }
    s_.light_faults = 0;
    s_.receipt = e.receipt;
    s_.t_stable_ns = e.receipt.t_ack_ns + s_.plan->settle_ns;
    s_.step = t_ < s_.t_stable_ns ? ShotStep::settle : ShotStep::collect;
    s_.discarded = 0;
    if (s_.plan->is_preview) {
      s_.shot_deadline_ns = t_ + kPreviewNs;
      drop_early();
      return;
    }
    const double frame_us =
        std::max(s_.plan->frame_us, shot_of(s_.current).exposure_us + s_.plan->skew_us);
    s_.shot_deadline_ns = std::max(t_, s_.t_stable_ns) + kShotSlackNs +
                          static_cast<std::int64_t>(kShotFrames * frame_us * 1e3);
    // Their stamps decide, not the order in which two threads were heard.
    for (const event::FrameArrived& frame : std::exchange(s_.early, {})) {
      judge(frame);
    }
  }

  void on(const event::LightDark& e) {
    if (e.job == s_.job) {
      s_.is_job_open = false;
      s_.light_faults = 0;
    }
  }

  void on(const event::LightConfirmed& e) {
    if (!s_.awaiting || s_.awaiting->frame != e.frame) {
      return;
    }
    SequencerState::Awaiting waiting = *std::move(s_.awaiting);
    s_.awaiting.reset();
    FrameEvidence& evidence = waiting.evidence;
    const CleanVerdict verdict =
        judge_clean({evidence.t_exposure_start_ns, evidence.t_exposure_end_ns},
                    evidence.t_stable_ns, e.t_request_ns);
    evidence.t_next_change_ns = e.t_request_ns;
    evidence.margin_us = verdict.margin_us;
    evidence.temperature_c = e.temperature_c;
    if (e.tag == evidence.tag && e.boot_id == s_.boot_id && verdict.is_clean) {
      s_.held.push_back(SequencerState::Held{waiting.frame, waiting.shot, waiting.attempt});
      shot_state(waiting.shot) = ShotState::checking;
      out_.emplace_back(action::CheckFrame{waiting.frame, waiting.shot, waiting.attempt,
                                           std::move(waiting.evidence)});
      return;
    }
    ++s_.counters.confirms_failed;
    drop(waiting.frame);
    const bool is_newest = waiting.job == s_.job;
    if (is_newest) {
      s_.is_job_open = false;
      leave_shot();  // the light thread did not go on to show it
    }
    const bool is_reboot = e.boot_id != s_.boot_id;
    retry(waiting.shot, is_reboot
                            ? fmt::format("the controller started again (boot {})", e.boot_id)
                            : fmt::format("the light changed by itself: tag {}, not {}", e.tag,
                                          evidence.tag));
    if (is_reboot) {
      lose_controller("the controller started again", t_);
    } else if (is_newest) {
      s_.is_dark = false;  // unknown
      advance(std::nullopt);
    }
  }

  void on(const event::LightFault& e) {
    if (s_.awaiting && s_.awaiting->job == e.job) {
      const SequencerState::Awaiting waiting = *std::move(s_.awaiting);
      s_.awaiting.reset();
      drop(waiting.frame);
      return_to_pending(waiting.shot);
    }
    if (e.job == 0 && s_.is_light_connected) {
      ++s_.counters.light_faults;
      ++s_.light_faults;
      leave_shot();
      lose_controller("controller: " + e.what, t_ + backoff_ns(s_.light_faults));
    } else if (e.job == s_.job && s_.is_job_open) {
      on_light_fault(e.code, e.what);
    }
  }

  void on(const event::CameraStarted& e) {
    if (!s_.is_camera_starting || e.stream != s_.stream) {
      return;
    }
    s_.is_camera_starting = false;
    s_.is_camera_started = true;
    s_.is_exposure_open = false;
    s_.has_sequence = false;
    s_.n_hashes = 0;
    s_.exposure_read_us = e.exposure_us;
    s_.max_held =
        std::max(1, std::min(s_.plan != nullptr ? s_.plan->max_held : 1, e.n_buffers - 3));
    if (!check_exposure()) {
      return;
    }
    became_ready(kCameraLost);
  }

  void on(const event::ExposureSet& e) {
    if (e.request != s_.exposure_request || !s_.is_exposure_open) {
      return;
    }
    s_.is_exposure_open = false;
    s_.exposure_read_us = e.exposure_us;
    (void)check_exposure();
  }

  void on(const event::CameraFault& e) {
    const bool is_needed = s_.is_camera_started || s_.is_camera_starting;
    if (e.stream != s_.stream || !is_needed) {
      return;
    }
    ++s_.counters.camera_faults;
    ++s_.camera_faults;
    s_.is_camera_started = false;
    s_.is_camera_starting = false;
    s_.is_exposure_open = false;
    if (e.code == Errc::unsupported || e.code == Errc::refused) {
      abort("camera: " + e.what);
      return;
    }
    s_.retry_camera_ns = t_ + backoff_ns(s_.camera_faults);
    add_reason(kCameraLost, "camera: " + e.what);
  }

  void on(const event::FrameArrived& e) {
    ++s_.counters.frames;
    const bool is_of_stream = s_.is_camera_started && e.stream == s_.stream;
    const bool is_usable = is_of_stream && examine(e);
    const bool has_shot = is_of_stream && s_.phase == Phase::running && s_.current >= 0 &&
                          s_.step != ShotStep::none;
    if (!has_shot || !is_usable) {
      s_.discarded += has_shot ? 1 : 0;
      ++s_.counters.frames_unused;
      drop(e.frame);
    } else if (s_.step == ShotStep::light) {
      if (s_.early.size() >= kMaxEarly) {
        drop(s_.early.front().frame);
        s_.early.erase(s_.early.begin());
        ++s_.counters.frames_unused;
      }
      s_.early.push_back(e);
    } else {
      judge(e);
    }
  }

  void on(const event::FrameChecked& e) {
    const auto it = find_held(e.frame);
    if (it == s_.held.end()) {
      return;
    }
    if (e.problem.empty()) {
      if (shot_state(it->shot) == ShotState::checking) {
        shot_state(it->shot) = ShotState::committing;
        out_.emplace_back(action::CommitFrame{it->frame, it->shot, it->attempt, e.evidence});
      }
      return;
    }
    ++s_.counters.checks_failed;  // also said by the writer, which checks once more
    const int shot = it->shot;
    s_.held.erase(it);
    drop(e.frame);
    retry(shot, e.problem);
    advance(std::nullopt);
  }

  void on(const event::FrameCommitted& e) {
    const auto it = find_held(e.frame);
    if (it == s_.held.end()) {
      return;
    }
    shot_state(it->shot) = ShotState::committed;
    ++s_.n_committed;
    ++s_.counters.commits;
    s_.failures = 0;
    s_.held.erase(it);
    drop(e.frame);
    s_.retry_disk_ns = kNever;
    clear_reason(kDiskFull);
    advance(std::nullopt);
  }

  void on(const event::CommitFault& e) {
    if (s_.plan == nullptr) {
      return;
    }
    ++s_.counters.commit_faults;
    s_.retry_disk_ns = t_ + kDiskRetryNs;
    add_reason(kDiskFull, "disk: " + e.what);
  }

  void on(const event::DiskGood&) {
    s_.retry_disk_ns = kNever;
    clear_reason(kDiskFull);
  }

  void on(const event::SessionFinished&) {
    if (s_.phase != Phase::finalise) {
      return;
    }
    s_.is_finished = true;
    s_.reasons = 0;
    s_.retry_disk_ns = kNever;
    stop_camera();
    enter(Phase::done, fmt::format("{} shots", s_.shots.size()));
  }

  /// Sets the next Tick; ends an abort that waits for nothing any more.
  void close_step() {
    if (s_.phase == Phase::aborting) {
      finish_abort();
    }
    s_.deadline_ns =
        std::min({s_.retry_light_ns, s_.retry_camera_ns, s_.retry_disk_ns, s_.retry_evidence_ns,
                  s_.retry_held_ns, s_.shot_deadline_ns, s_.abort_deadline_ns});
  }

 private:
  [[nodiscard]] const SequencedShot& shot_of(int i) const {
    return s_.plan->shots[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] ShotState& shot_state(int i) { return s_.shots[static_cast<std::size_t>(i)]; }
  [[nodiscard]] std::vector<SequencerState::Held>::iterator find_held(std::uint64_t frame) {
    return std::find_if(s_.held.begin(), s_.held.end(),
                        [frame](const SequencerState::Held& h) { return h.frame == frame; });
  }
  [[nodiscard]] bool is_shooting() const {
    return s_.phase == Phase::preflight || s_.phase == Phase::running ||
           s_.phase == Phase::suspended;
  }

  bool due(std::int64_t& deadline_ns) const {
    if (deadline_ns > t_) {
      return false;
    }
    deadline_ns = kNever;
    return true;
  }

  void log(std::string kind, std::string text, int shot = -1) {
    out_.emplace_back(action::LogEvent{std::move(kind), std::move(text), shot});
  }
  void drop(std::uint64_t frame) { out_.emplace_back(action::DropFrame{frame}); }

  void enter(Phase phase, const std::string& why) {
    s_.phase = phase;
    log("state", fmt::format("{}: {}", to_string(phase), why));
  }

  // ---- the run
  // -------------------------------------------------------------------------------

  /// Makes sure of light and camera, then runs. Also the way back from paused and safe-off.
  void preflight() {
    s_.phase = Phase::preflight;
    log("state", "preflight");
    prepare();
  }

  /// First the light, which connects dark; then the camera: so no frame of an unknown light
  /// comes.
  void prepare() {
    if (!s_.is_light_connected) {
      if (!s_.is_job_open) {
        connect_light();
      }
    } else if (!s_.is_camera_started && !s_.is_camera_starting) {
      start_camera();
    }
    preflight_done();
  }

  void preflight_done() {
    if (s_.reasons != 0) {
      enter(Phase::suspended, reasons_text(s_.reasons));
    } else if (s_.is_light_connected && s_.is_camera_started) {
      s_.reason_text.clear();
      enter(Phase::running,
            fmt::format("{} of {} shots to do", s_.pending.size(), s_.shots.size()));
      advance(std::nullopt);
    }
  }

  /// Shows the next shot when there is one and a buffer for it; else darkens, and finishes when
  /// all is committed. With `confirm` the light is asked about the last frame first.
  void advance(std::optional<ConfirmRequest> confirm) {
    if (s_.phase != Phase::running || s_.current >= 0) {
      if (confirm) {
        lights_off(confirm);
      }
      return;
    }
    const bool has_room =
        static_cast<int>(s_.held.size()) + (s_.awaiting ? 1 : 0) < s_.max_held;
    if (has_room && !s_.pending.empty()) {
      begin_shot(confirm);
    } else if (confirm || !s_.is_dark) {
      lights_off(confirm);
    } else if (s_.n_committed == static_cast<int>(s_.shots.size())) {
      enter(Phase::finalise, "all shots are committed");
      out_.emplace_back(action::FinishSession{});
    }
  }

  void begin_shot(std::optional<ConfirmRequest> confirm) {
    const int shot = s_.pending.front();
    s_.pending.pop_front();
    s_.current = shot;
    s_.step = ShotStep::light;
    s_.shot_deadline_ns = kNever;
    shot_state(shot) = ShotState::exposing;
    const double exposure_us = shot_of(shot).exposure_us;
    if (exposure_us != s_.exposure_asked_us) {
      s_.exposure_asked_us = exposure_us;
      s_.is_exposure_open = true;
      out_.emplace_back(action::SetExposure{++s_.exposure_request, exposure_us});
    }
    s_.is_dark = false;
    s_.is_job_open = true;
    out_.emplace_back(action::ShowShot{++s_.job, shot, shot_of(shot).tag, confirm});
  }

  void return_to_pending(int shot) {
    shot_state(shot) = ShotState::pending;
    s_.pending.push_front(shot);
  }

  /// The present shot is given up for now, without counting against it.
  void leave_shot() {
    if (s_.current >= 0) {
      return_to_pending(s_.current);
    }
    s_.current = -1;
    s_.step = ShotStep::none;
    s_.shot_deadline_ns = kNever;
    drop_early();
  }

  /// A try that failed. After some in a row another shot goes first; after many the run waits.
  void retry(int shot, const std::string& why) {
    ++s_.counters.retries;
    ++s_.failures;
    log("retry", why, shot);
    shot_state(shot) = ShotState::pending;
    if (s_.failures % kFailuresToRotate == 0) {
      s_.pending.push_back(shot);
    } else {
      s_.pending.push_front(shot);
    }
    if (s_.failures >= kFailuresToSuspend && s_.phase == Phase::running) {
      s_.retry_evidence_ns = t_ + kEvidenceRetryNs;
      add_reason(kNoEvidence, "no clean frame: " + why);
    }
  }

  void on_shot_timeout() {
    s_.shot_deadline_ns = kNever;
    if (s_.current < 0) {
      return;
    }
    if (s_.plan->is_preview) {
      abort("the preview ends after a minute");
      return;
    }
    ++s_.counters.shot_timeouts;
    const int shot = s_.current;
    s_.current = -1;
    s_.step = ShotStep::none;
    retry(shot, fmt::format("no clean frame in time, {} discarded", s_.discarded));
    advance(std::nullopt);
  }

  void add_reason(std::uint32_t reason, const std::string& text) {
    if ((s_.reasons & reason) == 0) {
      log("fault", text);
    }
    s_.reasons |= reason;
    s_.reason_text = text;
    if (s_.phase == Phase::running || s_.phase == Phase::preflight) {
      ++s_.counters.suspensions;
      leave_shot();
      enter(Phase::suspended, reasons_text(s_.reasons));
      darken();
    }
  }

  void clear_reason(std::uint32_t reason) {
    s_.reasons &= ~reason;
    if (s_.reasons == 0 && s_.phase == Phase::suspended) {
      preflight();
    }
  }

  /// A device is there (again).
  void became_ready(std::uint32_t reason) {
    const bool was_preflight = s_.phase == Phase::preflight;
    clear_reason(reason);
    if (was_preflight && s_.phase == Phase::preflight) {
      prepare();
    }
  }

  void abort(const std::string& why) {
    if (s_.phase == Phase::idle || s_.phase == Phase::done || s_.phase == Phase::aborting) {
      return;
    }
    s_.reason_text = why;
    enter(Phase::aborting, why);
    if (s_.plan != nullptr && !s_.plan->is_preview) {
      out_.emplace_back(action::MarkAborted{why});
    }
    leave_shot();
    s_.abort_deadline_ns = t_ + kAbortLimitNs;
    darken();
  }

  /// Idle as soon as the lights have answered and nothing is on its way to the disk, or when
  /// the limit is over: then what waits is forgotten, as nothing of it was promised.
  void finish_abort() {
    const bool is_over = t_ >= s_.abort_deadline_ns;
    const bool is_quiet = !s_.is_job_open && s_.held.empty() && !s_.awaiting;
    if (!is_over && !is_quiet) {
      return;
    }
    if (!s_.held.empty()) {
      out_.emplace_back(action::ForgetCommits{});
    }
    release_all_frames();
    stop_camera();
    if (s_.is_job_open) {
      s_.is_light_connected = false;  // no answer: connect afresh next time, which darkens
      s_.is_job_open = false;
    }
    s_.plan.reset();
    s_.pending.clear();
    s_.reasons = 0;
    s_.failures = 0;
    s_.retry_light_ns = s_.retry_camera_ns = s_.retry_disk_ns = s_.retry_evidence_ns =
        s_.retry_held_ns = kNever;
    s_.abort_deadline_ns = kNever;
    enter(Phase::idle, "aborted");
  }

  void release_all_frames() {
    for (const SequencerState::Held& held : s_.held) {
      drop(held.frame);
    }
    s_.held.clear();
    if (s_.awaiting) {
      drop(s_.awaiting->frame);
      s_.awaiting.reset();
    }
  }

  // ---- the light
  // -----------------------------------------------------------------------------

  void connect_light() {
    s_.retry_light_ns = kNever;
    s_.is_job_open = true;
    out_.emplace_back(action::ConnectLight{++s_.job});
  }

  void lights_off(std::optional<ConfirmRequest> confirm) {
    s_.is_dark = true;
    s_.is_job_open = true;
    out_.emplace_back(action::LightsOff{++s_.job, confirm});
  }

  /// Off if anything may be lit. A lost controller turns off by its lease.
  void darken() {
    if (s_.is_light_connected && !s_.is_dark) {
      lights_off(std::nullopt);
    }
  }

  void darken_always() {
    if (s_.is_light_connected || !s_.is_job_open) {
      lights_off(std::nullopt);
    }
  }

  void on_light_fault(Errc code, const std::string& what) {
    ++s_.counters.light_faults;
    ++s_.light_faults;
    s_.is_job_open = false;
    leave_shot();
    if (code == Errc::refused || code == Errc::unsupported) {
      abort("controller: " + what);
      return;
    }
    if (code == Errc::device_busy) {
      s_.retry_held_ns = t_ + kHeldRetryNs;
      s_.is_dark = false;  // what was lit before may be lit still
      add_reason(kHeldBack, "controller: " + what);
      return;
    }
    const bool was_connected = s_.is_light_connected;
    if (!was_connected || code == Errc::device_gone || s_.light_faults >= kLightFaultsToLose) {
      lose_controller("controller: " + what, t_ + backoff_ns(s_.light_faults));
      return;
    }
    log("light", what);
    s_.is_dark = false;  // unknown: off, or latched again
    if (s_.phase == Phase::running) {
      advance(std::nullopt);
    } else {
      darken();
    }
  }

  void lose_controller(const std::string& what, std::int64_t retry_ns) {
    s_.is_light_connected = false;
    s_.is_job_open = false;
    const bool is_needed = s_.plan != nullptr && s_.phase != Phase::done &&
                           s_.phase != Phase::idle && s_.phase != Phase::aborting;
    if (is_needed || s_.phase == Phase::safe_off) {
      s_.retry_light_ns = retry_ns;
      add_reason(kControllerLost, what);
    }
  }

  // ---- the camera
  // ----------------------------------------------------------------------------

  void start_camera() {
    s_.retry_camera_ns = kNever;
    if (s_.plan == nullptr) {
      return;
    }
    const int next = s_.pending.empty() ? 0 : s_.pending.front();
    s_.exposure_asked_us = shot_of(next).exposure_us;
    s_.is_camera_starting = true;
    out_.emplace_back(action::StartCamera{++s_.stream, s_.exposure_asked_us});
  }

  void stop_camera() {
    if (s_.is_camera_started || s_.is_camera_starting) {
      out_.emplace_back(action::StopCamera{});
    }
    s_.is_camera_started = false;
    s_.is_camera_starting = false;
    s_.camera_faults = 0;
    s_.retry_camera_ns = kNever;
  }

  bool check_exposure() {
    if (std::abs(s_.exposure_read_us - s_.exposure_asked_us) <=
        kExposureReadTol * s_.exposure_asked_us) {
      return true;
    }
    abort(fmt::format("camera: asked for an exposure of {} us, it set {} us",
                      s_.exposure_asked_us, s_.exposure_read_us));
    return false;
  }

  /// Keeps track of sequence and stamps; true when the frame by itself may be used.
  bool examine(const event::FrameArrived& e) {
    const FrameInfo& info = e.info;
    const std::size_t n_known = std::min(s_.n_hashes, s_.recent_hashes.size());
    const auto* const begin = s_.recent_hashes.data();
    const bool is_known = std::find(begin, begin + n_known, e.pixel_hash) != begin + n_known;
    s_.recent_hashes[s_.n_hashes % s_.recent_hashes.size()] = e.pixel_hash;
    ++s_.n_hashes;
    const bool is_first = !s_.has_sequence;
    const bool is_forward = is_first || (info.sequence > s_.last_sequence &&
                                         info.timestamp_ns > s_.last_timestamp_ns);
    if (!is_forward || info.timestamp_ns > t_ + kStampAheadNs) {
      ++s_.counters.frames_out_of_order;
      return false;
    }
    const bool is_gap = !is_first && info.sequence != s_.last_sequence + 1;
    s_.has_sequence = true;
    s_.last_sequence = info.sequence;
    s_.last_timestamp_ns = info.timestamp_ns;
    s_.camera_faults = 0;
    if (is_gap) {
      ++s_.counters.sequence_gaps;
    }
    const bool is_damaged =
        (info.flags & (kFrameError | kFrameShort)) != 0 || (info.flags & kFrameMonotonic) == 0;
    if (is_damaged) {
      ++s_.counters.frames_damaged;
      return false;
    }
    if (is_known && e.must_differ) {
      ++s_.counters.duplicates;
      return false;
    }
    // Without the strobe's count the stamp alone decides: a lost neighbour takes nothing from
    // it.
    return !is_gap || (s_.plan != nullptr && s_.plan->sync == SyncMode::free_run);
  }

  /// Takes the frame for the present shot, or gives it back.
  void judge(const event::FrameArrived& e) {
    const bool is_collecting = s_.current >= 0 && !s_.awaiting &&
                               (s_.step == ShotStep::settle || s_.step == ShotStep::collect);
    if (is_collecting && t_ >= s_.t_stable_ns) {
      s_.step = ShotStep::collect;
    }
    if (s_.plan->is_preview) {
      drop(e.frame);
      return;
    }
    if (!is_collecting || !is_exposed_as_asked(e.info) || !accept(e)) {
      ++s_.discarded;
      ++s_.counters.frames_unused;
      drop(e.frame);
    }
  }

  void drop_early() {
    for (const event::FrameArrived& frame : std::exchange(s_.early, {})) {
      drop(frame.frame);
      ++s_.counters.frames_unused;
    }
  }

  bool is_exposed_as_asked(const FrameInfo& info) {
    const bool is_right =
        !s_.is_exposure_open &&
        std::abs(info.exposure_us - s_.exposure_read_us) <= kExposureTol * s_.exposure_read_us;
    if (!is_right) {
      ++s_.counters.wrong_exposure;
    }
    return is_right;
  }

  /// Takes a frame whose stamp proves a clean exposure; the controller is asked next.
  bool accept(const event::FrameArrived& e) {
    const SequencerPlan& plan = *s_.plan;
    const SequencedShot& shot = shot_of(s_.current);
    const ExposureWindow window = exposure_window({.timestamp_ns = e.info.timestamp_ns,
                                                   .meaning = plan.timestamp,
                                                   .exposure_us = e.info.exposure_us,
                                                   .read_us = plan.read_us,
                                                   .skew_us = plan.skew_us});
    if (!judge_clean(window, s_.t_stable_ns, t_).is_clean) {
      return false;
    }
    FrameEvidence evidence;
    evidence.pattern_id = shot.pattern_id;
    evidence.tag = shot.tag;
    evidence.tag_echo = s_.receipt.tag_echo;
    evidence.t_command_ns = s_.receipt.t_command_ns;
    evidence.t_ack_ns = s_.receipt.t_ack_ns;
    evidence.t_stable_ns = s_.t_stable_ns;
    evidence.t_exposure_start_ns = window.start_ns;
    evidence.t_exposure_end_ns = window.end_ns;
    evidence.sequence = e.info.sequence;
    evidence.timestamp_ns = e.info.timestamp_ns;
    evidence.timestamp_meaning = plan.timestamp;
    evidence.flags = e.info.flags;
    evidence.exposure_asked_us = shot.exposure_us;
    evidence.exposure_read_us = e.info.exposure_us;
    evidence.gain_db = e.info.gain_db;
    evidence.read_us = plan.read_us;
    evidence.skew_us = plan.skew_us;
    evidence.discarded_before = s_.discarded;
    evidence.sync = plan.sync;
    const int i_shot = s_.current;
    const int attempt = s_.attempts[static_cast<std::size_t>(i_shot)]++;
    s_.current = -1;
    s_.step = ShotStep::none;
    s_.shot_deadline_ns = kNever;
    // The job that asks about this frame is the next one that advance() issues.
    s_.awaiting =
        SequencerState::Awaiting{e.frame, s_.job + 1, i_shot, attempt, std::move(evidence)};
    advance(ConfirmRequest{e.frame, shot.tag});
    return true;
  }

  SequencerState& s_;
  std::int64_t t_;
  std::vector<Action>& out_;
};

}  // namespace

StepResult step(SequencerState state, const TimedEvent& event) {
  StepResult result{std::move(state), {}};
  Stepper stepper(result.state, event.t_ns, result.actions);
  std::visit([&stepper](const auto& body) { stepper.on(body); }, event.body);
  stepper.close_step();
  return result;
}

}  // namespace haarlight
