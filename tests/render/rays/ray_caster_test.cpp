// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/rays/ray_caster.h"

#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <thread>
#include <type_traits>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"

namespace haarlight::render {
namespace {

bool is_blocked(const RayCaster& caster, const Eigen::Vector3d& from,
                const Eigen::Vector3d& to) {
  std::uint8_t blocked = 0;
  caster.are_blocked(from, {&to, 1}, {&blocked, 1});
  return blocked != 0;
}

bool is_blocked(const RayCaster& caster, const Ray& ray) {
  std::uint8_t blocked = 0;
  caster.are_blocked({&ray, 1}, RayOrder::scattered, {&blocked, 1});
  return blocked != 0;
}

using Eigen::Vector3d;

double uniform(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(77, a, b)); }

Vector3d random_vector(std::uint64_t a, std::uint64_t b, double size) {
  return size * Vector3d(uniform(a, 3 * b) - 0.5, uniform(a, 3 * b + 1) - 0.5,
                         uniform(a, 3 * b + 2) - 0.5);
}

/// Moeller and Trumbore's test in double; `clear_of_edges` is the least distance of the hit
/// from the triangle's border in barycentric units.
struct Exact {
  bool is_hit = false;
  double t = 0.0;
  double clear_of_edges = 0.0;
};
Exact moeller_trumbore(const Vector3d& o, const Vector3d& d, const Vector3d& a,
                       const Vector3d& b, const Vector3d& c) {
  const Vector3d e1 = b - a;
  const Vector3d e2 = c - a;
  const Vector3d p = d.cross(e2);
  const double det = e1.dot(p);
  Exact result;
  if (std::abs(det) < 1e-12) {
    return result;
  }
  const Vector3d s = o - a;
  const double u = s.dot(p) / det;
  const Vector3d q = s.cross(e1);
  const double v = d.dot(q) / det;
  result.t = e2.dot(q) / det;
  result.clear_of_edges = std::min({u, v, 1.0 - u - v});
  result.is_hit = result.clear_of_edges >= 0.0 && result.t > 0.0;
  return result;
}

Scene triangle_soup(int n) {
  Scene scene;
  scene.materials.emplace_back();
  Mesh mesh;
  for (int i = 0; i < n; ++i) {
    const Vector3d centre = random_vector(1, static_cast<std::uint64_t>(i), 200.0);
    for (int c = 0; c < 3; ++c) {
      mesh.vertices.emplace_back(
          (centre +
           random_vector(2, 3 * static_cast<std::uint64_t>(i) + static_cast<std::uint64_t>(c),
                         40.0))
              .cast<float>()
              .cast<double>());
    }
    mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  scene.meshes.push_back(mesh);
  return scene;
}

TEST(RayCaster, AgreesWithMoellerTrumboreInDouble) {
  const Scene scene = triangle_soup(300);
  const RayCaster caster(scene);
  const Mesh& mesh = scene.meshes[0];
  int n_hits = 0;
  int n_near_edges = 0;
  for (std::uint64_t r = 0; r < 4000; ++r) {
    const Vector3d origin = random_vector(3, r, 400.0).cast<float>().cast<double>();
    const Vector3d direction = random_vector(4, r, 1.0).normalized();
    Exact best;
    int best_triangle = -1;
    double nearest_border = 1.0;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      const Exact e = moeller_trumbore(origin, direction, mesh.vertices[3 * i],
                                       mesh.vertices[3 * i + 1], mesh.vertices[3 * i + 2]);
      if (e.t > 0.0) {
        nearest_border = std::min(nearest_border, std::abs(e.clear_of_edges));
      }
      if (e.is_hit && (best_triangle < 0 || e.t < best.t)) {
        best = e;
        best_triangle = static_cast<int>(i);
      }
    }
    if (nearest_border < 1e-3) {  // single precision may decide either way
      ++n_near_edges;
      continue;
    }
    const std::optional<Hit> hit = caster.intersect(origin, direction);
    ASSERT_EQ(hit.has_value(), best_triangle >= 0) << "ray " << r;
    if (hit) {
      ++n_hits;
      EXPECT_EQ(hit->triangle, best_triangle) << "ray " << r;
      // The distance is recomputed in double on the triangle's plane.
      EXPECT_NEAR(hit->distance_mm, best.t, 1e-6 * best.t + 1e-6) << "ray " << r;
      EXPECT_LE(hit->flat_normal.dot(direction), 0.0);
      // Occlusion agrees with the nearest hit on both sides of it.
      EXPECT_FALSE(is_blocked(caster, origin, origin + (best.t - 0.1) * direction));
      EXPECT_TRUE(is_blocked(caster, origin, origin + (best.t + 0.2) * direction));
    }
  }
  EXPECT_GT(n_hits, 300);
  EXPECT_LT(n_near_edges, 1200);
}

TEST(RayCaster, PacketsAnswerLikeSingleRays) {
  const Scene scene = triangle_soup(300);
  const RayCaster caster(scene);
  std::vector<Vector3d> targets;
  for (std::uint64_t i = 0; i < 1003; ++i) {  // no multiple of the packet
    targets.push_back(random_vector(5, i, 400.0));
  }
  std::vector<std::uint8_t> blocked(targets.size(), 9);
  const Vector3d from(10.0, -20.0, 30.0);
  caster.are_blocked(from, targets, blocked);
  int n_blocked = 0;
  for (std::size_t i = 0; i < targets.size(); ++i) {
    EXPECT_EQ(blocked[i] != 0, is_blocked(caster, from, targets[i]));
    n_blocked += blocked[i];
  }
  EXPECT_GT(n_blocked, 100);
  EXPECT_LT(n_blocked, 1000);
}

TEST(RayCaster, SpansAnswerLikeSingleRays) {
  const Scene scene = triangle_soup(300);
  const RayCaster caster(scene);
  std::vector<Ray> rays;
  for (std::uint64_t i = 0; i < 2003; ++i) {  // no multiple of the packet
    rays.push_back({.origin = random_vector(5, i, 400.0),
                    .direction = random_vector(6, i, 1.0),
                    .t_min = i % 3 == 0 ? 100.0 : 0.0,
                    .t_max = i % 5 == 0 ? 300.0 : std::numeric_limits<double>::infinity()});
  }
  for (const RayOrder order : {RayOrder::coherent, RayOrder::scattered}) {
    std::vector<RawHit> hits(rays.size());
    std::vector<std::uint8_t> blocked(rays.size(), 9);
    caster.intersect(rays, order, hits);
    caster.are_blocked(rays, order, blocked);
    int n_hits = 0;
    int n_other = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const RawHit alone = caster.intersect(rays[i]);
      n_hits += alone.is_hit() ? 1 : 0;
      // Where a ray meets an edge within single precision the two may differ.
      n_other +=
          alone.is_hit() != hits[i].is_hit() || alone.triangle != hits[i].triangle ? 1 : 0;
      n_other += is_blocked(caster, rays[i]) != (blocked[i] != 0) ? 1 : 0;
      n_other += alone.is_hit() != (blocked[i] != 0) ? 1 : 0;
      if (alone.is_hit() && alone.triangle == hits[i].triangle) {
        EXPECT_NEAR(hits[i].t, alone.t, 1e-4F * alone.t);
        EXPECT_GT(hits[i].t, rays[i].t_min);
        EXPECT_LT(hits[i].t, rays[i].t_max);
      }
    }
    EXPECT_GT(n_hits, 100);
    EXPECT_LT(n_hits, 1700);
    EXPECT_LE(n_other, 3);
  }
}

