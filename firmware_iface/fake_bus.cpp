// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/fake_bus.h"

#include <array>
#include <utility>

namespace haarlight::firmware_iface {

using registers::Exception;

FakeBus::FakeBus(LightController& controller, NanosecondClock clock, FakeBusScript script)
    : controller_(controller), clock_(std::move(clock)), script_(std::move(script)) {}

template <class Act>
Result<Exception> FakeBus::run(Act act) {
  if (!is_open_) {
    return fail(Errc::device_gone, "fake bus: not open");
  }
  const auto fault = script_ ? script_() : std::nullopt;
  if (fault && fault->answer) {
    return *fault->answer;
  }
  if (fault && !fault->acts) {
    return fail(fault->code, "fake bus: scripted fault, not carried out");
  }
  const Exception answer = act();
  if (fault) {
    return fail(fault->code, "fake bus: scripted fault, carried out");
  }
  return answer;
}

Result<void> FakeBus::open() {
  is_open_ = true;
  return {};
}

void FakeBus::close() noexcept { is_open_ = false; }

Result<Exception> FakeBus::read_input(std::uint16_t first, std::span<std::uint16_t> words) {
  return run([&] { return controller_.read_input(first, words, clock_()); });
}

Result<Exception> FakeBus::read_holding(std::uint16_t first, std::span<std::uint16_t> words) {
  return run([&] { return controller_.read_holding(first, words, clock_()); });
}

Result<Exception> FakeBus::write_holding(std::uint16_t first,
                                         std::span<const std::uint16_t> words) {
  return run([&] { return controller_.write_holding(first, words, clock_()); });
}

Result<Exception> FakeBus::write_coils(std::uint16_t first,
                                       std::span<const std::uint8_t> bits) {
  HAARLIGHT_EXPECTS(bits.size() <= registers::kMaxCoilsWritten, "one request's worth of bits");
  std::array<bool, registers::kMaxCoilsWritten> copy{};
  for (std::size_t i = 0; i < bits.size(); ++i) {
    copy[i] = bits[i] != 0;
  }
  return run([&] {
    return controller_.write_coils(first, std::span<const bool>(copy.data(), bits.size()),
                                   clock_());
  });
}

std::unique_ptr<RegisterLightArray> make_fake_light_array(LightController& controller,
                                                          NanosecondClock clock,
                                                          FakeBusScript script) {
  auto bus = std::make_unique<FakeBus>(controller, clock, std::move(script));
  const RegisterLightArrayOptions options{
      .n_elements = controller.n_elements(),
      .lease = controller.config().default_lease,
      .power_limit = std::nullopt,
  };
  return std::make_unique<RegisterLightArray>(std::move(bus), options, std::move(clock));
}

}  // namespace haarlight::firmware_iface
