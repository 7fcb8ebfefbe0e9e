// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/hull_cache.h"

#include <array>
#include <bit>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "haarlight/core/files.h"
#include "haarlight/render/light/rig_lights.h"
#include "haarlight/render/mesh/mesh_writer.h"
#include "relight/hull/hull_surface.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::json;

constexpr int kVoxelsPerByte = 4;

Json numbers(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

std::string packed(const std::vector<relight::VoxelState>& states) {
  std::string bytes((states.size() + kVoxelsPerByte - 1) / kVoxelsPerByte, '\0');
  for (std::size_t i = 0; i < states.size(); ++i) {
    const auto bits = static_cast<unsigned>(states[i]) << (2 * (i % kVoxelsPerByte));
    char& byte = bytes[i / kVoxelsPerByte];
    byte = static_cast<char>(static_cast<unsigned char>(byte) | bits);
  }
  return bytes;
}

template <class T, std::size_t N>
void append(std::string& bytes, const std::vector<std::array<T, N>>& rows) {
  static_assert(std::endian::native == std::endian::little);
  bytes.append(reinterpret_cast<const char*>(rows.data()), rows.size() * sizeof(rows[0]));
}

std::string surface_bytes(const render::SurfaceMesh& mesh) {
  std::string bytes;
  append(bytes, mesh.vertices);
  append(bytes, mesh.normals);
  append(bytes, mesh.triangles);
  append(bytes, mesh.colours);
  return bytes;
}

Json grid_json(const relight::VoxelGrid& grid) {
  return {{"size", {grid.nx, grid.ny, grid.nz}},
          {"voxel_mm", grid.voxel_mm},
          {"low_mm", numbers(grid.low)},
          {"origin", numbers(grid.origin)},
          {"axes", {numbers(grid.axes[0]), numbers(grid.axes[1]), numbers(grid.axes[2])}}};
}

/// The camera without its distortion, which the page does not draw.
Json camera_json(const CameraModel& camera) {
  Json rows = Json::array();
  for (int row = 0; row < 3; ++row) {
    const auto values = camera.world_from_cam.matrix().row(row);
    rows.push_back({values(0), values(1), values(2), values(3)});
  }
  return {{"size", {camera.width, camera.height}},
          {"focal", {camera.fx, camera.fy}},
          {"centre", {camera.cx, camera.cy}},
          {"world_from_cam", rows}};
}

Json lights_json(const Rig& rig) {
  Json lights = Json::array();
  for (const render::SquareLight& light : render::rig_lights(rig)) {
    lights.push_back({{"centre", numbers(light.centre)},
                      {"u", numbers(light.u)},
                      {"v", numbers(light.v)},
                      {"emits", numbers(light.emits)},
                      {"size", {light.width_mm, light.height_mm}},
                      {"radiance", light.radiance},
                      {"lobe_mu", light.lobe_mu}});
  }
  return lights;
}

}  // namespace

HullForPage hull_for_page(const relight::CapturedHull& found, const Rig& rig,
                          const relight::PlaneFrame& frame,
                          const std::vector<std::string>& options) {
  const relight::VoxelGrid& grid = found.hull.grid;
  const relight::HullSummary& counts = found.source.hull;
  const render::SurfaceMesh mesh = relight::hull_surface(found.hull);
  HullForPage page;
  page.voxels = packed(found.hull.states);
  page.surface = surface_bytes(mesh);
  Json json = {
      {"state", "ready"},
      {"grid", grid_json(grid)},
      {"plane",
       {{"centre",
         numbers(grid.origin + frame.x0_mm * frame.u + frame.y0_mm * frame.v +
                 0.5 * frame.texel_mm * (frame.width * frame.u - frame.height * frame.v))},
        {"width_mm", frame.width * frame.texel_mm},
        {"height_mm", frame.height * frame.texel_mm}}},
      {"camera", camera_json(rig.cameras[0].model)},
      {"lights", lights_json(rig)},
      {"surface", {{"vertices", mesh.vertices.size()}, {"triangles", mesh.triangles.size()}}},
      {"counts",
       {{"matter", counts.n_matter},
        {"assumed_full", counts.n_assumed_full},
        {"assumed_empty", counts.n_assumed_empty}}},
      {"low_mm", counts.low_mm},
      {"high_mm", counts.high_mm},
      {"touches_border", counts.touches_border},
      {"leaves_camera", counts.leaves_camera},
      {"file", found.source.file},
      {"options", options}};
  page.hash = content_hash(json.dump() + page.voxels + page.surface);
  json["hash"] = page.hash;
  page.description = json.dump();
  return page;
}

HullCache::HullCache(HullRequest request) : request_(std::move(request)) {
  try {
    const relight::ShadowCaptures captures(request_.captured, request_.settings.memory_bytes);
    relight::require_lights(captures.frame(), render::rig_lights(captures.rig()));
  } catch (const Error& error) {
    now_.state = State::refused;
    now_.problem = error;
  }
}

HullCache::~HullCache() = default;

void HullCache::begin() {
  const std::lock_guard lock(mutex_);
  if (now_.state == State::waiting) {
    now_.state = State::carving;
    worker_ = std::jthread([this] { run(); });
  }
}

HullCache::Look HullCache::look() const {
  const std::lock_guard lock(mutex_);
  return now_;
}

void HullCache::run() {
  Look found;
  try {
    const relight::ShadowCaptures captures(request_.captured, request_.settings.memory_bytes);
    relight::PipelineNotes notes(request_.settings.tell);
    const relight::CapturedHull hull =
        relight::captured_hull(request_.captured, request_.voxel_mm, request_.settings, notes);
    relight::require_object(hull.hull, request_.captured.basis);
    found.state = State::ready;
    found.hull = std::make_shared<const HullForPage>(
        hull_for_page(hull, captures.rig(), captures.frame(), request_.options));
  } catch (const Error& error) {
    found.state = State::refused;
    found.problem = error;
  } catch (const std::exception& error) {
    found.state = State::refused;
    found.problem = Error(error.what(), request_.captured.basis,
                          "haarlight hull says more of the same capture", ExitCode::internal);
  }
  const std::lock_guard lock(mutex_);
  now_ = std::move(found);
}

}  // namespace haarlight::apps
