// SPDX-License-Identifier: Apache-2.0
#include "render/surface/irradiance_gather.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "haarlight/core/error.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

/// dE of a turn of the normal n by the small rotation w is the integral of L (w x n).d over the
/// directions d, and n x n' = w: dE/dturn is the integral of L (n x d) [Ward92]. Over a cell n x d is
/// integrated exactly, as sin^2 theta d theta: rays of density cos/pi would have no bound at the
/// horizon. Columns are the local axes.
Matrix3d turn_of(const HemisphereCells& cells,
                 std::span<const PathIntegrator::Gathered> found) {
  const auto up_to = [&](int high) {
    const double sine = std::sqrt(static_cast<double>(high) / cells.n_high);
    return 0.5 * (std::asin(sine) - sine * std::sqrt(1.0 - sine * sine));
  };
  Matrix3d by_turn = Matrix3d::Zero();
  for (int j = 0; j < cells.n_high; ++j) {
    const double scale = 2.0 * pi / cells.n_around * (up_to(j + 1) - up_to(j));
    for (int k = 0; k < cells.n_around; ++k) {
      const Vector2d middle = at_turns((k + 0.5) / cells.n_around);
      const Vector3d around(-middle.y(), middle.x(), 0.0);  // of z x d
      by_turn += scale * found[cells.number(j, k)].radiance * around.transpose();
    }
  }
  return by_turn;
}

/// dE/dshift: at a border of two cells what is nearer moves against what is behind it, by 1/r of the
/// shift [Ward92], section 2.2. Columns are the local axes. @param least_mm  what is nearer counts as
/// so far: no record reaches less
Matrix3d shift_of(const HemisphereCells& cells, std::span<const PathIntegrator::Gathered> found,
                  double least_mm) {
  Matrix3d by_shift = Matrix3d::Zero();
  const auto at = [&](int high, int around) -> const PathIntegrator::Gathered& {
    return found[cells.number(high, around)];
  };
  const auto inverse_distance = [least_mm](const PathIntegrator::Gathered& a,
                                           const PathIntegrator::Gathered& b) {
    // 0 where both see nothing.
    return 1.0 / std::max(least_mm, std::min(a.distance_mm, b.distance_mm));
  };
  const auto sine_of_border = [&](int high) {
    return std::sqrt(static_cast<double>(high) / cells.n_high);
  };
  for (int k = 0; k < cells.n_around; ++k) {
    const Vector2d middle = at_turns((k + 0.5) / cells.n_around);
    const Vector2d border = at_turns(static_cast<double>(k) / cells.n_around);
    const Vector3d outwards(middle.x(), middle.y(), 0.0);
    const Vector3d onwards(-border.y(), border.x(), 0.0);
    const int before = (k + cells.n_around - 1) % cells.n_around;
    for (int j = 0; j < cells.n_high; ++j) {
      const PathIntegrator::Gathered& cell = at(j, k);
      if (j > 0) {
        const double sine = sine_of_border(j);
        const PathIntegrator::Gathered& inner = at(j - 1, k);
        const double scale = 2.0 * pi / cells.n_around * sine * (1.0 - sine * sine) *
                             inverse_distance(cell, inner);
        by_shift += scale * (cell.radiance - inner.radiance) * outwards.transpose();
      }
      const double width = sine_of_border(j + 1) - sine_of_border(j);
      const PathIntegrator::Gathered& neighbour = at(j, before);
      by_shift += width * inverse_distance(cell, neighbour) *
                  (cell.radiance - neighbour.radiance) * onwards.transpose();
    }
  }
  return by_shift;
}

}  // namespace

HemisphereCells HemisphereCells::of(int n_rays) {
  HAARLIGHT_EXPECTS(n_rays >= 4, "rays over a hemisphere");
  const int n_high = std::max(1, static_cast<int>(std::lround(std::sqrt(n_rays / pi))));
  return {.n_high = n_high, .n_around = n_rays / n_high};
}

Vector3d HemisphereCells::direction(int cell, const Vector2d& square) const {
  const int high = cell / n_around;
  const double sine_squared = (high + square.x()) / n_high;
  const Vector2d around = at_turns((cell % n_around + square.y()) / n_around);
  const double sine = std::sqrt(sine_squared);
  return {sine * around.x(), sine * around.y(), std::sqrt(std::max(0.0, 1.0 - sine_squared))};
}

IrradianceRecord record_of(const Vector3d& point, const Matrix3d& world_from_local,
                           const HemisphereCells& cells,
                           std::span<const PathIntegrator::Gathered> found, double accuracy,
                           const RadiusLimits& limits) {
  HAARLIGHT_EXPECTS(found.size() == static_cast<std::size_t>(cells.size()), "all cells");
  IrradianceRecord record;
  Vector3d radiance = Vector3d::Zero();
  double inverse_distances = 0.0;
  double nearest = std::numeric_limits<double>::infinity();
  for (int cell = 0; cell < cells.size(); ++cell) {
    const PathIntegrator::Gathered& one = found[static_cast<std::size_t>(cell)];
    radiance += one.radiance;
    inverse_distances += 1.0 / one.distance_mm;
    nearest = std::min(nearest, one.distance_mm);
  }
  record.irradiance =
      pi / cells.size() * radiance;  // density cos/pi: E = pi times the mean of L
  const double harmonic_mean =
      inverse_distances > 0.0 ? cells.size() / inverse_distances : limits.most_mm;
  const double radius = accuracy * std::clamp(harmonic_mean, limits.least_mm, limits.most_mm);
  record.reach = {.point = point,
                  .normal = world_from_local.col(2),
                  .radius_mm = std::max(accuracy * limits.least_mm, std::min(radius, nearest))};
  record.by_turn = turn_of(cells, found) * world_from_local.transpose();
  record.by_shift =
      shift_of(cells, found, accuracy * limits.least_mm) * world_from_local.transpose();
  for (int colour = 0; colour < 3; ++colour) {
    // No further than to nothing at the end of its reach: differences of two rays are noise.
    const double change = record.by_shift.row(colour).norm() * record.reach.radius_mm;
    if (change > record.irradiance[colour]) {
      record.by_shift.row(colour) *= record.irradiance[colour] / change;
    }
  }
  return record;
}

}  // namespace haarlight::render
