// SPDX-License-Identifier: Apache-2.0
#include "render/volume/volume_ray_caster.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/volume/segment.h"
#include "render/volume/side_of_ray.h"
#include "render/volume/tetrahedra.h"

namespace haarlight::render {

using Eigen::Array2d;
using Eigen::Array3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kRounding = std::numeric_limits<double>::epsilon() / 2.0;
/// Of a mesh's size: by how much two cells may be in one place without overlapping.
constexpr double kOverlap = 1e-9;
constexpr double kNoDepth = 745.2;  // e^-x is 0 beyond
/// Smaller coordinates, in the camera's frame, count as 0 (SeenPoint).
constexpr double kSmallest = 1e-60;

double without_dust(double x) { return std::abs(x) < kSmallest ? 0.0 : x; }

constexpr double kBoxRounding = 1e-3;  // pixels

/// Whole pixels first <= i < end.
struct PixelRange {
  int first = 0;
  int end = 0;
};
/// Those of a range whose centres are within [low, high].
PixelRange pixels_within(double low, double high, int first, int end) {
  const auto bounded = [&](double pixel) {
    return static_cast<int>(
        std::clamp(pixel, static_cast<double>(first), static_cast<double>(end)));
  };
  return {.first = bounded(std::ceil(low)), .end = bounded(std::floor(high) + 1.0)};
}

/// A point of the mesh: where it is seen, and its fields.
struct FieldPoint {
  SeenPoint seen;
  double density = 0.0;
  double colour = 0.0;
};

/// The same as seen from one ray: (x, y) of det[p, a, b] = a.x b.y - a.y b.x, and by how much
/// these may be off.
struct Corner {
  std::uint32_t node = 0;
  const FieldPoint* point = nullptr;
  double x = 0.0;
  double y = 0.0;
  double error = 0.0;
  double size = 0.0;  ///< |x| + |y|
};

/// Where a ray passes a face.
struct Crossing {
  double z = 0.0;
  double density = 0.0;  ///< the field's value
  double colour = 0.0;
};

Crossing between(const Crossing& from, const Crossing& to, double s) {
  const double rest = 1.0 - s;
  return {.z = rest * from.z + s * to.z,
          .density = rest * from.density + s * to.density,
          .colour = rest * from.colour + s * to.colour};
}

/// A face that a ray passes into a cell: anticlockwise as the ray sees it, so that it has all edges
/// on its positive side.
struct PassedFace {
  std::array<Corner, 3> corners;
  /// det[p, corner i, corner i + 1], >= 0.
  std::array<double, 3> sides{};

  [[nodiscard]] Crossing crossing() const {
    const std::array<double, 3> weights = {sides[1], sides[2], sides[0]};
    const double sum = weights[0] + weights[1] + weights[2];
    Crossing at;
    for (std::size_t i = 0; i < 3; ++i) {
      const double weight = weights.at(i) / sum;
      at.z += weight * corners.at(i).point->seen.z;
      at.density += weight * corners.at(i).point->density;
      at.colour += weight * corners.at(i).point->colour;
    }
    return at;
  }
};

}  // namespace

/// The mesh as the camera sees it.
struct VolumeRayCaster::View {
  const VolumeScene& scene;
  Tetrahedra mesh;
  Projection projection;
  std::vector<FieldPoint> points;
  double size = 0.0;  ///< largest coordinate
  double near = 0.0;  ///< along the camera's axis
  double far = std::numeric_limits<double>::infinity();
  int tiles_across = 0;
  /// Of each tile of the film the faces that may be within it, numbers in mesh.boundary.
  std::vector<std::vector<std::uint32_t>> faces_of_tiles;

  explicit View(const VolumeScene& scene);

  [[nodiscard]] Vector2d ray(int x, int y) const;
  /// World length of a ray's piece over the difference of z.
  [[nodiscard]] double stretch(const Vector2d& p) const {
    return projection == Projection::perspective ? std::sqrt(p.squaredNorm() + 1.0) : 1.0;
  }
  /// On the picture, in pixels whose centres are whole numbers.
  struct SeenBox {
    Array2d low;
    Array2d high;
  };
  /// About a face, with room for rounding.
  [[nodiscard]] SeenBox box_of(const BoundaryFace& face) const;
  /// World length of a ray within the mesh, at most.
  [[nodiscard]] double longest() const;
  [[nodiscard]] std::string cell_name(std::uint32_t cell) const {
    return std::to_string(scene.mesh.number_in_file(cell));
  }

