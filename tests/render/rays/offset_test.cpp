// SPDX-License-Identifier: Apache-2.0
/// @file
/// RayCaster::offset_mm(): no ray that starts there meets the surface that it leaves.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"

namespace haarlight::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kFar = std::numeric_limits<double>::infinity();

class Numbers {
 public:
  explicit Numbers(std::uint64_t seed) : seed_(seed) {}
  double unit() { return uniform_unit(hash_key(seed_, ++n_)); }
  double between(double low, double high) { return low + (high - low) * unit(); }
  /// Even in the logarithm.
  double scale(double low, double high) { return low * std::pow(high / low, unit()); }
  Vector3d within(double size) {
    return {between(-size, size), between(-size, size), between(-size, size)};
  }
  Vector3d direction() {
    const double z = between(-1.0, 1.0);
    const double phi = between(0.0, 2.0 * std::numbers::pi);
    const double r = std::sqrt(1.0 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
  }

 private:
  std::uint64_t seed_;
  std::uint64_t n_ = 0;
};

/// Two specks that are the corners of the scene's box, so that its middle is not the surfaces'.
void add_corners(Scene& scene, double size, const Vector3d& middle) {
  const double speck = 1e-3 * size;
  for (const double side : {-1.0, 1.0}) {
    const Vector3d corner = middle + Vector3d::Constant(side * size);
    scene.meshes.push_back({.vertices = {corner, corner - side * speck * Vector3d::UnitX(),
                                         corner - side * speck * Vector3d::UnitY()},
                            .triangles = {{0, 1, 2}}});
  }
}

Vector3d somewhere(Numbers& numbers, double size) {
  return numbers.unit() < 0.5 ? numbers.within(size) : numbers.within(1e-3 * size);
}

/// Triangles of 1e-4 to 1 of the scene's size, no thinner than offset_mm() is a bound for.
Mesh triangles(Numbers& numbers, double size, int n) {
  Mesh mesh;
  while (static_cast<int>(mesh.triangles.size()) < n) {
    const double reach = numbers.scale(1e-4, 0.3) * size;
    const Vector3d centre = somewhere(numbers, 0.6 * size);
    std::array<Vector3d, 3> corners;
    for (Vector3d& corner : corners) {
      corner = centre + numbers.within(reach);
    }
    std::array<double, 3> sides{(corners[1] - corners[0]).norm(),
                                (corners[2] - corners[1]).norm(),
                                (corners[0] - corners[2]).norm()};
    std::ranges::sort(sides);
    if (sides[0] * sides[1] >
        60.0 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).norm()) {
      continue;
    }
    const auto first = static_cast<int>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), corners.begin(), corners.end());
    mesh.triangles.emplace_back(first, first + 1, first + 2);
  }
  return mesh;
}

/// A point on a triangle, its corners and sides too.
Vector3d on_triangle(Numbers& numbers, const Vector3d& a, const Vector3d& b,
                     const Vector3d& c) {
  const double kind = numbers.unit();
  double u = numbers.unit();
  double v = numbers.unit();
  if (u + v > 1.0) {
    u = 1.0 - u;
    v = 1.0 - v;
  }
  if (kind < 0.2) {
    v = 0.0;
  }
  if (kind < 0.1) {
    u = numbers.scale(1e-7, 1.0);
  }
  return a + u * (b - a) + v * (c - a);
}

/// Of all slopes: also such that single precision does not tell from 0.
Vector3d leaving(Numbers& numbers, const Vector3d& normal) {
  const Vector3d along = normal.cross(numbers.direction()).normalized();
  const double cosine = numbers.unit() < 0.5 ? numbers.unit() : numbers.scale(1e-12, 1.0);
  return (std::sqrt(1.0 - cosine * cosine) * along + cosine * normal).normalized();
}

struct Count {
  std::uint64_t n_rays = 0;
  std::uint64_t n_self = 0;  ///< that meet what they leave
};

