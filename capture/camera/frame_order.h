// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

/// @file
/// Turns a driver's frame count and timestamps into evidence: continues the 32-bit count across
/// wraps and restarts, and detects timestamps that cannot be true. Pure apart from its own
/// state.

namespace haarlight::capture {

class FrameOrder {
 public:
  struct Verdict {
    std::uint64_t sequence = 0;  ///< strictly increasing within a stream
    bool is_restart = false;     ///< the count went back or stood still: frames may be missing
    bool is_timestamp_jump = false;  ///< earlier than the last, after arrival, or far too old
  };

  /// @param patience_ns  a frame older than this on arrival has a wrong timestamp
  explicit FrameOrder(std::int64_t patience_ns) : patience_ns_(patience_ns) {}

  /// The next frame, as delivered by the driver.
  /// @param raw      its count modulo 2^32; a step of 2^31 or more counts as a step back
  /// @param arrival_ns  when the driver delivered it, on the timestamps' clock: a true
  /// timestamp is earlier, whichever moment it means
  [[nodiscard]] Verdict classify(std::uint32_t raw, std::int64_t timestamp_ns,
                                 std::int64_t arrival_ns);

  /// Streaming was restarted: whatever the driver counts now, the next frame continues the
  /// sequence after a gap.
  void restart() { is_restarted_ = last_raw_.has_value(); }

 private:
  std::int64_t patience_ns_;
  std::optional<std::uint32_t> last_raw_;
  std::uint64_t sequence_ = 0;
  std::optional<std::int64_t> last_timestamp_ns_;
  bool is_restarted_ = false;
};

}  // namespace haarlight::capture
