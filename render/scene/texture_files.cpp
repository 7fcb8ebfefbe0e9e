// SPDX-License-Identifier: Apache-2.0
#include "render/scene/texture_files.h"

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "core/picture/picture_bytes.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "render/scene/gltf_material.h"
#include "render/scene/texture.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr float kRounding = 1e-4F;

/// @throws Error  at its first texel outside 0..1
void require_albedos(const Image<float>& picture, const MaterialTexture& named) {
  constexpr auto kInColour =
      std::to_array<std::string_view>({" in red", " in green", " in blue"});
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; c < picture.channels(); ++c) {
        const float value = picture(y, x, c);
        if (!(value >= -kRounding && value <= 1.0F + kRounding)) {
          throw Error(
              fmt::format("pixel (x {}, y {}) of texture {} is {:.4g}{}, an albedo "
                          "outside 0..1",
                          x, y, named.file, value,
                          picture.channels() == 3 ? kInColour.at(static_cast<std::size_t>(c))
                                                  : std::string_view()),
              named.where,
              "scale the picture to 0..1, or save it as sRGB: a texture is the "
              "reflected fraction of the light");
        }
      }
    }
  }
}

/// @param is_colour  decode it to linear light; else its numbers as they are
Image<float> read_picture_of(const MaterialTexture& texture, bool is_colour = true) {
  try {
    PictureFile picture =
        texture.bytes != nullptr
            ? read_picture_bytes(std::as_bytes(std::span(*texture.bytes)), texture.file)
            : read_picture(texture.file);
    return is_colour ? linear_light(std::move(picture), texture.file)
                     : std::move(picture.pixels);
  } catch (const Error& error) {
    throw Error(fmt::format("the texture: {} ({})", error.problem(), error.where()),
                texture.where, error.hint(), error.code());
  }
}

}  // namespace

namespace {

/// Over all texels, RGB; 1 without a texture. @throws Error  one outside 0..1
Vector3d mean_of(const MaterialTexture& texture, bool is_colour, LoadedTextures& loaded,
                 std::set<std::string>& files) {
  if (texture.file.empty()) {
    return Vector3d::Ones();
  }
  const Image<float> picture = read_picture_of(texture, is_colour);
  require_albedos(picture, texture);
  if (files.insert(texture.file).second) {
    ++loaded.n_pictures;
    if (texture.bytes == nullptr) {
      loaded.files.push_back(texture.file);
    }
  }
  Vector3d sum = Vector3d::Zero();
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        sum[c] += picture(y, x, picture.channels() == 3 ? c : 0);
      }
    }
  }
  return sum / (static_cast<double>(picture.width()) * picture.height());
}

/// What is a texture in glTF and one number here.
void settle(Material& material, LoadedTextures& loaded, std::set<std::string>& files) {
  const std::shared_ptr<const MetallicRoughness> averaged = std::move(material.averaged);
  material.averaged = nullptr;
  material.emits =
      material.emits.cwiseProduct(mean_of(averaged->emission_texture, true, loaded, files));
  if (material.bsdf == BsdfKind::dielectric) {
    return;
  }
  MetallicRoughness settled = *averaged;
  const Vector3d mean = mean_of(averaged->roughness_texture, false, loaded, files);
  settled.roughness *= mean.y();
  settled.metallic *= mean.z();
  set_metallic_roughness(material, settled);
  if (material.bsdf == BsdfKind::conductor && !settled.base_texture.file.empty()) {
    settled.base =
        settled.base.cwiseProduct(mean_of(settled.base_texture, true, loaded, files));
    set_metallic_roughness(material, settled);
  }
}

}  // namespace

std::shared_ptr<const Texture> make_texture(Image<float> picture,
                                            const MaterialTexture& named) {
  require_albedos(picture, named);
  for (float& value : picture.pixels()) {
    value = std::clamp(value, 0.0F, 1.0F);
  }
  return std::make_shared<const Texture>(std::move(picture));
}

LoadedTextures load_textures(Scene& scene, std::uint64_t memory_bytes) {
  LoadedTextures loaded;
  std::map<std::string, std::shared_ptr<const Texture>> pictures;
  std::set<std::string> files;
  for (Material& material : scene.materials) {
    if (material.averaged != nullptr) {
      settle(material, loaded, files);
    }
    MaterialTexture& texture = material.kd_texture;
    if (texture.file.empty()) {
      continue;
    }
    std::shared_ptr<const Texture>& picture = pictures[texture.file];
    if (picture == nullptr) {
      Image<float> texels = read_picture_of(texture);
      loaded.bytes += texels.pixels().size_bytes();
      if (loaded.bytes > memory_bytes) {
        throw Error(
            fmt::format("the textures up to {} need {} MB, --memory allows {}", texture.file,
                        loaded.bytes / 1'000'000, memory_bytes / 1'000'000),
            texture.where, "make them smaller, or give more --memory", ExitCode::usage);
      }
      if (files.insert(texture.file).second) {
        ++loaded.n_pictures;
        if (texture.bytes == nullptr) {
          loaded.files.push_back(texture.file);
        }
      }
      picture = make_texture(std::move(texels), texture);
    }
    texture.picture = picture;
  }
  return loaded;
}

}  // namespace haarlight::render