/// Rays from points of a surface, on both sides of it.
class Leaving {
 public:
  Leaving(const RayCaster& caster, double times) : caster_(&caster), times_(times) {}
  /// @param radius_mm  of a sphere, whose inside meets its other side: 0 of what is flat
  void add(Numbers& numbers, const Vector3d& point, const Vector3d& normal,
           std::uint32_t surface, std::uint32_t triangle, double radius_mm = 0.0) {
    const double offset = times_ * caster_->offset_mm(surface, triangle, point);
    for (const double side : {-1.0, 1.0}) {
      const Vector3d direction = leaving(numbers, side * normal);
      rays_.push_back({.origin = point + side * offset * normal, .direction = direction});
      from_.push_back({.mesh = surface, .triangle = triangle});
      const double height = (radius_mm - offset) * side * normal.dot(direction);
      const double chord = height + std::sqrt(height * height + 2.0 * radius_mm * offset);
      until_.push_back(radius_mm > 0.0 && side < 0.0 ? 0.5 * chord : kFar);
    }
  }
  void count(Count& count) {
    std::vector<RawHit> hits(rays_.size());
    caster_->intersect(rays_, RayOrder::scattered, hits);
    for (std::size_t i = 0; i < rays_.size(); ++i) {
      const bool is_single = i % 4 == 0;
      const RawHit hit = is_single ? caster_->intersect(rays_[i]) : hits[i];
      count.n_self += hit.is_hit() && hit.mesh == from_[i].mesh &&
                              hit.triangle == from_[i].triangle && hit.t < until_[i]
                          ? 1
                          : 0;
      ++count.n_rays;
    }
    rays_.clear();
    from_.clear();
    until_.clear();
  }

 private:
  const RayCaster* caster_;
  double times_;
  std::vector<Ray> rays_;
  std::vector<RawHit> from_;
  std::vector<double> until_;  ///< no nearer hit of the same surface is a true one
};

constexpr int kTriangles = 40;  // of a scene
constexpr int kPoints = 50;     // of each

void leave_triangles(Numbers& numbers, const Mesh& mesh, std::uint32_t surface, Leaving& rays) {
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto corner = [&](int i) -> const Vector3d& {
      return mesh.vertices[static_cast<std::size_t>(mesh.triangles[t][i])];
    };
    const Vector3d normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
    for (int i = 0; i < kPoints; ++i) {
      rays.add(numbers, on_triangle(numbers, corner(0), corner(1), corner(2)), normal, surface,
               static_cast<std::uint32_t>(t));
    }
  }
}

Count of_triangles(double times, int n_scenes) {
  Count count;
  for (int exponent = -6; exponent <= 6; ++exponent) {
    for (int i = 0; i < n_scenes; ++i) {
      Numbers numbers(static_cast<std::uint64_t>(100 * (exponent + 10) + i));
      const double size = std::pow(10.0, exponent);
      Scene scene;
      scene.materials.emplace_back();
      scene.meshes.push_back(triangles(numbers, size, kTriangles));
      add_corners(scene, size, Vector3d::Zero());
      const Vector3d far = numbers.within(i % 2 == 0 ? 0.0 : 1e3 * size);
      for (Mesh& mesh : scene.meshes) {
        for (Vector3d& vertex : mesh.vertices) {
          vertex += far;
        }
      }
      const RayCaster caster(scene);
      Leaving rays(caster, times);
      leave_triangles(numbers, scene.meshes[0], 0, rays);
      rays.count(count);
    }
  }
  return count;
}

Count of_instances(double times, int n_scenes, double most_stretch) {
  Count count;
  for (int exponent = -6; exponent <= 6; exponent += 2) {
    for (int i = 0; i < n_scenes; ++i) {
      Numbers numbers(static_cast<std::uint64_t>(7000 + 100 * (exponent + 10) + i));
      const double size = std::pow(10.0, exponent);
      Scene scene;
      scene.materials.emplace_back();
      const double mesh_size = numbers.scale(1e-3, 1e3);
      scene.meshes.push_back(triangles(numbers, mesh_size, kTriangles));
      for (int k = 0; k < 3; ++k) {
        const auto turned = [&] {
          return Eigen::AngleAxisd(numbers.between(0.0, 3.0), numbers.direction())
              .toRotationMatrix();
        };
        const Vector3d stretches(1.0, numbers.scale(1.0 / most_stretch, 1.0),
                                 numbers.unit() < 0.3 ? -1.0 : 1.0);
        Instance instance;
        instance.world_from_mesh.linear() = numbers.scale(1e-3, 0.3) * size / mesh_size *
                                            turned() * stretches.asDiagonal() * turned();
        instance.world_from_mesh.translation() = somewhere(numbers, 0.6 * size);
        scene.instances.push_back(instance);
      }
      add_corners(scene, size, Vector3d::Zero());
      const RayCaster caster(scene);
      Leaving rays(caster, times);
      leave_triangles(numbers, scene.meshes[0], 0, rays);
      for (std::uint32_t k = 0; k < 3; ++k) {
        leave_triangles(numbers, mesh_of(scene, scene.instances[k]), 3 + k, rays);
      }
      rays.count(count);
    }
  }
  return count;
}

