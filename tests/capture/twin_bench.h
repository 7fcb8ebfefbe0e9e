// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/camera/camera.h"
#include "capture/commission/commission_bench.h"
#include "core/random.h"
#include "firmware_iface/fake_bus.h"
#include "haarlight/core/rig/rig.h"
#include "sim/truth.h"
#include "sim/virtual_camera.h"
#include "tests/temporary_folder.h"

/// @file
/// The virtual rig on a virtual clock: the simulator's own sensor and controller behind the
/// Camera and LightArray interfaces, so that a commissioning of minutes takes a second and is
/// the same every time. The bus takes 10 to 60 us per request, now and then much longer; frames
/// come late by up to 0.3 ms, now and then by 5 ms.

namespace haarlight::testing {

/// The light of point sources on the shadow plane, as each pixel sees it.
inline sim::Transport plane_transport(const TemporaryFolder& folder, const Rig& rig) {
  const CameraSpec& camera = rig.cameras[0];
  sim::TransportData data;
  data.width = camera.frame_width;
  data.height = camera.active_rows;
  data.n_lights = rig.n_lights();
  data.key = std::string(32, 'a');
  data.seconds = 1.0;
  std::vector<float> planes;
  for (const LightElement& light : light_elements(rig)) {
    for (int y = 0; y < data.height; ++y) {
      for (int x = 0; x < data.width; ++x) {
        const CameraRay ray = ray_through(camera.model, x + 0.5, y + 0.5);
        const double t = -ray.origin_world.z() / ray.direction_world.z();
        const Eigen::Vector3d way = light.centre - (ray.origin_world + t * ray.direction_world);
        const double r2 = way.squaredNorm();
        planes.push_back(static_cast<float>(1e6 * way.z() * way.z() / (r2 * r2)));
      }
    }
  }
  data.planes = planes;
  sim::write_transport(folder / "transport.bin", data);
  return sim::Transport::open(folder / "transport.bin");
}

class TwinBench {
 public:
  /// @param lit_electrons  of a pixel under one light at the rig's exposure; 0: half the well
  /// @param rendered  what each pixel sees of each light; nothing: of point sources on the
  /// plane
  TwinBench(const Rig& written, const sim::SimTruth& truth, std::uint64_t seed = 1,
            double lit_electrons = 0.0, std::optional<sim::Transport> rendered = std::nullopt)
      : truth_rig_(sim::apply_truth(truth, written)),
        transport_(rendered ? std::move(*rendered) : plane_transport(folder_, written)),
        controller_(firmware_iface::controller_config(written), 1, now_),
        seed_(seed),
        sensor_(truth_rig_.cameras[0], truth_rig_.controller, transport_,
                sim::VirtualCameraOptions{seed, lit_electrons, true,
                                          sim::true_light_power(truth, written.n_lights()),
                                          sim::true_wiring(truth, written.n_lights()),
                                          sim::true_flaws(truth, written.cameras[0].id)}),
        camera_(*this),
        lights_(firmware_iface::make_fake_light_array(
            controller_, [this] { return tick(); }, [this] { return bus_fault(); })) {}

  [[nodiscard]] capture::Camera& camera() { return camera_; }
  /// Another camera on the same sensor, owned by the caller.
  [[nodiscard]] std::unique_ptr<capture::Camera> take_camera() {
    return std::make_unique<TwinCamera>(*this);
  }
  [[nodiscard]] firmware_iface::LightArray& lights() { return *lights_; }
  [[nodiscard]] firmware_iface::LightController& controller() { return controller_; }
  [[nodiscard]] capture::CommissionClock clock() {
    return {[this] { return now_; },
            [this](std::int64_t t) {
              now_ = std::max(now_, t + static_cast<std::int64_t>(8e4 * chance(35)));
            }};
  }
  [[nodiscard]] std::int64_t now_ns() const { return now_; }
  /// The camera is unplugged after so many more frames.
  void unplug_camera_after(int frames) { frames_left_ = frames; }
  /// One request, so many from now, gets no answer; it may have acted.
  void fail_bus_after(int requests, bool acts) {
    requests_left_ = requests;
    fault_acts_ = acts;
  }
  /// The camera exposes so many times as long as it says.
  void stretch_exposures(double factor) { stretch_ = factor; }
  [[nodiscard]] double lit_watts_peak() const { return peak_watts_; }

 private:
  std::optional<firmware_iface::FakeBusFault> bus_fault() {
    return requests_left_-- == 0
               ? std::optional(firmware_iface::FakeBusFault{Errc::timeout, fault_acts_})
               : std::nullopt;
  }

  double chance(std::uint64_t stream) {
    return uniform_unit(hash_key(seed_, stream, ++draws_));
  }

  /// Each look at the clock costs what a request costs.
  std::int64_t tick() {
    const double u = chance(31);
    now_ += static_cast<std::int64_t>(1e3 * (u < 0.98 ? 10.0 + 50.0 * u : 2000.0));
    controller_.advance(now_);
    peak_watts_ = std::max(peak_watts_, controller_.power().value());
    return now_;
  }

  class TwinCamera final : public capture::Camera {
   public:
    explicit TwinCamera(TwinBench& bench) : bench_(bench) {}

