// SPDX-License-Identifier: Apache-2.0
/// @file
/// What glTF files show: triangles, nodes, cameras, and the same scene in both of our forms.

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/scene/texture_files.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/scene/gltf_made.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3i;

Image<float> picture_of(const SceneFile& file) {
  const RayCaster caster(file.scene);
  const PathIntegrator integrator(file.scene, caster, nullptr, {file.camera, file.optics},
                                  PathOptions{});
  Film film(file.camera.width, file.camera.height, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = 4}, film).samples, 4U);
  return film.mean(0);
}

/// Corners of all triangles, in their order.
std::vector<Vector3d> corners_of(const Mesh& mesh) {
  std::vector<Vector3d> corners;
  for (const Vector3i& t : mesh.triangles) {
    for (const int corner : t) {
      corners.push_back(mesh.vertices[static_cast<std::size_t>(corner)]);
    }
  }
  return corners;
}

void expect_same(const std::vector<Vector3d>& found, const std::vector<Vector3d>& wanted,
                 double tolerance = 1e-9) {
  ASSERT_EQ(found.size(), wanted.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_LE((found[i] - wanted[i]).cwiseAbs().maxCoeff(), tolerance)
        << i << ": " << found[i].transpose() << ", not " << wanted[i].transpose();
  }
}

/// One mesh without a material, at one node.
SceneFile shown(const MadeGltf& made, std::string_view primitive, std::string_view node = "") {
  return parse_gltf(
      made.glb(fmt::format(
          R"(,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{}}}],"meshes":[{{"primitives":[{}]}}])",
          node, primitive)),
      "t.glb");
}

TEST(Gltf, IsTheSceneThatTomlDescribes) {
  MadeGltf made = made_floor();
  const std::string lamp =
      R"({"doubleSided":false,"emissiveFactor":[0.5,0.25,1],"pbrMetallicRoughness":)"
      R"({"baseColorFactor":[0,0,0,1],"metallicFactor":0},"extensions":{)"
      R"("KHR_materials_emissive_strength":{"emissiveStrength":1366},)"
      R"("KHR_materials_specular":{"specularFactor":0}}})";
  const std::string varnish =
      R"({"pbrMetallicRoughness":{"baseColorFactor":[0.75,0.5,0.25,1],"metallicFactor":0,)"
      R"("roughnessFactor":0.5}})";
  // The lamp looks down: a half turn about x.
  const SceneFile gltf = parse_gltf(
      made.glb(fmt::format(
          R"(,"scenes":[{{"nodes":[0,1,2,3]}}],"nodes":[{{"mesh":0}},)"
          R"({{"mesh":1,"translation":[0,2,0],"rotation":[1,0,0,0],"scale":[0.25,1,0.5]}},)"
          R"({{"camera":0,"translation":[0,1,3],"rotation":[0,0,0,1]}},)"
          R"({{"translation":[1,1.5,0.5],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}],)"
          R"("meshes":[{},{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":1}}]}}],)"
          R"("materials":[{},{}],"cameras":[{{"type":"perspective","perspective":)"
          R"({{"yfov":0.9,"aspectRatio":1,"znear":0.5,"zfar":100}}}}],)"
          R"("extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point","intensity":683}}]}}}})",
          kFloorMesh, varnish, lamp)),
      "t.glb");
  SceneFile both = gltf;
  both.camera = resized(both.camera, 16, 16);
  const testing::TemporaryFolder folder;
  write_file_atomically(folder / "s.toml", fmt::format(R"(
[[material]]
name = "varnish"
bsdf = "coated"
kd = [0.75, 0.5, 0.25]
roughness = 0.25
[[material]]
name = "lamp"
kd = [0]
emits = [1, 0.5, 2]
[[quad]]
corners = [[-1000, -1000, 0], [1000, -1000, 0], [1000, 1000, 0], [-1000, 1000, 0]]
material = "varnish"
[[quad]]
corners = [[-250, 500, 2000], [250, 500, 2000], [250, -500, 2000], [-250, -500, 2000]]
material = "lamp"
[[light]]
kind = "point"
position = [1000, -500, 1500]
intensity = [1e6]
[camera]
size = [640, 640]
eye = [0, -3000, 1000]
target = [0, 0, 1000]
fov_y_deg = {:.17g}
near_mm = 500
far_mm = 100000
)",
                                                       0.9 * 180.0 / std::numbers::pi));
  SceneFile toml = read_scene(folder / "s.toml");
  toml.scene.materials[0].is_kd_seen = true;  // the colour is glTF's
  ASSERT_EQ(gltf.scene.meshes.size(), 2U);
  for (std::size_t m = 0; m < 2; ++m) {
    expect_same(corners_of(gltf.scene.meshes[m]), corners_of(toml.scene.meshes[m]), 1e-9);
  }
  EXPECT_TRUE(gltf.camera.world_from_cam.isApprox(toml.camera.world_from_cam, 1e-15));
  EXPECT_EQ(gltf.camera.width, 640);
  EXPECT_NEAR(gltf.camera.fy, toml.camera.fy, 1e-9);
  EXPECT_NEAR(gltf.camera.fx, toml.camera.fx, 1e-9);
  EXPECT_EQ(gltf.optics, toml.optics);
  toml.camera = resized(toml.camera, 16, 16);
  const Image<float> ours = picture_of(toml);
  const Image<float> theirs = picture_of(both);
  double most = 0.0;
  for (std::size_t i = 0; i < ours.pixels().size(); ++i) {
    // Single precision of the picture, and of the angle in the TOML file.
    EXPECT_NEAR(theirs.pixels()[i], ours.pixels()[i],
                2e-6 * (1.0 + std::abs(ours.pixels()[i])));
    most = std::max(most, static_cast<double>(ours.pixels()[i]));
  }
  EXPECT_GT(most, 0.1);
}