TEST(RayCaster, TellsTheFrontByTheOrderOfTheCorners) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_quad({-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, 0));
  const RayCaster caster(scene);
  const std::optional<Hit> above = caster.intersect({0.2, 0.1, 5.0}, {0, 0, -1});
  const std::optional<Hit> below = caster.intersect({0.2, 0.1, -5.0}, {0, 0, 1});
  ASSERT_TRUE(above && below);
  EXPECT_TRUE(above->is_front);  // counter-clockwise from there
  EXPECT_EQ(above->flat_normal, Vector3d(0, 0, 1));
  EXPECT_FALSE(below->is_front);
  EXPECT_EQ(below->flat_normal, Vector3d(0, 0, -1));
}

TEST(RayCaster, AMeshWithoutTrianglesKeepsTheNumbersOfTheOthers) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.emplace_back();
  scene.meshes.push_back(make_quad({-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, 0));
  scene.meshes.emplace_back().vertices.emplace_back(5.0, 0.0, 0.0);
  scene.meshes.push_back(make_quad({-1, -1, 1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, 1}, 0));
  const RayCaster caster(scene);
  EXPECT_EQ(caster.intersect({.origin = {0.2, 0.1, 5.0}, .direction = {0, 0, -1}}).mesh, 3U);
  EXPECT_EQ(caster.intersect({.origin = {0.2, 0.1, -5.0}, .direction = {0, 0, 1}}).mesh, 1U);
  EXPECT_FALSE(is_blocked(caster, Ray{.origin = {0, 0, -5.0}, .direction = {0, 1, 0}}));
}

