// SPDX-License-Identifier: Apache-2.0
/// @file
/// The methods that the exact one is compared with: right where their assumptions hold, wrong in the
/// way that is said where they do not.

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using test::kDark;
using test::LightKind;
using test::scene_under_light;
using test::ShadowScene;
using testing::HasSubstr;

std::vector<Vector3d> points_along(const Vector3d& from, const Vector3d& to, int n) {
  std::vector<Vector3d> points;
  for (int i = 0; i < n; ++i) {
    points.emplace_back(from + (i + 0.5) / n * (to - from));
  }
  return points;
}

std::vector<double> values_by(ShadowMethod method, const ShadowScene& made,
                              const std::vector<Vector3d>& points,
                              SoftShadowOptions options = {}) {
  options.method = method;
  std::vector<double> values;
  for (const LightShadow& shadow : test::shadow_values(made.scene, points, options).shadows) {
    values.push_back(shadow.visibility);
  }
  return values;
}

double mean_error(ShadowMethod method, const ShadowScene& made,
                  const std::vector<Vector3d>& points, const SoftShadowOptions& options = {}) {
  const std::vector<double> values = values_by(method, made, points, options);
  double sum = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    sum += std::abs(values[i] - made.truth(points[i])) / static_cast<double>(points.size());
  }
  return sum;
}

/// A flat convex mesh of two triangles.
Mesh sheet(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d) {
  return make_quad(a, b, c, d, kDark);
}

/// The floor's points about the shadow of a long straight edge.
TEST(DBuffer, OneEdgeIsExactAtAnyAngle) {
  for (const double slope : {0.0, 0.15, -0.4}) {
    ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
    made.add(sheet({-30.0, -30.0, 1.0 - 30.0 * slope / 30.0}, {0.1, -30.0, 1.0 - slope},
                   {0.1, 30.0, 1.0 + slope}, {-30.0, 30.0, 1.0 + 30.0 * slope / 30.0}));
    const std::vector<Vector3d> points = points_along({-0.4, 0.1, 0.0}, {0.8, -0.1, 0.0}, 500);
    const std::vector<double> values = values_by(ShadowMethod::d_buffer, made, points);
    int n_penumbra = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double truth = made.truth(points[i]);
      n_penumbra += truth > 0.0 && truth < 1.0 ? 1 : 0;
      EXPECT_NEAR(values[i], truth, 1e-6) << slope << ", " << points[i].transpose();
    }
    EXPECT_GT(n_penumbra, 150) << slope;
  }
}

/// r = 1, a plate of half side 0.5 at z = 2, the ray y = 0.1 z: its umbra ends at z = 2.857, where the
/// nearest of the umbra's four planes is met; the farthest one is met at 6.67.
TEST(DBuffer, TheFarthestOfAllPutsTheEndOfAConvergingUmbraWrong) {
  ShadowScene made =
      scene_under_light(LightKind::disk, Vector3d::Zero(), Eigen::Matrix3d::Identity(), 1.0);
  made.add(sheet({-0.5, -0.5, 2.0}, {0.5, -0.5, 2.0}, {0.5, 0.5, 2.0}, {-0.5, 0.5, 2.0}));
  const auto at = [](double z) { return Vector3d(0.0, 0.1 * z, z); };
  const std::vector<Vector3d> points = {at(2.8), at(2.9), at(4.0), at(6.6), at(6.8)};
  // Even numbers of texels: the ray is no border of theirs.
  const SoftShadowOptions fine{.texels = 1001};
  const std::vector<double> by_piece = values_by(ShadowMethod::d_buffer, made, points, fine);
  EXPECT_EQ(by_piece[0], 0.0);
  EXPECT_GT(by_piece[1], 0.0);
  const std::vector<double> paper = values_by(ShadowMethod::paper, made, points, fine);
  EXPECT_EQ(paper[0], 0.0);
  EXPECT_EQ(paper[2], 0.0);
  EXPECT_EQ(paper[3], 0.0);
  EXPECT_GT(paper[4], 0.0);
  EXPECT_NEAR(made.truth(points[2]), 0.14, 0.02);
  EXPECT_GT(by_piece[2], 0.05);
}

