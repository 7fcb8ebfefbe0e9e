// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/usb_frame.h"

#include <algorithm>
#include <array>

#include "haarlight/core/error.h"

namespace haarlight::firmware_iface::usb {

namespace {

constexpr std::array<std::uint8_t, 2> kMark = {'H', 'L'};

void append_word(std::vector<std::uint8_t>& bytes, std::uint16_t word) {
  bytes.push_back(static_cast<std::uint8_t>(word >> 8U));
  bytes.push_back(static_cast<std::uint8_t>(word & 0xFFU));
}

std::uint16_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  return static_cast<std::uint16_t>((bytes[offset] << 8U) | bytes[offset + 1]);
}

}  // namespace

std::vector<std::uint8_t> encode_frame(const Frame& frame, std::size_t max_packet) {
  HAARLIGHT_EXPECTS(!frame.pdu.empty() && frame.pdu.size() <= kMaxPdu, "1 to 253 bytes of PDU");
  HAARLIGHT_EXPECTS(max_packet > 0, "an endpoint has a packet size");
  std::vector<std::uint8_t> bytes(kMark.begin(), kMark.end());
  bytes.push_back(kWireVersion);
  bytes.push_back(static_cast<std::uint8_t>(frame.kind));
  append_word(bytes, static_cast<std::uint16_t>(frame.sequence >> 16U));
  append_word(bytes, static_cast<std::uint16_t>(frame.sequence & 0xFFFFU));
  append_word(bytes, static_cast<std::uint16_t>(frame.pdu.size()));
  bytes.insert(bytes.end(), frame.pdu.begin(), frame.pdu.end());
  if (bytes.size() % max_packet == 0) {
    bytes.push_back(0);
  }
  return bytes;
}

std::optional<std::size_t> frame_size(std::span<const std::uint8_t> bytes) {
  const std::array<std::uint8_t, 3> start = {kMark[0], kMark[1], kWireVersion};
  const std::size_t n_start = std::min(bytes.size(), start.size());
  if (!std::equal(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(n_start),
                  start.begin())) {
    return std::nullopt;
  }
  if (bytes.size() > 3 && bytes[3] > static_cast<std::uint8_t>(FrameKind::reply)) {
    return std::nullopt;
  }
  if (bytes.size() < kHeaderBytes) {
    return 0;
  }
  const std::size_t n = word_at(bytes, 8);
  if (n < 1 || n > kMaxPdu) {
    return std::nullopt;
  }
  return kHeaderBytes + n;
}

std::optional<Frame> decode_frame(std::span<const std::uint8_t> bytes) {
  const std::optional<std::size_t> size = frame_size(bytes);
  if (!size || *size == 0 || bytes.size() < *size || bytes.size() > *size + 1) {
    return std::nullopt;
  }
  Frame frame;
  frame.kind = static_cast<FrameKind>(bytes[3]);
  frame.sequence = (static_cast<std::uint32_t>(word_at(bytes, 4)) << 16U) | word_at(bytes, 6);
  const std::span<const std::uint8_t> pdu = bytes.subspan(kHeaderBytes, *size - kHeaderBytes);
  frame.pdu.assign(pdu.begin(), pdu.end());
  return frame;
}

std::vector<std::uint8_t> encode_identity(std::span<const std::uint16_t> identity_registers) {
  HAARLIGHT_EXPECTS(identity_registers.size() == registers::input::kIdentityCount,
                    "the whole identity block");
  std::vector<std::uint8_t> bytes(kMark.begin(), kMark.end());
  bytes.push_back(kWireVersion);
  bytes.push_back(0);
  for (const std::uint16_t word : identity_registers) {
    append_word(bytes, word);
  }
  return bytes;
}

std::optional<std::vector<std::uint16_t>> decode_identity_reply(
    std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kIdentityBytes || bytes[0] != kMark[0] || bytes[1] != kMark[1] ||
      bytes[2] != kWireVersion) {
    return std::nullopt;
  }
  std::vector<std::uint16_t> words;
  for (std::size_t i = 4; i < bytes.size(); i += 2) {
    words.push_back(word_at(bytes, i));
  }
  return words;
}

}  // namespace haarlight::firmware_iface::usb
