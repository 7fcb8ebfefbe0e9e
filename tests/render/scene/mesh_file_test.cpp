// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cstring>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/render/scene/scene_io.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using testing::TemporaryFolder;

TEST(ReadObj, ReadsTheTwinsAirplane) {
  const Scene scene = read_obj(HAARLIGHT_SOURCE_DIR "/configs/scenes/airplane.obj");
  std::size_t n_triangles = 0;
  std::size_t n_smooth = 0;
  for (const Mesh& mesh : scene.meshes) {
    n_triangles += mesh.triangles.size();
    n_smooth += mesh.normals.empty() ? 0 : 1;
    EXPECT_TRUE(mesh.normals.empty() || mesh.normals.size() == mesh.vertices.size());
  }
  EXPECT_EQ(n_triangles, 6998U - 232U);  // the file's faces less those without area
  EXPECT_GT(n_smooth, 0U);
  ASSERT_GE(scene.materials.size(), 4U);
  EXPECT_EQ(scene.materials[0].name, "kd0.8_ks0_n0");
  EXPECT_DOUBLE_EQ(scene.materials[0].kd.x(), 0.8);
  EXPECT_DOUBLE_EQ(scene.materials[1].ks, 0.3);
  EXPECT_DOUBLE_EQ(scene.materials[1].exponent, 60.0);
}

TEST(ReadObj, UnderstandsPolygonsNegativeIndicesAndNormals) {
  const Scene scene = parse_obj(
      "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 2\n"
      "usemtl a\nf 1//1 2//1 3//1 4//1\nusemtl b\nf -4 -3/7 -2 # comment\n",
      "t.obj");
  ASSERT_EQ(scene.meshes.size(), 2U);
  EXPECT_EQ(scene.meshes[0].triangles.size(), 2U);
  EXPECT_EQ(scene.meshes[0].normals.size(), 4U);
  EXPECT_DOUBLE_EQ(scene.meshes[0].normals[0].z(), 1.0);
  EXPECT_TRUE(scene.meshes[1].normals.empty());
  EXPECT_EQ(scene.meshes[1].material, 1);
}

TEST(ReadObj, TakesMaterialsFromTheLibraryBeside) {
  const TemporaryFolder folder;
  write_file_atomically(
      folder / "m.mtl",
      std::string_view("newmtl shiny\nKd 0.1 0.2 0.3\nKs 0.4 0.4 0.4\nNs 77\n"));
  write_file_atomically(
      folder / "m.obj",
      std::string_view("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl shiny\nf 1 2 3\n"));
  const Scene scene = read_obj(folder / "m.obj");
  ASSERT_EQ(scene.materials.size(), 1U);
  EXPECT_DOUBLE_EQ(scene.materials[0].kd.y(), 0.2);
  EXPECT_DOUBLE_EQ(scene.materials[0].ks, 0.4);
  EXPECT_DOUBLE_EQ(scene.materials[0].exponent, 77.0);
}

struct Broken {
  const char* text;
  const char* where;
};

