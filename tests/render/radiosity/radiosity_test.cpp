// SPDX-License-Identifier: Apache-2.0
/// @file
/// Radiosity: form factors and systems in closed form, furnaces, beside path tracing, and at the ends of
/// what can be written.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/radiosity/patch_light.h"
#include "render/radiosity/radiosity_integrator.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/golden_file.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using std::numbers::pi;

double number(const nlohmann::json& value) {
  return value.is_string() ? std::stod(value.get<std::string>()) : value.get<double>();
}

VectorXd numbers_of(const nlohmann::json& values) {
  VectorXd numbers(static_cast<Eigen::Index>(values.size()));
  for (std::size_t i = 0; i < values.size(); ++i) {
    numbers[static_cast<Eigen::Index>(i)] = number(values[i]);
  }
  return numbers;
}

/// Elements of area 1, all of which see each other.
template <class FormFactor>
Exchange<double> dense(std::size_t n, const FormFactor& form_factor) {
  Exchange<double> exchange;
  exchange.root_area = VectorXd::Ones(static_cast<Eigen::Index>(n));
  exchange.row_begin = {0};
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      if (i != j) {
        exchange.columns.push_back(static_cast<std::uint32_t>(j));
        exchange.values.push_back(form_factor(i, j));
      }
    }
    exchange.row_begin.push_back(exchange.columns.size());
  }
  return exchange;
}

/// 1e-10, the tier of closed forms.
TEST(Radiosity, SystemsOfKnownFormFactors) {
  constexpr double kOpposite = 0.199824895698387383;  // of the golden file's notes
  constexpr double kBeside = 0.200043776075403154;
  int n_checked = 0;
  const nlohmann::json golden = test::read_golden("transport.json");
  for (const auto& item : golden.at("cases")) {
    const std::string kind = item["kind"];
    const nlohmann::json& geometry = item["geometry"];
    double found = 0.0;
    if (kind == "radiosity_unit_cube_6_patch") {
      const auto cube = dense(6, [&](std::size_t i, std::size_t j) {
        return i / 2 == j / 2 ? kOpposite : kBeside;
      });
      found =
          solve_radiosity(cube, numbers_of(geometry["emission"]), numbers_of(geometry["rho"]))
              .radiosity[std::stoi(geometry["face"].get<std::string>())];
    } else if (kind == "radiosity_two_plates") {
      const auto plates =
          dense(2, [&](std::size_t, std::size_t) { return number(geometry["F12"]); });
      found = solve_radiosity(
                  plates, Eigen::Vector2d(number(geometry["E1"]), number(geometry["E2"])),
                  Eigen::Vector2d(number(geometry["rho1"]), number(geometry["rho2"])))
                  .radiosity[1];
    } else {
      continue;
    }
    EXPECT_NEAR(found, number(item["value"]), 1e-10 * number(item["value"])) << item["id"];
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 3);
}

TEST(Patches, CutTrianglesEvenlyAndFindTheirPointsAgain) {
  Scene scene;
  scene.materials = {{}};
  scene.meshes = {make_quad({0, 0, 0}, {30, 0, 0}, {30, 20, 0}, {0, 20, 0}, 0),
                  make_quad({0, 0, 9}, {1, 0, 9}, {1, 1, 9}, {0, 1, 9}, 0)};
  const Patches patches(scene, 1000);
  EXPECT_LE(patches.size(), 1000U);
  EXPECT_GE(patches.size(), 900U);
  double sum = 0.0;
  for (std::size_t patch = 0; patch < patches.size(); ++patch) {
    sum += patches.area_mm2(patch);
    const CutTriangle& triangle = patches.triangle_of(patch);
    for (const Vector2d& square :
         {Vector2d(0.01, 0.5), Vector2d(0.4, 0.7), Vector2d(0.98, 0.02)}) {
      const Vector2d uv = patches.uv_in(patch, square);
      const PatchPoint found = Patches::find_in(triangle, uv);
      EXPECT_EQ(found.patch, patch);
      // Weights of the vertices give the point back.
      Vector2d back = Vector2d::Zero();
      for (int j = 0; j <= triangle.n; ++j) {
        for (int i = 0; i + j <= triangle.n; ++i) {
          for (std::size_t k = 0; k < 3; ++k) {
            if (found.vertices.at(k) == triangle.vertex(i, j)) {
              back += found.weights.at(k) * Vector2d(i, j) / triangle.n;
            }
          }
        }
      }
      EXPECT_NEAR((back - uv).norm(), 0.0, 1e-12);
    }
  }
  EXPECT_NEAR(sum, 601.0, 1e-9);
}

