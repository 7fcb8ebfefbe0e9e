// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as Modbus requests: the controller answers, never lights more than it may, never
/// reads or writes beyond its registers. Input: repeated [length byte][milliseconds byte][PDU].

#include <cstdint>
#include <cstdlib>
#include <span>

#include "firmware_iface/modbus_frame.h"
#include "firmware_iface/modbus_request.h"
#include "tests/firmware_iface/controller_fixture.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace haarlight::firmware_iface;
  std::span<const std::uint8_t> bytes(data, size);
  static_cast<void>(scan_tcp_request(bytes));
  static_cast<void>(scan_rtu_request(bytes));
  LightController controller(small_config(), 1, 0);
  std::int64_t now = 0;
  while (bytes.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(bytes[0], bytes.size() - 2);
    now += bytes[1] * kMs;
    const auto pdu = bytes.subspan(2, length);
    const auto reply = answer_request(controller, pdu, now);
    const bool is_answered = pdu.empty() ? reply.empty()
                                         : reply.size() >= 2 && reply.size() <= kMaxPduBytes &&
                                               (reply[0] & 0x7FU) == (pdu[0] & 0x7FU);
    if (!is_answered || controller.power().value() > 30.0 + 1e-9) {
      std::abort();
    }
    bytes = bytes.subspan(2 + length);
  }
  controller.advance(now + 120'000 * kMs);
  if (!controller.lit().pattern->empty()) {
    std::abort();  // a lease that never ends
  }
  return 0;
}
