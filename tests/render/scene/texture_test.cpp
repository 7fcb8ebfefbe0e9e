// SPDX-License-Identifier: Apache-2.0
#include "render/scene/texture.h"

#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/bsdf/bsdf.h"
#include "render/scene/texture_files.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using testing::TemporaryFolder;

double number(std::uint64_t key) { return uniform_unit(hash_key(7, key)); }

Image<float> random_picture(int height, int width, int channels) {
  Image<float> picture(height, width, channels);
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    picture.pixels()[i] = static_cast<float>(number(i));
  }
  return picture;
}

/// The definition of bilinear: the endlessly repeated texels under tents of two texels' width.
Vector3d sum_of_tents(const Image<float>& picture, const Vector2d& uv) {
  const auto tent = [](double distance) { return std::max(0.0, 1.0 - std::abs(distance)); };
  const double x = uv.x() * picture.width();
  const double y = -uv.y() * picture.height();  // rows go down, the bottom row ends at v = 0
  const auto modulo = [](int i, int n) { return ((i % n) + n) % n; };
  Vector3d sum = Vector3d::Zero();
  const int left = static_cast<int>(std::floor(x)) - 2;
  const int top = static_cast<int>(std::floor(y)) - 2;
  for (int j = top; j < top + 5; ++j) {
    for (int i = left; i < left + 5; ++i) {
      for (int c = 0; c < 3; ++c) {
        sum[c] += tent(x - (i + 0.5)) * tent(y - (j + 0.5)) *
                  picture(modulo(j, picture.height()), modulo(i, picture.width()),
                          picture.channels() == 3 ? c : 0);
      }
    }
  }
  return sum;
}

TEST(Texture, IsTheTexelsUnderTents) {
  for (const int channels : {1, 3}) {
    const Image<float> picture = random_picture(3, 4, channels);
    const Texture texture(picture);
    for (std::uint64_t i = 0; i < 1000; ++i) {
      const Vector2d uv(6.0 * number(1000 + 2 * i) - 3.0, 6.0 * number(1001 + 2 * i) - 3.0);
      // Texels of up to 12 are rounded at 2^-50 or so.
      EXPECT_LE((texture.at(uv) - sum_of_tents(picture, uv)).cwiseAbs().maxCoeff(), 1e-14)
          << uv.transpose();
    }
  }
}

TEST(Texture, VGoesUpAndRowsGoDown) {
  const Image<float> picture = random_picture(4, 8, 3);  // their centres are exact in binary
  const Texture texture(picture);
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 8; ++x) {
      const Vector3d found = texture.at({(x + 0.5) / 8.0, 1.0 - (y + 0.5) / 4.0});
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(found[c], picture(y, x, c));
      }
    }
  }
}

TEST(Texture, RepeatsWithoutEnd) {
  const Texture texture(random_picture(5, 7, 3));
  for (const double u : {0.0, 0.0625, 0.3125, 0.9375}) {  // exact beside a million, too
    for (const double shift : {1.0, -1.0, 7.0, -3.0, 1e6, -1e6}) {
      EXPECT_EQ(texture.at({u + shift, 0.8125}), texture.at({u, 0.8125})) << u << ' ' << shift;
      EXPECT_EQ(texture.at({0.8125, u + shift}), texture.at({0.8125, u})) << u << ' ' << shift;
    }
  }
  // Opposite sides are joined: half of the first and half of the last column.
  const Image<float> sides = random_picture(1, 3, 1);
  EXPECT_NEAR(Texture(sides).at({1.0, 0.5}).x(), 0.5 * (sides(0, 0) + sides(0, 2)), 1e-16);
}

TEST(Texture, AtExtremesStaysWithinItsTexels) {
  Image<float> one(1, 1, 3);
  one(0, 0, 0) = 0.25F;
  one(0, 0, 2) = 1.0F;
  const Texture constant(one);
  const Texture wide(random_picture(1, 1000, 1));
  const double tiny = std::numeric_limits<double>::denorm_min();
  for (const double u : {0.0, -0.0, tiny, -tiny, -1e-300, 1e-17, -1e-17, 0.5, 1.0 - 0x1p-53,
                         1.0, 1e15, -1e15, 1e300, -1e300}) {
    for (const double v : {0.0, -1e-300, 0.3, 1.0, 1e15}) {
      EXPECT_EQ(constant.at({u, v}), Vector3d(0.25, 0.0, 1.0)) << u << ' ' << v;
      EXPECT_GE(wide.at({u, v}).minCoeff(), 0.0);
      EXPECT_LE(wide.at({u, v}).maxCoeff(), 1.0);
    }
  }
  EXPECT_THROW(Texture(Image<float>(0, 4, 3)), ContractViolation);
  EXPECT_THROW(Texture(Image<float>(4, 4, 2)), ContractViolation);
}

