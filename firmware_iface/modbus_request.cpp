// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/modbus_request.h"

#include <algorithm>
#include <array>

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;

constexpr std::uint8_t kReadCoils = 1;
constexpr std::uint8_t kReadDiscrete = 2;
constexpr std::uint8_t kReadHolding = 3;
constexpr std::uint8_t kReadInput = 4;
constexpr std::uint8_t kWriteCoil = 5;
constexpr std::uint8_t kWriteRegister = 6;
constexpr std::uint8_t kWriteCoils = 15;
constexpr std::uint8_t kWriteRegisters = 16;

std::uint16_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  return static_cast<std::uint16_t>((bytes[offset] << 8U) | bytes[offset + 1]);
}

void append_word(std::vector<std::uint8_t>& bytes, std::uint16_t word) {
  bytes.push_back(static_cast<std::uint8_t>(word >> 8U));
  bytes.push_back(static_cast<std::uint8_t>(word & 0xFFU));
}

std::vector<std::uint8_t> read_bits(LightController& controller,
                                    std::span<const std::uint8_t> pdu, std::int64_t now_ns) {
  const std::uint8_t function = pdu[0];
  if (pdu.size() != 5) {
    return exception_reply(function, Exception::illegal_value);
  }
  const std::uint16_t first = word_at(pdu, 1);
  const std::size_t n = word_at(pdu, 3);
  if (n < 1 || n > registers::kMaxCoilsRead) {
    return exception_reply(function, Exception::illegal_value);
  }
  std::array<bool, registers::kMaxCoilsRead> bits{};
  const std::span<bool> requested(bits.data(), n);
  const Exception no = function == kReadCoils
                           ? controller.read_coils(first, requested, now_ns)
                           : controller.read_discrete(first, requested, now_ns);
  if (no != Exception::none) {
    return exception_reply(function, no);
  }
  const std::size_t n_bytes = (n + 7) / 8;
  std::vector<std::uint8_t> reply(2 + n_bytes);
  reply[0] = function;
  reply[1] = static_cast<std::uint8_t>(n_bytes);
  for (std::size_t i = 0; i < n; ++i) {
    if (bits[i]) {
      reply[2 + i / 8] = static_cast<std::uint8_t>(reply[2 + i / 8] | (1U << (i % 8)));
    }
  }
  return reply;
}

std::vector<std::uint8_t> read_words(LightController& controller,
                                     std::span<const std::uint8_t> pdu, std::int64_t now_ns) {
  const std::uint8_t function = pdu[0];
  if (pdu.size() != 5) {
    return exception_reply(function, Exception::illegal_value);
  }
  const std::uint16_t first = word_at(pdu, 1);
  const std::size_t n = word_at(pdu, 3);
  if (n < 1 || n > registers::kMaxRegistersRead) {
    return exception_reply(function, Exception::illegal_value);
  }
  std::array<std::uint16_t, registers::kMaxRegistersRead> words{};
  const std::span<std::uint16_t> requested(words.data(), n);
  const Exception no = function == kReadHolding
                           ? controller.read_holding(first, requested, now_ns)
                           : controller.read_input(first, requested, now_ns);
  if (no != Exception::none) {
    return exception_reply(function, no);
  }
  std::vector<std::uint8_t> reply = {function, static_cast<std::uint8_t>(2 * n)};
  for (std::size_t i = 0; i < n; ++i) {
    append_word(reply, words[i]);
  }
  return reply;
}

std::vector<std::uint8_t> write_one(LightController& controller,
                                    std::span<const std::uint8_t> pdu, std::int64_t now_ns) {
  const std::uint8_t function = pdu[0];
  if (pdu.size() != 5) {
    return exception_reply(function, Exception::illegal_value);
  }
  const std::uint16_t address = word_at(pdu, 1);
  const std::uint16_t value = word_at(pdu, 3);
  Exception no = Exception::none;
  if (function == kWriteCoil) {
    if (value != 0x0000 && value != 0xFF00) {
      return exception_reply(function, Exception::illegal_value);
    }
    const std::array<bool, 1> bit = {value != 0};
    no = controller.write_coils(address, bit, now_ns);
  } else {
    const std::array<std::uint16_t, 1> word = {value};
    no = controller.write_holding(address, word, now_ns);
  }
  return no == Exception::none ? std::vector<std::uint8_t>(pdu.begin(), pdu.end())
                               : exception_reply(function, no);
}

std::vector<std::uint8_t> write_many(LightController& controller,
                                     std::span<const std::uint8_t> pdu, std::int64_t now_ns) {
  const std::uint8_t function = pdu[0];
  if (pdu.size() < 6 || pdu.size() != 6U + pdu[5]) {
    return exception_reply(function, Exception::illegal_value);
  }
  const std::uint16_t first = word_at(pdu, 1);
  const std::size_t n = word_at(pdu, 3);
  const bool is_coils = function == kWriteCoils;
  const std::size_t n_max =
      is_coils ? registers::kMaxCoilsWritten : registers::kMaxRegistersWritten;
  const std::size_t n_bytes = is_coils ? (n + 7) / 8 : 2 * n;
  if (n < 1 || n > n_max || n_bytes != pdu[5]) {
    return exception_reply(function, Exception::illegal_value);
  }
  Exception no = Exception::none;
  if (is_coils) {
    std::array<bool, registers::kMaxCoilsWritten> bits{};
    for (std::size_t i = 0; i < n; ++i) {
      bits[i] = ((pdu[6 + i / 8] >> (i % 8)) & 1U) != 0;
    }
    no = controller.write_coils(first, std::span<const bool>(bits.data(), n), now_ns);
  } else {
    std::array<std::uint16_t, registers::kMaxRegistersWritten> words{};
    for (std::size_t i = 0; i < n; ++i) {
      words[i] = word_at(pdu, 6 + 2 * i);
    }
    no = controller.write_holding(first, std::span<const std::uint16_t>(words.data(), n),
                                  now_ns);
  }
  if (no != Exception::none) {
    return exception_reply(function, no);
  }
  return {pdu.begin(), pdu.begin() + 5};
}

}  // namespace

std::vector<std::uint8_t> exception_reply(std::uint8_t function, Exception exception) {
  return {static_cast<std::uint8_t>(function | 0x80U), static_cast<std::uint8_t>(exception)};
}

std::vector<std::uint8_t> answer_request(LightController& controller,
                                         std::span<const std::uint8_t> pdu,
                                         std::int64_t now_ns) {
  if (pdu.empty()) {
    return {};
  }
  switch (pdu[0]) {
    case kReadCoils:
    case kReadDiscrete:
      return read_bits(controller, pdu, now_ns);
    case kReadHolding:
    case kReadInput:
      return read_words(controller, pdu, now_ns);
    case kWriteCoil:
    case kWriteRegister:
      return write_one(controller, pdu, now_ns);
    case kWriteCoils:
    case kWriteRegisters:
      return write_many(controller, pdu, now_ns);
    default:
      return exception_reply(pdu[0], Exception::illegal_function);
  }
}

}  // namespace haarlight::firmware_iface
