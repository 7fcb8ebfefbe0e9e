// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>

#include "capture/camera/camera.h"
#include "capture/camera/remote_camera_protocol.h"
#include "haarlight/core/files.h"

/// @file
/// A camera behind a unix SEQPACKET socket: the client of
/// capture/camera/remote_camera_protocol.h. Frames are mapped read-only in place; a file that
/// its owner could still shrink is copied instead (a shrunken mapping would kill the process).
/// One thread; a Frame may be released from any thread and may outlive the camera.
///
/// Limits, whatever the server sends: at most as many frames are held as it granted buffers,
/// and at most 1 GiB of them (but at least 4); further frames are returned unread. A mapping
/// ends with its frame; only a file that is sent again stays mapped, at most as many of those
/// as frames may be held plus kSpareFiles.

namespace haarlight::capture {

class RemoteFrameMemory;

class RemoteCamera final : public Camera {
 public:
  RemoteCamera() = default;
  ~RemoteCamera() override;
  RemoteCamera(const RemoteCamera&) = delete;
  RemoteCamera& operator=(const RemoteCamera&) = delete;

  /// Connects to the socket `spec.device`, closing a running stream first. Faults: device_gone
  /// (no such socket, or nobody listening), refused (not the rig's frame size), timeout,
  /// protocol.
  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  /// Frames that arrive before the answer are kept for next().
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  /// Requested from the server by the next start, which faults if it is not granted.
  [[nodiscard]] Result<void> set_trigger(TriggerSource source) override;
  [[nodiscard]] Result<void> trigger() override;
  void stop() noexcept override;

  /// A server has a few more files than the frames it grants: one is being filled.
  static constexpr std::size_t kSpareFiles = 4;

 private:
  struct Packet {
    RemoteHeader header;
    Fd memory;
    std::int64_t arrival_ns = 0;  ///< recvmsg delivered it, CLOCK_MONOTONIC
  };
  [[nodiscard]] Result<void> send(const RemoteHeader& header);
  [[nodiscard]] Result<Packet> receive(std::chrono::steady_clock::time_point deadline);
  /// Waits for an answer of this type; frames are queued meanwhile.
  [[nodiscard]] Result<RemoteHeader> answer_to(RemoteMessage message);
  [[nodiscard]] Result<Frame> make_frame(Packet packet);
  /// True when one more frame may be held; otherwise it was returned to the server.
  [[nodiscard]] bool take_or_return(const RemoteHeader& header);
  [[nodiscard]] std::shared_ptr<RemoteFrameMemory> memory_of(const Fd& fd, std::size_t stride);

  /// A file that delivered frames. Its identity is valid while it is mapped; after that it only
  /// shows that the server may send its files again.
  struct KnownFile {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    std::weak_ptr<RemoteFrameMemory> memory;
    std::shared_ptr<RemoteFrameMemory> kept;  ///< set when it is sent a second time
  };

  std::shared_ptr<Fd> socket_;
  CameraSpec spec_;
  std::deque<Packet> queued_;
  TriggerSource trigger_ = TriggerSource::free;
  std::size_t max_held_ = 0;
  std::shared_ptr<std::atomic<std::size_t>> n_held_;  ///< including queued frames
  std::deque<KnownFile> files_;                       ///< most recent first
};

}  // namespace haarlight::capture
