// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/grid_laplacian.h"

#include <algorithm>
#include <cmath>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kRowsATask = 16;
constexpr float kHalf = 0.5F;

/// Sums rows separately, then in order: the same on any number of threads.
template <class RowSum>
double sum_rows(std::size_t height, const RowSum& row_sum) {
  std::vector<double> sums(height);
  parallel_for(height, kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      sums[y] = row_sum(y);
    }
  });
  double total = 0.0;
  for (const double sum : sums) {
    total += sum;
  }
  return total;
}

}  // namespace

GridLaplacian::GridLaplacian(int height, int width, std::vector<float> right,
                             std::vector<float> down) {
  HAARLIGHT_EXPECTS(height > 0 && width > 0 && right.size() == count(height) * count(width) &&
                        down.size() == right.size(),
                    "weights of a picture's edges");
  Level level{height, width, std::move(right), std::move(down), {}};
  for (int y = 0; y < height; ++y) {
    level.right[count(y) * count(width) + count(width - 1)] = 0.0F;
  }
  std::fill_n(level.down.end() - width, width, 0.0F);
  finish(level);
  levels_.push_back(std::move(level));
  while (levels_.back().height > 1 || levels_.back().width > 1) {
    levels_.push_back(coarsen(levels_.back()));
  }
}

void GridLaplacian::finish(Level& level) {
  const std::size_t w = count(level.width);
  level.inverse_diagonal.resize(level.right.size());
  for (std::size_t i = 0; i < level.right.size(); ++i) {
    const float sum = level.right[i] + level.down[i] + (i % w > 0 ? level.right[i - 1] : 0.0F) +
                      (i >= w ? level.down[i - w] : 0.0F);
    level.inverse_diagonal[i] = sum > 0.0F ? 1.0F / sum : 0.0F;
  }
}

GridLaplacian::Level GridLaplacian::coarsen(const Level& fine) {
  Level coarse;
  coarse.height = (fine.height + 1) / 2;
  coarse.width = (fine.width + 1) / 2;
  const std::size_t n = count(coarse.height) * count(coarse.width);
  coarse.right.assign(n, 0.0F);
  coarse.down.assign(n, 0.0F);
  for (int y = 0; y < fine.height; ++y) {
    for (int x = 0; x < fine.width; ++x) {
      const std::size_t from = count(y) * count(fine.width) + count(x);
      const std::size_t to = count(y / 2) * count(coarse.width) + count(x / 2);
      if (x % 2 == 1) {
        coarse.right[to] += kHalf * fine.right[from];
      }
      if (y % 2 == 1) {
        coarse.down[to] += kHalf * fine.down[from];
      }
    }
  }
  finish(coarse);
  return coarse;
}

void GridLaplacian::sweep(const Level& level, std::span<const float> f, std::span<float> z,
                          int colour) {
  const std::size_t w = count(level.width);
  parallel_for(count(level.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      const std::size_t row = y * w;
      for (std::size_t x = (y + count(colour)) % 2; x < w; x += 2) {
        const std::size_t i = row + x;
        float sum = f[i];
        if (x + 1 < w) {
          sum += level.right[i] * z[i + 1];
        }
        if (x > 0) {
          sum += level.right[i - 1] * z[i - 1];
        }
        if (y + 1 < count(level.height)) {
          sum += level.down[i] * z[i + w];
        }
        if (y > 0) {
          sum += level.down[i - w] * z[i - w];
        }
        z[i] = sum * level.inverse_diagonal[i];
      }
    }
  });
}

void GridLaplacian::cycle(std::size_t i_level, Room& room) const {
  const Level& level = levels_[i_level];
  const std::span<const float> f = room.f[i_level];
  const std::span<float> z = room.z[i_level];
  std::fill(z.begin(), z.end(), 0.0F);
  if (i_level + 1 == levels_.size()) {
    return;  // one pixel: no edge
  }
  sweep(level, f, z, 0);
  sweep(level, f, z, 1);
  const Level& coarse = levels_[i_level + 1];
  const std::size_t w = count(level.width);
  const std::size_t cw = count(coarse.width);
  std::vector<float>& below = room.f[i_level + 1];
  parallel_for(count(coarse.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t cy = begin; cy < end; ++cy) {
      std::fill_n(below.begin() + static_cast<std::ptrdiff_t>(cy * cw), cw, 0.0F);
      for (std::size_t y = 2 * cy; y < std::min(2 * cy + 2, count(level.height)); ++y) {
        for (std::size_t x = 0; x < w; ++x) {
          const std::size_t i = y * w + x;
          float left = f[i];
          if (x + 1 < w) {
            left += level.right[i] * (z[i + 1] - z[i]);
          }
          if (x > 0) {
            left += level.right[i - 1] * (z[i - 1] - z[i]);
          }
          if (y + 1 < count(level.height)) {
            left += level.down[i] * (z[i + w] - z[i]);
          }
          if (y > 0) {
            left += level.down[i - w] * (z[i - w] - z[i]);
          }
          below[cy * cw + x / 2] += left;
        }
      }
    }
  });
  cycle(i_level + 1, room);
  const std::vector<float>& rise = room.z[i_level + 1];
  parallel_for(count(level.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      for (std::size_t x = 0; x < w; ++x) {
        z[y * w + x] += rise[y / 2 * cw + x / 2];
      }
    }
  });
  sweep(level, f, z, 1);
  sweep(level, f, z, 0);
}

