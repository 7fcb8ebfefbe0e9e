// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/separable_basis.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

int frequency_bits(int row, int col) {
  return static_cast<int>(std::bit_width(static_cast<unsigned>(std::max(row, col))));
}

/// A transform of each grid by itself, its coefficients ordered by frequency.
class GridBasis : public FixedBasis {
 public:
  GridBasis(const HaarGrid& grid, int n_lights) : FixedBasis(n_lights), grid_(grid) {}
  [[nodiscard]] std::vector<int> order() const final {
    return for_each_grid(dyadic_order(grid_), grid_.size(), n_lights());
  }
  [[nodiscard]] std::vector<int> group_ends() const final {
    return for_each_grid(dyadic_group_ends(grid_), grid_.size(), n_lights());
  }

 protected:
  [[nodiscard]] const HaarGrid& grid() const { return grid_; }
  /// Calls `work(values of a grid)` for every grid of every row.
  template <class T, class Work>
  void for_grids(std::span<T> rows, const Work& work) const {
    HAARLIGHT_EXPECTS(rows.size() % count(n_lights()) == 0, "whole pixels");
    for (std::size_t at = 0; at < rows.size(); at += count(grid_.size())) {
      work(rows.subspan(at, count(grid_.size())));
    }
  }

 private:
  HaarGrid grid_;
};

/// The DCT-II along one side.
struct DctMatrix {
  std::size_t n;
  std::vector<double> by_frequency;  ///< (frequency, light)
  std::vector<double> by_light;      ///< its transpose

  explicit DctMatrix(int side) : n(count(side)), by_frequency(n * n), by_light(n * n) {
    // The angle is reduced exactly: cos(pi j / (2 n)) repeats after 4 n.
    std::vector<double> cosines(4 * n);
    for (std::size_t j = 0; j < cosines.size(); ++j) {
      cosines[j] = std::cos(std::numbers::pi * double(j) / (2.0 * double(n)));
    }
    for (std::size_t i = 0; i < n; ++i) {
      const double scale = std::sqrt((i == 0 ? 1.0 : 2.0) / double(n));
      for (std::size_t k = 0; k < n; ++k) {
        const double value = scale * cosines[(2 * k + 1) * i % (4 * n)];
        by_frequency[i * n + k] = value;
        by_light[k * n + i] = value;
      }
    }
  }
};

/// out = a b, of (rows, inner) by (inner, cols): sums in the order of the inner index. Most
/// coefficients of a file are 0 and cost nothing.
template <class A>
void multiply(const A* a, const double* b, std::size_t rows, std::size_t inner,
              std::size_t cols, double* out) {
  std::fill_n(out, rows * cols, 0.0);
  for (std::size_t row = 0; row < rows; ++row) {
    double* sums = out + row * cols;
    for (std::size_t i = 0; i < inner; ++i) {
      const auto factor = double{a[row * inner + i]};
      if (factor == 0.0) {
        continue;
      }
      const double* from = b + i * cols;
      for (std::size_t col = 0; col < cols; ++col) {
        sums[col] += factor * from[col];
      }
    }
  }
}

class DctBasis final : public GridBasis {
 public:
  DctBasis(const HaarGrid& grid, int n_lights)
      : GridBasis(grid, n_lights), along_y_(grid.rows), along_x_(grid.cols) {}
  void forward(std::span<float> rows) const override { forward_all(rows); }
  void forward(std::span<double> rows) const override { forward_all(rows); }
  void inverse(std::span<float> rows) const override { inverse_all(rows); }
  void inverse(std::span<double> rows) const override { inverse_all(rows); }

 private:
  template <class T>
  void forward_all(std::span<T> rows) const {
    transform(rows, along_x_.by_light, along_y_.by_frequency);
  }
  template <class T>
  void inverse_all(std::span<T> rows) const {
    transform(rows, along_x_.by_frequency, along_y_.by_light);
  }
  /// x becomes y x' of the matrices along y and along x.
  template <class T>
  void transform(std::span<T> rows, const std::vector<double>& x,
                 const std::vector<double>& y) const {
    const std::size_t n_y = along_y_.n;
    const std::size_t n_x = along_x_.n;
    std::vector<double> half(n_y * n_x);
    std::vector<double> whole(n_y * n_x);
    for_grids(rows, [&](std::span<T> values) {
      multiply(values.data(), x.data(), n_y, n_x, n_x, half.data());
      multiply(y.data(), half.data(), n_y, n_y, n_x, whole.data());
      std::transform(whole.begin(), whole.end(), values.begin(),
                     [](double v) { return static_cast<T>(v); });
    });
  }

