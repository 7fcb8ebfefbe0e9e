// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using testing::TemporaryFolder;

SceneFile scene_of(const std::string& text) {
  const TemporaryFolder folder;
  write_file_atomically(
      folder / "tri.obj",
      std::string_view("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl kd0.7_ks0_n0\nf 1 2 3\n"));
  write_file_atomically(folder / "s.toml", std::string_view(text));
  return read_scene(folder / "s.toml");
}

const std::string kMaterial =
    "[[material]]\nname = \"a\"\nkd = [0.1, 0.2, 0.3]\nks = 0.5\nexponent = 20\n";

TEST(SceneFile, ReadsEveryShape) {
  const SceneFile file = scene_of(kMaterial + R"(
[[mesh]]
file = "tri.obj"
translate = [10.0, 0.0, 5.0]
scale = 2.0
rotate_z_deg = 90.0
[[mesh]]
file = "tri.obj"
material = "a"
[[sphere]]
centre = [0.0, 0.0, 50.0]
radius = 10.0
subdivisions = 3
material = "a"
[[box]]
low = [0.0, 0.0, 0.0]
high = [1.0, 2.0, 3.0]
material = "a"
[[quad]]
corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
material = "a"
[camera]
size = [640, 480]
eye = [0.0, -500.0, 400.0]
target = [0.0, 0.0, 0.0]
fov_y_deg = 40.0
dist = [0.1, 0.0, 0.0, 0.0, 0.0]
)");
  ASSERT_EQ(file.scene.meshes.size(), 5U);
  EXPECT_TRUE(file.has_camera);
  EXPECT_EQ(file.camera.width, 640);
  EXPECT_NEAR(file.camera.fy, 240.0 / std::tan(20.0 * 3.14159265358979 / 180.0), 1e-9);
  EXPECT_EQ(file.camera.distortion[0], 0.1);
  const Mesh& moved = file.scene.meshes[0];
  EXPECT_TRUE(moved.vertices[1].isApprox(Eigen::Vector3d(10.0, 2.0, 5.0)));
  EXPECT_EQ(file.scene.materials[static_cast<std::size_t>(moved.material)].name,
            "kd0.7_ks0_n0");
  EXPECT_EQ(file.scene.materials[static_cast<std::size_t>(file.scene.meshes[1].material)].name,
            "a");
  EXPECT_EQ(file.scene.meshes[2].triangles.size(), 8U * 64U);
  EXPECT_EQ(file.scene.meshes[3].triangles.size(), 12U);
}

TEST(SceneFile, TakesACameraByItsMatrices) {
  const SceneFile file = scene_of(kMaterial + R"(
[[sphere]]
centre = [0.0, 0.0, 0.0]
radius = 1.0
material = "a"
[camera]
size = [64, 48]
K = [[50, 0, 32], [0, 50, 24], [0, 0, 1]]
world_from_cam = [[1, 0, 0, 7], [0, -1, 0, 8], [0, 0, -1, 9]]
)");
  EXPECT_EQ(file.camera.fx, 50.0);
  EXPECT_TRUE(file.camera.centre_world().isApprox(Eigen::Vector3d(7, 8, 9)));
}

TEST(SceneFile, ReadsEveryShippedScene) {
  for (const char* name : {"airplane", "biplane", "tree", "blocks", "blade", "empty", "plinth",
                           "stairs", "cornell", "cornell_glass", "cornell_tiles", "lights"}) {
    const SceneFile file =
        read_scene(std::string(HAARLIGHT_SOURCE_DIR "/configs/scenes/") + name + ".toml");
    EXPECT_TRUE(file.has_camera) << name;
    EXPECT_FALSE(file.scene.meshes.empty()) << name;
  }
}

