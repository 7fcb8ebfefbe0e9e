// SPDX-License-Identifier: Apache-2.0
#include "sim/transport.h"

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "core/log.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/picture.h"
#include "haarlight/render/rig_lights.h"

namespace haarlight::sim {

namespace {

using Eigen::Vector3d;

constexpr int kTransportVersion = 4;  // incremented when the same input gives new numbers

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
  key.add(options.direct.mixed_grid);
  key.add(options.direct.sample_all ? 1.0 : 0.0);
  key.add(static_cast<double>(options.direct.seed));
  for (const render::Material& material : scene.materials) {
    key.add(material.kd);
    key.add(material.ks);
    key.add(material.exponent);
  }
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
      Transport transport = Transport::open(file);
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
  const CameraSpec& spec = rig.cameras[static_cast<std::size_t>(camera)];
  const CameraModel& model = spec.model;
  const render::RayCaster caster(scene);
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  const render::DirectLight direct(caster, lights, options.direct);
  const auto n_lights = lights.size();
  const auto width = static_cast<std::size_t>(model.width);
  const auto height = static_cast<std::size_t>(model.height);
  const std::size_t n_pixels = width * height;
  std::vector<float> planes(n_lights * n_pixels);
  std::vector<std::uint64_t> rays_of_row(height, 0);
  const int n = options.n_subpixels;
  Progress progress("transport", height, options.progress);
  parallel_for(height, 1, [&](std::size_t y0, std::size_t y1) {
    std::vector<render::LightContribution> contributions(n_lights);
    std::vector<double> sums(n_lights);
    std::vector<float> row(width * n_lights);
    for (std::size_t y = y0; y < y1; ++y) {
      for (std::size_t x = 0; x < width; ++x) {
        std::fill(sums.begin(), sums.end(), 0.0);
        const Vector3d colour = response(spec.bayer, static_cast<int>(x), static_cast<int>(y));
        for (int s = 0; s < n * n; ++s) {
          const int sub_row = s / n;
          const std::optional<render::SurfacePoint> surface =
              render::visible_surface(caster, model, static_cast<double>(x) + (s % n + 0.5) / n,
                                      static_cast<double>(y) + (sub_row + 0.5) / n);
          ++rays_of_row[y];
          if (!surface) {
            continue;
          }
          const render::Material& material =
              scene.materials[static_cast<std::size_t>(surface->material)];
          rays_of_row[y] += direct.evaluate(
              *surface, material, hash_key(y, x, static_cast<std::uint64_t>(s)), contributions);
          const double kd = colour.dot(material.kd);
          for (std::size_t k = 0; k < n_lights; ++k) {
            sums[k] += kd * contributions[k].diffuse + material.ks * contributions[k].specular;
          }
        }
        for (std::size_t k = 0; k < n_lights; ++k) {
          row[k * width + x] = static_cast<float>(sums[k] / (n * n));
        }
      }
      for (std::size_t k = 0; k < n_lights; ++k) {
        std::copy_n(row.begin() + static_cast<std::ptrdiff_t>(k * width), width,
                    planes.begin() + static_cast<std::ptrdiff_t>(k * n_pixels + y * width));
      }
      progress.advance();
    }
  });
  TransportData data;
  data.width = model.width;
  data.height = model.height;
  data.n_lights = static_cast<int>(n_lights);
  for (const std::uint64_t rays : rays_of_row) {
    data.n_rays += rays;
  }
  data.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  data.key = key;
  data.planes = planes;
  write_transport(file, data);
  return Transport::open(file);
}

}  // namespace haarlight::sim
