// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/modbus_frame.h"

#include <array>
#include <string_view>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "firmware_iface/modbus_request.h"
#include "tests/firmware_iface/controller_fixture.h"

namespace haarlight::firmware_iface {
namespace {

// CRC-16/MODBUS of "123456789" is 0x4B37 (catalogue of parametrised CRC algorithms).
TEST(ModbusFrame, CrcHasItsCheckValue) {
  constexpr std::string_view kCheck = "123456789";
  const std::vector<std::uint8_t> bytes(kCheck.begin(), kCheck.end());
  EXPECT_EQ(rtu_crc(bytes), 0x4B37);
}

// Example of [Modbus12] 6.1: read discrete outputs 20-38.
TEST(ModbusFrame, ReadCoilsExampleIsUnderstood) {
  LightController c(wide_config(64), 1, 0);
  constexpr std::array<std::uint8_t, 3> kStates = {0xCD, 0x6B, 0x05};
  for (int i = 0; i < 19; ++i) {
    const auto byte = static_cast<std::size_t>(i / 8);
    ASSERT_EQ(set_on(c, 0x13 + i, ((kStates[byte] >> (i % 8)) & 1) != 0, 0),
              registers::Exception::none);
  }
  const std::vector<std::uint8_t> request = {0x01, 0x00, 0x13, 0x00, 0x13};
  const std::vector<std::uint8_t> expected = {0x01, 0x03, 0xCD, 0x6B, 0x05};
  EXPECT_EQ(answer_request(c, request, 0), expected);
}

// Example of [Modbus12] 6.11: write ten coils from 20 on.
TEST(ModbusFrame, WriteCoilsExampleIsUnderstood) {
  LightController c(wide_config(64), 1, 0);
  const std::vector<std::uint8_t> request = {0x0F, 0x00, 0x13, 0x00, 0x0A, 0x02, 0xCD, 0x01};
  const std::vector<std::uint8_t> expected = {0x0F, 0x00, 0x13, 0x00, 0x0A};
  EXPECT_EQ(answer_request(c, request, 0), expected);
  std::array<bool, 10> bits{};
  ASSERT_EQ(c.read_coils(0x13, bits, 0), registers::Exception::none);
  EXPECT_EQ(bits, (std::array<bool, 10>{true, false, true, true, false, false, true, true, true,
                                        false}));
}

TEST(ModbusFrame, RequestsBeyondTheLimitsAreIllegalValues) {
  LightController c(wide_config(4096), 1, 0);
  const std::vector<std::uint8_t> illegal = {0x84, 0x03};
  EXPECT_EQ(answer_request(c, std::vector<std::uint8_t>{4, 0, 0, 0, 126}, 0), illegal);
  EXPECT_EQ(answer_request(c, std::vector<std::uint8_t>{4, 0, 0, 0, 0}, 0), illegal);
  EXPECT_EQ(answer_request(c, std::vector<std::uint8_t>{4, 0, 0, 0}, 0), illegal);
  std::vector<std::uint8_t> write(6 + 2 * 124);
  write[0] = 16;
  write[1] = 0x10;
  write[4] = 124;
  write[5] = 248;
  EXPECT_EQ(answer_request(c, write, 0)[1], 3);
  EXPECT_EQ(answer_request(c, std::vector<std::uint8_t>{5, 0, 0, 0x12, 0x34}, 0)[1], 3);
  EXPECT_EQ(answer_request(c, std::vector<std::uint8_t>{0x2B, 0x0E}, 0),
            (std::vector<std::uint8_t>{0xAB, 0x01}));
  EXPECT_TRUE(answer_request(c, {}, 0).empty());
}

TEST(ModbusFrame, BrokenHeadersAreTold) {
  const std::vector<std::uint8_t> protocol = {0, 1, 0, 1, 0, 6, 1, 4};
  EXPECT_EQ(scan_tcp_request(protocol).verdict, ScanVerdict::broken);
  const std::vector<std::uint8_t> length = {0, 1, 0, 0, 1, 0, 1, 4};
  EXPECT_EQ(scan_tcp_request(length).verdict, ScanVerdict::broken);
  const std::vector<std::uint8_t> crc = {1, 4, 0, 0, 0, 1, 0, 0};
  EXPECT_EQ(scan_rtu_request(crc).verdict, ScanVerdict::broken);
}

RC_GTEST_PROP(ModbusFrame, TcpFramesComeBackWholeAndNotBefore,
              (std::uint16_t transaction, std::uint8_t unit)) {
  const auto pdu = *rc::gen::resize(250, rc::gen::nonEmpty<std::vector<std::uint8_t>>());
  RC_PRE(pdu.size() <= 253U);
  const auto frame = frame_tcp(transaction, unit, pdu);
  for (std::size_t n = 0; n < frame.size(); ++n) {
    RC_ASSERT(scan_tcp_request(std::span(frame).first(n)).verdict == ScanVerdict::need_more);
  }
  const FrameScan scan = scan_tcp_request(frame);
  RC_ASSERT(scan.verdict == ScanVerdict::complete);
  RC_ASSERT(scan.n_bytes == frame.size());
  RC_ASSERT(scan.request.transaction == transaction);
  RC_ASSERT(scan.request.unit == unit);
  RC_ASSERT(scan.request.pdu == pdu);
}

RC_GTEST_PROP(ModbusFrame, ASingleWrongBitBreaksAnRtuRequest, (std::uint16_t address)) {
  const std::vector<std::uint8_t> pdu = {6, static_cast<std::uint8_t>(address >> 8U),
                                         static_cast<std::uint8_t>(address & 0xFFU), 0, 1};
  auto frame = frame_rtu(1, pdu);
  RC_ASSERT(scan_rtu_request(frame).verdict == ScanVerdict::complete);
  const int bit = *rc::gen::inRange(16, static_cast<int>(8 * frame.size()));
  auto& byte = frame[static_cast<std::size_t>(bit / 8)];
  byte = static_cast<std::uint8_t>(byte ^ (1U << (bit % 8)));
  RC_ASSERT(scan_rtu_request(frame).verdict == ScanVerdict::broken);
}

}  // namespace
}  // namespace haarlight::firmware_iface
