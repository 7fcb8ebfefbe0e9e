// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include "capture/daemon/work_queue.h"
#include "capture/sequencer/sequencer.h"
#include "core/thread_pulse.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// The thread that owns the bus to the lights: runs the sequencer's light jobs in order and
/// renews the lease between them, as long as the control thread lives (deadman): when that has
/// been silent for the length of a lease, the lights are turned off here, and by the
/// controller.

namespace haarlight::capture {

struct LightThreadConfig {
  std::chrono::milliseconds lease{2000};
  std::chrono::microseconds poll{2000};  ///< interval between two readings of the step counter
  std::chrono::microseconds trigger_delay{
      0};  ///< from a latch to the camera's trigger; 0: none
  /// Patterns by shot, of the run in progress.
  std::function<std::shared_ptr<const std::vector<std::vector<firmware_iface::ElementLevel>>>()>
      patterns;
  std::function<void(EventBody)> send;
  Clock* clock = &real_clock();
};

class LightThread {
 public:
  /// Starts; connects to nothing before the first ConnectLight.
  LightThread(std::unique_ptr<firmware_iface::LightArray> lights, LightThreadConfig config);
  /// All off, then stops.
  ~LightThread();
  LightThread(const LightThread&) = delete;
  LightThread& operator=(const LightThread&) = delete;

  void post(const action::ConnectLight& job);
  void post(const action::ShowShot& job);
  void post(const action::UploadTable& job);
  void post(const action::ArmBlock& job);
  void post(const action::ExtendBlock& job);
  /// With no confirmation to wait for, it goes ahead of all waiting jobs, which are answered by
  /// a fault.
  void post(const action::LightsOff& job);

  /// The control thread is alive.
  void feed_deadman() { fed_ns_ = clock_.now_ns(); }
  [[nodiscard]] const ThreadPulse& pulse() const { return pulse_; }

 private:
  using Job = std::variant<action::ConnectLight, action::ShowShot, action::UploadTable,
                           action::ArmBlock, action::ExtendBlock, action::LightsOff>;

  void run(const std::stop_token& stop);
  void do_job(const Job& job);
  void connect(const action::ConnectLight& job);
  void show(const action::ShowShot& job);
  void upload(const action::UploadTable& job);
  void arm(const action::ArmBlock& job);
  void extend(const action::ExtendBlock& job);
  void darken(const action::LightsOff& job);
  /// Reads the step counter while a block is armed.
  void read_steps();
  /// False when the light is not as it should be, or the controller did not answer.
  [[nodiscard]] bool confirm(std::uint64_t job, const std::optional<ConfirmRequest>& request);
  void keep_lease();
  void enqueue(const Job& job);

  std::unique_ptr<firmware_iface::LightArray> lights_;
  LightThreadConfig config_;
  Clock& clock_;
  WorkQueue<Job> jobs_{64, clock_};
  ThreadPulse pulse_{"light", clock_};
  std::atomic<std::int64_t> fed_ns_;
  // Used by this thread only.
  bool is_connected_ = false;
  bool is_dark_ = true;
  std::int64_t renewed_ns_ = 0;
  std::uint64_t block_ = 0;  ///< job of the block whose steps are read; 0: none
  std::int64_t next_read_ns_ = 0;
  std::jthread thread_;  // last member: stops first
};

}  // namespace haarlight::capture
