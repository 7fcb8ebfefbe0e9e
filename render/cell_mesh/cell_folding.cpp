// SPDX-License-Identifier: Apache-2.0
/// @file
/// The Jacobian of cells with nodes beside their corners: its sign anywhere, its integral.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include "render/cell_mesh/cell_mesh.h"
#include "render/cell_mesh/shape_functions.h"

namespace haarlight::render {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Nodes from the first on, which is exact where they are near each other and far from 0.
std::vector<Vector3d> nodes_about_first(const CellMesh& mesh, std::size_t i_cell) {
  std::vector<Vector3d> x;
  for (const std::uint32_t node : mesh.nodes_of(i_cell)) {
    x.emplace_back(mesh.points[node] - mesh.points[mesh.nodes_of(i_cell)[0]]);
  }
  return x;
}

Matrix3d jacobian_of(std::span<const Vector3d> nodes, const ShapeFunctions& shape) {
  Matrix3d jacobian = Matrix3d::Zero();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    jacobian += nodes[i] * shape.slopes.at(i).transpose();
  }
  return jacobian;
}

/// The domain of a cell's coordinates, as far as polynomials on it are concerned: products of simplices.
enum class Domain : std::uint8_t { tetrahedron, wedge, cube };

Domain domain_of(CellType type) {
  switch (shape_of(type).linear) {
    case CellType::tetrahedron:
      return Domain::tetrahedron;
    case CellType::wedge:
      return Domain::wedge;
    default:
      return Domain::cube;  // a pyramid's, too
  }
}

/// Exponents of r, s and t; those of 1 - r - s - t, 1 - r - s, 1 - r ... are what is left of the degree.
using Exponents = std::array<int, 3>;

std::vector<Exponents> exponents_of(Domain domain, int degree) {
  std::vector<Exponents> all;
  for (int i = 0; i <= degree; ++i) {
    for (int j = 0; j <= degree; ++j) {
      for (int k = 0; k <= degree; ++k) {
        const int of_simplex = domain == Domain::tetrahedron ? i + j + k
                               : domain == Domain::wedge     ? i + j
                                                             : 0;
        if (of_simplex <= degree) {
          all.push_back({i, j, k});
        }
      }
    }
  }
  return all;
}

double factorial(int n) { return n < 2 ? 1.0 : n * factorial(n - 1); }

/// The factor of a Bernstein polynomial: in how many orders its factors are multiplied.
double orders_of(Domain domain, int degree, const Exponents& e) {
  const auto [i, j, k] = e;
  const double all = factorial(degree);
  const auto binomial = [&](int n) { return all / (factorial(n) * factorial(degree - n)); };
  switch (domain) {
    case Domain::tetrahedron:
      return all / (factorial(i) * factorial(j) * factorial(k) * factorial(degree - i - j - k));
    case Domain::wedge:
      return all / (factorial(i) * factorial(j) * factorial(degree - i - j)) * binomial(k);
    default:
      return binomial(i) * binomial(j) * binomial(k);
  }
}

double power(double x, int n) { return n == 0 ? 1.0 : x * power(x, n - 1); }

double bernstein(Domain domain, int degree, const Exponents& e, const Vector3d& rst) {
  const auto [i, j, k] = e;
  const double own = power(rst.x(), i) * power(rst.y(), j) * power(rst.z(), k);
  double rest = 1.0;
  switch (domain) {
    case Domain::tetrahedron:
      rest = power(1.0 - rst.sum(), degree - i - j - k);
      break;
    case Domain::wedge:
      rest = power(1.0 - rst.x() - rst.y(), degree - i - j) * power(1.0 - rst.z(), degree - k);
      break;
    default:
      rest = power(1.0 - rst.x(), degree - i) * power(1.0 - rst.y(), degree - j) *
             power(1.0 - rst.z(), degree - k);
  }
  return orders_of(domain, degree, e) * own * rest;
}

/// What does not depend on the cell: points at which its Jacobian's columns are taken, and how Bernstein
/// coefficients follow; which products of these make which coefficient of the determinant.
struct Rule {
  Domain domain = Domain::cube;
  int degree = 0;
  std::vector<Exponents> exponents;
  std::vector<Vector3d> points;  ///< of a part, by its own coordinates
  Eigen::MatrixXd to_bernstein;
  std::vector<double> orders;       ///< of `exponents`
  std::vector<double> orders_of_3;  ///< of sums of three, by place(); 0: there are none

