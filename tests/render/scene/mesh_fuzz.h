// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene_io.h"

/// @file
/// What the fuzz targets of the mesh readers share.

namespace haarlight::test {

/// Any bytes either read as a sound scene or are refused with Error.
template <class Parse>
void read_or_refuse(const Parse& parse, const std::uint8_t* data, std::size_t size) {
  set_log_level(LogLevel::off);
  try {
    const render::Scene scene =
        parse(std::string_view(reinterpret_cast<const char*>(data), size));
    for (const render::Mesh& mesh : scene.meshes) {
      for (const Eigen::Vector3i& t : mesh.triangles) {
        if (t.minCoeff() < 0 || t.maxCoeff() >= static_cast<int>(mesh.vertices.size())) {
          std::abort();
        }
      }
      for (const Eigen::Vector3d& v : mesh.vertices) {
        if (!v.allFinite()) {
          std::abort();
        }
      }
      if (!mesh.normals.empty() && mesh.normals.size() != mesh.vertices.size()) {
        std::abort();
      }
      if (!mesh.uvs.empty() && mesh.uvs.size() != mesh.vertices.size()) {
        std::abort();
      }
      for (const Eigen::Vector2d& uv : mesh.uvs) {
        if (!(uv.cwiseAbs().maxCoeff() <= render::kMaxUv)) {
          std::abort();
        }
      }
      if (mesh.material < 0 || mesh.material >= static_cast<int>(scene.materials.size())) {
        std::abort();
      }
    }
  } catch (const Error&) {  // NOLINT(bugprone-empty-catch): the only way out for bad bytes
  }
}

}  // namespace haarlight::test