TEST(SceneFile, NamesLineAndHintOfBrokenOnes) {
  const std::string ball = "[[sphere]]\ncentre = [0, 0, 0]\nradius = 1.0\nmaterial = \"a\"\n";
  const std::string broken[] = {
      "",
      kMaterial,
      "[[sphere\n",
      ball,                               // no such material
      kMaterial + kMaterial + ball,       // the name twice
      kMaterial + ball + "colour = 3\n",  // unknown key
      kMaterial + "[[sphere]]\ncentre = [0, 0]\nradius = 1.0\nmaterial = \"a\"\n",
      kMaterial + "[[sphere]]\ncentre = [0, 0, 0]\nradius = -1.0\nmaterial = \"a\"\n",
      kMaterial + "[[box]]\nlow = [0, 0, 0]\nhigh = [1, 0, 1]\nmaterial = \"a\"\n",
      "[[material]]\nname = \"a\"\nkd = [0.5, 0.5]\n" + ball,
      "[[material]]\nname = \"a\"\nkd = [1.5]\n" + ball,
      "[[mesh]]\nfile = \"missing.obj\"\n",
      "[[mesh]]\nfile = \"tri.stl\"\n",
      kMaterial + ball +
          "[camera]\nsize = [64, 0]\neye = [0, 0, 1]\ntarget = [0, 0, 0]\nfov_y_deg = 30\n",
      kMaterial + ball +
          "[camera]\nsize = [64, 48]\neye = [0, 0, 1]\ntarget = [0, 0, 0]\nfov_y_deg = 30\n",
      kMaterial + ball +
          "[camera]\nsize = [64, 48]\nK = [[50, 0, 32], [0, 50, 24], [0, 0, 1]]\n"
          "world_from_cam = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 2, 0]]\n",
  };
  for (const std::string& text : broken) {
    try {
      static_cast<void>(scene_of(text));
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_NE(error.where().find("s.toml"), std::string::npos) << error.where();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

const std::string kNamed = kMaterial + "[[mesh]]\nname = \"leaf\"\nfile = \"tri.obj\"\n";

TEST(SceneFile, ReadsInstances) {
  const SceneFile file = scene_of(kNamed + R"(
[[instance]]
mesh = "leaf"
[[instance]]
mesh = "leaf"
translate = [10.0, 0.0, 5.0]
scale = 2.0
rotate_z_deg = 90.0
material = "a"
)");
  ASSERT_EQ(file.scene.meshes.size(), 1U);
  ASSERT_EQ(file.scene.instances.size(), 2U);
  EXPECT_TRUE(file.scene.instances[0].world_from_mesh.isApprox(Eigen::Affine3d::Identity(), 0));
  EXPECT_EQ(material_of(file.scene, file.scene.instances[0]), file.scene.meshes[0].material);
  // (1, 0, 0) turned to (0, 1, 0), twice as far, and moved.
  const Eigen::Vector3d moved =
      file.scene.instances[1].world_from_mesh * Eigen::Vector3d(1, 0, 0);
  EXPECT_LE((moved - Eigen::Vector3d(10, 2, 5)).norm(), 1e-14);
  EXPECT_EQ(
      file.scene
          .materials[static_cast<std::size_t>(material_of(file.scene, file.scene.instances[1]))]
          .name,
      "a");
}

TEST(SceneFile, NamesWhatIsWrongWithAnInstance) {
  struct Case {
    std::string keys;
    std::string problem;
    std::string hint;
    int line;
  };
  const std::string instance = "[[instance]]\nmesh = \"leaf\"\n";  // lines 9 and 10
  for (const Case& wrong : {
           Case{"[[instance]]\nmesh = \"laef\"\n", "no [[mesh]] is named 'laef'", "'leaf'", 10},
           Case{"[[instance]]\nscale = 2.0\n", "mesh", "", 9},
           Case{instance + "scale = 0.0\n", "scale", "", 11},
           Case{instance + "scale = nan\n", "scale", "", 11},
           Case{instance + "scale = -1.0\n", "scale", "", 11},
           Case{instance + "translate = [0.0, inf, 0.0]\n", "translate", "", 11},
           Case{instance + "rotate_z_deg = nan\n", "rotate_z_deg", "", 11},
           Case{instance + "material = \"b\"\n", "no [[material]] is named 'b'", "", 11},
           Case{instance + "file = \"tri.obj\"\n", "file", "", 11},
           Case{"[[mesh]]\nname = \"leaf\"\nfile = \"tri.obj\"\n", "a second mesh 'leaf'",
                "own name", 10},
           Case{"[[mesh]]\nname = \"\"\nfile = \"tri.obj\"\n", "empty name", "", 10},
       }) {
    try {
      static_cast<void>(scene_of(kNamed + wrong.keys));
      ADD_FAILURE() << wrong.keys;
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find(wrong.problem), std::string::npos) << error.problem();
      EXPECT_NE(error.hint().find(wrong.hint), std::string::npos) << error.hint();
      EXPECT_FALSE(error.hint().empty());
      EXPECT_NE(error.where().find("s.toml:" + std::to_string(wrong.line)), std::string::npos)
          << error.where() << " of " << wrong.keys;
    }
  }
}

TEST(SceneFile, RefusesATextureOnAnInstanceWithoutTextureCoordinates) {
  try {
    static_cast<void>(scene_of(kNamed + "[[material]]\nname = \"t\"\nkd_texture = \"t.png\"\n" +
                               "[[instance]]\nmesh = \"leaf\"\nmaterial = \"t\"\n"));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("no texture coordinates"), std::string::npos);
    EXPECT_NE(error.where().find("s.toml:14"), std::string::npos) << error.where();
  }
}

const std::string kBall = "[[sphere]]\ncentre = [0, 0, 0]\nradius = 1.0\nmaterial = \"a\"\n";

Material material_of(const std::string& keys) {
  return scene_of("[[material]]\nname = \"a\"\n" + keys + kBall).scene.materials.at(0);
}

TEST(SceneFile, ReadsEveryBsdf) {
  EXPECT_EQ(material_of("ks = 0.5\n").bsdf, BsdfKind::blinn_phong);
  EXPECT_EQ(material_of("bsdf = \"blinn_phong\"\nkd = [0.9]\nks = 0.1\n").ks, 0.1);
  const Material plaster = material_of("bsdf = \"oren_nayar\"\nkd = [0.9]\nsigma_deg = 30\n");
  EXPECT_EQ(plaster.bsdf, BsdfKind::oren_nayar);
  EXPECT_EQ(plaster.kd.z(), 0.9);
  EXPECT_NEAR(plaster.sigma, 0.5235987755982988, 1e-15);
  const Material mirror = material_of("bsdf = \"mirror\"\nreflectance = [0.9, 0.8, 0.7]\n");
  EXPECT_EQ(mirror.bsdf, BsdfKind::mirror);
  EXPECT_EQ(mirror.reflectance.y(), 0.8);
  EXPECT_EQ(material_of("bsdf = \"mirror\"\n").reflectance.y(), 1.0);
  EXPECT_EQ(material_of("bsdf = \"dielectric\"\n").ior, 1.5);
  EXPECT_EQ(material_of("bsdf = \"dielectric\"\nior = 1.33\n").ior, 1.33);
  const Material gold =
      material_of("bsdf = \"conductor\"\nmetal = \"gold\"\nroughness = 0.3\n");
  EXPECT_EQ(gold.bsdf, BsdfKind::conductor);
  EXPECT_EQ(gold.roughness, 0.3);
  EXPECT_EQ(gold.k.x(), 3.60245);
  const Material given =
      material_of("bsdf = \"conductor\"\neta = [1.1, 1.2, 1.3]\nk = [2.5]\n");
  EXPECT_EQ(given.eta.y(), 1.2);
  EXPECT_EQ(given.k.z(), 2.5);
  EXPECT_EQ(given.roughness, 0.1);
  const Material lacquer =
      material_of("bsdf = \"coated\"\nkd = [0.5, 0.1, 0.1]\nior = 1.6\nroughness = 0.05\n");
  EXPECT_EQ(lacquer.bsdf, BsdfKind::coated);
  EXPECT_EQ(lacquer.ior, 1.6);
  EXPECT_EQ(lacquer.roughness, 0.05);
}

TEST(SceneFile, NamesTheKeyThatItsBsdfDoesNotHave) {
  const struct {
    const char* keys;
    const char* problem;
  } broken[] = {
      {"bsdf = \"glass\"\n", "bsdf"},
      {"bsdf = \"mirror\"\nkd = [0.5]\n", "kd is no key of bsdf = \"mirror\""},
      {"ior = 1.5\n", "ior is no key of bsdf = \"blinn_phong\""},
      {"bsdf = \"dielectric\"\nroughness = 0.1\n", "roughness is no key"},
      {"bsdf = \"dielectric\"\nmetal = \"gold\"\n", "metal is no key"},
      {"bsdf = \"dielectric\"\nior = 0.9\n", "ior"},
      {"bsdf = \"dielectric\"\nior = 4.1\n", "ior"},
      {"bsdf = \"coated\"\nior = 1.1\n", "ior"},
      {"bsdf = \"coated\"\nroughness = 0\n", "roughness"},
      {"bsdf = \"coated\"\nroughness = 1.1\n", "roughness"},
      {"bsdf = \"coated\"\nks = 0.1\n", "ks is no key"},
      {"bsdf = \"oren_nayar\"\n", "sigma_deg is missing"},
      {"bsdf = \"oren_nayar\"\nsigma_deg = 91\n", "sigma_deg"},
      {"bsdf = \"mirror\"\nreflectance = [1.1]\n", "albedo outside"},
      {"bsdf = \"mirror\"\nreflectance = [1, 1]\n", "1 or 3 numbers"},
      {"bsdf = \"conductor\"\n", "without a metal"},
      {"bsdf = \"conductor\"\neta = [1.5]\n", "without a metal"},
      {"bsdf = \"conductor\"\nmetal = \"brass\"\n", "metal"},
      {"bsdf = \"conductor\"\nmetal = \"gold\"\nk = [3]\n", "by its name and by its numbers"},
      {"bsdf = \"conductor\"\neta = [0]\nk = [3]\n", "eta is out of range"},
      {"bsdf = \"conductor\"\neta = [1]\nk = [30]\n", "k is out of range"},
      {"kd = [0.8, 0.2, 0.2]\nks = 0.3\n", "kd + ks = 1.1"},
  };
  for (const auto& [keys, problem] : broken) {
    try {
      static_cast<void>(material_of(keys));
      ADD_FAILURE() << keys;
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find(problem), std::string::npos)
          << keys << ": " << error.problem();
      EXPECT_NE(error.where().find("s.toml:"), std::string::npos) << error.where();
      EXPECT_FALSE(error.hint().empty());
      EXPECT_EQ(error.hint().find("unknown key"), std::string::npos) << error.hint();
    }
  }
}

