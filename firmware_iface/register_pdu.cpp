// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/register_pdu.h"

#include <algorithm>
#include <optional>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;

constexpr std::uint8_t kWriteCoils = 15;
constexpr std::uint8_t kWriteRegisters = 16;
constexpr std::uint8_t kExceptionBit = 0x80;
constexpr std::size_t kWriteReplyBytes = 5;  // function, address, count

void append_word(std::vector<std::uint8_t>& bytes, std::size_t word) {
  bytes.push_back(static_cast<std::uint8_t>((word >> 8U) & 0xFFU));
  bytes.push_back(static_cast<std::uint8_t>(word & 0xFFU));
}

/// The exception carried by a reply to `function`; nothing when it is an ordinary reply.
std::optional<Result<Exception>> exception_in(std::span<const std::uint8_t> pdu,
                                              std::uint8_t function) {
  if (pdu.empty()) {
    return fail(Errc::protocol, "an empty reply");
  }
  if (pdu[0] == function) {
    return std::nullopt;
  }
  if (pdu[0] != (function | kExceptionBit) || pdu.size() != 2) {
    return fail(Errc::protocol,
                fmt::format("a reply to function {}, {} was requested", pdu[0], function));
  }
  const auto code = static_cast<Exception>(pdu[1]);
  switch (code) {
    case Exception::illegal_function:
    case Exception::illegal_address:
    case Exception::illegal_value:
    case Exception::device_failure:
    case Exception::busy:
    case Exception::bank_sum:
    case Exception::gateway_target:
      return code;
    case Exception::none:
      break;
  }
  return fail(Errc::protocol, fmt::format("unknown exception {}", pdu[1]));
}

}  // namespace

std::vector<std::uint8_t> read_request(ReadFunction function, std::uint16_t first,
                                       std::size_t n) {
  HAARLIGHT_EXPECTS(n >= 1 && n <= registers::kMaxRegistersRead,
                    "one request's worth of registers");
  std::vector<std::uint8_t> pdu = {static_cast<std::uint8_t>(function)};
  append_word(pdu, first);
  append_word(pdu, n);
  return pdu;
}

std::vector<std::uint8_t> write_registers_request(std::uint16_t first,
                                                  std::span<const std::uint16_t> words) {
  HAARLIGHT_EXPECTS(!words.empty() && words.size() <= registers::kMaxRegistersWritten,
                    "one request's worth of registers");
  std::vector<std::uint8_t> pdu = {kWriteRegisters};
  append_word(pdu, first);
  append_word(pdu, words.size());
  pdu.push_back(static_cast<std::uint8_t>(2 * words.size()));
  for (const std::uint16_t word : words) {
    append_word(pdu, word);
  }
  return pdu;
}

std::vector<std::uint8_t> write_coils_request(std::uint16_t first,
                                              std::span<const std::uint8_t> bits) {
  HAARLIGHT_EXPECTS(!bits.empty() && bits.size() <= registers::kMaxCoilsWritten,
                    "one request's worth of bits");
  std::vector<std::uint8_t> pdu = {kWriteCoils};
  append_word(pdu, first);
  append_word(pdu, bits.size());
  const std::size_t n_bytes = (bits.size() + 7) / 8;
  pdu.push_back(static_cast<std::uint8_t>(n_bytes));
  const std::size_t start = pdu.size();
  pdu.resize(start + n_bytes);
  for (std::size_t i = 0; i < bits.size(); ++i) {
    if (bits[i] != 0) {
      pdu[start + i / 8] = static_cast<std::uint8_t>(pdu[start + i / 8] | (1U << (i % 8)));
    }
  }
  return pdu;
}

Result<Exception> read_reply(std::span<const std::uint8_t> pdu, ReadFunction function,
                             std::span<std::uint16_t> words) {
  if (auto exception = exception_in(pdu, static_cast<std::uint8_t>(function))) {
    return *exception;
  }
  if (pdu.size() != 2 + 2 * words.size() || pdu[1] != 2 * words.size()) {
    return fail(Errc::protocol, fmt::format("a reply of {} bytes, expected {}", pdu.size(),
                                            2 + 2 * words.size()));
  }
  for (std::size_t i = 0; i < words.size(); ++i) {
    words[i] = static_cast<std::uint16_t>((pdu[2 + 2 * i] << 8U) | pdu[3 + 2 * i]);
  }
  return Exception::none;
}

Result<Exception> write_reply(std::span<const std::uint8_t> pdu,
                              std::span<const std::uint8_t> request) {
  HAARLIGHT_EXPECTS(request.size() >= kWriteReplyBytes, "a write request");
  if (auto exception = exception_in(pdu, request[0])) {
    return *exception;
  }
  if (pdu.size() != kWriteReplyBytes || !std::equal(pdu.begin(), pdu.end(), request.begin())) {
    return fail(Errc::protocol, "the reply names other registers than the request");
  }
  return Exception::none;
}

}  // namespace haarlight::firmware_iface
