// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "render/volume/cell_faces.h"
#include "render/volume/side_of_ray.h"
#include "render/volume/volume_scene.h"

/// @file
/// A mesh as a camera sees it.

namespace haarlight::render {

/// Whole pixels first <= i < end.
struct PixelRange {
  int first = 0;
  int end = 0;
};
/// Those of a range whose centres are within [low, high], in pixels whose centres are whole numbers.
[[nodiscard]] PixelRange pixels_within(double low, double high, int first, int end);

/// A point of the mesh: where it is seen, and its fields.
struct FieldPoint {
  SeenPoint seen;
  double density = 0.0;
  double colour = 0.0;
  double contour = 0.0;
};

struct VolumeView {
  const VolumeScene& scene;  ///< outlives it
  std::shared_ptr<const CellFaces> connected;
  const CellFaces& mesh;  ///< of `connected`
  Projection projection;
  std::vector<FieldPoint> points;
  double size = 0.0;  ///< largest coordinate
  double near = 0.0;  ///< along the camera's axis
  double far = std::numeric_limits<double>::infinity();
  int tiles_across = 0;
  /// Of each tile of the film the faces that may be seen in it, numbers in mesh.boundary.
  std::vector<std::vector<std::uint32_t>> faces_of_tiles;

  /// @throws Error  as connect_cells(); optical depths beyond kLargestDepth
  VolumeView(const VolumeScene& scene, FaceForm form);
  /// @param connected  the scene's cells by connect_cells(): other views may share them
  /// @throws Error  optical depths beyond kLargestDepth
  VolumeView(const VolumeScene& scene, std::shared_ptr<const CellFaces> connected);

  /// (x, y) of side_of_ray.h, of a pixel's centre.
  [[nodiscard]] Eigen::Vector2d ray(int x, int y) const;
  /// From corner to corner, in units of ray().
  [[nodiscard]] double picture_size() const {
    return (ray(scene.camera.width, scene.camera.height) - ray(0, 0)).norm();
  }
  /// World length of a ray's piece over the difference of z.
  [[nodiscard]] double stretch(const Eigen::Vector2d& p) const {
    return projection == Projection::perspective ? std::sqrt(p.squaredNorm() + 1.0) : 1.0;
  }
  /// In the camera's frame.
  [[nodiscard]] Eigen::Vector3d point_at(const Eigen::Vector2d& p, double z) const {
    return projection == Projection::perspective ? Eigen::Vector3d(p.x() * z, p.y() * z, z)
                                                 : Eigen::Vector3d(p.x(), p.y(), z);
  }
  /// World length of a ray within the mesh, at most.
  [[nodiscard]] double longest() const;
  [[nodiscard]] std::string cell_name(std::uint32_t cell) const {
    return std::to_string(scene.mesh.number_in_file(cell));
  }

  /// On the picture, in pixels whose centres are whole numbers.
  struct SeenBox {
    Eigen::Array2d low;
    Eigen::Array2d high;
  };
  /// About points of the mesh and all between them, with room for rounding; unbounded where some are
  /// in front of the eye and some are not.
  [[nodiscard]] SeenBox box_of(std::span<const std::uint32_t> nodes) const;
  /// About a face of the boundary: a bent one is among its Bezier points.
  [[nodiscard]] SeenBox box_of(const BoundaryFace& face) const;

 private:
  [[nodiscard]] SeenBox box_about(std::span<const SeenPoint> seen) const;
  void find_points();
  void sort_boundary();
  void require_depths() const;
};

}  // namespace haarlight::render
