// SPDX-License-Identifier: Apache-2.0
#include "sim/transport.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <span>
#include <vector>

#include <fmt/format.h>

#include "core/log.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"

namespace haarlight::sim {

namespace {

using Eigen::Vector3d;

constexpr int kTransportVersion = 4;  // incremented when the same input gives new numbers

// Points of one surface: normals within 5 degrees, and no step between them.
constexpr double kOneSurfaceCosine = 0.9962;
constexpr double kOneSurfaceStep = 0.1;

/// Collects the bytes of everything relevant, for the key.
class KeyBytes {
 public:
  void add(double value) { append(&value, sizeof value); }
  void add(const Vector3d& v) {
    add(v.x());
    add(v.y());
    add(v.z());
  }
  [[nodiscard]] std::string hash() const { return content_hash(bytes_); }

 private:
  void append(const void* data, std::size_t size) {
    bytes_.append(static_cast<const char*>(data), size);
  }
  std::string bytes_;
};

/// How a pixel responds to red, green and blue.
Vector3d response(BayerPattern pattern, int x, int y) {
  // Colours of the 2 x 2 cell in raster order: 0 red, 1 green, 2 blue.
  const char* cell = nullptr;
  switch (pattern) {
    case BayerPattern::none:
      return Vector3d::Constant(1.0 / 3.0);
    case BayerPattern::rggb:
      cell = "\0\1\1\2";
      break;
    case BayerPattern::bggr:
      cell = "\2\1\1\0";
      break;
    case BayerPattern::grbg:
      cell = "\1\0\2\1";
      break;
    case BayerPattern::gbrg:
      cell = "\1\2\0\1";
      break;
  }
  return Vector3d::Unit(cell[(y % 2) * 2 + x % 2]);
}

std::size_t row_values(const TransportData& data) {
  return static_cast<std::size_t>(data.width) * static_cast<std::size_t>(data.n_lights);
}

/// Rows of a strip. @throws Error(usage)
int rows_within(std::uint64_t memory_bytes, const TransportData& data,
                const std::string& rig_file) {
  const std::uint64_t sums = sizeof(double) * static_cast<std::uint64_t>(data.width) *
                             static_cast<std::uint64_t>(data.height);
  const std::uint64_t row = sizeof(float) * row_values(data);
  if (memory_bytes < sums + row) {
    throw Error(fmt::format("{} bytes are not enough for one row of {} pixels under {} lights",
                            memory_bytes, data.width, data.n_lights),
                rig_file, fmt::format("give at least {} (--memory)", sums + row),
                ExitCode::usage);
  }
  return static_cast<int>(
      std::min((memory_bytes - sums) / row, static_cast<std::uint64_t>(data.height)));
}

/// One camera's rows of T.
class Renderer {
 public:
  Renderer(const Rig& rig, int camera, const render::Scene& scene,
           const TransportOptions& options)
      : camera_(&rig.cameras[static_cast<std::size_t>(camera)]),
        scene_(&scene),
        n_subpixels_(options.n_subpixels),
        subpixels_at_edges_(options.subpixels_at_edges),
        caster_(scene),
        direct_(caster_, render::rig_lights(rig), options.direct),
        indirect_(scene, caster_, direct_, options.indirect),
        squared_(static_cast<std::size_t>(camera_->model.height)) {}

  [[nodiscard]] int width() const { return camera_->model.width; }
  [[nodiscard]] int height() const { return camera_->model.height; }
  [[nodiscard]] int n_lights() const { return direct_.n_lights(); }

  /// @param strip  (n_lights, n_rows, width) @return rays
  std::uint64_t render(int y0, int n_rows, std::span<float> strip, Progress& progress);

  /// Standard error of the indirect light in what was rendered over the root of its squares (L2), of
  /// the halves' difference.
  [[nodiscard]] double relative_l2() const;

