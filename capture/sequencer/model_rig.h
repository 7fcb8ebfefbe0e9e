// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <queue>
#include <string>
#include <vector>

#include "capture/camera/metadata_rows.h"
#include "capture/sequencer/sequencer.h"

/// @file
/// A rig without devices on a virtual clock: controller, camera, checks, writer and a busy
/// operator, each with faults drawn from a seed. It runs the sequencer as the daemon does and
/// knows the ground truth: which pattern was lit during every row of every frame. One session
/// takes about a millisecond of real time, and its seed replays it exactly. For tests.

namespace haarlight::capture {

/// Probabilities are per frame, per light job or per commit; rates per second of virtual time.
struct ModelFaults {
  double frame_late = 0.0;  ///< delivered up to three frames late
  double frame_dropped = 0.0;
  double frame_repeated = 0.0;  ///< delivered twice
  double frame_stale = 0.0;     ///< an old picture under a new number and timestamp
  double frame_swapped = 0.0;   ///< delivered after its successor
  double frame_damaged = 0.0;
  double light_timeout = 0.0;  ///< no answer; the pattern may or may not be shown
  double light_wrong_echo = 0.0;
  double light_late = 0.0;   ///< acts 5 to 60 ms after its acknowledgement, shown when it does
  double light_lying = 0.0;  ///< acts just as late, but is shown at once
  double timestamp_late = 0.0;   ///< the timestamp is 0.1 to 1.9 ms late
  double timestamp_early = 0.0;  ///< or early
  double strobe_late = 0.0;      ///< a step comes up to two frames late, counted when it does
  double strobe_lost = 0.0;      ///< the edge at a frame's end never reaches the controller
  double strobe_false = 0.0;     ///< a spurious edge within a frame
  double entry_wrong = 0.0;      ///< a table entry holds another shot's pattern
  double poll_slow = 0.0;        ///< a status takes several frame times (a busy host)
  double trigger_lost = 0.0;
  double check_failed = 0.0;
  double commit_full = 0.0;  ///< the disk is full for a while
  double controller_reboot_rate = 0.0;
  double interlock_rate = 0.0;   ///< the controller is dark and says "not now" for some time
  double lease_lost_rate = 0.0;  ///< the controller goes dark by itself, without rebooting
  double camera_gone_rate = 0.0;
  double pause_rate = 0.0;
  double safe_off_rate = 0.0;
  double abort_rate = 0.0;  ///< and started again
  double reshoot_rate = 0.0;
};

struct ModelRigConfig {
  std::uint64_t seed = 1;
  double fps = 120.0;
  double skew_us = 0.0;
  double read_us = 3000.0;
  TimestampMeaning timestamp = TimestampMeaning::end_frame;
  double latch_us = 200.0;  ///< command to change of light
  double rise_us = 50.0;
  double bus_us = 800.0;              ///< longest answer time
  double commit_us = 2000.0;          ///< longest
  double timestamp_jitter_us = 20.0;  ///< maximum, uniformly distributed
  double timestamp_sigma_us = 0.0;    ///< rms of additional normal jitter
  double camera_ppm = 0.0;            ///< how much slower its clock is than the host's
  int n_buffers = 6;
  SyncMode sync = SyncMode::free_run;
  int strobe_every = 1;
  double trigger_us = 0.0;  ///< controller leads: from the latch to the trigger
  int table_depth = 1024;
  double warming_c_per_s = 0.0;  ///< of the controller, from 25 degrees C
  ModelFaults faults;
  bool counts_wrong = false;  ///< wrong frames are counted instead of failing the session
};

/// Frame, sync mode and faults of a seed: a different rig for each.
[[nodiscard]] ModelRigConfig random_model_rig(std::uint64_t seed);
/// Changes a random rig's sync mode, with all that depends on it.
void set_sync_mode(ModelRigConfig& rig, SyncMode sync);
/// A small plan for it: up to `max_shots` shots, one or two exposures, some dark.
[[nodiscard]] std::shared_ptr<const SequencerPlan> random_model_plan(const ModelRigConfig& rig,
                                                                     int max_shots);

/// What a frame really saw.
struct ModelFrame {
  FrameInfo info;
  FrameTag truth;
  std::int64_t start_ns = 0;  ///< of its exposure
  std::uint64_t pixel_hash = 0;
  int n_clean = 0;  ///< index of this wholly clean frame since the latch, from 0
  bool is_timestamp_false = false;
};

struct ModelOutcome {
  bool is_done = false;
  std::string problem;   ///< the first violated guarantee; empty: none
  double seconds = 0.0;  ///< virtual
  std::uint64_t n_events = 0;
  int n_commits = 0;
  int n_wrong = 0;            ///< of them: saw something else; with counts_wrong not a problem
  std::uint64_t n_false = 0;  ///< frames with a false timestamp
  /// Frames with a true timestamp refused because of it: off the rhythm, or, where triggered,
  /// though they saw only their shot's light.
  std::uint64_t n_suspected = 0;
  std::uint64_t n_late = 0;  ///< light changes after their acknowledgement
  SequencerCounters counters;
};

class ModelRig {  // NOLINT(clang-analyzer-optin.performance.Padding): sorted for readers
 public:
  /// Receives each commit. False: the disk is full. The default keeps nothing.
  using Commit = std::function<bool(const action::CommitFrame&, const ModelFrame&)>;
  using Finish = std::function<bool()>;

