// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/daemon/camera_thread.h"
#include "capture/daemon/rig_watch.h"
#include "capture/daemon/run_observer.h"
#include "capture/sequencer/sequencer.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/rig/rig.h"
#include "session/session_writer.h"

/// @file
/// The capture daemon without its process: threads, devices, session and HTTP around the
/// sequencer. apps/haarlightd is its main(); tests run it with devices of their own. Threads:
/// control, camera, light, one checking worker, writer, http; see docs/architecture.md.

namespace haarlight::capture {

struct DaemonConfig {
  Rig rig;
  std::filesystem::path sessions;  ///< folder of session folders; created when missing
  std::function<Result<std::unique_ptr<firmware_iface::LightArray>>()> make_light;
  std::function<Result<std::unique_ptr<Camera>>()> make_camera;
  session::Storage* storage = nullptr;  ///< outlives the daemon
  bool has_http = true;
  std::string token;
  std::filesystem::path web_folder;  ///< static page; empty: none
  bool resumes = true;               ///< resume an unfinished session at startup
  /// How long one call of a thread may last before hanging_thread() names it; four times as
  /// long for the writer, since disks may spin up.
  std::chrono::milliseconds hang_limit{15000};
  Clock* clock = &real_clock();  ///< of every thread; outlives the daemon
  /// Called in each iteration of the threads "control" and "checks", which own no device that
  /// could hang. For tests of the watchdog.
  std::function<void(std::string_view thread)> on_turn = {};
};

/// The controller's last report of the lights.
enum class LightsKnown { unknown, off, on };

/// A snapshot of the daemon, as served by GET /v1/state.
struct DaemonState {
  Phase phase = Phase::boot;
  ShotStep step = ShotStep::none;
  std::uint32_t reasons = 0;
  std::string reason_text;
  std::string session;  ///< id; empty: none since the start
  std::filesystem::path folder;
  std::shared_ptr<const Plan> plan;
  int n_shots = 0;
  int n_committed = 0;
  int current = -1;
  LightsKnown lights = LightsKnown::unknown;
  double seconds_left = -1.0;  ///< estimated from measured shots; negative: not known yet
  bool is_preview = false;     ///< lights are on for the operator, nothing is captured
  bool is_opening = false;     ///< a session is being created or recovered
  std::shared_ptr<const session::RecoveryReport>
      recovery;  ///< of the session, when it was reopened
  /// Sessions begun, but neither finished nor aborted, and not resumed at startup: that happens
  /// only to the one written last.
  std::vector<std::string> unfinished;
  SequencerCounters counters;
};

/// The reply to POST /v1/run.
struct RunReceipt {
  std::string session;
  std::filesystem::path folder;
  std::string plan_hash;
  int n_shots = 0;
};

class Daemon {
 public:
  /// Starts every thread; nothing is lit before a run.
  /// @throws Error  devices in the rig file that are not available, a sync mode that the camera
  ///                does not support, address in use
  explicit Daemon(DaemonConfig config);
  /// All lights off; frames awaiting their commit are finished first.
  ~Daemon();
  Daemon(const Daemon&) = delete;
  Daemon& operator=(const Daemon&) = delete;

  // Thread-safe; none of these waits for a device.
  [[nodiscard]] DaemonState state() const;
  /// For each shot of state().session; as many as in its plan.
  [[nodiscard]] std::vector<ShotState> shot_states() const;
  /// 0 without HTTP.
  [[nodiscard]] int http_port() const;
  /// Begins a new session.
  /// @param plan_text  a plan file's TOML, or a plan.json
  /// @throws Error  the plan's problems; interrupted: a run is in progress
  [[nodiscard]] RunReceipt run(const std::string& plan_text, const std::string& name);
  /// Resumes an unfinished session of the sessions folder.
  /// @throws Error  no such session; interrupted: a run is in progress
  [[nodiscard]] RunReceipt resume_session(const std::string& id);
  /// Lights these and streams, for aiming and focusing: state() says is_preview, newest_frame()
  /// has the picture. Ended by an abort, by all-off, or automatically after a minute.
  /// @param exposure_us  0: the camera's own
  /// @throws Error  lights that the rig does not have, too much power; interrupted: a run is in
  ///     progress
  void show_preview(std::vector<session::LightLevel> lit, double exposure_us);
  /// One of the sequencer's requests: Pause, Resume, Abort, SafeOff, Reshoot.
  void request(EventBody request);
  /// The camera's newest frame for live viewers, see capture/daemon/frame_tap.h: nothing before
  /// the first frame that arrives after a request, and nothing while the camera is stopped.
  [[nodiscard]] std::shared_ptr<const TappedFrame> newest_frame() const;
  /// Frames copied for live viewers so far.
  [[nodiscard]] std::uint64_t n_frames_shown() const;
  [[nodiscard]] const Rig& rig() const;
  [[nodiscard]] const Clock& clock() const;
  /// A plan as run() would accept it. @throws Error  the plan's problems
  [[nodiscard]] Plan expand(const std::string& plan_text, const std::string& name) const;
  /// The state of the run's shots.
  [[nodiscard]] const RunObserver& observer() const;
  /// The state of the devices.
  [[nodiscard]] RigWatch& watch() const;
  /// Prometheus text.
  [[nodiscard]] std::string metrics() const;

  /// The name of a thread stuck in a call beyond its limit; empty: all is well. For the
  /// watchdog: a daemon with a hanging thread cannot recover from within.
  [[nodiscard]] std::string hanging_thread() const;
  /// Lights off over a separate connection, as the light thread may be the one that hangs.
  /// Waits about a second at most; errors are only logged.
  void put_lights_out() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// The immutable part of a run, from rig and plan.
[[nodiscard]] std::shared_ptr<const SequencerPlan> sequencer_plan(const Rig& rig,
                                                                  const Plan& plan);

/// True for the name of a folder directly in the sessions folder, never of anything outside it.
[[nodiscard]] bool is_session_name(const std::string& name);

/// Everything the constructor would refuse before touching a device or the disk.
/// @throws Error  a sync mode, controller or camera that this version does not support
void require_drivers(const DaemonConfig& config);

}  // namespace haarlight::capture