 private:
  /// What the middle of a pixel shows, if all its sub-pixels show the same smooth surface.
  [[nodiscard]] std::optional<render::SurfacePoint> one_surface(int x, int y) const;
  /// Of one pixel, all (n_lights,).
  struct PixelSums {
    std::vector<render::LightContribution> contributions;  ///< working memory
    std::vector<double> direct;
    std::vector<double> even;  ///< halves of the indirect light
    std::vector<double> odd;

    explicit PixelSums(std::size_t n_lights)
        : contributions(n_lights), direct(n_lights), even(n_lights), odd(n_lights) {}
    void clear() {
      for (std::vector<double>* sums : {&direct, &even, &odd}) {
        std::fill(sums->begin(), sums->end(), 0.0);
      }
    }
  };
  struct Squares {
    double value = 0.0;
    double error = 0.0;
  };
  /// Adds a pixel's sub-pixels. @return rays
  [[nodiscard]] std::uint64_t add_pixel(int x, int y, PixelSums& sums) const;

  const CameraSpec* camera_;
  const render::Scene* scene_;
  int n_subpixels_;
  bool subpixels_at_edges_;
  render::RayCaster caster_;
  render::DirectLight direct_;
  render::IndirectLight indirect_;
  std::vector<Squares> squared_;  ///< by row, of all its values
};

std::optional<render::SurfacePoint> Renderer::one_surface(int x, int y) const {
  const int n = n_subpixels_;
  std::optional<render::SurfacePoint> middle =
      render::visible_surface(caster_, camera_->model, x + 0.5, y + 0.5);
  for (int s = 0; middle && s < n * n; ++s) {
    const int sub_row = s / n;
    const std::optional<render::SurfacePoint> other = render::visible_surface(
        caster_, camera_->model, x + (s % n + 0.5) / n, y + (sub_row + 0.5) / n);
    if (!other || other->material != middle->material ||
        other->normal.dot(middle->normal) < kOneSurfaceCosine) {
      return std::nullopt;
    }
    const Vector3d way = other->point - middle->point;
    if (std::abs(way.dot(middle->normal)) > kOneSurfaceStep * way.norm()) {
      return std::nullopt;
    }
  }
  return middle;
}

std::uint64_t Renderer::add_pixel(int x, int y, PixelSums& sums) const {
  const int n = n_subpixels_;
  const Vector3d colour = response(camera_->bayer, x, y);
  const auto add = [&](const render::SurfacePoint& surface, int s, int n_subpixels) {
    const render::Material& material =
        scene_->materials[static_cast<std::size_t>(surface.material)];
    std::uint64_t n_rays =
        direct_.evaluate(surface, material,
                         hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x),
                                  static_cast<std::uint64_t>(s)),
                         sums.contributions);
    const double kd = n_subpixels * colour.dot(material.kd);
    const double ks = n_subpixels * material.ks;
    for (std::size_t k = 0; k < sums.direct.size(); ++k) {
      sums.direct[k] +=
          kd * sums.contributions[k].diffuse + ks * sums.contributions[k].specular;
    }
    if (indirect_.options().bounces > 0) {
      // A sub-pixel's part of the paths, rounded up to an even number.
      const int part = indirect_.options().paths * n_subpixels / (n * n);
      const int n_paths = std::max(2, part + part % 2);
      n_rays += indirect_.add(surface, colour,
                              {.x = x,
                               .y = y,
                               .first = s * n_paths,
                               .n = n_paths,
                               .weight = static_cast<double>(n_subpixels)},
                              sums.contributions, sums.even, sums.odd);
    }
    return n_rays;
  };
  std::uint64_t n_rays = 0;
  if (subpixels_at_edges_ && n > 1) {
    n_rays += static_cast<std::uint64_t>(n * n + 1);
    if (const std::optional<render::SurfacePoint> surface = one_surface(x, y)) {
      return n_rays + add(*surface, 0, n * n);
    }
  }
  for (int s = 0; s < n * n; ++s) {
    const int sub_row = s / n;
    const std::optional<render::SurfacePoint> surface = render::visible_surface(
        caster_, camera_->model, x + (s % n + 0.5) / n, y + (sub_row + 0.5) / n);
    ++n_rays;
    n_rays += surface ? add(*surface, s, 1) : 0;
  }
  return n_rays;
}