Count of_round(double times, int n_scenes) {
  Count count;
  for (int exponent = -6; exponent <= 6; ++exponent) {
    for (int i = 0; i < n_scenes; ++i) {
      Numbers numbers(static_cast<std::uint64_t>(90000 + 100 * (exponent + 10) + i));
      const double size = std::pow(10.0, exponent);
      Scene scene;
      scene.materials.emplace_back();
      add_corners(scene, size, Vector3d::Zero());
      for (int k = 0; k < kTriangles / 2; ++k) {
        scene.spheres.push_back({.centre = somewhere(numbers, 0.5 * size),
                                 .radius_mm = numbers.scale(1e-4, 0.3) * size});
        scene.disks.push_back({.centre = somewhere(numbers, 0.5 * size),
                               .normal = numbers.direction(),
                               .radius_mm = numbers.scale(1e-4, 0.3) * size});
      }
      const RayCaster caster(scene);
      Leaving rays(caster, times);
      for (std::uint32_t k = 0; k < kTriangles / 2; ++k) {
        for (int p = 0; p < kPoints; ++p) {
          const Sphere& sphere = scene.spheres[k];
          const Vector3d normal = numbers.direction();
          rays.add(numbers, sphere.centre + sphere.radius_mm * normal, normal, 2 + k, 0,
                   sphere.radius_mm);
          const Disk& disk = scene.disks[k];
          const Vector3d along = disk.normal.cross(numbers.direction()).normalized();
          rays.add(numbers, disk.centre + std::sqrt(numbers.unit()) * disk.radius_mm * along,
                   disk.normal, 2 + kTriangles / 2 + k, 0);
        }
      }
      rays.count(count);
    }
  }
  return count;
}

// 64 times nearer some do: the tests above can fail.
constexpr double kTooNear = 1.0 / 64.0;

TEST(RayOffset, NoRayMeetsTheTriangleThatItLeaves) {
  const Count found = of_triangles(1.0, 20);
  EXPECT_GE(found.n_rays, 1'000'000U);
  EXPECT_EQ(found.n_self, 0U);
  const Count nearer = of_triangles(kTooNear, 1);
  EXPECT_GT(nearer.n_self, nearer.n_rays / 100);
}

TEST(RayOffset, NoRayMeetsTheInstanceThatItLeaves) {
  // Turned and scaled; stretched up to four times as well.
  for (const double most_stretch : {1.0, 4.0}) {
    const Count found = of_instances(1.0, 9, most_stretch);
    EXPECT_GE(found.n_rays, 1'000'000U);
    EXPECT_EQ(found.n_self, 0U);
    const Count nearer = of_instances(kTooNear, 1, most_stretch);
    EXPECT_GT(nearer.n_self, nearer.n_rays / 100);
  }
}

TEST(RayOffset, NoRayMeetsTheSphereOrDiskThatItLeaves) {
  const Count found = of_round(1.0, 20);
  EXPECT_GE(found.n_rays, 1'000'000U);
  EXPECT_EQ(found.n_self, 0U);
  const Count nearer = of_round(kTooNear, 1);
  EXPECT_GT(nearer.n_self, nearer.n_rays / 100);
}

TEST(RayOffset, IsWhatAHitSays) {
  Numbers numbers(3);
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(triangles(numbers, 100.0, kTriangles));
  scene.meshes.push_back(make_box({200, 0, 0}, {250, 50, 30}, 0));
  scene.spheres.push_back({.centre = {-200, 0, 0}, .radius_mm = 60.0});
  scene.disks.push_back({.centre = {0, 200, 0}, .radius_mm = 60.0});
  scene.instances.push_back({.mesh = 1});
  scene.instances[0].world_from_mesh.translation() = Vector3d(0, -200, 0);
  const RayCaster caster(scene);
  std::array<int, 5> n_hits{};
  for (int i = 0; i < 8000; ++i) {
    const Vector3d origin = numbers.within(300.0) + Vector3d(0, 0, 500);
    const auto hit = caster.intersect(origin, (numbers.within(250.0) - origin).normalized());
    if (hit) {
      ++n_hits.at(static_cast<std::size_t>(hit->mesh));
      EXPECT_DOUBLE_EQ(hit->offset_mm,
                       caster.offset_mm(static_cast<std::uint32_t>(hit->mesh),
                                        static_cast<std::uint32_t>(hit->triangle), hit->point));
      EXPECT_GT(hit->offset_mm, 0.0);
    }
  }
  EXPECT_GT(*std::ranges::min_element(n_hits), 20);
}

}  // namespace
}  // namespace haarlight::render
