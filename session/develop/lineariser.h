// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "session/develop/sensor_response.h"

/// @file
/// The first step of develop: from stored samples to linear steps above black.

namespace haarlight::session {

/// Linear steps above black, (DN - black), or with the sRGB curve inverted over the same range.
/// Pure after construction.
class Lineariser {
 public:
  Lineariser(const FrameForm& form, Transfer transfer, const SensorResponse& response);

  [[nodiscard]] float operator()(float dn) const {
    if (!table_.empty()) {
      return table_[static_cast<std::size_t>(dn)];
    }
    return is_srgb_ ? decode(dn) : dn - black_;
  }
  /// The same of many.
  void apply(std::span<const float> dn, float* out) const;
  /// At or above the level from which samples only mean "at least".
  [[nodiscard]] bool is_clipped(float dn) const { return dn >= clip_; }
  [[nodiscard]] double clip_dn() const { return clip_; }
  /// The clip level, linear.
  [[nodiscard]] double clip() const { return (*this)(clip_); }
  /// One step of the camera has the same size everywhere.
  [[nodiscard]] bool is_linear() const { return !is_srgb_; }
  /// White minus black: the full range in steps.
  [[nodiscard]] double range() const { return range_; }

 private:
  [[nodiscard]] float decode(float dn) const;

  float black_;
  float clip_;
  float range_;
  bool is_srgb_;
  std::vector<float> table_;
};

}  // namespace haarlight::session
