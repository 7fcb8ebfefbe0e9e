// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/rig/rig.h"

/// @file
/// Another vendor's Modbus registers, as described in a profile file
/// (docs/reference/controllers.md): which function and address sets the level of channel k,
/// switches it, makes a pattern show, turns all off. So a common controller needs no C++.

namespace haarlight::firmware_iface {

/// Modbus functions that a profile may name.
enum class WriteFunction : std::uint8_t {
  coil = 5,
  word = 6,
  coils = 15,
  words = 16,
};
enum class CheckFunction : std::uint8_t {
  coils = 1,
  holding = 3,
  input = 4,
};

/// Where channel k's value is: address `first + k`.
struct ProfileChannels {
  WriteFunction write = WriteFunction::words;
  CheckFunction read = CheckFunction::holding;  ///< for reading back what was written
  std::uint16_t first = 0;
  int per_request = 1;     ///< channels one request may write or read
  std::uint16_t full = 1;  ///< the value of drive 1; coils: 1
};

/// One value at one address.
struct ProfileValue {
  std::uint16_t address = 0;
  std::uint16_t value = 0;
  WriteFunction write = WriteFunction::word;
  bool is_kept = true;  ///< reads back as written
};

struct ProfileExpectation {
  CheckFunction read = CheckFunction::holding;
  std::uint16_t address = 0;
  std::uint16_t value = 0;
};

struct ControllerProfile {
  std::string name;
  std::string source;  ///< where the vendor documents the registers
  int channels = 0;
  ProfileChannels channel;
  std::vector<ProfileValue> at_connect;      ///< written once per connection, and read back
  std::vector<ProfileExpectation> identity;  ///< must match, otherwise it is a different device
  std::vector<ProfileValue> before;          ///< before a pattern's values
  std::vector<ProfileValue> latch;           ///< shows them; empty: each takes effect by itself

  [[nodiscard]] bool has_levels() const noexcept { return channel.full > 1; }
};

/// @throws Error  every problem with file:line and a hint
[[nodiscard]] ControllerProfile read_controller_profile(const std::filesystem::path& path);
[[nodiscard]] ControllerProfile parse_controller_profile(const std::string& text,
                                                         const std::string& name);

/// What a controller with a profile does not guarantee, in plain sentences for log and page.
[[nodiscard]] std::vector<std::string> missing_promises(const ControllerProfile& profile);

/// The file of a profile named in a rig file: a path relative to that file, or a bare name
/// searched for in `profiles/` next to it and one folder up. Empty: not found.
[[nodiscard]] std::filesystem::path find_controller_profile(
    const std::string& name, const std::filesystem::path& rig_file);

/// Reads the profile that a rig's controller needs, as the daemon will.
/// @throws Error  not there, not readable, fewer channels than the rig has lights
void require_profile(const Rig& rig);

}  // namespace haarlight::firmware_iface