  Rule(Domain the_domain, int the_degree)
      : domain(the_domain), degree(the_degree), exponents(exponents_of(domain, degree)) {
    const auto n = static_cast<Eigen::Index>(exponents.size());
    Eigen::MatrixXd values(n, n);
    for (const Exponents& e : exponents) {
      points.emplace_back(Vector3d(e[0], e[1], e[2]) / degree);
      orders.push_back(orders_of(domain, degree, e));
    }
    for (Eigen::Index row = 0; row < n; ++row) {
      for (Eigen::Index column = 0; column < n; ++column) {
        values(row, column) =
            bernstein(domain, degree, exponents[static_cast<std::size_t>(column)],
                      points[static_cast<std::size_t>(row)]);
      }
    }
    to_bernstein = values.inverse();
    orders_of_3.assign(kPlaces, 0.0);
    for (const Exponents& e : exponents_of(domain, 3 * degree)) {
      orders_of_3[place(e)] = orders_of(domain, 3 * degree, e);
    }
  }

  static constexpr std::size_t kSide = 7;  // exponents up to 6
  static constexpr std::size_t kPlaces = 343;
  static std::size_t place(const Exponents& e) {
    const auto at = [&](std::size_t i) { return static_cast<std::size_t>(e[i]); };
    return (at(0) * kSide + at(1)) * kSide + at(2);
  }
};

const Rule& rule_of(CellType type) {
  // Slopes of quadratic functions of barycentric coordinates are linear; of products they are not.
  static const Rule kQuadraticTetrahedron(Domain::tetrahedron, 1);
  static const Rule kCubicTetrahedron(Domain::tetrahedron, 2);
  static const Rule kWedge(Domain::wedge, 2);
  static const Rule kCube(Domain::cube, 2);
  switch (domain_of(type)) {
    case Domain::tetrahedron:
      return type == CellType::cubic_tetrahedron ? kCubicTetrahedron : kQuadraticTetrahedron;
    case Domain::wedge:
      return kWedge;
    default:
      return kCube;
  }
}

/// A part of a cell: the coordinates of its corners, in the order of those of a linear cell.
using Part = std::vector<Vector3d>;

Part whole(Domain domain) {
  const auto up = [](Part flat) {
    const std::size_t n = flat.size();
    for (std::size_t i = 0; i < n; ++i) {
      flat.emplace_back(flat[i] + Vector3d::UnitZ());
    }
    return flat;
  };
  switch (domain) {
    case Domain::tetrahedron:
      return {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    case Domain::wedge:
      return up({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}});
    default:
      return up({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}});
  }
}

/// In the part's own coordinates: it is the whole, moved linearly.
Vector3d point_of(Domain domain, const Part& part, const Vector3d& own) {
  const std::size_t second = domain == Domain::cube ? 3 : 2;
  const std::size_t third = domain == Domain::tetrahedron ? 3 : part.size() / 2;
  return part[0] + own.x() * (part[1] - part[0]) + own.y() * (part[second] - part[0]) +
         own.z() * (part[third] - part[0]);
}

/// Two halves. By turns across other edges, so that parts keep their shape.
std::array<Part, 2> halves_of(Domain domain, const Part& part, int n_halvings) {
  if (domain == Domain::tetrahedron) {
    const Vector3d middle = 0.5 * (part[0] + part[3]);
    return {Part{part[0], middle, part[1], part[2]}, Part{part[3], middle, part[1], part[2]}};
  }
  const std::size_t half = part.size() / 2;
  const bool is_across_height = n_halvings % 3 == 0;
  Part lower = part;
  Part upper = part;
  if (is_across_height) {
    for (std::size_t i = 0; i < half; ++i) {
      lower[i + half] = upper[i] = 0.5 * (part[i] + part[i + half]);
    }
  } else if (domain == Domain::wedge) {
    for (const std::size_t i : {std::size_t{0}, half}) {
      const Vector3d middle = 0.5 * (part[i] + part[i + 2]);
      lower[i + 1] = upper[i + 1] = middle;
      lower[i + 2] = upper[i + 2] = part[i + 1];
      upper[i] = part[i + 2];
    }
  } else {
    const bool is_across_r = n_halvings % 3 == 1;
    for (const std::size_t i : {std::size_t{0}, half}) {
      const std::size_t to = is_across_r ? i + 1 : i + 3;
      const std::size_t from = is_across_r ? i + 3 : i + 1;  // the other end of the lower side
      lower[to] = upper[i] = 0.5 * (part[i] + part[to]);
      lower[i + 2] = upper[from] = 0.5 * (part[from] + part[i + 2]);
    }
  }
  return {std::move(lower), std::move(upper)};
}

