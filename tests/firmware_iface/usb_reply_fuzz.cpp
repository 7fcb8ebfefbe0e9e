// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a USB frame, an identity and a reply to a request: decoded or refused, and what
/// is decoded encodes to the same bytes again.

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "firmware_iface/register_pdu.h"
#include "firmware_iface/usb_frame.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace haarlight::firmware_iface;
  const std::span<const std::uint8_t> bytes(data, size);
  const auto n = usb::frame_size(bytes);
  const auto frame = usb::decode_frame(bytes);
  if (frame) {
    if (!n || *n == 0 || *n > size || frame->pdu.empty()) {
      std::abort();
    }
    const auto again = usb::encode_frame(*frame, 512);
    if (!std::equal(again.begin(), again.begin() + static_cast<std::ptrdiff_t>(*n), data)) {
      std::abort();
    }
  }
  if (const auto identity = usb::decode_identity_reply(bytes)) {
    const auto again = usb::encode_identity(*identity);
    if (!std::equal(again.begin() + 4, again.end(), data + 4)) {
      std::abort();
    }
  }
  const std::span<const std::uint8_t> pdu = frame ? std::span(frame->pdu) : bytes;
  std::array<std::uint16_t, 23> words{};
  for (const ReadFunction function : {ReadFunction::holding, ReadFunction::input}) {
    for (const std::size_t count : {1U, 2U, 23U}) {
      static_cast<void>(read_reply(pdu, function, std::span(words.data(), count)));
    }
  }
  const std::array<std::uint16_t, 2> sent = {1, 2};
  static_cast<void>(write_reply(pdu, write_registers_request(0, sent)));
  return 0;
}
