// SPDX-License-Identifier: Apache-2.0
#include "render/surface/surface_methods.h"

#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <utility>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/scene/texture.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr int kForever = std::numeric_limits<int>::max();

/// Straight down on (-half, half)^2 of the plane z = 0, up is +y.
Camera from_above(int side, double half) {
  CameraModel model;
  model.width = side;
  model.height = side;
  model.cx = model.cy = 0.5 * side;
  model.world_from_cam = look_at({0, 0, 10}, Vector3d::Zero(), Vector3d::UnitY());
  return {model, {.pixel_mm = 2.0 * half / side}};
}

std::vector<double> red_of(const Image<float>& image) {
  std::vector<double> red;
  for (std::size_t i = 0; i < image.pixels().size(); i += 3) {
    red.push_back(image.pixels()[i]);
  }
  return red;
}

/// A picture of side x side pixels, red alone, row by row.
class Picture {
 public:
  using Result = std::vector<double>;
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_l2(found, truth);
  }

 protected:
  explicit Picture(int side) : side_(side) {}
  [[nodiscard]] Result render(const Scene& scene, const Camera& camera,
                              const PathOptions& options, std::uint32_t samples,
                              std::size_t layer = SurfaceLayer::kRadiance) const {
    const RayCaster caster(scene);
    const PathIntegrator integrator(scene, caster, nullptr, camera, options);
    Film film(side_, side_, surface_layers(options.has_features));
    const RunResult result = run_loop(integrator, samples, film);
    HAARLIGHT_EXPECTS(result.samples == samples, "a picture of all samples");
    return red_of(film.mean(layer));
  }

  int side_;

 private:
  static RunResult run_loop(const PathIntegrator& integrator, std::uint32_t samples,
                            Film& film) {
    return haarlight::render::run(integrator, {.samples = samples}, film);
  }
};

/// Within a box that emits and reflects the same everywhere; directions are followed alone, so that
/// nothing is left to chance but where a path ends.
class Furnace : public Picture {
 public:
  [[nodiscard]] Result truth() const {
    return Result(static_cast<std::size_t>(side_) * static_cast<std::size_t>(side_),
                  kEmitted / (1.0 - kAlbedo));
  }
  [[nodiscard]] MethodScale scale() const { return {1, static_cast<long long>(side_) * side_}; }

 protected:
  explicit Furnace(MethodSize size) : Picture(by_size(size, 8, 64, 256)) {
    scene_.materials.push_back({.name = "wall",
                                .kd = Vector3d::Constant(kAlbedo),
                                .emits = Vector3d::Constant(kEmitted)});
    Mesh box = make_box({-100, -100, -100}, {100, 150, 80}, 0);
    for (Eigen::Vector3i& triangle : box.triangles) {
      std::swap(triangle[1], triangle[2]);  // its front is inside
    }
    scene_.meshes.push_back(std::move(box));
  }
  [[nodiscard]] Result picture(int most_bounces, int sure_bounces) const {
    PathOptions options;
    options.most_bounces = most_bounces;
    options.sure_bounces = sure_bounces;
    options.sampling = DirectSampling::bsdf;
    return render(scene_, from_above(side_, 50.0), options, 16);
  }

 private:
  static constexpr double kAlbedo = 0.8;
  static constexpr double kEmitted = 2.0;
  Scene scene_;
};

class CutPaths : public Furnace {
 public:
  explicit CutPaths(MethodSize size) : Furnace(size) {}
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<int, 4> kBounces{1, 4, 16, 64};
    return picture(kBounces.at(setting), kForever);
  }
};

class Roulette : public Furnace {
 public:
  explicit Roulette(MethodSize size) : Furnace(size) {}
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<int, 3> kSure{0, 4, kForever};
    return picture(64, kSure.at(setting));
  }
};

