// SPDX-License-Identifier: Apache-2.0
/// @file
/// Covers that hug the light or the receiver, nearer than a ray in single precision tells: what is
/// called exact is within 1e-6 of the closed form at any distance.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "render/soft_shadow/shadow_grid.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using test::kDark;
using test::LightKind;
using test::scene_under_light;
using test::ShadowScene;

constexpr double kExact = 1e-6;
constexpr double kHeight = 2.0;
constexpr std::array kLights = {LightKind::disk, LightKind::square_mesh, LightKind::led};
/// Whole scenes and points, level or turned and shifted.
struct Place {
  double scale = 1.0;
  bool is_turned = false;

  [[nodiscard]] Eigen::Affine3d world_from_level() const {
    Eigen::Affine3d move = Eigen::Affine3d::Identity();
    if (is_turned) {
      move.translate(scale * Vector3d(0.7, -0.3, 0.45));
      move.rotate(Eigen::AngleAxisd(0.8, Vector3d(1, -2, 0.6).normalized()));
    }
    return move;
  }
};

constexpr std::array<Place, 4> kPlaces = {
    {{1.0, false}, {1.0, true}, {1e-6, true}, {1e6, true}}};

/// What a sweep found.
struct Sweep {
  int n_values = 0;
  int n_exact = 0;
  int n_hidden = 0;  ///< in truth, wholly
  double worst = 0.0;
  std::size_t n_behind = 0;  ///< first meshes that are behind the light: no pieces of the truth

  /// @param level  a scene under a level light, and points in it
  void add(const ShadowScene& level, const std::vector<Vector3d>& level_points,
           const Place& place, const std::string& what) {
    const Eigen::Affine3d move = place.world_from_level();
    ShadowScene made =
        scene_under_light(level.light, move * level.centre,
                          level.light_from_world * move.linear().transpose(), level.radius);
    const std::size_t n_own = made.scene.meshes.size();
    for (std::size_t m = n_own; m < level.scene.meshes.size(); ++m) {
      Mesh mesh = level.scene.meshes[m];
      for (Vector3d& vertex : mesh.vertices) {
        vertex = move * vertex;
      }
      if (m < n_own + n_behind) {
        made.scene.meshes.push_back(mesh);
      } else {
        made.add(mesh);
      }
    }
    std::vector<Vector3d> points;
    for (const Vector3d& point : level_points) {
      points.push_back(move * point);
    }
    const test::ShadowValues values = test::shadow_values(made.scene, points);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const LightShadow& shadow = values.shadows[i];
      const double truth = made.truth(points[i]);
      ++n_values;
      n_hidden += truth < kExact ? 1 : 0;
      if (test::is_exact(shadow.kind)) {
        ++n_exact;
        const double error = std::abs(shadow.visibility - truth);
        if (error > kExact && worst <= kExact) {
          ADD_FAILURE() << what << ", point " << points[i].transpose() << ": "
                        << shadow.visibility << " for " << truth << ", "
                        << kShadowKindWords.at(static_cast<std::size_t>(shadow.kind));
        }
        worst = std::max(worst, error);
      }
    }
  }
  void expect(const std::string& what, double least_exact, double least_hidden) const {
    std::printf("%s: %d values, %d exact, %d hidden, largest error of exact ones %.3g\n",
                what.c_str(), n_values, n_exact, n_hidden, worst);
    EXPECT_LE(worst, kExact);
    EXPECT_GE(n_exact, least_exact * n_values);
    EXPECT_GE(n_hidden, least_hidden * n_values);
  }
};

std::string told(const char* what, double gap, double tilt, const Place& place) {
  char words[120];
  std::snprintf(words, sizeof words, "%s, gap %.3g, tilt %.3g, scale %.0g%s", what, gap, tilt,
                place.scale, place.is_turned ? ", turned" : "");
  return words;
}

/// A sheet about a point, its height growing along x by `slope` and along y by half of it.
Mesh sheet(const Vector3d& middle, double half_x, double half_y, double slope) {
  const auto corner = [&](double s, double t) -> Vector3d {
    return middle + Vector3d(s * half_x, t * half_y, slope * (s * half_x + 0.5 * t * half_y));
  };
  return make_quad(corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1), kDark);
}

/// A floor that makes the scene large, not to be seen from above.
void add_floor(ShadowScene& made, double half) {
  made.add(make_box({-half, -half, -0.2 * half}, {half, half, -0.1 * half}, kDark));
}

std::vector<double> steps(double first, double last, double factor) {
  std::vector<double> all;
  for (double step = first; step < last; step *= factor) {
    all.push_back(step);
  }
  all.push_back(last);
  return all;
}

