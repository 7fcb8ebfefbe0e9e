// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/shadow_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// What rounding may add to an image, of 1 + its size.
constexpr double kPadding = 1e-9;

/// Rounded up, so that no face is lost by single precision.
float above(double value) {
  return std::nextafter(static_cast<float>(value), std::numeric_limits<float>::infinity());
}

/// Where f0 + (f1 - f0) s <= 0 within [low, high], which it shortens; false: nowhere.
bool cut(double f0, double f1, double& low, double& high) {
  if (f0 > 0.0 && f1 > 0.0) {
    return false;
  }
  if (f0 > 0.0) {
    low = std::max(low, f0 / (f0 - f1));
  } else if (f1 > 0.0) {
    high = std::min(high, f0 / (f0 - f1));
  }
  return low <= high;
}

/// A triangle cut off at kNearestZ.
struct Clipped {
  std::array<Vector3d, 4> corners;
  std::size_t n = 0;
};
Clipped clip_near(const std::array<Vector3d, 3>& triangle) {
  Clipped clipped;
  for (std::size_t i = 0; i < 3; ++i) {
    const Vector3d& a = triangle.at(i);
    const Vector3d& b = triangle.at((i + 1) % 3);
    if (a.z() >= kNearestZ) {
      clipped.corners.at(clipped.n++) = a;
    }
    if ((a.z() >= kNearestZ) != (b.z() >= kNearestZ)) {
      const double s = (kNearestZ - a.z()) / (b.z() - a.z());
      Vector3d point = a + s * (b - a);
      point.z() = kNearestZ;
      clipped.corners.at(clipped.n++) = point;
    }
  }
  return clipped;
}

}  // namespace

int ShadowGrid::Axis::cell(double xi) const {
  const double even = (xi / (1.0 + std::abs(xi)) - first) * scale;
  return static_cast<int>(std::clamp(even, 0.0, static_cast<double>(n - 1)));
}

double ShadowGrid::Axis::border(int cell) const {
  if (cell <= 0) {
    return low;
  }
  if (cell >= n) {
    return high;
  }
  const double even = first + cell / scale;
  return even / (1.0 - std::abs(even));
}

double ShadowGrid::Axis::middle(int cell) const {
  if (scale == 0.0) {
    return 0.5 * (low + high);
  }
  const double even = first + (cell + 0.5) / scale;
  return even / (1.0 - std::abs(even));
}

ShadowGrid::ShadowGrid(std::span<const Vector3d> receivers, int n_cells, double rounding)
    : rounding_(rounding) {
  Eigen::AlignedBox2d box;
  farthest_inverse_z_ = std::numeric_limits<double>::infinity();
  for (const Vector3d& x : receivers) {
    if (x.z() > kNearestZ) {
      box.extend(Vector2d(x.head<2>() / x.z()));
      farthest_inverse_z_ = std::min(farthest_inverse_z_, 1.0 / x.z());
    }
  }
  const auto fit = [n_cells](double low, double high) {
    Axis axis;
    axis.low = low - kPadding * (1.0 + std::abs(low));
    axis.high = high + kPadding * (1.0 + std::abs(high));
    axis.n = n_cells;
    axis.first = axis.low / (1.0 + std::abs(axis.low));
    const double last = axis.high / (1.0 + std::abs(axis.high));
    axis.scale = last > axis.first ? n_cells / (last - axis.first) : 0.0;
    if (axis.scale == 0.0 || !std::isfinite(axis.scale)) {
      axis.n = 1;
      axis.scale = 0.0;
    }
    return axis;
  };
  if (box.isEmpty()) {
    box.extend(Vector2d::Zero().eval());
  }
  columns_ = fit(box.min().x(), box.max().x());
  rows_ = fit(box.min().y(), box.max().y());
  const std::size_t n = index(0, rows_.n);
  begins_.assign(n + 1, 0);
  nearest_.assign(n, 0.0F);
  curved_.assign(n, 0.0F);
}

