// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "capture/camera/metadata_rows.h"
#include "firmware_iface/light_history.h"
#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"
#include "sim/transport_file.h"

/// @file
/// The sensor of the virtual rig: integrates the lights' true state over each row's exposure
/// and turns it into sensor words with photon and read noise. Model, per pixel:
///
///     mu    = lit_electrons  (E / E_rig)  sum_k drive_k(row)  T_k / scale          electrons
///     e     = Poisson(mu) + read N(0, 1),  e <= full well
///     word  = round(black + e 10^(dB/20) / gain), clipped to 0 .. 2^bits - 1
///
/// Poisson by inversion below 30 electrons, above by a normal of variance mu (together with the
/// read noise), whose relative error in the variance is below 0.3 %. An LED follows a change
/// after `latch`, then rises or falls linearly over `rise` or `fall` (the longest delays the
/// rig file allows, so that a rig file with too short delays is found out).

namespace haarlight::sim {

/// Additional effects of real LEDs and real sensors; all 0: an ideal rig.
struct RigFlaws {
  /// Every LED is brighter by this fraction at the camera's first frame, and settles:
  /// 1 + warm_up exp(-t / warm_up_s).
  double warm_up = 0.0;
  double warm_up_s = 60.0;
  /// Each light change comes later by 0 to this much, drawn uniformly by the time of its latch;
  /// and each of its ramps is longer by 0 to ramp_spread_us.
  double latch_spread_us = 0.0;
  double ramp_spread_us = 0.0;
  double dark_e_per_s = 0.0;  ///< dark current of a normal pixel
  double hot_fraction = 0.0;  ///< this fraction of the pixels has hot_e_per_s
  double hot_e_per_s = 0.0;
  double prnu = 0.0;        ///< rms relative deviation of the pixels' sensitivity
  double vignetting = 0.0;  ///< sensitivity lost in the corners, growing with r^2
  friend bool operator==(const RigFlaws&, const RigFlaws&) = default;
};

struct VirtualCameraOptions {
  std::uint64_t seed = 1;
  /// Electrons of a lit pixel of the plane under one light at the rig file's exposure;
  /// 0 = half the full well.
  double lit_electrons = 0.0;
  bool has_noise = true;
  /// Of each light, 1 = as rendered, 0 = dead; empty: all 1.
  std::vector<double> light_power;
  /// Element k lights the LED wiring[k]; empty: its own.
  std::vector<int> wiring;
  RigFlaws flaws;
};

/// One frame to be taken.
struct Exposure {
  std::int64_t start_ns = 0;  ///< of the first row
  double exposure_us = 0.0;
  double gain_db = 0.0;
};

/// What the light did during a frame.
struct LightSeen {
  capture::FrameTag tag;
  std::int64_t last_change_ns =
      0;  ///< when the light last became steady before the frame's start
};

/// One thread.
class VirtualCamera {
 public:
  /// Keeps a reference to `transport`.
  /// @throws Error  transport of another size, too few embedded metadata rows, no full well
  VirtualCamera(const CameraSpec& spec, ControllerSpec controller, const Transport& transport,
                VirtualCameraOptions options = {});

  /// The span of light history that a frame needs.
  [[nodiscard]] std::int64_t history_begin_ns(const Exposure& exposure) const;
  [[nodiscard]] std::int64_t end_ns(const Exposure& exposure) const;  ///< of the last row
  /// Of the readout: neither the last row's exposure nor the first row's readout ends later.
  [[nodiscard]] std::int64_t read_out_ns(const Exposure& exposure) const;
  /// Its timestamp.
  [[nodiscard]] std::int64_t timestamp_ns(const Exposure& exposure) const;

  [[nodiscard]] LightSeen look(const firmware_iface::LightHistory& history,
                               const Exposure& exposure) const;

  /// Takes the frame.
  /// @param noise_key  selects the noise: the same key and light give the same words
  /// @param words      (frame_height, frame_width, 1), including the embedded metadata rows
  void take(const firmware_iface::LightHistory& history, const Exposure& exposure,
            const LightSeen& seen, std::uint64_t noise_key, ImageView<std::uint16_t> words);

  /// Only the embedded metadata rows.
  void write_tag(const LightSeen& seen, ImageView<std::uint16_t> words) const;

  /// Electrons of a value T / scale = 1 at this exposure and drive 1.
  [[nodiscard]] double electrons_per_unit(double exposure_us) const;
  [[nodiscard]] const CameraSpec& spec() const noexcept { return spec_; }

 private:
  struct Element {
    int index = 0;
    std::vector<float> drive;  ///< mean over each row's exposure; one value when all are equal
  };
  /// The effect of one light change: when it begins after its latch, and its ramps. All ns.
  struct Delay {
    double latch = 0.0;
    double rise = 0.0;
    double fall = 0.0;
  };
  [[nodiscard]] Delay delay_of(const firmware_iface::LightTransition& state) const;
  [[nodiscard]] std::vector<Element> mean_drive_levels(
      const firmware_iface::LightHistory& history, const Exposure& exposure) const;
  void sum_light(const std::vector<Element>& elements, double electrons);
  void read_out(const Exposure& exposure, std::uint64_t noise_key,
                ImageView<std::uint16_t> words) const;
  void make_flaws();

  CameraSpec spec_;
  ControllerSpec controller_;
  const Transport* transport_;
  VirtualCameraOptions options_;
  std::vector<float> mean_;    ///< electrons, (height, width)
  std::vector<float> normal_;  ///< quantiles of the standard normal
  // Of the sensor's flaws; empty: none.
  std::vector<float> sensitivity_;
  std::vector<float> dark_;  ///< electrons per second
  std::int64_t first_ns_ = -1;
  // The last steady pattern, whose mean is still in mean_.
  std::shared_ptr<const std::vector<firmware_iface::ElementLevel>> steady_;
  double steady_exposure_us_ = 0.0;
};

}  // namespace haarlight::sim