/// Below the light and the cover: on the floor, close to the cover, aside, and between the two.
std::vector<Vector3d> points_below(double height, double radius, double gap, double scale) {
  std::vector<Vector3d> points;
  for (int i = 0; i < 7; ++i) {
    points.emplace_back(scale * (-0.9 + 0.3 * i), 0.013 * scale, 0.0);
  }
  for (const double below : {1e-7, 1e-5, 1e-3, 1e-2, 0.1, 0.5}) {
    for (const double aside : {0.0, 0.31, 0.9, 3.0, 40.0}) {
      points.emplace_back(aside * radius, 0.013 * radius, height - gap - below * height);
    }
  }
  for (const double part : {0.1, 0.5, 0.9}) {
    // Nearer is in the light's plane.
    if (part * gap > 2.0 * kNearestZ * radius) {
      points.emplace_back(0.21 * radius, 0.1 * radius, height - part * gap);
    }
  }
  return points;
}

/// @param radius  of the light at a height of 2 @param gaps  over what is swept, of a length
void sweep_covers(LightKind light, double radius, double length, const Place& place,
                  double factor, Sweep& sweep) {
  const double scale = place.scale;
  const double height = kHeight * scale;
  const double r = radius * scale;
  for (const double tilt : {0.0, 0.3, 0.9}) {
    // No part of it is nearer to the light's plane than kNearestZ of its radius, a square's corner.
    const double first = std::max(1e-9, 1.5 * kNearestZ * radius / (1.0 - tilt) / length);
    for (const double gap : steps(first * length, length, factor)) {
      const double slope = tilt * gap / (1.5 * 1.5 * radius);
      for (const double middle : {0.0, 1.7}) {
        // Whole, and with an edge over the light.
        for (const double floor : {0.5, 200.0}) {
          ShadowScene made = scene_under_light(light, height, r);
          made.add(sheet({middle * r, 0.0, height - gap * scale}, 1.5 * r, 1.5 * r, slope));
          add_floor(made, floor * scale);
          sweep.add(made, points_below(height, r, gap * scale, scale), place,
                    told("cover", gap, tilt, place));
        }
      }
    }
  }
}

TEST(SoftShadowCovers, OfTheLightAtAnyDistance) {
  for (const LightKind light : kLights) {
    Sweep sweep;
    for (const Place& place : {kPlaces[0], kPlaces[1]}) {
      sweep_covers(light, 0.3, 0.3, place, 10.0, sweep);
      sweep_covers(light, 1e-3, 1.9, place, 10.0, sweep);
    }
    sweep.expect("covers of the light", 0.99, 0.2);
  }
}

TEST(SoftShadowCovers, OfTheLightFinelySweptAndScaled) {
  for (const LightKind light : kLights) {
    Sweep sweep;
    for (const Place& place : kPlaces) {
      for (const double radius : {1e-3, 0.3, 20.0}) {
        sweep_covers(light, radius, radius, place, 2.5, sweep);
        sweep_covers(light, radius, 1.9, place, 2.5, sweep);
      }
    }
    sweep.expect("covers of the light", 0.97, 0.2);
  }
}

/// Rays that only count end before the light's own surface, straight above and aside.
TEST(SoftShadowCovers, NoLightHidesItselfFromTracedRays) {
  for (const LightKind light : kLights) {
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(0.8, Vector3d(1, -2, 0.6).normalized()).toRotationMatrix();
    const ShadowScene made = scene_under_light(light, {0.7, -0.3, 1.9}, turn, 0.3);
    std::vector<Vector3d> points;
    for (int i = 0; i < 200; ++i) {
      const Vector3d level(0.11 * i - 9.0, 0.013 * i, 0.02 + 0.01 * i);
      points.emplace_back(made.centre + turn.transpose() * level);
    }
    const test::ShadowValues values =
        test::shadow_values(made.scene, points, {.method = ShadowMethod::rays, .strata = 6});
    for (const LightShadow& shadow : values.shadows) {
      EXPECT_EQ(shadow.visibility, 1.0F);
      EXPECT_EQ(shadow.kind, ShadowKind::traced);
    }
  }
}