/// Past a level sheet's side, where the centre is seen and no corner parts the lamp: the cones of its
/// corners are not taken for sides, though the second line's points are within their reach.
TEST(DBuffer, ASideIsOneEdgeAsPublishedToo) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.add(sheet({-0.5, -0.5, 1}, {0.5, -0.5, 1}, {0.5, 0.5, 1}, {-0.5, 0.5, 1}));
  std::vector<Vector3d> points = points_along({1.02, 0.05, 0.0}, {1.28, 0.05, 0.0}, 200);
  for (const Vector3d& point : points_along({1.02, 0.68, 0.0}, {1.28, 0.68, 0.0}, 200)) {
    points.push_back(point);
  }
  const std::vector<double> values =
      values_by(ShadowMethod::paper, made, points, {.texels = 1024});
  for (std::size_t i = 0; i < points.size(); ++i) {
    // A texel is 1/1024 of the line, which is 0.43 of the lamp.
    EXPECT_NEAR(values[i], made.truth(points[i]), 2e-3) << points[i].transpose();
  }
}

/// Borders of one closed convex piece: whole umbra and whole light where the truth has them.
TEST(DBuffer, BordersOfAConvexPieceAreExact) {
  for (const double radius : {0.05, 0.3, 0.6}) {
    ShadowScene made = scene_under_light(LightKind::disk, 2.0, radius);
    made.add(make_box({-0.3, -0.25, 0.9}, {0.2, 0.3, 1.1}, kDark));
    int n_off = 0;
    std::vector<Vector3d> points;
    for (const double angle : {0.0, 0.4, 1.1, 2.0, 2.9, 3.7, 4.4, 5.5}) {
      const Vector3d to(2.0 * std::cos(angle), 2.0 * std::sin(angle), 0.0);
      const std::vector<Vector3d> line = points_along(Vector3d::Zero(), to, 500);
      points.insert(points.end(), line.begin(), line.end());
    }
    const std::vector<double> values =
        values_by(ShadowMethod::d_buffer, made, points, {.texels = 1024});
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double truth = made.truth(points[i]);
      n_off += (truth <= 1e-9) != (values[i] <= 1e-6) ? 1 : 0;
      n_off += (truth >= 1.0 - 1e-9) != (values[i] >= 1.0 - 1e-6) ? 1 : 0;
    }
    // A texel of 4/1024 of the floor beside a border may keep the wrong edge: one point of each line.
    EXPECT_LE(n_off, 16) << radius;
  }
}

TEST(DBuffer, ItsErrorFallsWithTexelsToThatOfItsAssumption) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.add(make_box({-0.3, -0.25, 0.999}, {0.2, 0.3, 1.001}, kDark));
  const std::vector<Vector3d> points = points_along({-1.5, -0.9, 0.0}, {1.5, 1.1, 0.0}, 600);
  const double coarse = mean_error(ShadowMethod::d_buffer, made, points, {.texels = 8});
  const double paper = mean_error(ShadowMethod::paper, made, points, {.texels = 512});
  const double by_piece = mean_error(ShadowMethod::d_buffer, made, points, {.texels = 512});
  EXPECT_GT(coarse, 1.1 * by_piece);
  EXPECT_GT(paper, by_piece);
  EXPECT_GT(by_piece, 1e-4);  // corners: one edge is not all
  EXPECT_LE(mean_error(ShadowMethod::exact, made, points), 1e-7);
}

TEST(DBuffer, FormsOfTheVisibilityDifferAsStated) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.add(sheet({-30, -30, 1}, {0, -30, 1}, {0, 30, 1}, {-30, 30, 1}));
  const std::vector<Vector3d> points = points_along({-0.4, 0.0, 0.0}, {0.4, 0.0, 0.0}, 4000);
  const std::vector<double> exact = values_by(ShadowMethod::d_buffer, made, points);
  for (const auto& [form, most] :
       {std::pair(VisibilityForm::cubic, 0.0394), std::pair(VisibilityForm::linear, 0.0577)}) {
    const std::vector<double> values =
        values_by(ShadowMethod::d_buffer, made, points, {.form = form});
    double worst = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      worst = std::max(worst, std::abs(values[i] - exact[i]));
    }
    EXPECT_NEAR(worst, most, 1e-4);
  }
}

/// Two boards that only together hide the light, and the silhouettes of its centre.
TEST(PointSilhouette, IsExactForSheetsAndNotForBodies) {
  const std::vector<Vector3d> points = points_along({-1.0, 0.013, 0.0}, {1.0, 0.013, 0.0}, 500);
  ShadowScene flat = scene_under_light(LightKind::disk, 2.0, 0.4);
  flat.add(sheet({-0.3, -0.3, 1}, {0.3, -0.3, 1}, {0.3, 0.3, 1}, {-0.3, 0.3, 1}));
  EXPECT_LE(mean_error(ShadowMethod::point_silhouette, flat, points), 1e-7);
  ShadowScene thick = scene_under_light(LightKind::disk, 2.0, 0.4);
  thick.add(make_box({-0.1, -0.3, 0.4}, {0.1, 0.3, 1.6}, kDark));
  EXPECT_GT(mean_error(ShadowMethod::point_silhouette, thick, points), 0.01);
  EXPECT_LE(mean_error(ShadowMethod::exact, thick, points), 1e-7);
}