const std::string kView = "[camera]\nsize = [64, 48]\neye = [0, -9, 9]\ntarget = [0, 0, 0]\n";

/// What a broken file's first error says; at a line of it and with a hint.
void expect_problem(const std::string& text, const std::string& problem) {
  try {
    static_cast<void>(scene_of(text));
    ADD_FAILURE() << text;
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find(problem), std::string::npos)
        << text << ": " << error.problem();
    EXPECT_NE(error.where().find("s.toml:"), std::string::npos) << error.where();
    EXPECT_FALSE(error.hint().empty());
  }
}

TEST(SceneFile, ReadsTheFilm) {
  const std::string view = kMaterial + kBall + kView + "fov_y_deg = 40\n";
  const SceneFile plain = scene_of(view);
  EXPECT_FALSE(plain.film.size || plain.film.crop || plain.film.filter);
  const SceneFile file = scene_of(
      view + "[film]\nsize = [100, 50]\ncrop = \"90x40+10+10\"\nfilter = \"mitchell\"\n");
  EXPECT_EQ(file.film.size, (std::array{100, 50}));
  EXPECT_EQ(file.film.crop, (Crop{.width = 90, .height = 40, .x = 10, .y = 10}));
  EXPECT_NE(file.film.crop_where.find("s.toml:"), std::string::npos);
  EXPECT_EQ(file.film.filter, FilterKind::mitchell);
  EXPECT_EQ(file.camera.width, 64) << "the camera is as the file has it";
  EXPECT_EQ(hash_of(file), hash_of(plain)) << "film settings are not the scene's";
  const std::pair<const char*, const char*> broken[] = {
      {"size = [0, 50]", "from 1 to 65536"},
      {"size = [100, 70000]", "from 1 to 65536"},
      {"size = [100.5, 50]", "from 1 to 65536"},
      {"size = [100]", "size"},
      {"crop = \"64x48+1+0\"", "outside of the picture of 64 x 48 pixels"},
      {"size = [32, 24]\ncrop = \"64x48+0+0\"", "outside of the picture of 32 x 24 pixels"},
      {"crop = \"64x48\"", "is no part of a picture"},
      {"crop = [1, 2, 3, 4]", "crop"},
      {"filter = \"sinc\"", "filter"},
      {"spp = 3", "spp"}};
  for (const auto& [film, problem] : broken) {
    expect_problem(fmt::format("{}[film]\n{}\n", view, film), problem);
  }
}

