// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/shape_functions.h"

#include <algorithm>
#include <cmath>

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

constexpr std::array<std::array<int, 3>, 8> kCube = {
    {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}}};

/// A function and its slopes by r, s and t.
struct Term {
  double value = 0.0;
  Vector3d slope = Vector3d::Zero();

  friend Term operator*(const Term& a, const Term& b) {
    return {.value = a.value * b.value, .slope = a.value * b.slope + b.value * a.slope};
  }
  friend Term operator*(double factor, const Term& a) {
    return {.value = factor * a.value, .slope = factor * a.slope};
  }
  friend Term operator+(const Term& a, double constant) {
    return {.value = a.value + constant, .slope = a.slope};
  }
  friend Term operator+(const Term& a, const Term& b) {
    return {.value = a.value + b.value, .slope = a.slope + b.slope};
  }
};

class Filler {
 public:
  explicit Filler(ShapeFunctions& shape) : shape_(shape) {}
  void add(const Term& term) {
    shape_.weights.at(n_) = term.value;
    shape_.slopes.at(n_++) = term.slope;
  }

 private:
  ShapeFunctions& shape_;
  std::size_t n_ = 0;
};

std::array<Term, 4> barycentric(const Vector3d& rst) {
  return {Term{.value = 1.0 - rst.sum(), .slope = Vector3d::Constant(-1.0)},
          Term{.value = rst.x(), .slope = Vector3d::UnitX()},
          Term{.value = rst.y(), .slope = Vector3d::UnitY()},
          Term{.value = rst.z(), .slope = Vector3d::UnitZ()}};
}

void fill_tetrahedron(CellType type, const Vector3d& rst, Filler& out) {
  const std::array<Term, 4> b = barycentric(rst);
  for (const Term& x : b) {
    out.add(type == CellType::tetrahedron ? x
            : type == CellType::quadratic_tetrahedron
                ? x * (2.0 * x + -1.0)
                : 0.5 * (x * ((3.0 * x + -1.0) * (3.0 * x + -2.0))));
  }
  if (type == CellType::tetrahedron) {
    return;
  }
  for (const auto& [i, j] : kQuadraticEdges) {
    const Term product = b.at(i) * b.at(j);
    if (type == CellType::quadratic_tetrahedron) {
      out.add(4.0 * product);
    } else {
      out.add(4.5 * (product * (3.0 * b.at(i) + -1.0)));
      out.add(4.5 * (product * (3.0 * b.at(j) + -1.0)));
    }
  }
  if (type == CellType::cubic_tetrahedron) {
    constexpr std::array<std::array<std::size_t, 3>, 4> kFaces = {
        {{0, 1, 3}, {1, 2, 3}, {2, 0, 3}, {0, 2, 1}}};
    for (const auto& [i, j, k] : kFaces) {
      out.add(27.0 * (b.at(i) * (b.at(j) * b.at(k))));
    }
  }
}

/// Functions of one coordinate that are 1 at 0, at 1, or in the middle and 0 at both.
struct Along {
  Term at_0;
  Term at_1;
  Term bubble;  ///< 4 x (1 - x)

  Along(double x, const Vector3d& axis)
      : at_0{.value = 1.0 - x, .slope = -axis},
        at_1{.value = x, .slope = axis},
        bubble(4.0 * (at_0 * at_1)) {}
  [[nodiscard]] const Term& at(int end) const { return end == 0 ? at_0 : at_1; }
  /// By halves: parabolas that are 1 at 0, 1/2 or 1.
  [[nodiscard]] Term parabola(int half) const {
    return half == 1 ? bubble : at(half / 2) + -0.5 * bubble;
  }
};

/// Where a hexahedron's nodes are, in halves.
std::array<int, 3> halves_of(std::size_t node) {
  const CellShape& shape = shape_of(CellType::triquadratic_hexahedron);
  const auto sum_of = [](auto corners) {
    std::array<int, 3> sum{};
    for (const std::uint8_t corner : corners) {
      for (std::size_t i = 0; i < 3; ++i) {
        sum.at(i) += kCube.at(corner).at(i);
      }
    }
    return sum;
  };
  if (node < shape.n_corners) {
    return {2 * kCube.at(node)[0], 2 * kCube.at(node)[1], 2 * kCube.at(node)[2]};
  }
  if (node < shape.n_corners + shape.edges.size()) {
    return sum_of(shape.edges[node - shape.n_corners]);
  }
  if (node == shape.centre) {
    return {1, 1, 1};
  }
  const auto side = std::ranges::find(shape.in_faces, node) - shape.in_faces.begin();
  std::array<int, 3> sum = sum_of(shape.faces[static_cast<std::size_t>(side)]);
  for (int& half : sum) {
    half /= 2;
  }
  return sum;
}

