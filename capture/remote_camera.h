#pragma once

#include <deque>
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
  void stop() noexcept override;

 private:
  struct Packet {
    RemoteHeader header;
    Fd memory;
  };
  [[nodiscard]] Result<void> send(const RemoteHeader& header);
  [[nodiscard]] Result<Packet> receive(std::chrono::steady_clock::time_point deadline);
  /// Waits for a kind of answer; frames are queued meanwhile.
  [[nodiscard]] Result<RemoteHeader> answer_to(RemoteMessage message);
  [[nodiscard]] Result<Frame> make_frame(Packet packet) const;

  std::shared_ptr<Fd> socket_;
  CameraSpec spec_;
  std::deque<Packet> queued_;
};

}  // namespace haarlight
