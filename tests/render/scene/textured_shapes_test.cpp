// SPDX-License-Identifier: Apache-2.0
/// @file
/// Texture coordinates of spheres and boxes, by a picture whose colour is a known function of them.

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/render/rays/ray_caster.h"
#include "render/bsdf/bsdf.h"
#include "render/scene/texture.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kTexels = 512;
const Vector3d kCentre(10.0, -20.0, 30.0);
constexpr double kRadius = 40.0;

/// Red and green go around with u, blue rises with v. Without a step where u = 1 meets u = 0.
Vector3d colour_of(const Vector2d& uv) {
  const double turn = 2.0 * std::numbers::pi * uv.x();
  return {0.5 + 0.4 * std::cos(turn), 0.5 + 0.4 * std::sin(turn), 0.1 + 0.8 * uv.y()};
}

Material painted() {
  Image<float> picture(kTexels, kTexels, 3);
  for (int y = 0; y < kTexels; ++y) {
    for (int x = 0; x < kTexels; ++x) {
      const Vector3d colour = colour_of({(x + 0.5) / kTexels, 1.0 - (y + 0.5) / kTexels});
      for (int c = 0; c < 3; ++c) {
        picture(y, x, c) = static_cast<float>(colour[c]);
      }
    }
  }
  Material material{.name = "painted", .kd = Vector3d::Ones()};
  material.kd_texture.file = "painted";
  material.kd_texture.picture = std::make_shared<const Texture>(std::move(picture));
  return material;
}

// Bilinear between 512 texels: (2 pi / 512)^2 / 8 of 0.4; texels are floats.
constexpr double kOfTexture = 1e-5;

/// What a ray from outside towards the centre meets in that direction from it.
Hit hit_from(const RayCaster& caster, const Vector3d& direction) {
  return caster.intersect(kCentre + 5.0 * kRadius * direction, -direction).value();
}

Vector3d albedo_of(const Scene& scene, const Hit& hit) {
  return albedo(bsdf_of(scene, hit), Vector3d::UnitZ());
}

Vector3d random_direction(std::uint64_t i) {
  const double z = 2.0 * uniform_unit(hash_key(1, i)) - 1.0;
  const double phi = 2.0 * std::numbers::pi * uniform_unit(hash_key(2, i));
  return {std::sqrt(1.0 - z * z) * std::cos(phi), std::sqrt(1.0 - z * z) * std::sin(phi), z};
}

/// By the definition, where atan2 is not at its ends.
Vector2d uv_by_angles(const Vector3d& d) {
  const double azimuth =
      d.y() >= 0.0 ? std::acos(d.x() / std::hypot(d.x(), d.y()))
                   : 2.0 * std::numbers::pi - std::acos(d.x() / std::hypot(d.x(), d.y()));
  return {azimuth / (2.0 * std::numbers::pi), std::acos(-d.z()) / std::numbers::pi};
}

TEST(SphereUv, IsAzimuthAndPolarAngle) {
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const Vector3d d = random_direction(i);
    // acos loses half its digits at its ends.
    EXPECT_LT((sphere_uv(d) - uv_by_angles(d)).norm(), 1e-7) << d.transpose();
  }
  EXPECT_EQ(sphere_uv(Vector3d::UnitX()), Vector2d(0.0, 0.5));
  EXPECT_EQ(sphere_uv(Vector3d::UnitY()), Vector2d(0.25, 0.5));
  EXPECT_EQ(sphere_uv(-Vector3d::UnitX()), Vector2d(0.5, 0.5));
  EXPECT_EQ(sphere_uv(-Vector3d::UnitY()), Vector2d(0.75, 0.5));
  EXPECT_EQ(sphere_uv(Vector3d::UnitZ()).y(), 1.0);
  EXPECT_EQ(sphere_uv(-Vector3d::UnitZ()).y(), 0.0);
  EXPECT_EQ(sphere_uv(Vector3d(1.0, -1e-30, 0.0)).x(), 0.0) << "below 1";
}

TEST(TexturedSphere, AnExactOneHasTheColourOfItsAngles) {
  Scene scene;
  scene.materials = {painted(), {.name = "plain"}};
  scene.spheres = {{.centre = kCentre, .radius_mm = kRadius}};
  const RayCaster caster(scene);
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const Vector3d d = random_direction(i);
    if (std::abs(d.z()) > 0.999) {
      continue;  // a texel joins the picture's top and bottom
    }
    const Hit hit = hit_from(caster, d);
    EXPECT_LT((albedo_of(scene, hit) - colour_of(uv_by_angles(d))).norm(), 2.0 * kOfTexture);
  }
  scene.spheres[0].material = 1;
  EXPECT_EQ(hit_from(RayCaster(scene), Vector3d::UnitY()).uv, Vector2d::Zero());
}