 private:
  void find_points();
  void sort_boundary();
  void require_depths() const;
};

VolumeRayCaster::View::View(const VolumeScene& the_scene)
    : scene(the_scene),
      mesh(connect_tetrahedra(scene.mesh, scene.mesh_file.string())),
      projection(scene.optics.pixel_mm > 0.0 ? Projection::parallel : Projection::perspective),
      near(scene.optics.near_mm) {
  if (scene.optics.far_mm > 0.0) {
    far = scene.optics.far_mm;
  }
  find_points();
  require_depths();
  sort_boundary();
}

Vector2d VolumeRayCaster::View::ray(int x, int y) const {
  const CameraModel& camera = scene.camera;
  const Vector2d off_axis(x + 0.5 - camera.cx, y + 0.5 - camera.cy);
  return projection == Projection::parallel
             ? Vector2d(scene.optics.pixel_mm * off_axis)
             : Vector2d(off_axis.x() / camera.fx, off_axis.y() / camera.fy);
}

void VolumeRayCaster::View::find_points() {
  const Eigen::Isometry3d cam_from_world = scene.camera.world_from_cam.inverse();
  const std::size_t n = scene.mesh.points.size();
  points.resize(n);
  const auto value_of = [](const ScalarField& field, std::size_t i) {
    return field.is_per_cell ? 0.0 : field.values[i];
  };
  constexpr std::size_t kGrain = 4096;
  parallel_for(n, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Vector3d seen = cam_from_world * scene.mesh.points[i];
      points[i] = {.seen = {.x = without_dust(seen.x()),
                            .y = without_dust(seen.y()),
                            .z = without_dust(seen.z())},
                   .density = value_of(scene.density_field, i),
                   .colour = value_of(scene.colour_field, i)};
    }
  });
  for (const FieldPoint& point : points) {
    size = std::max(
        {size, std::abs(point.seen.x), std::abs(point.seen.y), std::abs(point.seen.z)});
  }
}

double VolumeRayCaster::View::longest() const {
  const Vector2d first = ray(0, 0).cwiseAbs();
  const Vector2d last = ray(scene.camera.width, scene.camera.height).cwiseAbs();
  return 2.0 * size * stretch(first.cwiseMax(last));
}

/// Segments take optical depths up to a limit.
void VolumeRayCaster::View::require_depths() const {
  const double largest = std::ranges::max(scene.density.values());
  if (!(largest * longest() <= kLargestDepth)) {
    throw Error(
        fmt::format("an extinction of {:g} over {:g} mm is an optical depth beyond {:g}",
                    largest, longest(), kLargestDepth),
        scene.mesh_file.string(), "give [density] a smaller scale");
  }
}

VolumeRayCaster::View::SeenBox VolumeRayCaster::View::box_of(const BoundaryFace& face) const {
  const Vector2d first = ray(0, 0);
  const Vector2d pixel = ray(1, 1) - first;
  SeenBox box{.low = Array2d::Constant(std::numeric_limits<double>::infinity()),
              .high = Array2d::Constant(-std::numeric_limits<double>::infinity())};
  int n_in_front = 0;
  int n_behind = 0;
  const Tetrahedron& cell = mesh.cells[face.cell];
  for (const std::uint8_t number : kTetrahedronFaces.at(face.node)) {
    const SeenPoint& seen = points[cell.nodes.at(number)].seen;
    const double w = projection == Projection::perspective ? seen.z : 1.0;
    n_in_front += w > 0.0 ? 1 : 0;
    n_behind += w < 0.0 ? 1 : 0;
    const Array2d at((seen.x / w - first.x()) / pixel.x(),
                     (seen.y / w - first.y()) / pixel.y());
    box.low = box.low.min(at);
    box.high = box.high.max(at);
  }
  if (n_in_front != 3 && n_behind != 3) {
    // The eye's plane passes through it: it may be seen anywhere.
    box.low.setConstant(-std::numeric_limits<double>::infinity());
    box.high.setConstant(std::numeric_limits<double>::infinity());
  }
  box.low -= kBoxRounding;
  box.high += kBoxRounding;
  return box;
}

