// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "core/rig/controller_address.h"
#include "firmware_iface/register_bus.h"

/// @file
/// Modbus TCP and RTU over libmodbus, whose own error recovery stays off.

namespace haarlight::firmware_iface {

struct ModbusTiming {
  /// From the end of a request on the wire to the start of its answer. Time for the bytes
  /// themselves is added (RTU).
  std::chrono::milliseconds turnaround{250};
  std::chrono::milliseconds connect{500};
  /// RTU: after a fault the line must be silent this long. Longer than the latest possible
  /// answer (docs/reference/register-map.md: firmware answers within 500 ms or never).
  std::chrono::milliseconds quiet{1000};
};

/// @param unit  1 .. 247
[[nodiscard]] std::unique_ptr<RegisterBus> make_modbus_tcp_bus(const TcpAddress& address,
                                                               int unit,
                                                               ModbusTiming timing = {});
[[nodiscard]] std::unique_ptr<RegisterBus> make_modbus_rtu_bus(const SerialAddress& address,
                                                               int unit,
                                                               ModbusTiming timing = {});

}  // namespace haarlight::firmware_iface
