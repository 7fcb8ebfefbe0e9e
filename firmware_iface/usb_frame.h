// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "haarlight/firmware_iface/register_map.h"

/// @file
/// The USB frames between host and light controller, defined once for the driver and the
/// simulated device: docs/reference/usb-protocol.md prints them for firmware authors. Requests
/// and replies are Modbus PDUs (the same registers, functions and exceptions) in a frame with a
/// sequence number, so that a late answer cannot be mistaken for the next one. Numbers are
/// big-endian as in Modbus. Pure; safe from any thread.
///
///     byte 0-1  'H' 'L'     2  version = 1     3  kind: 0 request, 1 reply
///     byte 4-7  sequence    8-9  n, the PDU's length, 1 .. 253
///     byte 10 .. 10 + n - 1  the PDU; then at most one byte of padding

namespace haarlight::firmware_iface::usb {

/// A controller is recognised by its interface, whatever its vendor and product ids are.
inline constexpr std::uint8_t kInterfaceClass = 0xFF;     ///< vendor specific
inline constexpr std::uint8_t kInterfaceSubclass = 0x48;  ///< 'H'
inline constexpr std::uint8_t kInterfaceProtocol = 0x4C;  ///< 'L'

/// Vendor requests on endpoint 0, recipient device: they need no claimed interface and get
/// through when the bulk endpoints are jammed. wValue and wIndex are 0.
enum class ControlRequest : std::uint8_t {
  identity = 1,  ///< in, kIdentityBytes
  resync = 2,    ///< out, no data: forget a partial request and every reply not yet fetched
  all_off = 3,   ///< out, no data: same as register all_off
};
inline constexpr std::uint8_t kVendorIn = 0xC0;
inline constexpr std::uint8_t kVendorOut = 0x40;

inline constexpr std::uint8_t kWireVersion = 1;
inline constexpr std::size_t kHeaderBytes = 10;
inline constexpr std::size_t kMaxPdu = 253;
inline constexpr std::size_t kMaxFrame = kHeaderBytes + kMaxPdu + 1;

enum class FrameKind : std::uint8_t { request = 0, reply = 1 };

struct Frame {
  FrameKind kind = FrameKind::request;
  std::uint32_t sequence = 0;
  std::vector<std::uint8_t> pdu;
};

/// @param max_packet  of the endpoint: a frame that fills a whole number of packets gets one
/// byte of padding, so that every transfer ends with a short packet
[[nodiscard]] std::vector<std::uint8_t> encode_frame(const Frame& frame,
                                                     std::size_t max_packet);
/// Nothing: not one complete frame of this version.
[[nodiscard]] std::optional<Frame> decode_frame(std::span<const std::uint8_t> bytes);
/// Bytes of the frame that begins here: 0 = more are needed to decide, nothing = no frame
/// begins like this.
[[nodiscard]] std::optional<std::size_t> frame_size(std::span<const std::uint8_t> bytes);

/// Answer to ControlRequest::identity: 'H' 'L', version, 0, then the identity registers
/// (registers::input::kMagic on), high byte first.
inline constexpr std::size_t kIdentityBytes =
    4 + 2 * std::size_t{registers::input::kIdentityCount};
[[nodiscard]] std::vector<std::uint8_t> encode_identity(
    std::span<const std::uint16_t> identity_registers);
/// The identity registers; nothing: not a light controller, or one of a different version.
[[nodiscard]] std::optional<std::vector<std::uint16_t>> decode_identity_reply(
    std::span<const std::uint8_t> bytes);

}  // namespace haarlight::firmware_iface::usb
