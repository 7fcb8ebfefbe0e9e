// SPDX-License-Identifier: Apache-2.0
/// @file
/// Broken glTF files: each is refused by what is wrong and where, with a hint.

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene_io.h"
#include "tests/render/scene/gltf_made.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

struct Broken {
  std::string bytes;
  std::string where;    ///< of the error
  std::string problem;  ///< words in it
};

void expect_refused(const Broken& broken) {
  try {
    (void)parse_gltf(broken.bytes, "t.glb");
    ADD_FAILURE() << broken.where << ": " << broken.problem << " was read";
  } catch (const Error& error) {
    EXPECT_EQ(error.where(), broken.where) << error.problem();
    EXPECT_NE(error.problem().find(broken.problem), std::string::npos)
        << error.problem() << ", not " << broken.problem;
    EXPECT_FALSE(error.hint().empty());
  }
}

/// A whole file, with one piece of it exchanged.
std::string changed(std::string_view from, std::string_view to) {
  std::string body = floor_body(
      matte("1,1,1"),
      R"(,{"camera":0,"children":[2]},{"extensions":{"KHR_lights_punctual":{"light":0}}})",
      R"(,"cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":0.1}}],)"
      R"("extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","intensity":5,)"
      R"("spot":{"outerConeAngle":0.5}}]}},"textures":[{"source":0}],"samplers":[],)"
      R"("images":[{"uri":"data:image/png;base64,AAAA"}])");
  body.replace(body.find(R"("nodes":[0,1,2])"), 15, R"("nodes":[0,1])");
  const MadeGltf made = made_floor();
  std::string json = made.json(
      body, fmt::format(R"(,"uri":"data:;base64,{}")", MadeGltf::base64(made.binary())));
  const std::size_t at = json.find(from);
  EXPECT_NE(at, std::string::npos) << from << " in " << json;
  return json.replace(at, from.size(), to);
}

TEST(GltfBroken, ContainersNameTheByte) {
  const std::string whole = made_floor().glb(floor_body(matte("1,1,1")));
  (void)parse_gltf(whole, "t.glb");
  expect_refused({"glTF", "t.glb: byte 4", "ends within its header"});
  expect_refused({whole.substr(0, 100), "t.glb: byte 8", "but there are 100"});
  std::string other = whole;
  other[4] = 1;
  expect_refused({other, "t.glb: byte 4", "version 1"});
  other = whole;
  other[16] = 'X';
  expect_refused({other, "t.glb: byte 16", "not JSON"});
  other = whole;
  other[13] = static_cast<char>(0xff);
  expect_refused({other, "t.glb: byte 12", "not there"});
  expect_refused({"", "t.glb", "not JSON"});
  expect_refused({std::string(100, '['), "t.glb", "brackets"});
  // Without its binary chunk.
  const MadeGltf made = made_floor();
  expect_refused({made.json(floor_body(matte("1,1,1"))), "t.glb: buffers[0]", "without a uri"});
}

