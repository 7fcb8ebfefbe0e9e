// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

/// @file
/// Wire protocol of a remote camera: a unix SEQPACKET socket; the camera is the server. One
/// message per packet, little-endian, beginning with a RemoteHeader. A frame's pixels arrive as
/// a memfd by SCM_RIGHTS (rows of `stride` bytes, 16-bit words); the client maps it read-only,
/// and returns it by closing it and sending `release` with the frame's sequence number.
/// Specified in docs/reference/remote-camera.md.

namespace haarlight::capture {

inline constexpr std::uint32_t kRemoteMagic = 0x4d434c48;  // "HLCM"
inline constexpr std::uint16_t kRemoteVersion = 1;

enum class RemoteMessage : std::uint16_t {
  setup =
      1,  ///< client: width, height, exposure, gain, fps to set; server answers `setup` as set
  set_exposure =
      2,        ///< client: exposure to set; server answers `set_exposure` with the value set
  start = 3,    ///< client: start streaming
  stop = 4,     ///< client: stop streaming
  frame = 5,    ///< server: a frame, with a memfd
  release = 6,  ///< client: the memory of this sequence number is free again
  error = 7,    ///< server: the request was refused; `flags` holds an errno
  trigger = 8,  ///< client: expose one frame now; answered only by the frame
};

/// 64 bytes.
struct RemoteHeader {
  std::uint32_t magic = kRemoteMagic;
  std::uint16_t version = kRemoteVersion;
  std::uint16_t message = 0;
  /// Of a frame. In `setup`: what starts an exposure, as requested and as set: 0 the camera
  /// itself, 1 `trigger` messages, 2 its trigger line.
  std::uint64_t sequence = 0;
  std::int64_t timestamp_ns = 0;  ///< CLOCK_MONOTONIC
  std::uint32_t flags = 0;        ///< FrameFlag
  std::uint32_t width = 0;
  std::uint32_t height = 0;  ///< including embedded metadata rows
  std::uint32_t fourcc = 0;
  std::uint32_t stride = 0;  ///< bytes per row
  std::uint32_t bytes = 0;   ///< of the memfd
  float exposure_us = 0.0F;
  float gain_db = 0.0F;
  float fps = 0.0F;
  std::uint32_t n_buffers = 0;  ///< frames the client may hold
};
static_assert(sizeof(RemoteHeader) == 64);

}  // namespace haarlight::capture
