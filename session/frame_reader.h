// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <span>
#include <unordered_map>
#include <vector>

#include "haarlight/session/session.h"

/// @file
/// Rows of a session's frames, as stored: for who reads every frame part by part. A frame's TIFF
/// is parsed at the first reading only; the rows themselves are read directly, nothing else of
/// their strips.

namespace haarlight::session {

/// Borrows the session. Safe to share between threads.
class FrameReader {
 public:
  explicit FrameReader(const Session& session) : session_(&session) {}

  /// Rows [y0, y1) of a frame's active area.
  /// @param out  (y1 - y0, width, channels) samples, little-endian: row_bytes() a row
  /// @throws Error  naming the frame's file
  void read(const FrameRecord& frame, int y0, int y1, std::span<std::byte> out) const;
  /// Says that these rows will be read soon: the disk may fetch them meanwhile. Of a frame that
  /// was not read yet nothing is fetched.
  void expect(const FrameRecord& frame, int y0, int y1) const noexcept;
  [[nodiscard]] std::size_t row_bytes() const;

 private:
  /// Where a frame's strips begin in its file.
  using Strips = std::vector<std::uint64_t>;
  [[nodiscard]] const Strips& strips_of(const FrameRecord& frame) const;

  const Session* session_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<const FrameRecord*, Strips> strips_;  ///< addresses stay
};

}  // namespace haarlight::session