void fill_triquadratic(const std::array<Along, 3>& along, Filler& out) {
  static const auto kHalves = [] {
    std::array<std::array<int, 3>, kMostCellNodes> all{};
    for (std::size_t i = 0; i < all.size(); ++i) {
      all.at(i) = halves_of(i);
    }
    return all;
  }();
  std::array<std::array<Term, 3>, 3> parabolas;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (int half = 0; half < 3; ++half) {
      parabolas.at(axis).at(static_cast<std::size_t>(half)) = along.at(axis).parabola(half);
    }
  }
  for (const std::array<int, 3>& node : kHalves) {
    const auto of = [&](std::size_t axis) -> const Term& {
      return parabolas.at(axis).at(static_cast<std::size_t>(node.at(axis)));
    };
    out.add(of(0) * (of(1) * of(2)));
  }
}

/// Along an edge of a serendipity element: linear across, a parabola along it.
Term on_edge(const std::array<Along, 3>& along, std::size_t a, std::size_t b) {
  Term product{.value = 1.0};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const int end = kCube.at(a).at(axis);
    product = product *
              (end == kCube.at(b).at(axis) ? along.at(axis).at(end) : along.at(axis).bubble);
  }
  return product;
}

/// A corner's: what is linear, without half of each of its three edges'.
Term at_corner(const std::array<Along, 3>& along, std::size_t corner) {
  const std::array<int, 3>& ends = kCube.at(corner);
  const Term& x = along[0].at(ends[0]);
  const Term& y = along[1].at(ends[1]);
  const Term& z = along[2].at(ends[2]);
  return x * (y * z) + -0.5 * (along[0].bubble * (y * z)) + -0.5 * (x * (along[1].bubble * z)) +
         -0.5 * (x * (y * along[2].bubble));
}

void fill_hexahedron(CellType type, const std::array<Along, 3>& along, Filler& out) {
  if (type == CellType::triquadratic_hexahedron) {
    fill_triquadratic(along, out);
    return;
  }
  const bool is_linear = type == CellType::hexahedron;
  for (std::size_t i = 0; i < kCube.size(); ++i) {
    out.add(is_linear ? along[0].at(kCube.at(i)[0]) *
                            (along[1].at(kCube.at(i)[1]) * along[2].at(kCube.at(i)[2]))
                      : at_corner(along, i));
  }
  if (!is_linear) {
    for (const auto& [a, b] : shape_of(type).edges) {
      out.add(on_edge(along, a, b));
    }
  }
}

void fill_wedge(CellType type, const Vector3d& rst, Filler& out) {
  const std::array<Term, 3> flat = {
      Term{.value = 1.0 - rst.x() - rst.y(), .slope = Vector3d(-1.0, -1.0, 0.0)},
      Term{.value = rst.x(), .slope = Vector3d::UnitX()},
      Term{.value = rst.y(), .slope = Vector3d::UnitY()}};
  const Along height(rst.z(), Vector3d::UnitZ());
  const bool is_linear = type == CellType::wedge;
  for (const int end : {0, 1}) {
    for (const Term& b : flat) {
      out.add(is_linear ? b * height.at(end)
                        : b * ((2.0 * b + -1.0) * height.at(end) + -0.5 * height.bubble));
    }
  }
  if (is_linear) {
    return;
  }
  for (const int end : {0, 1}) {
    for (std::size_t i = 0; i < 3; ++i) {
      out.add(4.0 * (flat.at(i) * (flat.at((i + 1) % 3) * height.at(end))));
    }
  }
  for (const Term& b : flat) {
    out.add(b * height.bubble);
  }
}

/// Without the factor 1 - t that all nodes but the tip have.
void fill_pyramid(CellType type, const std::array<Along, 3>& along, bool is_over_height,
                  Filler& out) {
  const Along& height = along[2];
  const auto with_height = [&](const Term& over) {
    const Term whole = over * height.at_0;
    return is_over_height ? Term{.value = whole.value,
                                 .slope = {over.slope.x(), over.slope.y(), whole.slope.z()}}
                          : whole;
  };
  const auto corner = [&](std::size_t i) {
    return along[0].at(kCube.at(i)[0]) * along[1].at(kCube.at(i)[1]);
  };
  if (type == CellType::pyramid) {
    for (std::size_t i = 0; i < 4; ++i) {
      out.add(with_height(corner(i)));
    }
    out.add(height.at_1);
    return;
  }
  // Along an edge of the base, over the height: of a factor of its own across it, so that on the triangle over
  // it the function is that of a quadratic triangle.
  const auto on_base = [&](std::size_t i) {
    const std::array<int, 3>& a = kCube.at(i);
    const std::size_t across = a[0] == kCube.at((i + 1) % 4)[0] ? 0 : 1;
    const Term& y = along.at(across).at(a.at(across));
    return along.at(1 - across).bubble * (y + -1.0 * (height.at_1 * (y * (2.0 * y + -1.0))));
  };
  for (std::size_t i = 0; i < 4; ++i) {  // the height's bubble is 4 t (1 - t)
    out.add(with_height(corner(i) + -0.5 * (on_base(i) + on_base((i + 3) % 4)) +
                        -2.0 * (corner(i) * height.at_1)));
  }
  out.add(height.at_1 * (2.0 * height.at_1 + -1.0));
  for (std::size_t i = 0; i < 4; ++i) {
    out.add(with_height(on_base(i)));
  }
  for (std::size_t i = 0; i < 4; ++i) {
    out.add(with_height(4.0 * (corner(i) * height.at_1)));
  }
}