  ModelRig(ModelRigConfig config, std::shared_ptr<const SequencerPlan> plan);
  ~ModelRig();
  ModelRig(const ModelRig&) = delete;
  ModelRig& operator=(const ModelRig&) = delete;

  void set_commit(Commit commit) { commit_ = std::move(commit); }
  void set_finish(Finish finish) { finish_ = std::move(finish); }

  /// Runs one session to its end.
  /// @param committed  shots that need no frame, as found by recovery
  /// @param limit_s    virtual time after which the session counts as stuck
  [[nodiscard]] ModelOutcome run(std::vector<bool> committed, std::vector<int> next_attempt,
                                 double limit_s = 600.0);

  [[nodiscard]] const SequencerState& state() const { return state_; }
  /// The journal's lines, newest last; for messages of a failed test.
  [[nodiscard]] const std::deque<std::string>& log() const { return log_; }

 private:
  struct Pending {
    std::int64_t t_ns = 0;
    std::uint64_t order = 0;
    std::function<void()> work;
    bool operator<(const Pending& other) const {
      return t_ns != other.t_ns ? t_ns > other.t_ns : order > other.order;
    }
  };
  /// The light from `t_ns` on; `is_settled` is false while it changes.
  struct LightSpan {
    std::int64_t t_ns = 0;
    std::uint32_t tag = 0;
    bool is_settled = true;
  };

  void at(std::int64_t t_ns, std::function<void()> work);
  void send(EventBody body);
  void perform(const Action& action);
  void fail(const std::string& problem);
  [[nodiscard]] double chance();
  [[nodiscard]] std::int64_t some_ns(double most_us);
  [[nodiscard]] bool happens(double probability) { return chance() < probability; }

  // Light.
  [[nodiscard]] double temperature_c() const {
    return 25.0 + config_.warming_c_per_s * 1e-9 * static_cast<double>(now_ns_);
  }
  void queue_job(std::function<void()> work);
  void start_job();
  void end_job(std::optional<EventBody> answer);
  void fail_job(std::uint64_t job, Errc code, const char* what);
  void light_job(std::uint64_t job, std::uint32_t tag, std::optional<ConfirmRequest> confirm);
  void show(std::uint64_t job, std::uint32_t tag);
  void change_light(std::uint32_t tag, std::int64_t delay_ns);
  /// Goes dark by itself: pending changes are discarded.
  void darken_by_itself();
  /// 5 to 60 ms, or 0.
  [[nodiscard]] std::int64_t some_lateness_ns(double fraction);
  /// When a change requested now acts, in the order of the changes.
  [[nodiscard]] std::int64_t act_ns(std::int64_t lateness_ns);
  [[nodiscard]] FrameTag truth_between(std::int64_t t0_ns, std::int64_t t1_ns) const;
  void reboot();
  void disarm();
  void upload(const action::UploadTable& table);
  void arm(const action::ArmBlock& block);
  void poll(std::uint64_t job);
  /// The camera's edge, or a spurious one.
  void strobe();
  void step_table();
  void schedule_strobes(std::uint64_t sequence, std::int64_t end_ns);