/// Each face into the tiles that its box meets.
void VolumeRayCaster::View::sort_boundary() {
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

/// One tile's rays, while a single thread works on them.
class VolumeRayCaster::TilePicture {
 public:
  TilePicture(const View& view, double least_transparency, const Tile& area)
      : view_(view),
        area_(area),
        most_depth_(least_transparency > 0.0 ? -std::log(least_transparency) : kNoDepth),
        light_(n_pixels()),
        is_glowing_(view.scene.glow == Glow::own) {
    for (std::vector<double>* column : {&depths_near_, &depths_far_}) {
      column->reserve(kBatch);
    }
    pieces_.reserve(kBatch);
  }

  void render() {
    find_entries();
    std::size_t i = 0;
    while (i < entries_.size()) {
      std::size_t end = i + 1;
      while (end < entries_.size() && entries_[end].pixel == entries_[i].pixel) {
        ++end;
      }
      follow(std::span(entries_).subspan(i, end - i));
      i = end;
    }
    composite();
  }

  void add_to(FilmTile& tile) const {
    std::size_t i = 0;
    for (int y = area_.y0; y < area_.y1; ++y) {
      for (int x = area_.x0; x < area_.x1; ++x, ++i) {
        const PixelLight& pixel = light_[i];
        const Array3d light = pixel.light + pixel.transparency * view_.scene.background;
        tile.add(x, y, kLight, Vector3d(light.matrix()));
        tile.add(x, y, kOpacity, pixel.opacity);
      }
    }
  }

  [[nodiscard]] const VolumeCounts& counts() const { return counts_; }
  [[nodiscard]] const std::optional<std::string>& overlap() const { return overlap_; }

 private:
  /// A ray of the tile meets the boundary from outside.
  struct Entry {
    std::uint32_t pixel = 0;  ///< of the tile, row by row
    std::uint32_t face = 0;   ///< of the boundary
    double z = 0.0;
  };
  struct PixelLight {
    Array3d light = Array3d::Zero();
    double opacity = 0.0;
    double transparency = 1.0;
  };
  /// A stretch between breakpoints; its depths are in columns of their own.
  struct Piece {
    Array3d near;
    Array3d far;
    double length = 0.0;
    std::uint32_t pixel = 0;
  };

  static constexpr std::size_t kBatch = 4096;

  [[nodiscard]] std::size_t n_pixels() const {
    return static_cast<std::size_t>(area_.width()) * static_cast<std::size_t>(area_.height());
  }

  void set_ray(int x, int y) {
    p_ = view_.ray(x, y);
    stretch_ = view_.stretch(p_);
  }

  [[nodiscard]] Corner corner_of(std::uint32_t node) const {
    const FieldPoint& point = view_.points[node];
    const double w = view_.projection == Projection::perspective ? point.seen.z : 1.0;
    Corner corner{.node = node, .point = &point};
    const double px = p_.x() * w;
    const double py = p_.y() * w;
    corner.x = point.seen.x - px;
    corner.y = point.seen.y - py;
    corner.size = std::abs(corner.x) + std::abs(corner.y);
    corner.error = 2.0 * kRounding * (corner.size + std::abs(px) + std::abs(py));
    return corner;
  }

  /// det[p, a, b], of the sign that exact arithmetic gives it; its size may be rounded to 0.
  /// @param is_left  whether it counts as positive
  [[nodiscard]] double side(const Corner& a, const Corner& b, bool& is_left) {
    const double det = a.x * b.y - a.y * b.x;
    const double error = a.error * b.size + b.error * a.size + a.error * b.error +
                         4.0 * kRounding * a.size * b.size;
    if (std::abs(det) > error) {
      is_left = det > 0.0;
      return det;
    }
    ++counts_.exact_sides;
    is_left = exact_side(view_.projection, p_, a.point->seen, b.point->seen) > 0;
    return is_left == (det > 0.0) ? det : 0.0;
  }

  /// The face as the ray passes into its cell.
  /// @return  whether it does
  [[nodiscard]] bool passes_into(const BoundaryFace& face, PassedFace& passed) {
    const Tetrahedron& cell = view_.mesh.cells[face.cell];
    const std::array<std::uint8_t, 3>& numbers = kTetrahedronFaces.at(face.node);
    for (std::size_t i = 0; i < 3; ++i) {  // from outside, seen along the ray: turned round
      passed.corners.at(i) = corner_of(cell.nodes.at(numbers.at(2 - i)));
    }
    for (std::size_t i = 0; i < 3; ++i) {
      bool is_left = false;
      passed.sides.at(i) =
          side(passed.corners.at(i), passed.corners.at(i == 2 ? 0 : i + 1), is_left);
      if (!is_left) {
        return false;
      }
    }
    return true;
  }

  void find_entries() {
    const int tile_x = area_.x0 / Film::kTile;
    const int tile_y = area_.y0 / Film::kTile;
    const std::vector<std::uint32_t>& faces =
        view_.faces_of_tiles[static_cast<std::size_t>(tile_y) *
                                 static_cast<std::size_t>(view_.tiles_across) +
                             static_cast<std::size_t>(tile_x)];
    for (const std::uint32_t number : faces) {
      const BoundaryFace& face = view_.mesh.boundary[number];
      const View::SeenBox box = view_.box_of(face);
      const PixelRange across = pixels_within(box.low.x(), box.high.x(), area_.x0, area_.x1);
      const PixelRange down = pixels_within(box.low.y(), box.high.y(), area_.y0, area_.y1);
      for (int y = down.first; y < down.end; ++y) {
        for (int x = across.first; x < across.end; ++x) {
          set_ray(x, y);
          PassedFace passed;
          if (passes_into(face, passed)) {
            entries_.push_back({.pixel = static_cast<std::uint32_t>(
                                    (y - area_.y0) * area_.width() + x - area_.x0),
                                .face = number,
                                .z = passed.crossing().z});
          }
        }
      }
    }
    std::ranges::sort(entries_, [](const Entry& a, const Entry& b) {
      return a.pixel != b.pixel ? a.pixel < b.pixel
                                : (a.z != b.z ? a.z < b.z : a.face < b.face);
    });
  }

  /// One ray through all parts of the mesh that it meets, from the nearest on.
  void follow(std::span<const Entry> entries) {
    const int width = area_.width();
    const std::uint32_t pixel = entries.front().pixel;
    set_ray(area_.x0 + static_cast<int>(pixel) % width,
            area_.y0 + static_cast<int>(pixel) / width);
    pixel_ = pixel;
    depth_ = 0.0;
    ++counts_.rays;
    std::uint32_t last_cell = kNoCell;
    double left_at = -std::numeric_limits<double>::infinity();
    for (const Entry& entry : entries) {
      const BoundaryFace& face = view_.mesh.boundary[entry.face];
      PassedFace passed;
      static_cast<void>(passes_into(face, passed));  // it does: that made the entry
      Crossing at = passed.crossing();
      if (at.z < left_at) {
        if (left_at - at.z > kOverlap * view_.size) {
          note_overlap(last_cell, face.cell);
        }
        at.z = left_at;
      }
      last_cell = walk(face.cell, passed, at);
      if (last_cell == kNoCell) {
        ++counts_.opaque_rays;
        return;
      }
      left_at = at.z;
    }
  }

  /// From the face into the cell and on, until the ray leaves the mesh.
  /// @param at  where it enters; then where it left
  /// @return  the last cell; kNoCell: the ray ended
  std::uint32_t walk(std::uint32_t cell, PassedFace face, Crossing& at) {
    for (std::size_t n = 0; n <= view_.mesh.cells.size(); ++n) {
      const Tetrahedron& tetrahedron = view_.mesh.cells[cell];
      const std::size_t left_behind = pass(tetrahedron, face);
      ++counts_.cells;
      const Crossing out = face.crossing();
      if (out.z > at.z) {  // otherwise nothing but rounding, or the eye
        add_cell(cell, at, out);
        at = out;
      }
      if (depth_ > most_depth_) {
        return kNoCell;
      }
      const std::uint32_t next = tetrahedron.neighbours.at(left_behind);
      if (next == kNoCell) {
        return cell;
      }
      cell = next;
    }
    note_overlap(cell, cell);  // it turns in a ring
    return kNoCell;
  }

  /// From the face that a ray passed into a cell to that by which it leaves.
  /// @return  the node that is not on that face, within the cell
  std::size_t pass(const Tetrahedron& cell, PassedFace& face) {
    auto& [a, b, c] = face.corners;
    const std::uint32_t node = cell.nodes[0] ^ cell.nodes[1] ^ cell.nodes[2] ^ cell.nodes[3] ^
                               a.node ^ b.node ^ c.node;
    const Corner d = corner_of(node);
    // The ray has all edges of abc on its left, so of ad, bd and cd at least one and not all.
    std::array<bool, 3> is_left{};
    const double ad = side(a, d, is_left[0]);
    const double bd = side(b, d, is_left[1]);
    const double cd = side(c, d, is_left[2]);
    std::uint32_t left_behind = 0;
    if (!is_left[0] && is_left[1]) {
      left_behind = c.node;
      c = d;
      face.sides = {face.sides[0], bd, -ad};
    } else if (!is_left[1] && is_left[2]) {
      left_behind = a.node;
      a = d;
      face.sides = {-bd, face.sides[1], cd};
    } else {
      left_behind = b.node;
      b = d;
      face.sides = {ad, -cd, face.sides[2]};
    }
    const auto place = std::ranges::find(cell.nodes, left_behind);
    return static_cast<std::size_t>(place - cell.nodes.begin());
  }

  /// What the ray gathers within a cell, between the clipping planes.
  void add_cell(std::uint32_t cell, Crossing from, Crossing to) {
    const VolumeScene& scene = view_.scene;
    if (scene.density_field.is_per_cell) {
      from.density = to.density = scene.density_field.values[cell];
    }
    if (scene.colour_field.is_per_cell) {
      from.colour = to.colour = scene.colour_field.values[cell];
    }
    if (!(to.z > view_.near && from.z < view_.far)) {
      return;
    }
    const Crossing whole = from;
    const double thickness = to.z - from.z;
    if (from.z < view_.near) {
      from = between(whole, to, (view_.near - whole.z) / thickness);
    }
    if (to.z > view_.far) {
      to = between(whole, to, (view_.far - whole.z) / thickness);
    }
    cut(from, to);
  }

  /// Pieces along which both transfer functions are linear.
  void cut(const Crossing& from, const Crossing& to) {
    const PiecewiseLinear<double>& density = view_.scene.density;
    const PiecewiseLinear<Array3d>& colour = view_.scene.colour;
    PartsAlong densities(density.breakpoints(), from.density, to.density);
    PartsAlong colours(colour.breakpoints(), from.colour, to.colour);
    const double length = stretch_ * (to.z - from.z);
    double s = 0.0;
    double density_at = from.density;
    double colour_at = from.colour;
    while (true) {
      const double next = std::min(densities.next(), colours.next());
      const bool is_last = !(next <= 1.0);
      const double end = is_last ? 1.0 : next;
      const auto value_at_end = [&](const PartsAlong& parts, double first, double last) {
        return parts.next() == next && !is_last ? parts.next_value()
               : is_last                        ? last
                                                : (1.0 - end) * first + end * last;
      };
      const double density_end = value_at_end(densities, from.density, to.density);
      const double colour_end = value_at_end(colours, from.colour, to.colour);
      if (end > s) {
        add_piece((end - s) * length, density.in_part(densities.part(), density_at),
                  density.in_part(densities.part(), density_end),
                  colour.in_part(colours.part(), colour_at),
                  colour.in_part(colours.part(), colour_end));
      }
      if (is_last) {
        return;
      }
      s = end;
      density_at = density_end;
      colour_at = colour_end;
      if (densities.next() == next) {
        densities.advance();
      }
      if (colours.next() == next) {
        colours.advance();
      }
    }
  }

  void add_piece(double length, double rho_near, double rho_far, const Array3d& near,
                 const Array3d& far) {
    // In a part of the transfer function it is linear, whatever rounding says.
    const double depth_near = std::max(rho_near * length, 0.0);
    const double depth_far = std::max(rho_far * length, 0.0);
    if (depth_near == 0.0 && depth_far == 0.0 && !is_glowing_) {
      return;
    }
    ++counts_.segments;
    depth_ += 0.5 * depth_near + 0.5 * depth_far;
    depths_near_.push_back(depth_near);
    depths_far_.push_back(depth_far);
    pieces_.push_back({.near = near, .far = far, .length = length, .pixel = pixel_});
    if (pieces_.size() == kBatch) {
      composite();
    }
  }

  /// The pieces so far, which of each pixel come from the eye on.
  void composite() {
    const std::size_t n = pieces_.size();
    for (std::vector<double>& column : weights_) {
      column.resize(n);
    }
    find_weights(depths_near_, depths_far_,
                 {.chromaticity_near = weights_[0],
                  .chromaticity_far = weights_[1],
                  .glow_near = weights_[2],
                  .glow_far = weights_[3],
                  .transparency = weights_[4]});
    const std::size_t first = is_glowing_ ? 2 : 0;
    for (std::size_t i = 0; i < n; ++i) {
      const Piece& piece = pieces_[i];
      PixelLight& pixel = light_[piece.pixel];
      const double scale = is_glowing_ ? piece.length : 1.0;
      const double near = scale * pixel.transparency * weights_.at(first)[i];
      const double far = scale * pixel.transparency * weights_.at(first + 1)[i];
      pixel.light += near * piece.near + far * piece.far;
      pixel.opacity += pixel.transparency * (weights_[0][i] + weights_[1][i]);
      pixel.transparency *= weights_[4][i];
    }
    depths_near_.clear();
    depths_far_.clear();
    pieces_.clear();
  }

  void note_overlap(std::uint32_t a, std::uint32_t b) {
    if (!overlap_) {
      overlap_ =
          fmt::format("cells {} and {} overlap, in pixel ({}, {})", view_.cell_name(a),
                      view_.cell_name(b), area_.x0 + static_cast<int>(pixel_) % area_.width(),
                      area_.y0 + static_cast<int>(pixel_) / area_.width());
    }
  }

  const View& view_;
  Tile area_;
  double most_depth_;
  std::vector<PixelLight> light_;
  bool is_glowing_;
  std::vector<Entry> entries_;
  VolumeCounts counts_;
  std::optional<std::string> overlap_;
  // Of the ray that is being followed.
  Vector2d p_ = Vector2d::Zero();
  double stretch_ = 1.0;
  std::uint32_t pixel_ = 0;
  double depth_ = 0.0;  ///< optical, so far
  // Pieces that are not composited yet.
  std::vector<double> depths_near_;
  std::vector<double> depths_far_;
  std::vector<Piece> pieces_;
  std::array<std::vector<double>, 5> weights_;
};

VolumeRayCaster::VolumeRayCaster(const VolumeScene& scene, const VolumeOptions& options) {
  const auto begin = std::chrono::steady_clock::now();
  view_ = std::make_unique<View>(scene);
  double of_colour = 0.0;
  for (const Array3d& colour : scene.colour.values()) {
    of_colour = std::max(of_colour, colour.maxCoeff());
  }
  // Of a chromaticity the weights add up to the opacity, of a glow to less than the length.
  brightest_ = std::max(scene.glow == Glow::own ? of_colour * view_->longest() : of_colour,
                        scene.background.maxCoeff());
  if (options.max_error > 0.0 && brightest_ > 0.0) {
    least_transparency_ = std::min(options.max_error / brightest_, 1.0);
  }
  prepare_seconds_ =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

std::uint64_t VolumeRayCaster::bytes_needed(const VolumeScene& scene) {
  const std::uint64_t n_cells = scene.mesh.n_cells();
  const std::uint64_t n_points = scene.mesh.points.size();
  constexpr std::uint64_t kPerFace = 16;  // while neighbours are found, four of each cell
  const std::uint64_t of_mesh =
      n_cells * (4 * sizeof(std::uint32_t) + sizeof(std::size_t) + 1) +
      n_points * (sizeof(Vector3d) + 2 * sizeof(double));
  return of_mesh + n_cells * (sizeof(Tetrahedron) + 4 * kPerFace) +
         n_points * (sizeof(FieldPoint) + sizeof(std::size_t));
}

VolumeRayCaster::~VolumeRayCaster() = default;

std::vector<FilmLayer> VolumeRayCaster::layers() {
  return {{.name = "light", .channels = 3}, {.name = "opacity", .channels = 1}};
}

std::uint64_t VolumeRayCaster::render_tile(SampleRange samples, FilmTile& tile) const {
  HAARLIGHT_EXPECTS(samples.first == 0 && samples.end == 1, "one sample per pixel");
  TilePicture picture(*view_, least_transparency_, tile.area());
  picture.render();
  picture.add_to(tile);
  const VolumeCounts& counts = picture.counts();
  const std::scoped_lock lock(mutex_);
  counts_.rays += counts.rays;
  counts_.cells += counts.cells;
  counts_.segments += counts.segments;
  counts_.exact_sides += counts.exact_sides;
  counts_.opaque_rays += counts.opaque_rays;
  if (picture.overlap() && (!overlap_ || *picture.overlap() < *overlap_)) {
    overlap_ = picture.overlap();
  }
  return counts.rays;
}

VolumeCounts VolumeRayCaster::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

double VolumeRayCaster::left_out() const {
  return counts().opaque_rays > 0 ? least_transparency_ * brightest_ : 0.0;
}

void VolumeRayCaster::require_no_overlap() const {
  const std::scoped_lock lock(mutex_);
  if (overlap_) {
    throw Error(*overlap_, view_->scene.mesh_file.string(),
                "a ray can be in one cell at a time: mend the mesh");
  }
}

}  // namespace haarlight::render
