// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>

#include "capture/camera/camera.h"
#include "capture/camera/frame_order.h"
#include "capture/camera/v4l2_controls.h"
#include "capture/camera/v4l2_list.h"

/// @file
/// A camera attached to this machine, through V4L2: memory-mapped streaming, everything set
/// manually and read back. docs/reference/cameras.md is the user's guide.
///
/// Frames are unpacked into our own memory at once and the driver gets its buffer back: a slow
/// disk then costs memory but no frame, and frames outlive an unplugged device. Device failures
/// are detected where they occur: poll's error bits, an errno, the buffer's flags, its count
/// and timestamp, a control that moved.

namespace haarlight::capture {

/// Frame counts since construction.
struct V4l2Counters {
  std::uint64_t frames = 0;          ///< handed out
  std::uint64_t pool_exhausted = 0;  ///< returned unread: pool exhausted
  std::uint64_t io_errors = 0;       ///< of the stream
  std::uint64_t restarts = 0;        ///< of the stream, after such an error
  std::uint64_t reopenings = 0;      ///< starts after the first
};

class V4l2Camera final : public Camera {
 public:
  explicit V4l2Camera(V4l2Paths paths = {});
  ~V4l2Camera() override;
  V4l2Camera(const V4l2Camera&) = delete;
  V4l2Camera& operator=(const V4l2Camera&) = delete;

  /// Finds the device (after the first time: the same one, under whatever node), sets region,
  /// format, rate and controls, and starts streaming. Faults: device_gone, device_busy (in use
  /// by another program, no USB bandwidth), unsupported (not offered: the text lists what is),
  /// refused (set to a value other than requested; no permission to open it), io.
  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  /// EIO and a broken stream are answered by restarting the stream, a few times without a good
  /// frame in between; then fault io (a new start reopens the device). A control that changed
  /// by itself is fault io. After device_gone the device is closed.
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  /// Frames until `exposure_delay_frames` after the change report their exposure as unknown.
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  /// The next start sets the rig file's `trigger` controls, and faults if there are none.
  [[nodiscard]] Result<void> set_trigger(TriggerSource source) override;
  [[nodiscard]] Result<void> trigger() override;
  void stop() noexcept override;

  [[nodiscard]] const V4l2Counters& counters() const { return counters_; }

 private:
  class Words;
  struct Stream;
  [[nodiscard]] Result<Stream> open_stream(const CameraSpec& spec);
  [[nodiscard]] Result<void> check_controls();
  [[nodiscard]] Result<void> take_events();
  /// Nothing when no frame was ready after all, or the pool is exhausted.
  [[nodiscard]] Result<std::optional<Frame>> take_frame();
  [[nodiscard]] Result<std::optional<Frame>> copy_out(const V4l2Filled& filled);
  [[nodiscard]] FrameInfo describe(const V4l2Filled& filled);
  [[nodiscard]] Result<void> restart(const Fault& why);
  /// Closes a device that is gone; passes the fault on.
  [[nodiscard]] tl::unexpected<Fault> give_up(Fault fault);

  V4l2Paths paths_;
  std::optional<V4l2Identity> identity_;  ///< of the first start
  TriggerSource trigger_ = TriggerSource::free;
  bool is_depth_proven_ = false;  ///< a frame stayed within the rig file's bit depth
  std::unique_ptr<Stream> stream_;
  V4l2Counters counters_;
};

}  // namespace haarlight::capture