TEST(SceneFile, ReadsWhereTheViewBeginsAndEnds) {
  for (const char* kind : {"fov_y_deg = 40\n", "width_mm = 40\n",
                           "fov_y_deg = 40\nlens_radius_mm = 2\nfocus_mm = 9\n"}) {
    const std::string view = fmt::format("{}{}{}{}", kMaterial, kBall, kView, kind);
    const SceneFile plain = scene_of(view);
    EXPECT_EQ(plain.optics.near_mm, 0.0);
    EXPECT_EQ(plain.optics.far_mm, 0.0);
    const SceneFile near = scene_of(view + "near_mm = 3\n");
    EXPECT_EQ(near.optics.near_mm, 3.0);
    const SceneFile both = scene_of(view + "near_mm = 3\nfar_mm = 20\n");
    EXPECT_EQ(both.optics.far_mm, 20.0);
    EXPECT_NE(hash_of(near), hash_of(plain));
    EXPECT_NE(hash_of(both), hash_of(near));
    expect_problem(view + "near_mm = 20\nfar_mm = 20\n", "the camera sees nothing");
    expect_problem(view + "near_mm = 20\nfar_mm = 3\n", "the camera sees nothing");
    expect_problem(view + "near_mm = -1\n", "near_mm");
    expect_problem(view + "far_mm = -1\n", "far_mm");
    expect_problem(view + "far_mm = nan\n", "far_mm");
  }
}