void ShadowGrid::add_bounding(std::span<const Vector3d> receivers,
                              std::vector<Vector3d>& bounding) {
  constexpr std::size_t kBounds = 5;  // left, right, low, high, far
  const auto measure = [](const Vector3d& x) {
    const Vector2d image = x.head<2>() / x.z();
    return std::array<double, kBounds>{-image.x(), image.x(), -image.y(), image.y(), x.z()};
  };
  std::array<Vector3d, kBounds> kept;
  std::array<double, kBounds> most;
  most.fill(-std::numeric_limits<double>::infinity());
  for (const std::span<const Vector3d> points :
       {std::span<const Vector3d>(bounding), receivers}) {
    for (const Vector3d& x : points) {
      if (!(x.z() > kNearestZ)) {
        continue;
      }
      const std::array<double, kBounds> of_x = measure(x);
      for (std::size_t i = 0; i < kBounds; ++i) {
        if (of_x.at(i) > most.at(i)) {
          most.at(i) = of_x.at(i);
          kept.at(i) = x;
        }
      }
    }
  }
  // One that bounds one side bounds all: the first of them has some number.
  if (most.front() > -std::numeric_limits<double>::infinity()) {
    bounding.assign(kept.begin(), kept.end());
  }
}

bool ShadowGrid::covers(const Vector3d& receiver) const {
  const Vector2d image = receiver.head<2>() / receiver.z();
  return image.x() >= columns_.low && image.x() <= columns_.high && image.y() >= rows_.low &&
         image.y() <= rows_.high && 1.0 / receiver.z() >= farthest_inverse_z_;
}

/// Calls `function(cell)` for all cells that meet the images of an edge's receivers.
template <typename Function>
void ShadowGrid::for_cells_near(const Vector3d& a, const Vector3d& b,
                                const Function& function) const {
  // What is nearer than the light's plane or farther than all receivers hides nothing.
  double from = 0.0;
  double to = 1.0;
  if (!cut(kNearestZ - a.z(), kNearestZ - b.z(), from, to) ||
      !cut(farthest_inverse_z_ * a.z() - 1.0, farthest_inverse_z_ * b.z() - 1.0, from, to)) {
    return;
  }
  const auto disc = [&](double s) {
    Vector3d q = a + s * (b - a);
    q.z() = std::max(q.z(), kNearestZ);
    const Vector2d centre = q.head<2>() / q.z();
    return Disc{.centre = centre,
                .radius = std::max(0.0, 1.0 / q.z() - farthest_inverse_z_) * (1.0 + kPadding) +
                          kPadding * (1.0 + centre.norm())};
  };
  Disc p = disc(from);
  Disc q = disc(to);
  // A rounding moves q's image, seen from x, by |x| + 1 over x_z - q_z at most.
  const double most = 1.0 / std::max(kNearestZ, std::min(a.z() + from * (b.z() - a.z()),
                                                         a.z() + to * (b.z() - a.z())));
  const double beyond =
      rounding_ * most * (1.0 + 2.0 * most + std::max(p.centre.norm(), q.centre.norm()));
  p.radius += beyond;
  q.radius += beyond;
  const double low_y = std::min(p.centre.y() - p.radius, q.centre.y() - q.radius);
  const double high_y = std::max(p.centre.y() + p.radius, q.centre.y() + q.radius);
  const double low_x = std::min(p.centre.x() - p.radius, q.centre.x() - q.radius);
  const double high_x = std::max(p.centre.x() + p.radius, q.centre.x() + q.radius);
  if (high_x < columns_.low || low_x > columns_.high || high_y < rows_.low ||
      low_y > rows_.high) {
    return;
  }
  const int last_row = rows_.cell(high_y + kPadding * (1.0 + std::abs(high_y)));
  for (int row = rows_.cell(low_y - kPadding * (1.0 + std::abs(low_y))); row <= last_row;
       ++row) {
    const double row_low = rows_.border(row);
    const double row_high = rows_.border(row + 1);
    const double slack = kPadding * (1.0 + std::max(std::abs(row_low), std::abs(row_high)));
    double s0 = 0.0;
    double s1 = 1.0;
    if (!cut(p.centre.y() - p.radius - row_high - slack,
             q.centre.y() - q.radius - row_high - slack, s0, s1) ||
        !cut(row_low - slack - p.centre.y() - p.radius,
             row_low - slack - q.centre.y() - q.radius, s0, s1)) {
      continue;
    }
    const auto mix = [](double f0, double f1, double s) { return f0 + s * (f1 - f0); };
    const double left0 = p.centre.x() - p.radius;
    const double left1 = q.centre.x() - q.radius;
    const double right0 = p.centre.x() + p.radius;
    const double right1 = q.centre.x() + q.radius;
    double left = std::min(mix(left0, left1, s0), mix(left0, left1, s1));
    double right = std::max(mix(right0, right1, s0), mix(right0, right1, s1));
    left -= kPadding * (1.0 + std::abs(left));
    right += kPadding * (1.0 + std::abs(right));
    if (right < columns_.low || left > columns_.high) {
      continue;
    }
    const int last = columns_.cell(right);
    for (int column = columns_.cell(left); column <= last; ++column) {
      function(index(column, row));
    }
  }
}

