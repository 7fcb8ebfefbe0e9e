// SPDX-License-Identifier: Apache-2.0
#include "relight/study/dyadic_transform.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <tuple>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// Points 0, stride, 2 stride ... of a line; a point is `width` numbers.
struct Line {
  float* first;
  std::size_t stride;  ///< numbers from one point to the next
  int n;               ///< points
  std::size_t width;
  [[nodiscard]] float* at(int i) const { return first + stride * count(i); }
};

/// x[to] += factor (x[a] + x[b])
void add_pair(const Line& line, int to, int a, int b, float factor) {
  float* x = line.at(to);
  const float* left = line.at(a);
  const float* right = line.at(b);
  for (std::size_t i = 0; i < line.width; ++i) {
    x[i] += factor * (left[i] + right[i]);
  }
}

void predict(const Line& line, float factor) {
  for (int i = 1; i < line.n; i += 2) {
    add_pair(line, i, i - 1, i + 1 < line.n ? i + 1 : i - 1, factor);
  }
}

void update(const Line& line, float factor) {
  for (int i = 0; i < line.n; i += 2) {
    add_pair(line, i, i > 0 ? i - 1 : i + 1, i + 1 < line.n ? i + 1 : i - 1, factor);
  }
}

/// (a, b) to ((a + b), (a - b)) / sqrt 2: its own inverse.
void turn(const Line& line) {
  constexpr auto kHalf = static_cast<float>(1.0 / std::numbers::sqrt2);
  for (int i = 0; i + 1 < line.n; i += 2) {
    float* a = line.at(i);
    float* b = line.at(i + 1);
    for (std::size_t k = 0; k < line.width; ++k) {
      const float sum = kHalf * (a[k] + b[k]);
      b[k] = kHalf * (a[k] - b[k]);
      a[k] = sum;
    }
  }
}

void lift_line(const Line& line, Wavelet wavelet, bool is_forward) {
  if (line.n < 2) {
    return;
  }
  if (wavelet == Wavelet::haar) {
    turn(line);
  } else if (is_forward) {
    predict(line, -0.5F);
    update(line, 0.25F);
  } else {
    update(line, -0.25F);
    predict(line, 0.5F);
  }
}

/// norm[level][i]: norm of the line represented by a 1 at point i of that level.
std::vector<std::vector<double>> line_norms(Wavelet wavelet, int n, int n_levels) {
  std::vector<std::vector<double>> norms(count(n_levels), std::vector<double>(count(n), 1.0));
  std::vector<float> x(count(n));
  for (int level = 0; level < n_levels; ++level) {
    for (int i = 0; i < n; i += 1 << level) {
      std::fill(x.begin(), x.end(), 0.0F);
      x[count(i)] = 1.0F;
      for (int j = level; j >= 0; --j) {
        const int stride = 1 << j;
        lift_line({x.data(), count(stride), (n - 1) / stride + 1, 1}, wavelet, false);
      }
      double energy = 0.0;
      for (const float v : x) {
        energy += double{v} * double{v};
      }
      norms[count(level)][count(i)] = std::sqrt(energy);
    }
  }
  return norms;
}

}  // namespace

DyadicTransform::DyadicTransform(Wavelet wavelet, int rows, int cols)
    : wavelet_(wavelet), rows_(rows), cols_(cols) {
  HAARLIGHT_EXPECTS(rows > 0 && cols > 0, "an array");
  while ((std::max(rows, cols) - 1) >> n_levels_ > 0) {
    ++n_levels_;
  }
  const auto over_rows = line_norms(wavelet, rows, n_levels_);
  const auto over_cols = line_norms(wavelet, cols, n_levels_);
  std::vector<std::tuple<int, int>> kind(count(rows) * count(cols));  // (coarse first, which)
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < cols; ++x) {
      // The level that created it: where its row or column is odd; the very last for (0, 0).
      int level = 0;
      while (level + 1 < n_levels_ && ((y >> level) & 1) == 0 && ((x >> level) & 1) == 0) {
        ++level;
      }
      const double norm = n_levels_ == 0 ? 1.0
                                         : over_rows[count(level)][count(y)] *
                                               over_cols[count(level)][count(x)];
      norms_.push_back(wavelet == Wavelet::haar ? 1.0F : static_cast<float>(norm));
      const int which = ((y >> level) & 1) * 2 + ((x >> level) & 1);
      kind[count(y) * count(cols) + count(x)] = {-level, which};
    }
  }
  order_.resize(kind.size());
  std::iota(order_.begin(), order_.end(), 0);
  std::stable_sort(order_.begin(), order_.end(),
                   [&](int a, int b) { return kind[count(a)] < kind[count(b)]; });
}

/// Numbers [first, first + n) of each point.
struct DyadicTransform::Part {
  std::span<float> x;
  std::size_t width;
  std::size_t first;
  std::size_t n;
};

void DyadicTransform::lift(const Part& part, int level, bool is_forward) const {
  const int stride = 1 << level;
  const std::size_t row = count(cols_) * part.width;
  const int n_x = (cols_ - 1) / stride + 1;
  const int n_y = (rows_ - 1) / stride + 1;
  float* x = part.x.data() + part.first;
  const auto along_x = [&] {
    for (int y = 0; y < rows_; y += stride) {
      lift_line({x + count(y) * row, count(stride) * part.width, n_x, part.n}, wavelet_,
                is_forward);
    }
  };
  const auto along_y = [&] {
    for (int at = 0; at < cols_; at += stride) {
      lift_line({x + count(at) * part.width, count(stride) * row, n_y, part.n}, wavelet_,
                is_forward);
    }
  };
  if (is_forward) {
    along_x();
    along_y();
  } else {
    along_y();
    along_x();
  }
}

void DyadicTransform::scale(const Part& part, bool is_forward) const {
  if (wavelet_ == Wavelet::haar) {
    return;  // all 1
  }
  for (std::size_t i = 0; i < norms_.size(); ++i) {
    const float factor = is_forward ? norms_[i] : 1.0F / norms_[i];
    float* point = part.x.data() + i * part.width + part.first;
    for (std::size_t k = 0; k < part.n; ++k) {
      point[k] *= factor;
    }
  }
}

void DyadicTransform::forward(std::span<float> x, std::size_t width, std::size_t first,
                              std::size_t n) const {
  HAARLIGHT_EXPECTS(x.size() == norms_.size() * width && first + n <= width,
                    "numbers of the array");
  const Part part{x, width, first, n};
  for (int level = 0; level < n_levels_; ++level) {
    lift(part, level, true);
  }
  scale(part, true);
}

void DyadicTransform::inverse(std::span<float> x, std::size_t width, std::size_t first,
                              std::size_t n) const {
  HAARLIGHT_EXPECTS(x.size() == norms_.size() * width && first + n <= width,
                    "numbers of the array");
  const Part part{x, width, first, n};
  scale(part, false);
  for (int level = n_levels_ - 1; level >= 0; --level) {
    lift(part, level, false);
  }
}

}  // namespace haarlight::relight
