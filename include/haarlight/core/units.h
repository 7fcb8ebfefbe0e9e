// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <compare>

/// @file
/// Strong units for module interfaces. Inside a kernel a plain double carries its unit in its
/// name.

namespace haarlight {

/// A number with a unit that the compiler checks; `tests/core/compile_fail` proves that units
/// do not mix.
template <class Unit>
class Quantity {
 public:
  constexpr Quantity() = default;
  constexpr explicit Quantity(double value) : value_(value) {}
  [[nodiscard]] constexpr double value() const { return value_; }

  friend constexpr Quantity operator+(Quantity a, Quantity b) {
    return Quantity(a.value_ + b.value_);
  }
  friend constexpr auto operator<=>(Quantity,
                                    Quantity) = default;  // NOLINT(modernize-use-nullptr)

 private:
  double value_ = 0.0;
};

using Watts = Quantity<struct WattTag>;

}  // namespace haarlight
