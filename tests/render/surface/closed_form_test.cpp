// SPDX-License-Identifier: Apache-2.0
/// @file
/// Light whose amount is known in closed form, on a matte floor: every kind of light, every strategy,
/// every sampler. Without HAARLIGHT_ALL_STRATEGIES each scene meets a part of the combinations, so
/// that every strategy meets every sampler somewhere.
///
/// Samples of one sampler depend on each other. So each combination is rendered with 16 seeds, and
/// Student's t of their means is held to one probability of a false alarm over all of them, 0.01.

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/render/analytic/polygon_light.h"
#include "render/analytic/disk_light.h"
#include "render/surface/bidirectional_integrator.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr double kAlbedo = 0.7;
constexpr double kWeak = 3e-4;  // of the mean: a larger standard error would see nothing
constexpr int kReplicates = 16;
constexpr int kSide = 8;  // pixels

const Vector3d kPoint(12, -7, 0);  // that is looked at

struct Lit {
  std::string name;
  Scene scene;
  std::optional<Environment> environment;
  double irradiance = 0.0;     ///< of red, at kPoint
  double distance_mm = 100.0;  ///< of the nearest lamp, or less
  /// Found by points of the light alone, or by directions of the BSDF alone, in reasonable time.
  bool can_be_asked = true;
  bool can_be_followed = true;
  bool has_many = false;
};

Scene floor_scene() {
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(kAlbedo)},
                     {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(3, 2, 1)}};
  scene.meshes = {make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, 0)};
  return scene;
}

/// Adds a lamp that looks down, counter-clockwise from below. @return its irradiance at kPoint
double add_quad(const Vector3d& low, const Vector3d& high, int material, Scene& scene) {
  const std::vector<Vector3d> corners = {low,
                                         {low.x(), high.y(), low.z()},
                                         {high.x(), high.y(), low.z()},
                                         {high.x(), low.y(), low.z()}};
  scene.meshes.push_back(make_quad(corners[0], corners[1], corners[2], corners[3], material));
  const double radiance = scene.materials[static_cast<std::size_t>(material)].emits.x();
  return radiance * polygon_irradiance(corners, kPoint, Vector3d::UnitZ()).value;
}

/// A sphere above the horizon: pi L (r/d)^2 cos.
double add_sphere(const Vector3d& centre, double radius, Scene& scene) {
  scene.spheres.push_back({.centre = centre, .radius_mm = radius, .material = 1});
  const Vector3d way = centre - kPoint;
  return 3.0 * pi * radius * radius * way.z() / std::pow(way.norm(), 3);
}

/// A disk parallel to the floor.
double add_disk(const Vector3d& centre, double radius, Scene& scene) {
  scene.disks.push_back(
      {.centre = centre, .normal = -Vector3d::UnitZ(), .radius_mm = radius, .material = 1});
  const EmittingDisk disk{.centre = centre, .normal = -Vector3d::UnitZ(), .radius_mm = radius};
  return 3.0 * disk_irradiance(disk, kPoint, Vector3d::UnitZ()).value();
}

double add_point(const Vector3d& position, Scene& scene) {
  scene.point_lights.push_back({.position = position, .intensity = Vector3d::Constant(4e4)});
  const Vector3d way = position - kPoint;
  return 4e4 * way.z() / std::pow(way.norm(), 3);
}

Image<float> pattern(int width, int height, float sun) {
  Image<float> picture(height, width, 3);
  std::uint32_t state = 5;
  for (float& value : picture.pixels()) {
    state = state * 1664525U + 1013904223U;
    value = 1.0F + static_cast<float>(state >> 24U) / 128.0F;
  }
  picture(height / 4, width / 3) += sun;
  return picture;
}

/// Irradiance of a horizontal floor, texel by texel.
double irradiance_of(const Image<float>& lat_long) {
  double sum = 0.0;
  for (int row = 0; row < lat_long.height() / 2; ++row) {
    const double above = std::sin(pi * row / lat_long.height());
    const double below = std::sin(pi * (row + 1) / lat_long.height());
    for (int col = 0; col < lat_long.width(); ++col) {
      sum +=
          double{lat_long(row, col)} * pi / lat_long.width() * (below * below - above * above);
    }
  }
  return sum;
}
double irradiance_of(const std::array<Image<float>, 6>& faces) {
  double sum = 0.0;
  for (int face = 0; face < 6; ++face) {
    const Image<float>& picture = faces[static_cast<std::size_t>(face)];
    const double step = 2.0 / picture.width();
    for (int y = 0; y < picture.height(); ++y) {
      for (int x = 0; x < picture.width(); ++x) {
        const double s = -1.0 + step * x;
        const double t = -1.0 + step * y;
        const std::vector<Vector3d> corners = {
            cube_direction(face, s, t), cube_direction(face, s, t + step),
            cube_direction(face, s + step, t + step), cube_direction(face, s + step, t)};
        sum += double{picture(y, x)} *
               polygon_irradiance(corners, Vector3d::Zero(), Vector3d::UnitZ()).value;
      }
    }
  }
  return sum;
}