TEST(GltfBroken, ValuesNameTheirPlace) {
  (void)parse_gltf(changed(R"("scenes")", R"("scenes")"), "t.glb");
  const Broken broken[] = {
      {changed(R"("version":"2.0")", R"("version":"1.0")"), "t.glb: asset.version", "glTF 1.0"},
      {changed(R"("asset")", R"("set")"), "t.glb", "\"asset\" is missing"},
      {changed(R"("scenes":)",
               R"("extensionsRequired":["KHR_draco_mesh_compression"],"scenes":)"),
       "t.glb: extensionsRequired[0]", "KHR_draco_mesh_compression"},
      {changed(R"("scenes":)", R"("scene":1,"scenes":)"), "t.glb: scene", "number 1"},
      {changed(R"("scenes":[{"nodes":[0,1]}])", R"("scenes":[])"), "t.glb", "no scene"},
      {changed(R"("nodes":[0,1])", R"("nodes":[0,9])"), "t.glb: scenes[0].nodes[1]",
       "number 9"},
      {changed(R"("children":[2])", R"("children":[1])"), "t.glb: nodes[1].children[0]",
       "twice"},
      {changed(R"("children":[2])", R"("children":[0])"), "t.glb: nodes[1].children[0]",
       "twice"},
      {changed(R"({"mesh":0})", R"({"mesh":0,"scale":[1,2]})"), "t.glb: nodes[0].scale",
       "2 numbers"},
      {changed(R"({"mesh":0})", R"({"mesh":0,"scale":[1e99,1,1]})"), "t.glb: nodes[0].scale[0]",
       "outside"},
      {changed(R"({"mesh":0})", R"({"mesh":0,"translation":[1e8,0,0]})"), "t.glb: nodes[0]",
       "beyond 1e9 mm"},
      {changed(R"({"mesh":0})", R"({"mesh":0,"rotation":[0,0,0,0]})"),
       "t.glb: nodes[0].rotation", "no quaternion"},
      {changed(R"({"mesh":0})", R"({"mesh":0,"matrix":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]})"),
       "t.glb: nodes[0].matrix", "last row"},
      {changed(R"({"mesh":0})", R"({"mesh":-1})"), "t.glb: nodes[0].mesh", "outside"},
      {changed(R"({"mesh":0})", R"({"mesh":"0"})"), "t.glb: nodes[0].mesh", "whole number"},
      {changed(R"("indices":1)", R"("indices":7)"), "t.glb: meshes[0].primitives[0].indices",
       "number 7"},
      {changed(R"("indices":1)", R"("indices":0)"), "t.glb: accessors[0].type", "SCALAR"},
      {changed(R"("material":0)", R"("material":3)"), "t.glb: meshes[0].primitives[0].material",
       "of 1"},
      {changed(R"("material":0)", R"("mode":9)"), "t.glb: meshes[0].primitives[0].mode",
       "outside"},
      {changed(R"("count":6)", R"("count":5)"), "t.glb: meshes[0].primitives[0]",
       "multiple of 3"},
      {changed(R"("count":6)", R"("count":7)"), "t.glb: accessors[1]", "7 elements"},
      {changed(R"("count":6)", R"("count":4294967295)"), "t.glb: accessors[1]", "elements"},
      {changed(R"("bufferView":0,"componentType":5126,"count":4)",
               R"("componentType":5126,"count":4000000000)"),
       "t.glb: accessors[0]", "without bytes"},
      {changed(R"("count":4)", R"("count":0)"), "t.glb: accessors[0].count", "outside"},
      {changed(R"("componentType":5123)", R"("componentType":5124)"),
       "t.glb: accessors[1].componentType", "5124"},
      {changed(R"("byteOffset":48,"byteLength":12)", R"("byteOffset":48,"byteLength":99)"),
       "t.glb: bufferViews[1]", "of a buffer of"},
      {changed(R"("buffer":0,)", R"("buffer":1,)"), "t.glb: bufferViews[0].buffer", "number 1"},
      {changed(R"("byteLength":92)", R"("byteLength":93)"), "t.glb: buffers[0]",
       "but there are"},
      {changed("base64,", "base64,!"), "t.glb: buffers[0].uri", "no base64"},
      {changed("data:;base64,", "data:,"), "t.glb: buffers[0].uri", "not in base64"},
      {changed("data:;base64,", "https://example.org/"), "t.glb: buffers[0].uri", "no file"},
      {changed("[1,1,1,1]", "[1,1,2,1]"),
       "t.glb: materials[0].pbrMetallicRoughness."
       "baseColorFactor[2]",
       "outside"},
      {changed(R"("metallicFactor":0)", R"("metallicFactor":"a")"),
       "t.glb: materials[0].pbrMetallicRoughness.metallicFactor", "expected a number"},
      {changed(R"("metallicFactor":0)", R"("metallicFactor":0,"baseColorTexture":{"index":1})"),
       "t.glb: materials[0].pbrMetallicRoughness.baseColorTexture.index", "number 1"},
      {changed(R"("yfov":1)", R"("yfov":4)"), "t.glb: cameras[0].perspective.yfov", "outside"},
      {changed(R"("znear":0.1)", R"("znear":5,"zfar":2)"), "t.glb: cameras[0].perspective",
       "sees nothing"},
      {changed(R"("type":"perspective")", R"("type":"fisheye")"), "t.glb: cameras[0].type",
       "none of"},
      {changed(R"("outerConeAngle":0.5)", R"("outerConeAngle":3)"),
       "t.glb: extensions.KHR_lights_punctual.lights[0].spot.outerConeAngle", "outside"},
      {changed(R"("intensity":5)", R"("intensity":-5)"),
       "t.glb: extensions.KHR_lights_punctual.lights[0].intensity", "outside"},
      {changed(R"({"light":0})", R"({"light":1})"),
       "t.glb: nodes[2].extensions.KHR_lights_punctual.light", "number 1"},
  };
  for (const Broken& one : broken) {
    expect_refused(one);
  }
}

TEST(GltfBroken, NumbersNameTheirElement) {
  MadeGltf made;
  made.add_points({0, 0, 0, 1, 0, 0, 0, std::numeric_limits<float>::quiet_NaN(), 1});
  const auto body = [](std::string_view primitive) {
    return fmt::format(
        R"(,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{}]}}])",
        primitive);
  };
  expect_refused({made.glb(body(R"({"attributes":{"POSITION":0}})")), "t.glb: accessors[0]",
                  "element 2 is not a finite number"});
  MadeGltf far = made_floor();
  far.add_indices({0, 1, 4});
  expect_refused({far.glb(body(R"({"attributes":{"POSITION":0},"indices":3})")),
                  "t.glb: meshes[0].primitives[0].indices", "index 2 is 4, of 4 vertices"});
  expect_refused({far.glb(body(R"({"attributes":{"POSITION":0,"NORMAL":2},"indices":1})")),
                  "t.glb: accessors[2].type", "wants VEC3"});
  // Points and lines alone are no surface.
  expect_refused(
      {far.glb(body(R"({"attributes":{"POSITION":0},"mode":1})")), "t.glb", "no triangles"});
  // Nor is a texture without coordinates.
  expect_refused({far.glb(body(R"({"attributes":{"POSITION":0},"indices":1,"material":0})") +
                          R"(,"materials":[{"pbrMetallicRoughness":{"metallicFactor":0,)"
                          R"("baseColorTexture":{"index":0}}}],"textures":[{"source":0}],)"
                          R"("images":[{"uri":"data:image/png;base64,AAAA"}])"),
                  "t.glb: meshes[0].primitives[0].attributes", "no TEXCOORD_0"});
}

TEST(GltfBroken, FilesBesideItAreNamed) {
  const testing::TemporaryFolder folder;
  const MadeGltf made = made_floor();
  write_file_atomically(
      folder / "s.gltf",
      std::string_view(made.json(floor_body(matte("1,1,1")), R"(,"uri":"gone.bin")")));
  try {
    (void)read_scene(folder / "s.gltf");
    FAIL() << "bytes that are not there";
  } catch (const Error& error) {
    EXPECT_EQ(error.where(), (folder / "s.gltf").string() + ": buffers[0].uri");
    EXPECT_NE(error.problem().find("gone.bin"), std::string::npos) << error.problem();
  }
}

}  // namespace
}  // namespace haarlight::render
