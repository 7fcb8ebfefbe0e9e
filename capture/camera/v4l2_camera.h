// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>

#include "capture/camera/camera.h"
#include "capture/camera/frame_order.h"
#include "capture/camera/v4l2_controls.h"
#include "capture/camera/v4l2_list.h"

/// @file
/// A camera of this machine, through V4L2: memory-mapped streaming, everything set by hand and
/// read back. docs/reference/cameras.md is the page for people.
///
/// A frame's words are unpacked into memory of our own at once and the driver gets its buffer
/// back: a slow disk then costs memory and no frame, and frames outlive an unplugged device.
/// What happened to the device is found where it happens: poll's error bits, an errno, the
/// buffer's flags, its count and stamp, a control that moved.

namespace haarlight {

/// What became of the frames since construction.
struct V4l2Counters {
  std::uint64_t frames = 0;      ///< handed out
  std::uint64_t unhoused = 0;    ///< given back unseen: all memory was held
  std::uint64_t io_errors = 0;   ///< of the stream
  std::uint64_t restarts = 0;    ///< of the stream, after such an error
  std::uint64_t reopenings = 0;  ///< starts after the first
};

class V4l2Camera final : public Camera {
 public:
  explicit V4l2Camera(V4l2Places places = {});
  ~V4l2Camera() override;
  V4l2Camera(const V4l2Camera&) = delete;
  V4l2Camera& operator=(const V4l2Camera&) = delete;

  /// Finds the device (after the first time: the same one, under whatever node), sets region,
  /// format, rate and controls and streams. Faults: device_gone, device_busy (another program
  /// has it, no USB bandwidth), unsupported (not offered: the text lists what is), refused (set
  /// to another value than asked; no right to open it), io.
  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  /// EIO and a broken stream are answered by streaming anew, a few times without a good frame
  /// in between; then fault io (a new start reopens the device). A control that changed by
  /// itself is fault io. After device_gone the device is closed.
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  /// Frames until `exposure_delay_frames` after the change say that their exposure is not
  /// known.
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  /// The next start sets the rig file's `trigger` controls, and faults without them.
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
  /// Nothing when there is none after all, or no memory for it.
  [[nodiscard]] Result<std::optional<Frame>> take_frame();
  [[nodiscard]] Result<std::optional<Frame>> house(const V4l2Filled& filled);
  [[nodiscard]] FrameInfo describe(const V4l2Filled& filled);
  [[nodiscard]] Result<void> restart(const Fault& why);
  /// Closes a device that is gone; hands the fault on.
  [[nodiscard]] tl::unexpected<Fault> give_up(Fault fault);

  V4l2Places places_;
  std::optional<V4l2Identity> identity_;  ///< of the first start
  TriggerSource trigger_ = TriggerSource::free;
  bool is_depth_proven_ = false;  ///< a frame kept to the rig file's bits
  std::unique_ptr<Stream> stream_;
  V4l2Counters counters_;
};

}  // namespace haarlight