TEST(Gltf, MetresBecomeMillimetresAndYBecomesZ) {
  MadeGltf made;
  made.add_points({1, 2, 3, 4, 5, 6, 7, 8, 1});
  const SceneFile file = shown(made, R"({"attributes":{"POSITION":0}})");
  expect_same(corners_of(file.scene.meshes.at(0)),
              {{1000, -3000, 2000}, {4000, -6000, 5000}, {7000, -1000, 8000}});
}

TEST(Gltf, TrianglesOfEveryKindAreTheSame) {
  MadeGltf made;
  // 0: positions; a grid of two squares.
  made.add_points({0, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0, 1, 2, 0, 0, 2, 0, 1});
  made.add<std::uint8_t>({0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5}, 5121, "SCALAR", 1);   // 1
  made.add<std::uint16_t>({0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5}, 5123, "SCALAR", 1);  // 2
  made.add<std::uint32_t>({0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5}, 5125, "SCALAR", 1);  // 3
  const auto listed = [&](std::string_view primitive) {
    return corners_of(shown(made, primitive).scene.meshes.at(0));
  };
  const std::vector<Vector3d> wanted = listed(R"({"attributes":{"POSITION":0},"indices":1})");
  ASSERT_EQ(wanted.size(), 12U);
  expect_same({wanted.begin(), wanted.begin() + 3}, {{0, 0, 0}, {0, -1000, 0}, {1000, 0, 0}});
  expect_same(listed(R"({"attributes":{"POSITION":0},"indices":2})"), wanted);
  expect_same(listed(R"({"attributes":{"POSITION":0},"indices":3,"mode":4})"), wanted);
  // A strip: every second triangle has its corners the other way round, so that all face the same way.
  const std::vector<Vector3d> strip = listed(R"({"attributes":{"POSITION":0},"mode":5})");
  ASSERT_EQ(strip.size(), 12U);
  for (std::size_t t = 0; t < strip.size(); t += 3) {
    EXPECT_GT((strip[t + 1] - strip[t]).cross(strip[t + 2] - strip[t]).z(), 0.0) << t;
  }
  made.add_indices({2, 0, 1, 3, 5, 4});  // 4: a fan about the third point
  const std::vector<Vector3d> fan =
      listed(R"({"attributes":{"POSITION":0},"indices":4,"mode":6})");
  ASSERT_EQ(fan.size(), 12U);
  for (std::size_t t = 0; t < fan.size(); t += 3) {
    EXPECT_GT((fan[t + 1] - fan[t]).cross(fan[t + 2] - fan[t]).z(), 0.0) << t;
    expect_same({fan[t + 2]}, {{1000, 0, 0}});
  }
}