TEST(ReadObj, NamesLineAndHintOfBrokenFiles) {
  const Broken broken[] = {
      {"", "t.obj"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "t.obj"},  // no face
      {"v 0 0\n", "t.obj:1"},
      {"v 0 0 nan\n", "t.obj:1"},
      {"v 0 0 inf\n", "t.obj:1"},
      {"v 0 0 1e999\n", "t.obj:1"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n", "t.obj:4"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "t.obj:4"},
      {"vn 0 0 0\n", "t.obj:1"},
      {"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "t.obj"},  // no area
      {"v 0 0 0\nv 1e200 0 0\nv 0 1e200 0\nf 1 2 3\n", "t.obj:4"},
  };
  for (const Broken& item : broken) {
    try {
      static_cast<void>(parse_obj(item.text, "t.obj"));
      ADD_FAILURE() << item.text;
    } catch (const Error& error) {
      EXPECT_EQ(error.where(), item.where) << item.text;
      EXPECT_FALSE(error.hint().empty());
    }
  }
  EXPECT_THROW(static_cast<void>(read_obj("/nowhere/x.obj")), Error);
}

const std::string kAsciiHead =
    "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 3\nproperty float x\n"
    "property float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n";

std::string binary_ply(float z2 = 0.0F, int last = 2) {
  std::string bytes = kAsciiHead;
  bytes.replace(bytes.find("ascii"), 5, "binary_little_endian");
  const std::array<float, 9> vertices = {0, 0, 0, 1, 0, 0, 0, 1, z2};
  bytes.append(reinterpret_cast<const char*>(vertices.data()), sizeof vertices);
  bytes += '\3';
  const std::array<int, 3> face = {0, 1, last};
  bytes.append(reinterpret_cast<const char*>(face.data()), sizeof face);
  return bytes;
}

TEST(ReadPly, ReadsAsciiAndBinaryAlike) {
  const Scene ascii = parse_ply(kAsciiHead + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "t.ply");
  const Scene binary = parse_ply(binary_ply(), "t.ply");
  for (const Scene* scene : {&ascii, &binary}) {
    ASSERT_EQ(scene->meshes.size(), 1U);
    EXPECT_EQ(scene->meshes[0].vertices.size(), 3U);
    EXPECT_DOUBLE_EQ(scene->meshes[0].vertices[2].y(), 1.0);
    EXPECT_EQ(scene->meshes[0].triangles[0], Eigen::Vector3i(0, 1, 2));
  }
}

TEST(ReadPly, SkipsWhatItDoesNotNeedAndKeepsNormals) {
  const Scene scene = parse_ply(
      "ply\nformat ascii 1.0\nelement camera 1\nproperty list uchar float junk\n"
      "element vertex 4\nproperty double nx\nproperty double ny\nproperty double nz\n"
      "property double x\nproperty double y\nproperty double z\nproperty uchar red\n"
      "element face 1\nproperty uchar flag\nproperty list uchar uint vertex_index\nend_header\n"
      "2 1.5 2.5\n"
      "0 0 2 0 0 0 9\n0 0 2 1 0 0 9\n0 0 2 1 1 0 9\n0 0 2 0 1 0 9\n"
      "7 4 0 1 2 3\n",
      "t.ply");
  EXPECT_EQ(scene.meshes[0].triangles.size(), 2U);
  EXPECT_DOUBLE_EQ(scene.meshes[0].normals[3].z(), 1.0);
}

TEST(ReadPly, NamesPositionAndHintOfBrokenFiles) {
  const std::string big_endian = "ply\nformat binary_big_endian 1.0\nend_header\n";
  const std::string broken[] = {
      "",
      "plywood\n",
      "ply\nelement vertex 3\n",
      "ply\nend_header\n",
      big_endian,
      "ply\nformat ascii 1.0\nelement vertex many\nend_header\n",
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty colour x\nend_header\n",
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float a\nend_header\n1 2 3\n",
      "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
      kAsciiHead + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
      kAsciiHead + "0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n",
      kAsciiHead + "0 0 0\n1 0 0\n0 1 0\n2 0 1\n",
      kAsciiHead + "0 0 0\n1 0 0\n0 1 nan\n3 0 1 2\n",
      kAsciiHead + "0 0 0\n1 0 0\n",
      kAsciiHead + "0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n",
      binary_ply().substr(0, binary_ply().size() - 1),
      binary_ply(0.0F, -1),
      binary_ply(std::numeric_limits<float>::infinity()),
  };
  for (const std::string& bytes : broken) {
    try {
      static_cast<void>(parse_ply(bytes, "t.ply"));
      ADD_FAILURE() << bytes;
    } catch (const Error& error) {
      EXPECT_TRUE(error.where().starts_with("t.ply")) << error.where();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

TEST(MaterialNames, DecodeAsTheTwinsSay) {
  Material material;
  EXPECT_TRUE(decode_material_name("kd0.3_ks0.8_n200_smooth", material));
  EXPECT_DOUBLE_EQ(material.kd.z(), 0.3);
  EXPECT_DOUBLE_EQ(material.ks, 0.8);
  EXPECT_DOUBLE_EQ(material.exponent, 200.0);
  for (const char* name : {"", "kd", "kd0.3", "kd0.3_ks0.8", "kdx_ks0_n0",
                           "kd0.3_ks0.8_n200_matt", "kd-1_ks0_n0", "kdnan_ks0_n0"}) {
    EXPECT_FALSE(decode_material_name(name, material)) << name;
  }
}

RC_GTEST_PROP(ReadObj, GivesBackWhatWasWritten, ()) {
  const int n = *rc::gen::inRange(1, 20);
  std::string text;
  std::vector<Eigen::Vector3d> corners;
  for (int i = 0; i < 3 * n; ++i) {
    const Eigen::Vector3d v(i + *rc::gen::inRange(-100, 100) / 7.0, (i % 3) * 50.0,
                            (i % 3 == 1 ? 1e3 : 0.0) + *rc::gen::inRange(-100, 100) / 3.0);
    corners.push_back(v);
    text += fmt::format("v {} {} {}\n", v.x(), v.y(), v.z());
    if (i % 3 == 2) {
      text += fmt::format("f {} {} {}\n", i - 1, i, i + 1);
    }
  }
  const Scene scene = parse_obj(text, "t.obj");
  RC_ASSERT(scene.meshes.size() == 1U);
  const Mesh& mesh = scene.meshes[0];
  RC_ASSERT(mesh.triangles.size() == static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < corners.size(); ++i) {
    RC_ASSERT(mesh.vertices[static_cast<std::size_t>(
                  mesh.triangles[i / 3][static_cast<int>(i % 3)])] == corners[i]);
  }
}

}  // namespace
}  // namespace haarlight::render
