// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/timing.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

namespace haarlight::capture {

namespace {

constexpr double kRoundTripUs =
    1000.0;  // confirm and latch over TCP, with two thread hand-overs
constexpr double kTriggerRoundTrips = 4.0;  // latch and read-back, by a slow host
constexpr double kBitsAByte = 10.0;         // RTU: start, 8 data, parity or stop, stop
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

std::string find_strobe_problem(const Rig& rig, double exposure_us) {
  const CameraSpec& camera = rig.cameras.front();
  const double guard_us = 1e-3 * static_cast<double>(kGuardNs);
  const double settle_us = 1e-3 * static_cast<double>(settle_ns(rig.controller)) - guard_us;
  const double period_us = 1e6 / camera.fps;
  const double room_us = period_us * rig.strobe_every;
  const double need_us = exposure_us + camera.skew_us + settle_us + guard_us;
  if (exposure_us <= period_us && need_us <= room_us) {
    return {};
  }
  if (exposure_us > period_us) {
    return fmt::format(
        "camera-leads: an exposure of {:.1f} us is longer than the frame time of {:.1f} us at "
        "{:.2f} fps, so the strobe would not come at the rate that the rig file names",
        exposure_us, period_us, camera.fps);
  }
  return fmt::format(
      "camera-leads: the light does not settle within its frame: exposure {:.1f} + skew {:.1f} "
      "+ "
      "settle {:.1f} + guard {:.1f} = {:.1f} us, and {} x {:.1f} = {:.1f} us per step at "
      "{:.2f} "
      "fps: {:.1f} us too long",
      exposure_us, camera.skew_us, settle_us, guard_us, need_us, rig.strobe_every, period_us,
      room_us, camera.fps, need_us - room_us);
}

std::chrono::microseconds step_poll(const Rig& rig) noexcept {
  const double fps = rig.cameras.empty() ? 30.0 : rig.cameras.front().fps;
  return std::chrono::microseconds(
      std::clamp<std::int64_t>(std::llround(2e5 / fps), 300, 20000));
}

std::chrono::microseconds trigger_delay(const Rig& rig) noexcept {
  const double settle_us = 1e-3 * static_cast<double>(settle_ns(rig.controller));
  return std::chrono::microseconds(
      std::llround(settle_us + kTriggerRoundTrips * round_trip_us(rig.controller)));
}

double expected_frames_a_shot(const Rig& rig, double exposure_us) {
  const CameraSpec& camera = rig.cameras.front();
  const double frame_us = std::max(1e6 / camera.fps, exposure_us);
  if (rig.sync != SyncMode::free_run) {
    // A triggered frame needs exposure, skew and settling within one or more frame times.
    const double need_us =
        exposure_us + camera.skew_us + static_cast<double>(settle_ns(rig.controller)) * 1e-3;
    if (rig.sync == SyncMode::camera_leads) {
      return rig.strobe_every;
    }
    return std::max(1.0, std::ceil(need_us / frame_us));
  }
  // A clean frame that starts at 0 reaches the host after exposure, skew and readout; then the
  // next pattern is latched and settles; the next exposure starts at the next multiple of the
  // frame time.
  const double delivery_us = exposure_us + std::max(camera.skew_us, camera.read_us);
  const double stable_us = delivery_us + round_trip_us(rig.controller) +
                           static_cast<double>(settle_ns(rig.controller)) * 1e-3;
  return std::ceil(stable_us / frame_us);
}

double seconds_a_shot(const Rig& rig, double exposure_us) {
  const double period_s = std::max(1.0 / rig.cameras.front().fps, exposure_us * 1e-6);
  return expected_frames_a_shot(rig, exposure_us) * period_s;
}

}  // namespace haarlight::capture