/// From the front of one mesh to that of another.
double factor_between(const Exchange<float>& exchange, const Patches& patches,
                      std::uint32_t from, std::uint32_t to) {
  double sum = 0.0;
  double area = 0.0;
  for (std::size_t i = 0; i < patches.size(); ++i) {
    if (patches.triangle_of(i).surface != from) {
      continue;
    }
    area += patches.area_mm2(i);
    for (std::size_t j = 0; j < patches.size(); ++j) {
      if (patches.triangle_of(j).surface == to) {
        sum += patches.area_mm2(i) * exchange.form_factor(2 * i, 2 * j);
      }
    }
  }
  return sum / area;
}

/// Of independent rays, n of both ends together, the standard error would be sqrt(F/n); evenly drawn
/// ones are better. 3 of them. Not the extreme ones: a gap of 1e-6 is no farther than rays start.
TEST(FormFactors, OfRectanglesAreThoseInClosedForm) {
  constexpr std::uint32_t kRays = 1024;
  int n_checked = 0;
  const nlohmann::json golden = test::read_golden("transport.json");
  for (const auto& item : golden.at("cases")) {
    const std::string kind = item["kind"];
    const nlohmann::json& geometry = item["geometry"];
    const double truth = number(item["value"]);
    if (!kind.starts_with("form_factor_p") || item["tier"] != "normal") {
      continue;
    }
    Scene scene;
    scene.materials = {{}};
    if (kind == "form_factor_parallel_rectangles") {
      const double a = number(geometry["a"]);
      const double b = number(geometry["b"]);
      const double gap = number(geometry["gap"]);
      scene.meshes = {make_quad({0, 0, 0}, {a, 0, 0}, {a, b, 0}, {0, b, 0}, 0),
                      make_quad({0, 0, gap}, {0, b, gap}, {a, b, gap}, {a, 0, gap}, 0)};
    } else {
      const double edge = number(geometry["common_edge"]);
      const double w = number(geometry["w_from"]);
      const double h = number(geometry["h_to"]);
      scene.meshes = {make_quad({0, 0, 0}, {w, 0, 0}, {w, edge, 0}, {0, edge, 0}, 0),
                      make_quad({0, 0, 0}, {0, edge, 0}, {0, edge, h}, {0, 0, h}, 0)};
    }
    const RayCaster caster(scene);
    const Patches patches(scene, 64);
    const Exchange<float> exchange =
        form_factors(scene, caster, patches, {.patches = 64, .rays = kRays});
    const double found = factor_between(exchange, patches, 0, 1);
    const double error = std::sqrt(truth / static_cast<double>(kRays * patches.size()));
    std::printf("%s: %.6f, %.6f in closed form, independent rays +- %.6f\n",
                item["id"].get<std::string>().c_str(), found, truth, error);
    EXPECT_NEAR(found, truth, 3.0 * error) << item["id"];
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 3);
}

/// A box seen from within, of 200 x 300 x 400 mm.
Scene room(const Material& wall) {
  Scene scene;
  scene.materials = {wall};
  Mesh box = make_box({-100, -150, -200}, {100, 150, 200}, 0);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  scene.meshes = {box};
  return scene;
}

