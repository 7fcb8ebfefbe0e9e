/// @file
/// Fuzz target: an OBJ file either reads as a sound scene or throws Error.

#include <cstdint>
#include <cstdlib>

#include "core/error.h"
#include "core/log.h"
#include "render/scene_io.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::set_log_level(haarlight::LogLevel::off);
  try {
    const haarlight::Scene scene =
        haarlight::parse_obj({reinterpret_cast<const char*>(data), size}, "fuzz.obj");
    for (const haarlight::Mesh& mesh : scene.meshes) {
      for (const Eigen::Vector3i& t : mesh.triangles) {
        if (t.minCoeff() < 0 || t.maxCoeff() >= static_cast<int>(mesh.vertices.size())) {
          std::abort();
        }
      }
      if (mesh.material < 0 || mesh.material >= static_cast<int>(scene.materials.size())) {
        std::abort();
      }
    }
  } catch (const haarlight::Error&) {
  }
  return 0;
}
