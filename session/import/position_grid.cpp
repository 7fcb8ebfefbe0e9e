// SPDX-License-Identifier: Apache-2.0
#include "session/import/position_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <limits>
#include <numeric>

#include <Eigen/Eigenvalues>

namespace haarlight::session {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kMostLights = 16384;
constexpr double kTolerance = 0.25;  // of the pitch

/// Positions in their own plane, and their distance from it.
struct Flat {
  std::vector<Vector2d> at;
  Vector3d u, v;
  double off_mm = 0.0;  ///< the farthest
};

Flat flatten(std::span<const SessionLight> lights) {
  Vector3d middle = Vector3d::Zero();
  for (const SessionLight& light : lights) {
    middle += light.coordinates / static_cast<double>(lights.size());
  }
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const SessionLight& light : lights) {
    spread += (light.coordinates - middle) * (light.coordinates - middle).transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(spread);
  Flat flat;
  flat.u = eigen.eigenvectors().col(2);
  flat.v = eigen.eigenvectors().col(1);
  for (const SessionLight& light : lights) {
    const Vector3d d = light.coordinates - middle;
    flat.at.emplace_back(flat.u.dot(d), flat.v.dot(d));
    flat.off_mm = std::max(flat.off_mm, std::abs(eigen.eigenvectors().col(0).dot(d)));
  }
  return flat;
}

/// The direction of nearest neighbours, up to quarter turns: their angles times four, averaged.
Vector2d row_direction(const std::vector<Vector2d>& at) {
  std::complex<double> sum = 0.0;
  for (std::size_t i = 0; i < at.size(); ++i) {
    Vector2d nearest = Vector2d::Zero();
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < at.size(); ++j) {
      const double d2 = (at[j] - at[i]).squaredNorm();
      if (j != i && d2 < least) {
        least = d2;
        nearest = at[j] - at[i];
      }
    }
    if (least > 0.0) {
      sum += std::pow(std::complex<double>(nearest.x(), nearest.y()) / std::sqrt(least), 4);
    }
  }
  const double angle = 0.25 * std::arg(sum);
  return {std::cos(angle), std::sin(angle)};
}

/// Numbers divided into `n` groups of equal size: each one's group, and the groups' pitch.
struct Groups {
  std::vector<int> of;
  double pitch = 0.0;  ///< 0: no such groups
};

Groups cut_evenly(const std::vector<double>& values, int n) {
  const auto each = static_cast<std::size_t>(values.size()) / static_cast<std::size_t>(n);
  std::vector<std::size_t> sorted(values.size());
  std::iota(sorted.begin(), sorted.end(), std::size_t{0});
  std::sort(sorted.begin(), sorted.end(),
            [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  Groups groups;
  groups.of.resize(values.size());
  std::vector<double> middle(static_cast<std::size_t>(n), 0.0);
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    groups.of[sorted[i]] = static_cast<int>(i / each);
    middle[i / each] += values[sorted[i]] / static_cast<double>(each);
  }
  const double pitch = (middle.back() - middle.front()) / (n - 1);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const int group = groups.of[i];
    if (!(std::abs(values[i] - (middle.front() + pitch * group)) < kTolerance * pitch)) {
      return groups;
    }
  }
  groups.pitch = pitch;
  return groups;
}

/// Lights by row and column; empty where two fall on one position.
std::vector<int> order_of(const std::vector<int>& row, const std::vector<int>& col,
                          int n_cols) {
  std::vector<int> order(row.size(), -1);
  for (std::size_t i = 0; i < row.size(); ++i) {
    int& at = order[static_cast<std::size_t>(row[i]) * static_cast<std::size_t>(n_cols) +
                    static_cast<std::size_t>(col[i])];
    if (at >= 0) {
      return {};
    }
    at = static_cast<int>(i);
  }
  return order;
}

std::vector<int> reversed(const std::vector<int>& index, int n) {
  std::vector<int> out(index.size());
  std::transform(index.begin(), index.end(), out.begin(), [n](int i) { return n - 1 - i; });
  return out;
}

/// The eight ways to number a grid. @return  as listed if one of them matches; otherwise by the
/// frame
PositionGrid count_grid(const std::vector<int>& along_u, int n_u,
                        const std::vector<int>& along_v, int n_v, Vector3d u, Vector3d v) {
  std::vector<PositionGrid> ways;
  for (const bool is_turned : {false, true}) {
    const auto& [row, n_row] = is_turned ? std::pair(along_u, n_u) : std::pair(along_v, n_v);
    const auto& [col, n_col] = is_turned ? std::pair(along_v, n_v) : std::pair(along_u, n_u);
    for (const bool is_row_back : {false, true}) {
      for (const bool is_col_back : {false, true}) {
        ways.push_back({n_row, n_col,
                        order_of(is_row_back ? reversed(row, n_row) : row,
                                 is_col_back ? reversed(col, n_col) : col, n_col)});
        if (std::is_sorted(ways.back().order.begin(), ways.back().order.end())) {
          return ways.back();
        }
      }
    }
  }
  const bool is_turned = std::abs(u.x()) < std::abs(v.x());  // columns run along v
  const Vector3d& down = is_turned ? u : v;
  const Vector3d& right = is_turned ? v : u;
  const std::size_t way =
      (is_turned ? 4U : 0U) + (down.y() > 0.0 ? 2U : 0U) + (right.x() < 0.0 ? 1U : 0U);
  return ways[way];
}

}  // namespace

std::optional<PositionGrid> find_position_grid(std::span<const SessionLight> lights) {
  if (lights.size() < 4 || lights.size() > kMostLights ||
      !std::all_of(lights.begin(), lights.end(),
                   [](const SessionLight& light) { return light.is_position; })) {
    return std::nullopt;
  }
  const Flat flat = flatten(lights);
  const Vector2d direction = row_direction(flat.at);
  std::vector<double> u;
  std::vector<double> v;
  for (const Vector2d& p : flat.at) {
    u.push_back(direction.dot(p));
    v.push_back(direction.x() * p.y() - direction.y() * p.x());
  }
  const auto n = static_cast<int>(lights.size());
  for (int n_u = 2; 2 * n_u <= n; ++n_u) {
    if (n % n_u != 0) {
      continue;
    }
    Groups along_u = cut_evenly(u, n_u);
    Groups along_v = cut_evenly(v, n / n_u);
    const double pitch = std::min(along_u.pitch, along_v.pitch);
    if (pitch > 0.0 && flat.off_mm < kTolerance * pitch &&
        !order_of(along_v.of, along_u.of, n_u).empty()) {
      return count_grid(along_u.of, n_u, along_v.of, n / n_u,
                        direction.x() * flat.u + direction.y() * flat.v,
                        direction.x() * flat.v - direction.y() * flat.u);
    }
  }
  return std::nullopt;
}

}  // namespace haarlight::session
