// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include <gtest/gtest.h>

#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/scene/texture.h"
#include "render/scene/texture_files.h"
#include "tests/extremes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;

EXTREMES_OF(texture, "render/scene", "textures: periodic, bilinear; their coordinates at a hit")

/// Grey texels 1/n, 2/n .. 1, row by row.
Image<float> ramp(int width, int height) {
  Image<float> picture(height, width, 1);
  const std::span<float> texels = picture.pixels();
  for (std::size_t i = 0; i < texels.size(); ++i) {
    texels[i] = static_cast<float>(i + 1) / static_cast<float>(texels.size());
  }
  return picture;
}

void make_with(float value) {
  Image<float> picture = ramp(4, 2);
  picture(1, 2) = value;
  static_cast<void>(
      make_texture(std::move(picture), {.file = "made.exr", .where = "s.toml:3"}));
}

/// The largest error of texture coordinates on a parallelogram of 200 mm, looked at along
/// `direction` from `distance_mm` away, `offset` from the origin.
double hit_error(const Vector3d& direction, double distance_mm, double offset) {
  const Vector3d corner(offset, -offset, 3.0);
  const Vector3d along(200.0, 20.0, 0.0);
  const Vector3d across(-30.0, 150.0, 0.0);
  Scene scene;
  scene.materials = {{.name = "tiles", .kd_texture = {.file = "made.png"}}};
  scene.meshes = {
      make_quad(corner, corner + along, corner + along + across, corner + across, 0)};
  const RayCaster caster(scene);
  double worst = 0.0;
  for (const double u : {0.1, 0.3, 0.55, 0.9}) {
    for (const double v : {0.05, 0.5, 0.8}) {
      const Vector3d point = corner + u * along + v * across;
      const Vector3d from = point - distance_mm * direction.normalized();
      const std::optional<Hit> hit = caster.intersect(from, direction.normalized());
      worst = std::max(worst, hit ? (hit->uv - Vector2d(u, v)).cwiseAbs().maxCoeff() : 1.0);
    }
  }
  return worst;
}

EXTREME(texture, dark) {
  EXPECT_EQ(Texture(Image<float>(3, 5, 3)).at({0.3, 0.7}), Vector3d::Zero());
  return exact("black: reflects nothing");
}
EXTREME(texture, one) {
  for (const double u : {0.0, -1e-300, 0.5, 1.0, -1e15}) {
    EXPECT_EQ(Texture(ramp(1, 1)).at({u, 0.3}), Vector3d::Ones());
  }
  return exact("one texel: the same everywhere");
}
EXTREME(texture, largest) {
  const Texture texture(ramp(4, 2));
  for (const double u : {1e15, -1e15}) {
    EXPECT_EQ(texture.at({u + 0.125, 0.75}), texture.at({0.125, 0.75}));
  }
  return both(exact("coordinates of 1e15, the largest ones with the largest scale: periodic"),
              refused("'2e9' is no texture coordinate",
                      [] { static_cast<void>(parse_obj("vt 2e9 0\n", "t.obj")); }));
}
EXTREME(texture, odd_size) {
  const Image<float> picture = ramp(7, 3);
  const Texture texture(picture);
  double worst = 0.0;
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 7; ++x) {
      const Vector2d centre((x + 0.5) / 7.0, 1.0 - (y + 0.5) / 3.0);
      worst = std::max(worst, std::abs(texture.at(centre).x() - double{picture(y, x)}));
    }
  }
  return bounded(worst, 1e-14, "7 × 3 texels at their centres: error",
                 "centres rounded at 2^-53 of 7 texels");
}
EXTREME(texture, scale) {
  const Texture texture(ramp(4, 2));
  for (const double u : {1e-30, -1e-30}) {
    EXPECT_EQ(texture.at({u, u}), texture.at({0.0, 0.0}));
  }
  return exact("coordinates of ±1e-30: those of 0");
}
EXTREME(texture, subnormal) {
  Image<float> picture(1, 2, 1);
  picture(0, 1) = 1e-40F;
  EXPECT_EQ(Texture(picture).at({0.75, 0.5}).x(), double{1e-40F});
  EXPECT_EQ(Texture(picture).at({0.5, 0.5}).x(), 0.5 * double{1e-40F});
  return exact("texels of 1e-40: kept, and interpolated in double precision");
}
EXTREME(texture, not_finite) {
  return both(refused("pixel (x 2, y 1) of texture made.exr is nan",
                      [] { make_with(std::numeric_limits<float>::quiet_NaN()); }),
              refused("'nan' is no texture coordinate",
                      [] { static_cast<void>(parse_obj("vt nan 0\n", "t.obj")); }));
}
EXTREME(texture, degenerate) {
  Scene scene;
  scene.materials = {{.name = "tiles", .kd_texture = {.file = "made.png"}}};
  scene.meshes = {make_quad({0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, 0)};
  scene.meshes[0].uvs.assign(4, Vector2d(0.3, 0.6));
  const std::optional<Hit> hit =
      RayCaster(scene).intersect(Vector3d(0.3, 0.4, 5.0), -Vector3d::UnitZ());
  EXPECT_TRUE(hit && hit->uv == Vector2d(0.3, 0.6));
  return exact("corners with the same coordinates: one point of the picture");
}
EXTREME(texture, grazing) {
  return bounded(hit_error({1.0, 0.2, -1e-3}, 50.0, 0.0), 1e-11,
                 "a thousandth of the way is down: error of the coordinates",
                 "2^-53 of 50 mm over that slope, on 150 mm; 100 of them");
}
EXTREME(texture, far_near) {
  return bounded(
      std::max(hit_error({0.3, 0.4, -1.0}, 100.0, 1e6), hit_error({0.3, 0.4, -1.0}, 1e-3, 0.0)),
      1e-10, "1e6 mm from the origin, and seen from 1e-3 mm: error of the coordinates",
      "coordinates of 1e6 rounded at 1e-10, on 150 mm; 100 of them");
}
EXTREME(texture, duplicate) {
  const Texture texture(ramp(7, 3));
  EXPECT_EQ(texture.at({0.3125 + 1e6, 0.8125 - 1e6}), texture.at({0.3125, 0.8125}));
  return exact("a million repetitions on: the same");
}
EXTREME(texture, clipped) {
  return both(refused("pixel (x 2, y 1) of texture made.exr is 3", [] { make_with(3.0F); }),
              refused("is -0.5", [] { make_with(-0.5F); }));
}

}  // namespace
}  // namespace haarlight::render