std::uint64_t Renderer::render(int y0, int n_rows, std::span<float> strip, Progress& progress) {
  constexpr std::size_t kPixels = 16;  // a cache line of each plane
  const auto n_lights = static_cast<std::size_t>(direct_.n_lights());
  const auto columns = static_cast<std::size_t>(width());
  const std::size_t n_blocks = (columns + kPixels - 1) / kPixels;  // of a row
  const std::size_t plane = static_cast<std::size_t>(n_rows) * columns;
  std::atomic<std::uint64_t> n_rays = 0;
  std::vector<Squares> squares(static_cast<std::size_t>(n_rows) * n_blocks);
  const double n_subpixels = n_subpixels_ * n_subpixels_;
  parallel_for(
      static_cast<std::size_t>(n_rows) * n_blocks, 1, [&](std::size_t begin, std::size_t end) {
        PixelSums sums(n_lights);
        std::vector<float> block(kPixels * n_lights);
        for (std::size_t i = begin; i < end; ++i) {
          const std::size_t row = i / n_blocks;
          const std::size_t x0 = i % n_blocks * kPixels;
          const std::size_t count = std::min(kPixels, columns - x0);
          for (std::size_t x = 0; x < count; ++x) {
            sums.clear();
            n_rays += add_pixel(static_cast<int>(x0 + x), y0 + static_cast<int>(row), sums);
            for (std::size_t k = 0; k < n_lights; ++k) {
              const double value =
                  (sums.direct[k] + 0.5 * (sums.even[k] + sums.odd[k])) / n_subpixels;
              const double error = 0.5 * (sums.even[k] - sums.odd[k]) / n_subpixels;
              squares[i].value += value * value;
              squares[i].error += error * error;
              block[k * kPixels + x] = static_cast<float>(value);
            }
          }
          for (std::size_t k = 0; k < n_lights; ++k) {
            std::copy_n(block.data() + k * kPixels, count,
                        strip.data() + k * plane + row * columns + x0);
          }
          if (x0 + count == columns) {
            progress.advance();
          }
        }
      });
  for (std::size_t i = 0; i < squares.size(); ++i) {
    Squares& row = squared_[static_cast<std::size_t>(y0) + i / n_blocks];
    row.value += squares[i].value;
    row.error += squares[i].error;
  }
  return n_rays;
}

double Renderer::relative_l2() const {
  Squares sum;
  for (const Squares& row : squared_) {
    sum.value += row.value;
    sum.error += row.error;
  }
  return sum.value > 0.0 ? std::sqrt(sum.error / sum.value) : 0.0;
}

}  // namespace

std::filesystem::path default_transport_cache() {
  const char* cache = std::getenv("XDG_CACHE_HOME");  // NOLINT(concurrency-mt-unsafe)
  if (cache != nullptr && *cache != '\0') {
    return std::filesystem::path(cache) / "haarlight";
  }
  const char* home = std::getenv("HOME");  // NOLINT(concurrency-mt-unsafe)
  if (home != nullptr && *home != '\0') {
    return std::filesystem::path(home) / ".cache" / "haarlight";
  }
  return std::filesystem::temp_directory_path() / "haarlight";
}

