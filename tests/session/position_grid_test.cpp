// SPDX-License-Identifier: Apache-2.0
#include "session/import/position_grid.h"

#include <algorithm>
#include <array>
#include <random>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace haarlight::session {
namespace {

/// Row by row, turned in space, each position off by up to `off_mm`.
std::vector<SessionLight> grid_lights(int rows, int cols, double pitch_u, double pitch_v,
                                      double off_mm, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> some(-off_mm, off_mm);
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.3 * seed, Eigen::Vector3d(1.0, 0.4, 2.0).normalized())
          .toRotationMatrix();
  std::vector<SessionLight> lights;
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < cols; ++c) {
      SessionLight light;
      light.is_position = true;
      light.coordinates =
          turn * Eigen::Vector3d(pitch_u * c + some(random), pitch_v * r + some(random),
                                 500.0 + some(random));
      lights.push_back(light);
    }
  }
  return lights;
}

bool is_as_listed(const PositionGrid& grid) {
  return std::is_sorted(grid.order.begin(), grid.order.end());
}

TEST(PositionGrid, IsFoundInAnyPoseAndPitch) {
  const std::vector<std::array<double, 4>> grids = {
      {4, 4, 30, 30}, {17, 30, 30, 30}, {2, 9, 20, 55}, {32, 32, 30, 30}, {3, 2, 70, 40}};
  for (unsigned seed = 0; seed < 20; ++seed) {
    for (const auto& [rows, cols, pitch_u, pitch_v] : grids) {
      const auto lights = grid_lights(static_cast<int>(rows), static_cast<int>(cols), pitch_u,
                                      pitch_v, 0.08 * std::min(pitch_u, pitch_v), seed);
      const auto grid = find_position_grid(lights);
      ASSERT_TRUE(grid.has_value()) << rows << " x " << cols << ", seed " << seed;
      EXPECT_TRUE(is_as_listed(*grid));
      EXPECT_EQ(grid->rows, static_cast<int>(rows));
      EXPECT_EQ(grid->cols, static_cast<int>(cols));
    }
  }
}

TEST(PositionGrid, ListedInAnyOrderIsPutInItsOwn) {
  std::vector<SessionLight> lights = grid_lights(5, 7, 30, 30, 1.0, 0);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].name = std::to_string(k);
  }
  std::mt19937 random(7);
  std::shuffle(lights.begin(), lights.end(), random);
  const auto grid = find_position_grid(lights);
  ASSERT_TRUE(grid.has_value());
  ASSERT_EQ(grid->rows, 5);
  ASSERT_EQ(grid->cols, 7);
  for (int r = 0; r < 5; ++r) {
    for (int c = 0; c < 7; ++c) {
      // Unturned: the first row has the greatest y.
      const int at = grid->order[7 * static_cast<std::size_t>(r) + static_cast<std::size_t>(c)];
      EXPECT_EQ(lights[static_cast<std::size_t>(at)].name, std::to_string((4 - r) * 7 + c));
    }
  }
}

TEST(PositionGrid, IsNotSeenWhereThereIsNone) {
  std::vector<SessionLight> lights = grid_lights(4, 6, 30, 30, 0.0, 1);
  EXPECT_TRUE(find_position_grid(lights).has_value());
  std::vector<SessionLight> moved = lights;
  moved[9].coordinates += 0.4 * (lights[10].coordinates - lights[9].coordinates);
  EXPECT_FALSE(find_position_grid(moved).has_value());
  std::vector<SessionLight> lifted = lights;
  const Eigen::Vector3d along = lights[1].coordinates - lights[0].coordinates;
  const Eigen::Vector3d across = lights[6].coordinates - lights[0].coordinates;
  lifted[9].coordinates += 12.0 * along.cross(across).normalized();
  EXPECT_FALSE(find_position_grid(lifted).has_value());
  std::vector<SessionLight> doubled = lights;
  doubled[3].coordinates = lights[4].coordinates;
  EXPECT_FALSE(find_position_grid(doubled).has_value());
  std::vector<SessionLight> fewer(lights.begin(), lights.end() - 1);
  EXPECT_FALSE(find_position_grid(fewer).has_value());
  std::vector<SessionLight> directions = lights;
  for (SessionLight& light : directions) {
    light.is_position = false;
  }
  EXPECT_FALSE(find_position_grid(directions).has_value());
  std::vector<SessionLight> one_position(16, lights[0]);
  EXPECT_FALSE(find_position_grid(one_position).has_value());
}

TEST(PositionGrid, DomesAndRandomPositionsAreNone) {
  for (unsigned seed = 0; seed < 50; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> some(0.0, 1.0);
    std::vector<SessionLight> lights(static_cast<std::size_t>(6 + seed));
    for (SessionLight& light : lights) {
      light.is_position = true;
      light.coordinates = {some(random), some(random), std::abs(some(random))};
      light.coordinates = 500.0 * light.coordinates.normalized();
    }
    EXPECT_FALSE(find_position_grid(lights).has_value()) << seed;
  }
}

}  // namespace
}  // namespace haarlight::session
