#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "capture/camera.h"
#include "firmware_iface/light_array.h"
#include "session/evidence.h"

/// @file
/// The heart of the daemon as a pure function: step(state, event) -> (state, actions). No
/// clock, no I/O, no randomness: time arrives in events, so a capture with any fault replays
/// exactly.
///
/// A frame is committed to a shot only when (1) the controller echoed the shot's tag after the
/// latch, (2) the camera's stamp puts its exposure after t_stable, (3) the controller, asked
/// again after the exposure's end, still shows that tag in the same boot, (4) it came in
/// sequence, with no damage flag, in the exposure asked, and is not a picture seen before, and
/// (5) the pixel checks pass. The diagram is in capture/README.md.

namespace haarlight {

enum class Phase {
  boot,
  recover,
  idle,
  preflight,
  running,
  paused,
  suspended,
  aborting,
  finalise,
  done,
  safe_off,
};
[[nodiscard]] std::string_view to_string(Phase phase) noexcept;

/// Where the present shot stands while running; checks and commits of earlier shots go on
/// beside.
enum class ShotStep { none, light, settle, collect };
[[nodiscard]] std::string_view to_string(ShotStep step) noexcept;

// SuspendReason: why a run is suspended; bits of SequencerState::reasons. Each ends by itself.
inline constexpr std::uint32_t kCameraLost = 1U << 0U;      ///< retried with growing delay
inline constexpr std::uint32_t kControllerLost = 1U << 1U;  ///< retried with growing delay
inline constexpr std::uint32_t kDiskFull = 1U << 2U;  ///< the commit is repeated every second
/// Many frames, none clean: tried again every two seconds.
inline constexpr std::uint32_t kNoEvidence = 1U << 3U;
/// The controller says not now (interlock, temperature, an element's rest): asked every second.
inline constexpr std::uint32_t kHeldBack = 1U << 4U;
/// "camera, disk"
[[nodiscard]] std::string reasons_text(std::uint32_t reasons);

enum class ShotState : std::uint8_t { pending, exposing, checking, committing, committed };
[[nodiscard]] std::string_view to_string(ShotState state) noexcept;

struct SequencedShot {
  std::uint32_t tag = 0;  ///< what the controller echoes; never 0
  double exposure_us = 0.0;
  int pattern_id = 0;
};

/// Everything that does not change during a run.
struct SequencerPlan {
  /// One shot, shown for people: no frame is taken, it ends by itself after a minute.
  bool is_preview = false;
  std::vector<SequencedShot> shots;
  SyncMode sync = SyncMode::free_run;
  TimestampMeaning timestamp = TimestampMeaning::end_frame;
  double read_us = 0.0;
  double skew_us = 0.0;
  double frame_us = 0.0;       ///< frame period
  std::int64_t settle_ns = 0;  ///< guard included, see capture/timing.h
  int max_held = 8;            ///< frames being checked or committed, at most
};

/// The lowest tag of a plan's shots; shot i has kFirstTag + i.
inline constexpr std::uint32_t kFirstTag = 1;

struct ConfirmRequest {
  std::uint64_t frame = 0;
  std::uint32_t tag = 0;
  friend bool operator==(const ConfirmRequest&, const ConfirmRequest&) = default;
};

// ---- actions: what the world is asked to do
// --------------------------------------------------

namespace action {
/// Connect (or connect again), all off, answer LightConnected or LightFault.
struct ConnectLight {
  std::uint64_t job = 0;
};
/// First, with `confirm`: read the status and answer LightConfirmed; go on only when it still
/// shows that tag. Then latch the shot's pattern, answer LightShown or LightFault.
struct ShowShot {
  std::uint64_t job = 0;
  int shot = 0;
  std::uint32_t tag = 0;
  std::optional<ConfirmRequest> confirm;
};
/// As ShowShot, but all off; answers LightDark.
struct LightsOff {
  std::uint64_t job = 0;
  std::optional<ConfirmRequest> confirm;
};
/// Open, set up and stream (again); answers CameraStarted or CameraFault.
struct StartCamera {
  std::uint64_t stream = 0;  ///< named by all that this stream reports
  double exposure_us = 0.0;
};
struct StopCamera {};
/// Answers ExposureSet or CameraFault.
struct SetExposure {
  std::uint64_t request = 0;
  double exposure_us = 0.0;
};
/// Give the frame's buffer back.
struct DropFrame {
  std::uint64_t frame = 0;
};
/// Pixel checks; answers FrameChecked.
struct CheckFrame {
  std::uint64_t frame = 0;
  int shot = 0;
  int attempt = 0;
  FrameEvidence evidence;
};
/// To the writer; answers FrameCommitted, or CommitFault once for all that wait.
struct CommitFrame {
  std::uint64_t frame = 0;
  int shot = 0;
  int attempt = 0;
  FrameEvidence evidence;
};
/// Try the waiting commits and withdrawals again; answers CommitFault or DiskGood, after a
/// FrameCommitted for each frame.
struct RetryCommits {};
/// Forget the waiting commits (the run was aborted); their frames are dropped besides.
struct ForgetCommits {};
/// Their frames are wanted no more: new ones follow. Answers CommitFault when the disk cannot.
struct WithdrawShots {
  std::vector<int> shots;
};
/// The run was given up: it does not go on by itself at the daemon's next start.
struct MarkAborted {
  std::string why;
};
/// Write session.json; answers SessionFinished or CommitFault.
struct FinishSession {};
/// A line for the journal and the event stream. `kind` is one word.
struct LogEvent {
  std::string kind;
  std::string text;
  int shot = -1;
};
}  // namespace action

using Action = std::variant<action::ConnectLight, action::ShowShot, action::LightsOff,
                            action::StartCamera, action::StopCamera, action::SetExposure,
                            action::DropFrame, action::CheckFrame, action::CommitFrame,
                            action::RetryCommits, action::ForgetCommits, action::WithdrawShots,
                            action::MarkAborted, action::FinishSession, action::LogEvent>;

// ---- events: what the world reports
// ----------------------------------------------------------

namespace event {
struct Tick {};
/// Devices' threads are up; recovery of unfinished sessions begins.
struct Booted {};
/// Nothing (more) to recover.
struct Recovered {};
/// A session was made or reopened: shoot what is not committed. While all is off by request,
/// not before a Resume.
struct Run {
  std::shared_ptr<const SequencerPlan> plan;
  std::vector<bool> committed;
  std::vector<int> next_attempt;
};
struct Pause {};
struct Resume {};
struct Abort {};
struct SafeOff {};
struct Reshoot {
  std::vector<int> shots;
};
struct LightConnected {
  std::uint64_t job = 0;
  std::uint32_t boot_id = 0;
};
struct LightShown {
  std::uint64_t job = 0;
  LatchReceipt receipt;
};
struct LightDark {
  std::uint64_t job = 0;
};
/// The status read before the lights changed.
struct LightConfirmed {
  std::uint64_t frame = 0;
  std::int64_t t_request_ns = 0;  ///< just before the status was asked
  std::uint32_t tag = 0;          ///< shown then
  std::uint32_t boot_id = 0;
  std::optional<double> temperature_c{};  ///< of the controller
};
/// A job that failed; job 0: the lease could not be renewed.
struct LightFault {
  std::uint64_t job = 0;
  Errc code = Errc::io;
  std::string what;
};
struct CameraStarted {
  std::uint64_t stream = 0;
  double exposure_us = 0.0;  ///< as read back
  int n_buffers = 0;
};
struct ExposureSet {
  std::uint64_t request = 0;
  double exposure_us = 0.0;  ///< as read back
};
struct CameraFault {
  std::uint64_t stream = 0;
  Errc code = Errc::io;
  std::string what;
};
struct FrameArrived {
  std::uint64_t frame = 0;  ///< the world's name for the buffer
  std::uint64_t stream = 0;
  FrameInfo info;
  std::uint64_t pixel_hash = 0;  ///< of the active rows
  bool must_differ = true;  ///< false: every pixel is clipped, two such frames may coincide
};
struct FrameChecked {
  std::uint64_t frame = 0;
  int shot = 0;
  FrameEvidence evidence;                     ///< completed
  std::string problem;                        ///< empty: good
  FrameVerdict verdict = FrameVerdict::good;  ///< which kind of problem
};
struct FrameCommitted {
  std::uint64_t frame = 0;
  int shot = 0;
};
struct CommitFault {
  Errc code = Errc::io;
  std::string what;
};
/// Nothing waits for the disk any more.
struct DiskGood {};
struct SessionFinished {};
}  // namespace event

using EventBody = std::variant<
    event::Tick, event::Booted, event::Recovered, event::Run, event::Pause, event::Resume,
    event::Abort, event::SafeOff, event::Reshoot, event::LightConnected, event::LightShown,
    event::LightDark, event::LightConfirmed, event::LightFault, event::CameraStarted,
    event::ExposureSet, event::CameraFault, event::FrameArrived, event::FrameChecked,
    event::FrameCommitted, event::CommitFault, event::DiskGood, event::SessionFinished>;

struct TimedEvent {
  std::int64_t t_ns = 0;  ///< never before that of the last event
  EventBody body;
};

// ---- state
// -----------------------------------------------------------------------------------

/// Counted since the start; exported at /metrics.
struct SequencerCounters {
  std::uint64_t frames = 0;
  std::uint64_t frames_unused = 0;   ///< not wholly under one settled pattern, or not wanted
  std::uint64_t frames_damaged = 0;  ///< flags, short
  std::uint64_t sequence_gaps = 0;
  std::uint64_t frames_out_of_order = 0;
  std::uint64_t duplicates = 0;
  std::uint64_t wrong_exposure = 0;
  std::uint64_t checks_failed = 0;
  std::uint64_t confirms_failed = 0;  ///< the light changed by itself
  std::uint64_t retries = 0;          ///< shots shown again
  std::uint64_t shot_timeouts = 0;
  std::uint64_t light_faults = 0;
  std::uint64_t camera_faults = 0;
  std::uint64_t commit_faults = 0;
  std::uint64_t controller_reboots = 0;
  std::uint64_t suspensions = 0;
  std::uint64_t commits = 0;
};

inline constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();

/// All that the sequencer knows. Plain data; copyable.
struct SequencerState {  // NOLINT(clang-analyzer-optin.performance.Padding): sorted for readers
  Phase phase = Phase::boot;
  std::uint32_t reasons = 0;          ///< SuspendReason bits
  std::string reason_text;            ///< of the newest suspension or refusal, for people
  std::int64_t deadline_ns = kNever;  ///< a Tick is wanted then

