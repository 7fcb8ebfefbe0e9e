// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/haar.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Index = std::ptrdiff_t;

constexpr int kLargestSize = 1024;
constexpr std::size_t kStackValues = 4096;  // scratch that fits on the stack: rigs have 32 x 32

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

/// Splits m values `stride` apart into (m + 1) / 2 sums and m / 2 differences; the last of an
/// odd number is its own sum.
void split_line(std::int64_t* x, std::int64_t* scratch, Index m, Index stride) {
  const Index h = (m + 1) / 2;
  for (Index j = 0; j < m / 2; ++j) {
    const std::int64_t a = x[2 * j * stride];
    const std::int64_t b = x[(2 * j + 1) * stride];
    const std::int64_t d = a - b;
    scratch[j] = b + (d >> 1);
    scratch[j + h] = d;
  }
  if (m % 2 == 1) {
    scratch[h - 1] = x[(m - 1) * stride];
  }
  for (Index j = 0; j < m; ++j) {
    x[j * stride] = scratch[j];
  }
}

void join_line(std::int64_t* x, std::int64_t* scratch, Index m, Index stride) {
  const Index h = (m + 1) / 2;
  for (Index j = 0; j < m / 2; ++j) {
    const std::int64_t s = x[j * stride];
    const std::int64_t d = x[(j + h) * stride];
    const std::int64_t b = s - (d >> 1);
    scratch[2 * j] = d + b;
    scratch[2 * j + 1] = b;
  }
  if (m % 2 == 1) {
    scratch[m - 1] = x[(h - 1) * stride];
  }
  for (Index j = 0; j < m; ++j) {
    x[j * stride] = scratch[j];
  }
}

// ---- grids of any sides ----

void require_grids(std::size_t size, const HaarGrid& grid) {
  HAARLIGHT_EXPECTS(grid.is_valid(), "the Haar transform needs sides of 1 to 1024");
  HAARLIGHT_EXPECTS(size % static_cast<std::size_t>(grid.size()) == 0,
                    "the Haar transform needs whole arrays of rows * cols values");
}

/// Sums before the first level, after it, ... down to one.
std::vector<Index> lengths_of(Index n) {
  std::vector<Index> lengths = {n};
  while (lengths.back() > 1) {
    lengths.push_back((lengths.back() + 1) / 2);
  }
  return lengths;
}

/// Steps until both sides are 1, finest first.
std::vector<std::pair<Index, Index>> steps_of(const HaarGrid& grid) {
  const std::vector<Index> rows = lengths_of(grid.rows);
  const std::vector<Index> cols = lengths_of(grid.cols);
  std::vector<std::pair<Index, Index>> steps;
  for (std::size_t i = 0; i + 1 < std::max(rows.size(), cols.size()); ++i) {
    steps.emplace_back(rows[std::min(i, rows.size() - 1)], cols[std::min(i, cols.size() - 1)]);
  }
  return steps;
}

/// The pair weights along one side of n lights at each level: the parts of s's first and second
/// value. For two groups of equal size both are exactly sqrt(1/2).
struct PairParts {
  double first = 0.0;
  double second = 0.0;
};

std::vector<std::vector<PairParts>> parts_of(Index n) {
  std::vector<std::vector<PairParts>> parts;
  std::vector<double> counts(static_cast<std::size_t>(n), 1.0);
  while (counts.size() > 1) {
    std::vector<PairParts>& level = parts.emplace_back();
    std::vector<double> merged;
    for (std::size_t j = 0; j + 1 < counts.size(); j += 2) {
      const double both = counts[j] + counts[j + 1];
      level.push_back({std::sqrt(counts[j] / both), std::sqrt(counts[j + 1] / both)});
      merged.push_back(both);
    }
    if (counts.size() % 2 == 1) {
      merged.push_back(counts.back());
    }
    counts = std::move(merged);
  }
  return parts;
}

/// s and d from a pair, and the pair from s and d: the same reflection.
template <class T>
void reflect(const PairParts& part, T a, T b, T& first, T& second) {
  first = static_cast<T>(part.first * double{a} + part.second * double{b});
  second = static_cast<T>(part.second * double{a} - part.first * double{b});
}

/// A row of m values into (m + 1) / 2 sums and m / 2 differences.
template <class T>
void split_row(T* x, T* scratch, Index m, const std::vector<PairParts>& parts) {
  const Index h = (m + 1) / 2;
  std::copy_n(x, m, scratch);
  for (Index j = 0; j < m / 2; ++j) {
    reflect(parts[static_cast<std::size_t>(j)], scratch[2 * j], scratch[2 * j + 1], x[j],
            x[j + h]);
  }
  if (m % 2 == 1) {
    x[h - 1] = scratch[m - 1];
  }
}

template <class T>
void join_row(T* x, T* scratch, Index m, const std::vector<PairParts>& parts) {
  const Index h = (m + 1) / 2;
  std::copy_n(x, m, scratch);
  for (Index j = 0; j < m / 2; ++j) {
    reflect(parts[static_cast<std::size_t>(j)], scratch[j], scratch[j + h], x[2 * j],
            x[2 * j + 1]);
  }
  if (m % 2 == 1) {
    x[m - 1] = scratch[h - 1];
  }
}

