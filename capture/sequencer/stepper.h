// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/sequencer/sequencer.h"

/// @file
/// The internals of capture/sequencer/sequencer.h: one event's effect on the state. Its methods
/// are divided by concept into sequencer.cpp (phases), sequencer_shot.cpp (one pattern at a
/// time), sequencer_block.cpp (the strobe steps a table), sequencer_light.cpp,
/// sequencer_camera.cpp and sequencer_disk.cpp. Included by these alone.

namespace haarlight::capture {

namespace sequencing {

inline constexpr std::int64_t kMs = 1'000'000;
inline constexpr std::int64_t kFirstBackoffNs = 100 * kMs;
inline constexpr std::int64_t kLastBackoffNs = 2000 * kMs;
inline constexpr std::int64_t kDiskRetryNs = 1000 * kMs;
inline constexpr std::int64_t kEvidenceRetryNs = 2000 * kMs;
inline constexpr std::int64_t kHeldRetryNs = 1000 * kMs;
inline constexpr std::int64_t kWrongLightRetryNs = 2'000 * kMs;
inline constexpr int kWrongLightsToSuspend = 2;  ///< withdrawals of one shot
/// An abort is guaranteed within 200 ms; the rest is for the threads and the answer.
inline constexpr std::int64_t kAbortLimitNs = 150 * kMs;
/// In addition to the frames: late delivery, a busy host.
inline constexpr std::int64_t kShotSlackNs = 300 * kMs;
inline constexpr std::int64_t kPreviewNs = 60'000 * kMs;
inline constexpr double kShotFrames = 8.0;  ///< frame times without a clean frame: shown again
/// Until a camera's period is known: its first frame may come late, and half of the frames be
/// lost.
inline constexpr std::int64_t kRhythmSlackNs = 3000 * kMs;
inline constexpr double kRhythmFrames = 4.0 * FrameRhythm::kFirst;
inline constexpr std::size_t kMaxEarly = 4;  ///< frames kept until the latch's answer arrives
inline constexpr int kLightFaultsToLose = 3;
inline constexpr int kRefusalsToEnd = 4;  ///< a stray answer does not occur four times in a row
inline constexpr int kFailuresToRotate = 4;       ///< the next shot is tried first
inline constexpr int kBlocksToSuspend = 6;        ///< in a row, without a proven frame
inline constexpr int kFailuresToSuspend = 24;     ///< in a row, without a commit
inline constexpr double kExposureTol = 0.005;     ///< frame against read-back: sent as a float
inline constexpr double kExposureReadTol = 0.05;  ///< read-back against requested: row steps
inline constexpr int kSpareBuffers = 3;           ///< for frames that are not held

[[nodiscard]] std::int64_t backoff_ns(int faults);

}  // namespace sequencing

class Stepper {
 public:
  Stepper(SequencerState& state, std::int64_t t_ns, std::vector<Action>& actions)
      : s_(state), t_(t_ns), out_(actions) {}

  void on(const event::Tick&);
  void on(const event::Booted&);
  void on(const event::Recovered&);
  void on(const event::Run& run);
  void on(const event::Pause&);
  void on(const event::Resume&);
  void on(const event::Abort&);
  void on(const event::SafeOff&);
  void on(const event::Reshoot& reshoot);
  void on(const event::LightShown& e);
  void on(const event::LightConfirmed& e);
  void on(const event::LightConnected& e);
  void on(const event::LightDark& e);
  void on(const event::LightFault& e);
  void on(const event::CameraStarted& e);
  void on(const event::ExposureSet& e);
  void on(const event::CameraFault& e);
  void on(const event::FrameArrived& e);
  void on(const event::FrameChecked& e);
  void on(const event::FrameCommitted& e);
  void on(const event::CommitFault& e);
  void on(const event::DiskGood&);
  void on(const event::SessionFinished&);
  void on(const event::TableUploaded& e);
  void on(const event::BlockArmed& e);
  void on(const event::StepRead& e);
  /// Sets the next Tick; ends an abort that has nothing left to wait for.
  void close_step();

