// SPDX-License-Identifier: Apache-2.0
/// @file
/// Lamps and emission of glTF files against closed forms: candela, lux and nits by 683 lm/W.

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/scene/gltf_made.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

/// Radiance of the floor's middle, a white Lambertian surface, seen from 1 m above: half a
/// millimetre of it.
Vector3d shown_floor(const std::string& light_node, const std::string& light) {
  const SceneFile file = parse_gltf(
      made_floor().glb(floor_body(
          matte("1,1,1"),
          fmt::format(R"(,{{"camera":0,"translation":[0,1,0],)"
                      R"("rotation":[-0.70710678118654752,0,0,0.70710678118654752]}},)"
                      R"({{{},"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}})",
                      light_node),
          fmt::format(R"(,"cameras":[{{"type":"orthographic","orthographic":{{"xmag":0.00025,)"
                      R"("ymag":0.00025,"znear":0,"zfar":5}}}}],)"
                      R"("extensions":{{"KHR_lights_punctual":{{"lights":[{}]}}}})",
                      light))),
      "t.glb");
  CameraModel camera = resized(file.camera, 4, 4);
  CameraOptics optics = file.optics;
  optics.pixel_mm *= file.camera.width / 4.0;
  const RayCaster caster(file.scene);
  const PathIntegrator integrator(file.scene, caster, nullptr, {camera, optics}, PathOptions{});
  Film film(4, 4, surface_layers(false));
  (void)run(integrator, {.samples = 4}, film);
  const Image<float> picture = film.mean(0);
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    sum[static_cast<int>(i % 3)] += picture.pixels()[i] / 16.0;
  }
  return sum;
}

/// Of single precision, and of the floor's 0.5 mm, over which cos^3/d^2 changes by 1e-7.
constexpr double kTolerance = 1e-6;

void expect_radiance(const Vector3d& found, const Vector3d& wanted,
                     double tolerance = kTolerance) {
  EXPECT_LE((found - wanted).cwiseAbs().maxCoeff(), tolerance * wanted.maxCoeff())
      << found.transpose() << ", not " << wanted.transpose();
}

TEST(GltfLight, APointOfCandelaGivesItsIrradiance) {
  // 1366 cd are 2 W/sr; 2 m above and 1.5 m beside: d = 2.5 m, cos = 0.8.
  const Vector3d colour(1.0, 0.5, 0.25);
  expect_radiance(shown_floor(R"("translation":[1.5,2,0])",
                              R"({"type":"point","intensity":1366,"color":[1,0.5,0.25]})"),
                  colour * (2.0 * 0.8 / (2.5 * 2.5) / std::numbers::pi));
}

TEST(GltfLight, ASpotIsThatWithinItsCone) {
  const std::string spot =
      R"({{"type":"spot","intensity":683,"spot":{{"innerConeAngle":{},"outerConeAngle":{}}}}})";
  // Straight down from 2 m: a turn of -90 degrees about x takes -z there. The scale does not matter.
  const std::string down =
      R"("translation":[{},2,0],"scale":[3,3,3],"rotation":[-0.70710678118654752,0,0,0.70710678118654752])";
  const auto floor = [&](double beside, double inner, double outer) {
    return shown_floor(fmt::format(fmt::runtime(down), beside),
                       fmt::format(fmt::runtime(spot), inner, outer));
  };
  expect_radiance(floor(0.0, 0.1, 0.2), Vector3d::Constant(0.25 / std::numbers::pi));
  // 0.5 m beside: at an angle of atan(1/4) = 0.245.
  const double cosine = 4.0 / std::sqrt(17.0);
  const double full = cosine / (17.0 / 4.0) / std::numbers::pi;
  expect_radiance(floor(0.5, 0.25, 0.5), Vector3d::Constant(full));
  EXPECT_EQ(floor(0.5, 0.1, 0.24), Vector3d::Zero());
  // Between, by the smooth step of the cosine, which changes by 8e-4 from one end of the 0.5 mm to the
  // other: the samples' mean is not quite the middle's.
  const double t = (cosine - std::cos(0.4)) / (std::cos(0.1) - std::cos(0.4));
  expect_radiance(floor(0.5, 0.1, 0.4), Vector3d::Constant(full * t * t * (3.0 - 2.0 * t)),
                  1e-5);
}

TEST(GltfLight, ADirectionOfLuxGivesItsIrradiance) {
  // Turned by -60 degrees about x it shines down at 30 degrees to the floor's normal.
  expect_radiance(shown_floor(fmt::format(R"("rotation":[{:.17g},0,0,{:.17g}])",
                                          -std::sin(std::numbers::pi / 6.0),
                                          std::cos(std::numbers::pi / 6.0)),
                              R"({"type":"directional","intensity":2049})"),
                  Vector3d::Constant(3.0 * std::sqrt(0.75) / std::numbers::pi));
}

Vector3d emitted(std::string_view generator) {
  const std::string lamp =
      R"({"emissiveFactor":[1,0.5,0],"extensions":{"KHR_materials_emissive_strength":)"
      R"({"emissiveStrength":1366}}})";
  return parse_gltf(
             made_floor().glb(floor_body(lamp),
                              fmt::format(R"("version":"2.0","generator":"{}")", generator)),
             "t.glb")
      .scene.materials.at(0)
      .emits;
}

TEST(GltfLight, EmissionIsInNitsButForBlenders) {
  EXPECT_LE((emitted("by hand") - Vector3d(2.0, 1.0, 0.0)).norm(), 1e-12);
  // It writes watts of a lamp as candela by 683 lm/W, radiance as it is.
  EXPECT_EQ(emitted("Khronos glTF Blender I/O v3.4.50"), Vector3d(1366.0, 683.0, 0.0));
}

SceneFile lamp_of(bool is_double_sided, bool is_closed) {
  MadeGltf made = made_floor();
  // 3: of a tetrahedron about the origin.
  made.add_indices({0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3});
  made.add_points({0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 1, 0});  // 4
  return parse_gltf(
      made.glb(fmt::format(
          R"(,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":)"
          R"([{{"attributes":{{"POSITION":{}}},"indices":{},"material":0}}]}}],)"
          R"("materials":[{{"emissiveFactor":[1,1,1],"doubleSided":{}}}])",
          is_closed ? 4 : 0, is_closed ? 3 : 1, is_double_sided)),
      "t.glb");
}

TEST(GltfLight, AnOpenDoubleSidedEmitterShinesBothWays) {
  EXPECT_EQ(lamp_of(false, false).scene.meshes.size(), 1U);
  EXPECT_EQ(lamp_of(true, true).scene.meshes.size(), 1U);  // its inside is not seen
  const SceneFile both = lamp_of(true, false);
  ASSERT_EQ(both.scene.meshes.size(), 2U);
  const RayCaster caster(both.scene);
  for (const double side : {1.0, -1.0}) {
    const auto hit =
        caster.intersect(Vector3d(300.0, 200.0, side * 500.0), Vector3d(0.0, 0.0, -side));
    ASSERT_TRUE(hit.has_value());
    EXPECT_TRUE(hit->is_front) << side;
    EXPECT_NEAR(hit->point.z(), 0.0, 0.05) << side;  // 1e-5 of its 2.8 m apart
    EXPECT_GT(both.scene.materials.at(static_cast<std::size_t>(hit->material)).emits.x(), 0.0);
  }
}

}  // namespace
}  // namespace haarlight::render
