// SPDX-License-Identifier: Apache-2.0
/// @file
/// Materials of glTF files: what each becomes, and their textures.

#include <cmath>
#include <fstream>
#include <numbers>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/coat_albedo.h"
#include "render/bsdf/fresnel.h"
#include "render/scene/texture.h"
#include "render/scene/texture_files.h"
#include "tests/render/scene/gltf_made.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Material material_of(std::string_view json) {
  return parse_gltf(made_floor().glb(floor_body(json)), "t.glb").scene.materials.at(0);
}

TEST(GltfMaterial, AMetalReflectsItsColourAndAsMuchAsSchlicks) {
  for (const double base : {0.02, 0.1, 0.2, 0.5, 0.8, 0.95, 0.999}) {
    const Material material =
        material_of(fmt::format(R"({{"pbrMetallicRoughness":{{"baseColorFactor":[{},{},{},1],)"
                                R"("roughnessFactor":0.3}}}})",
                                base, base, base));
    EXPECT_EQ(material.bsdf, BsdfKind::conductor);
    EXPECT_DOUBLE_EQ(material.roughness, 0.09);
    EXPECT_NEAR(fresnel_conductor(1.0, material.eta, material.k).x(), base, 1e-9);
    double sum = 0.0;
    double most = 0.0;
    constexpr int kPoints = 1000;
    for (int i = 0; i < kPoints; ++i) {
      const double cosine = (i + 0.5) / kPoints;
      const double ours = fresnel_conductor(cosine, material.eta, material.k).x();
      const double schlick = base + (1.0 - base) * std::pow(1.0 - cosine, 5);
      sum += 2.0 * cosine * (ours - schlick) / kPoints;
      most = std::max(most, std::abs(ours - schlick));
    }
    // The table of tints errs by 1e-4. From 0.03 to 0.17 every index reflects more, the least by up to
    // 0.009.
    EXPECT_NEAR(sum, 0.0, base == 0.1 ? 0.009 : 2e-4) << base;
    EXPECT_LE(most, base > 0.85 ? 0.25 : 0.1) << base;
  }
}

TEST(GltfMaterial, HalfOfMetallicIsAMetal) {
  const auto kind = [](double metallic) {
    return material_of(
               fmt::format(R"({{"pbrMetallicRoughness":{{"metallicFactor":{}}}}})", metallic))
        .bsdf;
  };
  EXPECT_EQ(kind(0.0), BsdfKind::coated);
  EXPECT_EQ(kind(0.49), BsdfKind::coated);
  EXPECT_EQ(kind(0.5), BsdfKind::conductor);
  EXPECT_EQ(material_of("{}").bsdf, BsdfKind::conductor);  // glTF's default
}

TEST(GltfMaterial, ACoatedOneShowsItsColour) {
  // What the base shows of light from everywhere, by quadrature over the BSDF without its coat,
  // is the colour times what a white base shows.
  SceneFile file = parse_gltf(
      made_floor().glb(floor_body(
          R"({"pbrMetallicRoughness":{"baseColorFactor":[0.8,0.4,0.1,1],"metallicFactor":0,)"
          R"("roughnessFactor":0.6}})")),
      "t.glb");
  ASSERT_EQ(file.scene.materials.at(0).bsdf, BsdfKind::coated);
  EXPECT_DOUBLE_EQ(file.scene.materials[0].ior, 1.5);
  EXPECT_DOUBLE_EQ(file.scene.materials[0].roughness, 0.36);
  const auto shown = [&](const Vector3d& colour) {
    file.scene.materials[0].kd = colour;
    const Bsdf bsdf = bsdf_of(file.scene, Hit{.material = 0});
    Vector3d sum = Vector3d::Zero();
    constexpr int kPoints = 400;
    for (int i = 0; i < kPoints; ++i) {
      const double cosine = std::sqrt((i + 0.5) / kPoints);
      sum += albedo(bsdf, {std::sqrt(1.0 - cosine * cosine), 0.0, cosine}) / kPoints;
    }
    return sum;
  };
  const Vector3d coat = shown(Vector3d::Zero());
  const Vector3d white = shown(Vector3d::Ones()) - coat;
  const Vector3d base = shown({0.8, 0.4, 0.1}) - coat;
  // The table's mean transmittance is not below the true one, by 0.03 at most.
  EXPECT_LE((base - white.cwiseProduct(Vector3d(0.8, 0.4, 0.1))).cwiseAbs().maxCoeff(), 1e-9)
      << base.transpose() << " of " << white.transpose();
  EXPECT_GT(white.x(), 0.85);
}

