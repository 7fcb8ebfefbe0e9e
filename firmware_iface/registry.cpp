#include "core/rig.h"
#include "firmware_iface/light_array.h"
#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_light_array.h"
#include "firmware_iface/usb_bus.h"

/// @file
/// The light arrays there are: one case a kind.

namespace haarlight {

namespace {

Result<std::unique_ptr<RegisterBus>> make_bus(const ControllerSpec& spec) {
  switch (spec.kind) {
    case ControllerKind::modbus_tcp: {
      const auto address = parse_tcp_address(spec.address);
      if (!address) {
        return tl::unexpected<Fault>(address.error());
      }
      return make_modbus_tcp_bus(*address, spec.unit);
    }
    case ControllerKind::modbus_rtu: {
      const auto address = parse_serial_address(spec.address);
      if (!address) {
        return tl::unexpected<Fault>(address.error());
      }
      return make_modbus_rtu_bus(*address, spec.unit);
    }
    case ControllerKind::usb:
      return make_usb_bus(spec.address);
  }
  return fail(Errc::unsupported, "unknown controller kind");
}

}  // namespace

Result<std::unique_ptr<LightArray>> make_light_array(const ControllerSpec& spec,
                                                     int n_elements) {
  if (spec.profile != "haarlight") {
    return fail(Errc::unsupported, "controller profile '" + spec.profile +
                                       "': only \"haarlight\" is known (docs/register-map.md)");
  }
  if (n_elements < 1 || n_elements > registers::kMaxElements) {
    return fail(Errc::unsupported, "a rig of " + std::to_string(n_elements) +
                                       " lights: a controller has 1 to " +
                                       std::to_string(registers::kMaxElements));
  }
  if (spec.lease.count() < registers::kMinLeaseMs ||
      spec.lease.count() > registers::kMaxLeaseMs) {
    return fail(Errc::unsupported, "lease of " + std::to_string(spec.lease.count()) +
                                       " ms: " + std::to_string(registers::kMinLeaseMs) +
                                       " to " + std::to_string(registers::kMaxLeaseMs) +
                                       " are possible");
  }
  auto bus = make_bus(spec);
  if (!bus) {
    return tl::unexpected<Fault>(bus.error());
  }
  const RegisterLightArrayOptions options{
      .n_elements = n_elements, .lease = spec.lease, .power_limit = std::nullopt};
  return std::make_unique<RegisterLightArray>(std::move(*bus), options);
}

}  // namespace haarlight
