// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <memory>

#include "capture/camera/camera.h"
#include "firmware_iface/fake_light_array.h"

/// @file
/// A camera without a device that really watches a FakeLight: frames at a fixed period of the
/// light's clock, the lit tag in the embedded metadata rows, "mixed" when it changed during the
/// exposure. For tests.

namespace haarlight::capture {

/// Set by a test, from any thread.
struct FakeCameraHands {
  std::atomic<bool> is_gone{false};    ///< unplugged
  std::atomic<bool> is_silent{false};  ///< connected, but delivers no frames
  std::atomic<int> n_held{0};          ///< buffers held
  /// Frames under this tag are clipped in every other column; 0: none.
  std::atomic<std::uint32_t> clipped_tag{0};
};

class FakeCamera final : public Camera {
 public:
  FakeCamera(std::shared_ptr<const firmware_iface::FakeLight> light,
             std::shared_ptr<FakeCameraHands> hands);
  ~FakeCamera() override;
  FakeCamera(const FakeCamera&) = delete;
  FakeCamera& operator=(const FakeCamera&) = delete;

  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  void stop() noexcept override;

 private:
  std::shared_ptr<const firmware_iface::FakeLight> light_;
  std::shared_ptr<FakeCameraHands> hands_;
  Clock& clock_;  ///< the light's
  CameraSpec spec_;
  bool is_streaming_ = false;
  std::int64_t t0_ns_ = 0;
  std::uint64_t sequence_ = 0;
};

}  // namespace haarlight::capture
