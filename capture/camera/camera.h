// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "core/rig/pixel_format.h"
#include "haarlight/core/error.h"
#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// A camera as the capture thread sees it. One thread owns one camera. Implementations:
/// remote_camera (a socket), replay_camera (a session), v4l2_camera (a local device).

namespace haarlight::capture {

// FrameFlag: the bits of FrameInfo::flags.
inline constexpr std::uint32_t kFrameError =
    1U << 0U;  ///< the driver marked the buffer as damaged
inline constexpr std::uint32_t kFrameShort = 1U << 1U;      ///< fewer bytes than a frame
inline constexpr std::uint32_t kFrameMonotonic = 1U << 2U;  ///< the timestamp is in
                                                            ///< CLOCK_MONOTONIC
/// The driver claims to timestamp the start of exposure (else the end of the frame). What the
/// timestamp really means is measured.
inline constexpr std::uint32_t kFrameTimestampedAtStart = 1U << 3U;
// Why kFrameError is set where the driver did not set it.
inline constexpr std::uint32_t kFrameTimestampJump = 1U << 4U;    ///< implausible timestamp
inline constexpr std::uint32_t kFrameSequenceRestart = 1U << 5U;  ///< the driver's count
                                                                  ///< restarted

struct FrameInfo {
  std::uint64_t sequence = 0;     ///< counts sensor frames; a gap is a lost frame
  std::int64_t timestamp_ns = 0;  ///< CLOCK_MONOTONIC; meaning as given in the rig file
  /// When the driver (DQBUF) or the socket (recvmsg) delivered it, on the same clock: whatever
  /// the timestamp means, it lies before this.
  std::int64_t arrival_ns = 0;
  std::uint32_t flags = 0;
  double exposure_us = 0.0;  ///< in force for this frame; 0: unknown
  double gain_db = 0.0;
};

/// A frame in one of the camera's buffers; the destructor returns the buffer. Move-only.
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
  /// (frame_height, width, 1) sensor words, including the embedded metadata rows.
  [[nodiscard]] ImageView<const std::uint16_t> pixels() const noexcept { return pixels_; }
  void reset();

 private:
  FrameInfo info_;
  ImageView<const std::uint16_t> pixels_;
  Release release_;
};

/// What the camera reported at setup: requested values as read back.
struct CameraSetup {
  int width = 0;
  int height = 0;
  int n_buffers = 0;  ///< frames that may be held at once
  double fps = 0.0;
  double exposure_us = 0.0;
  double gain_db = 0.0;
  PixelUse use = PixelUse::measurement;  ///< what the frames may be used for
  std::string identity;  ///< model and serial number, compared after a reconnection
};

/// What starts an exposure.
enum class TriggerSource {
  free,      ///< the camera, free-running
  software,  ///< the host, by Camera::trigger
  line,      ///< its trigger input: the light controller
};

class Camera {
 public:
  Camera() = default;
  virtual ~Camera() = default;
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;
  /// Opens the device, sets every value of the rig file, reads it back and starts streaming.
  [[nodiscard]] virtual Result<CameraSetup> start(const CameraSpec& spec) = 0;
  /// The next frame. Fault timeout when `deadline` passes; device_gone when it is lost.
  [[nodiscard]] virtual Result<Frame> next(std::chrono::steady_clock::time_point deadline) = 0;
  /// Sets the exposure of a later frame and returns the value read back. Frames tell when it is
  /// in force.
  [[nodiscard]] virtual Result<double> set_exposure(double exposure_us) = 0;
  /// Call before start; kept until the next call.
  [[nodiscard]] virtual Result<void> set_trigger(TriggerSource source) {
    if (source == TriggerSource::free) {
      return {};
    }
    return fail(Errc::unsupported, "this camera runs freely, it takes no trigger");
  }
  /// Exposes one frame now, which next() delivers. Ignored while the camera is busy with the
  /// previous frame.
  [[nodiscard]] virtual Result<void> trigger() {
    return fail(Errc::unsupported, "this camera takes no trigger from the host");
  }
  /// Stops streaming and closes the device; never fails, may be called repeatedly.
  virtual void stop() noexcept = 0;
};

/// Creates the camera named in the rig file (registry in camera.cpp).
[[nodiscard]] Result<std::unique_ptr<Camera>> make_camera(const CameraSpec& spec);

}  // namespace haarlight::capture
