// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "firmware_iface/controller_link.h"
#include "firmware_iface/register_bus.h"
#include "firmware_iface/register_codec.h"
#include "haarlight/core/units.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// The light array behind the register map, whatever bus carries the registers.

namespace haarlight::firmware_iface {

struct RegisterLightArrayOptions {
  int n_elements = 0;  ///< of the rig
  std::chrono::milliseconds lease{2000};
  /// Written to the controller at every connection and read back, if it is below the
  /// controller's hard limit; none: keeps the controller's own.
  std::optional<Watts> power_limit = std::nullopt;
};

/// See LightArray. After a fault nothing is known about the light: the next call reopens the
/// link or lets the line fall silent, proves it by an echo, and reads back; when bank and light
/// differ from what was last confirmed, ALL_OFF comes first. No write is ever sent twice.
///
/// Cost: a one-light step after another one takes at most 5 requests (off bit, on bit, level
/// where it differs, tag + sum + latch in one, status); more statuses where the controller acts
/// later than it acknowledges.
class RegisterLightArray final : public LightArray {
 public:
  RegisterLightArray(std::unique_ptr<RegisterBus> bus, RegisterLightArrayOptions options,
                     NanosecondClock clock = monotonic_now_ns);
  ~RegisterLightArray() override;
  RegisterLightArray(const RegisterLightArray&) = delete;
  RegisterLightArray& operator=(const RegisterLightArray&) = delete;

  [[nodiscard]] Result<ControllerIdentity> connect() override;
  void disconnect() noexcept override;
  [[nodiscard]] Result<LatchReceipt> show(std::span<const ElementLevel> pattern,
                                          std::uint32_t tag) override;
  [[nodiscard]] Result<LatchReceipt> all_off() override;
  [[nodiscard]] Result<void> renew_lease() override;
  [[nodiscard]] Result<ControllerStatus> status() override;
  [[nodiscard]] Result<void> upload_table(std::span<const std::vector<ElementLevel>> patterns,
                                          std::span<const std::uint32_t> tags) override;
  [[nodiscard]] Result<void> arm_table(registers::StepSource source) override;
  [[nodiscard]] Result<LatchReceipt> step_table() override;
  [[nodiscard]] Result<LatchReceipt> arm_strobe(const StrobeRun& run) override;
  [[nodiscard]] Result<void> extend_strobe(int count) override;
  [[nodiscard]] Result<void> set_trigger_delay(std::chrono::microseconds delay) override;

  [[nodiscard]] LinkState link_state() const noexcept { return link_.state(); }

 private:
  struct TableProof {
    std::uint32_t tag = 0;
    std::uint32_t sum = 0;
    friend bool operator==(const TableProof&, const TableProof&) = default;
  };

  [[nodiscard]] Result<void> make_ready(RetryPolicy retry_policy);
  [[nodiscard]] Result<void> resynchronise();
  [[nodiscard]] Result<void> prove_line();
  [[nodiscard]] Result<void> set_power_limit();
  [[nodiscard]] Result<ControllerIdentity> read_identity();
  [[nodiscard]] Result<StatusBlock> read_status();
  /// A request that the controller must accept; otherwise a fault.
  [[nodiscard]] Result<void> demand(Result<registers::Exception> answer, const char* operation);
  [[nodiscard]] Fault refusal_fault(registers::Exception exception, const char* operation);
  [[nodiscard]] Result<void> all_off_unchecked();
  [[nodiscard]] Result<void> check_pattern(std::span<const ElementLevel> pattern,
                                           std::uint32_t tag) const;
  [[nodiscard]] Result<LatchReceipt> latch_pattern(std::span<const ElementLevel> pattern,
                                                   std::uint32_t tag);
  [[nodiscard]] Result<void> write_bank(std::span<const ElementLevel> pattern);
  [[nodiscard]] Result<void> write_levels();
  [[nodiscard]] Result<void> write_on_bits();
  /// The status that shows this tag and sum; while it still shows the previous state, it is
  /// read again for up to kShownWithinNs. Otherwise the first status that shows something
  /// different.
  [[nodiscard]] Result<StatusBlock> await_shown(std::uint32_t tag, std::uint32_t sum);
  [[nodiscard]] Result<void> confirm_shown(std::uint32_t tag, std::uint32_t sum,
                                           LatchReceipt& receipt);
  [[nodiscard]] std::string name() const { return link_.name(); }

  ControllerLink link_;
  RegisterLightArrayOptions options_;
  std::uint32_t echo_ = 0;
  std::optional<ControllerIdentity> identity_;
  std::uint32_t hard_limit_dw_ = 0;  ///< 0.1 W

  // Contents of the shadow bank, as far as confirmed.
  bool is_bank_certain_ = false;
  bool is_bank_stale_ = false;  ///< the last latch was refused by its bank sum
  std::vector<std::uint8_t> on_;
  std::vector<std::int32_t> levels_;   ///< -1 = unknown
  std::vector<std::uint16_t> wanted_;  ///< scratch: level of each element, 0 = off
  std::vector<TableProof> table_;      ///< of the entries uploaded since the last start
  std::uint32_t steps_taken_ = 0;
  TableProof shown_;  ///< by the newest status; dark after an arming
};

}  // namespace haarlight::firmware_iface
