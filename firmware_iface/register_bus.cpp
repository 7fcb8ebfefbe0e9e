// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/register_bus.h"

namespace haarlight::firmware_iface {

namespace {

tl::unexpected<Fault> not_carried(const std::string& name, const char* operation) {
  return fail(Errc::unsupported, name + ": " + operation + ": not carried by this bus");
}

}  // namespace

Result<registers::Exception> RegisterBus::read_coils(std::uint16_t /*first*/,
                                                     std::span<std::uint8_t> /*bits*/) {
  return not_carried(name(), "reading coils");
}
Result<registers::Exception> RegisterBus::write_coil(std::uint16_t /*address*/,
                                                     bool /*is_on*/) {
  return not_carried(name(), "writing one coil");
}
Result<registers::Exception> RegisterBus::write_register(std::uint16_t /*address*/,
                                                         std::uint16_t /*value*/) {
  return not_carried(name(), "writing one register");
}

}  // namespace haarlight::firmware_iface
