// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/scene/scene.h"
#include "render/cell_mesh/cell_mesh.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/volume/backdrop.h"
#include "render/volume/contours.h"
#include "render/volume/transfer_function.h"

/// @file
/// Input of the volume renderer: a mesh of cells, what its fields look like, a camera. Lengths in mm;
/// the mesh's numbers count as mm.

namespace haarlight::render {

/// What a point of the medium emits towards the eye, per unit length.
enum class Glow : std::uint8_t {
  chromaticity,  ///< its colour times the extinction: what absorbs, glows [Williams92]
  own,           ///< its colour, whatever the extinction [Wilhelms91]
};
inline constexpr auto kGlowWords = std::to_array<std::string_view>({"chromaticity", "own"});
constexpr std::span<const std::string_view> words_of(Glow) { return kGlowWords; }

/// One number for each point, linear within the cells, or for each cell.
struct ScalarField {
  std::string name;  ///< also its component: "velocity[2]"
  bool is_per_cell = false;
  std::vector<double> values;  ///< finite
};

struct VolumeScene {
  std::filesystem::path mesh_file;
  std::filesystem::path solution_file;  ///< with the fields of a PLOT3D grid; empty: none
  CellMesh mesh;                        ///< sound; its own fields have been taken out of it
  MeshCheck check;                      ///< of it
  ScalarField density_field;            ///< what the extinction is a function of
  ScalarField colour_field;             ///< may be the same
  PiecewiseLinear<double> density{{0.0}, {0.0}};  ///< extinction, 1/mm, >= 0
  PiecewiseLinear<Eigen::Array3d> colour{{0.0}, {Eigen::Array3d::Ones()}};  ///< RGB, >= 0
  Glow glow = Glow::chromaticity;
  std::vector<Contour> contours;  ///< of the contour field
  ScalarField contour_field;      ///< one number for each point; empty without contours
  Background background;
  std::optional<SurfacesBehind> surfaces;  ///< then without a background
  CameraModel camera;                      ///< without distortion
  CameraOptics optics;                     ///< without a lens
};

/// What a pixel would show without the medium.
[[nodiscard]] Eigen::Array3d light_behind(const VolumeScene& scene, int x, int y);

/// Of the surface behind the medium, or within it, in mm along the camera's axis; kNoDepth: none.
[[nodiscard]] double depth_behind(const VolumeScene& scene, int x, int y);

/// Holds the pictures that a scene names to its camera's size: before it is rendered.
/// @throws Error  naming the picture, both sizes and what to do
void require_sizes(const VolumeScene& scene);

/// A scene file (TOML: [mesh], [density], [colour], [[contour]], [background], [behind], [camera]), its
/// mesh, and the pictures that it names, of any size.
/// @throws Error  with file:line what is wrong in it, or in the mesh; a field that the mesh does not
///                have, with those that it has
[[nodiscard]] VolumeScene read_volume_scene(const std::filesystem::path& path);

}  // namespace haarlight::render