class Folds {
 public:
  Folds(const CellMesh& mesh, std::size_t i_cell)
      : type_(mesh.types[i_cell]),
        nodes_(nodes_about_first(mesh, i_cell)),
        rule_(rule_of(type_)) {}

  [[nodiscard]] Folding find() {
    const Part all = whole(rule_.domain);
    find_columns(all);
    double size = 0.0;
    for (const Eigen::MatrixX3d& column : columns_) {
      size = std::max(size, column.rowwise().norm().maxCoeff());
    }
    // Of the columns' coefficients, sums with factors of up to 27, and of products of three.
    const double of_size = rule_.degree == 1 ? 1e-14 : 4e-14;
    rounding_ = of_size * size * size * size;
    constexpr int kHalvings = 24;
    return of_part(all, kHalvings);
  }

 private:
  /// The Bernstein coefficients of dx/dr, dx/ds and dx/dt on a part; of a pyramid's without its factors
  /// 1 - t, which are positive but at the tip.
  void find_columns(const Part& part) {
    const auto n = static_cast<Eigen::Index>(rule_.points.size());
    for (Eigen::MatrixX3d& column : columns_) {
      column.resize(n, 3);
    }
    ShapeFunctions shape;
    for (Eigen::Index i = 0; i < n; ++i) {
      const Vector3d at =
          point_of(rule_.domain, part, rule_.points[static_cast<std::size_t>(i)]);
      if (type_ == CellType::quadratic_pyramid) {
        find_shape_over_height(type_, at, shape);
      } else {
        find_shape(type_, at, shape);
      }
      const Matrix3d jacobian = jacobian_of(nodes_, shape);
      for (std::size_t k = 0; k < 3; ++k) {
        columns_.at(k).row(i) = jacobian.col(static_cast<Eigen::Index>(k)).transpose();
      }
    }
    for (Eigen::MatrixX3d& column : columns_) {
      column = (rule_.to_bernstein * column).eval();
    }
  }

  /// Products of Bernstein polynomials with the orders of their factors multiplied in are sums of
  /// products over exponents that add up.
  [[nodiscard]] double least_coefficient() {
    cross_.assign(Rule::kPlaces, Vector3d::Zero());
    det_.assign(Rule::kPlaces, 0.0);
    const std::size_t n = rule_.exponents.size();
    const auto row = [&](std::size_t column, std::size_t i) -> Vector3d {
      return rule_.orders[i] *
             columns_.at(column).row(static_cast<Eigen::Index>(i)).transpose();
    };
    const auto sum_of = [](const Exponents& a, const Exponents& b) {
      return Exponents{a[0] + b[0], a[1] + b[1], a[2] + b[2]};
    };
    for (std::size_t i = 0; i < n; ++i) {
      const Vector3d of_s = row(1, i);
      for (std::size_t j = 0; j < n; ++j) {
        cross_[Rule::place(sum_of(rule_.exponents[i], rule_.exponents[j]))] +=
            of_s.cross(row(2, j));
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      const Vector3d of_r = row(0, i);
      for (const Exponents& e : of_two()) {
        det_[Rule::place(sum_of(rule_.exponents[i], e))] += of_r.dot(cross_[Rule::place(e)]);
      }
    }
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t place = 0; place < det_.size(); ++place) {
      if (rule_.orders_of_3[place] > 0.0) {
        least = std::min(least, det_[place] / rule_.orders_of_3[place]);
      }
    }
    return least;
  }

  [[nodiscard]] const std::vector<Exponents>& of_two() {
    if (of_two_.empty()) {
      of_two_ = exponents_of(rule_.domain, 2 * rule_.degree);
    }
    return of_two_;
  }