/// Rows: all light arrives somewhere; what is missing has slipped through an edge in single precision,
/// at most 1 ray in 1000. Reciprocity: to the rounding of floats.
TEST(FormFactors, InAClosedRoomRowsSumToOneAndAreReciprocal) {
  const Scene scene = room({});
  const RayCaster caster(scene);
  const Patches patches(scene, 300);
  const Exchange<float> exchange = form_factors(scene, caster, patches, {.rays = 512});
  const VectorXd sums = exchange.row_sums();
  double least = 1.0;
  double most = 0.0;
  for (std::size_t i = 0; i < patches.size(); ++i) {
    least = std::min(least, sums[static_cast<Eigen::Index>(2 * i)]);
    most = std::max(most, sums[static_cast<Eigen::Index>(2 * i)]);
    EXPECT_EQ(sums[static_cast<Eigen::Index>(2 * i + 1)], 0.0) << "outside";
    for (std::size_t j = 0; j < i; ++j) {
      const double there = patches.area_mm2(i) * exchange.form_factor(2 * i, 2 * j);
      const double back = patches.area_mm2(j) * exchange.form_factor(2 * j, 2 * i);
      EXPECT_NEAR(there, back, 1e-12 * there);
    }
  }
  std::printf("rows sum to %.7f ... %.7f\n", least, most);
  EXPECT_GE(least, 0.999);
  EXPECT_LE(most, 1.0 + 1e-6);
}

/// A room that emits and reflects everywhere alike: what the walls reflect is rho L_e/(1 - rho), so that
/// pi of it arrives by way of others. 1 %: direct light is drawn with 256 points for each patch.
TEST(Radiosity, AFurnaceIsTheGeometricSum) {
  for (const double albedo : {0.0, 0.5, 0.9}) {
    const Scene scene =
        room({.kd = Vector3d::Constant(albedo), .emits = Vector3d(1.0, 2.0, 0.5)});
    const RayCaster caster(scene);
    const PatchLight light(scene, caster, nullptr, {.patches = 300, .rays = 256});
    for (std::uint32_t triangle = 0; triangle < 12; ++triangle) {
      const Vector3d found =
          light.irradiance({.u = 0.3F, .v = 0.2F, .mesh = 0, .triangle = triangle}, true);
      const double truth = pi * albedo / (1.0 - albedo);
      EXPECT_NEAR(found.x(), truth, 0.01 * truth) << albedo;
      EXPECT_NEAR(found.y(), 2.0 * truth, 0.02 * truth) << albedo;
    }
  }
}

constexpr int kSize = 24;

/// Two blocks in a room that is open towards -y, under a lamp without extent, all lengths times `scale`.
Scene blocks(double scale, double intensity, double albedo = 0.7) {
  Scene scene;
  scene.materials = {{.name = "white", .kd = Vector3d::Constant(albedo)},
                     {.name = "red", .kd = albedo * Vector3d(0.9, 0.1, 0.1)}};
  const auto at = [scale](double x, double y, double z) -> Vector3d {
    return scale * Vector3d(x, y, z);
  };
  scene.meshes = {
      make_quad(at(-100, -100, 0), at(100, -100, 0), at(100, 100, 0), at(-100, 100, 0), 0),
      make_quad(at(-100, 100, 0), at(100, 100, 0), at(100, 100, 200), at(-100, 100, 200), 0),
      make_quad(at(-100, -100, 0), at(-100, 100, 0), at(-100, 100, 200), at(-100, -100, 200),
                1),
      make_quad(at(100, 100, 0), at(100, -100, 0), at(100, -100, 200), at(100, 100, 200), 0),
      make_quad(at(-100, -100, 200), at(-100, 100, 200), at(100, 100, 200), at(100, -100, 200),
                0),
      make_box(at(-60, 0, 0), at(0, 50, 110), 0),
      make_box(at(20, -40, 0), at(70, 10, 50), 0)};
  scene.point_lights = {{.position = at(10, -20, 170),
                         .intensity = Vector3d::Constant(intensity * scale * scale)}};
  return scene;
}

CameraModel before_blocks(double scale) {
  return testing::square_camera(scale * Vector3d(0, -400, 100), scale * Vector3d(0, 0, 95),
                                34.0, kSize);
}