void ShadowGrid::count_edge(const Vector3d& a, const Vector3d& b) {
  for_cells_near(a, b, [this](std::size_t cell) { ++begins_[cell + 1]; });
}

void ShadowGrid::start_lists() {
  std::uint64_t sum = 0;
  for (std::uint32_t& begin : begins_) {
    sum += begin;
    HAARLIGHT_EXPECTS(sum <= std::numeric_limits<std::uint32_t>::max(),
                      "edges in the cells of a shadow grid fit into 32 bits");
    begin = static_cast<std::uint32_t>(sum);
  }
  listed_.assign(sum, 0);
  ends_.assign(begins_.begin(), begins_.end() - 1);
}

void ShadowGrid::list_edge(std::uint32_t number, const Vector3d& a, const Vector3d& b) {
  for_cells_near(a, b, [this, number](std::size_t cell) { listed_[ends_[cell]++] = number; });
}

void ShadowGrid::add_face(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Clipped clipped = clip_near({a, b, c});
  if (clipped.n < 3) {
    return;
  }
  const auto corners = std::span(clipped.corners).first(clipped.n);
  Eigen::AlignedBox2d box;
  double most = 0.0;  // of 1 / z
  for (const Vector3d& corner : corners) {
    box.extend(Vector2d(corner.head<2>() / corner.z()));
    most = std::max(most, 1.0 / corner.z());
  }
  // Of the grid's own numbers and, by 2^-50, of the face's.
  const Vector2d size = box.max().cwiseAbs().cwiseMax(box.min().cwiseAbs());
  const Vector2d grid(std::max(std::abs(columns_.low), std::abs(columns_.high)),
                      std::max(std::abs(rows_.low), std::abs(rows_.high)));
  const Vector2d padding = kPadding * (Vector2d::Ones() + grid) + 0x1p-50 * size;
  const Vector2d low = box.min() - padding;
  const Vector2d high = box.max() + padding;
  if (high.x() < columns_.low || low.x() > columns_.high || high.y() < rows_.low ||
      low.y() > rows_.high || most < farthest_inverse_z_) {
    return;
  }
  // On the plane m.q = d: 1 / z = (m_x xi + m_y eta + m_z) / d.
  const Vector3d m = (b - a).cross(c - a);
  const double d = m.dot(a);
  const int last_row = rows_.cell(high.y());
  for (int row = rows_.cell(low.y()); row <= last_row; ++row) {
    const double row_low = rows_.border(row) - padding.y();
    const double row_high = rows_.border(row + 1) + padding.y();
    double left = std::numeric_limits<double>::infinity();
    double right = -left;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const Vector3d& from = corners[i];
      const Vector3d& to = corners[(i + 1) % corners.size()];
      const Vector2d p = from.head<2>() / from.z();
      const Vector2d q = to.head<2>() / to.z();
      double s0 = 0.0;
      double s1 = 1.0;
      if (cut(p.y() - row_high, q.y() - row_high, s0, s1) &&
          cut(row_low - p.y(), row_low - q.y(), s0, s1)) {
        const double x0 = p.x() + s0 * (q.x() - p.x());
        const double x1 = p.x() + s1 * (q.x() - p.x());
        left = std::min({left, x0, x1});
        right = std::max({right, x0, x1});
      }
    }
    left -= padding.x();
    right += padding.x();
    if (!(left <= right) || right < columns_.low || left > columns_.high) {
      continue;
    }
    const int last = columns_.cell(right);
    for (int column = columns_.cell(left); column <= last; ++column) {
      double inverse = most;
      if (d != 0.0) {
        const double xi =
            m.x() / d > 0.0 ? columns_.border(column + 1) : columns_.border(column);
        const double eta = m.y() / d > 0.0 ? row_high : row_low;
        const double at = (m.x() * xi + m.y() * eta + m.z()) / d;
        inverse = std::isfinite(at) ? std::clamp(at, 0.0, most) : most;
      }
      float& nearest = nearest_[index(column, row)];
      nearest = std::max(nearest, above(inverse));
    }
  }
}

