// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// The light controller as a device. One thread owns one LightArray. Implementations:
/// RegisterLightArray (our own registers over Modbus or USB) and ProfileLightArray (another
/// vendor's registers).

namespace haarlight::firmware_iface {

struct ControllerIdentity {
  std::string model;
  std::uint32_t serial = 0;
  std::uint32_t firmware = 0;
  std::uint32_t boot_id = 0;  ///< changes at every start of the controller
  std::uint32_t uptime_ms = 0;
  int n_elements = 0;
  int table_depth = 0;
  /// What this controller does not guarantee, in plain sentences; empty for our own register
  /// map.
  std::vector<std::string> missing;
};

struct ControllerStatus {
  std::uint32_t uptime_ms = 0;
  std::uint32_t boot_id = 0;
  std::uint32_t faults = 0;  ///< registers::kFault... bits
  std::uint32_t tag = 0;     ///< of what is lit
  std::uint32_t step_counter = 0;
  double temperature_c = 0.0;
  double supply_a = 0.0;
  bool is_dark = true;
  bool is_armed = false;       ///< a pattern table
  bool is_table_done = false;  ///< it stepped past its last armed entry
};

/// One element of a pattern and its level; 65535 = drive 1.
struct ElementLevel {
  int element = 0;
  std::uint16_t level = 65535;
};

/// A run of the uploaded table that the camera's strobe steps.
struct StrobeRun {
  int first = 0;    ///< entry that the first edge shows
  int count = 0;    ///< entries armed; extend_strobe raises it
  int divider = 1;  ///< steps at every n-th edge
};

/// The evidence a receipt has for what is lit.
enum class LightProof {
  tag,        ///< the controller returned the tag and the sum of what it shows
  read_back,  ///< it has no tags: every channel was read back and holds what was written
};

/// Evidence of what is lit.
struct LatchReceipt {
  std::int64_t t_command_ns = 0;  ///< CLOCK_MONOTONIC just before the latch was sent
  std::int64_t t_ack_ns = 0;      ///< just after its acknowledgement arrived
  /// Just after the answer arrived that shows the tag and the sum (or the channels' values).
  /// The light counts from here: a gateway may acknowledge long before it acts. 0: not read
  /// back.
  std::int64_t t_shown_ns = 0;
  std::uint32_t tag_echo = 0;  ///< read back after the latch; for LightProof::read_back the
                               ///< host's own, assigned to what was read
  LightProof proof = LightProof::tag;
};

/// A controller, or the gateway in front of it, may act this long after its acknowledgement:
/// until then a read-back of the previous state is repeated, later it is a fault.
inline constexpr std::int64_t kShownWithinNs = 100'000'000;

/// Faults: timeout, device_gone, protocol (state UNKNOWN: call all_off or show again), refused
/// (power, duty or range limit: nothing was lit), device_busy. Any fault voids the last
/// receipt: nothing is known about the light until a call succeeds.
class LightArray {
 public:
  LightArray() = default;
  virtual ~LightArray() = default;
  LightArray(const LightArray&) = delete;
  LightArray& operator=(const LightArray&) = delete;
  [[nodiscard]] virtual Result<ControllerIdentity> connect() = 0;
  virtual void disconnect() noexcept = 0;
  /// Writes the shadow bank (only what differs from its known contents), the tag, and latches;
  /// reads tag and bank sum back until they show, kShownWithinNs at most. The pattern may be
  /// empty (a dark frame), its levels may be 0, and it names each element at most once.
  /// @param tag  not 0, which means dark by all_off, lease, fault or restart
  [[nodiscard]] virtual Result<LatchReceipt> show(std::span<const ElementLevel> pattern,
                                                  std::uint32_t tag) = 0;
  /// Accepted in every state, never optimised away.
  [[nodiscard]] virtual Result<LatchReceipt> all_off() = 0;
  [[nodiscard]] virtual Result<void> renew_lease() = 0;
  [[nodiscard]] virtual Result<ControllerStatus> status() = 0;
  /// Uploads patterns to be stepped by the camera's strobe or by the host.
  [[nodiscard]] virtual Result<void> upload_table(
      std::span<const std::vector<ElementLevel>> patterns,
      std::span<const std::uint32_t> tags) = 0;
  /// Shows the next table entry.
  [[nodiscard]] virtual Result<LatchReceipt> step_table() = 0;
  /// Arms the uploaded table from its first entry, dark until the first step; upload_table
  /// leaves it armed for the host. With the strobe as source the lease must be renewed
  /// meanwhile.
  [[nodiscard]] virtual Result<void> arm_table(registers::StepSource source) {
    static_cast<void>(source);
    return fail(Errc::unsupported, "this light array has no pattern table");
  }
  /// Arms a part of the uploaded table for the camera's strobe, dark until the first edge. The
  /// receipt's times are those of the arming, which nothing reads back; its tag means dark.
  [[nodiscard]] virtual Result<LatchReceipt> arm_strobe(const StrobeRun& run) {
    static_cast<void>(run);
    return fail(Errc::unsupported, "this light array has no pattern table");
  }
  /// Arms entries after those of the run in progress, `count` in all, without going dark. Does
  /// nothing when the run is over: see status().
  [[nodiscard]] virtual Result<void> extend_strobe(int count) {
    static_cast<void>(count);
    return fail(Errc::unsupported, "this light array has no pattern table");
  }
  /// Delay from each latch to a pulse on the camera's trigger line; 0: none.
  [[nodiscard]] virtual Result<void> set_trigger_delay(std::chrono::microseconds delay) {
    if (delay.count() == 0) {
      return {};
    }
    return fail(Errc::unsupported, "this light array has no trigger line");
  }
};

/// Creates the array named in the rig file (registry.cpp).
/// @param n_elements  of the rig; a controller with fewer is refused at connect
[[nodiscard]] Result<std::unique_ptr<LightArray>> make_light_array(const ControllerSpec& spec,
                                                                   int n_elements);

/// Turns everything off although another program, or a hanging thread of ours, holds the
/// controller. Over USB by the control endpoint. Fault unsupported: the wire allows only one
/// connection (RTU), or a second connection is an ordinary one (TCP).
[[nodiscard]] Result<void> all_off_beside(const ControllerSpec& spec);

}  // namespace haarlight::firmware_iface