TEST(Texture, IsKnownByItsTexels) {
  Image<float> picture = random_picture(3, 4, 1);
  const std::string hash = Texture(picture).hash();
  EXPECT_EQ(Texture(picture).hash(), hash);
  picture(2, 3) += 0x1p-20F;
  EXPECT_NE(Texture(picture).hash(), hash);
  EXPECT_NE(Texture(Image<float>(2, 3, 1)).hash(), Texture(Image<float>(3, 2, 1)).hash());
}

// Texture coordinates of meshes.

TEST(ReadObj, MakesAVertexOfEachCombination) {
  // Two triangles of a square: at corner 3 they have different texture coordinates.
  const Scene scene = parse_obj(
      "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0 0.5\nvt 1 1\nvt 0.25\n"
      "f 1/1 2/2 3/3\nf 1/1 3/-1 4/-2\n",
      "t.obj");
  ASSERT_EQ(scene.meshes.size(), 1U);
  const Mesh& mesh = scene.meshes[0];
  // In the order of the faces.
  EXPECT_EQ(mesh.triangles[0], Eigen::Vector3i(0, 1, 2));
  EXPECT_EQ(mesh.triangles[1], Eigen::Vector3i(0, 3, 4));
  ASSERT_EQ(mesh.vertices.size(), 5U);
  ASSERT_EQ(mesh.uvs.size(), 5U);
  EXPECT_EQ(mesh.vertices[2], mesh.vertices[3]);
  EXPECT_EQ(mesh.uvs[1], Vector2d(1.0, 0.0));
  EXPECT_EQ(mesh.uvs[2], Vector2d(1.0, 1.0));
  EXPECT_EQ(mesh.uvs[3], Vector2d(0.25, 0.0));
  EXPECT_EQ(mesh.uvs[4], Vector2d(1.0, 1.0));
}

TEST(ReadObj, KeepsMeshesWithoutTextureCoordinatesApart) {
  const std::string corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\n";
  const std::string faces = "f 1//1 2//1 3//1\nf 1//1 3//1 4//1\n";
  const Scene without = parse_obj(corners + faces, "t.obj");
  ASSERT_EQ(without.meshes.size(), 1U);
  EXPECT_EQ(without.meshes[0].vertices.size(), 4U);
  EXPECT_TRUE(without.meshes[0].uvs.empty());
  // A face where only one corner has one is a face without.
  const Scene mixed =
      parse_obj(corners + "f 1/1/1 2//1 3//1\nf 1/1/1 3/2/1 4/1/1\n" + faces, "t.obj");
  ASSERT_EQ(mixed.meshes.size(), 2U);
  EXPECT_TRUE(mixed.meshes[0].uvs.empty());
  EXPECT_EQ(mixed.meshes[0].triangles.size(), 3U);
  EXPECT_EQ(mixed.meshes[1].uvs.size(), 3U);
  EXPECT_EQ(mixed.meshes[1].normals.size(), 3U);
}

