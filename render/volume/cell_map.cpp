// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_map.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

CellMap::CellMap(CellType type, std::span<const Vector3d> nodes,
                 std::span<const MappedFields> fields, Shape shape)
    : type_(type),
      place_(shape == Shape::bent ? type : shape_of(type).linear),
      n_(nodes.size()),
      n_placed_(shape_of(place_).n_nodes) {
  HAARLIGHT_EXPECTS(
      type != CellType::tetrahedron && n_ == shape_of(type).n_nodes && fields.size() == n_,
      "a cell that is not linear");
  std::ranges::copy(nodes, nodes_.begin());
  std::ranges::copy(fields, fields_.begin());
  for (const Vector3d& node : nodes.first(n_placed_)) {
    size_ = std::max(size_, node.cwiseAbs().maxCoeff());
  }
  if (place_ == CellType::tetrahedron) {
    rst_.setConstant(0.25);
  }
  find_shape(place_, rst_, of_place_);
  constexpr double kRounding = 4e-15;
  const double steepness = size_ * jacobian().inverse().cwiseAbs().rowwise().sum().maxCoeff();
  const auto noise_of = [&](double MappedFields::*field) {
    const auto [least, most] = std::ranges::minmax(fields, {}, field);
    return kRounding * (std::max(std::abs(least.*field), std::abs(most.*field)) +
                        steepness * (most.*field - least.*field));
  };
  noise_ = {.density = noise_of(&MappedFields::density),
            .colour = noise_of(&MappedFields::colour),
            .contour = noise_of(&MappedFields::contour)};
  is_affine_ = has_parallel_sides();
}

Eigen::Matrix3d CellMap::jacobian() const {
  Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < n_placed_; ++i) {
    jacobian += nodes_.at(i) * of_place_.slopes.at(i).transpose();
  }
  return jacobian;
}

bool CellMap::has_parallel_sides() const {
  constexpr double kRounding = 1e-15;
  const auto are_alike = [this](std::size_t a, std::size_t b, std::size_t c, std::size_t d) {
    return ((nodes_.at(b) - nodes_.at(a)) - (nodes_.at(d) - nodes_.at(c)))
               .cwiseAbs()
               .maxCoeff() <= kRounding * size_;
  };
  switch (place_) {
    case CellType::tetrahedron:
      return true;
    case CellType::hexahedron:
      return are_alike(0, 1, 3, 2) && are_alike(0, 1, 4, 5) && are_alike(0, 1, 7, 6) &&
             are_alike(0, 3, 4, 7) && are_alike(0, 3, 5, 6);
    case CellType::wedge:
      return are_alike(0, 3, 1, 4) && are_alike(0, 3, 2, 5);
    default:
      return false;  // a pyramid's coordinates are quotients
  }
}

void CellMap::begin_at(const Vector3d& rst) {
  rst_ = rst;
  find_shape(place_, rst_, of_place_);
  at_.setZero();
  for (std::size_t i = 0; i < n_placed_; ++i) {
    at_ += of_place_.weights.at(i) * nodes_.at(i);
  }
}

const Vector3d& CellMap::find(const Vector3d& point) {
  const bool is_found = shape_of(place_).may_bend() ? go_within(point) : go_to(point);
  n_lost_ += is_found ? 0 : 1;
  return rst_;
}

/// Along the line from the last point, in as many steps as it takes to stay within the cell: a
/// bent one may have the point at other (r, s, t) beside it.
bool CellMap::go_within(const Vector3d& point) {
  constexpr double kWithin = 1e-6;
  constexpr int kMostSteps = 256;
  const Vector3d from = rst_;
  const auto is_within = [this] { return depth_within(place_, rst_) >= -kWithin; };
  for (int n = 1; n <= kMostSteps; n *= 2) {
    rst_ = from;
    bool is_found = true;
    for (int i = 1; is_found && i <= n; ++i) {
      const double s = static_cast<double>(i) / n;
      is_found = go_to(i == n ? point : (1.0 - s) * at_ + s * point) && is_within();
    }
    if (is_found) {
      at_ = point;
      return true;
    }
  }
  return false;
}

/// By Newton's method. @return  whether to rounding
bool CellMap::go_to(const Vector3d& point) {
  constexpr double kNearTip = 0.9;
  if (place_ == CellType::pyramid && rst_.z() > kNearTip) {
    rst_ = {0.5, 0.5, 0.25};  // from the tip no step leads away
  }
  constexpr int kMostSteps = 40;
  constexpr double kRounding = 1e-15;
  constexpr double kLastStep = 1e-8;  // its square is rounding
  constexpr double kLost = 1e-12;
  double off = 0.0;
  for (int step = 0; step < kMostSteps; ++step) {
    find_shape(place_, rst_, of_place_);
    Vector3d rest = point;
    for (std::size_t i = 0; i < n_placed_; ++i) {
      rest -= of_place_.weights.at(i) * nodes_.at(i);
    }
    const double before = off;
    off = rest.cwiseAbs().maxCoeff();
    const Vector3d change = jacobian().inverse() * rest;
    // At the tip of a pyramid r and s are any: there is nothing to gain by a further step.
    if (!change.allFinite() || (step > 2 && off <= kRounding * size_ && off >= 0.5 * before)) {
      break;
    }
    rst_ = (rst_ + change).cwiseMax(-0.25).cwiseMin(1.25);
    if (change.cwiseAbs().maxCoeff() <= kLastStep) {
      return true;
    }
  }
  return off <= kLost * size_;
}

MappedFields CellMap::fields_of(const Vector3d& rst) {
  find_shape(type_, rst, of_fields_);
  MappedFields mean;
  for (std::size_t i = 0; i < n_; ++i) {
    const double weight = of_fields_.weights.at(i);
    mean.density += weight * fields_.at(i).density;
    mean.colour += weight * fields_.at(i).colour;
    mean.contour += weight * fields_.at(i).contour;
  }
  return mean;
}

Vector3d CellMap::contour_slope(const Vector3d& point) {
  const Vector3d& rst = find(point);
  find_shape(place_, rst, of_place_);
  find_shape(type_, rst, of_fields_);
  Vector3d slope = Vector3d::Zero();  // by r, s, t
  for (std::size_t i = 0; i < n_; ++i) {
    slope += fields_.at(i).contour * of_fields_.slopes.at(i);
  }
  return jacobian().transpose().inverse() * slope;
}

}  // namespace haarlight::render
