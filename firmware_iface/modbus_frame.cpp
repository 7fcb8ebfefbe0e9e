// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/modbus_frame.h"

#include <algorithm>

namespace haarlight::firmware_iface {

namespace {

constexpr std::size_t kTcpHeader = 7;  // transaction, protocol, length, unit
constexpr std::size_t kMaxPdu = 253;
constexpr std::size_t kRtuOverhead = 3;  // unit and CRC

std::uint16_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  return static_cast<std::uint16_t>((bytes[offset] << 8U) | bytes[offset + 1]);
}

}  // namespace

std::uint16_t rtu_crc(std::span<const std::uint8_t> bytes) {
  unsigned crc = 0xFFFF;
  for (const std::uint8_t byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) {
      crc = (crc & 1U) != 0 ? (crc >> 1U) ^ 0xA001U : crc >> 1U;
    }
  }
  return static_cast<std::uint16_t>(crc);
}

FrameScan scan_tcp_request(std::span<const std::uint8_t> bytes) {
  FrameScan scan;
  if (bytes.size() < kTcpHeader) {
    return scan;
  }
  const std::size_t length = word_at(bytes, 4);  // unit and PDU
  if (word_at(bytes, 2) != 0 || length < 2 || length > kMaxPdu + 1) {
    scan.verdict = ScanVerdict::broken;
    scan.n_bytes = bytes.size();
    return scan;
  }
  const std::size_t total = kTcpHeader - 1 + length;
  if (bytes.size() < total) {
    return scan;
  }
  scan.verdict = ScanVerdict::complete;
  scan.n_bytes = total;
  scan.request.transaction = word_at(bytes, 0);
  scan.request.unit = bytes[6];
  const auto pdu = bytes.subspan(kTcpHeader, length - 1);
  scan.request.pdu.assign(pdu.begin(), pdu.end());
  return scan;
}

FrameScan scan_rtu_request(std::span<const std::uint8_t> bytes) {
  FrameScan scan;
  if (bytes.size() < 2) {
    return scan;
  }
  const unsigned function = bytes[1];
  std::size_t n_pdu = 0;
  if (function >= 1 && function <= 6) {
    n_pdu = 5;
  } else if (function == 15 || function == 16) {
    if (bytes.size() < 7) {
      return scan;
    }
    n_pdu = 6U + bytes[6];
  }
  scan.n_bytes = bytes.size();
  if (n_pdu == 0 || n_pdu > kMaxPdu) {
    scan.verdict = ScanVerdict::broken;
    return scan;
  }
  const std::size_t total = n_pdu + kRtuOverhead;
  if (bytes.size() < total) {
    scan.n_bytes = 0;
    return scan;
  }
  const unsigned crc = rtu_crc(bytes.first(total - 2));
  const unsigned got = bytes[total - 2] | (static_cast<unsigned>(bytes[total - 1]) << 8U);
  if (crc != got) {
    scan.verdict = ScanVerdict::broken;
    return scan;
  }
  scan.verdict = ScanVerdict::complete;
  scan.n_bytes = total;
  scan.request.unit = bytes[0];
  const auto pdu = bytes.subspan(1, n_pdu);
  scan.request.pdu.assign(pdu.begin(), pdu.end());
  return scan;
}

std::vector<std::uint8_t> frame_tcp(std::uint16_t transaction, std::uint8_t unit,
                                    std::span<const std::uint8_t> pdu) {
  const std::size_t length = pdu.size() + 1;
  std::vector<std::uint8_t> frame(kTcpHeader + pdu.size());
  frame[0] = static_cast<std::uint8_t>(transaction >> 8U);
  frame[1] = static_cast<std::uint8_t>(transaction & 0xFFU);
  frame[4] = static_cast<std::uint8_t>(length >> 8U);
  frame[5] = static_cast<std::uint8_t>(length & 0xFFU);
  frame[6] = unit;
  std::copy(pdu.begin(), pdu.end(), frame.begin() + kTcpHeader);
  return frame;
}

std::vector<std::uint8_t> frame_rtu(std::uint8_t unit, std::span<const std::uint8_t> pdu) {
  std::vector<std::uint8_t> frame(pdu.size() + kRtuOverhead);
  frame[0] = unit;
  std::copy(pdu.begin(), pdu.end(), frame.begin() + 1);
  const unsigned crc = rtu_crc(std::span<const std::uint8_t>(frame).first(pdu.size() + 1));
  frame[pdu.size() + 1] = static_cast<std::uint8_t>(crc & 0xFFU);
  frame[pdu.size() + 2] = static_cast<std::uint8_t>(crc >> 8U);
  return frame;
}

}  // namespace haarlight::firmware_iface