TEST(TexturedSphere, OfTrianglesHasTheColourOfItsAnglesAtTheSeamToo) {
  Scene scene;
  scene.materials = {painted()};
  for (const int n : {3, 5}) {
    scene.meshes = {make_textured_sphere(kCentre, kRadius, n, 0)};
    const RayCaster caster(scene);
    // Triangles are up to 1.5 times a quarter turn / 2^n long. Linear between their corners u and v
    // are off by the length squared / 8 of their second derivatives, at |z| < 0.9 up to
    // 0.9 / 0.19 + 1/0.19 of 1 / (2 pi); colours change by 0.4 x 2 pi and 0.8 of that.
    const double length = 1.5 * 0.5 * std::numbers::pi / (1 << n);
    const double bound = 0.4 * length * length / 8.0 * 10.0 + kOfTexture;
    double worst = 0.0;
    const auto check = [&](const Vector3d& d) {
      const Vector3d off = albedo_of(scene, hit_from(caster, d)) - colour_of(uv_by_angles(d));
      worst = std::max(worst, off.cwiseAbs().maxCoeff());
    };
    for (std::uint64_t i = 0; i < 4000; ++i) {
      const Vector3d d = random_direction(i);
      if (std::abs(d.z()) < 0.9) {
        check(d);
      }
      // Close to the seam, at both sides.
      const double polar = 0.5 + 0.8 * uniform_unit(hash_key(3, i));
      const double side = (i % 2 == 0 ? 1e-4 : -1e-4) * uniform_unit(hash_key(4, i));
      check({std::sin(polar) * std::cos(side), std::sin(polar) * std::sin(side),
             std::cos(polar)});
    }
    EXPECT_LT(worst, bound) << n;
    EXPECT_GT(worst, 0.01 * bound) << "a bound of the right size";
    RecordProperty("worst_" + std::to_string(n), std::to_string(worst));
  }
}

TEST(TexturedSphere, IsWholeAtThePoles) {
  Scene scene;
  scene.materials = {painted()};
  scene.meshes = {make_textured_sphere(kCentre, kRadius, 5, 0)};
  const RayCaster caster(scene);
  for (int i = 0; i < 360; ++i) {
    for (const double top : {1.0, -1.0}) {
      const double phi = std::numbers::pi * (i + 0.5) / 180.0;
      const Vector3d d(0.04 * std::cos(phi), 0.04 * std::sin(phi), top);
      const Vector2d uv = hit_from(caster, d.normalized()).uv;
      // The eighth of a turn: a pole's corner is between the two others of its triangle.
      const double around = std::remainder(uv.x() - phi / (2.0 * std::numbers::pi), 1.0);
      EXPECT_LT(std::abs(around), 0.125) << i;
      // Lines of equal v are squares there, not circles.
      const double polar = std::numbers::pi * (top > 0.0 ? 1.0 - uv.y() : uv.y());
      EXPECT_LT(polar, 0.04 * std::numbers::sqrt2);
      EXPECT_GT(polar, 0.04 / std::numbers::sqrt2);
    }
  }
}

TEST(TexturedBox, EachSideShowsThePictureUprightFromOutside) {
  Scene scene;
  scene.materials = {painted()};
  const Vector3d half(10.0, 20.0, 30.0);
  scene.meshes = {make_textured_box(kCentre - half, kCentre + half, 0)};
  const RayCaster caster(scene);
  const struct {
    Vector3d outwards;
    Vector3d right;  ///< of who looks at it from outside
    Vector3d up;
  } sides[] = {
      {-Vector3d::UnitY(), Vector3d::UnitX(), Vector3d::UnitZ()},
      {Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()},
      {Vector3d::UnitY(), -Vector3d::UnitX(), Vector3d::UnitZ()},
      {-Vector3d::UnitX(), -Vector3d::UnitY(), Vector3d::UnitZ()},
      {Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY()},
      {-Vector3d::UnitZ(), Vector3d::UnitX(), -Vector3d::UnitY()},
  };
  for (const auto& [outwards, right, up] : sides) {
    EXPECT_EQ(right.cross(up), outwards);
    for (std::uint64_t i = 0; i < 50; ++i) {
      const Vector2d uv(0.01 + 0.98 * uniform_unit(hash_key(5, i)),
                        0.01 + 0.98 * uniform_unit(hash_key(6, i)));
      const Vector3d at = kCentre + half.cwiseProduct(outwards + (2.0 * uv.x() - 1.0) * right +
                                                      (2.0 * uv.y() - 1.0) * up);
      const std::optional<Hit> hit = caster.intersect(at + 50.0 * outwards, -outwards);
      ASSERT_TRUE(hit);
      EXPECT_LT((hit->uv - uv).norm(), 1e-12);
      EXPECT_LT((albedo_of(scene, *hit) - colour_of(uv)).norm(), 2.0 * kOfTexture);
    }
  }
}

}  // namespace
}  // namespace haarlight::render
