// SPDX-License-Identifier: Apache-2.0
#include "haarlight/firmware_iface/controller_profile.h"

#include <array>
#include <system_error>

#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/firmware_iface/register_map.h"

namespace haarlight::firmware_iface {

namespace {

constexpr Range kWord{.min = 0.0, .max = 65535.0};

WriteFunction read_write_function(ConfigTable& t, WriteFunction fallback) {
  const auto number =
      t.integer_or("write", static_cast<std::int64_t>(fallback), {.min = 1, .max = 127});
  switch (number) {
    case 5:
    case 6:
    case 15:
    case 16:
      return static_cast<WriteFunction>(number);
    default:
      t.problem("write", fmt::format("function {} does not write", number),
                "5 = one coil, 6 = one register, 15 = coils, 16 = registers");
      return fallback;
  }
}

CheckFunction read_check_function(ConfigTable& t, CheckFunction fallback) {
  const auto number =
      t.integer_or("read", static_cast<std::int64_t>(fallback), {.min = 1, .max = 127});
  switch (number) {
    case 1:
    case 3:
    case 4:
      return static_cast<CheckFunction>(number);
    default:
      t.problem("read", fmt::format("function {} is not used for reading back", number),
                "1 = coils, 3 = holding registers, 4 = input registers");
      return fallback;
  }
}

bool is_coil(WriteFunction function) {
  return function == WriteFunction::coil || function == WriteFunction::coils;
}

ProfileChannels read_channels(ConfigTable& t, int n_channels) {
  ProfileChannels c;
  c.write = read_write_function(t, WriteFunction::words);
  const bool is_bit = is_coil(c.write);
  c.read = read_check_function(t, is_bit ? CheckFunction::coils : CheckFunction::holding);
  c.first = static_cast<std::uint16_t>(t.integer("first", kWord));
  c.full = static_cast<std::uint16_t>(t.integer_or("full", 1, {.min = 1, .max = 65535}));
  const bool is_single = c.write == WriteFunction::coil || c.write == WriteFunction::word;
  const int longest = is_bit ? registers::kMaxCoilsWritten : registers::kMaxRegistersWritten;
  c.per_request = static_cast<int>(
      t.integer_or("per_request", is_single ? 1 : longest,
                   {.min = 1, .max = static_cast<double>(is_single ? 1 : longest)}));
  if (is_bit && c.full != 1) {
    t.problem("full", "a coil is on or off", "leave full out");
  }
  if (is_bit != (c.read == CheckFunction::coils)) {
    t.problem("read", "coils are read back as coils, registers as registers",
              "read = 1 for write = 5 or 15; read = 3 or 4 for write = 6 or 16");
  }
  if (c.first + n_channels > 65536) {
    t.problem("first", "the last channel's address is beyond 65535", "check first, channels");
  }
  return c;
}

std::vector<ProfileValue> read_values(ConfigTable& root, std::string_view key,
                                      bool is_kept_always) {
  std::vector<ProfileValue> values;
  for (ConfigTable& t : root.tables(key)) {
    ProfileValue v;
    v.address = static_cast<std::uint16_t>(t.integer("address", kWord));
    v.value = static_cast<std::uint16_t>(t.integer("value", kWord));
    v.write = read_write_function(t, WriteFunction::word);
    v.is_kept = is_kept_always || t.flag_or("kept", true);
    if (is_coil(v.write) && v.value > 1) {
      t.problem("value", "a coil is 0 or 1", "write 0 or 1");
    }
    values.push_back(v);
  }
  return values;
}

ControllerProfile read_tables(ConfigTable& root) {
  ControllerProfile profile;
  root.integer("schema", {.min = 1, .max = 1});
  profile.name = root.text("name");
  profile.source = root.text("source");
  profile.channels = static_cast<int>(
      root.integer("channels", {.min = 1, .max = double{registers::kMaxElements}}));
  if (auto channel = root.table("channel")) {
    profile.channel = read_channels(*channel, profile.channels);
  } else {
    root.problem("channel", "[channel] is missing",
                 "add [channel] with write, first and, for levels, full");
  }
  profile.at_connect = read_values(root, "connect", true);
  profile.before = read_values(root, "before", false);
  profile.latch = read_values(root, "latch", false);
  for (ConfigTable& t : root.tables("identity")) {
    ProfileExpectation e;
    e.read = read_check_function(t, CheckFunction::holding);
    e.address = static_cast<std::uint16_t>(t.integer("address", kWord));
    e.value = static_cast<std::uint16_t>(t.integer("value", kWord));
    profile.identity.push_back(e);
  }
  if (!profile.before.empty() && profile.latch.empty()) {
    root.problem("before", "[[before]] without [[latch]]",
                 "add the value that shows a pattern");
  }
  root.finish();
  return profile;
}

}  // namespace

ControllerProfile parse_controller_profile(const std::string& text, const std::string& name) {
  ConfigTable root = ConfigTable::parse_text(text, name);
  return read_tables(root);
}

ControllerProfile read_controller_profile(const std::filesystem::path& path) {
  return parse_controller_profile(read_file(path, 1U << 20U), path.string());
}

std::vector<std::string> missing_promises(const ControllerProfile& profile) {
  std::vector<std::string> missing;
  missing.emplace_back(
      "no tag: a pattern is proven by reading every channel back, which shows what was set, "
      "not "
      "when");
  missing.emplace_back(
      "no lease: when the host dies or the cable comes out, the lights stay as they are. Only "
      "the host's own deadman turns them off; wire a watchdog relay into their supply");
  missing.emplace_back("no limits: power and heat are watched by the host alone");
  missing.emplace_back(
      "no start number: a restart of the controller shows only when its outputs changed with "
      "it");
  missing.emplace_back("no pattern table: it cannot be stepped by the camera's strobe");
  if (profile.latch.empty()) {
    missing.emplace_back(
        "no latch: channels change one after the other, and a frame counts only after the last "
        "of them");
  }
  if (!profile.has_levels()) {
    missing.emplace_back("no levels: a channel is on or off; any other drive is refused");
  }
  return missing;
}

std::filesystem::path find_controller_profile(const std::string& name,
                                              const std::filesystem::path& rig_file) {
  namespace fs = std::filesystem;
  const fs::path folder =
      rig_file.empty() ? fs::current_path() : fs::absolute(rig_file).parent_path();
  const fs::path candidates[] = {folder / name, folder / "profiles" / (name + ".toml"),
                                 folder.parent_path() / "profiles" / (name + ".toml")};
  for (const fs::path& candidate : candidates) {
    std::error_code ignored;
    if (fs::is_regular_file(candidate, ignored)) {
      return candidate;
    }
  }
  return {};
}

void require_profile(const Rig& rig) {
  if (rig.controller.profile == "haarlight") {
    return;
  }
  const std::filesystem::path file = find_controller_profile(rig.controller.profile, rig.file);
  if (file.empty()) {
    throw Error(fmt::format("controller profile \"{}\": no such file", rig.controller.profile),
                rig.file.string(),
                "put it beside the rig file or in profiles/, or correct profile =");
  }
  const ControllerProfile profile = read_controller_profile(file);
  if (rig.n_lights() > profile.channels) {
    throw Error(fmt::format("{} lights, but a {} has {} channels", rig.n_lights(), profile.name,
                            profile.channels),
                rig.file.string(), "correct the faces, or choose another profile");
  }
}

}  // namespace haarlight::firmware_iface
