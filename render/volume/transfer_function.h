// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "haarlight/core/error.h"

/// @file
/// Piecewise linear functions of a field's value, and where a value that runs linearly along a ray
/// passes their breakpoints. Pure; safe from any thread.

namespace haarlight::render {

/// Linear between breakpoints, constant before the first and after the last.
template <class Value>
class PiecewiseLinear {
 public:
  /// @param breakpoints  ascending, none twice, at least one
  /// @param values       one for each
  PiecewiseLinear(std::vector<double> breakpoints, std::vector<Value> values)
      : breakpoints_(std::move(breakpoints)), values_(std::move(values)) {
    HAARLIGHT_EXPECTS(!breakpoints_.empty() && breakpoints_.size() == values_.size() &&
                          std::ranges::adjacent_find(
                              breakpoints_, [](double a, double b) { return !(a < b); }) ==
                              breakpoints_.end(),
                      "ascending breakpoints and a value for each");
  }

  [[nodiscard]] std::span<const double> breakpoints() const noexcept { return breakpoints_; }
  [[nodiscard]] const std::vector<Value>& values() const noexcept { return values_; }

  /// Within the part between breakpoints part - 1 and part: 0 before all, their number after all.
  /// Continuous: at a breakpoint both parts give its value to the last bit.
  [[nodiscard]] Value in_part(std::size_t part, double x) const {
    if (part == 0) {
      return values_.front();
    }
    if (part >= values_.size()) {
      return values_.back();
    }
    const double low = breakpoints_[part - 1];
    const double w = (x - low) / (breakpoints_[part] - low);
    return (1.0 - w) * values_[part - 1] + w * values_[part];
  }

  /// The part of a value; of a breakpoint's the one after it.
  [[nodiscard]] std::size_t part_of(double x) const {
    return static_cast<std::size_t>(std::ranges::upper_bound(breakpoints_, x) -
                                    breakpoints_.begin());
  }

  [[nodiscard]] Value at(double x) const { return in_part(part_of(x), x); }

 private:
  std::vector<double> breakpoints_;
  std::vector<Value> values_;
};

/// The parts that a value runs through from `from` (s = 0) to `to` (s = 1), one after the other.
class PartsAlong {
 public:
  PartsAlong(std::span<const double> breakpoints, double from, double to)
      : breakpoints_(breakpoints), from_(from), change_(to - from) {
    const auto number = [&](const auto& place) {
      return static_cast<std::size_t>(place - breakpoints.begin());
    };
    if (to >= from) {
      part_ = number(std::ranges::upper_bound(breakpoints, from));
      n_left_ = number(std::ranges::lower_bound(breakpoints, to));
      n_left_ = n_left_ > part_ ? n_left_ - part_ : 0;
    } else {
      part_ = number(std::ranges::lower_bound(breakpoints, from));
      n_left_ = number(std::ranges::upper_bound(breakpoints, to));
      n_left_ = part_ > n_left_ ? part_ - n_left_ : 0;
    }
    find_next();
  }

  /// As PiecewiseLinear::in_part().
  [[nodiscard]] std::size_t part() const noexcept { return part_; }
  /// Where this part ends, within [0, 1]; kNone: beyond `to`.
  [[nodiscard]] double next() const noexcept { return next_; }
  /// The breakpoint there.
  [[nodiscard]] double next_value() const { return breakpoints_[index()]; }
  /// To the part behind it.
  void advance() {
    part_ = change_ >= 0.0 ? part_ + 1 : part_ - 1;
    --n_left_;
    find_next();
  }

  static constexpr double kNone = std::numeric_limits<double>::infinity();

 private:
  [[nodiscard]] std::size_t index() const { return change_ >= 0.0 ? part_ : part_ - 1; }
  void find_next() {
    if (n_left_ == 0) {
      next_ = kNone;
    } else {
      next_ = std::clamp((breakpoints_[index()] - from_) / change_, std::max(next_, 0.0), 1.0);
    }
  }

  std::span<const double> breakpoints_;
  double from_;
  double change_;
  double next_ = 0.0;
  std::size_t part_ = 0;
  std::size_t n_left_ = 0;
};

}  // namespace haarlight::render
