// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/photometric_stereo.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/session/light_file.h"
#include "sim/transport.h"
#include "tests/temporary_folder.h"

/// @file
/// Captures whose normals are known: rendered by others (rti_synth), and by the twin.

namespace haarlight::testing {

inline const std::filesystem::path kSynthetic =
    HAARLIGHT_SOURCE_DIR "/../shared/data/rti_synth";

struct Rendered {
  std::optional<MemoryStack> stack;
  relight::StereoLights lights;
  Image<float> normals;  ///< (height, width, 3) unit
};

/// @param is_decoded  sRGB pictures to linear light; false: the numbers as they are
inline Rendered read_rendered(const std::string& name, bool is_decoded) {
  const std::filesystem::path folder = kSynthetic / name / "Dome";
  Rendered capture;
  const session::LightList list = session::read_light_file(folder / "dirs.lp");
  for (const session::SessionLight& light : list.lights) {
    const int k = static_cast<int>(capture.lights.directions.size());
    capture.lights.directions.push_back(light.coordinates.normalized());
    const Image<float> picture = is_decoded ? read_linear_image(folder / light.name)
                                            : read_picture(folder / light.name).pixels;
    if (!capture.stack) {
      capture.stack.emplace(StackDims{picture.width(), picture.height(), 3,
                                      static_cast<int>(list.lights.size())});
    }
    for (int y = 0; y < picture.height(); ++y) {
      for (int x = 0; x < picture.width(); ++x) {
        for (int c = 0; c < 3; ++c) {
          capture.stack->at(c, y, x, k) = picture(y, x, c);
        }
      }
    }
  }
  capture.normals = read_picture(folder / "normals.png").pixels;
  for (float& value : capture.normals.pixels()) {
    value = 2.0F * value - 1.0F;
  }
  return capture;
}

/// The cube of 32 x 32 lights under every second row and column, with a small camera.
inline Rig twin_rig(int width, int height) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  Face& face = rig.faces[0];
  face.rows = face.cols = 16;
  face.pitch_mm = 60.0;
  CameraModel& camera = rig.cameras[0].model;
  const double scale = static_cast<double>(width) / camera.width;
  camera.width = width;
  camera.height = height;
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  rig.cameras[0].frame_width = width;
  rig.cameras[0].active_rows = height;
  return rig;
}

struct Twin {
  MemoryStack stack;
  relight::StereoLights lights;
};

inline Twin capture_twin(const Rig& rig, const render::Scene& scene) {
  const TemporaryFolder folder;
  sim::TransportOptions options;
  options.cache_folder = folder.path();
  const sim::Transport transport = sim::make_transport(rig, 0, scene, options);
  const CameraModel& camera = rig.cameras[0].model;
  Twin twin{MemoryStack({camera.width, camera.height, 1, rig.n_lights()}), {}};
  for (int k = 0; k < rig.n_lights(); ++k) {
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        twin.stack.at(0, y, x, k) =
            static_cast<float>(double{transport.plane(k)(y, x)} / transport.scale());
      }
    }
  }
  twin.lights.are_near = true;
  for (const LightElement& element : light_elements(rig)) {
    twin.lights.near.push_back({element.centre, element.emits, element.lobe_mu});
    twin.lights.directions.push_back((element.centre - rig.object_centre).normalized());
  }
  return twin;
}

inline render::Scene ground() {
  render::Scene scene;
  scene.materials.push_back({"paper", Eigen::Vector3d::Constant(0.8), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-1000, -1000, 0}, {1000, -1000, 0}, {1000, 1000, 0},
                                           {-1000, 1000, 0}, 0));
  return scene;
}

/// What a camera sees of a scene, pixel by pixel.
struct SeenScene {
  /// (height, width, 3) unit, world frame: the mean of albedo times normal over the pixel,
  /// which is what a photometric fit of all of it can find.
  Image<float> normal;
  Image<float> height;  ///< (height, width) mm above z = 0, the mean
  Image<float> object;  ///< (height, width) fraction of the pixel that rises above z = 0
};

inline SeenScene see(const render::Scene& scene, const CameraModel& camera) {
  constexpr int kSub = 4;
  constexpr double kOnGround = 0.01;  // mm
  const render::RayCaster caster(scene);
  SeenScene seen{Image<float>(camera.height, camera.width, 3),
                 Image<float>(camera.height, camera.width, 1),
                 Image<float>(camera.height, camera.width, 1)};
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (int i = 0; i < kSub * kSub; ++i) {
        const int row = i / kSub;
        const auto hit = render::visible_surface(caster, camera, x + (i % kSub + 0.5) / kSub,
                                                 y + (row + 0.5) / kSub);
        if (!hit) {
          continue;
        }
        sum += scene.materials[static_cast<std::size_t>(hit->material)].kd.mean() * hit->normal;
        seen.object(y, x) += hit->point.z() > kOnGround ? 1.0F / (kSub * kSub) : 0.0F;
        seen.height(y, x) += static_cast<float>(hit->point.z() / (kSub * kSub));
      }
      for (int c = 0; c < 3 && sum.norm() > 0.0; ++c) {
        seen.normal(y, x, c) = static_cast<float>(sum[c] / sum.norm());
      }
    }
  }
  return seen;
}

}  // namespace haarlight::testing
