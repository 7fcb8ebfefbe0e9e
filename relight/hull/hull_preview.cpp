// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_preview.h"

#include <algorithm>
#include <array>
#include <limits>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "haarlight/render/picture.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr int kWidth = 480;  // of a view
constexpr int kHeight = 360;
constexpr double kNarrow = 6.0;   // focal length over the view's height: nearly parallel rays
constexpr double kMargin = 1.15;  // the view's height over the object's size
constexpr int kFloor = 0;
constexpr int kFirstColour = 1;

/// The box around a surface.
struct Bounds {
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity());
  Vector3d high = -low;

  [[nodiscard]] Vector3d centre() const { return 0.5 * (low + high); }
  [[nodiscard]] double size() const { return (high - low).norm(); }
};

Bounds bounds_of(const render::SurfaceMesh& surface) {
  Bounds bounds;
  for (const auto& [x, y, z] : surface.vertices) {
    const Vector3d at(double{x}, double{y}, double{z});
    bounds.low = bounds.low.cwiseMin(at);
    bounds.high = bounds.high.cwiseMax(at);
  }
  return bounds;
}

/// The surface on the plane's picture; a mesh and a material per colour of the vertices.
render::Scene scene_of(const render::SurfaceMesh& surface, const PlaneFrame& frame) {
  render::Scene scene;
  scene.materials.push_back({"floor", Vector3d::Constant(0.8), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad(
      frame.world_of(0.0, frame.height), frame.world_of(frame.width, frame.height),
      frame.world_of(frame.width, 0.0), frame.world_of(0.0, 0.0), kFloor));
  render::Mesh all;
  for (std::size_t i = 0; i < surface.vertices.size(); ++i) {
    const auto& [x, y, z] = surface.vertices[i];
    const auto& [nx, ny, nz] = surface.normals[i];
    all.vertices.emplace_back(double{x}, double{y}, double{z});
    all.normals.emplace_back(double{nx}, double{ny}, double{nz});
  }
  std::vector<std::array<std::uint8_t, 3>> colours;
  for (const auto& [a, b, c] : surface.triangles) {
    const auto at = std::find(colours.begin(), colours.end(), surface.colours[a]);
    const auto i = static_cast<std::size_t>(at - colours.begin());
    if (at == colours.end()) {
      colours.push_back(surface.colours[a]);
      Vector3d kd;
      for (std::size_t k = 0; k < 3; ++k) {
        kd[static_cast<Eigen::Index>(k)] = std::pow(surface.colours[a][k] / 255.0, 2.2);
      }
      scene.materials.push_back({"hull", kd, 0.0, 1.0});
      scene.meshes.push_back(all);
      scene.meshes.back().material = kFirstColour + static_cast<int>(i);
    }
    scene.meshes[i + 1].triangles.emplace_back(static_cast<int>(a), static_cast<int>(b),
                                               static_cast<int>(c));
  }
  return scene;
}

/// A square light of irradiance pi at the object, from this direction.
render::SquareLight light_from(const Vector3d& direction, const Bounds& bounds) {
  const double distance = 4.0 * bounds.size();
  const double side = 0.8 * bounds.size();
  render::SquareLight light;
  const Vector3d to = direction.normalized();
  light.centre = bounds.centre() + distance * to;
  light.emits = -to;
  light.u = to.unitOrthogonal();
  light.v = to.cross(light.u);
  light.width_mm = side;
  light.height_mm = side;
  light.radiance = std::numbers::pi * distance * distance / (side * side);
  return light;
}

/// The capture's camera, its whole picture fitted into the view.
CameraModel fitted(CameraModel camera) {
  const double scale = std::min(kWidth / static_cast<double>(camera.width),
                                kHeight / static_cast<double>(camera.height));
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx = scale * camera.cx + 0.5 * (kWidth - scale * camera.width);
  camera.cy = scale * camera.cy + 0.5 * (kHeight - scale * camera.height);
  camera.width = kWidth;
  camera.height = kHeight;
  return camera;
}

CameraModel looking(const Vector3d& from, const Vector3d& up, const Bounds& bounds) {
  CameraModel camera;
  camera.width = kWidth;
  camera.height = kHeight;
  camera.fx = camera.fy = kNarrow * kHeight;
  camera.cx = 0.5 * kWidth;
  camera.cy = 0.5 * kHeight;
  camera.world_from_cam =
      look_at(bounds.centre() + kNarrow * kMargin * bounds.size() * from.normalized(),
              bounds.centre(), up);
  return camera;
}

struct View {
  CameraModel camera;
  Vector3d light;  ///< direction to it
};

}  // namespace

Image<float> hull_preview(const ShadowHull& hull, const render::SurfaceMesh& surface,
                          const CameraModel& camera, const PlaneFrame& frame,
                          ProgressStyle progress) {
  HAARLIGHT_EXPECTS(!surface.triangles.empty(), "a surface");
  const Bounds bounds = bounds_of(surface);
  const auto& [u, v, up] = hull.grid.axes;
  const std::array<View, 4> views{
      View{fitted(camera), up - 0.5 * u - 0.3 * v},
      View{looking(-v + 0.25 * up, up, bounds), up - 0.6 * u - 0.6 * v},
      View{looking(u + 0.25 * up, up, bounds), up - 0.6 * v + 0.6 * u},
      View{looking(up, v, bounds), up - 0.5 * u + 0.5 * v}};
  const render::Scene scene = scene_of(surface, frame);
  const render::RayCaster caster(scene);
  Image<float> picture(2 * kHeight, 2 * kWidth, 3);
  for (std::size_t i = 0; i < views.size(); ++i) {
    // A key light, and a third of it from the other side so that nothing is black.
    const std::array<render::SquareLight, 2> lights{
        light_from(views[i].light, bounds),
        light_from(2.0 * up - views[i].light +
                       0.5 * (views[i].camera.centre_world() - bounds.centre()).normalized(),
                   bounds)};
    const std::array<Vector3d, 2> weights{Vector3d::Constant(0.75), Vector3d::Constant(0.25)};
    render::LitOptions options;
    options.direct.mixed_grid = 5;  // it is looked at, not measured
    options.background = Vector3d::Constant(0.15);
    options.progress = progress;
    const render::LitPicture lit =
        render::render_lit(scene, caster, views[i].camera, lights, weights, options);
    const int y0 = kHeight * static_cast<int>(i / 2);
    const int x0 = kWidth * static_cast<int>(i % 2);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          picture(y0 + y, x0 + x, c) = lit.radiance(y, x, c);
        }
      }
    }
  }
  return picture;
}

}  // namespace haarlight::relight
