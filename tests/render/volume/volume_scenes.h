// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "render/film/no_depth.h"
#include "render/volume/cell_projection.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/side_of_ray.h"
#include "render/volume/visibility_order.h"
#include "render/volume/volume_ray_caster.h"
#include "render/volume/volume_scene.h"

/// @file
/// Volumes whose pictures are known: the unit cube with the field (x + 2 y + 3 z)/6.

namespace haarlight::render::test {

inline constexpr auto kAllTypes = std::to_array<CellType>(
    {CellType::tetrahedron, CellType::hexahedron, CellType::wedge, CellType::pyramid,
     CellType::quadratic_tetrahedron, CellType::quadratic_hexahedron,
     CellType::triquadratic_hexahedron, CellType::quadratic_wedge, CellType::quadratic_pyramid,
     CellType::cubic_tetrahedron});
/// Those with nodes beside their corners.
inline constexpr auto kBentTypes =
    std::to_array<CellType>({CellType::quadratic_tetrahedron, CellType::quadratic_hexahedron,
                             CellType::triquadratic_hexahedron, CellType::quadratic_wedge,
                             CellType::quadratic_pyramid, CellType::cubic_tetrahedron});

/// n^3 cubes of side 1/n, of six tetrahedra about a diagonal each, or of five, which alternate.
enum class Split { six, five };
[[nodiscard]] CellMesh cube_of_tetrahedra(std::size_t n, Split split = Split::six);

/// n^3 cubes, each one hexahedron, two wedges, six pyramids about its middle, or six tetrahedra; those with
/// more nodes straight, with nodes in common.
[[nodiscard]] CellMesh cube_of(CellType type, std::size_t n);

/// The field (x + 2 y + 3 z)/6 at the mesh's points.
[[nodiscard]] ScalarField linear_field(const CellMesh& mesh);

/// Five breakpoints with as many colours; or two spikes of extinction; or one that hardly changes.
enum class Transfer { hills, spikes, nearly_constant };
void set_transfer(Transfer transfer, VolumeScene& scene);

/// A ray through the cube from tests/golden/volume_segments.json, and its truth.
struct GoldenRay {
  Eigen::Vector3d origin;
  Eigen::Vector3d direction;
  Projection projection = Projection::parallel;
  PiecewiseLinear<double> density;
  PiecewiseLinear<Eigen::Array3d> colour;
  Eigen::Array3d of_chromaticity;
  Eigen::Array3d of_glow;
  double opacity = 0.0;
};
/// @param field  "linear" or "quadratic"
[[nodiscard]] std::vector<GoldenRay> golden_rays(const std::string& field);
/// The largest relative error of light and opacity, with both kinds of glow.
[[nodiscard]] double relative_error(const GoldenRay& ray, VolumeScene& scene);

/// Of the mesh with its linear field, hills, and a camera of one pixel.
[[nodiscard]] VolumeScene scene_of(CellMesh mesh);

/// One pixel, whose centre looks from `origin` along `direction` (of any length).
void look_along(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                Projection projection, VolumeScene& scene);

/// Light, opacity, and where half is hidden.
struct VolumeLight {
  Eigen::Array3d light = Eigen::Array3d::Zero();
  double opacity = 0.0;
  double depth = kNoDepth;
};

/// Of every pixel, row by row. @throws Error  as the ray caster and its check for overlaps
[[nodiscard]] std::vector<VolumeLight> render(const VolumeScene& scene,
                                              const VolumeOptions& options = {});
/// The same by a renderer of that scene; overlaps are not checked.
[[nodiscard]] std::vector<VolumeLight> picture_by(const TileRenderer& renderer,
                                                  const VolumeScene& scene);

/// The same by projecting cells.
struct ProjectedPicture {
  std::vector<VolumeLight> pixels;
  ProjectionCounts counts;
};
[[nodiscard]] ProjectedPicture project(const VolumeScene& scene,
                                       SmallCells small_cells = SmallCells::sampled);
[[nodiscard]] ProjectedPicture project(const VolumeScene& scene, const VisibilityOrder& order);

/// A preview of it.
[[nodiscard]] std::vector<VolumeLight> preview(const VolumeScene& scene,
                                               const PreviewOptions& options = {});

/// Every cell with points of its own.
[[nodiscard]] CellMesh torn(const CellMesh& mesh);
/// Some of its cells, in this order.
[[nodiscard]] CellMesh chosen(const CellMesh& mesh, const std::vector<std::size_t>& cells);

/// Of a picture's pixel.
[[nodiscard]] inline const VolumeLight& pixel_of(const std::vector<VolumeLight>& picture,
                                                 const VolumeScene& scene, int x, int y) {
  return picture[static_cast<std::size_t>(y) * static_cast<std::size_t>(scene.camera.width) +
                 static_cast<std::size_t>(x)];
}

/// The largest difference of two pictures.
[[nodiscard]] double difference(const std::vector<VolumeLight>& a,
                                const std::vector<VolumeLight>& b);

/// A picture of side x side pixels of the whole cube.
void look_at_cube(const Eigen::Vector3d& eye, int side, VolumeScene& scene);

/// Where a ray enters the unit cube and leaves it, in lengths of its direction; not before the eye.
[[nodiscard]] std::pair<double, double> within_cube(const Eigen::Vector3d& origin,
                                                    const Eigen::Vector3d& direction);

/// In closed form what a ray gathers that is within the unit cube from near to far (lengths of
/// `direction`), of the scene's transfer functions of the linear field.
[[nodiscard]] VolumeLight light_within_cube(const VolumeScene& scene,
                                            const Eigen::Vector3d& origin,
                                            const Eigen::Vector3d& direction, double near = 0.0,
                                            double far = 1e300);

/// The ray through a pixel's centre, of direction 1 along the camera's axis.
[[nodiscard]] std::pair<Eigen::Vector3d, Eigen::Vector3d> pixel_ray(const VolumeScene& scene,
                                                                    int x, int y);

/// The largest difference of a picture to the closed form of the cube.
[[nodiscard]] double error_of_cube(const VolumeScene& scene,
                                   const std::vector<VolumeLight>& picture);

}  // namespace haarlight::render::test
