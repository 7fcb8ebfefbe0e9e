// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "capture/camera/camera.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// One camera and one light array under a commissioning run's control: keeps the lease, records
/// when frames arrive, and leaves the rig dark on every exit path. Uses the devices directly,
/// not through the daemon: that discards the frames that saw the light change, which are the
/// ones needed here.

namespace haarlight::capture {

/// CLOCK_MONOTONIC, or a virtual clock in tests.
struct CommissionClock {
  std::function<std::int64_t()> now_ns;
  std::function<void(std::int64_t)> sleep_until_ns;
};
[[nodiscard]] CommissionClock monotonic_clock();

/// From when a capture counts its light's settling: the read-back that shows the pattern.
[[nodiscard]] inline std::int64_t settle_reference_ns(
    const firmware_iface::LatchReceipt& receipt) {
  return receipt.t_shown_ns != 0 ? receipt.t_shown_ns : receipt.t_ack_ns;
}

/// A thin band of rows whose mean is tracked; `position` 0 = first row, 1 = last.
struct RowBand {
  int first = 0;
  int count = 1;
  double position = 0.0;
};

struct ArrivedFrame {
  Frame frame;
  std::int64_t arrival_ns = 0;
};

using LightPattern = std::vector<firmware_iface::ElementLevel>;

/// Mean and scatter of the bands under steady light.
struct SteadyLevel {
  std::vector<double> bands;   ///< counts
  double frame_scatter = 0.0;  ///< rms over frames of a band's mean, pooled
  double low_level = 0.0;      ///< a quarter of the pixels are darker than this, counts
  double median = 0.0;
  double high_level = 0.0;  ///< 1 % of the pixels are brighter than this
};

/// One thread. Every device fault becomes an Error(unavailable) with a hint; a requested stop
/// becomes Error(interrupted).
class CommissionBench {
 public:
  /// Borrows everything. @param should_stop  polled between frames; may be empty
  CommissionBench(const Rig& rig, int camera, Camera& device,
                  firmware_iface::LightArray& lights, CommissionClock clock,
                  std::function<bool()> should_stop);
  /// Lights off, camera stopped; never throws.
  ~CommissionBench();
  CommissionBench(const CommissionBench&) = delete;
  CommissionBench& operator=(const CommissionBench&) = delete;

  /// Connects the lights (dark first), starts the camera at `exposure_us`, measures its period.
  void open(double exposure_us);

  [[nodiscard]] firmware_iface::LatchReceipt show(const LightPattern& pattern);
  /// Median time from calling show() to the middle of its latch request, ns.
  [[nodiscard]] std::int64_t lead_ns() const;
  [[nodiscard]] ArrivedFrame next_frame();
  /// Takes frames until that moment, then sleeps up to it.
  void drain_until(std::int64_t t_ns);
  /// @return  as read back; `before` and `after` bracket the instant of setting
  double set_exposure(double exposure_us, std::int64_t* before_ns = nullptr,
                      std::int64_t* after_ns = nullptr);
  /// Lets frames pass until exposure and light have certainly taken effect.
  void settle();
  /// Shows a pattern, settles, and measures `n` frames.
  [[nodiscard]] SteadyLevel look_steady(const LightPattern& pattern, int n_frames);

  [[nodiscard]] std::vector<double> band_means(const Frame& frame) const;
  [[nodiscard]] const std::vector<RowBand>& bands() const { return bands_; }
  [[nodiscard]] std::int64_t now_ns() const { return clock_.now_ns(); }
  [[nodiscard]] const CameraSpec& spec() const { return spec_; }
  [[nodiscard]] const Rig& rig() const { return rig_; }
  [[nodiscard]] int camera_index() const { return camera_index_; }
  [[nodiscard]] double period_us() const { return period_us_; }
  [[nodiscard]] double exposure_us() const { return exposure_us_; }
  [[nodiscard]] const CameraSetup& setup() const { return setup_; }
  [[nodiscard]] const firmware_iface::ControllerIdentity& controller() const {
    return controller_;
  }
  [[nodiscard]] int white() const { return (1 << spec_.bits) - 1; }
  /// Frames to let pass after a change of exposure; grows once the delay is known.
  void set_settle_frames(int n) { settle_frames_ = n; }
  /// The lights in order of use: those that contribute most first, as many together as the
  /// rig's power budget allows.
  [[nodiscard]] LightPattern brightest(int n) const;
  [[nodiscard]] int n_allowed() const { return n_allowed_; }
  [[nodiscard]] std::int64_t last_timestamp_ns() const { return last_timestamp_ns_; }

 private:
  template <class T>
  T demand(Result<T> result, const char* what);
  void demand_void(const Result<void>& result, const char* what);
  void check_stop() const;
  void keep_lease();
  void measure_period();
  void choose_order();

  const Rig& rig_;
  int camera_index_;
  CameraSpec spec_;
  Camera& camera_;
  firmware_iface::LightArray& lights_;
  CommissionClock clock_;
  std::function<bool()> should_stop_;
  CameraSetup setup_;
  firmware_iface::ControllerIdentity controller_;
  std::vector<RowBand> bands_;
  std::vector<int> order_;
  int n_allowed_ = 0;
  double period_us_ = 0.0;
  double exposure_us_ = 0.0;
  int settle_frames_ = 8;
  std::uint32_t tag_ = 0;
  std::int64_t lease_ns_ = 0;
  std::int64_t last_timestamp_ns_ = 0;
  std::vector<std::int64_t> leads_;
};

}  // namespace haarlight::capture
