// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_splat.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "render/volume/segment.h"

namespace haarlight::render {

using Eigen::Array2d;
using Eigen::Array3d;
using Eigen::Vector3d;

namespace {

/// Cells that cover fewer pixels' centres are splats.
constexpr int kFewest = 2;
constexpr double kKernel = 3.0;  ///< pixels

double cross(const Array2d& a, const Array2d& b) { return a.x() * b.y() - a.y() * b.x(); }

bool is_within(const Array2d& p, const std::array<Array2d, 3>& triangle) {
  const double a = cross(triangle[1] - triangle[0], p - triangle[0]);
  const double b = cross(triangle[2] - triangle[1], p - triangle[1]);
  const double c = cross(triangle[0] - triangle[2], p - triangle[2]);
  return (a >= 0.0 && b >= 0.0 && c >= 0.0) || (a <= 0.0 && b <= 0.0 && c <= 0.0);
}

/// Corners on the picture, in pixels whose centres are whole numbers.
class SeenCell {
 public:
  SeenCell(const VolumeView& view, std::uint32_t cell)
      : faces_(std::span(view.mesh.faces)
                   .subspan(view.mesh.begins[cell],
                            view.mesh.begins[cell + 1] - view.mesh.begins[cell])) {
    const CellMesh& mesh = view.scene.mesh;
    const auto nodes = mesh.nodes_of(cell).first(shape_of(mesh.types[cell]).n_corners);
    for (const std::uint32_t node : nodes) {
      const Vector3d at(view.points[node].seen.x, view.points[node].seen.y,
                        view.points[node].seen.z);
      camera_ += at / static_cast<double>(nodes.size());
      near_ = std::min(near_, at.z());
      far_ = std::max(far_, at.z());
      corners_.push_back(pixel_of(view, at));
    }
    for (const Array2d& corner : corners_) {
      low_ = low_.min(corner);
      high_ = high_.max(corner);
    }
  }

  static Array2d pixel_of(const VolumeView& view, const Vector3d& at) {
    const double w = view.projection == Projection::perspective ? at.z() : 1.0;
    const Array2d first = view.ray(0, 0).array();
    const Array2d pixel = view.ray(1, 1).array() - first;
    return (Array2d(at.x(), at.y()) / w - first) / pixel;
  }

  [[nodiscard]] bool is_between(double near, double far) const {
    return near_ > near && far_ < far;
  }
  [[nodiscard]] const Vector3d& centre() const { return camera_; }
  /// No larger than what it would be spread over.
  [[nodiscard]] bool is_small() const { return (high_ - low_ <= kKernel).all(); }

  /// Pixels' centres that it covers, no more than `enough`.
  [[nodiscard]] int n_covered(int enough) const {
    int n = 0;
    const Array2d first = low_.ceil();
    const Array2d last = high_.floor();
    for (double y = first.y(); y <= last.y() && n < enough; y += 1.0) {
      for (double x = first.x(); x <= last.x() && n < enough; x += 1.0) {
        n += covers({x, y}) ? 1 : 0;
      }
    }
    return n;
  }

 private:
  [[nodiscard]] bool covers(const Array2d& p) const {
    return std::ranges::any_of(faces_, [&](const CellFace& face) {
      return is_within(
          p, {corners_[face.corners[0]], corners_[face.corners[1]], corners_[face.corners[2]]});
    });
  }

  std::span<const CellFace> faces_;
  std::vector<Array2d> corners_;
  Vector3d camera_ = Vector3d::Zero();
  double near_ = std::numeric_limits<double>::infinity();
  double far_ = -std::numeric_limits<double>::infinity();
  Array2d low_ = Array2d::Constant(std::numeric_limits<double>::infinity());
  Array2d high_ = Array2d::Constant(-std::numeric_limits<double>::infinity());
};

bool has_contour(const VolumeScene& scene, std::span<const std::uint32_t> nodes) {
  if (scene.contours.empty()) {
    return false;
  }
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const std::uint32_t node : nodes) {
    low = std::min(low, scene.contour_field.values[node]);
    high = std::max(high, scene.contour_field.values[node]);
  }
  return std::ranges::any_of(scene.contours, [&](const Contour& contour) {
    return contour.value >= low && contour.value <= high;
  });
}

double at_centre(const ScalarField& field, std::uint32_t cell,
                 std::span<const std::uint32_t> corners) {
  if (field.is_per_cell) {
    return field.values[cell];
  }
  double sum = 0.0;
  for (const std::uint32_t node : corners) {
    sum += field.values[node] / static_cast<double>(corners.size());
  }
  return sum;
}

}  // namespace

double quadratic_spline(double t) {
  const double away = std::abs(t);
  if (away <= 0.5) {
    return 0.75 - away * away;
  }
  return away < 1.5 ? 0.5 * (1.5 - away) * (1.5 - away) : 0.0;
}

std::array<int, 2> CellSplat::first_pixel() const {
  return {static_cast<int>(std::lround(centre.x())) - 1,
          static_cast<int>(std::lround(centre.y())) - 1};
}

PixelLight CellSplat::at(int x, int y, Glow glow) const {
  const double part = quadratic_spline(x - centre.x()) * quadratic_spline(y - centre.y());
  const double of_ray = part * length;
  const double of_part = of_ray * extinction;
  const SegmentWeights weights = weights_of_depths(of_part, of_part);
  const EndWeights& of = glow == Glow::own ? weights.of_glow : weights.of_chromaticity;
  return {.light = (glow == Glow::own ? of_ray : 1.0) * (of.near + of.far) * colour,
          .opacity = weights.opacity,
          .transparency = weights.transparency};
}

std::optional<CellSplat> splat_of(const VolumeView& view, std::uint32_t cell) {
  const VolumeScene& scene = view.scene;
  const std::span<const std::uint32_t> nodes = scene.mesh.nodes_of(cell);
  const SeenCell seen(view, cell);
  if (!seen.is_between(view.near, view.far) || !seen.is_small() || has_contour(scene, nodes) ||
      seen.n_covered(kFewest) >= kFewest) {
    return std::nullopt;
  }
  const std::span<const std::uint32_t> corners =
      nodes.first(shape_of(scene.mesh.types[cell]).n_corners);
  const Vector3d& centre = seen.centre();
  CellSplat splat{.centre = SeenCell::pixel_of(view, centre)};
  double across_ray = 0.0;  // of a pixel, mm^2
  if (view.projection == Projection::parallel) {
    across_ray = scene.optics.pixel_mm * scene.optics.pixel_mm;
  } else {
    // Of a plane across the axis, times the cosine of the ray's angle to it.
    const double stretch = centre.norm() / centre.z();
    across_ray = centre.z() * centre.z() / (scene.camera.fx * scene.camera.fy * stretch);
  }
  splat.length = std::abs(cell_volume(scene.mesh, cell)) / across_ray;
  splat.extinction = scene.density.at(at_centre(scene.density_field, cell, corners));
  splat.colour = scene.colour.at(at_centre(scene.colour_field, cell, corners));
  splat.depth = centre.z();
  return splat;
}

}  // namespace haarlight::render