void GridLaplacian::apply(std::span<const double> z, std::span<double> out) const {
  const Level& level = levels_.front();
  const std::size_t w = count(level.width);
  parallel_for(count(level.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      for (std::size_t x = 0; x < w; ++x) {
        const std::size_t i = y * w + x;
        double sum = 0.0;
        if (x + 1 < w) {
          sum += double{level.right[i]} * (z[i] - z[i + 1]);
        }
        if (x > 0) {
          sum += double{level.right[i - 1]} * (z[i] - z[i - 1]);
        }
        if (y + 1 < count(level.height)) {
          sum += double{level.down[i]} * (z[i] - z[i + w]);
        }
        if (y > 0) {
          sum += double{level.down[i - w]} * (z[i] - z[i - w]);
        }
        out[i] = sum;
      }
    }
  });
}

std::vector<double> GridLaplacian::divergence(std::span<const float> steps_right,
                                              std::span<const float> steps_down) const {
  const Level& level = levels_.front();
  const std::size_t w = count(level.width);
  HAARLIGHT_EXPECTS(
      steps_right.size() == level.right.size() && steps_down.size() == level.right.size(),
      "one step per edge");
  std::vector<double> f(level.right.size());
  parallel_for(count(level.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    const auto flow_right = [&](std::size_t i) {
      return level.right[i] > 0.0F ? double{level.right[i]} * double{steps_right[i]} : 0.0;
    };
    const auto flow_down = [&](std::size_t i) {
      return level.down[i] > 0.0F ? double{level.down[i]} * double{steps_down[i]} : 0.0;
    };
    for (std::size_t y = begin; y < end; ++y) {
      for (std::size_t x = 0; x < w; ++x) {
        const std::size_t i = y * w + x;
        f[i] = (x > 0 ? flow_right(i - 1) : 0.0) - flow_right(i) +
               (y > 0 ? flow_down(i - w) : 0.0) - flow_down(i);
      }
    }
  });
  return f;
}

GridSolve GridLaplacian::solve(std::span<const double> f, std::span<double> z, double tolerance,
                               int max_iterations) const {
  const Level& level = levels_.front();
  const std::size_t n = level.right.size();
  const std::size_t w = count(level.width);
  HAARLIGHT_EXPECTS(f.size() == n && z.size() == n, "one value per pixel");
  Room room;
  for (const Level& l : levels_) {
    room.f.emplace_back(l.right.size());
    room.z.emplace_back(l.right.size());
  }
  // The preconditioner works in float: scaled to 1, so that small residuals stay in its range.
  const auto precondition = [&](std::span<const double> r) {
    double largest = 0.0;
    for (const double value : r) {
      largest = std::max(largest, std::abs(value));
    }
    const double scale = largest > 0.0 ? largest : 1.0;
    for (std::size_t i = 0; i < n; ++i) {
      room.f[0][i] = static_cast<float>(r[i] / scale);
    }
    cycle(0, room);
    return scale;
  };
  const auto dot_scaled = [&](std::span<const double> a, double scale) {
    return scale * sum_rows(count(level.height), [&](std::size_t y) {
             double sum = 0.0;
             for (std::size_t i = y * w; i < (y + 1) * w; ++i) {
               sum += a[i] * double{room.z[0][i]};
             }
             return sum;
           });
  };
  GridSolve summary;
  double scale = precondition(f);
  const double whole = dot_scaled(f, scale);
  if (!(whole > 0.0)) {
    summary.is_converged = true;
    return summary;
  }
  std::vector<double> r(n);
  std::vector<double> p(n);
  std::vector<double> q(n);
  apply(z, q);
  for (std::size_t i = 0; i < n; ++i) {
    r[i] = f[i] - q[i];
  }
  scale = precondition(r);
  double rz = dot_scaled(r, scale);
  for (std::size_t i = 0; i < n; ++i) {
    p[i] = scale * double{room.z[0][i]};
  }
  summary.residual = std::sqrt(std::max(rz, 0.0) / whole);
  while (summary.residual > tolerance && summary.iterations < max_iterations) {
    apply(p, q);
    const double pq = sum_rows(count(level.height), [&](std::size_t y) {
      double sum = 0.0;
      for (std::size_t i = y * w; i < (y + 1) * w; ++i) {
        sum += p[i] * q[i];
      }
      return sum;
    });
    if (!(pq > 0.0)) {
      break;
    }
    const double alpha = rz / pq;
    parallel_for(n, std::size_t{1} << 15U, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        z[i] += alpha * p[i];
        r[i] -= alpha * q[i];
      }
    });
    scale = precondition(r);
    const double next = dot_scaled(r, scale);
    const double beta = next / rz;
    rz = next;
    parallel_for(n, std::size_t{1} << 15U, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        p[i] = scale * double{room.z[0][i]} + beta * p[i];
      }
    });
    ++summary.iterations;
    summary.residual = std::sqrt(std::max(rz, 0.0) / whole);
  }
  summary.is_converged = summary.residual <= tolerance;
  return summary;
}

}  // namespace haarlight::relight
