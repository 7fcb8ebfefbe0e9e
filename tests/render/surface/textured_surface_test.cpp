// SPDX-License-Identifier: Apache-2.0
/// @file
/// Pictures of textured surfaces that are known in closed form.

#include <cmath>
#include <memory>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "render/scene/texture.h"
#include "render/scene/texture_files.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kTexels = 8;
constexpr int kPixels = 32;
constexpr int kPixelsPerTexel = (kPixels / kTexels) * (kPixels / kTexels);
constexpr double kEmitted = 2.0;

Image<float> random_picture() {
  Image<float> picture(kTexels, kTexels, 3);
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    picture.pixels()[i] = static_cast<float>(uniform_unit(hash_key(3, i)));
  }
  return picture;
}

/// A square with the random picture, in a closed box that emits 2 everywhere and reflects nothing,
/// seen square on from above: the texture covers the view `repeats` times in each direction.
SceneFile textured_square(const Image<float>& picture, int repeats) {
  const testing::TemporaryFolder folder;
  write_image(folder / "p.exr", picture.view());
  write_file_atomically(folder / "s.toml", std::string_view(R"(
[[material]]
name = "picture"
kd_texture = "p.exr"
[[quad]]
corners = [[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]]
material = "picture"
[camera]
size = [32, 32]
eye = [0, 0, 100]
target = [0, 0, 0]
up = [0, 1, 0]
width_mm = 80
)"));
  SceneFile file = read_scene(folder / "s.toml");
  load_textures(file.scene, 1'000'000);
  file.scene.materials[0].kd_texture.scale.setConstant(repeats);
  file.scene.materials.push_back(
      {.name = "sky", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(kEmitted)});
  Mesh box = make_box({-900, -900, -900}, {900, 900, 900}, 1);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);  // its front is inside
  }
  file.scene.meshes.push_back(box);
  return file;
}

std::unique_ptr<Film> render(const SceneFile& file, SamplerKind sampler,
                             std::uint32_t samples) {
  const RayCaster caster(file.scene);
  PathOptions options;
  options.sampler = sampler;
  options.has_features = true;
  const PathIntegrator integrator(file.scene, caster, nullptr, {file.camera, file.optics},
                                  options);
  auto film =
      std::make_unique<Film>(file.camera.width, file.camera.height, surface_layers(true));
  EXPECT_EQ(run(integrator, {.samples = samples}, *film).samples, samples);
  return film;
}

Vector3d at_pixel(const Texture& texture, int x, int y) {
  return texture.at({(x + 0.5) / kPixels, 1.0 - (y + 0.5) / kPixels});
}

TEST(TexturedSurface, ItsAlbedoIsThePictureUprightAtThePixelCentres) {
  const Image<float> picture = random_picture();
  const Texture texture(picture);
  const std::unique_ptr<Film> film =
      render(textured_square(picture, 1), SamplerKind::sobol, 256);
  const Image<float> albedo = film->mean(SurfaceLayer::kAlbedo);
  for (int y = 0; y < kPixels; ++y) {
    for (int x = 0; x < kPixels; ++x) {
      const Vector3d truth = at_pixel(texture, x, y);
      for (int c = 0; c < 3; ++c) {
        // A pixel's edges are at texels' centres or between them, so that the texture is bilinear
        // over it, and its mean that of the centre. The samples' mean position: one in each 256th
        // of a side, standard deviation 256^-1.5 / sqrt(12) of a pixel, which a texel
        // on 4 x 4 pixels makes at most 2.5e-5 of both directions; five of them.
        EXPECT_NEAR(albedo(y, x, c), truth[c], 1.3e-4) << x << ' ' << y << ' ' << c;
      }
    }
  }
  // Upright: the top row of pixels shows the picture's.
  EXPECT_NEAR(albedo(2, 2, 0), picture(0, 0, 0), 0.2);
}