TEST(RayCaster, ShorteningLetsARayTouchBothEnds) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_quad({-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, 0));
  const RayCaster caster(scene);
  EXPECT_FALSE(is_blocked(caster, {0, 0, 0}, {0, 0, 10}));
  EXPECT_FALSE(is_blocked(caster, {0, 0, 10}, {0, 0, 0}));
  EXPECT_TRUE(is_blocked(caster, {0, 0, 10}, {0, 0, -1}));
  EXPECT_FALSE(is_blocked(caster, {0, 0, 0}, {0, 0, 0}));
}

TEST(RayCaster, SphereCarriesAnalyticNormals) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_sphere({1, 2, 3}, 50.0, 5, 0));
  const RayCaster caster(scene);
  for (std::uint64_t i = 0; i < 200; ++i) {
    const Vector3d direction = random_vector(6, i, 1.0).normalized();
    const std::optional<Hit> hit =
        caster.intersect(Vector3d(1, 2, 3) - 100.0 * direction, direction);
    ASSERT_TRUE(hit);
    // 2^5 parts a quarter turn: chords lie within 50 (1 - cos(pi/128)) = 0.015 mm, and linear
    // interpolation of unit normals errs by at most (pi/64)^2 / 8.
    EXPECT_NEAR((hit->point - Vector3d(1, 2, 3)).norm(), 50.0, 0.05);
    EXPECT_GT(hit->normal.dot(-direction), 1.0 - 1e-5);
  }
}

// It keeps references: a scene that ends with the statement is refused by the compiler.
static_assert(std::is_constructible_v<RayCaster, const Scene&>);
static_assert(!std::is_constructible_v<RayCaster, Scene>);
static_assert(!std::is_constructible_v<RayCaster, const Scene>);

TEST(RayCaster, EmptySceneHitsNothing) {
  const Scene scene;
  const RayCaster caster(scene);
  EXPECT_FALSE(caster.intersect({0, 0, 0}, {0, 0, 1}));
  EXPECT_FALSE(is_blocked(caster, {0, 0, 0}, {0, 0, 1}));
}

/// Embree shares oneTBB with every loop of the process.
TEST(RayCaster, LeavesOtherLoopsTheirThreads) {
  if (std::thread::hardware_concurrency() < 2) {
    GTEST_SKIP() << "one processor";
  }
  Scene scene;
  scene.materials.push_back({"m", Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(
      make_quad({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {1.0, 1.0, 0.0}, {0.0, 1.0, 0.0}, 0));
  const RayCaster caster(scene);
  // Each waits for the other: with one thread the first waits in vain.
  std::atomic<int> n_begun = 0;
  std::atomic<int> n_met = 0;
  parallel_for(2, 1, [&](std::size_t, std::size_t) {
    ++n_begun;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (n_begun < 2 && std::chrono::steady_clock::now() < end) {
      std::this_thread::yield();
    }
    n_met += n_begun == 2 ? 1 : 0;
  });
  EXPECT_EQ(n_met, 2);
}

}  // namespace
}  // namespace haarlight::render
