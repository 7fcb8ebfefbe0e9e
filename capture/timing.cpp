#include "capture/timing.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace haarlight {

namespace {

constexpr double kRoundTripUs =
    1000.0;                           // confirm and latch over TCP, with two thread hand-overs
constexpr double kBitsAByte = 10.0;   // RTU: start, 8 data, parity or stop, stop
constexpr double kBytesAShot = 64.0;  // RTU: confirm, changed levels, tag, latch, read back

double round_trip_us(const ControllerSpec& controller) {
  if (controller.kind != ControllerKind::modbus_rtu) {
    return kRoundTripUs;
  }
  const auto colon = controller.address.rfind(':');
  const double baud =
      colon == std::string::npos ? 115200.0 : std::atof(controller.address.c_str() + colon + 1);
  return kRoundTripUs + 1e6 * kBytesAShot * kBitsAByte / std::max(baud, 300.0);
}

}  // namespace

std::int64_t settle_ns(const ControllerSpec& controller) noexcept {
  const double settle_us =
      controller.latch_us + std::max(controller.rise_us, controller.fall_us);
  return static_cast<std::int64_t>(std::llround(settle_us * 1e3)) + kGuardNs;
}

double expected_frames_a_shot(const Rig& rig, double exposure_us) {
  const CameraSpec& camera = rig.cameras.front();
  const double frame_us = std::max(1e6 / camera.fps, exposure_us);
  if (rig.sync != SyncMode::free_run) {
    // A triggered frame needs exposure, skew and settling within one or more frame times.
    const double need_us =
        exposure_us + camera.skew_us + static_cast<double>(settle_ns(rig.controller)) * 1e-3;
    return std::max(1.0, std::ceil(need_us / frame_us));
  }
  // A clean frame that starts at 0 is in our hands after exposure, skew and readout; then the
  // next pattern is latched and settles; the next exposure starts at the next multiple of the
  // frame time.
  const double delivery_us = exposure_us + std::max(camera.skew_us, camera.read_us);
  const double stable_us = delivery_us + round_trip_us(rig.controller) +
                           static_cast<double>(settle_ns(rig.controller)) * 1e-3;
  return std::ceil(stable_us / frame_us);
}

}  // namespace haarlight
