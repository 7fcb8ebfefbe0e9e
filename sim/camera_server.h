// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>

#include "haarlight/core/rig/rig.h"
#include "sim/fault_script.h"
#include "sim/virtual_camera.h"

/// @file
/// A virtual camera behind a real socket: unix SEQPACKET, frames as memory files passed by
/// SCM_RIGHTS (capture/camera/remote_camera_protocol.h). It free-runs: frame n starts at its
/// own time whatever the client does; when the client holds every buffer, frames are lost and
/// the sequence shows it. One client at a time, one thread of its own.

namespace haarlight::sim {

/// The source of a camera's light. Called from the camera's thread.
struct LightSource {
  /// The state at t0 and each change in (t0, t1]; t1 is in the past.
  std::function<firmware_iface::LightHistory(std::int64_t t0_ns, std::int64_t t1_ns)> history;
  /// Announced in advance: an edge of the strobe line at `t_ns`, the end of an exposure. May be
  /// empty.
  std::function<void(std::int64_t t_ns)> strobe;
};

struct CameraServerOptions {
  VirtualCameraOptions camera{};
  int n_buffers = 8;  ///< frames the client may hold
  FrameFaults faults{};
  std::uint64_t fault_seed = 1;
  /// A frame whose exposure begins within this time after the light became steady may or may
  /// not be refused by a host, depending on how fast its acknowledgement travels. It is lost (a
  /// gap in the sequence), so that the committed pixels don't depend on the host's speed. 0 =
  /// deliver it.
  double doubtful_us = 2000.0;
  int exposure_delay_frames =
      0;  ///< frames begun after an exposure was set that still use the old one
  /// Frames are planned this long before they begin (a strobe is announced this early), so that
  /// a slow machine does not distort their times. A new exposure is in force after that.
  std::int64_t lookahead_ns = 0;
  /// No sensor model: each buffer is filled once with noise, and a frame changes its embedded
  /// metadata rows and one word. For measuring what is behind the camera.
  bool is_prepared = false;
  /// Probabilities that an edge of the strobe line is lost, or that a spurious one comes within
  /// a frame.
  double strobe_lost_probability = 0.0;
  double strobe_false_probability = 0.0;
};

struct CameraServerCounts {
  std::uint64_t n_delivered = 0;
  std::uint64_t n_mixed = 0;      ///< delivered while the light changed
  std::uint64_t n_no_buffer = 0;  ///< lost: the client held all buffers
  std::uint64_t n_overrun = 0;    ///< lost: this machine was too slow
  std::uint64_t n_doubtful = 0;   ///< lost: see doubtful_us
  std::uint64_t n_faults = 0;     ///< late, dropped, duplicated, stale or swapped by the script
};

/// Runs from construction to destruction. Thread-safe.
class CameraServer {
 public:
  /// Listens on `socket`; a stale socket file is replaced, a live one refused.
  /// @throws Error  unusable path, camera that does not fit the transport
  CameraServer(const CameraSpec& spec, const ControllerSpec& controller,
               const Transport& transport, LightSource light, std::filesystem::path socket,
               const CameraServerOptions& options = {});
  ~CameraServer();
  CameraServer(const CameraServer&) = delete;
  CameraServer& operator=(const CameraServer&) = delete;

  [[nodiscard]] const std::filesystem::path& socket() const;
  [[nodiscard]] CameraServerCounts counts() const;
  /// When the first frame began (CLOCK_MONOTONIC ns); nothing before.
  [[nodiscard]] std::optional<std::int64_t> first_frame_ns() const;
  /// A pulse on the trigger line at `t_ns`; ignored unless the client selected it, or while a
  /// frame is exposed or read out.
  void trigger_line(std::int64_t t_ns);
  /// Disconnects the client, as if the cable were pulled; it may connect again.
  void disconnect_client();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::sim