  std::shared_ptr<const SequencerPlan> plan;
  std::vector<ShotState> shots;
  std::vector<int> attempts;  ///< next attempt's number of each shot
  std::deque<int> pending;
  int n_committed = 0;
  bool is_finished = false;  ///< session.json stands

  // The present shot.
  int current = -1;
  ShotStep step = ShotStep::none;
  LatchReceipt receipt;
  std::int64_t t_stable_ns = 0;
  std::int64_t shot_deadline_ns = kNever;
  int discarded = 0;
  /// Frames that came before the latch's acknowledgement was told; judged when it is.
  std::vector<event::FrameArrived> early;
  int failures = 0;  ///< shots tried in a row without a commit

  // The light. At most one job matters: the newest.
  bool is_light_connected = false;
  bool is_dark = true;    ///< the newest job leaves the lights off
  std::uint64_t job = 0;  ///< number of the newest job
  bool is_job_open = false;
  std::uint32_t boot_id = 0;
  int light_faults = 0;  ///< in a row
  std::int64_t retry_light_ns = kNever;

  /// A frame accepted by its stamp that waits for the controller's word.
  struct Awaiting {
    std::uint64_t frame = 0;
    std::uint64_t job = 0;
    int shot = 0;
    int attempt = 0;
    FrameEvidence evidence;
  };
  std::optional<Awaiting> awaiting;

