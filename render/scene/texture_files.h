// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Reads the pictures of a scene's textures. Apart from haarlight::scene, which links no picture
/// format.

namespace haarlight::render {

struct LoadedTextures {
  std::vector<std::string> files;  ///< each once; not those inside another file
  std::size_t n_pictures = 0;      ///< with those
  std::uint64_t bytes = 0;         ///< that their texels take
};

/// Also settles Material::averaged. Reads every picture that the scene's materials name, each file once, as linear light
/// (haarlight/core/picture/image_io.h), and sets MaterialTexture::picture.
/// @param memory_bytes  for all texels together; one picture alone is held to
///                      limit_picture_memory() before it is decoded
/// @throws Error  at MaterialTexture::where: a file that is not there or is no picture, a texel
///                outside 0..1 with its column and row, more texels than fit
LoadedTextures load_textures(Scene& scene, std::uint64_t memory_bytes);

/// One of them, once read. What a conversion between colour spaces leaves outside 0..1, 1e-4, is
/// clipped.
/// @param picture  (h, w, 1 or 3) @param named  its file and where that is named, for errors
/// @throws Error  a texel outside 0..1
[[nodiscard]] std::shared_ptr<const Texture> make_texture(Image<float> picture,
                                                          const MaterialTexture& named);

}  // namespace haarlight::render
