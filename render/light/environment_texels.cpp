// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/environment_texels.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kLargestPiece = 0.2;  // rad; keeps every polygon far below a hemisphere
constexpr double kSagitta = 1e-7;      // rad between a chord and its parallel of latitude
constexpr int kMostTabledChords = 12;  // pictures with more have few texels
// acos loses half the digits near 1, and the arcs bulge a little: a margin covers both.
constexpr double kRadiusMargin = 1e-6;

Eigen::Vector3d sphere_direction(double theta, double phi) {
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

/// A chord over the angle a at polar angle t lies a^2/8 sin t cos t closer to the pole: a times
/// this is the number of chords that keep kSagitta.
double chords_per_radian(double theta) {
  const double bend = std::abs(std::sin(theta) * std::cos(theta)) / 8.0;
  return std::sqrt(bend / kSagitta);
}

int arc_chords(double per_radian, double width) {
  return std::max(1, static_cast<int>(std::ceil(width * per_radian)));
}

void finish_texel(EnvironmentTexel& texel) {
  double smallest = 1.0;
  for (const Eigen::Vector3d& corner : texel.corners) {
    smallest = std::min(smallest, texel.centre.dot(corner));
  }
  texel.radius = std::acos(std::clamp(smallest, -1.0, 1.0)) + kRadiusMargin;
}

}  // namespace

EnvironmentTexels::EnvironmentTexels(const Environment& environment, double turn_rad)
    : environment_(environment), angle_(environment.angle_ + turn_rad) {
  if (environment.layout() != EnvironmentLayout::lat_long) {
    most_radius_ = kPi;
    return;
  }
  const int n_cols = environment.row_texels();
  const double height = kPi / environment.n_rows();
  const double width = 2.0 * kPi / n_cols;
  parts_y_ = static_cast<int>(std::ceil(height / kLargestPiece));
  parts_x_ = static_cast<int>(std::ceil(width / kLargestPiece));
  // From the centre along its meridian, then along a parallel; twice the margin for rounding.
  most_radius_ = 0.5 * height / parts_y_ + 0.5 * width / parts_x_ + 2.0 * kRadiusMargin;
  double widest = 0.0;
  for (int i = 0; i < n_cols * parts_x_; ++i) {
    Column column;
    column.from = kPi - width * (double(i) / parts_x_) + angle_;
    column.to = kPi - width * (double(i + 1) / parts_x_) + angle_;
    const double middle = 0.5 * (column.from + column.to);
    column.middle = {std::cos(middle), std::sin(middle)};
    column.col = i / parts_x_;
    widest = std::max(widest, std::abs(column.to - column.from));
    columns_.push_back(column);
  }
  const int most_chords =
      std::min(kMostTabledChords, arc_chords(chords_per_radian(0.25 * kPi), widest));
  for (int n = 1; n <= most_chords; ++n) {
    std::vector<Azimuth>& azimuths = azimuths_.emplace_back();
    for (const Column& column : columns_) {
      for (const auto& [from, to] :
           {std::pair(column.to, column.from), std::pair(column.from, column.to)}) {
        for (int i = 0; i <= n; ++i) {
          const double phi = from + (to - from) * i / n;
          azimuths.push_back({std::cos(phi), std::sin(phi)});
        }
      }
    }
  }
}

const EnvironmentTexels::Azimuth* EnvironmentTexels::tabled(int n_chords, std::size_t column,
                                                            bool is_lower) const {
  const auto n = static_cast<std::size_t>(n_chords);
  return n > azimuths_.size()
             ? nullptr
             : azimuths_[n - 1].data() + (2 * column + (is_lower ? 0 : 1)) * (n + 1);
}

/// The lower edge from right to left, the upper one back.
void EnvironmentTexels::append_arc(DirectionPolygon& corners, double theta, double per_radian,
                                   std::size_t column, bool is_lower) const {
  const double sine = std::sin(theta);
  const double cosine = std::cos(theta);
  if (sine < 1e-12) {
    corners.push_back({0.0, 0.0, theta < 1.0 ? 1.0 : -1.0});
    return;
  }
  const double from = is_lower ? columns_[column].to : columns_[column].from;
  const double to = is_lower ? columns_[column].from : columns_[column].to;
  const int n = arc_chords(per_radian, std::abs(to - from));
  if (const Azimuth* azimuth = tabled(n, column, is_lower)) {
    for (int i = 0; i <= n; ++i, ++azimuth) {
      corners.emplace_back(sine * (*azimuth)[0], sine * (*azimuth)[1], cosine);
    }
    return;
  }
  for (int i = 0; i <= n; ++i) {
    corners.push_back(sphere_direction(theta, from + (to - from) * i / n));
  }
}

