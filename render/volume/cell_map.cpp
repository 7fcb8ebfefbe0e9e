// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_map.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

CellMap::CellMap(CellType type, std::span<const Vector3d> corners,
                 std::span<const MappedFields> fields)
    : type_(type), n_(corners.size()) {
  HAARLIGHT_EXPECTS(
      type != CellType::tetrahedron && n_ == shape_of(type).n_nodes && fields.size() == n_,
      "a cell that is not linear");
  std::ranges::copy(corners, corners_.begin());
  std::ranges::copy(fields, fields_.begin());
  for (const Vector3d& corner : corners) {
    size_ = std::max(size_, corner.cwiseAbs().maxCoeff());
  }
  find_weights(rst_);
  Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < n_; ++i) {
    jacobian += corners_.at(i) * slopes_.at(i).transpose();
  }
  constexpr double kRounding = 4e-15;
  const double steepness = size_ * jacobian.inverse().cwiseAbs().rowwise().sum().maxCoeff();
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

bool CellMap::has_parallel_sides() const {
  constexpr double kRounding = 1e-15;
  const auto are_alike = [this](std::size_t a, std::size_t b, std::size_t c, std::size_t d) {
    return ((corners_.at(b) - corners_.at(a)) - (corners_.at(d) - corners_.at(c)))
               .cwiseAbs()
               .maxCoeff() <= kRounding * size_;
  };
  switch (type_) {
    case CellType::hexahedron:
      return are_alike(0, 1, 3, 2) && are_alike(0, 1, 4, 5) && are_alike(0, 1, 7, 6) &&
             are_alike(0, 3, 4, 7) && are_alike(0, 3, 5, 6);
    case CellType::wedge:
      return are_alike(0, 3, 1, 4) && are_alike(0, 3, 2, 5);
    default:
      return false;  // a pyramid's coordinates are quotients
  }
}

void CellMap::find_quadratic_weights(const Vector3d& rst) {
  const Eigen::Vector4d b(1.0 - rst.sum(), rst.x(), rst.y(), rst.z());
  std::array<Vector3d, 4> slopes = {Vector3d::Constant(-1.0), Vector3d::UnitX(),
                                    Vector3d::UnitY(), Vector3d::UnitZ()};
  for (std::size_t i = 0; i < slopes.size(); ++i) {
    const double of_corner = b[static_cast<Eigen::Index>(i)];
    weights_.at(i) = of_corner * (2.0 * of_corner - 1.0);
    slopes_.at(i) = (4.0 * of_corner - 1.0) * slopes.at(i);
  }
  for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
    const auto [i, j] = kQuadraticEdges.at(e);
    weights_.at(4 + e) = 4.0 * b[i] * b[j];
    slopes_.at(4 + e) = 4.0 * (b[j] * slopes.at(i) + b[i] * slopes.at(j));
  }
}

void CellMap::find_weights(const Vector3d& rst) {
  if (type_ == CellType::quadratic_tetrahedron) {
    find_quadratic_weights(rst);
    return;
  }
  const double t = rst.z();
  if (type_ == CellType::wedge) {
    const std::array<Vector3d, 3> flat = {Vector3d(1.0 - rst.x() - rst.y(), -1.0, -1.0),
                                          Vector3d(rst.x(), 1.0, 0.0),
                                          Vector3d(rst.y(), 0.0, 1.0)};  // value, d/dr, d/ds
    for (std::size_t i = 0; i < 3; ++i) {
      const Vector3d& f = flat.at(i);
      weights_.at(i) = f[0] * (1.0 - t);
      slopes_.at(i) = {f[1] * (1.0 - t), f[2] * (1.0 - t), -f[0]};
      weights_.at(i + 3) = f[0] * t;
      slopes_.at(i + 3) = {f[1] * t, f[2] * t, f[0]};
    }
    return;
  }
  const double r = rst.x();
  const double s = rst.y();
  const std::array<Vector3d, 4> flat = {
      Vector3d((1.0 - r) * (1.0 - s), s - 1.0, r - 1.0), Vector3d(r * (1.0 - s), 1.0 - s, -r),
      Vector3d(r * s, s, r), Vector3d((1.0 - r) * s, -s, 1.0 - r)};
  for (std::size_t i = 0; i < 4; ++i) {
    const Vector3d& f = flat.at(i);
    weights_.at(i) = f[0] * (1.0 - t);
    slopes_.at(i) = {f[1] * (1.0 - t), f[2] * (1.0 - t), -f[0]};
    if (type_ == CellType::hexahedron) {
      weights_.at(i + 4) = f[0] * t;
      slopes_.at(i + 4) = {f[1] * t, f[2] * t, f[0]};
    }
  }
  if (type_ == CellType::pyramid) {
    weights_[4] = t;
    slopes_[4] = Vector3d::UnitZ();
  }
}

void CellMap::begin_at(const Vector3d& rst) {
  rst_ = rst;
  find_weights(rst_);
  at_.setZero();
  for (std::size_t i = 0; i < n_; ++i) {
    at_ += weights_.at(i) * corners_.at(i);
  }
}

const Vector3d& CellMap::find(const Vector3d& point) {
  const bool is_found =
      type_ == CellType::quadratic_tetrahedron ? go_within(point) : go_to(point);
  n_lost_ += is_found ? 0 : 1;
  return rst_;
}

/// Along the line from the last point, in as many steps as it takes to stay within the tetrahedron: a
/// bent one may have the point at other (r, s, t) beside it.
bool CellMap::go_within(const Vector3d& point) {
  constexpr double kWithin = 1e-6;
  constexpr int kMostSteps = 256;
  const Vector3d from = rst_;
  const auto is_within = [this] {
    return std::min(rst_.minCoeff(), 1.0 - rst_.sum()) >= -kWithin;
  };
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
  if (type_ == CellType::pyramid && rst_.z() > kNearTip) {
    rst_ = {0.5, 0.5, 0.25};  // from the tip no step leads away
  }
  constexpr int kMostSteps = 40;
  constexpr double kRounding = 1e-15;
  constexpr double kLastStep = 1e-8;  // its square is rounding
  constexpr double kLost = 1e-12;
  double off = 0.0;
  for (int step = 0; step < kMostSteps; ++step) {
    find_weights(rst_);
    Vector3d rest = point;
    Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < n_; ++i) {
      rest -= weights_.at(i) * corners_.at(i);
      jacobian += corners_.at(i) * slopes_.at(i).transpose();
    }
    const double before = off;
    off = rest.cwiseAbs().maxCoeff();
    const Vector3d change = jacobian.inverse() * rest;
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
  find_weights(rst);
  MappedFields mean;
  for (std::size_t i = 0; i < n_; ++i) {
    mean.density += weights_.at(i) * fields_.at(i).density;
    mean.colour += weights_.at(i) * fields_.at(i).colour;
    mean.contour += weights_.at(i) * fields_.at(i).contour;
  }
  return mean;
}

Vector3d CellMap::contour_slope(const Vector3d& point) {
  find_weights(find(point));
  Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
  Vector3d slope = Vector3d::Zero();  // by r, s, t
  for (std::size_t i = 0; i < n_; ++i) {
    jacobian += corners_.at(i) * slopes_.at(i).transpose();
    slope += fields_.at(i).contour * slopes_.at(i);
  }
  return jacobian.transpose().inverse() * slope;
}

}  // namespace haarlight::render
