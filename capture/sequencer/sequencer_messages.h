// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "capture/camera/camera.h"
#include "haarlight/firmware_iface/light_array.h"
#include "haarlight/session/evidence.h"
#include "session/event_kind.h"

/// @file
/// The sequencer's inputs and outputs: the plan of a run, events (what the world reports) and
/// actions (what the world should do). Plain data.

namespace haarlight::capture {

struct SequencedShot {
  std::uint32_t tag = 0;  ///< what the controller echoes; never 0
  double exposure_us = 0.0;
  int pattern_id = 0;
  bool is_dark = false;  ///< a dark frame
};

/// Everything that does not change during a run.
struct SequencerPlan {
  /// One shot, shown for the operator: no frame is taken, it ends by itself after a minute.
  bool is_preview = false;
  std::vector<SequencedShot> shots;
  SyncMode sync = SyncMode::free_run;
  TimestampMeaning timestamp = TimestampMeaning::end_frame;
  double read_us = 0.0;
  double skew_us = 0.0;
  double frame_us = 0.0;       ///< frame period
  std::int64_t settle_ns = 0;  ///< guard included, see capture/plan/timing.h
  int max_held = 8;            ///< frames being checked or committed, at most
  /// Controller leads: from a latch to the pulse on the camera's trigger line; 0: unknown.
  std::int64_t trigger_delay_ns = 0;
  /// Camera leads: the table steps at every n-th strobe. E + skew + settle <= n frame periods.
  int strobe_every = 1;
  int table_depth = 1024;  ///< camera leads: patterns uploaded at once, at most
  /// A dark frame is taken early when the controller's temperature is this far from that of the
  /// last one, degrees C; 0 = never.
  double darks_every_c = 0.0;
};

/// The lowest tag of a plan's shots; shot i has kFirstTag + i.
inline constexpr std::uint32_t kFirstTag = 1;

struct ConfirmRequest {
  std::uint64_t frame = 0;
  std::uint32_t tag = 0;
  friend bool operator==(const ConfirmRequest&, const ConfirmRequest&) = default;
};

// ---- actions: what the world should do ----

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
/// Camera leads: store these shots' patterns and tags in the controller's table; answers
/// TableUploaded or LightFault. The lights are off meanwhile.
struct UploadTable {
  std::uint64_t job = 0;
  std::vector<int> shots;
  std::vector<std::uint32_t> tags;
};
/// Camera leads: arm `count` entries from `first` on for the strobe; answers BlockArmed or
/// LightFault, then StepRead again and again, a few times per frame, until the next job.
struct ArmBlock {
  std::uint64_t job = 0;
  int first = 0;
  int count = 0;
  int every = 1;
};
/// Camera leads: `count` entries in all are now armed. Answers only LightFault with the block's
/// job; StepRead reports the outcome.
struct ExtendBlock {
  std::uint64_t job = 0;  ///< of the block
  int count = 0;
};
/// Like ShowShot, but all off; answers LightDark.
struct LightsOff {
  std::uint64_t job = 0;
  std::optional<ConfirmRequest> confirm;
};
/// Open, set up and stream (again); answers CameraStarted or CameraFault.
struct StartCamera {
  std::uint64_t stream = 0;  ///< identifies all reports of this stream
  double exposure_us = 0.0;
  SyncMode sync = SyncMode::free_run;  ///< what starts an exposure
};
struct StopCamera {};
/// Light leads: expose one frame now. Answered by the frame, or CameraFault.
struct TriggerCamera {};
/// Answers ExposureSet or CameraFault.
struct SetExposure {
  std::uint64_t request = 0;
  double exposure_us = 0.0;
};
/// Return the frame's buffer.
struct DropFrame {
  std::uint64_t frame = 0;
};
/// Pixel checks; answers FrameChecked.
struct CheckFrame {
  std::uint64_t frame = 0;
  int shot = 0;
  int attempt = 0;
  session::FrameEvidence evidence;
};
/// To the writer; answers FrameCommitted, or CommitFault once for all that wait.
struct CommitFrame {
  std::uint64_t frame = 0;
  int shot = 0;
  int attempt = 0;
  session::FrameEvidence evidence;
};
/// Retry the waiting commits and withdrawals; answers CommitFault or DiskGood, after a
/// FrameCommitted for each frame.
struct RetryCommits {};
/// Forget the waiting commits (the run was aborted); their frames are also dropped.
struct ForgetCommits {};
/// Their frames are obsolete: new ones follow. Answers CommitFault when the disk cannot.
struct WithdrawShots {
  std::vector<int> shots;
};
/// The run was aborted: do not resume it at the daemon's next start.
struct MarkAborted {
  std::string why;
};
/// Write session.json; answers SessionFinished or CommitFault.
struct FinishSession {};
/// A line for the journal and the event stream.
struct LogEvent {
  session::EventKind kind = session::EventKind::state;
  std::string text;
  int shot = -1;
};
}  // namespace action