std::array<Along, 3> all_along(const Vector3d& rst) {
  return {Along(rst.x(), Vector3d::UnitX()), Along(rst.y(), Vector3d::UnitY()),
          Along(rst.z(), Vector3d::UnitZ())};
}

Vector3d corner_of(CellType linear, std::size_t corner) {
  constexpr std::array<std::size_t, 4> kOfTetrahedron = {0, 1, 3, 4};
  constexpr std::array<std::size_t, 6> kOfWedge = {0, 1, 3, 4, 5, 7};
  const std::size_t of_cube = linear == CellType::tetrahedron ? kOfTetrahedron.at(corner)
                              : linear == CellType::wedge     ? kOfWedge.at(corner)
                                                              : corner;
  const std::array<int, 3>& at = kCube.at(of_cube);
  return {static_cast<double>(at[0]), static_cast<double>(at[1]), static_cast<double>(at[2])};
}

}  // namespace

void find_shape(CellType type, const Vector3d& rst, ShapeFunctions& shape) {
  Filler out(shape);
  switch (shape_of(type).linear) {
    case CellType::tetrahedron:
      fill_tetrahedron(type, rst, out);
      return;
    case CellType::wedge:
      fill_wedge(type, rst, out);
      return;
    case CellType::pyramid:
      fill_pyramid(type, all_along(rst), false, out);
      return;
    default:
      fill_hexahedron(type, all_along(rst), out);
  }
}

void find_shape_over_height(CellType type, const Vector3d& rst, ShapeFunctions& shape) {
  Filler out(shape);
  fill_pyramid(type, all_along(rst), true, out);
}

Vector3d coordinates_between(CellType type, const std::array<std::uint8_t, 3>& corners,
                             const std::array<double, 3>& weights) {
  const CellType linear = shape_of(type).linear;
  constexpr std::uint8_t kTip = 4;
  Vector3d sum = Vector3d::Zero();
  double at_tip = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (linear == CellType::pyramid && corners.at(i) == kTip) {
      at_tip = weights.at(i);
    } else {
      sum += weights.at(i) * corner_of(linear, corners.at(i));
    }
  }
  if (at_tip > 0.0) {
    const double rest = 1.0 - at_tip;
    const Vector3d of_base = rest > 0.0 ? Vector3d(sum / rest) : Vector3d(0.5, 0.5, 0.0);
    sum = {of_base.x(), of_base.y(), at_tip};
  }
  return sum;
}

Vector3d coordinates_on_face(CellType type, std::size_t side,
                             const std::array<double, 4>& weights) {
  const std::array<std::uint8_t, 4>& corners = shape_of(type).faces[side];
  if (corners[3] == kNone) {
    return coordinates_between(type, {corners[0], corners[1], corners[2]},
                               {weights[0], weights[1], weights[2]});
  }
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < corners.size(); ++i) {
    sum += weights.at(i) * corner_of(shape_of(type).linear, corners.at(i));
  }
  return sum;
}

double depth_within(CellType type, const Vector3d& rst) {
  switch (shape_of(type).linear) {
    case CellType::tetrahedron:
      return std::min(rst.minCoeff(), 1.0 - rst.sum());
    case CellType::wedge:
      return std::min({rst.minCoeff(), 1.0 - rst.x() - rst.y(), 1.0 - rst.z()});
    case CellType::pyramid: {
      // At the tip r and s count for as much as they move a point.
      const double across = std::min({rst.x(), rst.y(), 1.0 - rst.x(), 1.0 - rst.y()});
      return std::min({rst.z(), 1.0 - rst.z(), across * std::max(0.0, 1.0 - rst.z())});
    }
    default:
      return std::min(rst.minCoeff(), 1.0 - rst.maxCoeff());
  }
}

}  // namespace haarlight::render
