// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/measured_camera.h"

#include <utility>

#include <fmt/format.h>

#include "core/rig/measured_rig.h"

namespace haarlight::capture {

namespace {

class MeasuredCameraOnly final : public Camera {
 public:
  MeasuredCameraOnly(std::unique_ptr<Camera> camera, Rig rig)
      : camera_(std::move(camera)), rig_(std::move(rig)) {}

  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override {
    auto setup = camera_->start(spec);
    if (setup) {
      try {
        require_measured_camera(rig_, spec.id, setup->identity);
      } catch (const Error& error) {
        camera_->stop();
        return fail(Errc::refused, fmt::format("{}; hint: {}", error.problem(), error.hint()));
      }
    }
    return setup;
  }
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override {
    return camera_->next(deadline);
  }
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override {
    return camera_->set_exposure(exposure_us);
  }
  void stop() noexcept override { camera_->stop(); }

 private:
  std::unique_ptr<Camera> camera_;
  Rig rig_;
};

}  // namespace

std::unique_ptr<Camera> require_measured_identity(std::unique_ptr<Camera> camera,
                                                  const Rig& rig) {
  if (rig.measured == nullptr || camera == nullptr) {
    return camera;
  }
  return std::make_unique<MeasuredCameraOnly>(std::move(camera), rig);
}

}  // namespace haarlight::capture
