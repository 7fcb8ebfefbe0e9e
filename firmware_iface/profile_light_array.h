// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "firmware_iface/controller_link.h"
#include "firmware_iface/register_bus.h"
#include "haarlight/firmware_iface/controller_profile.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// A light array using another vendor's registers. What such a controller lacks is reported,
/// not imitated: missing_promises().

namespace haarlight::firmware_iface {

/// See LightArray. `show` writes the channels that differ, latches where there is a latch, and
/// reads every channel of the rig back; the tag it then reports is the host's own, assigned to
/// what was read. `renew_lease` and `status` read back too: a lamp switched by someone else, or
/// a controller that restarted dark, is a fault and not a wrong frame. After any fault all is
/// turned off and read back before the next light.
///
/// Cost of a one-light step: two writes and one read-back per 125 registers or 2000 coils.
class ProfileLightArray final : public LightArray {
 public:
  ProfileLightArray(std::unique_ptr<RegisterBus> bus, ControllerProfile profile, int n_elements,
                    NanosecondClock clock = monotonic_now_ns);
  ~ProfileLightArray() override;
  ProfileLightArray(const ProfileLightArray&) = delete;
  ProfileLightArray& operator=(const ProfileLightArray&) = delete;

  [[nodiscard]] Result<ControllerIdentity> connect() override;
  void disconnect() noexcept override;
  [[nodiscard]] Result<LatchReceipt> show(std::span<const ElementLevel> pattern,
                                          std::uint32_t tag) override;
  [[nodiscard]] Result<LatchReceipt> all_off() override;
  [[nodiscard]] Result<void> renew_lease() override;
  [[nodiscard]] Result<ControllerStatus> status() override;
  /// Fault unsupported.
  [[nodiscard]] Result<void> upload_table(std::span<const std::vector<ElementLevel>> patterns,
                                          std::span<const std::uint32_t> tags) override;
  [[nodiscard]] Result<LatchReceipt> step_table() override;

 private:
  using Values = std::vector<std::uint16_t>;

  [[nodiscard]] Result<void> make_ready(RetryPolicy retry_policy);
  /// Checks its identity, sets it up, turns all off.
  [[nodiscard]] Result<void> resynchronise();
  [[nodiscard]] Result<void> demand(Result<registers::Exception> answer, const char* operation);
  [[nodiscard]] Result<void> write(const ProfileValue& value, const char* operation);
  [[nodiscard]] Result<Values> read(CheckFunction function, std::uint16_t first, std::size_t n);
  /// The value now at the address where `value` was written.
  [[nodiscard]] Result<std::uint16_t> read_back(const ProfileValue& value);
  [[nodiscard]] Result<void> write_channels(const Values& wanted);
  /// Compares what the channels hold with `wanted`. Channels that still hold their previous
  /// value are read again until `deadline_ns`.
  [[nodiscard]] Result<void> confirm(const Values& wanted, std::int64_t deadline_ns = 0);
  /// The same for what the latch retains.
  [[nodiscard]] Result<void> confirm_latch(std::int64_t deadline_ns);
  [[nodiscard]] Result<LatchReceipt> set(const Values& wanted, std::uint32_t tag);
  [[nodiscard]] std::string name() const;

  ControllerLink link_;
  ControllerProfile profile_;
  std::size_t n_elements_;
  Values held_;  ///< what was last confirmed; meaningful while is_certain_
  bool is_certain_ = false;
  std::uint32_t tag_ = 0;  ///< the host's name for held_
  std::uint32_t n_resynchronised_ = 0;
  std::int64_t connected_ns_ = 0;
};

}  // namespace haarlight::firmware_iface
