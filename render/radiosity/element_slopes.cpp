// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/element_slopes.h"

#include <algorithm>

#include <Eigen/LU>

namespace haarlight::render {

namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Slope = Eigen::Matrix<double, 3, 2>;

/// Patches of one triangle, by where they are: upside down or not in cell (i, j).
struct Cell {
  int i = 0;
  int j = 0;
  bool is_upside_down = false;

  [[nodiscard]] bool is_of(int n) const {
    return i >= 0 && j >= 0 && i + j < n - (is_upside_down ? 1 : 0);
  }
  [[nodiscard]] Vector2d middle() const {
    return Vector2d(i, j) + Vector2d::Constant(is_upside_down ? 2.0 / 3.0 : 1.0 / 3.0);
  }
};

/// Per step along the triangle's edges, by least squares.
Slope slope_of(const CutTriangle& triangle, const Cell& own, const Elements& elements,
               const std::vector<Vector3d>& radiosity, std::size_t back) {
  const auto side_of = [&](const Cell& cell) {
    return 2 * Patches::patch_of(triangle, cell.i, cell.j, cell.is_upside_down) + back;
  };
  const Vector3d& mean = radiosity[side_of(own)];
  Matrix2d squares = Matrix2d::Zero();
  Slope products = Slope::Zero();
  for (int dj = -1; dj <= 1; ++dj) {
    for (int di = -1; di <= 1; ++di) {
      for (const bool is_upside_down : {false, true}) {
        const Cell other{.i = own.i + di, .j = own.j + dj, .is_upside_down = is_upside_down};
        if (!other.is_of(triangle.n) || elements.within(side_of(other))) {
          continue;
        }
        const Vector2d step = other.middle() - own.middle();
        squares += step * step.transpose();
        products += (radiosity[side_of(other)] - mean) * step.transpose();
      }
    }
  }
  // A triangle of few patches may have them in one line.
  return squares.determinant() > 1e-6 ? Slope(products * squares.inverse())
                                      : Slope(Slope::Zero());
}

/// Makes what is below 0 at no corner of the patch of it.
void limit(const Vector3d& mean, Slope& slope) {
  for (int colour = 0; colour < 3; ++colour) {
    const double a = slope(colour, 0);
    const double b = slope(colour, 1);
    const double least = std::min({-a - b, 2.0 * a - b, 2.0 * b - a}) / 3.0;
    if (mean[colour] + least < 0.0) {
      slope.row(colour) *= mean[colour] / -least;
    }
  }
}

}  // namespace

ElementSlopes::ElementSlopes(const Patches& patches, const Elements& elements,
                             const std::vector<Vector3d>& radiosity)
    : slopes_(elements.n_sides(), Eigen::Matrix<float, 3, 2>::Zero()), radiosity_(&radiosity) {
  for (const CutTriangle& triangle : patches.triangles()) {
    for (int j = 0; j < triangle.n; ++j) {
      for (int i = 0; i + j < triangle.n; ++i) {
        for (const bool is_upside_down : {false, true}) {
          const Cell cell{.i = i, .j = j, .is_upside_down = is_upside_down};
          if (!cell.is_of(triangle.n)) {
            continue;
          }
          for (const std::size_t back : {0U, 1U}) {
            const std::size_t side =
                2 * Patches::patch_of(triangle, i, j, is_upside_down) + back;
            if (elements.within(side) || !(radiosity[side].maxCoeff() > 0.0)) {
              continue;
            }
            Slope slope = slope_of(triangle, cell, elements, radiosity, back);
            if (is_upside_down) {
              slope = -slope;  // its vertices' weights grow the other way
            }
            limit(radiosity[side], slope);
            slopes_[side] = slope.cast<float>();
          }
        }
      }
    }
  }
}

}  // namespace haarlight::render