/// The pilot's word on its rays, and the error that they have.
TEST(TracedShadows, HoldTheErrorThatIsAskedForAndSayIt) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.4);
  made.add(make_box({-0.3, -0.2, 0.8}, {0.3, 0.4, 1.2}, kDark));
  std::vector<Vector3d> points;
  for (int i = 0; i < 60; ++i) {
    for (int j = 0; j < 60; ++j) {
      points.emplace_back(-1.2 + 0.04 * i, -1.2 + 0.04 * j, 0.0);
    }
  }
  int before = 0;
  for (const double asked : {0.05, 0.02, 0.005}) {
    const test::ShadowValues values = test::shadow_values(
        made.scene, points, {.method = ShadowMethod::rays, .max_error = asked});
    std::vector<double> errors;
    double mean = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double truth = made.truth(points[i]);
      EXPECT_EQ(values.shadows[i].kind, ShadowKind::traced);
      if (truth > 0.0 && truth < 1.0) {
        errors.push_back(std::abs(values.shadows[i].visibility - truth));
        mean += errors.back();
      }
    }
    std::ranges::sort(errors);
    mean /= static_cast<double>(errors.size());
    const double at_99 = errors[errors.size() * 99 / 100];
    const TracedError& found = values.counts.traced;
    // A pilot of 512 tells 99 % by its five largest: 20 %.
    EXPECT_LE(at_99, 1.2 * asked);
    EXPECT_LE(mean, asked);
    EXPECT_GE(found.at_99, at_99 / 1.5);
    EXPECT_LE(found.at_99, asked);
    EXPECT_GE(found.mean, mean / 1.3);
    EXPECT_GT(found.n_pilot, 50);
    EXPECT_GT(found.strata, before);
    before = found.strata;
  }
}

Mesh mesh_of(std::vector<Vector3d> vertices, std::vector<Eigen::Vector3i> triangles) {
  Mesh mesh;
  mesh.name = "thing";
  mesh.vertices = std::move(vertices);
  mesh.triangles = std::move(triangles);
  mesh.material = kDark;
  return mesh;
}

/// Pages of a book, all from one spine.
Mesh book(int n_pages) {
  std::vector<Vector3d> vertices = {{0.0, -0.3, 1.0}, {0.0, 0.3, 1.0}};
  std::vector<Eigen::Vector3i> triangles;
  for (int i = 0; i < n_pages; ++i) {
    const double angle = 0.3 + 1.1 * i;
    vertices.emplace_back(0.4 * std::cos(angle), 0.0, 1.0 + 0.4 * std::sin(angle));
    triangles.emplace_back(0, 1, 2 + i);
  }
  return mesh_of(vertices, triangles);
}

Mesh broken_box(const std::function<void(Mesh&)>& change) {
  Mesh box = make_box({-0.3, -0.2, 0.8}, {0.3, 0.2, 1.2}, kDark);
  // One vertex for each corner.
  Mesh welded = mesh_of({}, {});
  for (const Eigen::Vector3i& triangle : box.triangles) {
    Eigen::Vector3i own;
    for (int c = 0; c < 3; ++c) {
      const Vector3d& corner = box.vertices[static_cast<std::size_t>(triangle[c])];
      const auto found = std::ranges::find(welded.vertices, corner);
      own[c] = static_cast<int>(found - welded.vertices.begin());
      if (found == welded.vertices.end()) {
        welded.vertices.push_back(corner);
      }
    }
    welded.triangles.push_back(own);
  }
  change(welded);
  return welded;
}

struct Broken {
  std::string what;
  Mesh mesh;
  std::string said;
};