TEST(ReadObj, NamesTheLineOfABadTextureCoordinate) {
  const std::string corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  const struct {
    std::string text;
    int line;
    const char* problem;
  } broken[] = {
      {"vt\n", 1, "no texture coordinate"},
      {"vt nan 0\n", 1, "'nan' is no texture coordinate"},
      {"vt 0 inf\n", 1, "'inf' is no texture coordinate"},
      {"vt 0 2e9\n", 1, "'2e9' is no texture coordinate"},
      {"vt 0 x\n", 1, "'x' is no texture coordinate"},
      {corners + "f 1/1 2/1 3/1\n", 4, "texture coordinate 1 of 0"},
      {corners + "vt 0 0\nf 1/1 2/1 3/2\n", 5, "texture coordinate 2 of 1"},
      {corners + "vt 0 0\nf 1/1 2/1 3/-2\n", 5, "texture coordinate -2 of 1"},
      {corners + "vt 0 0\nf 1/1 2/1 3/0\n", 5, "'0' is not the index of a texture coordinate"},
      {corners + "vt 0 0\nf 1/1 2/1 3/x\n", 5, "'x' is not the index of a texture coordinate"},
  };
  for (const auto& [text, line, problem] : broken) {
    try {
      static_cast<void>(parse_obj(text, "t.obj"));
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.where(), fmt::format("t.obj:{}", line));
      EXPECT_NE(error.problem().find(problem), std::string::npos) << error.problem();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

/// A triangle's file with two further properties per vertex.
std::string ply_with(const std::string& u, const std::string& v, const std::string& last) {
  return fmt::format(
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
      "property float z\nproperty double {}\nproperty double {}\nelement face 1\n"
      "property list uchar int vertex_indices\nend_header\n"
      "0 0 0 0 0\n1 0 0 1 0\n0 1 0 {}\n3 0 1 2\n",
      u, v, last);
}

TEST(ReadPly, TakesTextureCoordinatesByTheirUsualNames) {
  const struct {
    const char* u;
    const char* v;
  } names[] = {{"u", "v"}, {"s", "t"}, {"texture_u", "texture_v"}};
  for (const auto& [u, v] : names) {
    const Mesh mesh = parse_ply(ply_with(u, v, "-0.25 1.5"), "t.ply").meshes.at(0);
    ASSERT_EQ(mesh.uvs.size(), 3U) << u;
    EXPECT_EQ(mesh.uvs[1], Vector2d(1.0, 0.0));
    EXPECT_EQ(mesh.uvs[2], Vector2d(-0.25, 1.5));
  }
  EXPECT_TRUE(parse_ply(ply_with("u", "t", "0 1"), "t.ply").meshes.at(0).uvs.empty());
  for (const char* bad : {"nan 0", "0 inf", "0 2e9", "-2e9 0"}) {
    try {
      static_cast<void>(parse_ply(ply_with("s", "t", bad), "t.ply"));
      ADD_FAILURE() << bad;
    } catch (const Error& error) {
      EXPECT_EQ(error.problem(), "vertex 2 has no usable texture coordinates");
      EXPECT_TRUE(error.where().starts_with("t.ply:")) << error.where();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

// Textures of materials.

/// A folder with a textured triangle and a scene beside it.
class Textured : public ::testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) const {
    write_file_atomically(folder_ / name, std::string_view(text));
  }
  /// A 2 x 2 picture, as PNG of sRGB codes or as EXR of linear numbers.
  void write_picture(const std::string& name, float last = 0.5F) const {
    Image<float> picture(2, 2, 3);
    picture(0, 0, 0) = 1.0F;
    picture(0, 1, 1) = 1.0F;
    picture(1, 0, 2) = 1.0F;
    picture(1, 1, 0) = last;
    write_image(folder_ / name, picture.view());
  }
  [[nodiscard]] SceneFile scene_of(const std::string& text) const {
    write("s.toml", text);
    return read_scene(folder_ / "s.toml");
  }
  /// The error of reading the scene and its textures.
  [[nodiscard]] Error error_of(const std::string& text,
                               std::uint64_t memory_bytes = 1'000'000) const {
    try {
      SceneFile file = scene_of(text);
      load_textures(file.scene, memory_bytes);
    } catch (const Error& error) {
      return error;
    }
    ADD_FAILURE() << text;
    return {"", "", ""};
  }
  void expect_error(const std::string& text, const std::string& where,
                    const std::string& problem) const {
    const Error error = error_of(text);
    EXPECT_NE(error.problem().find(problem), std::string::npos)
        << text << ": " << error.problem();
    EXPECT_EQ(error.where(), (folder_ / where).string()) << text;
    EXPECT_FALSE(error.hint().empty());
    EXPECT_EQ(error.hint().find("unknown key"), std::string::npos) << error.hint();
  }

  TemporaryFolder folder_;
};

const std::string kMaterial = "[[material]]\nname = \"a\"\nkd_texture = \"p.png\"\n";
const std::string kQuad =
    "[[quad]]\ncorners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]\nmaterial = \"a\"\n";

TEST_F(Textured, MaterialsOfASceneFile) {
  write_picture("p.png");
  SceneFile file = scene_of(kMaterial + "texture_scale = [4, -2]\n" + kQuad +
                            "[[material]]\nname = \"b\"\nbsdf = \"coated\"\nkd = [0.5]\n"
                            "kd_texture = \"p.png\"\n");
  const Material& first = file.scene.materials[0];
  EXPECT_EQ(first.kd, Vector3d::Ones());  // a texture's default
  EXPECT_EQ(first.kd_texture.scale, Vector2d(4.0, -2.0));
  EXPECT_EQ(first.kd_texture.where, (folder_ / "s.toml").string() + ":3");
  const Material& second = file.scene.materials[1];
  EXPECT_EQ(second.kd, Vector3d::Constant(0.5));
  EXPECT_EQ(second.kd_texture.scale, Vector2d::Ones());
  const LoadedTextures loaded = load_textures(file.scene, 1000);
  EXPECT_EQ(loaded.files.size(), 1U);
  EXPECT_EQ(loaded.bytes, 48U);  // 2 x 2 texels of three floats
  EXPECT_EQ(first.kd_texture.picture, second.kd_texture.picture);
  // The picture's top left texel is red; its last texel is a decoded sRGB code.
  EXPECT_EQ(first.kd_texture.picture->at({0.25, 0.75}), Vector3d(1.0, 0.0, 0.0));
  EXPECT_FLOAT_EQ(static_cast<float>(first.kd_texture.picture->at({0.75, 0.25}).x()),
                  linear_from_srgb(188.0F / 255.0F));  // the code nearest to 0.5
}

TEST_F(Textured, MaterialsOfAnObjFile) {
  write_picture("p.exr", 0.75F);
  write("m.mtl",
        "newmtl bare\nmap_Kd p.exr\nnewmtl tinted\nmap_Kd -s 2 3 1 p.exr\nKd 0.5 0.25 1\n");
  write("m.obj",
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "usemtl bare\nf 1/1 2/2 3/3\nusemtl tinted\nf 1/1 2/2 3/3\n");
  SceneFile file = scene_of("[[mesh]]\nfile = \"m.obj\"\nscale = 2\nrotate_z_deg = 90\n");
  load_textures(file.scene, 1000);
  ASSERT_EQ(file.scene.materials.size(), 2U);
  EXPECT_EQ(file.scene.materials[0].kd, Vector3d::Ones());
  EXPECT_EQ(file.scene.materials[1].kd, Vector3d(0.5, 0.25, 1.0));
  EXPECT_EQ(file.scene.materials[1].kd_texture.scale, Vector2d(2.0, 3.0));
  EXPECT_EQ(file.scene.materials[0].kd_texture.picture->at({0.75, 0.25}).x(), 0.75);  // linear
  for (const Mesh& mesh : file.scene.meshes) {
    ASSERT_EQ(mesh.uvs.size(), 3U);  // neither turned nor scaled
    EXPECT_EQ(mesh.uvs[1], Vector2d(1.0, 0.0));
  }
  Scene appended;
  append_scene(appended, file.scene);
  EXPECT_EQ(appended.meshes[1].uvs, file.scene.meshes[1].uvs);
  EXPECT_EQ(appended.materials[1].kd_texture.picture,
            file.scene.materials[1].kd_texture.picture);
}

TEST_F(Textured, BrokenOnesAreNamed) {
  write_picture("p.png");
  write("text.png", "no picture");
  write("empty.png", "");
  write("flat.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 0\n");
  write("flat.obj", "o wing\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  const auto with = [](const std::string& picture) {
    return "[[material]]\nname = \"a\"\nkd_texture = \"" + picture + "\"\n" + kQuad;
  };
  expect_error(with("missing.png"), "s.toml:3", "missing.png");
  expect_error(with("text.png"), "s.toml:3", "text.png");
  expect_error(with("empty.png"), "s.toml:3", "empty.png");
  expect_error(with("flat.hdr"), "s.toml:3", "flat.hdr");
  expect_error(with("."), "s.toml:3", "the texture:");
  expect_error(with(""), "s.toml:3", "kd_texture names no file");
  expect_error(kMaterial + "texture_scale = [1]\n" + kQuad, "s.toml:4", "texture_scale");
  expect_error(kMaterial + "texture_scale = [1, 2e6]\n" + kQuad, "s.toml:4", "texture_scale");
  expect_error("[[material]]\nname = \"a\"\ntexture_scale = [1, 1]\n" + kQuad, "s.toml:3",
               "a scale without a texture");
  expect_error(kMaterial + "ks = 0.2\n" + kQuad, "s.toml:4", "kd + ks = 1.2");
  expect_error(kMaterial + "bsdf = \"mirror\"\n" + kQuad, "s.toml:3",
               "kd_texture is no key of bsdf = \"mirror\"");
  expect_error(kMaterial +
                   "[[disk]]\ncentre = [0, 0, 0]\nnormal = [0, 0, 1]\nradius = 1\n"
                   "material = \"a\"\n",
               "s.toml:8", "a disk has no texture coordinates; material 'a' has a texture");
  expect_error(kMaterial + "[[mesh]]\nfile = \"flat.obj\"\nmaterial = \"a\"\n", "s.toml:6",
               "'wing' of flat.obj has no texture coordinates");
}

TEST_F(Textured, BrokenMaterialsOfAnObjFileAreNamed) {
  write_picture("p.png");
  const auto mesh = [&](const std::string& library, const std::string& face) {
    write("m.mtl", "newmtl x\n" + library + "\n");
    write("m.obj", "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl x\n" + face + "\n");
    return "[[mesh]]\nfile = \"m.obj\"\n";
  };
  const std::string good = "f 1/1 2/1 3/1";
  expect_error(mesh("map_Kd", good), "s.toml:2", "map_Kd names no file");
  expect_error(mesh("map_Kd -s 1 1 1", good), "s.toml:2", "map_Kd names no file");
  expect_error(mesh("map_Kd -s x p.png", good), "s.toml:2", "map_Kd's -s needs numbers");
  expect_error(mesh("map_Kd -o 1 1 p.png", good), "s.toml:2", "map_Kd's option '-o'");
  expect_error(mesh("map_Kd p.png", "f 1 2 3"), "s.toml:2", "has no texture coordinates");
  expect_error(mesh("map_Kd missing.png", good), "m.mtl:2", "missing.png");
}

TEST_F(Textured, AlbedosOutsideTheUnitRangeAreNamedByTheirPixel) {
  const auto with = [](const std::string& picture) {
    return "[[material]]\nname = \"a\"\nkd_texture = \"" + picture + "\"\n" + kQuad;
  };
  write_picture("bright.exr", 3.0F);
  expect_error(with("bright.exr"), "s.toml:3", "pixel (x 1, y 1) of texture");
  EXPECT_NE(error_of(with("bright.exr")).problem().find("bright.exr is 3 in red"),
            std::string::npos);
  write_picture("dark.exr", -0.01F);
  expect_error(with("dark.exr"), "s.toml:3", "pixel (x 1, y 1) of texture");
  write_picture("nan.exr", std::numeric_limits<float>::quiet_NaN());
  expect_error(with("nan.exr"), "s.toml:3", "pixel (x 1, y 1) is not a finite number");
  write_picture("rounded.exr", 1.00005F);  // as a conversion between colour spaces leaves it
  SceneFile file = scene_of(with("rounded.exr"));
  load_textures(file.scene, 1000);
  EXPECT_EQ(file.scene.materials[0].kd_texture.picture->at({0.75, 0.25}).x(), 1.0);
}

TEST_F(Textured, TexelsKeepToTheMemory) {
  write_picture("p.png");
  write_picture("q.png");
  const std::string two =
      kMaterial + kQuad + "[[material]]\nname = \"b\"\nkd_texture = \"q.png\"\n";
  SceneFile file = scene_of(two);
  EXPECT_EQ(load_textures(file.scene, 96).bytes, 96U);
  const Error error = error_of(two, 95);
  EXPECT_NE(error.problem().find("q.png"), std::string::npos) << error.problem();
  EXPECT_EQ(error.where(), (folder_ / "s.toml").string() + ":9");
  EXPECT_EQ(error.code(), ExitCode::usage);
}

TEST_F(Textured, ASceneIsKnownByItsTexelsAndCoordinates) {
  const auto hash = [&](const std::string& text) {
    SceneFile file = scene_of(text);
    load_textures(file.scene, 1000);
    return hash_of(file);
  };
  write_picture("p.png");
  const std::string known = hash(kMaterial + kQuad);
  EXPECT_EQ(hash(kMaterial + kQuad), known);
  EXPECT_NE(hash(kMaterial + "texture_scale = [1, 2]\n" + kQuad), known);
  EXPECT_NE(hash("[[material]]\nname = \"a\"\nkd = [1]\n" + kQuad), known);
  SceneFile file = scene_of(kMaterial + kQuad);
  EXPECT_THROW(static_cast<void>(hash_of(file)), ContractViolation);  // not loaded
  load_textures(file.scene, 1000);
  EXPECT_EQ(hash_of(file), known);
  file.scene.meshes[0].uvs[2].x() = 0.5;
  EXPECT_NE(hash_of(file), known);
  write_picture("p.png", 0.7F);
  EXPECT_NE(hash(kMaterial + kQuad), known);
  write_picture("p.png");
  EXPECT_EQ(hash(kMaterial + kQuad), known);
}

// At a hit.

/// Hit by a ray from above or, with a small slope, nearly along the surface.
std::optional<Hit> look_at_point(const RayCaster& caster, const Vector3d& point,
                                 const Vector3d& from) {
  const Vector3d direction = (point - from).normalized();
  return caster.intersect(from, direction);
}

TEST(Hit, HasTheTextureCoordinatesOfItsPoint) {
  for (const double offset : {0.0, 1e6}) {  // far from the origin nothing is lost either
    const Vector3d corner(offset, -offset, 3.0);
    const Vector3d along(200.0, 20.0, 0.0);
    const Vector3d across(-30.0, 150.0, 10.0);
    Scene scene;
    scene.materials = {{.name = "tiles", .kd_texture = {.file = "tiles.png"}}};
    scene.meshes.push_back(
        make_quad(corner, corner + along, corner + along + across, corner + across, 0));
    scene.meshes[0].normals.assign(4, Vector3d::UnitZ());
    scene.meshes.push_back(make_sphere(corner - Vector3d(0, 0, 500), 10.0, 2, 0));
    const RayCaster caster(scene);
    for (std::uint64_t i = 0; i < 500; ++i) {
      const Vector2d uv(0.01 + 0.98 * number(2 * i), 0.01 + 0.98 * number(2 * i + 1));
      const Vector3d point = corner + uv.x() * along + uv.y() * across;
      // Roundings of coordinates of 1e6 are 1e-10, on 150 mm.
      const std::optional<Hit> hit =
          look_at_point(caster, point, point + Vector3d(40, 60, 300));
      ASSERT_TRUE(hit);
      EXPECT_LE((hit->uv - uv).cwiseAbs().maxCoeff(), offset > 0.0 ? 3e-11 : 1e-14);
    }
    const std::optional<Hit> sphere =
        look_at_point(caster, corner - Vector3d(0, 0, 500), corner - Vector3d(300, 300, 500));
    ASSERT_TRUE(sphere);
    EXPECT_EQ(sphere->mesh, 1);
    EXPECT_EQ(sphere->uv, Vector2d::Zero());  // a mesh without
  }
}

TEST(Bsdf, ATextureMultipliesKd) {
  Image<float> picture(1, 2, 3);
  picture(0, 0, 0) = 0.5F;
  picture(0, 0, 1) = 1.0F;
  MaterialTexture texture;
  texture.file = "p.png";
  texture.scale = {2.0, 1.0};
  texture.picture = std::make_shared<const Texture>(picture);
  Scene scene;
  scene.materials = {{.name = "matte", .kd = Vector3d(0.8, 0.6, 0.4), .kd_texture = texture},
                     {.name = "plaster",
                      .kd = Vector3d::Ones(),
                      .bsdf = BsdfKind::oren_nayar,
                      .kd_texture = texture},
                     {.name = "lacquer",
                      .kd = Vector3d(0.8, 0.6, 0.4),
                      .bsdf = BsdfKind::coated,
                      .kd_texture = texture}};
  Hit hit;
  hit.uv = {0.125 + 3.0, 0.2};  // twice that is the first texel's centre
  EXPECT_EQ(std::get<Lambert>(bsdf_of(scene, hit)).kd, Vector3d(0.4, 0.6, 0.0));
  hit.material = 2;
  EXPECT_EQ(std::get<Coated>(bsdf_of(scene, hit)).kd, Vector3d(0.4, 0.6, 0.0));
  hit.material = 1;
  const Vector3d to_eye(0.6, 0.0, 0.8);
  Scene plain;
  plain.materials = {
      {.name = "plaster", .kd = Vector3d(0.5, 1.0, 0.0), .bsdf = BsdfKind::oren_nayar}};
  EXPECT_EQ(albedo(bsdf_of(scene, hit), to_eye), albedo(bsdf_of(plain, Hit{}), to_eye));
  scene.materials[1].kd_texture.picture = nullptr;
  EXPECT_THROW(static_cast<void>(bsdf_of(scene, hit)), ContractViolation);
}

}  // namespace
}  // namespace haarlight::render
