// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/frame_order.h"

namespace haarlight::capture {

FrameOrder::Verdict FrameOrder::classify(std::uint32_t raw, std::int64_t timestamp_ns,
                                         std::int64_t arrival_ns) {
  Verdict verdict;
  if (!last_raw_) {
    sequence_ = raw;
  } else {
    const std::uint32_t step = raw - *last_raw_;
    const bool is_forward = step != 0 && step < 0x8000'0000U;
    verdict.is_restart = !is_restarted_ && !is_forward;
    // Skip one number: how many frames are missing is unknown.
    sequence_ += is_restarted_ || !is_forward ? 2 : step;
  }
  last_raw_ = raw;
  is_restarted_ = false;
  verdict.sequence = sequence_;
  verdict.is_timestamp_jump = (last_timestamp_ns_ && timestamp_ns <= *last_timestamp_ns_) ||
                              timestamp_ns > arrival_ns ||
                              timestamp_ns < arrival_ns - patience_ns_;
  if (!verdict.is_timestamp_jump) {
    last_timestamp_ns_ = timestamp_ns;
  }
  return verdict;
}

}  // namespace haarlight::capture