Lit& add(std::vector<Lit>& all, const std::string& name, bool can_be_followed) {
  all.push_back({.name = name, .scene = floor_scene(), .can_be_followed = can_be_followed});
  return all.back();
}

void add_lights_without_extent(std::vector<Lit>& all) {
  {
    Lit& lit = add(all, "a point", false);
    lit.irradiance = add_point({150, 90, 200}, lit.scene);
  }
  {
    Lit& lit = add(all, "a spot, where it fades", false);
    const Vector3d position(-100, 40, 260);
    const Vector3d axis = (Vector3d(60, 0, 0) - position).normalized();
    lit.scene.point_lights = {{.position = position,
                               .intensity = Vector3d::Constant(5e4),
                               .axis = axis,
                               .cos_full = std::cos(0.05),
                               .cos_end = std::cos(0.4)}};
    const Vector3d way = kPoint - position;
    const double cosine = axis.dot(way) / way.norm();
    const double t = (cosine - std::cos(0.4)) / (std::cos(0.05) - std::cos(0.4));
    lit.irradiance = 5e4 * (3.0 * t * t - 2.0 * t * t * t) * -way.z() / std::pow(way.norm(), 3);
  }
  {
    Lit& lit = add(all, "from afar", false);
    const Vector3d direction = Vector3d(0.3, -0.2, -0.7).normalized();
    lit.scene.directional_lights = {
        {.direction = direction, .irradiance = Vector3d::Constant(2.5)}};
    lit.irradiance = -2.5 * direction.z();
  }
}

void add_area_lights(std::vector<Lit>& all) {
  {
    Lit& lit = add(all, "a sphere, near", true);
    lit.irradiance = add_sphere({40, 10, 100}, 90, lit.scene);
    lit.distance_mm = 15.0;
  }
  {
    Lit& lit = add(all, "a sphere, small", false);
    lit.irradiance = add_sphere({150, -200, 180}, 3, lit.scene);
  }
  {
    Lit& lit = add(all, "a disk, near", true);
    lit.can_be_asked = false;
    lit.irradiance = add_disk({90, 60, 150}, 320, lit.scene);
  }
  {
    Lit& lit = add(all, "a disk, far", false);
    lit.irradiance = add_disk({90, 60, 250}, 40, lit.scene);
  }
  {
    Lit& lit = add(all, "a quad, near", true);
    lit.can_be_asked = false;
    lit.irradiance = add_quad({-260, -300, 130}, {280, 330, 130}, 1, lit.scene);
  }
  {
    Lit& lit = add(all, "a quad, far", false);
    lit.irradiance = add_quad({60, -80, 230}, {100, -20, 230}, 1, lit.scene);
  }
}

void add_environments(std::vector<Lit>& all) {
  {
    Lit& lit = add(all, "an even environment", true);
    Image<float> picture(4, 8, 1);
    std::ranges::fill(picture.pixels(), 1.5F);
    lit.environment = Environment::from_picture(picture, "made");
    lit.irradiance = 1.5 * pi;
  }
  {
    Lit& lit = add(all, "a lat-long environment", true);
    lit.can_be_asked = false;
    const Image<float> picture = pattern(16, 8, 0.0F);
    lit.environment = Environment::from_picture(picture, "made");
    lit.irradiance = irradiance_of(picture);
  }
  {
    Lit& lit = add(all, "an environment with a sun", false);
    lit.can_be_asked = false;
    const Image<float> picture = pattern(512, 256, 2e5F);
    lit.environment = Environment::from_picture(picture, "made");
    lit.irradiance = irradiance_of(picture);
  }
  {
    Lit& lit = add(all, "a cube environment", true);
    lit.can_be_asked = false;
    std::array<Image<float>, 6> faces;
    faces.fill(pattern(5, 5, 3.0F));
    lit.irradiance = irradiance_of(faces);
    lit.environment = Environment::from_faces(faces, "made");
  }
}

