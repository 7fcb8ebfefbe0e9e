// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "capture/doctor/doctor_hints.h"
#include "firmware_iface/usb_link.h"
#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// `haarlight rig doctor`: what is present of a rig, what was expected, and a hint where the
/// two differ. Read-only: lights nothing, writes one test file next to the sessions and removes
/// it.

namespace haarlight::capture {

enum class Finding {
  good,
  warning,  ///< works, but not optimally
  wrong,    ///< a capture would fail
};
inline constexpr auto kFindingWords =
    std::to_array<std::string_view>({"good", "warning", "wrong"});
constexpr std::span<const std::string_view> words_of(Finding) { return kFindingWords; }

struct DoctorLine {
  std::string subject;  ///< "controller", "camera main", "disk", ...
  Finding finding = Finding::good;
  std::string expected;
  std::string found;
  Hint hint{};  ///< empty when good
};

struct DoctorOptions {
  /// Prefix of /sys, /dev and /etc: another folder in tests.
  std::filesystem::path root = "/";
  /// Other TCP ports and unit numbers to search for a controller that is not where it should
  /// be.
  std::vector<int> other_ports = {502, 1502, 1503};
  std::vector<int> other_units = {1, 2, 3, 4, 5};
  int camera_frames = 24;
  std::uint64_t disk_test_bytes = std::uint64_t{32} << 20U;
  /// GET of a local address: the body, or nothing without an answer. Reveals whether a daemon
  /// holds the devices.
  std::function<std::string(const std::string& url)> fetch;
  /// The light controllers on USB; empty: list_usb_controllers().
  std::function<Result<std::vector<firmware_iface::UsbController>>()> list_usb{};
};

/// Everything below, in the order in which it would be fixed.
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
/// What is known of a camera without opening it: is it there, and may it be used?
struct CameraPresence {
  DoctorLine line;   ///< good, but nothing found yet: go on to open it
  std::string node;  ///< where it is now
};
[[nodiscard]] CameraPresence find_camera(const CameraSpec& spec, const DoctorOptions& options);
/// What the operator can do when the camera cannot be started.
[[nodiscard]] Hint camera_hint(const CameraSpec& spec, const Fault& fault);
/// What the operator can do when the controller does not answer.
[[nodiscard]] Hint controller_hint(const ControllerSpec& spec);
[[nodiscard]] std::vector<DoctorLine> examine_storage(const Rig& rig,
                                                      const DoctorOptions& options);

}  // namespace haarlight::capture