template <class T>
void copy_rows(const T* x, Index stride, Index rows, Index cols, T* scratch) {
  for (Index row = 0; row < rows; ++row) {
    std::copy_n(x + row * stride, cols, scratch + row * cols);
  }
}

/// All columns of rows `stride` apart at once.
template <class T>
void split_columns(T* x, T* scratch, Index stride, Index rows, Index cols,
                   const std::vector<PairParts>& parts) {
  const Index h = (rows + 1) / 2;
  copy_rows(x, stride, rows, cols, scratch);
  for (Index j = 0; j < rows / 2; ++j) {
    const PairParts part = parts[static_cast<std::size_t>(j)];
    const T* a = scratch + 2 * j * cols;
    for (Index col = 0; col < cols; ++col) {
      reflect(part, a[col], a[col + cols], x[j * stride + col], x[(j + h) * stride + col]);
    }
  }
  if (rows % 2 == 1) {
    std::copy_n(scratch + (rows - 1) * cols, cols, x + (h - 1) * stride);
  }
}

template <class T>
void join_columns(T* x, T* scratch, Index stride, Index rows, Index cols,
                  const std::vector<PairParts>& parts) {
  const Index h = (rows + 1) / 2;
  copy_rows(x, stride, rows, cols, scratch);
  for (Index j = 0; j < rows / 2; ++j) {
    const PairParts part = parts[static_cast<std::size_t>(j)];
    const T* s = scratch + j * cols;
    const T* d = scratch + (j + h) * cols;
    for (Index col = 0; col < cols; ++col) {
      reflect(part, s[col], d[col], x[2 * j * stride + col], x[(2 * j + 1) * stride + col]);
    }
  }
  if (rows % 2 == 1) {
    std::copy_n(scratch + (h - 1) * cols, cols, x + (rows - 1) * stride);
  }
}

/// The parts of all levels of both sides; the same for every pixel.
class WeightedHaar {
 public:
  explicit WeightedHaar(const HaarGrid& grid)
      : grid_(grid),
        steps_(steps_of(grid)),
        along_x_(parts_of(grid.cols)),
        along_y_(parts_of(grid.rows)) {}

  /// @param scratch  grid.size() values
  template <class T>
  void forward(T* x, T* scratch) const {
    for (std::size_t i = 0; i < steps_.size(); ++i) {
      const auto [rows, cols] = steps_[i];
      for (Index row = 0; cols > 1 && row < rows; ++row) {
        split_row(x + row * grid_.cols, scratch, cols, along_x_[i]);
      }
      if (rows > 1) {
        split_columns(x, scratch, grid_.cols, rows, cols, along_y_[i]);
      }
    }
  }
  template <class T>
  void inverse(T* x, T* scratch) const {
    for (std::size_t i = steps_.size(); i-- > 0;) {
      const auto [rows, cols] = steps_[i];
      if (rows > 1) {
        join_columns(x, scratch, grid_.cols, rows, cols, along_y_[i]);
      }
      for (Index row = 0; cols > 1 && row < rows; ++row) {
        join_row(x + row * grid_.cols, scratch, cols, along_x_[i]);
      }
    }
  }

 private:
  HaarGrid grid_;
  std::vector<std::pair<Index, Index>> steps_;
  std::vector<std::vector<PairParts>> along_x_;
  std::vector<std::vector<PairParts>> along_y_;
};

template <class T>
void forward_grids(std::span<T> x, const HaarGrid& grid) {
  require_grids(x.size(), grid);
  const auto size = static_cast<std::size_t>(grid.size());
  if (grid.is_plain()) {
    for (std::size_t at = 0; at < x.size(); at += size) {
      forward(x.subspan(at, size), grid.rows);
    }
    return;
  }
  const WeightedHaar haar(grid);
  std::vector<T> scratch(size);
  for (std::size_t at = 0; at < x.size(); at += size) {
    haar.forward(x.data() + at, scratch.data());
  }
}

template <class T>
void inverse_grids(std::span<T> x, const HaarGrid& grid) {
  require_grids(x.size(), grid);
  const auto size = static_cast<std::size_t>(grid.size());
  if (grid.is_plain()) {
    for (std::size_t at = 0; at < x.size(); at += size) {
      inverse(x.subspan(at, size), grid.rows);
    }
    return;
  }
  const WeightedHaar haar(grid);
  std::vector<T> scratch(size);
  for (std::size_t at = 0; at < x.size(); at += size) {
    haar.inverse(x.data() + at, scratch.data());
  }
}