std::vector<Broken> broken_meshes() {
  const std::string same = "two triangles that run the same way along it";
  const auto flip = [](std::size_t t) {
    return [t](Mesh& box) { std::swap(box.triangles[t][0], box.triangles[t][1]); };
  };
  const auto add = [](int a, int b, int c) {
    return [=](Mesh& box) { box.triangles.emplace_back(a, b, c); };
  };
  Mesh moebius = mesh_of({}, {});
  constexpr int kParts = 9;
  for (int i = 0; i < kParts; ++i) {
    const double turn = 2.0 * M_PI * i / kParts;
    const Vector3d out(std::cos(turn), std::sin(turn), 0.0);
    const Vector3d across =
        0.1 * (std::cos(0.5 * turn) * Vector3d::UnitZ() + std::sin(0.5 * turn) * out);
    moebius.vertices.emplace_back(Vector3d(0, 0, 1) + 0.3 * out - across);
    moebius.vertices.emplace_back(Vector3d(0, 0, 1) + 0.3 * out + across);
    const bool is_last = i + 1 == kParts;
    const int next = is_last ? 1 : 2 * i + 2;
    const int other = is_last ? 0 : 2 * i + 3;
    moebius.triangles.emplace_back(2 * i, next, 2 * i + 1);
    moebius.triangles.emplace_back(2 * i + 1, next, other);
  }
  return {
      {"three pages", book(3), "has 3 triangles"},
      {"four pages", book(4), "has 4 triangles"},
      {"five pages", book(5), "has 5 triangles"},
      {"a triangle twice",
       mesh_of({{0, 0, 1}, {0.3, 0, 1}, {0, 0.3, 1}}, {{0, 1, 2}, {0, 1, 2}}), same},
      {"a triangle three times",
       mesh_of({{0, 0, 1}, {0.3, 0, 1}, {0, 0.3, 1}}, {{0, 1, 2}, {0, 1, 2}, {1, 2, 0}}),
       "has 3 triangles"},
      {"two turned apart",
       mesh_of({{0, 0, 1}, {0.3, 0, 1}, {0, 0.3, 1}, {0, -0.3, 1}}, {{0, 1, 2}, {0, 1, 3}}),
       same},
      {"a box with its first triangle turned", broken_box(flip(0)), same},
      {"a box with its last triangle turned", broken_box(flip(11)), same},
      {"a box with a wall inside", broken_box(add(0, 2, 5)), "has 3 triangles"},
      {"a box with a fin", broken_box([](Mesh& box) {
         box.vertices.emplace_back(0.9, 0.9, 1.0);
         box.triangles.emplace_back(box.triangles[0][0], box.triangles[0][1],
                                    static_cast<int>(box.vertices.size()) - 1);
       }),
       "has 3 triangles"},
      {"a box with a face twice",
       broken_box([](Mesh& box) { box.triangles.push_back(box.triangles[3]); }),
       "has 3 triangles"},
      {"a box twice", broken_box([](Mesh& box) {
         const std::vector<Eigen::Vector3i> once = box.triangles;
         box.triangles.insert(box.triangles.end(), once.begin(), once.end());
       }),
       "has 4 triangles"},
      {"a Moebius strip", moebius, same},
  };
}

/// A D-buffer names mesh and edge; the exact way needs no two-manifolds.
TEST(DBuffer, NamesTheMeshAndTheEdgeThatIsNoTwoManifolds) {
  const std::vector<Broken> all = broken_meshes();
  EXPECT_GE(all.size(), 12U);
  for (const Broken& broken : all) {
    ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
    made.scene.meshes.push_back(broken.mesh);
    const std::vector<Vector3d> points = points_along({-1, 0.01, 0}, {1, 0.01, 0}, 50);
    for (const ShadowMethod method : {ShadowMethod::d_buffer, ShadowMethod::paper}) {
      try {
        (void)test::shadow_values(made.scene, points, {.method = method});
        ADD_FAILURE() << broken.what;
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), HasSubstr("mesh 0 (thing): the edge from (")) << broken.what;
        EXPECT_THAT(error.what(), HasSubstr(broken.said)) << broken.what;
        EXPECT_THAT(error.what(), HasSubstr("the test")) << broken.what;
      }
    }
    const test::ShadowValues exact = test::shadow_values(made.scene, points);
    const test::ShadowValues rays =
        test::shadow_values(made.scene, points, {.method = ShadowMethod::rays, .strata = 64});
    int n_exact = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      n_exact += test::is_exact(exact.shadows[i].kind) ? 1 : 0;
      EXPECT_NEAR(exact.shadows[i].visibility, rays.shadows[i].visibility, 0.02)
          << broken.what << ", point " << i;
    }
    EXPECT_GT(n_exact, 45) << broken.what;
  }
}

TEST(DBuffer, RefusesWhatHasNoEdges) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.scene.spheres.push_back({.centre = {0, 0, 1}, .radius_mm = 0.1, .material = kDark});
  EXPECT_THROW((void)test::shadow_values(made.scene, {Vector3d::Zero()},
                                         {.method = ShadowMethod::paper}),
               Error);
}

}  // namespace
}  // namespace haarlight::render