TEST(SceneFile, RefusesQuadsThatAreNone) {
  const auto quad = [](const std::string& corners) {
    return kMaterial + "[[quad]]\nmaterial = \"a\"\ncorners = [" + corners + "]\n";
  };
  // In a plane askew, given to four digits; concave at its third corner; a triangle; a sliver.
  for (const char* good :
       {"[0, 0, 0], [8.660, 5, 0], [8.660, 5, 7], [0, 0, 7]",
        "[0, 0, 0], [10, 0, 0], [3, 3, 0], [0, 10, 0]",
        "[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 0, 0]",
        "[0, 0, 0], [10, 0, 0], [10, 10, 0], [5, 5, 0]",
        "[9e6, 0, 0], [9e6, 9, 0], [9000000.001, 9, 0], [9000000.001, 0, 0]"}) {
    EXPECT_EQ(scene_of(quad(good)).scene.meshes.size(), 1U) << good;
  }
  const std::pair<const char*, const char*> broken[] = {
      {"[0, 0, 0], [10, 10, 0], [10, 0, 0], [0, 10, 0]", "bow-tie"},
      {"[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 0]", "bow-tie"},
      {"[0, 0, 0], [10, 0, 0], [0, 9, 0], [10, 10, 0]", "bow-tie"},
      {"[0, 10, 0], [0, 0, 0], [10, 0, 0], [1, 1, 0]", "concave at its second or fourth"},
      {"[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0.1]", "not flat: one corner is 0.1 mm"},
      {"[0, 0, 0], [10, 0, 0], [10, 10, 5], [0, 10, 0]", "not flat"},
      {"[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]", "no area"},
      {"[0.1, 0.2, 0.3], [0.2, 0.4, 0.6], [0.3, 0.6, 0.9], [0.7, 1.4, 2.1]", "no area"},
      {"[5, 5, 5], [5, 5, 5], [5, 5, 5], [5, 5, 5]", "no area"}};
  for (const auto& [corners, problem] : broken) {
    expect_problem(quad(corners), problem);
  }
}

/// Whether the triangles are the same, corner by corner, to the bit.
void expect_same_triangles(const Mesh& mesh, const Mesh& plain) {
  ASSERT_EQ(mesh.triangles.size(), plain.triangles.size());
  ASSERT_EQ(mesh.uvs.size(), mesh.vertices.size());
  ASSERT_EQ(mesh.normals.size(), plain.normals.empty() ? 0U : mesh.vertices.size());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    for (int c = 0; c < 3; ++c) {
      const auto own = static_cast<std::size_t>(mesh.triangles[t][c]);
      const auto other = static_cast<std::size_t>(plain.triangles[t][c]);
      ASSERT_EQ(mesh.vertices[own], plain.vertices[other]);
      if (!plain.normals.empty()) {
        ASSERT_EQ(mesh.normals[own], plain.normals[other]);
      }
    }
  }
}