/// The level of the coefficient at (row, col): 0 for the mean, then as many as there are steps.
int level_in(const HaarGrid& grid, const std::vector<std::pair<Index, Index>>& steps, int row,
             int col) {
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const auto [rows, cols] = steps[i];
    if (row >= (rows + 1) / 2 || col >= (cols + 1) / 2) {
      return static_cast<int>(steps.size() - i);
    }
  }
  HAARLIGHT_EXPECTS(row < grid.rows && col < grid.cols, "a position of the grid");
  return 0;
}

}  // namespace

bool HaarGrid::is_valid() const noexcept {
  return rows >= 1 && cols >= 1 && rows <= kLargestSize && cols <= kLargestSize;
}

bool is_haar_size(int n) noexcept {
  return n >= 1 && n <= kLargestSize && std::has_single_bit(static_cast<unsigned>(n));
}

void haar_forward(std::span<float> x, const HaarGrid& grid) { forward_grids(x, grid); }
void haar_forward(std::span<double> x, const HaarGrid& grid) { forward_grids(x, grid); }
void haar_inverse(std::span<float> x, const HaarGrid& grid) { inverse_grids(x, grid); }
void haar_inverse(std::span<double> x, const HaarGrid& grid) { inverse_grids(x, grid); }

void s_transform_forward(std::span<std::int64_t> x, const HaarGrid& grid) {
  require_grids(x.size(), grid);
  std::vector<std::int64_t> scratch(static_cast<std::size_t>(std::max(grid.rows, grid.cols)));
  const std::vector<std::pair<Index, Index>> steps = steps_of(grid);
  for (std::int64_t* array = x.data(); array != x.data() + x.size(); array += grid.size()) {
    for (const auto& [rows, cols] : steps) {
      for (Index row = 0; row < rows; ++row) {
        split_line(array + row * grid.cols, scratch.data(), cols, 1);
      }
      for (Index col = 0; col < cols; ++col) {
        split_line(array + col, scratch.data(), rows, grid.cols);
      }
    }
  }
}

double haar_inverse_at(std::span<const double> x, const HaarGrid& grid, int row, int col) {
  require_shape(x.size(), grid.rows);
  HAARLIGHT_EXPECTS(
      grid.is_plain() && row >= 0 && row < grid.rows && col >= 0 && col < grid.cols,
      "a value of a plain grid");
  const Index n = grid.rows;
  double value = x[0];
  for (Index m = 2; m <= n; m *= 2) {  // inverse_level of the one square around it
    const Index h = m / 2;
    const Index y = row * m / n;
    const Index z = col * m / n;
    const auto at = [&](Index i, Index j) { return x[static_cast<std::size_t>(i * n + j)]; };
    const double along_x = at(y / 2, z / 2 + h);
    const double along_y = at(y / 2 + h, z / 2);
    const double diagonal = at(y / 2 + h, z / 2 + h);
    const double sum = y % 2 == 0 ? value + along_y : value - along_y;
    const double difference = y % 2 == 0 ? along_x + diagonal : along_x - diagonal;
    value = (z % 2 == 0 ? sum + difference : sum - difference) * 0.5;
  }
  return value;
}

void s_transform_inverse(std::span<std::int64_t> x, const HaarGrid& grid) {
  require_grids(x.size(), grid);
  std::vector<std::int64_t> scratch(static_cast<std::size_t>(std::max(grid.rows, grid.cols)));
  const std::vector<std::pair<Index, Index>> steps = steps_of(grid);
  for (std::int64_t* array = x.data(); array != x.data() + x.size(); array += grid.size()) {
    for (std::size_t i = steps.size(); i-- > 0;) {
      const auto [rows, cols] = steps[i];
      for (Index col = 0; col < cols; ++col) {
        join_line(array + col, scratch.data(), rows, grid.cols);
      }
      for (Index row = 0; row < rows; ++row) {
        join_line(array + row * grid.cols, scratch.data(), cols, 1);
      }
    }
  }
}

std::vector<int> haar_order(const HaarGrid& grid) {
  HAARLIGHT_EXPECTS(grid.is_valid(), "sides of 1 to 1024");
  const std::vector<std::pair<Index, Index>> steps = steps_of(grid);
  std::vector<int> levels;
  std::vector<int> order(static_cast<std::size_t>(grid.size()));
  levels.reserve(order.size());
  for (int i = 0; i < grid.size(); ++i) {
    levels.push_back(level_in(grid, steps, i / grid.cols, i % grid.cols));
  }
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&levels](int a, int b) {
    return levels[static_cast<std::size_t>(a)] < levels[static_cast<std::size_t>(b)];
  });
  return order;
}

std::vector<int> haar_group_ends(const HaarGrid& grid) {
  constexpr Index kCoarse = 8;
  std::vector<int> ends;
  const std::vector<std::pair<Index, Index>> steps = steps_of(grid);
  for (std::size_t i = steps.size(); i-- > 0;) {
    const auto [rows, cols] = steps[i];
    if (std::max(rows, cols) >= kCoarse || i == 0) {
      ends.push_back(static_cast<int>(rows * cols));
    }
  }
  return steps.empty() ? std::vector<int>{1} : ends;
}

}  // namespace haarlight::relight
