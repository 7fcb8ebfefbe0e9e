// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_scene.h"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/scene/scene_io.h"

namespace haarlight::apps {

namespace {

/// Whether anything in it is a light.
bool is_lit(const render::Scene& scene) {
  const auto emits = [&scene](const auto& surface) {
    return scene.materials[static_cast<std::size_t>(surface.material)].emits.maxCoeff() > 0.0;
  };
  return std::ranges::any_of(scene.meshes, emits) ||
         std::ranges::any_of(scene.spheres, emits) || std::ranges::any_of(scene.disks, emits) ||
         std::ranges::any_of(
             scene.instances,
             [&scene](const render::Instance& instance) {
               const int material = render::material_of(scene, instance);
               return scene.materials[static_cast<std::size_t>(material)].emits.maxCoeff() >
                      0.0;
             }) ||
         std::ranges::any_of(
             scene.point_lights,
             [](const auto& light) { return light.intensity.maxCoeff() > 0.0; }) ||
         std::ranges::any_of(
             scene.directional_lights,
             [](const auto& light) { return light.irradiance.maxCoeff() > 0.0; }) ||
         scene.environment.has_value();
}

}  // namespace

bool has_ending(const std::string& file, std::string_view ending) {
  return std::filesystem::path(file).extension() == ending;
}

std::string preview_of(const std::string& output) {
  return has_ending(output, ".exr")
             ? std::filesystem::path(output).replace_extension(".png").string()
             : std::string();
}

void require_outputs(const std::string& output, const std::string& second, const char* option,
                     bool force) {
  const std::string preview = preview_of(output);
  for (const std::string& picture : {output, preview, second}) {
    if (!picture.empty()) {
      require_absent(picture, force);
      require_picture_name(picture);
    }
  }
  if (!second.empty() && (second == output || second == preview)) {
    throw Error("two pictures would be one file", output,
                std::string("give ") + option + " another name", ExitCode::usage);
  }
}

void add_exposure_option(Command& verb, std::optional<double>& exposure) {
  verb.option("--exposure", &exposure,
              "Factor for a .png (default: 98 % of the values are not clipped)",
              {.bounds = Bounds{1e-9, 1e9}});
}

void set_picture_size(render::SceneFile& file, std::vector<int> size) {
  if (size.empty() && file.film.size) {
    size.assign(file.film.size->begin(), file.film.size->end());
  }
  if (!size.empty()) {
    file.optics.pixel_mm *= static_cast<double>(file.camera.width) / size[0];
    file.camera = render::resized(file.camera, size[0], size[1]);
  }
}

render::SceneFile read_lit_scene(const std::string& path, std::vector<int> size) {
  render::SceneFile file = render::read_scene(path);
  if (!file.has_camera) {
    throw Error("the scene has no camera", path,
                render::is_gltf(path) ? "export it with its camera: docs/reference/gltf.md"
                                      : "add a [camera]: docs/reference/scene-file.md");
  }
  set_picture_size(file, std::move(size));
  if (!is_lit(file.scene)) {
    throw Error(
        "nothing in the scene emits light", path,
        render::is_gltf(path)
            ? "export it with its lamps (punctual lights), or give a material emission; lamps "
              "with an area and skies are not in glTF: docs/reference/gltf.md"
            : "give the [[material]] of a shape emits = [red, green, blue], or add a [[light]] "
              "or an [environment]: docs/reference/scene-file.md");
  }
  return file;
}

}  // namespace haarlight::apps