void EnvironmentTexels::for_each(int row, const Visit& visit) const {
  for_each(
      row, [](const Eigen::Vector3d& /*centre*/) { return true; }, visit);
}

void EnvironmentTexels::for_each(int row, const IsWanted& is_wanted, const Visit& visit) const {
  HAARLIGHT_EXPECTS(row >= 0 && row < n_rows(), "a row of the environment");
  if (environment_.layout() == EnvironmentLayout::lat_long) {
    for_each_lat_long(row, is_wanted, visit);
  } else {
    for_each_of_face(row, is_wanted, visit);
  }
}

void EnvironmentTexels::for_each_lat_long(int row, const IsWanted& is_wanted,
                                          const Visit& visit) const {
  const double height = kPi / n_rows();
  const double width = 2.0 * kPi / environment_.row_texels();
  EnvironmentTexel texel;
  for (int part_y = 0; part_y < parts_y_; ++part_y) {
    const double theta0 = height * (row + double(part_y) / parts_y_);
    const double theta1 = height * (row + double(part_y + 1) / parts_y_);
    // Omega = dphi (cos t0 - cos t1), written so that thin rows keep their precision.
    const double belt =
        2.0 * std::sin(0.5 * (theta0 + theta1)) * std::sin(0.5 * (theta1 - theta0));
    texel.solid_angle = belt * (width / parts_x_);
    const double middle_sine = std::sin(0.5 * (theta0 + theta1));
    const double middle_cosine = std::cos(0.5 * (theta0 + theta1));
    const double upper = chords_per_radian(theta0);
    const double lower = chords_per_radian(theta1);
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const Azimuth& middle = columns_[i].middle;
      texel.centre = {middle_sine * middle[0], middle_sine * middle[1], middle_cosine};
      texel.radiance = environment_.radiance_at({.row = row, .col = columns_[i].col});
      texel.corners.clear();
      texel.radius = 0.0;
      if (is_wanted(texel.centre)) {
        append_arc(texel.corners, theta1, lower, i, true);
        append_arc(texel.corners, theta0, upper, i, false);
        finish_texel(texel);
      }
      visit(texel);
    }
  }
}

void EnvironmentTexels::for_each_of_face(int row, const IsWanted& is_wanted,
                                         const Visit& visit) const {
  const int n = environment_.row_texels();
  const int face = row / n;
  const int y = row % n;
  const int parts = static_cast<int>(std::ceil(2.0 / (n * kLargestPiece)));
  const double step = 2.0 / (n * parts);
  const Eigen::AngleAxisd turn(angle_, Eigen::Vector3d::UnitZ());
  EnvironmentTexel texel;
  for (int j = y * parts; j < (y + 1) * parts; ++j) {
    for (int i = 0; i < n * parts; ++i) {
      const double s = -1.0 + step * i;
      const double t = -1.0 + step * j;
      // In OpenGL's table s x t points outwards: this order runs counter-clockwise from
      // outside.
      texel.corners = {turn * cube_direction(face, s, t),
                       turn * cube_direction(face, s, t + step),
                       turn * cube_direction(face, s + step, t + step),
                       turn * cube_direction(face, s + step, t)};
      for (Eigen::Vector3d& corner : texel.corners) {
        corner.normalize();
      }
      texel.centre = (turn * cube_direction(face, s + 0.5 * step, t + 0.5 * step)).normalized();
      texel.solid_angle = solid_angle(texel.corners);
      texel.radiance = environment_.radiance_at({.row = row, .col = i / parts});
      if (is_wanted(texel.centre)) {
        finish_texel(texel);
      } else {
        texel.corners.clear();
        texel.radius = 0.0;
      }
      visit(texel);
    }
  }
}

}  // namespace haarlight::render
