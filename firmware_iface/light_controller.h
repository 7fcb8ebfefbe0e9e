// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "firmware_iface/light_history.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/units.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// The behaviour of a light controller: registers in, light out. No I/O and no clock: every
/// call takes the current time in CLOCK_MONOTONIC nanoseconds (a time before the last one
/// counts as the last one). The simulated rig puts it behind real Modbus servers, tests and the
/// virtual clock call it directly, and it is the reference for firmware authors.

namespace haarlight::firmware_iface {

/// Elements on one supply string (or face): first .. first + count - 1.
struct ElementGroup {
  int first = 0;
  int count = 0;
  Watts element_power{5.0};  ///< of one element at full drive
  Watts max_power{5.0};      ///< of the group at any moment
};

struct ControllerConfig {
  std::string model = "haarlight-sim";  ///< at most 16 characters are kept
  std::uint32_t serial = 1;
  std::uint32_t firmware = 0x00010000;
  /// In ascending order without gaps; together all elements.
  std::vector<ElementGroup> groups;
  /// Limits over runs of elements in addition to the groups' own (a face with several strings);
  /// their element_power is not used. May be empty.
  std::vector<ElementGroup> supplies;
  Watts max_power{5.0};  ///< of all groups together: the hard limit
  int table_depth = 1024;
  std::chrono::milliseconds default_lease{2000};
  /// An element's heat follows its drive with time constant `heat_tau`; above this limit it is
  /// cut. 1 = full drive is allowed indefinitely.
  double duty_limit = 1.0;
  std::chrono::milliseconds heat_tau{10000};
  double supply_v = 48.0;
  std::size_t history = 8192;  ///< transitions kept
};

/// How a controller, or the gateway in front of it, acts late: a fraction of the commands that
/// change the light (latch, step, all off) is acknowledged at once and acts only after a delay,
/// in the order of the commands. What the controller does by itself (lease, interlock, a
/// refused command, a restart) is never late, and neither is the arming of a table; both end
/// what waits.
struct LateActing {
  enum class Shows {
    with_light,  ///< the status shows the new tag and sum when the light does: a gateway that
                 ///< forwards late, a controller that scans its registers cyclically
    at_once,     ///< the status is wrong: it shows them with the acknowledgement
    in_order,    ///< with_light, and the next request is answered only then: busy_until_ns
  };
  double fraction = 0.0;  ///< of the commands, drawn by (seed, number of the command)
  std::chrono::microseconds least{5'000};
  std::chrono::microseconds most{60'000};
  Shows shows = Shows::with_light;
  std::uint64_t seed = 1;
};

/// The controller of a rig: one group per face, or per string where the face has strings, the
/// faces' limits and their sum; of several duty limits the lowest applies to all.
[[nodiscard]] ControllerConfig controller_config(const Rig& rig);

/// One controller. One thread (sim::ControllerServer wraps it for several).
class LightController {
 public:
  /// @throws ContractViolation  groups with gaps, no element, more than registers::kMaxElements
  LightController(ControllerConfig config, std::uint32_t boot_id, std::int64_t now_ns);

  // Modbus's five operations. A request is accepted or refused as a whole by its addresses; its
  // values then act in ascending address order up to the first one that is refused.
  [[nodiscard]] registers::Exception read_coils(std::uint16_t first, std::span<bool> bits,
                                                std::int64_t now_ns);
  [[nodiscard]] registers::Exception read_discrete(std::uint16_t first, std::span<bool> bits,
                                                   std::int64_t now_ns);
  [[nodiscard]] registers::Exception read_input(std::uint16_t first,
                                                std::span<std::uint16_t> words,
                                                std::int64_t now_ns);
  [[nodiscard]] registers::Exception read_holding(std::uint16_t first,
                                                  std::span<std::uint16_t> words,
                                                  std::int64_t now_ns);
  [[nodiscard]] registers::Exception write_coils(std::uint16_t first,
                                                 std::span<const bool> bits,
                                                 std::int64_t now_ns);
  [[nodiscard]] registers::Exception write_holding(std::uint16_t first,
                                                   std::span<const std::uint16_t> words,
                                                   std::int64_t now_ns);

  // The world around it.
  /// An edge on the strobe line: steps an armed table whose source is the strobe.
  void strobe(std::int64_t now_ns);
  /// Power lost and restored: dark, everything forgotten, new boot id.
  void reboot(std::uint32_t boot_id, std::int64_t now_ns);
  void set_temperature(double temperature_c, std::int64_t now_ns);
  void set_interlock_open(bool is_open, std::int64_t now_ns);
  /// From the next command on.
  void set_late_acting(const LateActing& late) { late_ = late; }
  /// LateActing::Shows::in_order: no request may be carried out before this. Otherwise the last
  /// time.
  [[nodiscard]] std::int64_t busy_until_ns() const {
    return late_.shows == LateActing::Shows::in_order && !waiting_.empty()
               ? waiting_.back().t_ns
               : now_ns_;
  }
  /// Lets time pass: late acts, lease and thermal cuts happen at their own time, not at
  /// `now_ns`.
  void advance(std::int64_t now_ns);
  /// When `advance` has something to do next; INT64_MAX = never.
  [[nodiscard]] std::int64_t next_deadline_ns() const;

  // What an observer next to it sees.
  /// The state at t0 and each change in (t0, t1]. Call advance(t1) first.
  [[nodiscard]] LightHistory transitions(std::int64_t t0_ns, std::int64_t t1_ns) const {
    return log_.between(t0_ns, t1_ns);
  }
  /// Pulses on the camera's trigger line since construction, and when the last one is due.
  [[nodiscard]] std::uint64_t n_triggers() const { return n_triggers_; }
  [[nodiscard]] std::int64_t last_trigger_ns() const { return last_trigger_ns_; }
  [[nodiscard]] const LightTransition& lit() const { return log_.latest(); }
  /// Seconds at full drive of one element since construction, up to the last call's time.
  [[nodiscard]] double total_on_seconds(int element) const;
  /// Of what is lit.
  [[nodiscard]] Watts power() const;
  [[nodiscard]] std::uint32_t faults() const { return faults_; }
  [[nodiscard]] std::uint32_t boot_id() const { return boot_id_; }
  [[nodiscard]] int n_elements() const { return static_cast<int>(levels_.size()); }
  [[nodiscard]] const ControllerConfig& config() const { return config_; }

 private:
  using Pattern = std::shared_ptr<const std::vector<ElementLevel>>;
  struct TableEntry {
    Pattern pattern;
    std::uint32_t tag = 0;
  };
  /// A light change that a command requested.
  struct Act {
    std::int64_t t_ns = 0;
    Pattern pattern;
    std::uint32_t tag = 0;
    std::uint32_t step_counter = 0;
    bool has_trigger = false;
  };
  /// What the status registers report of the light.
  struct Shown {
    LightTransition light;
    std::uint32_t sum = 0;
    std::uint32_t step_counter = 0;
  };

  [[nodiscard]] registers::Exception write_control(std::uint16_t address, std::uint32_t value);
  [[nodiscard]] std::uint32_t read_control(std::uint16_t address) const;
  [[nodiscard]] registers::Exception latch();
  [[nodiscard]] registers::Exception store(std::uint16_t index);
  [[nodiscard]] registers::Exception arm(std::uint16_t n_entries);
  [[nodiscard]] registers::Exception extend(std::uint16_t n_entries);
  [[nodiscard]] bool is_stored(std::size_t first, std::size_t n) const;
  [[nodiscard]] registers::Exception step();
  [[nodiscard]] registers::Exception check_expected_sum();
  /// Refusal::none when the pattern may be lit now.
  [[nodiscard]] registers::Refusal validate(const std::vector<ElementLevel>& pattern,
                                            std::uint32_t tag) const;
  [[nodiscard]] registers::Exception refuse(registers::Refusal refusal);
  [[nodiscard]] Pattern shadow_pattern() const;
  /// Dark at once; what waits to act is discarded.
  void go_dark();
  void all_off();
  void forget_bank();
  /// Shows a pattern, now or late.
  void command(Pattern pattern, std::uint32_t tag, bool has_trigger);
  void perform(const Act& act);
  void send_trigger(std::int64_t t_ns);
  void set_shown(const Act& act);
  [[nodiscard]] std::int64_t draw_delay_ns();
  void show(Pattern pattern, std::uint32_t tag, std::int64_t t_ns);
  void renew_lease();
  void set_shadow(int element, std::uint16_t level, bool is_on);
  void fill_status(std::span<std::uint16_t> block) const;
  [[nodiscard]] double heat_at(int element, std::int64_t t_ns) const;
  [[nodiscard]] bool is_lit_or_armed() const;
  [[nodiscard]] std::uint64_t milliwatts(const std::vector<ElementLevel>& pattern) const;

  ControllerConfig config_;
  TransitionLog log_;
  std::int64_t now_ns_ = 0;
  std::int64_t boot_ns_ = 0;
  std::uint32_t boot_id_ = 0;
  // Shadow bank.
  std::vector<std::uint16_t> levels_;
  std::vector<std::uint8_t> on_;
  std::uint32_t shadow_sum_ = 0;
  std::uint32_t tag_ = 0;
  std::uint32_t expected_sum_ = 0;
  bool has_expected_sum_ = false;
  // Table.
  std::vector<TableEntry> table_;
  registers::StepSource step_source_ = registers::StepSource::host;
  int n_armed_ = 0;
  std::uint32_t step_counter_ = 0;
  std::size_t first_armed_ = 0;
  std::uint32_t strobe_divider_ = 1;
  std::uint32_t n_strobes_ = 0;     ///< edges since the arming
  std::size_t next_first_ = 0;      ///< for the next arming
  std::uint32_t next_divider_ = 1;  ///< for the next arming
  // Trigger line.
  std::uint32_t trigger_delay_us_ = 0;
  std::int64_t last_trigger_ns_ = 0;
  std::uint64_t n_triggers_ = 0;
  // Lease, limits, faults.
  std::int64_t lease_ns_ = 0;
  std::int64_t lease_deadline_ns_ = 0;
  std::int64_t heat_deadline_ns_ = std::numeric_limits<std::int64_t>::max();
  std::uint64_t power_limit_mw_ = 0;
  std::uint32_t faults_ = 0;
  registers::Refusal refusal_ = registers::Refusal::none;
  double temperature_c_ = 25.0;
  bool is_interlock_open_ = false;
  std::uint32_t echo_ = 0;
  std::uint32_t latch_counter_ = 0;
  Shown shown_;
  LateActing late_;
  std::deque<Act> waiting_;  ///< acknowledged, to act later; in order
  std::uint64_t n_commands_ = 0;
  // Per element: power, on-time, and heat at its last update.
  std::vector<std::uint32_t> element_mw_;
  std::vector<int> group_of_;
  std::vector<double> on_s_;
  std::vector<double> heat_;
  std::vector<std::int64_t> heat_ns_;
};

}  // namespace haarlight::firmware_iface
