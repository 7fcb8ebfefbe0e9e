// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "core/error.h"
#include "core/image.h"
#include "core/rig/pixel_format.h"
#include "core/rig/rig.h"

/// @file
/// A camera as the capture thread sees it. One thread owns one camera. Implementations:
/// remote_camera (a socket), replay_camera (a session), v4l2_camera (a device of this machine).

namespace haarlight {

// FrameFlag: the bits of FrameInfo::flags.
inline constexpr std::uint32_t kFrameError =
    1U << 0U;  ///< the driver marked the buffer as damaged
inline constexpr std::uint32_t kFrameShort = 1U << 1U;      ///< fewer bytes than a frame
inline constexpr std::uint32_t kFrameMonotonic = 1U << 2U;  ///< the stamp is CLOCK_MONOTONIC
/// The driver says that it stamps the start of the exposure (else the end of the frame). What
/// the stamp truly means is measured.
inline constexpr std::uint32_t kFrameStampedAtStart = 1U << 3U;
// Why kFrameError is set, where the driver did not set it.
inline constexpr std::uint32_t kFrameStampJump = 1U << 4U;  ///< the stamp is not believable
inline constexpr std::uint32_t kFrameSequenceRestart = 1U << 5U;  ///< the driver counts anew

struct FrameInfo {
  std::uint64_t sequence = 0;     ///< counts frames of the sensor; a gap is a lost frame
  std::int64_t timestamp_ns = 0;  ///< CLOCK_MONOTONIC; meaning as the rig file says
  /// When the driver (DQBUF) or the socket (recvmsg) gave it out, on the same clock: whatever
  /// the stamp means lies before it.
  std::int64_t arrival_ns = 0;
  std::uint32_t flags = 0;
  double exposure_us = 0.0;  ///< as in force for this frame; 0: not known
  double gain_db = 0.0;
};

/// A frame in a buffer of the camera's; the destructor gives the buffer back. Move-only.
class Frame {
 public:
  using Release = std::function<void()>;
  Frame() = default;
  Frame(FrameInfo info, ImageView<const std::uint16_t> pixels, Release release)
      : info_(info), pixels_(pixels), release_(std::move(release)) {}
  ~Frame() { reset(); }
  Frame(Frame&& other) noexcept;
  Frame& operator=(Frame&& other) noexcept;
  Frame(const Frame&) = delete;
  Frame& operator=(const Frame&) = delete;

  [[nodiscard]] const FrameInfo& info() const noexcept { return info_; }
  /// (frame_height, width, 1) sensor words, tag rows included.
  [[nodiscard]] ImageView<const std::uint16_t> pixels() const noexcept { return pixels_; }
  void reset();

 private:
  FrameInfo info_;
  ImageView<const std::uint16_t> pixels_;
  Release release_;
};

/// What the camera answered when it was set up: asked values as read back.
struct CameraSetup {
  int width = 0;
  int height = 0;
  int n_buffers = 0;  ///< frames that may be held at once
  double fps = 0.0;
  double exposure_us = 0.0;
  double gain_db = 0.0;
  PixelUse use = PixelUse::measurement;  ///< what the frames are good for
  std::string identity;  ///< model and serial number, compared after a reconnection
};

/// Who starts an exposure.
enum class TriggerSource {
  free,      ///< the camera, again and again
  software,  ///< the host, by Camera::trigger
  line,      ///< its trigger input: the light controller
};

class Camera {
 public:
  Camera() = default;
  virtual ~Camera() = default;
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;
  /// Opens the device, sets everything the rig asks for, reads it back and starts streaming.
  [[nodiscard]] virtual Result<CameraSetup> start(const CameraSpec& spec) = 0;
  /// The next frame. Fault timeout when `deadline` passes; device_gone when it is lost.
  [[nodiscard]] virtual Result<Frame> next(std::chrono::steady_clock::time_point deadline) = 0;
  /// Sets the exposure of a later frame; the value read back. Frames tell when it is in force.
  [[nodiscard]] virtual Result<double> set_exposure(double exposure_us) = 0;
  /// To be called before start; kept until the next call.
  [[nodiscard]] virtual Result<void> set_trigger(TriggerSource source) {
    if (source == TriggerSource::free) {
      return {};
    }
    return fail(Errc::unsupported, "this camera runs freely, it takes no trigger");
  }
  /// Exposes one frame now, which next() delivers. Nothing happens while the camera is busy
  /// with the frame before.
  [[nodiscard]] virtual Result<void> trigger() {
    return fail(Errc::unsupported, "this camera takes no trigger from the host");
  }
  /// Leaves streaming and closes the device; never fails, may be repeated.
  virtual void stop() noexcept = 0;
};

/// Makes the camera that the rig file names (registry in camera.cpp).
[[nodiscard]] Result<std::unique_ptr<Camera>> make_camera(const CameraSpec& spec);

}  // namespace haarlight
