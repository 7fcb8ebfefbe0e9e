// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include <gtest/gtest.h>

#include "relight/hull/hull_caster.h"
#include "relight/hull/shadow_hull.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using shadow_scene::blank_picture;
using shadow_scene::ceiling;
using shadow_scene::edge_width;
using shadow_scene::kH;

// A plate without thickness, x 0..80, y -60..60, under the 32 x 32 lights of the cube.
constexpr double kEdge = 150.0;
constexpr double kWide = 80.0;
constexpr double kHalf = 60.0;

/// The fraction of a light's side, in one axis, that an interval of the plate hides from p at
/// height h.
double hidden_share(double p, double h, double from, double to, double centre, double side) {
  const auto at = [&](double edge) { return p + (edge - p) * (kH - h) / (kEdge - h); };
  const double low = std::max(at(from), centre - 0.5 * side);
  const double high = std::min(at(to), centre + 0.5 * side);
  return std::max(0.0, high - low) / side;
}

Visibility shadow_of_plate(const PlaneFrame& frame, const render::SquareLight& light) {
  Visibility v = blank_picture(frame);
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const Vector3d p = frame.world_of(x + 0.5, y + 0.5);
      const double value =
          1.0 - hidden_share(p.x(), 0.0, 0.0, kWide, light.centre.x(), light.width_mm) *
                    hidden_share(p.y(), 0.0, -kHalf, kHalf, light.centre.y(), light.height_mm);
      v.value(y, x) = static_cast<float>(std::clamp(value, 0.0, 1.0));
      v.known(y, x) = 1;
    }
  }
  return v;
}

/// What 1024 pictures leave of the plate around its edge at x = 0.
ShadowHull carved_edge(const std::vector<render::SquareLight>& lights, double texel_mm,
                       double voxel_mm) {
  const PlaneFrame frame = shadow_scene::ground(0.0, texel_mm);
  const std::vector<SamplingPlane> planes{
      {frame,
       [&](int k) { return shadow_of_plate(frame, lights[static_cast<std::size_t>(k)]); },
       {}}};
  ShadowHull hull;
  hull.grid = make_voxel_grid(frame, 1.0, {{-20.0, -4.0, 70.0}, {40.0, 4.0, 220.0}}, voxel_mm);
  const CarveResult found = carve(hull.grid, planes, lights, {});
  for (const std::uint8_t is_empty : found.is_empty) {
    hull.states.push_back(is_empty != 0 ? VoxelState::empty : VoxelState::matter);
  }
  return hull;
}

TEST(HullEdge, AboveThePlaneItIsAsWideAsTheTruth) {
  const std::vector<render::SquareLight> lights = ceiling(32);
  for (const double voxel_mm : {2.0, 4.0}) {
    const ShadowHull hull = carved_edge(lights, 2.0, voxel_mm);
    const HullCaster caster(hull);
    for (const double h : {0.0, 50.0, 100.0}) {
      double least = 10.0;
      double most = 0.0;
      // The middle, and up to the corners: row * 32 + column.
      for (const std::size_t k : {496U, 495U, 340U, 108U, 656U, 828U, 388U, 1U, 1022U}) {
        const render::SquareLight& light = lights[k];
        // Where its middle passes the edge.
        const double middle = -light.centre.x() * (kEdge - h) / (kH - kEdge);
        const double y = -light.centre.y() * (kEdge - h) / (kH - kEdge);
        std::vector<double> found;
        std::vector<double> truth;
        constexpr double kStep = 0.02;
        for (double x = middle - 8.0; x < middle + 8.0; x += kStep) {
          found.push_back(caster.look({x, y, h}, light).value);
          truth.push_back(1.0 -
                          hidden_share(x, h, 0.0, kWide, light.centre.x(), light.width_mm));
        }
        const double ratio = edge_width(found, kStep) / edge_width(truth, kStep);
        least = std::min(least, ratio);
        most = std::max(most, ratio);
      }
      std::printf("| %g | %+.0f | %.2f | %.2f to %.2f |\n", voxel_mm, h,
                  28.0 * (kEdge - h) / (kH - kEdge), least, most);
      if (voxel_mm <= 2.0) {
        EXPECT_GT(least, 0.9) << h;
        EXPECT_LT(most, 1.1) << h;
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
