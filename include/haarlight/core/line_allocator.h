// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <new>
#include <vector>

/// @file
/// Large vectors of numbers that begin at a cache line and are not zeroed first: for who writes
/// all of them, line by line.

namespace haarlight {

inline constexpr std::size_t kCacheLine = 64;  // bytes

/// What resize() adds holds arbitrary numbers.
template <class T>
struct LineAllocator {
  using value_type = T;
  LineAllocator() = default;
  template <class U>
  explicit LineAllocator(const LineAllocator<U>& /*other*/) noexcept {}

  [[nodiscard]] T* allocate(std::size_t n) {
    return static_cast<T*>(::operator new (n * sizeof(T), std::align_val_t{kCacheLine}));
  }
  void deallocate(T* values, std::size_t /*n*/) noexcept {
    ::operator delete (values, std::align_val_t{kCacheLine});
  }
  template <class U>
  void construct(U* at) noexcept {
    ::new (static_cast<void*>(at)) U;
  }
  template <class U, class... From>
  void construct(U* at, From&&... from) {
    ::new (static_cast<void*>(at)) U(static_cast<From&&>(from)...);
  }
  friend bool operator==(const LineAllocator&, const LineAllocator&) noexcept { return true; }
};

using LineFloats = std::vector<float, LineAllocator<float>>;

}  // namespace haarlight