/// A board at the light's back, or in its plane, hides nothing of it.
TEST(SoftShadowCovers, NoBoardThatTheLightIsOn) {
  for (const LightKind light : kLights) {
    Sweep sweep;
    sweep.n_behind = 1;
    for (const Place& place : kPlaces) {
      const double scale = place.scale;
      const double height = kHeight * scale;
      for (const double gap : {0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3}) {
        ShadowScene made = scene_under_light(light, height, 0.3 * scale);
        // Behind the light's plane it is no piece of the truth.
        made.scene.meshes.push_back(
            sheet({0.1 * scale, 0.0, height + gap * scale}, 90 * scale, 90 * scale, 0.0));
        made.add(
            make_box({0.4 * scale, -scale, scale}, {0.5 * scale, scale, 1.1 * scale}, kDark));
        std::vector<Vector3d> points = points_below(height, 0.3 * scale, 0.0, scale);
        sweep.add(made, points, place, told("board", gap, 0.0, place));
      }
    }
    sweep.expect("boards", 0.95, 0.0);
  }
}

/// A sheet that hugs the receiver, over it or under it.
TEST(SoftShadowCovers, OfTheReceiverAtAnyDistance) {
  for (const LightKind light : kLights) {
    Sweep sweep;
    for (const Place& place : kPlaces) {
      const double scale = place.scale;
      for (const double gap : steps(1e-9, 0.3, 10.0)) {
        for (const double side : {1.0, -1.0}) {
          for (const double slope : {0.0, 0.2, 2.0}) {
            ShadowScene made = scene_under_light(light, kHeight * scale, 0.3 * scale);
            made.add(sheet({0.3 * scale, 0.2 * scale, 0.3 * scale}, 2.0 * scale, 2.0 * scale,
                           slope));
            made.add(make_box({-20 * scale, -20 * scale, -9 * scale},
                              {20 * scale, 20 * scale, -8 * scale}, kDark));
            std::vector<Vector3d> points;
            for (const double s : {-0.31, 0.0, 0.17, 0.4}) {
              const Vector3d on(0.3 + s, 0.2 + 0.7 * s, 0.3 + slope * (s + 0.35 * s));
              const Vector3d up = Vector3d(-slope, -0.5 * slope, 1.0).normalized();
              points.emplace_back(scale * (on - side * gap * up));
            }
            sweep.add(made, points, place, told("sheet", side * gap, slope, place));
          }
        }
      }
    }
    sweep.expect("about the receiver", 0.9, 0.3);
  }
}

/// A point nearer to a wall beside it than the rays' offset, outside and inside of a closed box.
TEST(SoftShadowCovers, AWallBesideTheReceiver) {
  for (const LightKind light : kLights) {
    Sweep sweep;
    for (const Place& place : kPlaces) {
      const double scale = place.scale;
      for (const double gap : steps(1e-9, 1e-2, 10.0)) {
        ShadowScene made = scene_under_light(light, kHeight * scale, 0.4 * scale);
        made.add(make_box({-0.25 * scale, -0.25 * scale, 0.0},
                          {0.25 * scale, 0.25 * scale, 0.5 * scale}, kDark));
        std::vector<Vector3d> points;
        for (const double out : {gap, -gap}) {
          points.emplace_back(scale * Vector3d(0.25 + out, 0.1, 0.2));
          points.emplace_back(scale * Vector3d(0.03, -0.25 - out, 1e-3));
          points.emplace_back(scale * Vector3d(0.03, 0.07, 0.5 + out));
          points.emplace_back(scale * Vector3d(0.25 + out, 0.25 + out, 0.4));
          points.emplace_back(scale * Vector3d(0.03, 0.07, -out));
        }
        sweep.add(made, points, place, told("wall", gap, 0.0, place));
      }
    }
    sweep.expect("walls", 0.9, 0.3);
  }
}

/// Kinds and values of covers at both ends are those of one cell.
TEST(SoftShadowCovers, AreTheSameForAnyGrid) {
  for (const LightKind light : kLights) {
    for (const double gap : steps(1e-9, 1e-3, 100.0)) {
      ShadowScene made = scene_under_light(light, kHeight, 0.3);
      made.add(sheet({0.1, 0.0, kHeight - gap}, 0.45, 0.45, 0.0));
      made.add(sheet({0.0, 0.0, 0.0}, 2.0, 2.0, 0.1));
      std::vector<Vector3d> points = points_below(kHeight, 0.3, gap, 1.0);
      for (int i = -9; i <= 9; ++i) {
        points.emplace_back(0.1 * i, 0.03, 0.1 * (0.1 * i + 0.5 * 0.03) + (i % 2) * gap);
      }
      const auto first = test::shadow_values(made.scene, points, {.grid = 1}).shadows;
      for (const int grid : {2, 31, 256}) {
        const auto other = test::shadow_values(made.scene, points, {.grid = grid}).shadows;
        for (std::size_t i = 0; i < points.size(); ++i) {
          EXPECT_EQ(first[i].visibility, other[i].visibility) << gap << ' ' << grid;
          EXPECT_EQ(first[i].kind, other[i].kind) << gap << ' ' << grid;
        }
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render
