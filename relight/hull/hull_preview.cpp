// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_preview.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "haarlight/render/direct/picture.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr int kWidth = 480;  // of a view
constexpr int kHeight = 360;
constexpr double kNarrow = 6.0;   // focal length over the view's height: nearly parallel rays
constexpr double kMargin = 1.15;  // the view's height over the object's size
constexpr double kTurningMargin = 0.95;  // seen from 22 degrees above, which foreshortens it
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

CameraModel looking(const Vector3d& from, const Vector3d& up, const Bounds& bounds,
                    double margin = kMargin) {
  CameraModel camera;
  camera.width = kWidth;
  camera.height = kHeight;
  camera.fx = camera.fy = kNarrow * kHeight;
  camera.cx = 0.5 * kWidth;
  camera.cy = 0.5 * kHeight;
  camera.world_from_cam =
      look_at(bounds.centre() + kNarrow * margin * bounds.size() * from.normalized(),
              bounds.centre(), up);
  return camera;
}

struct View {
  CameraModel camera;
  Vector3d light;  ///< direction to it
};

/// What every view shows.
class Stage {
 public:
  Stage(const render::SurfaceMesh& surface, const PlaneFrame& frame, Vector3d up,
        ProgressStyle progress)
      : bounds_(bounds_of(surface)),
        up_(std::move(up)),
        scene_(scene_of(surface, frame)),
        caster_(scene_),
        progress_(progress) {}

  [[nodiscard]] const Bounds& bounds() const { return bounds_; }

  /// @param y0, x0  of the view's first pixel
  void draw(const View& view, Image<float>& picture, int y0, int x0) const {
    // A key light, and a third of it from the other side so that nothing is black.
    const std::array<render::SquareLight, 2> lights{
        light_from(view.light, bounds_),
        light_from(2.0 * up_ - view.light +
                       0.5 * (view.camera.centre_world() - bounds_.centre()).normalized(),
                   bounds_)};
    const std::array<Vector3d, 2> weights{Vector3d::Constant(0.75), Vector3d::Constant(0.25)};
    render::LitOptions options;
    // It is looked at, not measured: a surface of voxels has more outlines than the few rays that
    // they would save.
    options.direct.sample_all = true;
    options.direct.mixed_grid = 2;
    options.background = Vector3d::Constant(0.15);
    options.progress = progress_;
    const render::LitPicture lit =
        render::render_lit(scene_, caster_, view.camera, lights, weights, options);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          picture(y0 + y, x0 + x, c) = lit.radiance(y, x, c);
        }
      }
    }
  }

 private:
  Bounds bounds_;
  Vector3d up_;
  render::Scene scene_;
  render::RayCaster caster_;
  ProgressStyle progress_;
};

}  // namespace

Image<float> hull_preview(const ShadowHull& hull, const render::SurfaceMesh& surface,
                          const CameraModel& camera, const PlaneFrame& frame,
                          ProgressStyle progress) {
  HAARLIGHT_EXPECTS(!surface.triangles.empty(), "a surface");
  const auto& [u, v, up] = hull.grid.axes;
  const Stage stage(surface, frame, up, progress);
  const std::array<View, 4> views{
      View{fitted(camera), up - 0.5 * u - 0.3 * v},
      View{looking(-v + 0.25 * up, up, stage.bounds()), up - 0.6 * u - 0.6 * v},
      View{looking(u + 0.25 * up, up, stage.bounds()), up - 0.6 * v + 0.6 * u},
      View{looking(up, v, stage.bounds()), up - 0.5 * u + 0.5 * v}};
  Image<float> picture(2 * kHeight, 2 * kWidth, 3);
  for (int i = 0; i < 4; ++i) {
    stage.draw(views.at(static_cast<std::size_t>(i)), picture, kHeight * (i / 2),
               kWidth * (i % 2));
  }
  return picture;
}

Image<float> hull_turning(const ShadowHull& hull, const render::SurfaceMesh& surface,
                          const PlaneFrame& frame, int n_frames, ProgressStyle progress) {
  HAARLIGHT_EXPECTS(!surface.triangles.empty() && n_frames > 0, "a surface, and frames of it");
  const auto& [u, v, up] = hull.grid.axes;
  const Stage stage(surface, frame, up, progress);
  Image<float> picture(n_frames * kHeight, kWidth, 3);
  for (int i = 0; i < n_frames; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / n_frames;
    const Vector3d front = std::sin(angle) * u - std::cos(angle) * v;
    const Vector3d right = std::cos(angle) * u + std::sin(angle) * v;
    stage.draw({looking(front + 0.4 * up, up, stage.bounds(), kTurningMargin),
                up + 0.6 * front - 0.6 * right},
               picture, i * kHeight, 0);
  }
  return picture;
}

}  // namespace haarlight::relight
