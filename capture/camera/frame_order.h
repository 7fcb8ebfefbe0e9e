// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

/// @file
/// A driver's frame count and stamps made fit for evidence: the 32-bit count continued over its
/// wraps and restarts, stamps that cannot be true found out. Pure but for its own memory.

namespace haarlight {

class FrameOrder {
 public:
  struct Verdict {
    std::uint64_t sequence = 0;  ///< grows by at least 1 from frame to frame of one stream
    bool is_restart = false;     ///< the count went back or stood still: frames may be missing
    bool is_stamp_jump = false;  ///< before an earlier frame's, after its arrival, or long past
  };

  /// @param patience_ns  a frame older than this when it arrives was stamped wrongly
  explicit FrameOrder(std::int64_t patience_ns) : patience_ns_(patience_ns) {}

  /// The next frame, as it comes from the driver.
  /// @param raw      its count modulo 2^32; a step of 2^31 or more is taken for a step back
  /// @param arrival_ns  when the driver gave it out, on the stamps' clock: a true stamp lies
  ///                    before, whichever moment it means
  [[nodiscard]] Verdict judge(std::uint32_t raw, std::int64_t stamp_ns,
                              std::int64_t arrival_ns);

  /// Streaming was begun anew: whatever the driver counts now, the next frame continues the
  /// sequence after a gap.
  void restart() { is_restarted_ = last_raw_.has_value(); }

 private:
  std::int64_t patience_ns_;
  std::optional<std::uint32_t> last_raw_;
  std::uint64_t sequence_ = 0;
  std::optional<std::int64_t> last_stamp_ns_;
  bool is_restarted_ = false;
};

}  // namespace haarlight