  // Camera.
  /// The camera's thread runs one command after the other.
  void after_camera(std::int64_t takes_ns, std::function<void()> work);
  void start_camera(std::uint64_t generation, std::uint64_t stream, double exposure_us);
  void expose(std::uint64_t generation);
  void expose_frame(std::uint64_t generation);
  [[nodiscard]] std::int64_t timestamp_jitter_ns();
  [[nodiscard]] std::int64_t timestamp_error_ns();
  void trigger();
  void deliver(const ModelFrame& frame);

  // Disk.
  void answer_of_disk();
  void commit_next();
  void schedule_rates();
  void every(double rate, const std::function<void()>& work);

  ModelRigConfig config_;
  std::shared_ptr<const SequencerPlan> plan_;
  Commit commit_;
  Finish finish_;
  SequencerState state_;
  std::priority_queue<Pending> queue_;
  std::int64_t now_ns_ = 1'000'000'000;
  std::uint64_t order_ = 0;
  std::uint64_t draws_ = 0;
  std::uint64_t n_events_ = 0;
  std::int64_t tick_ns_ = kNever;
  ModelOutcome outcome_;
  std::deque<std::string> log_;

  std::vector<LightSpan> light_;
  std::uint32_t boot_id_ = 1;
  std::uint32_t shown_tag_ = 0;             ///< as in the controller's register
  std::int64_t last_act_ns_ = 0;            ///< of the newest change requested
  std::uint64_t n_darkened_ = 0;            ///< by itself
  std::deque<std::function<void()>> jobs_;  ///< the light thread runs one after the other
  bool is_job_running_ = false;
  std::int64_t bus_back_ns_ = 0;  ///< no answers before then
  std::int64_t interlock_closes_ns_ = 0;
  bool is_connected_ = false;
  // The pattern table.
  std::vector<std::uint32_t> table_;  ///< tags
  std::uint32_t n_armed_ = 0;
  std::uint64_t n_armings_ = 0;  ///< and disarmings
  std::uint32_t first_armed_ = 0;
  std::uint32_t step_counter_ = 0;
  std::uint32_t n_strobes_ = 0;
  std::uint32_t late_strobe_ = 0;  ///< the newest whose step came late
  std::uint32_t every_ = 1;
  bool is_polling_ = false;
  std::uint64_t lost_frame_ = 0;   ///< the last frame whose strobe was lost; 0: none
  std::uint64_t false_frame_ = 0;  ///< the last frame with a spurious edge; 0: none

  std::uint64_t generation_ = 0;  ///< of the camera's stream; 0 frames of an old one arrive
  std::uint64_t stream_ = 0;      ///< the sequencer's name for it
  bool is_streaming_ = false;
  std::int64_t camera_back_ns_ = 0;
  std::int64_t camera_idle_ns_ = 0;  ///< when its commands so far are done
  std::uint64_t sequence_ = 0;
  double exposure_us_ = 0.0;
  double next_exposure_us_ = 0.0;
  int exposure_delay_ = 0;
  std::int64_t camera_free_ns_ = 0;   ///< triggered: busy until then
  std::deque<ModelFrame> delivered_;  ///< what the buffers still hold, newest last
  std::optional<ModelFrame> swapped_;
  std::uint64_t next_frame_ = 1;
  std::map<std::uint64_t, ModelFrame> frames_;  ///< buffers held
  std::uint32_t clean_tag_ = 0;
  std::uint64_t clean_latch_ = 0;
  std::uint64_t n_latches_ = 0;
  int n_clean_ = 0;

  std::deque<action::CommitFrame> commits_;
  bool is_committing_ = false;
  std::int64_t disk_back_ns_ = 0;
  std::vector<int> commit_counts_;
  std::vector<bool> is_committed_;
  std::vector<int> attempts_;
  std::int64_t abort_ns_ = kNever;
};

}  // namespace haarlight::capture
