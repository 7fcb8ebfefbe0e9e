// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "firmware_iface/light_controller.h"
#include "firmware_iface/register_bus.h"
#include "firmware_iface/register_light_array.h"

/// @file
/// A bus without hardware: requests go straight to a LightController in the same process, at
/// the time of a given clock. For tests and for simulations on a virtual clock; can be told to
/// fail.

namespace haarlight::firmware_iface {

/// The fate of one request on a FakeBus.
struct FakeBusFault {
  Errc code = Errc::timeout;
  bool acts = false;  ///< the request is carried out although it fails
  /// Instead: answered by this exception, not carried out.
  std::optional<registers::Exception> answer{};
};

/// Called once per request, before it acts; nothing = it succeeds.
using FakeBusScript = std::function<std::optional<FakeBusFault>()>;

/// The controller outlives the bus. One thread owns both, or the owner holds a lock.
class FakeBus final : public RegisterBus {
 public:
  FakeBus(LightController& controller, NanosecondClock clock, FakeBusScript script = {});

  [[nodiscard]] Result<void> open() override;
  void close() noexcept override;
  [[nodiscard]] BusRecovery recovery() const override { return BusRecovery::reopen; }
  [[nodiscard]] Result<void> settle() override { return {}; }
  [[nodiscard]] std::string name() const override { return "fake bus"; }
  [[nodiscard]] Result<registers::Exception> read_input(
      std::uint16_t first, std::span<std::uint16_t> words) override;
  [[nodiscard]] Result<registers::Exception> read_holding(
      std::uint16_t first, std::span<std::uint16_t> words) override;
  [[nodiscard]] Result<registers::Exception> write_holding(
      std::uint16_t first, std::span<const std::uint16_t> words) override;
  [[nodiscard]] Result<registers::Exception> write_coils(
      std::uint16_t first, std::span<const std::uint8_t> bits) override;

 private:
  template <class Act>
  Result<registers::Exception> run(Act act);

  LightController& controller_;
  NanosecondClock clock_;
  FakeBusScript script_;
  bool is_open_ = false;
};

/// A light array for a controller in the same process.
[[nodiscard]] std::unique_ptr<RegisterLightArray> make_fake_light_array(
    LightController& controller, NanosecondClock clock, FakeBusScript script = {});

}  // namespace haarlight::firmware_iface
