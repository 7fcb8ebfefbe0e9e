// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/profile_light_array.h"
#include "firmware_iface/register_light_array.h"
#include "firmware_iface/usb_bus.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// The available light arrays: one case per kind.

namespace haarlight::firmware_iface {

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

Result<std::unique_ptr<LightArray>> make_profile_array(const ControllerSpec& spec,
                                                       std::unique_ptr<RegisterBus> bus,
                                                       int n_elements) {
  const std::filesystem::path file = find_controller_profile(spec.profile, spec.rig_file);
  if (file.empty()) {
    return fail(Errc::unsupported,
                "controller profile '" + spec.profile +
                    "': neither \"haarlight\" nor a file beside the rig file or in profiles/");
  }
  if (spec.kind == ControllerKind::usb) {
    return fail(Errc::unsupported, "controller profile '" + spec.profile +
                                       "': profiles are for Modbus, not for kind = \"usb\"");
  }
  try {
    ControllerProfile profile = read_controller_profile(file);
    if (n_elements > profile.channels) {
      return fail(Errc::unsupported, "a rig of " + std::to_string(n_elements) + " lights: a " +
                                         profile.name + " has " +
                                         std::to_string(profile.channels) + " channels");
    }
    return std::make_unique<ProfileLightArray>(std::move(bus), std::move(profile), n_elements);
  } catch (const Error& error) {
    return fail(Errc::unsupported, error.what());
  }
}

}  // namespace

Result<std::unique_ptr<LightArray>> make_light_array(const ControllerSpec& spec,
                                                     int n_elements) {
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
  if (spec.profile != "haarlight") {
    return make_profile_array(spec, std::move(*bus), n_elements);
  }
  const RegisterLightArrayOptions options{
      .n_elements = n_elements,
      .lease = spec.lease,
      .power_limit =
          spec.max_watts > 0.0 ? std::optional(Watts(spec.max_watts)) : std::nullopt};
  return std::make_unique<RegisterLightArray>(std::move(*bus), options);
}

Result<void> all_off_beside(const ControllerSpec& spec) {
  if (spec.kind != ControllerKind::usb) {
    return fail(Errc::unsupported, "no second way to a controller on Modbus");
  }
  return usb_all_off(spec.address);
}

}  // namespace haarlight::firmware_iface