/// A floor under many lamps, whose powers differ by 100.
class ManyLamps : public Picture {
 public:
  explicit ManyLamps(MethodSize size) : Picture(by_size(size, 16, 48, 128)) {
    scene_.materials.push_back({.name = "floor", .kd = Vector3d::Constant(kAlbedo)});
    scene_.meshes.push_back(
        make_quad({-900, -900, 0}, {900, -900, 0}, {900, 900, 0}, {-900, 900, 0}, 0));
    const auto n = static_cast<std::uint64_t>(by_size(size, 64, 256, 4096));
    for (std::uint64_t i = 0; i < n; ++i) {
      const auto number = [i](std::uint64_t which) {
        return uniform_unit(hash_key(7, i, which));
      };
      scene_.point_lights.push_back(
          {.position = {1200.0 * (number(0) - 0.5), 1200.0 * (number(1) - 0.5),
                        100.0 + 200.0 * number(2)},
           .intensity = Vector3d::Constant(std::pow(100.0, number(3)))});
    }
  }
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<LightChoice, 4> kChoices{LightChoice::uniform, LightChoice::power,
                                                  LightChoice::tree, LightChoice::all};
    PathOptions options;
    options.most_bounces = 1;
    options.lights = kChoices.at(setting);
    return render(scene_, from_above(side_, kHalf), options, 16);
  }
  /// At the pixels' centres.
  [[nodiscard]] Result truth() const {
    Result radiance;
    for (int row = 0; row < side_; ++row) {
      for (int col = 0; col < side_; ++col) {
        const Vector3d at(kHalf * (2.0 * (col + 0.5) / side_ - 1.0),
                          kHalf * (1.0 - 2.0 * (row + 0.5) / side_), 0.0);
        double sum = 0.0;
        for (const PointLight& lamp : scene_.point_lights) {
          const Vector3d to_lamp = lamp.position - at;
          sum += lamp.intensity.x() * to_lamp.z() / std::pow(to_lamp.norm(), 3);
        }
        radiance.push_back(kAlbedo / std::numbers::pi * sum);
      }
    }
    return radiance;
  }
  [[nodiscard]] MethodScale scale() const {
    return {static_cast<int>(scene_.point_lights.size()),
            static_cast<long long>(side_) * side_};
  }

 private:
  static constexpr double kAlbedo = 0.8;
  static constexpr double kHalf = 50.0;
  Scene scene_;
};

/// A texture of random texels of which each pixel sees 24 x 24.
class FineTexture : public Picture {
 public:
  explicit FineTexture(MethodSize size) : Picture(by_size(size, 8, 32, 128)) {
    Image<float> picture(kTexels, kTexels, 1);
    for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
      picture.pixels()[i] = static_cast<float>(uniform_unit(hash_key(3, i)));
      mean_ += static_cast<double>(picture.pixels()[i]) / (kTexels * kTexels);
    }
    Material material{.name = "picture", .kd = Vector3d::Ones()};
    material.kd_texture.file = "random texels";
    material.kd_texture.scale.setConstant(static_cast<double>(kInPixel) * side_ / kTexels);
    material.kd_texture.picture = std::make_shared<const Texture>(std::move(picture));
    scene_.materials.push_back(std::move(material));
    scene_.meshes.push_back(
        make_quad({-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}, 0));
  }
  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<std::uint32_t, 4> kSamples{1, 16, 256, 4096};
    PathOptions options;
    options.most_bounces = 0;
    options.has_features = true;
    return render(scene_, from_above(side_, 50.0), options, kSamples.at(setting),
                  SurfaceLayer::kAlbedo);
  }
  [[nodiscard]] Result truth() const {
    return Result(static_cast<std::size_t>(side_) * static_cast<std::size_t>(side_), mean_);
  }
  [[nodiscard]] MethodScale scale() const { return {0, static_cast<long long>(side_) * side_}; }

 private:
  static constexpr int kTexels = 8;
  static constexpr int kInPixel = 24;
  Scene scene_;
  double mean_ = 0.0;
};

}  // namespace

std::vector<Method> surface_methods() {
  return {
      Method::of<CutPaths>(
          {.module = "render/surface",
           .name = "path tracing cut at a number of bounces, albedo 0.8",
           .settings = {"--bounces 1", "--bounces 4", "--bounces 16", "--bounces 64"},
           .error_norm = "relative L2 of the picture",
           .truth = "closed form: a furnace, L/(1 - albedo)",
           .exact_error = 1e-6,
           .exact_error_from = "0.8^65 = 5e-7 is left out; pictures are floats"}),
      Method::of<Roulette>(
          {.module = "render/surface",
           .name = "Russian roulette, 16 samples, albedo 0.8",
           .settings = {"from the first bounce on", "from the fifth bounce on", "never"},
           .error_norm = "relative L2 of the picture: noise, no bias",
           .truth = "closed form: a furnace, L/(1 - albedo)",
           .exact_error = 1e-6,
           .exact_error_from = "0.8^65 = 5e-7 is left out; pictures are floats"}),
      Method::of<ManyLamps>(
          {.module = "render/surface",
           .name = "choice among many lights, 16 samples",
           .settings = {"--lights uniform", "--lights power", "--lights tree", "--lights all"},
           .error_norm = "relative L2 of the picture: noise, no bias",
           .truth = "closed form: the sum over the lights at the pixels' centres",
           .exact_error = 2e-3,
           .exact_error_from =
               "samples are not in the middle of a pixel in the mean: 16^-1.5/sqrt(12) of its "
               "side, 6.25 mm, each way, of light that falls by at most 3 % a mm"}),
      Method::of<FineTexture>(
          {.module = "render/surface",
           .name = "texture without a footprint filter, 24 x 24 texels in a pixel",
           .settings = {"--spp 1", "--spp 16", "--spp 256", "--spp 4096"},
           .error_norm = "relative L2 of the albedo: noise, no bias",
           .truth = "closed form: the texels' mean",
           .exact_error = 9e-3,
           .exact_error_from =
               "independent samples: texels even in 0..1, 0.58 of their mean over sqrt(4096)"}),
  };
}

}  // namespace haarlight::render
