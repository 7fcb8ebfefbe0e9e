// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any words as a controller's identity and status: decoded or refused, and what is decoded
/// keeps its ranges.

#include <cstdint>
#include <cstdlib>
#include <vector>

#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_codec.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace haarlight::firmware_iface;
  std::vector<std::uint16_t> words;
  for (std::size_t i = 0; i + 1 < size; i += 2) {
    words.push_back(static_cast<std::uint16_t>((data[i] << 8U) | data[i + 1]));
  }
  if (const auto identity = decode_identity(words)) {
    if (identity->n_elements < 1 || identity->n_elements > registers::kMaxElements ||
        identity->model.size() > 16) {
      std::abort();
    }
  }
  if (const auto block = decode_status(words)) {
    static_cast<void>(reason_of(block->refusal));
    if (block->status.is_dark && block->shown_sum != 0) {
      std::abort();
    }
  }
  const std::string text(data, data + size);
  static_cast<void>(haarlight::parse_tcp_address(text));
  static_cast<void>(haarlight::parse_serial_address(text));
  return 0;
}
