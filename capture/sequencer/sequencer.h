// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "capture/sequencer/frame_rhythm.h"
#include "capture/sequencer/phase.h"
#include "capture/sequencer/sequencer_messages.h"
#include "capture/sequencer/strobe_proof.h"
#include "haarlight/core/enum_words.h"

/// @file
/// The core of the daemon as a pure function: step(state, event) -> (state, actions). No clock,
/// no I/O, no randomness: time arrives in events, so a capture with any fault replays exactly.
///
/// A frame is committed to a shot only when (1) the controller showed the shot's tag after the
/// latch, (2) the camera's timestamp puts its exposure after t_stable, counted from that
/// read-back, (3) the controller, queried again after the exposure's end, still shows that tag
/// in the same boot, (4) it came in sequence, with a timestamp before its arrival and on the
/// camera's own period (frame_rhythm.h) or after its trigger, with no damage flag, in the
/// requested exposure, and is not a picture seen before, and (5) the pixel checks pass. Where
/// the camera's strobe steps a table, strobe_proof.h replaces (1) to (3). The diagram
/// is in capture/README.md.
///
/// Where the camera free-runs (free-run, camera-leads), no light is latched and no table armed
/// while its period is unknown: preflight waits for it with the lights off, at the start, after
/// each restart of the camera, and when the period was lost on the way. So the first light too
/// is photographed by its first clean frame. Nothing depends on whether it is really dark then:
/// only timestamps are used. A period that is not learnt in time suspends the run
/// (kNoEvidence). Triggered frames have no period: there the light is latched at once. A
/// preview takes no frame and waits for none.
///
/// In triggered modes the trigger replaces the timestamp, as long as no other trigger's frame
/// can be mistaken for it. A trigger that brought no frame (a latch without an answer, a pause)
/// may still expose one: the next is delayed until no false timestamp can bridge the gap; a
/// latch that was never read back counts until the last moment at which it may act.

namespace haarlight::capture {

// SuspendReason: why a run is suspended; bits of SequencerState::reasons. Each ends by itself.
inline constexpr std::uint32_t kCameraLost = 1U << 0U;      ///< retried with growing delay
inline constexpr std::uint32_t kControllerLost = 1U << 1U;  ///< retried with growing delay
inline constexpr std::uint32_t kDiskFull = 1U << 2U;  ///< the commit is repeated every second
/// Many frames, none clean: retried every two seconds.
inline constexpr std::uint32_t kNoEvidence = 1U << 3U;
/// The controller says not now (interlock, temperature, an element's rest), or refused what it
/// accepted before, which is believed the fourth time: retried every second.
inline constexpr std::uint32_t kHeldBack = 1U << 4U;
/// The session's folder was moved or deleted: checked every second.
inline constexpr std::uint32_t kFolderGone = 1U << 5U;
/// A shot was withdrawn twice, contradicted by other frames of its lights: retried every two
/// seconds.
inline constexpr std::uint32_t kWrongLight = 1U << 6U;
/// "camera, disk"
[[nodiscard]] std::string reasons_text(std::uint32_t reasons);

enum class ShotState : std::uint8_t { pending, exposing, checking, committing, committed };
inline constexpr auto kShotStateWords = std::to_array<std::string_view>(
    {"pending", "exposing", "checking", "committing", "committed"});
constexpr std::span<const std::string_view> words_of(ShotState) { return kShotStateWords; }

// ---- state ----

/// Counted since the start; exported at /metrics.
struct SequencerCounters {
  std::uint64_t frames = 0;
  std::uint64_t frames_unused = 0;   ///< not wholly under one settled pattern, or not needed
  std::uint64_t frames_damaged = 0;  ///< flags, short
  std::uint64_t sequence_gaps = 0;
  std::uint64_t frames_out_of_order = 0;
  std::uint64_t timestamps_ahead = 0;  ///< timestamped after they arrived
  std::uint64_t off_rhythm = 0;        ///< timestamped off their camera's period
  std::uint64_t rhythm_unknown = 0;    ///< arrived before the camera's period was known
  std::uint64_t duplicates = 0;
  std::uint64_t wrong_exposure = 0;
  std::uint64_t checks_failed = 0;
  std::uint64_t frames_doubted = 0;   ///< committed, then contradicted by later pictures
  std::uint64_t confirms_failed = 0;  ///< the light changed by itself
  std::uint64_t retries = 0;          ///< shots shown again
  std::uint64_t shot_timeouts = 0;
  std::uint64_t light_faults = 0;
  std::uint64_t camera_faults = 0;
  std::uint64_t commit_faults = 0;
  std::uint64_t controller_reboots = 0;
  std::uint64_t blocks = 0;            ///< camera leads: parts of the table armed
  std::uint64_t blocks_cut = 0;        ///< ended before their table for lack of free buffers
  std::uint64_t strobe_unproven = 0;   ///< frames for which the step counter was not k, k + 1
  std::uint64_t table_mismatches = 0;  ///< tag other than the table's at that step
  std::uint64_t suspensions = 0;
  std::uint64_t commits = 0;
};

inline constexpr std::int64_t kNoPulse = std::numeric_limits<std::int64_t>::min();

/// The sequencer's entire state. Plain data; copyable.
struct SequencerState {  // NOLINT(clang-analyzer-optin.performance.Padding): sorted for readers
  Phase phase = Phase::boot;
  std::uint32_t reasons = 0;          ///< SuspendReason bits
  std::string reason_text;            ///< of the newest suspension or refusal, for display
  std::int64_t deadline_ns = kNever;  ///< when a Tick is due

