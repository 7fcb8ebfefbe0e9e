#pragma once

#include <deque>
#include <map>
#include <memory>

#include "capture/camera.h"
#include "capture/remote_camera_protocol.h"
#include "core/files.h"

/// @file
/// A camera behind a unix SEQPACKET socket: the client of capture/remote_camera_protocol.h.
/// Frames are mapped read-only where they lie; a memfd that its owner could still shrink is
/// copied instead (a shrunken mapping would end the process). One thread; a Frame may be
/// released from any thread and may outlive the camera.

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
  /// Mapped once: a server sends the same few memory files again and again.
  [[nodiscard]] std::shared_ptr<RemoteFrameMemory> map_memory(const Fd& fd, std::size_t bytes);

  std::shared_ptr<Fd> socket_;
  CameraSpec spec_;
  std::deque<Packet> queued_;
  TriggerSource trigger_ = TriggerSource::free;
  /// By device and inode, which live as long as the mapping.
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::shared_ptr<RemoteFrameMemory>> mapped_;
};

}  // namespace haarlight
