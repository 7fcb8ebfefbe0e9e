#include "relight/basis/haar.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <numeric>

#include "core/error.h"

namespace haarlight {

namespace {

using Index = std::ptrdiff_t;

constexpr int kLargestSize = 1024;
constexpr std::size_t kStackValues = 4096;  // scratch that fits the stack: rigs have 32 x 32

void require_shape(std::size_t size, int n) {
  HAARLIGHT_EXPECTS(is_haar_size(n), "the Haar transform needs a power of two up to 1024");
  HAARLIGHT_EXPECTS(size == static_cast<std::size_t>(n) * static_cast<std::size_t>(n),
                    "the Haar transform needs n * n values");
}

/// Calls `body(scratch)` with room for n * n values.
template <class T, class Body>
void with_scratch(int n, const Body& body) {
  const auto count = static_cast<std::size_t>(n) * static_cast<std::size_t>(n);
  if (count <= kStackValues) {
    T scratch[kStackValues];  // NOLINT(cppcoreguidelines-init-variables)
    body(static_cast<T*>(scratch));
  } else {
    std::vector<T> scratch(count);
    body(scratch.data());
  }
}

template <class T>
void forward_level(T* x, T* scratch, Index n, Index m) {
  const Index h = m / 2;
  for (Index y = 0; y < m; ++y) {
    std::copy_n(x + y * n, m, scratch + y * m);
  }
  for (Index i = 0; i < h; ++i) {
    const T* top = scratch + 2 * i * m;
    const T* bottom = top + m;
    T* ll = x + i * n;
    T* yd = x + (i + h) * n;
    for (Index j = 0; j < h; ++j) {
      const T sum_top = top[2 * j] + top[2 * j + 1];
      const T sum_bottom = bottom[2 * j] + bottom[2 * j + 1];
      const T difference_top = top[2 * j] - top[2 * j + 1];
      const T difference_bottom = bottom[2 * j] - bottom[2 * j + 1];
      ll[j] = (sum_top + sum_bottom) * T(0.5);
      ll[j + h] = (difference_top + difference_bottom) * T(0.5);
      yd[j] = (sum_top - sum_bottom) * T(0.5);
      yd[j + h] = (difference_top - difference_bottom) * T(0.5);
    }
  }
}

template <class T>
void inverse_level(T* x, T* scratch, Index n, Index m) {
  const Index h = m / 2;
  for (Index y = 0; y < m; ++y) {
    std::copy_n(x + y * n, m, scratch + y * m);
  }
  for (Index i = 0; i < h; ++i) {
    const T* ll = scratch + i * m;
    const T* yd = scratch + (i + h) * m;
    T* top = x + 2 * i * n;
    T* bottom = top + n;
    for (Index j = 0; j < h; ++j) {
      const T sum_top = ll[j] + yd[j];
      const T sum_bottom = ll[j] - yd[j];
      const T difference_top = ll[j + h] + yd[j + h];
      const T difference_bottom = ll[j + h] - yd[j + h];
      top[2 * j] = (sum_top + difference_top) * T(0.5);
      top[2 * j + 1] = (sum_top - difference_top) * T(0.5);
      bottom[2 * j] = (sum_bottom + difference_bottom) * T(0.5);
      bottom[2 * j + 1] = (sum_bottom - difference_bottom) * T(0.5);
    }
  }
}

template <class T>
void forward(std::span<T> x, int n) {
  require_shape(x.size(), n);
  with_scratch<T>(n, [&](T* scratch) {
    for (Index m = n; m > 1; m /= 2) {
      forward_level(x.data(), scratch, n, m);
    }
  });
}

template <class T>
void inverse(std::span<T> x, int n) {
  require_shape(x.size(), n);
  with_scratch<T>(n, [&](T* scratch) {
    for (Index m = 2; m <= n; m *= 2) {
      inverse_level(x.data(), scratch, n, m);
    }
  });
}

/// Splits m values `stride` apart into h sums and h differences.
template <class T>
void split_line(T* x, T* scratch, Index m, Index stride) {
  const Index h = m / 2;
  for (Index j = 0; j < h; ++j) {
    const T a = x[2 * j * stride];
    const T b = x[(2 * j + 1) * stride];
    const T d = a - b;
    scratch[j] = b + (d >> 1);
    scratch[j + h] = d;
  }
  for (Index j = 0; j < m; ++j) {
    x[j * stride] = scratch[j];
  }
}

template <class T>
void join_line(T* x, T* scratch, Index m, Index stride) {
  const Index h = m / 2;
  for (Index j = 0; j < h; ++j) {
    const T s = x[j * stride];
    const T d = x[(j + h) * stride];
    const T b = s - (d >> 1);
    scratch[2 * j] = d + b;
    scratch[2 * j + 1] = b;
  }
  for (Index j = 0; j < m; ++j) {
    x[j * stride] = scratch[j];
  }
}

template <class T>
void s_forward(std::span<T> x, int n) {
  require_shape(x.size(), n);
  std::vector<T> scratch(static_cast<std::size_t>(n));
  for (Index m = n; m > 1; m /= 2) {
    for (Index y = 0; y < m; ++y) {
      split_line(x.data() + y * n, scratch.data(), m, 1);
    }
    for (Index i = 0; i < m; ++i) {
      split_line(x.data() + i, scratch.data(), m, n);
    }
  }
}

template <class T>
void s_inverse(std::span<T> x, int n) {
  require_shape(x.size(), n);
  std::vector<T> scratch(static_cast<std::size_t>(n));
  for (Index m = 2; m <= n; m *= 2) {
    for (Index i = 0; i < m; ++i) {
      join_line(x.data() + i, scratch.data(), m, n);
    }
    for (Index y = 0; y < m; ++y) {
      join_line(x.data() + y * n, scratch.data(), m, 1);
    }
  }
}

}  // namespace

bool is_haar_size(int n) noexcept {
  return n >= 1 && n <= kLargestSize && std::has_single_bit(static_cast<unsigned>(n));
}

void haar_forward(std::span<float> x, int n) { forward(x, n); }
void haar_forward(std::span<double> x, int n) { forward(x, n); }
void haar_inverse(std::span<float> x, int n) { inverse(x, n); }
void haar_inverse(std::span<double> x, int n) { inverse(x, n); }

void s_transform_forward(std::span<std::int32_t> x, int n) { s_forward(x, n); }
void s_transform_forward(std::span<std::int64_t> x, int n) { s_forward(x, n); }
void s_transform_inverse(std::span<std::int32_t> x, int n) { s_inverse(x, n); }
void s_transform_inverse(std::span<std::int64_t> x, int n) { s_inverse(x, n); }

int haar_level(int row, int col) noexcept {
  return static_cast<int>(std::bit_width(static_cast<unsigned>(std::max(row, col))));
}

std::vector<int> haar_order(int n) {
  std::vector<int> order(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [n](int a, int b) {
    return haar_level(a / n, a % n) < haar_level(b / n, b % n);
  });
  return order;
}

}  // namespace haarlight