Image<float> picture_of(const TileRenderer& integrator, std::uint32_t samples) {
  Film film(kSize, kSize, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return film.mean(0);
}

Image<float> by_radiosity(const Scene& scene, const CameraModel& model, std::size_t patches,
                          std::uint32_t rays = 512, std::uint32_t samples = 16) {
  const RayCaster caster(scene);
  return picture_of(RadiosityIntegrator(
                        scene, caster, nullptr, model, {},
                        PatchLight(scene, caster, nullptr, {.patches = patches, .rays = rays})),
                    samples);
}

/// Means of 4 x 4 pixels: what is left of paths' noise is a fourth of a pixel's.
std::vector<double> block_means(const Image<float>& picture) {
  constexpr int kBlock = 4;
  constexpr int kAcross = kSize / kBlock;
  std::vector<double> means(std::size_t{3} * kAcross * kAcross);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int c = 0; c < 3; ++c) {
        means.at(3 * static_cast<std::size_t>(y / kBlock * kAcross + x / kBlock) +
                 static_cast<std::size_t>(c)) += double{picture(y, x, c)} / (kBlock * kBlock);
      }
    }
  }
  return means;
}

/// The same points of pixels and a lamp without extent: direct light and edges are the same. Errors over the
/// mean, of 100, 1000 and 4000 patches: less and less. 0.4 % in the mean of 1000 and more, and of blocks 0.8 % with
/// the noise of paths.
TEST(Radiosity, IsPathTracingWithinDiffuseBlocks) {
  const Scene scene = blocks(1.0, 1e4);
  const CameraModel model = before_blocks(1.0);
  const RayCaster caster(scene);
  const std::vector<double> truth =
      block_means(picture_of(PathIntegrator(scene, caster, nullptr, model, {}), 1024));
  const auto n = static_cast<double>(truth.size());
  double mean = 0.0;
  for (const double value : truth) {
    mean += value / n;
  }
  double last = 1.0;
  for (const std::size_t patches : {100U, 1000U, 4000U}) {
    const std::vector<double> found =
        block_means(by_radiosity(scene, model, patches, 512, 1024));
    double off = 0.0;
    double squared = 0.0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      off += (found[i] - truth[i]) / n;
      squared += (found[i] - truth[i]) * (found[i] - truth[i]) / n;
    }
    const double rmse = std::sqrt(squared) / mean;
    std::printf("%zu patches: mean %+.4f, RMSE %.4f of the mean\n", patches, off / mean, rmse);
    EXPECT_LT(rmse, last);
    last = rmse;
    EXPECT_LE(std::abs(off / mean), patches >= 1000 ? 0.004 : 0.02);
  }
  EXPECT_LE(last, 0.008);
}

/// Parts, each with a solution of its own, are those of one computer.
TEST(Radiosity, TheSameForAnyNumberOfThreadsAndParts) {
  constexpr int kLarge = 70;
  const Scene scene = blocks(1.0, 1e4);
  const CameraModel model = testing::square_camera({0, -400, 100}, {0, 0, 95}, 99.0, kLarge);
  const RayCaster caster(scene);
  std::vector<std::vector<float>> pictures;
  for (const auto& [threads, parts] : {std::pair{1, 1}, {2, 1}, {7, 1}, {2, 3}}) {
    const ThreadLimit limit(threads);
    Film film(kLarge, kLarge, surface_layers(false));
    for (int part = 0; part < parts; ++part) {
      const RadiosityIntegrator integrator(
          scene, caster, nullptr, model, {},
          PatchLight(scene, caster, nullptr, {.patches = 200, .rays = 64}));
      (void)run(integrator,
                {.samples = 2,
                 .part = {.index = static_cast<std::size_t>(part),
                          .n_parts = static_cast<std::size_t>(parts)}},
                film);
    }
    const Image<float> picture = film.mean(0);
    pictures.emplace_back(picture.pixels().begin(), picture.pixels().end());
  }
  for (const std::vector<float>& picture : pictures) {
    EXPECT_EQ(picture, pictures[0]);
  }
}

void expect_finite(const Image<float>& picture) {
  for (const float value : picture.pixels()) {
    ASSERT_TRUE(std::isfinite(value) && value >= 0.0F) << value;
  }
}