TEST(SceneFile, GivesTextureCoordinatesWhereATextureIsAndChangesNothingElse) {
  const std::string shapes = R"(
[[sphere]]
centre = [1, 2, 3]
radius = 4
subdivisions = 3
material = "a"
[[box]]
low = [0, 0, 0]
high = [1, 2, 3]
material = "a"
)";
  const Scene plain = scene_of(kMaterial + shapes).scene;
  const Scene textured =
      scene_of("[[material]]\nname = \"a\"\nkd_texture = \"p.png\"\n" + shapes).scene;
  const Mesh sphere = make_sphere({1, 2, 3}, 4.0, 3, 0);
  const Mesh box = make_box({0, 0, 0}, {1, 2, 3}, 0);
  EXPECT_TRUE(plain.meshes[0].uvs.empty() && plain.meshes[1].uvs.empty());
  EXPECT_EQ(plain.meshes[0].vertices, sphere.vertices);
  EXPECT_EQ(plain.meshes[1].vertices, box.vertices);
  EXPECT_EQ(plain.meshes[0].triangles, sphere.triangles);
  EXPECT_EQ(plain.meshes[1].triangles, box.triangles);
  expect_same_triangles(textured.meshes[0], sphere);
  expect_same_triangles(textured.meshes[1], box);
}

