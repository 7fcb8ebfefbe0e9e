// SPDX-License-Identifier: Apache-2.0
/// @file
/// Coordinates within bent hexahedra, wedges and pyramids: from points back to what they were made of.

#include "render/volume/cell_map.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

double uniform(std::uint64_t what, std::uint64_t i) { return uniform_unit(hash_key(what, i)); }

/// A corner moved by up to 0.15 along each axis.
Vector3d bent(double x, double y, double z, std::uint64_t& number) {
  const auto by = [&number] { return 0.3 * (uniform(1, number++) - 0.5); };
  const double dx = by();
  const double dy = by();
  return {x + dx, y + dy, z + by()};
}

std::vector<Vector3d> bent_cell(CellType type, std::uint64_t& number) {
  std::vector<Vector3d> corners;
  for (const double z : {0.0, 1.0}) {
    if (type == CellType::pyramid && z == 1.0) {
      corners.push_back(bent(0.5, 0.5, 1.0, number));
      break;
    }
    corners.push_back(bent(0.0, 0.0, z, number));
    corners.push_back(bent(1.0, 0.0, z, number));
    if (type != CellType::wedge) {
      corners.push_back(bent(1.0, 1.0, z, number));
    }
    corners.push_back(bent(0.0, 1.0, z, number));
  }
  return corners;
}

/// The point of these coordinates, from side to side of the cell.
Vector3d point_of(CellType type, const std::vector<Vector3d>& corners, const Vector3d& rst) {
  const auto between = [](const Vector3d& a, const Vector3d& b, double s) -> Vector3d {
    return (1.0 - s) * a + s * b;
  };
  const auto side = [&](std::size_t first) -> Vector3d {
    if (type == CellType::wedge) {
      return (1.0 - rst.x() - rst.y()) * corners[first] + rst.x() * corners[first + 1] +
             rst.y() * corners[first + 2];
    }
    return between(between(corners[first], corners[first + 1], rst.x()),
                   between(corners[first + 3], corners[first + 2], rst.x()), rst.y());
  };
  if (type == CellType::pyramid) {
    return between(side(0), corners[4], rst.z());
  }
  return between(side(0), side(type == CellType::wedge ? 3 : 4), rst.z());
}

/// 1e-13: roundings of the points, 1e-16, over a determinant of at least a tenth; r and s of a pyramid
/// are worth 1 - t as much.
TEST(CellMap, FindsTheCoordinatesOfPoints) {
  std::uint64_t number = 0;
  double worst = 0.0;
  for (const CellType type : {CellType::hexahedron, CellType::wedge, CellType::pyramid}) {
    for (int cell = 0; cell < 100; ++cell) {
      const std::vector<Vector3d> corners = bent_cell(type, number);
      const std::vector<MappedFields> fields(corners.size());
      CellMap map(type, corners, fields);
      EXPECT_FALSE(map.is_affine());
      for (int i = 0; i < 20; ++i) {
        Vector3d rst(uniform(2, number), uniform(3, number), uniform(4, number));
        ++number;
        if (type == CellType::wedge && rst.x() + rst.y() > 1.0) {
          rst = {1.0 - rst.x(), 1.0 - rst.y(), rst.z()};
        }
        const double worth = type == CellType::pyramid ? 1.0 - rst.z() : 1.0;
        const Vector3d off = map.find(point_of(type, corners, rst)) - rst;
        worst = std::max(
            {worst, worth * std::max(std::abs(off.x()), std::abs(off.y())), std::abs(off.z())});
      }
      EXPECT_EQ(map.n_lost(), 0U);
    }
  }
  std::printf("largest error %.2g\n", worst);
  EXPECT_LE(worst, 1e-13);
}

}  // namespace
}  // namespace haarlight::render