  std::shared_ptr<const SequencerPlan> plan;
  std::vector<ShotState> shots;
  std::vector<int> attempts;  ///< number of each shot's next attempt
  std::deque<int> pending;
  int n_committed = 0;
  bool is_finished = false;  ///< session.json exists

  // The current shot.
  int current = -1;
  ShotStep step = ShotStep::none;
  firmware_iface::LatchReceipt receipt;
  std::int64_t t_stable_ns = 0;
  std::int64_t shot_deadline_ns =
      kNever;  ///< in preflight: end of the wait for the camera's period
  int discarded = 0;
  std::uint64_t duplicates_before = 0;  ///< counters.duplicates when the shot was lit
  /// A usable frame, and how close its timestamp is to its moment.
  struct TimestampedFrame {
    event::FrameArrived frame;
    std::int64_t guard_ns = 0;
  };
  /// Frames that came before the latch's read-back was reported; classified once it is.
  std::vector<TimestampedFrame> early;
  std::set<int> withdrawn;              ///< committed once, and to be retaken
  std::map<int, int> times_doubted;     ///< per shot, since the run was last suspended for it
  std::set<int> doubted;                ///< shots to be retaken once they are committed
  int failures = 0;                     ///< consecutive shots tried without a commit
  std::optional<double> temperature_c;  ///< newest, of the controller
  std::optional<double> dark_temperature_c;  ///< at the newest dark frame

  // The light. At most one job matters: the newest.
  bool is_light_connected = false;
  bool is_dark = true;    ///< the newest job leaves the lights off
  std::uint64_t job = 0;  ///< number of the newest job
  bool is_job_open = false;
  std::uint32_t boot_id = 0;
  int light_faults = 0;    ///< in a row
  int refusals = 0;        ///< by the controller, since it last showed something
  bool has_shown = false;  ///< it has shown something in this run
  std::int64_t retry_light_ns = kNever;

  /// A frame accepted by its timestamp that awaits the controller's confirmation.
  struct Awaiting {
    std::uint64_t frame = 0;
    std::uint64_t job = 0;
    int shot = 0;
    int attempt = 0;
    session::FrameEvidence evidence;
  };
  std::optional<Awaiting> awaiting;

  /// Camera leads: the armed part of the table.
  struct Block {
    enum class Step { none, exposing, uploading, arming, running };
    Step step = Step::none;
    std::uint64_t job = 0;  ///< of its ArmBlock
    /// What the controller's table holds, by entry; empty: unknown.
    std::vector<int> table;
    int first = 0;           ///< entry of the table
    std::vector<int> shots;  ///< armed so far, in order
    int n_armed = 0;
    std::vector<bool> is_decided;  ///< has a frame, or was returned; by entry of the block
    int n_decided = 0;
    int n_accepted = 0;
    firmware_iface::LatchReceipt armed;
    std::uint32_t counter = 0;      ///< newest reading
    std::int64_t done_ns = kNever;  ///< when read as stepped past its end
    std::deque<StepReading> readings;
    std::optional<double> temperature_c;  ///< newest
    struct Waiting {
      event::FrameArrived frame;
      session::ExposureWindow window;
    };
    std::deque<Waiting> waiting;  ///< frames that await the reading after theirs
  };
  Block block;
  int table_depth = 0;  ///< of the controller

  // The camera.
  bool is_camera_started = false;
  bool is_camera_starting = false;
  std::uint64_t stream = 0;            ///< the newest
  std::uint64_t exposure_request = 0;  ///< the newest
  bool is_exposure_open = false;       ///< SetExposure not answered yet
  bool is_exposure_seen = false;       ///< a frame came in the requested exposure
  std::int64_t trigger_ns = kNever;    ///< light leads: when to expose
  std::int64_t triggered_ns =
      kNever;  ///< light leads: when the current shot's exposure was requested
  /// Controller leads: from then on the pulse of a latch whose frame was not taken cannot
  /// belong to a frame that could be taken. kNever: latched, and the controller has not
  /// answered yet.
  std::int64_t pulse_over_ns = kNoPulse;
  bool waits_for_pulse = false;  ///< the next latch waits for it
  int n_buffers = 0;
  double exposure_requested_us = 0.0;
  double exposure_read_us = 0.0;
  bool has_sequence = false;
  bool is_timestamp_refused = false;  ///< one from the future was reported in this stream
  std::uint64_t last_sequence = 0;
  std::int64_t last_timestamp_ns = 0;
  FrameRhythm rhythm;                             ///< of a free-running camera
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
  std::int64_t retry_wrong_light_ns = kNever;
  std::int64_t abort_deadline_ns = kNever;

  SequencerCounters counters;
};

struct StepResult {
  SequencerState state;
  std::vector<Action> actions;
};

/// One step. Pure: equal arguments give equal results. Never blocks, O(1) except for Run and
/// Reshoot. Unknown, late or repeated answers are ignored; a frame that no action keeps is
/// dropped.
[[nodiscard]] StepResult step(SequencerState state, const TimedEvent& event);

}  // namespace haarlight::capture
