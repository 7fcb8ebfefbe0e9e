// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>

#include "capture/camera/camera.h"
#include "capture/camera/remote_camera_protocol.h"
#include "core/files.h"

/// @file
/// A camera behind a unix SEQPACKET socket: the client of
/// capture/camera/remote_camera_protocol.h. Frames are mapped read-only where they lie; a file
/// that its owner could still shrink is copied instead (a shrunken mapping would end the
/// process). One thread; a Frame may be released from any thread and may outlive the camera.
///
/// Limits, whatever the server sends: no more frames are held than it granted buffers nor than
/// 1 GiB of them (at least 4); more are given back unseen. A mapping ends with its frame; only
/// a file that comes again stays mapped, and of those no more than the frames that may be held
/// and kSpareFiles.

namespace haarlight {

class RemoteFrameMemory;

class RemoteCamera final : public Camera {
 public:
  RemoteCamera() = default;
  ~RemoteCamera() override;
  RemoteCamera(const RemoteCamera&) = delete;
  RemoteCamera& operator=(const RemoteCamera&) = delete;

  /// Connects to the socket `spec.device`; a running stream is left first. Faults: device_gone
  /// (no such socket, nobody listens), refused (another size than the rig's), timeout,
  /// protocol.
  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  /// Frames that come before the answer are kept for next().
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  /// Asked of the server by the next start, which faults when it is not granted.
  [[nodiscard]] Result<void> set_trigger(TriggerSource source) override;
  [[nodiscard]] Result<void> trigger() override;
  void stop() noexcept override;

  /// A server has some files more than frames that it grants: one is being filled.
  static constexpr std::size_t kSpareFiles = 4;

 private:
  struct Packet {
    RemoteHeader header;
    Fd memory;
    std::int64_t arrival_ns = 0;  ///< recvmsg gave it out, CLOCK_MONOTONIC
  };
  [[nodiscard]] Result<void> send(const RemoteHeader& header);
  [[nodiscard]] Result<Packet> receive(std::chrono::steady_clock::time_point deadline);
  /// Waits for a kind of answer; frames are queued meanwhile.
  [[nodiscard]] Result<RemoteHeader> answer_to(RemoteMessage message);
  [[nodiscard]] Result<Frame> make_frame(Packet packet);
  /// True when there is room for one more; else it was given back.
  [[nodiscard]] bool take_or_return(const RemoteHeader& header);
  [[nodiscard]] std::shared_ptr<RemoteFrameMemory> memory_of(const Fd& fd, std::size_t stride);

  /// A file that frames came in. Its identity holds while it is mapped; after that it tells
  /// only that the server may send its files again.
  struct KnownFile {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    std::weak_ptr<RemoteFrameMemory> memory;
    std::shared_ptr<RemoteFrameMemory> kept;  ///< since it came a second time
  };

  std::shared_ptr<Fd> socket_;
  CameraSpec spec_;
  std::deque<Packet> queued_;
  TriggerSource trigger_ = TriggerSource::free;
  std::size_t max_held_ = 0;
  std::shared_ptr<std::atomic<std::size_t>> n_held_;  ///< queued ones included
  std::deque<KnownFile> files_;                       ///< the latest first
};

}  // namespace haarlight
