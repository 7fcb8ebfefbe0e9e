// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/usb_frame.h"

#include <array>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "firmware_iface/modbus_request.h"
#include "firmware_iface/register_pdu.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// Frames and PDUs by the bytes that docs/reference/usb-protocol.md and [Modbus12] print, and
/// the host's side against the controller's.

namespace haarlight::firmware_iface {
namespace {

using Bytes = std::vector<std::uint8_t>;

TEST(UsbFrame, HasTheBytesOfTheDocument) {
  const Bytes bytes =
      usb::encode_frame({usb::FrameKind::request, 0x01020304, {4, 0, 0, 0, 20}}, 512);
  EXPECT_EQ(bytes, (Bytes{'H', 'L', 1, 0, 1, 2, 3, 4, 0, 5, 4, 0, 0, 0, 20}));
  const auto frame = usb::decode_frame(bytes);
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->sequence, 0x01020304U);
  EXPECT_EQ(frame->pdu, (Bytes{4, 0, 0, 0, 20}));
}

TEST(UsbFrame, NeverEndsWithAFullPacket) {
  for (std::size_t n = 1; n <= usb::kMaxPdu; ++n) {
    const Bytes bytes = usb::encode_frame({usb::FrameKind::reply, 7, Bytes(n, 3)}, 64);
    EXPECT_NE(bytes.size() % 64, 0U);
    EXPECT_LE(bytes.size(), usb::kMaxFrame);
    const auto frame = usb::decode_frame(bytes);
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->pdu.size(), n);
  }
}

TEST(UsbFrame, BeginningsAndForeignBytesAreToldApart) {
  const Bytes whole = usb::encode_frame({usb::FrameKind::request, 9, {1, 2, 3}}, 512);
  for (std::size_t n = 0; n < whole.size(); ++n) {
    const Bytes part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));
    EXPECT_FALSE(usb::decode_frame(part));
    const auto size = usb::frame_size(part);
    ASSERT_TRUE(size);
    EXPECT_EQ(*size, n < usb::kHeaderBytes ? 0 : whole.size());
  }
  Bytes longer = whole;
  longer.resize(whole.size() + 2);
  EXPECT_FALSE(usb::decode_frame(longer));
  for (const std::size_t i : {0U, 1U, 2U, 3U, 8U}) {
    Bytes wrong = whole;
    wrong[i] = 0xEE;
    EXPECT_FALSE(usb::frame_size(wrong));
    EXPECT_FALSE(usb::decode_frame(wrong));
  }
}

TEST(UsbIdentity, IsTheIdentityRegisters) {
  std::vector<std::uint16_t> words(registers::input::kIdentityCount);
  words[0] = registers::kMagic;
  words[3] = 0x1234;
  const Bytes bytes = usb::encode_identity(words);
  EXPECT_EQ(bytes.size(), 44U);
  EXPECT_EQ(usb::decode_identity_reply(bytes), words);
  Bytes shorter = bytes;
  shorter.pop_back();
  EXPECT_FALSE(usb::decode_identity_reply(shorter));
}

// The examples that the Modbus specification prints, sections 6.3, 6.11 and 6.12.
TEST(RegisterPdu, HasTheSpecificationsBytes) {
  EXPECT_EQ(read_request(ReadFunction::holding, 107, 3), (Bytes{3, 0, 0x6B, 0, 3}));
  const std::array<std::uint16_t, 2> words = {0x000A, 0x0102};
  EXPECT_EQ(write_registers_request(1, words), (Bytes{16, 0, 1, 0, 2, 4, 0, 0x0A, 1, 2}));
  const std::array<std::uint8_t, 10> bits = {1, 0, 1, 1, 0, 0, 1, 1, 1, 0};
  EXPECT_EQ(write_coils_request(0x13, bits), (Bytes{15, 0, 0x13, 0, 10, 2, 0xCD, 0x01}));
  std::array<std::uint16_t, 3> got{};
  const Bytes reply = {3, 6, 0x02, 0x2B, 0, 0, 0, 0x64};
  ASSERT_EQ(read_reply(reply, ReadFunction::holding, got), registers::Exception::none);
  EXPECT_EQ(got, (std::array<std::uint16_t, 3>{555, 0, 100}));
}

TEST(RegisterPdu, AnswersThatDoNotFitAreNoAnswers) {
  std::array<std::uint16_t, 2> words{};
  const auto code = [&words](const Bytes& pdu) {
    const auto answer = read_reply(pdu, ReadFunction::input, words);
    return answer ? -1 : static_cast<int>(answer.error().code);
  };
  const auto protocol = static_cast<int>(Errc::protocol);
  EXPECT_EQ(code({}), protocol);
  EXPECT_EQ(code({3, 4, 0, 0, 0, 0}), protocol);     // another function
  EXPECT_EQ(code({4, 2, 0, 0}), protocol);           // too few
  EXPECT_EQ(code({4, 4, 0, 0, 0, 0, 0}), protocol);  // too many
  EXPECT_EQ(code({4, 2, 0, 0, 0, 0}), protocol);     // a count that lies
  EXPECT_EQ(code({0x84, 99}), protocol);             // an exception that does not exist
  EXPECT_EQ(code({0x84, 0}), protocol);
  EXPECT_EQ(code({0x84}), protocol);
  EXPECT_EQ(read_reply(Bytes{0x84, 6}, ReadFunction::input, words), registers::Exception::busy);
  const std::array<std::uint16_t, 1> one = {1};
  const Bytes request = write_registers_request(5, one);
  EXPECT_EQ(write_reply(Bytes{16, 0, 5, 0, 1}, request), registers::Exception::none);
  EXPECT_FALSE(write_reply(Bytes{16, 0, 6, 0, 1}, request));  // another register
  EXPECT_FALSE(write_reply(Bytes{16, 0, 5, 0}, request));
}

RC_GTEST_PROP(RegisterPdu, WhatTheHostWritesTheControllerHoldsAndTheHostReads, ()) {
  LightController controller(wide_config(256), 1, 0);
  const auto first = *rc::gen::inRange(0, 200);
  const auto n = static_cast<std::size_t>(*rc::gen::inRange(1, 50));
  const auto words =
      *rc::gen::container<std::vector<std::uint16_t>>(n, rc::gen::arbitrary<std::uint16_t>());
  const auto address = static_cast<std::uint16_t>(registers::holding::kLevels + first);
  const Bytes write = write_registers_request(address, words);
  RC_ASSERT(write_reply(answer_request(controller, write, 0), write) ==
            registers::Exception::none);
  std::vector<std::uint16_t> got(n);
  const Bytes read = read_request(ReadFunction::holding, address, n);
  RC_ASSERT(read_reply(answer_request(controller, read, 0), ReadFunction::holding, got) ==
            registers::Exception::none);
  RC_ASSERT(got == words);
}

}  // namespace
}  // namespace haarlight::firmware_iface