  DctMatrix along_y_;
  DctMatrix along_x_;
};

template <class T>
constexpr T kRootHalf = static_cast<T>(1.0 / std::numbers::sqrt2);

/// All levels along one line of n = 2^m points: sums first, then details.
template <class T>
void split_all_levels(T* x, std::size_t stride, std::size_t n, std::vector<T>& old) {
  for (std::size_t length = n; length > 1; length /= 2) {
    for (std::size_t i = 0; i < length; ++i) {
      old[i] = x[stride * i];
    }
    for (std::size_t i = 0; i < length / 2; ++i) {
      x[stride * i] = kRootHalf<T> * (old[2 * i] + old[2 * i + 1]);
      x[stride * (length / 2 + i)] = kRootHalf<T> * (old[2 * i] - old[2 * i + 1]);
    }
  }
}

template <class T>
void join_all_levels(T* x, std::size_t stride, std::size_t n, std::vector<T>& old) {
  for (std::size_t length = 2; length <= n; length *= 2) {
    for (std::size_t i = 0; i < length; ++i) {
      old[i] = x[stride * i];
    }
    for (std::size_t i = 0; i < length / 2; ++i) {
      x[stride * (2 * i)] = kRootHalf<T> * (old[i] + old[length / 2 + i]);
      x[stride * (2 * i + 1)] = kRootHalf<T> * (old[i] - old[length / 2 + i]);
    }
  }
}

class StandardHaarBasis final : public GridBasis {
 public:
  using GridBasis::GridBasis;
  void forward(std::span<float> rows) const override { work(rows, split_all_levels<float>); }
  void forward(std::span<double> rows) const override { work(rows, split_all_levels<double>); }
  void inverse(std::span<float> rows) const override { work(rows, join_all_levels<float>); }
  void inverse(std::span<double> rows) const override { work(rows, join_all_levels<double>); }

 private:
  template <class T, class LineWork>
  void work(std::span<T> rows, LineWork line) const {
    const std::size_t n_y = count(grid().rows);
    const std::size_t n_x = count(grid().cols);
    std::vector<T> old(std::max(n_y, n_x));
    for_grids(rows, [&](std::span<T> values) {
      for (std::size_t y = 0; y < n_y; ++y) {
        line(values.data() + y * n_x, 1, n_x, old);
      }
      for (std::size_t x = 0; x < n_x; ++x) {
        line(values.data() + x, n_x, n_y, old);
      }
    });
  }
};

}  // namespace

std::shared_ptr<const FixedBasis> make_dct_basis(const HaarGrid& grid, int n_lights) {
  return std::make_shared<DctBasis>(grid, n_lights);
}

std::shared_ptr<const FixedBasis> make_standard_haar_basis(const HaarGrid& grid, int n_lights) {
  return std::make_shared<StandardHaarBasis>(grid, n_lights);
}

std::vector<int> dyadic_order(const HaarGrid& grid) {
  std::vector<int> order(count(grid.size()));
  std::iota(order.begin(), order.end(), 0);
  const auto bits = [&grid](int i) { return frequency_bits(i / grid.cols, i % grid.cols); };
  std::stable_sort(order.begin(), order.end(),
                   [&bits](int a, int b) { return bits(a) < bits(b); });
  return order;
}

std::vector<int> dyadic_group_ends(const HaarGrid& grid) {
  constexpr int kCoarse = 8;
  std::vector<int> ends;
  for (int side = kCoarse; ends.empty() || ends.back() < grid.size(); side *= 2) {
    ends.push_back(std::min(side, grid.rows) * std::min(side, grid.cols));
  }
  return ends;
}

std::vector<int> for_each_grid(const std::vector<int>& of_grid, int grid_size, int n_lights) {
  std::vector<int> all;
  for (int start = 0; start < n_lights; start += grid_size) {
    std::transform(of_grid.begin(), of_grid.end(), std::back_inserter(all),
                   [start](int i) { return start + i; });
  }
  return all;
}

}  // namespace haarlight::relight