using Action =
    std::variant<action::ConnectLight, action::ShowShot, action::UploadTable, action::ArmBlock,
                 action::ExtendBlock, action::LightsOff, action::StartCamera,
                 action::StopCamera, action::TriggerCamera, action::SetExposure,
                 action::DropFrame, action::CheckFrame, action::CommitFrame,
                 action::RetryCommits, action::ForgetCommits, action::WithdrawShots,
                 action::MarkAborted, action::FinishSession, action::LogEvent>;

// ---- events: what the world reports ----

namespace event {
struct Tick {};
/// The devices' threads are up; recovery of unfinished sessions begins.
struct Booted {};
/// Nothing (more) to recover.
struct Recovered {};
/// A session was created or reopened: capture what is not committed. While all is off by
/// request, not before a Resume.
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
  int table_depth = 0;  ///< patterns that its table holds; 0: it has none
};
struct LightShown {
  std::uint64_t job = 0;
  firmware_iface::LatchReceipt receipt;
};
struct LightDark {
  std::uint64_t job = 0;
};
struct TableUploaded {
  std::uint64_t job = 0;
};
struct BlockArmed {
  std::uint64_t job = 0;
  firmware_iface::LatchReceipt receipt;  ///< of the arming; its tag is 0
};
/// The controller's status while a block is armed: some instant between request and answer.
struct StepRead {
  std::uint64_t job = 0;
  std::int64_t t_request_ns = 0;
  std::int64_t t_ack_ns = 0;
  std::uint32_t step_counter = 0;
  std::uint32_t tag = 0;
  std::uint32_t boot_id = 0;
  bool is_armed = false;
  bool is_done = false;                   ///< stepped past the last armed entry
  std::uint32_t faults = 0;               ///< registers::kFault... bits
  std::optional<double> temperature_c{};  ///< of the controller
};
/// The status read before the lights changed.
struct LightConfirmed {
  std::uint64_t frame = 0;
  std::int64_t t_request_ns = 0;  ///< just before the status was requested
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
  std::uint64_t frame = 0;  ///< identifies the buffer
  std::uint64_t stream = 0;
  FrameInfo info;
  std::uint64_t pixel_hash = 0;  ///< of the active rows
  bool must_differ = true;  ///< false: every pixel is clipped, so two such frames may coincide
};
struct FrameChecked {
  std::uint64_t frame = 0;
  int shot = 0;
  session::FrameEvidence evidence;                              ///< completed
  std::string problem;                                          ///< empty: good
  session::FrameVerdict verdict = session::FrameVerdict::good;  ///< which kind of problem
  std::vector<int> doubted{};  ///< earlier shots that this picture contradicts: to be retaken
  std::string note{};          ///< for the log
};
struct FrameCommitted {
  std::uint64_t frame = 0;
  int shot = 0;
};
/// device_gone: the session's folder is gone; refused, protocol: the session can never accept
/// the request; others: the disk.
struct CommitFault {
  Errc code = Errc::io;
  std::string what;
};
/// Nothing is waiting for the disk any more.
struct DiskGood {};
struct SessionFinished {};
}  // namespace event

using EventBody = std::variant<
    event::Tick, event::Booted, event::Recovered, event::Run, event::Pause, event::Resume,
    event::Abort, event::SafeOff, event::Reshoot, event::LightConnected, event::LightShown,
    event::LightDark, event::TableUploaded, event::BlockArmed, event::StepRead,
    event::LightConfirmed, event::LightFault, event::CameraStarted, event::ExposureSet,
    event::CameraFault, event::FrameArrived, event::FrameChecked, event::FrameCommitted,
    event::CommitFault, event::DiskGood, event::SessionFinished>;

struct TimedEvent {
  std::int64_t t_ns = 0;  ///< never before that of the previous event
  EventBody body;
};

inline constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();

}  // namespace haarlight::capture