    Result<capture::CameraSetup> start(const CameraSpec& spec) override {
      const CameraSpec& is = bench_.truth_rig_.cameras[0];
      exposure_us_ = spec.exposure_us;
      next_start_ns_ = bench_.now_ + 1'000'000;
      words_ = Image<std::uint16_t>(is.frame_height, is.frame_width, 1);
      return capture::CameraSetup{.width = is.frame_width,
                                  .height = is.frame_height,
                                  .n_buffers = 8,
                                  .fps = is.fps,
                                  .exposure_us = spec.exposure_us,
                                  .identity = "twin"};
    }

    Result<capture::Frame> next(std::chrono::steady_clock::time_point deadline) override {
      if (bench_.frames_left_ == 0) {
        return fail(Errc::device_gone, "twin: unplugged");
      }
      const std::int64_t until =
          std::chrono::duration_cast<std::chrono::nanoseconds>(deadline.time_since_epoch())
              .count();
      // A frame takes the exposure of the moment in which it begins.
      while (next_start_ns_ <= until &&
             (running_.empty() || next_start_ns_ <= running_.front().arrival_ns)) {
        begin_frame();
      }
      if (running_.empty()) {
        bench_.now_ = std::max(bench_.now_, until);
        return fail(Errc::timeout, "twin: no frame yet");
      }
      const Running frame = running_.front();
      if (frame.arrival_ns > until) {
        bench_.now_ = std::max(bench_.now_, until);
        return fail(Errc::timeout, "twin: no frame yet");
      }
      running_.pop_front();
      bench_.now_ = std::max(bench_.now_, frame.arrival_ns);
      bench_.controller_.advance(bench_.now_);
      --bench_.frames_left_;
      sim::VirtualCamera& sensor = bench_.sensor_;
      const firmware_iface::LightHistory history = bench_.controller_.transitions(
          sensor.history_begin_ns(frame.exposure), sensor.end_ns(frame.exposure));
      sensor.take(history, frame.exposure, sensor.look(history, frame.exposure), frame.sequence,
                  words_.view());
      // A frame is the caller's until it gives it back; two may be held at once.
      auto copy = std::make_shared<Image<std::uint16_t>>(words_);
      capture::FrameInfo info;
      info.sequence = frame.sequence;
      info.timestamp_ns = sensor.timestamp_ns(frame.exposure);
      info.arrival_ns = bench_.now_;
      info.flags = capture::kFrameMonotonic;
      info.exposure_us = frame.exposure.exposure_us / bench_.stretch_;
      return capture::Frame(info, copy->view(), [copy]() mutable { copy.reset(); });
    }

    Result<double> set_exposure(double exposure_us) override {
      bench_.now_ += static_cast<std::int64_t>(1e3 * (5.0 + 30.0 * bench_.chance(32)));
      while (next_start_ns_ <= bench_.now_) {
        begin_frame();
      }
      exposure_us_ = exposure_us;
      bench_.now_ += static_cast<std::int64_t>(1e3 * (5.0 + 30.0 * bench_.chance(33)));
      return exposure_us;
    }

    void stop() noexcept override { running_.clear(); }

   private:
    struct Running {
      std::uint64_t sequence = 0;
      sim::Exposure exposure;
      std::int64_t arrival_ns = 0;
    };

    void begin_frame() {
      const CameraSpec& is = bench_.truth_rig_.cameras[0];
      requested_us_.push_back(exposure_us_);
      if (static_cast<int>(requested_us_.size()) > is.exposure_delay_frames + 1) {
        requested_us_.pop_front();
      }
      Running frame;
      frame.sequence = sequence_++;
      frame.exposure = {next_start_ns_, bench_.stretch_ * requested_us_.front(), 0.0};
      const double late = bench_.chance(34);
      frame.arrival_ns = bench_.sensor_.read_out_ns(frame.exposure) + 200'000 +
                         static_cast<std::int64_t>(1e3 * (late < 0.97 ? 300.0 * late : 5000.0));
      if (!running_.empty()) {
        frame.arrival_ns = std::max(frame.arrival_ns, running_.back().arrival_ns);
      }
      running_.push_back(frame);
      next_start_ns_ += std::max(std::llround(1e9 / is.fps),
                                 std::llround(1e3 * frame.exposure.exposure_us) + 20'000);
    }

    TwinBench& bench_;
    double exposure_us_ = 0.0;
    std::int64_t next_start_ns_ = 0;
    std::uint64_t sequence_ = 0;
    std::deque<double> requested_us_;
    std::deque<Running> running_;
    Image<std::uint16_t> words_;
  };

  TemporaryFolder folder_;
  Rig truth_rig_;
  std::int64_t now_ = 1'000'000'000;
  sim::Transport transport_;
  firmware_iface::LightController controller_;
  std::uint64_t seed_;
  std::uint64_t draws_ = 0;
  int requests_left_ = -1;
  bool fault_acts_ = false;
  int frames_left_ = -1;  // counts down; negative: never
  double peak_watts_ = 0.0;
  double stretch_ = 1.0;
  sim::VirtualCamera sensor_;
  TwinCamera camera_;
  std::unique_ptr<firmware_iface::LightArray> lights_;
};

}  // namespace haarlight::testing
