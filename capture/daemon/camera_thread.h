// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "capture/camera/camera.h"
#include "capture/daemon/frame_tap.h"
#include "capture/daemon/work_queue.h"
#include "capture/sequencer/sequencer.h"
#include "core/thread_pulse.h"

/// @file
/// The thread that owns the camera: drains every frame at once, inspects it, and notifies the
/// control thread. Buffers stay with the FrameStore until they are dropped.

namespace haarlight::capture {

/// The frames held outside the camera. Thread-safe.
class FrameStore {
 public:
  std::uint64_t put(Frame frame);
  /// Null when it was dropped.
  [[nodiscard]] std::shared_ptr<const Frame> get(std::uint64_t id) const;
  void drop(std::uint64_t id);
  [[nodiscard]] std::size_t size() const;

 private:
  mutable std::mutex mutex_;
  std::uint64_t next_id_ = 1;
  std::map<std::uint64_t, std::shared_ptr<const Frame>> frames_;
};

class CameraThread {
 public:
  CameraThread(std::unique_ptr<Camera> camera, CameraSpec spec, FrameStore& store,
               std::function<void(EventBody)> send, Clock& clock = real_clock());
  ~CameraThread();
  CameraThread(const CameraThread&) = delete;
  CameraThread& operator=(const CameraThread&) = delete;

  void post(const action::StartCamera& command);
  void post(const action::StopCamera& command);
  void post(const action::SetExposure& command);
  void post(const action::TriggerCamera& command);

  /// The newest frame for live viewers, see capture/daemon/frame_tap.h. Thread-safe.
  [[nodiscard]] FrameTap& tap() noexcept { return tap_; }
  [[nodiscard]] const ThreadPulse& pulse() const { return pulse_; }

 private:
  using Command = std::variant<action::StartCamera, action::StopCamera, action::SetExposure,
                               action::TriggerCamera>;

  void run(const std::stop_token& stop);
  void do_command(const Command& command);
  void take_frame();
  /// No frame comes before our trigger: wait for the command, not for the camera.
  [[nodiscard]] bool is_idle() const;
  void fault(const Fault& fault);

  std::unique_ptr<Camera> camera_;
  CameraSpec spec_;
  double clip_dn_;  ///< of spec_
  FrameStore& store_;
  std::function<void(EventBody)> send_;
  Clock& clock_;
  WorkQueue<Command> commands_{64, clock_};
  ThreadPulse pulse_{"camera", clock_};
  FrameTap tap_{clock_};
  // Used by this thread only.
  bool is_streaming_ = false;
  std::uint64_t stream_ = 0;
  std::int64_t last_frame_ns_ = 0;
  bool is_frame_due_ = false;  ///< from the free-running camera, or after our trigger
  SyncMode sync_ = SyncMode::free_run;
  std::jthread thread_;  // last member: stops first
};

}  // namespace haarlight::capture