TEST(Gltf, AccessorsOfEveryKindAreTheSame) {
  MadeGltf made;
  made.add_points({0, 0, 0, 1, 0, 0, 0, 0, -1});  // 0
  const std::vector<Vector3d> wanted{{0, 0, 0}, {1000, 0, 0}, {0, 1000, 0}};
  const auto listed = [&](int positions) {
    return corners_of(
        shown(made, fmt::format(R"({{"attributes":{{"POSITION":{}}}}})", positions))
            .scene.meshes.at(0));
  };
  expect_same(listed(0), wanted);
  // 1: interleaved with four bytes each that are none of it, after an offset.
  const std::vector<float> mixed{9, 0, 0, 0, 9, 1, 0, 0, 9, 0, 0, -1, 9};
  made.add_view({reinterpret_cast<const char*>(mixed.data()), mixed.size() * 4},
                R"(,"byteStride":16)");
  made.add_accessor(
      R"({"bufferView":1,"byteOffset":4,"componentType":5126,"count":3,"type":"VEC3"})");
  expect_same(listed(1), wanted);
  // 2, 3, 4, 5: integers, normalised and not.
  made.add<std::int8_t>({0, 0, 0, 127, 0, 0, 0, 0, -127}, 5120, "VEC3", 3,
                        R"(,"normalized":true)");
  expect_same(listed(2), wanted);
  made.add<std::int16_t>({0, 0, 0, 32767, 0, 0, 0, 0, -32768}, 5122, "VEC3", 3,
                         R"(,"normalized":true)");
  expect_same(listed(3), wanted);
  made.add<std::int16_t>({0, 0, 0, 1, 0, 0, 0, 0, -1}, 5122, "VEC3", 3);
  expect_same(listed(4), wanted);
  // 5: sparse over zeros; 6: over other numbers.
  const std::vector<std::uint16_t> which{1, 2};
  const std::vector<float> values{1, 0, 0, 0, 0, -1};
  const std::size_t indices =
      made.add_view({reinterpret_cast<const char*>(which.data()), which.size() * 2});
  const std::size_t numbers =
      made.add_view({reinterpret_cast<const char*>(values.data()), values.size() * 4});
  for (const char* base : {"", R"("bufferView":0,)"}) {
    made.add_accessor(fmt::format(
        R"({{{}"componentType":5126,"count":3,"type":"VEC3","sparse":{{"count":2,"indices":)"
        R"({{"bufferView":{},"componentType":5123}},"values":{{"bufferView":{}}}}}}})",
        base, indices, numbers));
  }
  expect_same(listed(5), wanted);
  expect_same(listed(6), wanted);
}

TEST(Gltf, NodesStandInEachOther) {
  MadeGltf made;
  made.add_points({1, 0, 0, 0, 1, 0, 0, 0, 1});
  // Scaled, turned by 90 degrees about y (x to -z), moved; within another that is moved and scaled.
  const double half = std::sqrt(0.5);
  const std::string inner = fmt::format(
      R"("scale":[2,3,4],"rotation":[0,{:.17g},0,{:.17g}],"translation":[10,20,30])", half,
      half);
  const auto file = [&](const std::string& child) {
    return parse_gltf(made.glb(fmt::format(
                          R"(,"scenes":[{{"nodes":[1]}}],"nodes":[{{"mesh":0,{}}},)"
                          R"({{"children":[0],"scale":[0.5,0.5,0.5],"translation":[0,0,-1]}}],)"
                          R"("meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}])",
                          child)),
                      "t.glb");
  };
  // (x, y, z) to (4 z, 3 y, -2 x) + (10, 20, 30), halved, z less 1; then to our frame.
  const std::vector<Vector3d> wanted{
      {5000, -13000, 10000}, {5000, -14000, 11500}, {7000, -14000, 10000}};
  expect_same(corners_of(file(inner).scene.meshes.at(0)), wanted);
  expect_same(
      corners_of(file(R"("matrix":[0,0,-2,0,0,3,0,0,4,0,0,0,10,20,30,1])").scene.meshes.at(0)),
      wanted);
}

