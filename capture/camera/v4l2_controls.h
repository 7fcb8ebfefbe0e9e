// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include "capture/camera/camera.h"
#include "capture/camera/v4l2_device.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Fully manual control: which controls of a V4L2 camera are set, in which order, and what they
/// must stay. Every value set is read back; one that differs later has changed by itself.

namespace haarlight::capture {

/// A control that was set.
struct SetControl {
  V4l2Control control;
  std::int64_t value = 0;  ///< as read back
};

class V4l2Controls {
 public:
  /// What to set, in order: exposure mode, exposure priority, white balance, gain and focus
  /// modes to manual and power-line frequency to off, where the device has them and the rig
  /// file says nothing else; then exposure, gain, the other values of the rig file, and those
  /// that select what starts an exposure. Only queries the device.
  /// @param offered  V4l2Device::controls()
  /// Fault unsupported: a name, value or menu entry that the device does not have (lists those
  /// it has); an exposure or gain that cannot be expressed in its units; a trigger that the rig
  /// file does not describe.
  [[nodiscard]] static Result<V4l2Controls> choose(const std::vector<V4l2Control>& offered,
                                                   const CameraSpec& spec,
                                                   TriggerSource trigger);

  /// Sets each in order, reads it back, and subscribes to changes. Fault refused: the device
  /// set a value other than the rig file's (exposure: whatever it set is accepted).
  [[nodiscard]] Result<void> apply(V4l2Device& device);

  /// Reads every control back. Fault io: one changed by itself.
  [[nodiscard]] Result<void> verify(const V4l2Device& device) const;
  /// The same for a change reported by the driver.
  [[nodiscard]] Result<void> validate(const V4l2Event& event) const;

  /// Fault unsupported when the rig file says exposure_control = "none" and the time differs.
  [[nodiscard]] Result<double> set_exposure(V4l2Device& device, double exposure_us);

  /// Starts an exposure. Fault device_busy: the camera is already exposing. Fault unsupported:
  /// not set up for TriggerSource::software.
  [[nodiscard]] Result<void> fire(V4l2Device& device) const;

  /// In force, as read back; the rig file's value where no control sets it.
  [[nodiscard]] double exposure_us() const;
  [[nodiscard]] double gain_db() const;
  [[nodiscard]] bool can_set_exposure() const { return exposure_.has_value(); }
  [[nodiscard]] const std::vector<SetControl>& controls() const { return controls_; }

 private:
  class Chooser;
  [[nodiscard]] Result<void> set_one(V4l2Device& device, SetControl& set, bool is_exact) const;
  [[nodiscard]] std::int64_t exposure_steps(double exposure_us) const;

  std::vector<SetControl> controls_;     ///< in order of setting
  std::optional<std::size_t> exposure_;  ///< index of the exposure time
  std::optional<std::size_t> gain_;      ///< index of the gain, where it has a unit
  std::optional<V4l2Control> fire_;
  double exposure_unit_us_ = 0.0;
  double gain_unit_db_ = 0.0;
  double fixed_exposure_us_ = 0.0;
  double noted_gain_db_ = 0.0;
};

}  // namespace haarlight::capture