  [[nodiscard]] Folding of_part(const Part& part, int n_halvings) {
    find_columns(part);
    if (least_coefficient() > rounding_) {
      return Folding::none;
    }
    // At the part's corners the columns are their coefficients.
    for (std::size_t i = 0; i < rule_.points.size(); ++i) {
      const Vector3d& at = rule_.points[i];
      if ((at.array() == at.array().round()).all()) {
        Matrix3d jacobian;
        for (std::size_t k = 0; k < 3; ++k) {
          jacobian.col(static_cast<Eigen::Index>(k)) =
              columns_.at(k).row(static_cast<Eigen::Index>(i)).transpose();
        }
        if (jacobian.determinant() < -rounding_) {
          return Folding::folded;
        }
      }
    }
    if (n_halvings == 0) {
      return Folding::too_near_to_tell;
    }
    const std::array<Part, 2> halves = halves_of(rule_.domain, part, n_halvings);
    const Folding first = of_part(halves[0], n_halvings - 1);
    return first != Folding::none ? first : of_part(halves[1], n_halvings - 1);
  }

  CellType type_;
  std::vector<Vector3d> nodes_;
  const Rule& rule_;
  double rounding_ = 0.0;
  std::array<Eigen::MatrixX3d, 3> columns_;
  std::vector<Vector3d> cross_;
  std::vector<double> det_;
  std::vector<Exponents> of_two_;
};

/// Gauss's rules on [0, 1]: three points are exact for degree 5, five for degree 9.
struct GaussPoint {
  double at = 0.0;
  double weight = 0.0;
};
std::span<const GaussPoint> gauss_points(bool are_five) {
  static const std::array<GaussPoint, 3> kThree = {{{0.5 - 0.5 * std::sqrt(0.6), 5.0 / 18.0},
                                                    {0.5, 8.0 / 18.0},
                                                    {0.5 + 0.5 * std::sqrt(0.6), 5.0 / 18.0}}};
  static const std::array<GaussPoint, 5> kFive = [] {
    const double root = 2.0 * std::sqrt(10.0 / 7.0);
    const double inner = std::sqrt(5.0 - root) / 6.0;
    const double outer = std::sqrt(5.0 + root) / 6.0;
    const double of_inner = (322.0 + 13.0 * std::sqrt(70.0)) / 1800.0;
    const double of_outer = (322.0 - 13.0 * std::sqrt(70.0)) / 1800.0;
    return std::array<GaussPoint, 5>{{{0.5 - outer, of_outer},
                                      {0.5 - inner, of_inner},
                                      {0.5, 64.0 / 225.0},
                                      {0.5 + inner, of_inner},
                                      {0.5 + outer, of_outer}}};
  }();
  return are_five ? std::span<const GaussPoint>(kFive) : std::span<const GaussPoint>(kThree);
}

}  // namespace

Folding folding_of(const CellMesh& mesh, std::size_t i_cell) {
  return Folds(mesh, i_cell).find();
}

/// The Jacobian's determinant is of degree 5 along each coordinate, of a cubic tetrahedron of degree 6
/// in all; simplices are taken as cubes of which a side has shrunk, whose factors add 2 degrees.
double bent_volume(const CellMesh& mesh, std::size_t i_cell) {
  const CellType type = mesh.types[i_cell];
  const std::vector<Vector3d> nodes = nodes_about_first(mesh, i_cell);
  const std::span<const GaussPoint> points = gauss_points(type == CellType::cubic_tetrahedron);
  const Domain domain = domain_of(type);
  double volume = 0.0;
  ShapeFunctions shape;
  for (const GaussPoint& r : points) {
    for (const GaussPoint& s : points) {
      for (const GaussPoint& t : points) {
        double weight = r.weight * s.weight * t.weight;
        Vector3d at(r.at, s.at, t.at);
        if (domain != Domain::cube) {
          at.y() *= 1.0 - r.at;
          weight *= 1.0 - r.at;
        }
        if (domain == Domain::tetrahedron) {
          at.z() *= (1.0 - r.at) * (1.0 - s.at);
          weight *= (1.0 - r.at) * (1.0 - s.at);
        }
        find_shape(type, at, shape);
        volume += weight * jacobian_of(nodes, shape).determinant();
      }
    }
  }
  return volume;
}

}  // namespace haarlight::render