TEST(Gltf, AMirroredFrontStaysTheFront) {
  MadeGltf made = made_floor();
  made.add_points({0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0});  // 3: normals
  const std::string primitive = R"({"attributes":{"POSITION":0,"NORMAL":3},"indices":1})";
  for (const char* scale : {R"(,"scale":[1,1,1])", R"(,"scale":[-1,1,1])",
                            R"(,"scale":[1,1,-2])", R"(,"scale":[-1,1,-1])"}) {
    const Mesh mesh = shown(made, primitive, scale).scene.meshes.at(0);
    const std::vector<Vector3d> corners = corners_of(mesh);
    for (std::size_t t = 0; t < corners.size(); t += 3) {
      EXPECT_GT((corners[t + 1] - corners[t]).cross(corners[t + 2] - corners[t]).z(), 0.0)
          << scale;
    }
    for (const Vector3d& normal : mesh.normals) {
      EXPECT_EQ(normal, Vector3d::UnitZ()) << scale;
    }
  }
}

TEST(Gltf, AMeshShownAgainIsAnInstance) {
  MadeGltf made = made_floor();
  const auto body = [&](const char* second) {
    return made.glb(floor_body(matte("1,1,1"), second));
  };
  const SceneFile file = parse_gltf(
      body(R"(,{"mesh":0,"translation":[3,1,0],"scale":[-2,1,0.5],"rotation":[0.6,0,0,0.8]})"),
      "t.glb");
  ASSERT_EQ(file.scene.meshes.size(), 1U);
  ASSERT_EQ(file.scene.instances.size(), 1U);
  const Scene expanded = with_instances_expanded(file.scene, "t.glb");
  // The same by itself.
  const SceneFile alone = parse_gltf(
      made.glb(fmt::format(
          R"(,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"translation":[3,1,0],)"
          R"("scale":[-2,1,0.5],"rotation":[0.6,0,0,0.8]}}],"meshes":[{}],"materials":[{}])",
          kFloorMesh, matte("1,1,1"))),
      "t.glb");
  expect_same(corners_of(expanded.meshes.at(1)), corners_of(alone.scene.meshes.at(0)), 1e-9);
  // Flattened, it has no inverse: a mesh of its own.
  const SceneFile flat =
      parse_gltf(body(R"(,{"mesh":0,"translation":[3,1,0],"scale":[1,0,1]})"), "t.glb");
  EXPECT_EQ(flat.scene.meshes.size(), 2U);
  EXPECT_TRUE(flat.scene.instances.empty());
}

TEST(Gltf, CamerasSeeWhatTheFileSays) {
  const auto camera = [](std::string_view json) {
    return parse_gltf(made_floor().glb(floor_body(
                          matte("1,1,1"),
                          R"(,{"camera":0,"translation":[1,2,3],)"
                          R"("rotation":[0,0.70710678118654752,0,0.70710678118654752]})",
                          fmt::format(R"(,"cameras":[{}])", json))),
                      "t.glb");
  };
  // It looks along -x of glTF, which is -x of ours; its right is -z there, +y here.
  const SceneFile wide = camera(
      R"({"type":"perspective","perspective":{"yfov":1.2,"aspectRatio":2,"znear":0.25}})");
  EXPECT_EQ(wide.camera.width, 640);
  EXPECT_EQ(wide.camera.height, 320);
  const double up = std::tan(0.6);
  const auto corner =
      project(wide.camera, Vector3d(1000, -3000, 2000) + 1000.0 * Vector3d(-1.0, 2.0 * up, up));
  ASSERT_TRUE(corner.has_value());
  EXPECT_NEAR(corner->x(), 640.0, 1e-9);  // the upper right corner
  EXPECT_NEAR(corner->y(), 0.0, 1e-9);
  EXPECT_EQ(wide.optics.near_mm, 250.0);
  EXPECT_EQ(wide.optics.far_mm, 0.0);
  const SceneFile flat = camera(
      R"({"type":"orthographic","orthographic":{"xmag":0.5,"ymag":1,"znear":0,"zfar":9}})");
  EXPECT_EQ(flat.camera.width, 320);
  EXPECT_EQ(flat.camera.height, 640);
  const Ray ray = Camera(flat.camera, flat.optics).ray(320.0, 0.0, {0.5, 0.5});
  EXPECT_LE((ray.origin - Vector3d(1000, -2500, 3000)).norm(), 1e-9);
  EXPECT_LE((ray.direction + Vector3d::UnitX()).norm(), 1e-15);
  EXPECT_EQ(flat.optics.far_mm, 9000.0);
}