  // The camera.
  bool is_camera_started = false;
  bool is_camera_starting = false;
  std::uint64_t stream = 0;            ///< the newest
  std::uint64_t exposure_request = 0;  ///< the newest
  bool is_exposure_open = false;       ///< SetExposure not answered yet
  double exposure_asked_us = 0.0;
  double exposure_read_us = 0.0;
  bool has_sequence = false;
  std::uint64_t last_sequence = 0;
  std::int64_t last_timestamp_ns = 0;
  std::array<std::uint64_t, 32> recent_hashes{};  ///< more than a camera has buffers
  std::size_t n_hashes = 0;
  int camera_faults = 0;  ///< in a row
  std::int64_t retry_camera_ns = kNever;

  /// A frame being checked or committed.
  struct Held {
    std::uint64_t frame = 0;
    int shot = 0;
    int attempt = 0;
  };
  std::vector<Held> held;
  int max_held = 1;
  std::int64_t retry_disk_ns = kNever;
  std::int64_t retry_evidence_ns = kNever;
  std::int64_t retry_held_ns = kNever;
  std::int64_t abort_deadline_ns = kNever;

  SequencerCounters counters;
};

struct StepResult {
  SequencerState state;
  std::vector<Action> actions;
};

/// One step. Pure: equal arguments give equal results. Never blocks, O(1) but for Run and
/// Reshoot. Unknown, late or repeated answers are ignored; a frame that an action does not keep
/// is dropped.
[[nodiscard]] StepResult step(SequencerState state, const TimedEvent& event);

}  // namespace haarlight
