// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <span>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// Transport of register requests to a controller: what differs between Modbus TCP, Modbus RTU,
/// a controller in the same process and USB. RegisterLightArray does everything else.

namespace haarlight::firmware_iface {

/// How a bus restores "the next answer belongs to the next request" after a fault.
enum class BusRecovery {
  reopen,  ///< close and reopen: a late answer dies with its connection
  settle,  ///< no transaction id: wait until a late answer can no longer come
};

/// One link to one controller. One thread. A request is carried out at most once; nothing is
/// retried automatically. Each call ends within the bus's own deadline.
///
/// A request's result is the controller's exception code, `none` when it was carried out.
/// Faults: device_gone (the link is lost: close and open), timeout (no answer; the request may
/// have been carried out), protocol (an invalid answer), io.
class RegisterBus {
 public:
  RegisterBus() = default;
  virtual ~RegisterBus() = default;
  RegisterBus(const RegisterBus&) = delete;
  RegisterBus& operator=(const RegisterBus&) = delete;
  /// Opens the link. Faults device_gone, device_busy.
  [[nodiscard]] virtual Result<void> open() = 0;
  virtual void close() noexcept = 0;
  [[nodiscard]] virtual BusRecovery recovery() const = 0;
  /// Waits until no late answer can arrive any more and discards what arrived.
  /// Faults protocol: the line does not fall silent; device_gone.
  [[nodiscard]] virtual Result<void> settle() = 0;
  /// For messages: "Modbus TCP 127.0.0.1:1502".
  [[nodiscard]] virtual std::string name() const = 0;

  /// @param words  1 .. kMaxRegistersRead, to be filled
  [[nodiscard]] virtual Result<registers::Exception> read_input(
      std::uint16_t first, std::span<std::uint16_t> words) = 0;
  [[nodiscard]] virtual Result<registers::Exception> read_holding(
      std::uint16_t first, std::span<std::uint16_t> words) = 0;
  /// @param words  1 .. kMaxRegistersWritten
  [[nodiscard]] virtual Result<registers::Exception> write_holding(
      std::uint16_t first, std::span<const std::uint16_t> words) = 0;
  /// @param bits  1 .. kMaxCoilsWritten, each 0 or 1
  [[nodiscard]] virtual Result<registers::Exception> write_coils(
      std::uint16_t first, std::span<const std::uint8_t> bits) = 0;

  // Needed only for other vendors' registers (functions 1, 5 and 6). Fault unsupported: this
  // bus does not carry them.
  /// @param bits  1 .. kMaxCoilsRead, to be filled with 0 or 1
  [[nodiscard]] virtual Result<registers::Exception> read_coils(std::uint16_t first,
                                                                std::span<std::uint8_t> bits);
  [[nodiscard]] virtual Result<registers::Exception> write_coil(std::uint16_t address,
                                                                bool is_on);
  [[nodiscard]] virtual Result<registers::Exception> write_register(std::uint16_t address,
                                                                    std::uint16_t value);
};

}  // namespace haarlight::firmware_iface
