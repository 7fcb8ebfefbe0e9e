// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/surface/ray_integrator.h"

/// @file
/// What path tracing is measured against: ways to make paths that are as right and dearer, or noisier
/// [Chuang07]. Both ask all lights at each vertex, a point of each.

namespace haarlight::render {

struct PathBaselineOptions {
  RayOptions ray;
  int most_bounces = 64;  ///< a longer path's light is left out: a bias
  int sure_bounces = 4;   ///< before roulette begins
};

/// E[(D|G|S)*]L as path tracing, with a path of its own for each number of bounces: a path tells of its
/// last vertex alone, where path tracing uses all vertices of one. Rays grow with the square of the
/// bounces; estimates of different lengths are independent, and each is as noisy as before.
class NaivePathIntegrator final : public RayIntegrator {
 public:
  NaivePathIntegrator(const Scene& scene, const RayCaster& caster,
                      const Environment* environment, Camera camera,
                      const PathBaselineOptions& options);

 private:
  [[nodiscard]] Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                         std::uint64_t& n_rays) const override;
  [[nodiscard]] Eigen::Vector3d after(int bounces, Ray ray, const SampleNumbers& numbers,
                                      std::uint64_t& n_rays) const;

  PathBaselineOptions options_;
};

/// Points even on all surfaces of a scene.
class SurfacePoints {
 public:
  explicit SurfacePoints(const Scene& scene);

  struct Point {
    std::uint32_t surface = 0;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
  };
  [[nodiscard]] double area_mm2() const noexcept {
    return up_to_.empty() ? 0.0 : up_to_.back();
  }
  /// There must be an area. @param square  in [0, 1)^2
  [[nodiscard]] Point draw(const Eigen::Vector2d& square) const;

 private:
  enum class Shape : std::uint8_t { triangle, sphere, disk };
  struct Piece {
    Shape shape = Shape::triangle;
    std::uint32_t surface = 0;
    Eigen::Vector3d at = Eigen::Vector3d::Zero();  ///< corner or centre
    Eigen::Vector3d u = Eigen::Vector3d::Zero();   ///< edges, or radii
    Eigen::Vector3d v = Eigen::Vector3d::Zero();
    double radius_mm = 0.0;
  };
  void add(const Piece& piece, double area);
  void add_mesh(const Mesh& mesh, std::uint32_t surface);

  std::vector<Piece> pieces_;
  std::vector<double> up_to_;  ///< area of the pieces up to and with each
};

/// E(D|G)*L by vertices that are drawn evenly from all surfaces: each is seen from the one before, or
/// the path ends. Weighted by f cos cos/r^2 over that density, which has no bound where surfaces
/// touch: the variance is infinite then, and no error is stated truly. Ideal mirrors and glass are black:
/// no point is in the only direction.
class AreaPathIntegrator final : public RayIntegrator {
 public:
  AreaPathIntegrator(const Scene& scene, const RayCaster& caster,
                     const Environment* environment, Camera camera,
                     const PathBaselineOptions& options);

 private:
  [[nodiscard]] Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                         std::uint64_t& n_rays) const override;

  SurfacePoints points_;
  int most_bounces_;
};

}  // namespace haarlight::render
