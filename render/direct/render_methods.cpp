// SPDX-License-Identifier: Apache-2.0
#include "render/direct/render_methods.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/parallel.h"
#include "haarlight/render/analytic/plane_irradiance.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/direct/direct_light.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kHeight = 900.0;  // of the lights
constexpr double kEdge = 300.0;    // of the occluder

std::vector<SquareLight> ceiling(int side) {
  std::vector<SquareLight> lights;
  const double pitch = 960.0 / side;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      SquareLight light;
      light.centre = {(col - 0.5 * (side - 1)) * pitch, (row - 0.5 * (side - 1)) * pitch,
                      kHeight};
      light.width_mm = light.height_mm = 0.93 * pitch;
      lights.push_back(light);
    }
  }
  return lights;
}

/// Points of the ground, side x side.
std::vector<Vector3d> ground(int side) {
  std::vector<Vector3d> points;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      points.emplace_back(((col + 0.5) / side - 0.5) * 300.0,
                          ((row + 0.5) / side - 0.5) * 300.0, 0.0);
    }
  }
  return points;
}

/// Results of (points, lights), and how they differ.
class PointsUnderLights {
 public:
  using Result = std::vector<double>;
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_l2(found, truth);
  }
  [[nodiscard]] MethodScale scale() const {
    return {static_cast<int>(lights_.size()), static_cast<long long>(points_.size())};
  }

 protected:
  explicit PointsUnderLights(MethodSize size)
      : lights_(ceiling(by_size(size, 4, 16, 32))), points_(ground(by_size(size, 6, 48, 96))) {}
  /// `work(i, out)` for every point i, whose lights go to `out`.
  template <class Work>
  [[nodiscard]] Result each_point(const Work& work) const {
    Result all(points_.size() * lights_.size());
    parallel_for(points_.size(), 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        work(i, std::span(all).subspan(i * lights_.size(), lights_.size()));
      }
    });
    return all;
  }

  std::vector<SquareLight> lights_;
  std::vector<Vector3d> points_;
};

/// Half of the sky hidden by a plate whose edge runs along y: what a point sees of a light is a
/// rectangle.
class PastAnEdge : public PointsUnderLights {
 public:
  explicit PastAnEdge(MethodSize size)
      : PointsUnderLights(size), scene_(plate()), caster_(scene_) {}

  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<int, 4> kStrata{2, 4, 16, 64};
    DirectLightOptions options;
    options.mixed_grid = kStrata.at(setting);
    const DirectLight direct(caster_, lights_, options);
    return each_point([&](std::size_t i, std::span<double> out) {
      SurfacePoint surface;
      surface.point = points_[i];
      surface.normal = surface.flat_normal = surface.to_eye = Vector3d::UnitZ();
      std::vector<LightContribution> shares(lights_.size());
      (void)direct.evaluate(surface, Material{}, i, shares);
      std::transform(shares.begin(), shares.end(), out.begin(),
                     [](const LightContribution& share) { return share.diffuse; });
    });
  }
  /// The ray from p to l passes the edge where p.x + (l.x - p.x) kEdge/kHeight >= 0.
  [[nodiscard]] Result truth() const {
    return each_point([&](std::size_t i, std::span<double> out) {
      const Vector3d& p = points_[i];
      const double least = p.x() * (1.0 - kHeight / kEdge);
      for (std::size_t k = 0; k < lights_.size(); ++k) {
        std::array<Vector3d, 4> corners = light_corners(lights_[k]);
        for (Vector3d& corner : corners) {
          corner.x() = std::max(corner.x(), least);
        }
        out[k] =
            corners[0].x() < corners[1].x()
                ? polygon_irradiance(corners, p, Vector3d::UnitZ()).value / std::numbers::pi
                : 0.0;
      }
    });
  }

 private:
  static Scene plate() {
    Scene scene;
    scene.materials.emplace_back();
    scene.meshes.push_back(make_quad({-2000, -2000, kEdge}, {0, -2000, kEdge}, {0, 2000, kEdge},
                                     {-2000, 2000, kEdge}, 0));
    return scene;
  }

  const Scene scene_;
  RayCaster caster_;
};

class Unoccluded : public PointsUnderLights {
 public:
  explicit Unoccluded(MethodSize size) : PointsUnderLights(size) {}

  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<double, 4> kTolerances{1e-2, 1e-4, 1e-8, 1e-12};
    const PlaneIrradiance plane(lights_, Vector3d::UnitZ(), 0.0, kTolerances.at(setting));
    return each_point(
        [&](std::size_t i, std::span<double> out) { plane.evaluate(points_[i], out); });
  }
  [[nodiscard]] Result truth() const {
    return each_point([&](std::size_t i, std::span<double> out) {
      for (std::size_t k = 0; k < lights_.size(); ++k) {
        out[k] = light_irradiance(lights_[k], points_[i], Vector3d::UnitZ());
      }
    });
  }
};

}  // namespace

std::vector<Method> render_methods() {
  return {
      Method::of<PastAnEdge>(
          {.module = "render",
           .name = "direct light from area lights past an occluder's edge",
           .settings = {"2 x 2 strata", "4 x 4 strata", "16 x 16 strata", "64 x 64 strata"},
           .error_norm = "relative L2 of every light's irradiance",
           .truth = "closed form: Lambert's formula for the visible part of each light",
           .exact_error = 1e-3,
           .exact_error_from =
               "sampled: the edge crosses 64 of 4096 strata, each hit by chance, "
               "sqrt(64)/2 of 4096"}),
      Method::of<Unoccluded>(
          {.module = "render/analytic",
           .name = "irradiance of a plane from rectangular lights, Gauss points",
           .settings = {"1e-2", "1e-4", "1e-8", "1e-12"},
           .error_norm = "relative L2 of every light's irradiance",
           .truth = "closed form: Lambert's formula, light by light",
           .exact_error = 2e-12,
           .exact_error_from = "its own bound and the closed form's, 1e-12 each"}),
  };
}

}  // namespace haarlight::render