void ShadowGrid::add_curved(const Vector3d& centre, const Vector3d& half) {
  const double nearest = std::max(centre.z() - half.z(), kNearestZ);
  if (centre.z() + half.z() <= kNearestZ || 1.0 / nearest < farthest_inverse_z_) {
    return;
  }
  // The box around it is met where one of its diagonals' receivers, spread by its width, are.
  const double reach = 1.0 / nearest - farthest_inverse_z_;
  const double far_inverse = 1.0 / std::max(centre.z() + half.z(), kNearestZ);
  Eigen::AlignedBox2d box;
  for (const double inverse : {1.0 / nearest, far_inverse}) {
    const Vector2d r = half.head<2>();
    box.extend(Vector2d((centre.head<2>() - r) * inverse));
    box.extend(Vector2d((centre.head<2>() + r) * inverse));
  }
  const Vector2d low = box.min() - Vector2d::Constant(reach * (1.0 + kPadding));
  const Vector2d high = box.max() + Vector2d::Constant(reach * (1.0 + kPadding));
  if (high.x() < columns_.low || low.x() > columns_.high || high.y() < rows_.low ||
      low.y() > rows_.high) {
    return;
  }
  const int last_row = rows_.cell(high.y());
  const int last = columns_.cell(high.x());
  for (int row = rows_.cell(low.y()); row <= last_row; ++row) {
    for (int column = columns_.cell(low.x()); column <= last; ++column) {
      float& curved = curved_[index(column, row)];
      curved = std::max(curved, above(1.0 / nearest));
    }
  }
}

std::size_t ShadowGrid::cell_of(const Vector3d& receiver) const {
  return index(columns_.cell(receiver.x() / receiver.z()),
               rows_.cell(receiver.y() / receiver.z()));
}

ShadowGrid::Cell ShadowGrid::cell(std::size_t number) const {
  return {.edges = std::span(listed_).subspan(begins_[number],
                                              begins_[number + 1] - begins_[number]),
          .nearest_inverse_z = nearest_[number],
          .curved_inverse_z = curved_[number]};
}

Vector3d ShadowGrid::direction(std::size_t cell) const {
  const auto n_columns = static_cast<std::size_t>(columns_.n);
  return Vector3d(columns_.middle(static_cast<int>(cell % n_columns)),
                  rows_.middle(static_cast<int>(cell / n_columns)), 1.0)
      .normalized();
}

double ShadowGrid::side(std::size_t cell) const {
  const auto n_columns = static_cast<std::size_t>(columns_.n);
  const auto side_of = [](const Axis& axis, std::size_t number) {
    const int i = static_cast<int>(number);
    return axis.border(i + 1) - axis.border(i);
  };
  return std::max(side_of(columns_, cell % n_columns), side_of(rows_, cell / n_columns));
}

}  // namespace haarlight::render