/// Lengths times 10^+-6, lamps times 10^+-20. A ray that meets an edge in single precision may meet
/// another patch: 2 % of the brightest pixel.
TEST(RadiosityExtremes, APictureDoesNotDependOnScaleAndUnit) {
  const Image<float> one = by_radiosity(blocks(1.0, 1e4), before_blocks(1.0), 200, 64, 2);
  const float most = *std::ranges::max_element(one.pixels());
  for (const double scale : {1e-6, 1.0, 1e6}) {
    for (const double factor : {1e-20, 1.0, 1e20}) {
      const Image<float> other =
          by_radiosity(blocks(scale, 1e4 * factor), before_blocks(scale), 200, 64, 2);
      expect_finite(other);
      std::size_t n_off = 0;
      for (std::size_t i = 0; i < one.pixels().size(); ++i) {
        n_off += std::abs(other.pixels()[i] / factor - one.pixels()[i]) > 0.02 * most ? 1 : 0;
      }
      EXPECT_LE(n_off, one.pixels().size() / 50) << scale << ", " << factor;
    }
  }
}

TEST(RadiosityExtremes, NoAlbedoNoLightNoAreaAndNothingAtAll) {
  // Nothing is reflected: black, but for lamps that are seen.
  Image<float> picture = by_radiosity(blocks(1.0, 1e4, 0.0), before_blocks(1.0), 200, 64, 2);
  EXPECT_EQ(*std::ranges::max_element(picture.pixels()), 0.0F);
  // An open scene has an answer where all is reflected.
  picture = by_radiosity(blocks(1.0, 1e4, 1.0), before_blocks(1.0), 200, 64, 2);
  expect_finite(picture);
  EXPECT_GT(*std::ranges::max_element(picture.pixels()), 0.0F);
  picture = by_radiosity(blocks(1.0, 0.0), before_blocks(1.0), 200, 64, 2);
  EXPECT_EQ(*std::ranges::max_element(picture.pixels()), 0.0F);
  Scene scene = blocks(1.0, 1e4);
  scene.meshes.push_back(make_quad({0, 0, 150}, {10, 0, 150}, {10, 0, 150}, {0, 0, 150}, 0));
  scene.meshes.push_back(scene.meshes[0]);  // the floor twice
  expect_finite(by_radiosity(scene, before_blocks(1.0), 200, 64, 2));
  scene = {};
  scene.point_lights.push_back({});
  expect_finite(by_radiosity(scene, before_blocks(1.0), 200, 64, 2));
}

/// In a closed room where all is reflected light never ends: refused by name.
TEST(RadiosityExtremes, ARoomThatAbsorbsNothingIsRefused) {
  Scene scene = room({.kd = Vector3d::Ones()});
  scene.point_lights.push_back({.intensity = Vector3d::Constant(1e4)});
  const RayCaster caster(scene);
  try {
    const PatchLight light(scene, caster, nullptr, {.patches = 100, .rays = 64});
    FAIL() << "an answer";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("never ends"), std::string::npos) << error.what();
  }
}

TEST(RadiosityExtremes, WhatIsNotDiffuseIsRefusedByName) {
  for (const BsdfKind kind :
       {BsdfKind::mirror, BsdfKind::dielectric, BsdfKind::conductor, BsdfKind::coated}) {
    Scene scene = blocks(1.0, 1.0);
    scene.materials[1].bsdf = kind;
    EXPECT_THROW(require_diffuse(scene), Error) << to_string(kind);
  }
  Scene scene = blocks(1.0, 1.0);
  scene.materials[1].bsdf = BsdfKind::oren_nayar;
  require_diffuse(scene);
  scene.spheres.push_back({.radius_mm = 5.0, .material = 0});
  EXPECT_THROW(require_diffuse(scene), Error);
  scene.materials.push_back({.kd = Vector3d::Zero(), .emits = Vector3d::Ones()});
  scene.spheres[0].material = 2;
  require_diffuse(scene);
}

}  // namespace
}  // namespace haarlight::render
