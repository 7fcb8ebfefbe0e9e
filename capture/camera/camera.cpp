// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/camera.h"

#include <utility>

#include "capture/camera/remote_camera.h"
#include "capture/camera/replay_camera.h"
#include "capture/camera/v4l2_camera.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

Frame::Frame(Frame&& other) noexcept
    : info_(other.info_),
      pixels_(std::exchange(other.pixels_, {})),
      release_(std::exchange(other.release_, nullptr)) {}

Frame& Frame::operator=(Frame&& other) noexcept {
  if (this != &other) {
    reset();
    info_ = other.info_;
    pixels_ = std::exchange(other.pixels_, {});
    release_ = std::exchange(other.release_, nullptr);
  }
  return *this;
}

void Frame::reset() {
  const Release release = std::exchange(release_, nullptr);
  pixels_ = {};
  if (release) {
    release();
  }
}

Result<std::unique_ptr<Camera>> make_camera(const CameraSpec& spec) {
  switch (spec.kind) {
    case CameraKind::remote:
      return std::make_unique<RemoteCamera>();
    case CameraKind::replay:
      return std::make_unique<ReplayCamera>();
    case CameraKind::v4l2:
      return std::make_unique<V4l2Camera>();
  }
  throw_contract_violation("CameraKind", "a known kind", __FILE__, __LINE__);
}

}  // namespace haarlight::capture