TEST(TexturedSurface, UnderTheSameLightFromAllSidesShowsItsAlbedo) {
  const Image<float> picture = random_picture();
  const Texture texture(picture);
  constexpr std::uint32_t kSamples = 64;
  const std::unique_ptr<Film> film =
      render(textured_square(picture, 1), SamplerKind::independent, kSamples);
  const Image<float> radiance = film->mean(SurfaceLayer::kRadiance);
  const Image<float> error = film->standard_error(SurfaceLayer::kRadiance);
  double sum = 0.0;
  double squares = 0.0;
  double variance = 0.0;
  double truth_sum = 0.0;
  for (const float texel : picture.pixels()) {
    truth_sum += kEmitted * texel * kPixelsPerTexel;
  }
  for (int y = 0; y < kPixels; ++y) {
    for (int x = 0; x < kPixels; ++x) {
      const Vector3d truth = kEmitted * at_pixel(texture, x, y);
      for (int c = 0; c < 3; ++c) {
        const double deviation = (radiance(y, x, c) - truth[c]) / error(y, x, c);
        sum += radiance(y, x, c);
        squares += deviation * deviation / (3.0 * kPixels * kPixels);
        variance += static_cast<double>(error(y, x, c)) * error(y, x, c);
      }
    }
  }
  // Each pixel is off by as much as it says: over 1024 pixels whose colours share their paths the
  // root has a standard deviation of 2.2 %, and an error estimated from 64 samples adds 1.6 %.
  EXPECT_NEAR(std::sqrt(squares), 1.0, 0.1);
  // Tents sum to 1, so that the picture's mean is that of its texels. Colours share paths: up to
  // sqrt(3) of the standard error of independent ones; four of them.
  EXPECT_LE(std::sqrt(3.0 * variance), 2e-3 * truth_sum)
      << "weak: it would see no error of 1 %";
  EXPECT_NEAR(sum, truth_sum, 4.0 * std::sqrt(3.0 * variance));
}

/// Standard deviation of the texture's first channel over its square: by Gauss's two points in each
/// cell between texel centres, exact for the square of a bilinear function.
double deviation_of(const Texture& texture) {
  const double reach = 0.5 / std::sqrt(3.0);
  double mean = 0.0;
  double square = 0.0;
  for (int cell = 0; cell < kTexels * kTexels; ++cell) {
    const Eigen::Vector2i texel(cell % kTexels, cell / kTexels);
    for (const double du : {0.5 - reach, 0.5 + reach}) {
      for (const double dv : {0.5 - reach, 0.5 + reach}) {
        const double value =
            texture.at((texel.cast<double>() + Vector2d(0.5 + du, 0.5 + dv)) / kTexels).x();
        mean += value / (4.0 * kTexels * kTexels);
        square += value * value / (4.0 * kTexels * kTexels);
      }
    }
  }
  return std::sqrt(square - mean * mean);
}

TEST(TexturedSurface, WhereAPixelSeesManyTexelsItsSamplesAverageThem) {
  const Image<float> picture = random_picture();
  double mean = 0.0;
  for (int i = 0; i < kTexels * kTexels; ++i) {
    mean += picture(i / kTexels, i % kTexels) / (1.0 * kTexels * kTexels);
  }
  const SceneFile file = textured_square(picture, 3 * kPixels);  // 24 x 24 texels in a pixel
  const double deviation = deviation_of(Texture(picture));
  for (const std::uint32_t samples : {4U, 64U, 1024U}) {
    const auto relative = [&](SamplerKind sampler) {
      const Image<float> albedo = render(file, sampler, samples)->mean(SurfaceLayer::kAlbedo);
      double squares = 0.0;
      for (int i = 0; i < kPixels * kPixels; ++i) {
        const double off = albedo(i / kPixels, i % kPixels) - mean;
        squares += off * off / (kPixels * kPixels);
      }
      return std::sqrt(squares * samples) / deviation;
    };
    // Of 1024 pixels: the root has a standard deviation of 1 / sqrt(2048); four of them.
    const double independent = relative(SamplerKind::independent);
    EXPECT_NEAR(independent, 1.0, 0.09) << samples;
    RecordProperty("independent_" + std::to_string(samples), std::to_string(independent));
    const double sobol = relative(SamplerKind::sobol);
    EXPECT_LE(sobol, 1.09) << samples;
    RecordProperty("sobol_" + std::to_string(samples), std::to_string(sobol));
  }
}

}  // namespace
}  // namespace haarlight::render