TEST(Gltf, TheFilesOwnSceneIsShown) {
  const std::string body = fmt::format(
      R"(,"scene":1,"scenes":[{{"nodes":[0]}},{{"nodes":[1]}}],)"
      R"("nodes":[{{"mesh":0}},{{"mesh":0,"translation":[0,7,0]}}],"meshes":[{}],"materials":[{}])",
      kFloorMesh, matte("1,1,1"));
  const SceneFile file = parse_gltf(made_floor().glb(body), "t.glb");
  ASSERT_EQ(file.scene.meshes.size(), 1U);
  EXPECT_EQ(file.scene.meshes[0].vertices[0].z(), 7000.0);
}

TEST(Gltf, ItsBytesMayLieBesideIt) {
  const testing::TemporaryFolder folder;
  const MadeGltf made = made_floor();
  const std::string body = floor_body(matte("1,1,1"));
  write_file_atomically(folder / "a b.bin", std::string_view(made.binary()));
  write_file_atomically(folder / "s.gltf",
                        std::string_view(made.json(body, R"(,"uri":"a%20b.bin")")));
  const SceneFile beside = read_scene(folder / "s.gltf");
  const SceneFile within = parse_gltf(made.glb(body), "t.glb");
  EXPECT_EQ(hash_of(beside), hash_of(within));
  EXPECT_EQ(beside.files, std::vector<std::string>{(folder / "a b.bin").string()});
  write_file_atomically(folder / "m.toml", std::string_view(R"(
[[mesh]]
file = "s.gltf"
translate = [0, 0, 5]
[[mesh]]
file = "s.gltf"
material = "own"
[[material]]
name = "own"
)"));
  const SceneFile meshes = read_scene(folder / "m.toml");
  ASSERT_EQ(meshes.scene.meshes.size(), 2U);
  EXPECT_EQ(meshes.scene.meshes[0].vertices[0], Vector3d(-1000, -1000, 5));
  EXPECT_EQ(
      meshes.scene.materials.at(static_cast<std::size_t>(meshes.scene.meshes[1].material)).name,
      "own");
  EXPECT_EQ(meshes.files.size(), 2U);
}

TEST(Gltf, ItsHashIsOfAllThatIsShown) {
  const auto hash = [](const std::string& from, const std::string& to) {
    std::string body = floor_body(
        matte("1,1,1"), R"(,{"camera":0},{"extensions":{"KHR_lights_punctual":{"light":0}}})",
        R"(,"cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":0.1}}],)"
        R"("extensions":{"KHR_lights_punctual":{"lights":[{"type":"point","intensity":5}]}})");
    const std::size_t at = body.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    body.replace(at, from.size(), to);
    return hash_of(parse_gltf(made_floor().glb(body), "t.glb"));
  };
  const std::string as_it_is = hash("[1,1,1,1]", "[1,1,1,1]");
  EXPECT_NE(as_it_is, hash("[1,1,1,1]", "[1,1,0.5,1]"));
  EXPECT_NE(as_it_is, hash(R"("yfov":1)", R"("yfov":1.1)"));
  EXPECT_NE(as_it_is, hash(R"("intensity":5)", R"("intensity":6)"));
  EXPECT_NE(as_it_is, hash(R"({"mesh":0})", R"({"mesh":0,"translation":[0,1,0]})"));
  EXPECT_NE(as_it_is, hash(R"("specularFactor":0)", R"("specularFactor":1)"));
}

}  // namespace
}  // namespace haarlight::render
