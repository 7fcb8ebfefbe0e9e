// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/light/solid_angle.h"

/// @file
/// An environment's texels as polygons on the sphere, for integration over it.

namespace haarlight::render {

/// One texel as used for integration.
struct EnvironmentTexel {
  DirectionPolygon corners;  ///< counter-clockwise from outside; unit directions
  Eigen::Vector3d centre;    ///< unit
  double radius = 0.0;       ///< largest angle from the centre to a corner, radians
  double solid_angle = 0.0;  ///< exact, sr
  Eigen::Vector3d radiance = Eigen::Vector3d::Zero();  ///< grey: three equal values
};

/// Borrows the environment. Const calls are thread-safe: rows are the unit of parallel work.
class EnvironmentTexels {
 public:
  /// @return  whether a texel's corners are needed. @param centre  of the texel, unit
  using IsWanted = std::function<bool(const Eigen::Vector3d& centre)>;
  using Visit = std::function<void(const EnvironmentTexel& texel)>;

  /// @param turn_rad  by which the environment is turned about z besides, as by rotate()
  explicit EnvironmentTexels(const Environment& environment, double turn_rad = 0.0);

  [[nodiscard]] int n_rows() const { return environment_.n_rows(); }
  /// No texel's radius is larger, radians.
  [[nodiscard]] double most_radius() const noexcept { return most_radius_; }

  /// Calls `visit` for every piece of the row's texels: a texel, or, where it is wider than 0.2
  /// rad, parts of it. The polygons' edges along parallels of latitude are chords that deviate
  /// from the parallel by at most 1e-7 rad; neighbours share them, so that there are no gaps.
  void for_each(int row, const Visit& visit) const;
  /// The same; a texel that is not wanted has no corners and radius 0, and costs a tenth.
  void for_each(int row, const IsWanted& is_wanted, const Visit& visit) const;

 private:
  /// Cosine and sine of an azimuth.
  using Azimuth = std::array<double, 2>;
  /// A column's piece of a lat-long picture.
  struct Column {
    double from = 0.0;  ///< azimuth of its left edge, the larger one
    double to = 0.0;
    Azimuth middle{};
    int col = 0;  ///< of the picture
  };

  void for_each_lat_long(int row, const IsWanted& is_wanted, const Visit& visit) const;
  void for_each_of_face(int row, const IsWanted& is_wanted, const Visit& visit) const;
  void append_arc(DirectionPolygon& corners, double theta, double per_radian,
                  std::size_t column, bool is_lower) const;
  [[nodiscard]] const Azimuth* tabled(int n_chords, std::size_t column, bool is_lower) const;

  const Environment& environment_;
  double angle_ = 0.0;  ///< of the environment, turned
  double most_radius_ = 0.0;
  int parts_x_ = 1;  ///< pieces of a lat-long texel
  int parts_y_ = 1;
  std::vector<Column> columns_;                 ///< of a lat-long picture, left to right
  std::vector<std::vector<Azimuth>> azimuths_;  ///< by chords - 1: (columns, 2, chords + 1)
};

}  // namespace haarlight::render