void add_many_lights(std::vector<Lit>& all) {
  {
    Lit& lit = add(all, "one of each", false);
    lit.has_many = true;
    lit.irradiance = add_point({150, 90, 200}, lit.scene) +
                     add_quad({-160, -100, 140}, {-40, 60, 140}, 1, lit.scene) +
                     add_sphere({140, -130, 120}, 40, lit.scene) +
                     add_disk({30, 130, 160}, 60, lit.scene);
  }
  {
    Lit& lit = add(all, "nine lamps of 1 to 81", false);
    lit.has_many = true;
    for (int i = 0; i < 9; ++i) {
      lit.scene.materials.push_back({.name = "lamp",
                                     .kd = Vector3d::Zero(),
                                     .emits = Vector3d::Constant((i + 1) * (i + 1))});
      const int row = i / 3;
      const Vector3d low(-200 + 140 * (i % 3), -190 + 130 * row, 140 + 4 * i);
      lit.irradiance += add_quad(low, low + Vector3d(70, 60, 0), i + 2, lit.scene);
    }
  }
}

std::vector<Lit> lit_scenes() {
  std::vector<Lit> all;
  add_lights_without_extent(all);
  add_area_lights(all);
  add_environments(all);
  add_many_lights(all);
  for (Lit& lit : all) {
    if (lit.environment) {
      lit.scene.environment = EnvironmentSource{};
    }
  }
  return all;
}

/// Sees kPoint alone.
CameraModel camera() {
  return testing::square_camera(kPoint + Vector3d(-30, -50, 60), kPoint, 1e6, kSide);
}

struct Measured {
  double value = 0.0;
  double error = 0.0;  ///< of independent samples
};
std::unique_ptr<TileRenderer> make_integrator(const Lit& lit, const RayCaster& caster,
                                              const PathOptions& options,
                                              bool is_bidirectional) {
  const Environment* const environment = lit.environment ? &*lit.environment : nullptr;
  if (!is_bidirectional) {
    return std::make_unique<PathIntegrator>(lit.scene, caster, environment, camera(), options);
  }
  return std::make_unique<BidirectionalIntegrator>(
      lit.scene, caster, environment, camera(),
      BidirectionalOptions{.most_bounces = options.most_bounces,
                           .lights = options.lights,
                           .sampler = options.sampler,
                           .seed = options.seed,
                           .width = kSide,
                           .height = kSide});
}
Measured measure(const Lit& lit, const RayCaster& caster, const PathOptions& options,
                 bool is_bidirectional, std::uint32_t samples) {
  const auto integrator = make_integrator(lit, caster, options, is_bidirectional);
  Film film(kSide, kSide, surface_layers(false, is_bidirectional));
  EXPECT_EQ(run(*integrator, {.samples = samples}, film).samples, samples);
  const Image<float> mean = film.mean(0);
  const Image<float> error = film.standard_error(0);
  Measured measured;
  constexpr double kPixels = kSide * kSide;
  double variance = 0.0;
  for (int i = 0; i < kSide * kSide; ++i) {
    measured.value += double{mean(i / kSide, i % kSide)} / kPixels;
    variance += std::pow(double{error(i / kSide, i % kSide)} / kPixels, 2);
  }
  measured.error = std::sqrt(variance);
  return measured;
}

struct Combination {
  const Lit* lit;
  PathOptions options;
  bool is_bidirectional = false;
};
std::vector<Combination> combinations(const std::vector<Lit>& scenes, bool is_all) {
  std::vector<Combination> chosen;
  for (std::size_t s = 0; s < scenes.size(); ++s) {
    for (std::size_t sampler = 0; sampler < kSamplerWords.size(); ++sampler) {
      for (std::size_t sampling = 0; sampling < kDirectSamplingWords.size(); ++sampling) {
        for (std::size_t lights = 0; lights < kLightChoiceWords.size(); ++lights) {
          PathOptions options;
          options.most_bounces = 1;
          options.sampler = static_cast<SamplerKind>(sampler);
          options.sampling = static_cast<DirectSampling>(sampling);
          options.lights = static_cast<LightChoice>(lights);
          const bool is_one = options.lights == LightChoice::power;
          if ((!scenes[s].has_many && !is_one) ||
              (!scenes[s].can_be_asked && options.sampling == DirectSampling::light) ||
              (!scenes[s].can_be_followed && options.sampling == DirectSampling::bsdf)) {
            continue;
          }
          if (is_all || (s + sampler + 2 * sampling + 3 * lights) % 4 == 0) {
            chosen.push_back({.lit = &scenes[s], .options = options});
          }
          // Bidirectional path tracing weighs all strategies, and asks one light.
          if (options.sampling == DirectSampling::mis && options.lights != LightChoice::all &&
              (is_all || (s + sampler + lights) % 4 == 0)) {
            chosen.push_back({.lit = &scenes[s], .options = options, .is_bidirectional = true});
          }
        }
      }
    }
  }
  return chosen;
}

