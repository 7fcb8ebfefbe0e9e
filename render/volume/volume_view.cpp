// SPDX-License-Identifier: Apache-2.0
#include "render/volume/volume_view.h"

#include <algorithm>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/film/film.h"
#include "render/volume/bent_face.h"
#include "render/volume/segment.h"

namespace haarlight::render {

using Eigen::Array2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kBoxRounding = 1e-3;  // pixels
/// Smaller coordinates, in the camera's frame, count as 0 (SeenPoint).
constexpr double kSmallest = 1e-60;

double without_dust(double x) { return std::abs(x) < kSmallest ? 0.0 : x; }

}  // namespace

PixelRange pixels_within(double low, double high, int first, int end) {
  const auto bounded = [&](double pixel) {
    return static_cast<int>(
        std::clamp(pixel, static_cast<double>(first), static_cast<double>(end)));
  };
  return {.first = bounded(std::ceil(low)), .end = bounded(std::floor(high) + 1.0)};
}

VolumeView::VolumeView(const VolumeScene& the_scene, FaceForm form)
    : VolumeView(the_scene, std::make_shared<const CellFaces>(connect_cells(
                                the_scene.mesh, the_scene.mesh_file.string(), form))) {}

VolumeView::VolumeView(const VolumeScene& the_scene,
                       std::shared_ptr<const CellFaces> the_connected)
    : scene(the_scene),
      connected(std::move(the_connected)),
      mesh(*connected),
      projection(scene.optics.pixel_mm > 0.0 ? Projection::parallel : Projection::perspective),
      near(scene.optics.near_mm) {
  if (scene.optics.far_mm > 0.0) {
    far = scene.optics.far_mm;
  }
  find_points();
  require_depths();
  sort_boundary();
}

Vector2d VolumeView::ray(int x, int y) const {
  const CameraModel& camera = scene.camera;
  const Vector2d off_axis(x + 0.5 - camera.cx, y + 0.5 - camera.cy);
  return projection == Projection::parallel
             ? Vector2d(scene.optics.pixel_mm * off_axis)
             : Vector2d(off_axis.x() / camera.fx, off_axis.y() / camera.fy);
}

void VolumeView::find_points() {
  const Eigen::Isometry3d cam_from_world = scene.camera.world_from_cam.inverse();
  const std::size_t n = scene.mesh.points.size();
  points.resize(n);
  const auto value_of = [](const ScalarField& field, std::size_t i) {
    return field.is_per_cell || field.values.empty() ? 0.0 : field.values[i];
  };
  constexpr std::size_t kGrain = 4096;
  parallel_for(n, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Vector3d seen = cam_from_world * scene.mesh.points[i];
      points[i] = {.seen = {.x = without_dust(seen.x()),
                            .y = without_dust(seen.y()),
                            .z = without_dust(seen.z())},
                   .density = value_of(scene.density_field, i),
                   .colour = value_of(scene.colour_field, i),
                   .contour = value_of(scene.contour_field, i)};
    }
  });
  for (const FieldPoint& point : points) {
    size = std::max(
        {size, std::abs(point.seen.x), std::abs(point.seen.y), std::abs(point.seen.z)});
  }
}

double VolumeView::longest() const {
  const Vector2d first = ray(0, 0).cwiseAbs();
  const Vector2d last = ray(scene.camera.width, scene.camera.height).cwiseAbs();
  return 2.0 * size * stretch(first.cwiseMax(last));
}

/// Segments take optical depths up to a limit.
void VolumeView::require_depths() const {
  const double largest = std::ranges::max(scene.density.values());
  if (!(largest * longest() <= kLargestDepth)) {
    throw Error(
        fmt::format("an extinction of {:g} over {:g} mm is an optical depth beyond {:g}",
                    largest, longest(), kLargestDepth),
        scene.mesh_file.string(), "give [density] a smaller scale");
  }
}

VolumeView::SeenBox VolumeView::box_of(std::span<const std::uint32_t> nodes) const {
  constexpr std::size_t kMostNodes = 8;  // the corners of a cell
  std::array<SeenPoint, kMostNodes> seen;
  HAARLIGHT_EXPECTS(nodes.size() <= kMostNodes, "the corners of a cell or face");
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    seen.at(i) = points[nodes[i]].seen;
  }
  return box_about(std::span(seen).first(nodes.size()));
}

VolumeView::SeenBox VolumeView::box_of(const BoundaryFace& face) const {
  if (mesh.faces.empty() || !mesh.faces[face.number].is_bent()) {
    return box_of(face.nodes);
  }
  const SeenBezier bezier =
      bezier_of(*this, nodes_of_bent(scene.mesh, face.cell, mesh.faces[face.number]));
  return box_about(bezier.all());
}

VolumeView::SeenBox VolumeView::box_about(std::span<const SeenPoint> all) const {
  const Vector2d first = ray(0, 0);
  const Vector2d pixel = ray(1, 1) - first;
  SeenBox box{.low = Array2d::Constant(std::numeric_limits<double>::infinity()),
              .high = Array2d::Constant(-std::numeric_limits<double>::infinity())};
  std::size_t n_in_front = 0;
  std::size_t n_behind = 0;
  for (const SeenPoint& seen : all) {
    const double w = projection == Projection::perspective ? seen.z : 1.0;
    n_in_front += w > 0.0 ? 1 : 0;
    n_behind += w < 0.0 ? 1 : 0;
    const Array2d at((seen.x / w - first.x()) / pixel.x(),
                     (seen.y / w - first.y()) / pixel.y());
    box.low = box.low.min(at);
    box.high = box.high.max(at);
  }
  if (n_in_front != all.size() && n_behind != all.size()) {
    // The eye's plane passes through them: they may be seen anywhere.
    box.low.setConstant(-std::numeric_limits<double>::infinity());
    box.high.setConstant(std::numeric_limits<double>::infinity());
  }
  box.low -= kBoxRounding;
  box.high += kBoxRounding;
  return box;
}

/// Each face into the tiles that its box meets.
void VolumeView::sort_boundary() {
  const CameraModel& camera = scene.camera;
  tiles_across = (camera.width + Film::kTile - 1) / Film::kTile;
  const int tiles_down = (camera.height + Film::kTile - 1) / Film::kTile;
  faces_of_tiles.resize(static_cast<std::size_t>(tiles_across) *
                        static_cast<std::size_t>(tiles_down));
  for (std::size_t i = 0; i < mesh.boundary.size(); ++i) {
    const SeenBox box = box_of(mesh.boundary[i]);
    const PixelRange across = pixels_within(box.low.x(), box.high.x(), 0, camera.width);
    const PixelRange down = pixels_within(box.low.y(), box.high.y(), 0, camera.height);
    for (int y = down.first / Film::kTile; y * Film::kTile < down.end; ++y) {
      for (int x = across.first / Film::kTile; x * Film::kTile < across.end; ++x) {
        faces_of_tiles[static_cast<std::size_t>(y) * static_cast<std::size_t>(tiles_across) +
                       static_cast<std::size_t>(x)]
            .push_back(static_cast<std::uint32_t>(i));
      }
    }
  }
}

}  // namespace haarlight::render