TEST(GltfMaterial, ExtensionsChangeTheCoat) {
  const auto with = [](std::string_view extensions) {
    return material_of(
        fmt::format(R"({{"pbrMetallicRoughness":{{"metallicFactor":0}},"extensions":{{{}}}}})",
                    extensions));
  };
  EXPECT_DOUBLE_EQ(with(R"("KHR_materials_ior":{"ior":1.8})").ior, 1.8);
  EXPECT_EQ(with(R"("KHR_materials_specular":{"specularFactor":0})").bsdf,
            BsdfKind::blinn_phong);
  EXPECT_EQ(with(R"("KHR_materials_specular":{"specularFactor":0})").ks, 0.0);
  // As Blender says that there is none.
  EXPECT_EQ(with(R"("KHR_materials_specular":{"specularColorFactor":[0,0,0]},)"
                 R"("KHR_materials_ior":{"ior":1.45})")
                .bsdf,
            BsdfKind::blinn_phong);
  EXPECT_NEAR(with(R"("KHR_materials_specular":{"specularColorFactor":[0.8,0.8,0.8]})").ior,
              (1.0 + std::sqrt(0.032)) / (1.0 - std::sqrt(0.032)), 1e-12);
  // Half of the 0.04 that 1.5 reflects.
  const double ior = with(R"("KHR_materials_specular":{"specularFactor":0.5})").ior;
  EXPECT_NEAR(std::pow((ior - 1.0) / (ior + 1.0), 2), 0.02, 1e-12);
  const Material glass = with(
      R"("KHR_materials_transmission":{"transmissionFactor":1},"KHR_materials_ior":{"ior":1.33})");
  EXPECT_EQ(glass.bsdf, BsdfKind::dielectric);
  EXPECT_DOUBLE_EQ(glass.ior, 1.33);
}

/// A PNG of these sRGB codes, rows from the top.
std::string png_of(int width, const std::vector<std::array<int, 3>>& codes) {
  Image<float> picture(static_cast<int>(codes.size()) / width, width, 3);
  for (std::size_t i = 0; i < codes.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      picture.pixels()[3 * i + c] =
          linear_from_srgb(static_cast<float>(codes[i].at(c)) / 255.0F);
    }
  }
  const testing::TemporaryFolder folder;
  write_image(folder / "p.png", picture.view());
  return read_file(folder / "p.png");
}

/// The floor with a texture of that picture. @param use  members of the textureInfo, after a comma
SceneFile textured(const std::string& png, std::string_view material) {
  MadeGltf made = made_floor();
  const std::size_t view = made.add_view(png);
  SceneFile file = parse_gltf(
      made.glb(floor_body(
          material, "",
          fmt::format(
              R"(,"textures":[{{"source":0}}],"images":[{{"bufferView":{},"mimeType":"image/png"}}])",
              view))),
      "t.glb");
  const LoadedTextures loaded = load_textures(file.scene, 1'000'000);
  EXPECT_EQ(loaded.n_pictures, 1U);
  EXPECT_TRUE(loaded.files.empty());  // it is within the scene's
  return file;
}

constexpr std::array<int, 3> kRed{200, 20, 10};
constexpr std::array<int, 3> kGreen{20, 180, 30};
constexpr std::array<int, 3> kBlue{10, 40, 220};
constexpr std::array<int, 3> kGrey{128, 128, 128};

Vector3d linear(const std::array<int, 3>& codes) {
  Vector3d light;
  for (int c = 0; c < 3; ++c) {
    light[c] =
        linear_from_srgb(static_cast<float>(codes.at(static_cast<std::size_t>(c))) / 255.0F);
  }
  return light;
}

/// kd at a point of the floor, x to the right and y up as seen from above, -1 to 1.
Vector3d kd_at(const SceneFile& file, double x, double y) {
  const Mesh& mesh = file.scene.meshes.at(0);
  const Vector2d uv = mesh.uvs[0] + 0.5 * (x + 1.0) * (mesh.uvs[1] - mesh.uvs[0]) +
                      0.5 * (y + 1.0) * (mesh.uvs[3] - mesh.uvs[0]);
  const Material& material = file.scene.materials.at(0);
  return material.kd.cwiseProduct(material.kd_texture.picture->at(uv));
}