/// Of 15 degrees of freedom, two-sided: the t that is exceeded with probability 0.01/n; an upper
/// estimate between the n of the table.
double most_t(std::size_t n) {
  constexpr std::array<std::pair<std::size_t, double>, 6> kTable{
      {{1, 2.947}, {10, 4.073}, {30, 4.621}, {50, 4.881}, {100, 5.240}, {400, 5.985}}};
  const auto* found =
      std::ranges::find_if(kTable, [n](const auto& row) { return row.first >= n; });
  EXPECT_NE(found, kTable.end()) << "more combinations than the table knows";
  return found->second;
}

const std::vector<Lit>& scenes() {
  static const std::vector<Lit> kScenes = lit_scenes();
  return kScenes;
}

class ClosedForm : public ::testing::TestWithParam<std::size_t> {};

TEST_P(ClosedForm, EveryStrategyAndSampler) {
  const bool is_all = std::getenv("HAARLIGHT_ALL_STRATEGIES") != nullptr;
  const std::vector<Combination> chosen = combinations(scenes(), is_all);
  const double most = most_t(chosen.size());
  for (const Combination& combination : chosen) {
    if (combination.lit != &scenes()[GetParam()]) {
      continue;
    }
    const Lit& lit = *combination.lit;
    PathOptions options = combination.options;
    const std::string name = fmt::format(
        "{}: {} {}, lights {}, {}", lit.name,
        combination.is_bidirectional ? "bidirectional" : "sampling",
        to_string(options.sampling), to_string(options.lights), to_string(options.sampler));
    const double truth = lit.irradiance * kAlbedo / pi;
    const RayCaster caster(lit.scene);
    // 10^5 samples in each picture, or as many as a part of kWeak asks for where they are
    // independent: the error of 16 pictures' mean is itself known to 18 % only, so that of many
    // combinations some would be weak at 0.7. Even samples need fewer.
    const double aimed = (is_all ? 0.55 : 0.7) * kWeak;
    options.seed = 1000;
    const Measured pilot = measure(lit, caster, options, combination.is_bidirectional, 256);
    const double needed = std::pow(pilot.error / truth / aimed, 2) * 256 / kReplicates;
    const bool is_even =
        options.sampler == SamplerKind::sobol || options.sampler == SamplerKind::halton;
    const auto samples =
        static_cast<std::uint32_t>(std::clamp(is_even ? needed / 8.0 : needed, 1600.0, 1e5));
    double sum = 0.0;
    double squares = 0.0;
    for (int i = 0; i < kReplicates; ++i) {
      options.seed = static_cast<std::uint64_t>(i);
      const double ratio =
          measure(lit, caster, options, combination.is_bidirectional, samples).value / truth -
          1.0;
      sum += ratio;
      squares += ratio * ratio;
    }
    const double mean = sum / kReplicates;
    // Single precision of the picture, and of Embree at the lights' rims. A direction that is
    // followed starts off the floor: irradiance falls with the height by at most 2/distance.
    const bool is_followed = options.sampling != DirectSampling::light && !lit.environment;
    const double rounding =
        2e-6 + (is_followed ? 2.0 * caster.ray_offset_mm() / lit.distance_mm : 0.0);
    const double error = std::sqrt(std::max(0.0, squares - kReplicates * mean * mean) /
                                   (kReplicates - 1) / kReplicates);
    fmt::print("{:64s} {:7d} spp  off {:+.5f} %  sigma {:.5f} %  t {:+.2f}\n", name, samples,
               100.0 * mean, 100.0 * error, mean / std::max(error, 1e-12));
    EXPECT_LE(error, kWeak) << name << ": weak";
    ASSERT_LE(std::abs(mean), most * error + rounding)
        << name << "; " << chosen.size() << " combinations";
  }
}

INSTANTIATE_TEST_SUITE_P(Lights, ClosedForm,
                         ::testing::Range(std::size_t{0}, lit_scenes().size()),
                         [](const auto& scene) {
                           std::string name = scenes()[scene.param].name;
                           std::erase_if(name, [](char c) { return c == ',' || c == '-'; });
                           std::ranges::replace(name, ' ', '_');
                           return name;
                         });

}  // namespace
}  // namespace haarlight::render
