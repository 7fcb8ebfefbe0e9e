// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <tuple>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "core/random.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/compress.h"

/// @file
/// Light stacks made from closed forms: a sphere over a plane under an n x n array at 900 mm,
/// seen straight from above; penumbrae by 2 x 2 points per light. For the tables of methods and
/// for tests.

namespace haarlight::relight {

struct MadeScene {
  int width = 40;
  int height = 36;
  int grid = 16;  ///< columns
  int channels = 1;
  bool has_sphere = true;
  double noise = 0.0;  ///< fraction of a lit value, uniform
  int rows = 0;        ///< 0: as columns
  [[nodiscard]] int n_rows() const { return rows > 0 ? rows : grid; }
  [[nodiscard]] int n_lights() const { return n_rows() * grid; }
  [[nodiscard]] auto key() const {
    return std::tie(width, height, grid, channels, has_sphere, noise, rows);
  }
  friend bool operator<(const MadeScene& a, const MadeScene& b) { return a.key() < b.key(); }
};

inline bool is_blocked(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                       const Eigen::Vector3d& centre, double radius) {
  const Eigen::Vector3d d = (to - from).normalized();
  const Eigen::Vector3d m = from - centre;
  const double b = m.dot(d);
  const double c = m.squaredNorm() - radius * radius;
  return b < 0.0 && b * b - c > 0.0 && c > 0.0;
}

/// Value of one pixel under one light.
inline double made_value(const MadeScene& scene, int x, int y, int light) {
  const Eigen::Vector3d ball(20.0, -10.0, 80.0);
  const double radius = 50.0;
  const double pitch = 960.0 / scene.grid;
  Eigen::Vector3d point(-200.0 + 400.0 * (x + 0.5) / scene.width,
                        200.0 - 400.0 * (y + 0.5) / scene.height, 0.0);
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double albedo = 0.6 + 0.3 * std::sin(0.05 * point.x()) * std::cos(0.04 * point.y());
  const double planar = (point - ball).head<2>().squaredNorm();
  const bool is_on_ball = scene.has_sphere && planar < radius * radius;
  if (is_on_ball) {
    point.z() = ball.z() + std::sqrt(radius * radius - planar);
    normal = (point - ball).normalized();
    albedo = 0.4;
  }
  const int row = light / scene.grid % scene.n_rows();
  const int col = light % scene.grid;
  double sum = 0.0;
  for (int i = 0; i < 4; ++i) {
    const int right = i % 2;
    const int up = i / 2;
    const Eigen::Vector3d led((col - 0.5 * (scene.grid - 1) + (right - 0.5) / 2.2) * pitch,
                              (row - 0.5 * (scene.n_rows() - 1) + (up - 0.5) / 2.2) * pitch,
                              900.0);
    const Eigen::Vector3d to = led - point;
    const double r2 = to.squaredNorm();
    const double cosine = normal.dot(to);
    if (cosine > 0.0 &&
        !(scene.has_sphere && !is_on_ball && is_blocked(point, led, ball, radius))) {
      sum += cosine * to.z() / (r2 * r2) * 900.0 * 900.0 / 4.0;
    }
  }
  return albedo * sum;
}

inline MemoryStack render_stack(const MadeScene& scene) {
  MemoryStack stack({scene.width, scene.height, scene.channels, scene.n_lights()});
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      for (int k = 0; k < scene.n_lights(); ++k) {
        const double value = made_value(scene, x, y, k);
        for (int c = 0; c < scene.channels; ++c) {
          const double grain =
              scene.noise *
              (uniform_unit(
                   hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x),
                            static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(c))) -
               0.5);
          stack.at(c, y, x, k) = static_cast<float>(value * (1.0 - 0.2 * c) + grain);
        }
      }
    }
  }
  return stack;
}

/// Lights somewhere, for a header that needs them.
inline std::vector<BasisLight> made_lights(int n) {
  std::vector<BasisLight> lights(static_cast<std::size_t>(n));
  for (int k = 0; k < n; ++k) {
    const double angle = 2.4 * k;  // the golden angle: spread over the hemisphere
    const double z = (k + 0.5) / n;
    lights[static_cast<std::size_t>(k)] = {
        "light" + std::to_string(k), false,
        Eigen::Vector3d(std::sqrt(1.0 - z * z) * std::cos(angle),
                        std::sqrt(1.0 - z * z) * std::sin(angle), z),
        1.0};
  }
  return lights;
}

inline CompressSource made_source(const MemoryStack& stack, const HaarGrid& grid,
                                  const StackSource* plate = nullptr) {
  CompressSource source;
  source.stack = &stack;
  source.plate = plate;
  source.plate_origin = plate != nullptr ? PlateOrigin::captured : PlateOrigin::none;
  source.grid = grid;
  source.lights = made_lights(stack.dims().n_lights);
  source.name = "made";
  return source;
}

inline CompressSource made_source(const MemoryStack& stack, int side,
                                  const StackSource* plate = nullptr) {
  return made_source(stack, HaarGrid{side, side}, plate);
}

}  // namespace haarlight::relight