TEST(GltfMaterial, APictureStandsUpright) {
  const std::string png = png_of(2, {kRed, kGreen, kBlue, kGrey});
  const auto shown = [&](std::string_view more) {
    return textured(png, fmt::format(R"({{"pbrMetallicRoughness":{{"metallicFactor":0,)"
                                     R"("baseColorTexture":{{"index":0{}}}}}}})",
                                     more));
  };
  const auto expect_codes = [](const Vector3d& found, const std::array<int, 3>& codes) {
    EXPECT_LE((found - linear(codes)).cwiseAbs().maxCoeff(), 1e-6) << found.transpose();
  };
  const SceneFile plain = shown("");
  expect_codes(kd_at(plain, -0.5, 0.5), kRed);  // the first row is the upper one
  expect_codes(kd_at(plain, 0.5, 0.5), kGreen);
  expect_codes(kd_at(plain, -0.5, -0.5), kBlue);
  expect_codes(kd_at(plain, 0.5, -0.5), kGrey);
  // KHR_texture_transform: moved by half of the picture to the right, it begins with its second column.
  const SceneFile moved =
      shown(R"(,"extensions":{"KHR_texture_transform":{"offset":[0.5,0]}})");
  expect_codes(kd_at(moved, -0.5, 0.5), kGreen);
  expect_codes(kd_at(moved, 0.5, -0.5), kBlue);
  // Turned about the upper left corner by a quarter: what was at its right is above it then.
  const SceneFile turned =
      shown(R"(,"extensions":{"KHR_texture_transform":{"rotation":1.5707963267948966}})");
  expect_codes(kd_at(turned, -0.5, 0.5), kBlue);  // u' = v = 1/4, v' = -u = -1/4
  expect_codes(kd_at(turned, 0.5, 0.5), kRed);    // u' = 1/4, v' = -3/4
  const SceneFile scaled = shown(
      R"(,"extensions":{"KHR_texture_transform":{"scale":[0.5,0.5],"offset":[0.125,0.125]}})");
  expect_codes(kd_at(scaled, -0.5, 0.5), kRed);
  EXPECT_NE(hash_of(plain), hash_of(moved));
  EXPECT_NE(hash_of(plain), hash_of(textured(png_of(2, {kRed, kGreen, kBlue, kRed}),
                                             R"({"pbrMetallicRoughness":{"metallicFactor":0,)"
                                             R"("baseColorTexture":{"index":0}}})")));
}

TEST(GltfMaterial, TexturesThatAreOneNumberHereCountByTheirMean) {
  // Green is the roughness, blue the metallic weight; they are no colours.
  const std::string png = png_of(2, {{9, 51, 255}, {9, 102, 255}, {9, 153, 255}, {9, 204, 0}});
  const auto pbr = [](std::string_view words) {
    return fmt::format(
        R"({{"pbrMetallicRoughness":{{{}"metallicRoughnessTexture":{{"index":0}}}}}})", words);
  };
  const Material metal = textured(png, pbr(R"("roughnessFactor":0.5,)")).scene.materials.at(0);
  EXPECT_EQ(metal.bsdf, BsdfKind::conductor);       // 3/4 metallic
  EXPECT_NEAR(metal.roughness, 0.25 * 0.25, 1e-6);  // half of a mean of 1/2, squared
  EXPECT_EQ(metal.averaged, nullptr);
  const Material coated = textured(png, pbr(R"("metallicFactor":0.6,)")).scene.materials.at(0);
  EXPECT_EQ(coated.bsdf, BsdfKind::coated);  // 0.45
  EXPECT_NEAR(coated.roughness, 0.25, 1e-6);
  EXPECT_TRUE(coated.is_kd_seen);
  const Material lamp =
      textured(png_of(1, {kRed, kGreen}),
               R"({"emissiveFactor":[683,683,683],"emissiveTexture":{"index":0}})")
          .scene.materials.at(0);
  EXPECT_LE((lamp.emits - 0.5 * (linear(kRed) + linear(kGreen))).norm(), 1e-5);
  const Material gold = textured(png_of(1, {kRed, kGreen}),
                                 R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}})")
                            .scene.materials.at(0);
  EXPECT_LE(
      (fresnel_conductor(1.0, gold.eta, gold.k) - 0.5 * (linear(kRed) + linear(kGreen))).norm(),
      1e-5);
  EXPECT_TRUE(gold.kd_texture.file.empty());
}

}  // namespace
}  // namespace haarlight::render
