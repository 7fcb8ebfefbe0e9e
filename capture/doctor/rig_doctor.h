// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/rig/rig.h"
#include "firmware_iface/usb_link.h"

/// @file
/// `haarlight rig doctor`: what of a rig is there, what was expected, and the cure where the
/// two differ. Looks only: lights nothing, writes one test file beside the sessions and removes
/// it.

namespace haarlight {

enum class Finding {
  good,
  warning,  ///< works, but not as well as it could
  wrong,    ///< a capture would fail
};
[[nodiscard]] std::string_view to_string(Finding finding) noexcept;

struct DoctorLine {
  std::string subject;  ///< "controller", "camera main", "disk", ...
  Finding finding = Finding::good;
  std::string expected;
  std::string found;
  std::string cure;  ///< empty when good
};

struct DoctorOptions {
  /// Stands before /sys, /dev and /etc: another folder in tests.
  std::filesystem::path root = "/";
  /// Other TCP ports and unit numbers to look for a controller that is not where it should be.
  std::vector<int> other_ports = {502, 1502, 1503};
  std::vector<int> other_units = {1, 2, 3, 4, 5};
  int camera_frames = 24;
  std::uint64_t disk_test_bytes = std::uint64_t{32} << 20U;
  /// GET of a local address: the body, or nothing when nobody answers. Says whether a daemon
  /// holds the devices.
  std::function<std::string(const std::string& url)> fetch;
  /// The light controllers on USB; empty: list_usb_controllers().
  std::function<Result<std::vector<UsbController>>()> list_usb{};
};

/// Everything below, in the order in which a person would mend it.
[[nodiscard]] std::vector<DoctorLine> examine_rig(const std::filesystem::path& rig_file,
                                                  const DoctorOptions& options = {});
/// True when no line is wrong.
[[nodiscard]] bool is_healthy(const std::vector<DoctorLine>& lines);

// One subject each; `rig` as written.
[[nodiscard]] std::vector<DoctorLine> examine_measured(const std::filesystem::path& rig_file);
[[nodiscard]] std::vector<DoctorLine> examine_clock(const DoctorOptions& options);
/// @param holds_devices  set when a daemon answers
[[nodiscard]] std::vector<DoctorLine> examine_daemon(const Rig& rig,
                                                     const DoctorOptions& options,
                                                     bool& holds_devices);
[[nodiscard]] std::vector<DoctorLine> examine_controller(const Rig& rig,
                                                         const DoctorOptions& options);
[[nodiscard]] std::vector<DoctorLine> examine_camera(const Rig& rig, int camera,
                                                     const DoctorOptions& options);
/// What can be seen of a camera without opening it: is it there, and may it be used?
struct CameraPlace {
  DoctorLine line;   ///< good, nothing found yet: go on with opening it
  std::string node;  ///< where it is now
};
[[nodiscard]] CameraPlace find_camera(const CameraSpec& spec, const DoctorOptions& options);
/// What a person can do when the camera cannot be started.
[[nodiscard]] std::string camera_cure(const CameraSpec& spec, const Fault& fault);
/// What a person can do when the controller does not answer.
[[nodiscard]] std::string controller_cure(const ControllerSpec& spec);
[[nodiscard]] std::vector<DoctorLine> examine_storage(const Rig& rig,
                                                      const DoctorOptions& options);

}  // namespace haarlight
