// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

/// @file
/// The register map of a light controller, defined once: the drivers, the simulated controller
/// and docs/reference/register-map.md (a test compares them) all use this file. Addresses are
/// as on the wire, counted from 0. A 32-bit value is two registers, high word first, and is
/// written in one request or not at all.

namespace haarlight::firmware_iface::registers {

// Modbus limits of one request.
inline constexpr int kMaxRegistersWritten = 123;
inline constexpr int kMaxRegistersRead = 125;
inline constexpr int kMaxCoilsWritten = 1968;
inline constexpr int kMaxCoilsRead = 2000;

inline constexpr std::uint16_t kMagic = 0x484C;  ///< "HL"
inline constexpr std::uint16_t kMapVersion = 1;
inline constexpr std::uint16_t kMaxLevel = 65535;  ///< drive 1
inline constexpr int kMaxElements = 24576;         ///< six faces of 64 x 64
inline constexpr std::uint16_t kMinLeaseMs = 50;
inline constexpr std::uint16_t kMaxLeaseMs = 60000;

/// Input registers (function 4, read only).
namespace input {
// Identity: does not change while the controller runs.
inline constexpr std::uint16_t kMagic = 0x0000;
inline constexpr std::uint16_t kMapVersion = 0x0001;
inline constexpr std::uint16_t kSerial = 0x0002;
inline constexpr std::uint16_t kFirmware = 0x0004;
inline constexpr std::uint16_t kElements = 0x0006;
inline constexpr std::uint16_t kMaxLevel = 0x0007;
inline constexpr std::uint16_t kTableDepth = 0x0008;
inline constexpr std::uint16_t kMaxLeaseMs = 0x0009;
inline constexpr std::uint16_t kHardPowerLimit = 0x000A;
inline constexpr std::uint16_t kModel = 0x000C;
inline constexpr std::uint16_t kIdentityCount = 0x0014;
// Status: one read, one instant.
inline constexpr std::uint16_t kStatusFirst = 0x0020;
inline constexpr std::uint16_t kBootId = 0x0020;
inline constexpr std::uint16_t kUptimeMs = 0x0022;
inline constexpr std::uint16_t kStatusBits = 0x0024;
inline constexpr std::uint16_t kFaults = 0x0025;
inline constexpr std::uint16_t kTemperature = 0x0027;
inline constexpr std::uint16_t kSupplyCurrent = 0x0028;
inline constexpr std::uint16_t kTag = 0x0029;
inline constexpr std::uint16_t kShownSum = 0x002B;
inline constexpr std::uint16_t kStepCounter = 0x002D;
inline constexpr std::uint16_t kLatchCounter = 0x002F;
inline constexpr std::uint16_t kPower = 0x0031;
inline constexpr std::uint16_t kLeaseLeftMs = 0x0033;
inline constexpr std::uint16_t kRefusal = 0x0034;
inline constexpr std::uint16_t kShadowSum = 0x0035;
inline constexpr std::uint16_t kStatusCount = 0x0017;
}  // namespace input

/// Holding registers (functions 3, 6, 16).
namespace holding {
inline constexpr std::uint16_t kTag = 0x0000;
inline constexpr std::uint16_t kExpectedSum = 0x0002;
inline constexpr std::uint16_t kLatch = 0x0004;
inline constexpr std::uint16_t kTableStore = 0x0005;
inline constexpr std::uint16_t kStrobeDivider = 0x000E;
inline constexpr std::uint16_t kTableFirst = 0x000F;
inline constexpr std::uint16_t kStepSource = 0x0010;
inline constexpr std::uint16_t kTableArm = 0x0011;
inline constexpr std::uint16_t kStep = 0x0012;
inline constexpr std::uint16_t kTableExtend = 0x0013;
inline constexpr std::uint16_t kTriggerDelay = 0x0014;
inline constexpr std::uint16_t kLeaseMs = 0x0020;
inline constexpr std::uint16_t kLeaseRenew = 0x0021;
inline constexpr std::uint16_t kAllOff = 0x0022;
inline constexpr std::uint16_t kPowerLimit = 0x0023;
inline constexpr std::uint16_t kFaultClear = 0x0025;
inline constexpr std::uint16_t kEcho = 0x0027;
/// Shadow bank of levels: register kLevels + k is element k.
inline constexpr std::uint16_t kLevels = 0x1000;
}  // namespace holding

/// Value of kLatch and kStep that acts; 0 does nothing, anything else is an illegal value.
inline constexpr std::uint16_t kAct = 1;
inline constexpr std::uint16_t kMaxStrobeDivider = 255;
/// Largest value of kTriggerDelay, us.
inline constexpr std::uint32_t kMaxTriggerDelayUs = 1000000;
/// Value of kTableStore that does nothing.
inline constexpr std::uint16_t kStoreNothing = 0xFFFF;

/// Values of kStepSource.
enum class StepSource : std::uint16_t { host = 0, strobe = 1 };

// Bits of input::kStatusBits.
inline constexpr std::uint16_t kStatusDark = 1U << 0U;       ///< nothing is lit
inline constexpr std::uint16_t kStatusArmed = 1U << 1U;      ///< a pattern table is armed
inline constexpr std::uint16_t kStatusTableDone = 1U << 2U;  ///< stepped past its last entry

// Bits of input::kFaults. They stay until cleared; those marked "blocks" refuse every lit
// pattern as long as their cause lasts.
inline constexpr std::uint32_t kFaultLeaseExpired = 1U << 0U;  ///< the host was silent: all off
inline constexpr std::uint32_t kFaultOverPower = 1U << 1U;     ///< beyond a power limit
inline constexpr std::uint32_t kFaultElementDuty = 1U << 2U;   ///< an element beyond its duty
inline constexpr std::uint32_t kFaultOverTemperature = 1U << 3U;  ///< board too hot; blocks
inline constexpr std::uint32_t kFaultInterlock = 1U << 4U;        ///< interlock open; blocks
inline constexpr std::uint32_t kFaultBankSum = 1U << 5U;  ///< latch with a wrong bank sum

/// Values of kRefusal: why the last latch, store or step was refused.
enum class Refusal : std::uint16_t {
  none = 0,
  total_power = 1,
  group_power = 2,
  element_duty = 3,
  over_temperature = 4,
  interlock = 5,
  bank_sum = 6,
  tag_zero = 7,
  table_range = 8,
  table_not_armed = 9,
};

/// Modbus exception codes used; `none` is an ordinary answer.
enum class Exception : std::uint8_t {
  none = 0,
  illegal_function = 1,
  illegal_address = 2,
  illegal_value = 3,
  device_failure = 4,  ///< refused by a limit or a state: kRefusal says which
  busy = 6,
  bank_sum = 8,         ///< the bank is not what the host expects (Modbus: memory parity error)
  gateway_target = 11,  ///< a different unit was addressed
};

enum class Space : std::uint8_t { coil, discrete_input, input_register, holding_register };

/// One line of the map, as printed in docs/reference/register-map.md.
struct RegisterRow {
  Space space;
  std::uint16_t address;
  int count;  ///< registers or bits; 0 = one per element
  std::string_view name;
  std::string_view unit;
  std::string_view meaning;
};

inline constexpr std::array kRegisterMap = {
    RegisterRow{Space::coil, 0, 0, "on", "", "shadow bank: element k is on; read and write"},
    RegisterRow{Space::discrete_input, 0, 0, "lit", "", "element k is lit at this moment"},
    RegisterRow{Space::input_register, input::kMagic, 1, "magic", "", "0x484C (\"HL\")"},
    RegisterRow{Space::input_register, input::kMapVersion, 1, "map_version", "", "1"},
    RegisterRow{Space::input_register, input::kSerial, 2, "serial", "", "serial number"},
    RegisterRow{Space::input_register, input::kFirmware, 2, "firmware", "",
                "version: major, minor, patch in bits 31-16, 15-8, 7-0"},
    RegisterRow{Space::input_register, input::kElements, 1, "elements", "",
                "light elements of the controller"},
    RegisterRow{Space::input_register, input::kMaxLevel, 1, "max_level", "",
                "level of full drive: 65535"},
    RegisterRow{Space::input_register, input::kTableDepth, 1, "table_depth", "",
                "entries of the pattern table"},
    RegisterRow{Space::input_register, input::kMaxLeaseMs, 1, "max_lease", "ms",
                "longest lease that is accepted"},
    RegisterRow{Space::input_register, input::kHardPowerLimit, 2, "hard_power_limit", "0.1 W",
                "of all elements together; power_limit cannot exceed it"},
    RegisterRow{Space::input_register, input::kModel, 8, "model", "",
                "16 characters, two per register, high byte first, padded with 0"},
    RegisterRow{Space::input_register, input::kBootId, 2, "boot_id", "",
                "another number at every start"},
    RegisterRow{Space::input_register, input::kUptimeMs, 2, "uptime", "ms", "since the start"},
    RegisterRow{Space::input_register, input::kStatusBits, 1, "status", "",
                "bit 0 dark, 1 table armed, 2 table stepped past its end"},
    RegisterRow{Space::input_register, input::kFaults, 2, "faults", "",
                "bit 0 lease expired, 1 power, 2 element duty, 3 temperature, 4 interlock, "
                "5 bank sum"},
    RegisterRow{Space::input_register, input::kTemperature, 1, "temperature", "0.1 deg C",
                "hottest board, signed"},
    RegisterRow{Space::input_register, input::kSupplyCurrent, 1, "supply_current", "0.01 A",
                "drawn now"},
    RegisterRow{Space::input_register, input::kTag, 2, "shown_tag", "",
                "tag of what is lit; 0 = dark by all_off, lease, fault or start"},
    RegisterRow{Space::input_register, input::kShownSum, 2, "shown_sum", "",
                "bank sum of what is lit"},
    RegisterRow{Space::input_register, input::kStepCounter, 2, "step_counter", "",
                "steps since the table was armed, those past its end included"},
    RegisterRow{Space::input_register, input::kLatchCounter, 2, "latch_counter", "",
                "changes of light since the start"},
    RegisterRow{Space::input_register, input::kPower, 2, "power", "0.1 W", "of what is lit"},
    RegisterRow{Space::input_register, input::kLeaseLeftMs, 1, "lease_left", "ms",
                "until all goes off; 0 when nothing is lit or armed"},
    RegisterRow{
        Space::input_register, input::kRefusal, 1, "refusal", "",
        "of the last latch, store or step: 0 none, 1 total power, 2 group power, 3 element "
        "duty, 4 temperature, 5 interlock, 6 bank sum, 7 tag 0, 8 table range, 9 table not "
        "armed"},
    RegisterRow{Space::input_register, input::kShadowSum, 2, "shadow_sum", "",
                "bank sum of the shadow bank"},
    RegisterRow{Space::holding_register, holding::kTag, 2, "tag", "",
                "goes with the next latch or table_store; 0 is refused with any light on"},
    RegisterRow{Space::holding_register, holding::kExpectedSum, 2, "expected_sum", "",
                "bank sum the host means; compared once by the next latch or table_store"},
    RegisterRow{Space::holding_register, holding::kLatch, 1, "latch", "",
                "1 = show the shadow bank whole, restart the lease; 0 = nothing"},
    RegisterRow{Space::holding_register, holding::kTableStore, 1, "table_store", "",
                "i = copy shadow bank and tag to table entry i; 0xFFFF = nothing"},
    RegisterRow{
        Space::holding_register, holding::kStrobeDivider, 1, "strobe_divider", "",
        "n = the next table_arm's table steps at every n-th edge of the strobe line, its "
        "first edge included; 1 to 255, and 1 again after the arming"},
    RegisterRow{Space::holding_register, holding::kTableFirst, 1, "table_first", "",
                "entry that the next table_arm begins with; 0 again after the arming"},
    RegisterRow{Space::holding_register, holding::kStepSource, 1, "step_source", "",
                "0 = steps by the host, 1 = by the camera's strobe line; set before table_arm"},
    RegisterRow{Space::holding_register, holding::kTableArm, 1, "table_arm", "entries",
                "n = arm n entries from table_first on, go dark, set step_counter to 0; 0 = "
                "disarm"},
    RegisterRow{Space::holding_register, holding::kStep, 1, "step", "",
                "1 = show the next entry, past the last one go dark; restarts the lease"},
    RegisterRow{Space::holding_register, holding::kTableExtend, 1, "table_extend", "entries",
                "n = n entries are armed from now on, without going dark; nothing happens when "
                "it is not more, or when the table was stepped past its end"},
    RegisterRow{Space::holding_register, holding::kTriggerDelay, 2, "trigger_delay", "us",
                "from each latch of a pattern to a pulse on the camera's trigger line; 0 = no "
                "pulse, at most 1000000"},
    RegisterRow{Space::holding_register, holding::kLeaseMs, 1, "lease", "ms",
                "50 to max_lease; restarts the lease"},
    RegisterRow{Space::holding_register, holding::kLeaseRenew, 1, "lease_renew", "",
                "any value restarts the lease"},
    RegisterRow{Space::holding_register, holding::kAllOff, 1, "all_off", "",
                "any value: dark, all on bits and the tag cleared, table disarmed; always "
                "accepted"},
    RegisterRow{Space::holding_register, holding::kPowerLimit, 2, "power_limit", "0.1 W",
                "of all elements together"},
    RegisterRow{Space::holding_register, holding::kFaultClear, 2, "fault_clear", "",
                "bits of faults to clear"},
    RegisterRow{Space::holding_register, holding::kEcho, 2, "echo", "",
                "scratch: what is written is read back (proof of the line)"},
    RegisterRow{Space::holding_register, holding::kLevels, 0, "level", "1/65535",
                "shadow bank: drive of element k while it is on"},
};

}  // namespace haarlight::firmware_iface::registers