std::string transport_key(const Rig& rig, int camera, const render::Scene& scene,
                          const TransportOptions& options) {
  KeyBytes key;
  key.add(kTransportVersion);
  for (const render::SquareLight& light : render::rig_lights(rig)) {
    key.add(light.centre);
    key.add(light.u);
    key.add(light.v);
    key.add(light.emits);
    key.add(light.width_mm);
    key.add(light.height_mm);
    key.add(light.lobe_mu);
  }
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(camera));
  const CameraModel& model = spec.model;
  for (const double value :
       {static_cast<double>(model.width), static_cast<double>(model.height), model.fx, model.fy,
        model.cx, model.cy}) {
    key.add(value);
  }
  for (int i = 0; i < 5; ++i) {
    key.add(model.distortion[i]);
  }
  for (int i = 0; i < 12; ++i) {
    key.add(model.world_from_cam.matrix()(i / 4, i % 4));
  }
  key.add(static_cast<double>(spec.bayer));
  key.add(options.n_subpixels);
  if (options.subpixels_at_edges) {
    key.add(1.0);
  }
  if (options.indirect.bounces > 0) {
    key.add(2.0);
    key.add(options.indirect.bounces);
    key.add(options.indirect.paths);
  }
  key.add(options.direct.mixed_grid);
  key.add(options.direct.sample_all ? 1.0 : 0.0);
  key.add(static_cast<double>(options.direct.seed));
  for (const render::Material& material : scene.materials) {
    key.add(material.kd);
    key.add(material.ks);
    key.add(material.exponent);
  }
  HAARLIGHT_EXPECTS(scene.instances.empty(), "instances are expanded");
  for (const render::Mesh& mesh : scene.meshes) {
    key.add(mesh.material);
    key.add(static_cast<double>(mesh.vertices.size()));
    for (const Vector3d& vertex : mesh.vertices) {
      key.add(vertex);
    }
    key.add(static_cast<double>(mesh.triangles.size()));
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      key.add(triangle.cast<double>());
    }
    key.add(static_cast<double>(mesh.normals.size()));
    for (const Vector3d& normal : mesh.normals) {
      key.add(normal);
    }
  }
  return key.hash();
}

Transport make_transport(const Rig& rig, int camera, const render::Scene& scene,
                         const TransportOptions& options) {
  HAARLIGHT_EXPECTS(camera >= 0 && camera < static_cast<int>(rig.cameras.size()),
                    "a camera of the rig");
  HAARLIGHT_EXPECTS(options.n_subpixels >= 1, "at least one sub-pixel");
  const std::string key = transport_key(rig, camera, scene, options);
  const std::filesystem::path folder =
      options.cache_folder.empty() ? default_transport_cache() : options.cache_folder;
  const std::filesystem::path file = folder / ("transport-" + key + ".bin");
  if (std::filesystem::exists(file)) {
    try {
      Transport transport = Transport::open(file, options.progress);
      if (transport.key() == key) {
        return transport;
      }
      log_warning(file.string() + " was made from something else; it is made again");
    } catch (const Error& error) {
      log_warning(std::string(error.what()) + "; it is made again");
    }
  }
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  if (failed) {
    throw Error("the cache folder cannot be made: " + failed.message(), folder.string(),
                "give another one, or set XDG_CACHE_HOME", ExitCode::io);
  }

  const auto start = std::chrono::steady_clock::now();
  Renderer renderer(rig, camera, scene, options);
  TransportData data;
  data.width = renderer.width();
  data.height = renderer.height();
  data.n_lights = renderer.n_lights();
  data.key = key;
  const int most_rows = rows_within(options.memory_bytes, data, rig.file.string());
  TransportWriter writer(file, data);
  Progress progress("transport", static_cast<std::size_t>(data.height), options.progress);
  std::uint64_t n_rays = 0;
  std::vector<float> strip;
  for (int y0 = 0; y0 < data.height; y0 += most_rows) {
    const int n_rows = std::min(most_rows, data.height - y0);
    strip.resize(static_cast<std::size_t>(n_rows) * row_values(data));
    n_rays += renderer.render(y0, n_rows, strip, progress);
    writer.append_rows(strip);
  }
  strip = {};
  if (options.indirect.bounces > 0 && options.progress != ProgressStyle::none) {
    fmt::print(stderr,
               "indirect light: {} bounces, {} paths per pixel, standard error {:.2g} of the "
               "matrix (L2)\n",
               options.indirect.bounces, options.indirect.paths, renderer.relative_l2());
  }
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  return writer.finish(n_rays, seconds.count(), options.progress);
}

}  // namespace haarlight::sim