TEST(SceneFile, ReadsEveryLight) {
  const SceneFile file = scene_of(R"(
[[material]]
name = "lamp"
emits = [3, 2, 1]
[[sphere]]
centre = [1, 2, 3]
radius = 4
exact = true
material = "lamp"
[[disk]]
centre = [1, 2, 3]
normal = [0, 0, -7]
radius = 5
material = "lamp"
[[light]]
kind = "point"
position = [10, 20, 30]
intensity = [5]
[[light]]
kind = "spot"
position = [0, 0, 300]
target = [0, 400, 0]
intensity = [1, 2, 3]
angle_deg = 60
full_deg = 30
[[light]]
kind = "directional"
direction = [0, 0, -2]
irradiance = [0.5]
[environment]
file = "room.hdr"
rotate_z_deg = 90
scale = 2
)");
  const Scene& scene = file.scene;
  ASSERT_EQ(scene.spheres.size(), 1U);
  EXPECT_EQ(scene.spheres[0].centre, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(scene.spheres[0].radius_mm, 4.0);
  ASSERT_EQ(scene.disks.size(), 1U);
  EXPECT_EQ(scene.disks[0].normal, -Eigen::Vector3d::UnitZ());
  ASSERT_EQ(scene.point_lights.size(), 2U);
  EXPECT_EQ(scene.point_lights[0].intensity, Eigen::Vector3d::Constant(5.0));
  EXPECT_EQ(scene.point_lights[0].cos_end, -1.0);
  EXPECT_TRUE(scene.point_lights[1].axis.isApprox(Eigen::Vector3d(0, 0.8, -0.6)));
  EXPECT_NEAR(scene.point_lights[1].cos_end, 0.5, 1e-15);
  EXPECT_NEAR(scene.point_lights[1].cos_full, 0.75, 0.12);
  ASSERT_EQ(scene.directional_lights.size(), 1U);
  EXPECT_EQ(scene.directional_lights[0].direction, -Eigen::Vector3d::UnitZ());
  ASSERT_TRUE(scene.environment);
  EXPECT_EQ(scene.environment->file.filename(), "room.hdr");
  EXPECT_NEAR(scene.environment->rotate_z_rad, 1.5707963267948966, 1e-15);
  EXPECT_EQ(scene.environment->scale, 2.0);
}

TEST(SceneFile, NamesWhatIsWrongWithALight) {
  const std::string spot =
      "[[light]]\nkind = \"spot\"\nposition = [0, 0, 9]\nintensity = [1]\n";
  const struct {
    std::string text;
    const char* problem;
  } broken[] = {
      {"[[light]]\nposition = [0, 0, 0]\n", "kind"},
      {"[[light]]\nkind = \"area\"\n", "kind"},
      {"[[light]]\nkind = \"point\"\nposition = [0, 0, 9]\n", "intensity is missing"},
      {"[[light]]\nkind = \"point\"\nintensity = [1]\n", "position"},
      {"[[light]]\nkind = \"point\"\nposition = [0, 0, 9]\nintensity = [-1]\n",
       "intensity is out of range"},
      {"[[light]]\nkind = \"point\"\nposition = [0, 0, 9]\nintensity = [1e31]\n",
       "intensity is out of range"},
      {"[[light]]\nkind = \"point\"\nposition = [0, 0, 9]\nintensity = [1, 2]\n",
       "1 or 3 numbers"},
      {"[[light]]\nkind = \"point\"\nposition = [0, 0, 9]\nintensity = [1]\nangle_deg = 3\n",
       "angle_deg"},
      {spot + "target = [0, 0, 0]\n", "angle_deg"},
      {spot + "target = [0, 0, 9]\nangle_deg = 30\n", "shines at itself"},
      {spot + "target = [0, 0, 0]\nangle_deg = 30\nfull_deg = 40\n", "wider than the cone"},
      {spot + "target = [0, 0, 0]\nangle_deg = 190\n", "angle_deg"},
      {"[[light]]\nkind = \"directional\"\ndirection = [0, 0, 0]\nirradiance = [1]\n",
       "without length"},
      {"[[light]]\nkind = \"directional\"\ndirection = [0, 0, -1]\n", "irradiance is missing"},
      {"[environment]\nscale = 2\n", "file"},
      {"[environment]\nfile = \"a.hdr\"\nscale = -1\n", "scale"},
      {"[[disk]]\ncentre = [0, 0, 0]\nnormal = [0, 0, 0]\nradius = 1\nmaterial = \"a\"\n",
       "without length"},
      {"[[disk]]\ncentre = [0, 0, 0]\nnormal = [0, 0, 1]\nradius = 0\nmaterial = \"a\"\n",
       "radius"},
      {kBall + "exact = true\nsubdivisions = 3\n", "subdivisions"},
      {kBall + "exact = 1\n", "exact"},
  };
  for (const auto& [text, problem] : broken) {
    try {
      // Tables may come in any order; the keys of the last case belong to its ball.
      static_cast<void>(scene_of(kMaterial + text + (text.starts_with(kBall) ? "" : kBall)));
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find(problem), std::string::npos)
          << text << ": " << error.problem();
      EXPECT_NE(error.where().find("s.toml"), std::string::npos) << error.where();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

TEST(SceneFile, ItsHashKnowsEveryLight) {
  SceneFile file = scene_of(kMaterial + kBall);
  std::vector<std::string> hashes{hash_of(file)};
  file.scene.spheres.emplace_back();
  hashes.push_back(hash_of(file));
  file.scene.spheres[0].radius_mm = 2.0;
  hashes.push_back(hash_of(file));
  file.scene.disks.emplace_back();
  hashes.push_back(hash_of(file));
  file.scene.point_lights.emplace_back();
  hashes.push_back(hash_of(file));
  file.scene.point_lights[0].cos_end = 0.5;
  hashes.push_back(hash_of(file));
  file.scene.directional_lights.emplace_back();
  hashes.push_back(hash_of(file));
  file.scene.environment.emplace();
  hashes.push_back(hash_of(file));
  file.scene.environment->scale = 3.0;
  hashes.push_back(hash_of(file));
  std::ranges::sort(hashes);
  EXPECT_EQ(std::ranges::adjacent_find(hashes), hashes.end());
}

TEST(SceneFile, PassesOnWhereAMeshIsBroken) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "bad.obj", std::string_view("v 0 0 nan\n"));
  write_file_atomically(folder / "s.toml", std::string_view("[[mesh]]\nfile = \"bad.obj\"\n"));
  try {
    static_cast<void>(read_scene(folder / "s.toml"));
    FAIL();
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("bad.obj:1"), std::string::npos) << error.problem();
  }
}

TEST(AppendScene, KeepsEachMeshWithItsMaterial) {
  Scene a;
  a.materials.push_back({"a", Eigen::Vector3d::Ones(), 0.0, 1.0});
  a.meshes.push_back(make_box({0, 0, 0}, {1, 1, 1}, 0));
  Scene b;
  b.materials.push_back({"b", Eigen::Vector3d::Zero(), 0.0, 1.0});
  b.meshes.push_back(make_sphere({0, 0, 0}, 1.0, 1, 0));
  append_scene(a, b);
  EXPECT_EQ(a.materials[static_cast<std::size_t>(a.meshes[1].material)].name, "b");
}

TEST(MakeBox, IsClosedAndFacesOutwards) {
  const Mesh box = make_box({-1, -2, -3}, {1, 2, 3}, 0);
  double volume6 = 0.0;
  for (const Eigen::Vector3i& t : box.triangles) {
    const auto at = [&](int i) { return box.vertices[static_cast<std::size_t>(t[i])]; };
    volume6 += at(0).dot(at(1).cross(at(2)));
  }
  EXPECT_DOUBLE_EQ(volume6 / 6.0, 2.0 * 4.0 * 6.0);  // by the divergence theorem
}

}  // namespace
}  // namespace haarlight::render