 private:
  [[nodiscard]] const SequencedShot& shot_of(int i) const {
    return s_.plan->shots[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] ShotState& shot_state(int i) { return s_.shots[static_cast<std::size_t>(i)]; }
  void drop(std::uint64_t frame) { out_.emplace_back(action::DropFrame{frame}); }

  // sequencer.cpp
  [[nodiscard]] std::vector<SequencerState::Held>::iterator find_held(std::uint64_t frame);
  [[nodiscard]] bool is_shooting() const;
  bool due(std::int64_t& deadline_ns) const;
  void log(session::EventKind kind, std::string text, int shot = -1);
  void enter(Phase phase, const std::string& why);
  /// Ensures that light and camera are ready, then runs. Also the way back from paused and
  /// safe-off.
  void preflight();
  /// First the light, which connects dark; then the camera: so no frame of an unknown light
  /// arrives.
  void prepare();
  /// Runs when light and camera are ready and the camera's period is known; waits in the dark
  /// for whatever is missing.
  void preflight_done();
  /// Shows the next shot when there is one and a buffer for it; otherwise goes dark, and
  /// finishes when all is committed. With `confirm` the light first answers for the last frame.
  void advance(std::optional<ConfirmRequest> confirm);
  /// The controller's temperature while a shot's frame was exposed.
  void note_temperature(std::optional<double> temperature_c, int shot);
  /// Dark frames by temperature: the pending dark that should come now. It is the last but one
  /// left of this exposure: the spare ones are at the end, and one is kept for it.
  [[nodiscard]] std::optional<int> dark_due() const;
  void draw_dark();
  /// @param shot  that was in progress; -1: none
  void add_reason(std::uint32_t reason, const std::string& text, int shot);
  /// Shown now, or what the table was last read to show; -1: none.
  [[nodiscard]] int shot_under_way() const;
  void clear_reason(std::uint32_t reason);
  /// A device is ready (again).
  void became_ready(std::uint32_t reason);
  void abort(const std::string& why);
  /// Idle as soon as the lights have answered and nothing is on its way to the disk, or at the
  /// time limit: then what waits is discarded, as none of it was promised.
  void finish_abort();
  void release_all_frames();
  /// Committed shots become pending again, and their frames are withdrawn.
  /// @return  whether there was one
  bool withdraw(const std::vector<int>& shots);
  /// Those of the doubted shots that are committed by now.
  void withdraw_doubted();
  void suspend_for_light(const std::string& problem, int shot);

  // sequencer_shot.cpp
  void begin_shot(std::optional<ConfirmRequest> confirm);
  void return_to_pending(int shot);
  /// The current shot is abandoned for now, without counting against it.
  void leave_shot();
  /// A failed attempt. After some in a row another shot goes first; after many the run waits.
  void retry(int shot, const std::string& why);
  void on_shot_timeout();
  /// Accepts the frame for the current shot, or returns it.
  void validate(const SequencerState::TimestampedFrame& timestamped);
  /// A frame of the current shot was refused: in the triggered modes no other comes by itself.
  void ask_again(const event::FrameArrived& e);
  /// Light leads: the light has settled, and no open trigger's exposure can be mistaken for the
  /// next.
  [[nodiscard]] std::int64_t next_trigger_ns() const;
  /// Controller leads: a pulse of an abandoned latch may still come.
  [[nodiscard]] bool is_pulse_open() const;
  /// The light thread ended the newest job, and with it all earlier ones: where nothing was
  /// read back a latch among them acts within kShownWithinNs from now, or never.
  void note_job_end();
  void drop_early();
  /// Accepts a frame whose timestamp proves a clean exposure; the controller is queried next.
  bool accept(const SequencerState::TimestampedFrame& timestamped);
  /// What the mode implies for an exposure's start without the timestamp: not before its
  /// trigger.
  [[nodiscard]] std::int64_t earliest_start_ns() const;
  /// What camera and plan say about a frame; the light's part is missing.
  [[nodiscard]] session::FrameEvidence describe_frame(
      const event::FrameArrived& e, int shot, const session::ExposureWindow& window) const;

  // sequencer_light.cpp
  void connect_light();
  void lights_off(std::optional<ConfirmRequest> confirm);
  /// Turns off if anything may be lit. A lost controller turns off by its lease.
  void darken();
  void darken_always();
  void on_light_fault(Errc code, const std::string& what);
  void lose_controller(const std::string& what, std::int64_t retry_ns, int shot);

  // sequencer_camera.cpp
  void start_camera();
  void stop_camera();
  bool check_exposure();
  /// Tracks sequence and timestamps. Returns how close the frame's timestamp is to its moment,
  /// when it is usable by itself.
  [[nodiscard]] std::optional<std::int64_t> examine(const event::FrameArrived& e);
  /// The same for its timestamp among those of its stream.
  [[nodiscard]] std::optional<std::int64_t> examine_rhythm(const FrameInfo& info);
  void refuse_timestamp(const FrameInfo& info);
  bool is_exposed_as_requested(const FrameInfo& info);

  // sequencer_block.cpp
  /// Arms, extends or ends what the strobe steps; finishes when all is committed.
  void advance_block();
  void begin_block();
  void upload_block(int n_shots);
  void arm_block();
  /// Takes up to `n_most` pending shots, as long as they are the table's next.
  void take_pending(int n_most);
  void extend_block();
  void take_block_frame(const event::FrameArrived& e);
  /// Decides every frame whose readings have arrived; ends a block that is over.
  void decide_block();
  void take_by_strobe(const event::FrameArrived& e, const session::ExposureWindow& window,
                      const StrobeProof& proof);
  void decide(int entry);
  void end_block(const std::string& why);
  /// Abandons the block in progress; its shots come next again.
  void leave_block();
  void release_waiting();
  /// Entries without a frame return to the pending shots, before or after the others.
  void return_entries(bool is_first);
  void on_table_mismatch(std::uint32_t counter, std::uint32_t tag);
  [[nodiscard]] bool is_by_strobe() const;
  [[nodiscard]] bool is_camera_free() const;
  /// A light should be latched, and the camera's period is unknown.
  [[nodiscard]] bool is_rhythm_missing() const;
  [[nodiscard]] std::int64_t rhythm_patience_ns() const;
  [[nodiscard]] bool is_block_armed() const;
  [[nodiscard]] StrobeTiming strobe_timing() const;
  [[nodiscard]] std::int64_t block_patience_ns() const;
  /// Entries that may be armed or held at once, and that may be armed now.
  [[nodiscard]] int block_capacity() const;
  [[nodiscard]] int block_credit() const;
  /// Of the pending shots: how many from the front share one exposure.
  [[nodiscard]] int n_alike_pending() const;

  SequencerState& s_;
  std::int64_t t_;
  std::vector<Action>& out_;
};

}  // namespace haarlight::capture
