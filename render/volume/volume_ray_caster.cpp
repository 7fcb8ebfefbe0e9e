// SPDX-License-Identifier: Apache-2.0
#include "render/volume/volume_ray_caster.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <utility>

#include <Eigen/LU>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/film/no_depth.h"
#include "render/volume/cell_map.h"
#include "render/volume/contours.h"
#include "render/volume/curve.h"
#include "render/volume/light_sum.h"
#include "render/volume/passed_face.h"
#include "render/volume/side_of_ray.h"
#include "render/volume/volume_view.h"
#include "render/volume/zero_of.h"

namespace haarlight::render {

using Eigen::Array3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kRounding = std::numeric_limits<double>::epsilon() / 2.0;
/// Of a mesh's size: by how much two cells may be in one place without overlapping.
constexpr double kOverlap = 1e-9;
constexpr double kQuadraticNoise = 2e-15;         // of a quadratic field's values
constexpr double kHalfDepth = std::numbers::ln2;  ///< the optical depth that hides half

}  // namespace

/// One tile's rays, while a single thread works on them.
class VolumeRayCaster::TilePicture {
 public:
  TilePicture(const VolumeView& view, double least_transparency, const Tile& area)
      : view_(view),
        area_(area),
        // No ray ends before its depth is known, whatever error is allowed.
        most_depth_(std::max(
            kHalfDepth, least_transparency > 0.0 ? -std::log(least_transparency) : kNoLight)),
        contours_(view.scene.contours),
        sum_(view.scene,
             static_cast<std::size_t>(area.width()) * static_cast<std::size_t>(area.height())),
        probe_(view.scene, 1),
        pixels_(static_cast<std::size_t>(area.width()) *
                static_cast<std::size_t>(area.height())) {}

  void render() {
    find_entries();
    std::size_t i = 0;
    while (i < entries_.size()) {
      std::size_t end = i + 1;
      while (end < entries_.size() && entries_[end].pixel == entries_[i].pixel) {
        ++end;
      }
      const std::uint64_t n_known = counts_.lost_points + counts_.unresolved;
      follow(std::span(entries_).subspan(i, end - i));
      if (counts_.lost_points + counts_.unresolved > n_known) {
        pixels_[pixel_].flags |= PixelFlag::kUnresolved;
      }
      i = end;
    }
  }

  void add_to(FilmTile& tile) {
    const std::vector<PixelLight>& light_of = sum_.finish();
    counts_.segments = sum_.n_segments();
    std::size_t i = 0;
    for (int y = area_.y0; y < area_.y1; ++y) {
      for (int x = area_.x0; x < area_.x1; ++x, ++i) {
        const PixelLight& pixel = light_of[i];
        const Array3d light =
            pixel.light + pixel.transparency * light_behind(view_.scene, x, y);
        tile.add(x, y, kLight, Vector3d(light.matrix()));
        tile.add(x, y, kOpacity, pixel.opacity);
        tile.add(x, y, kDepth,
                 pixels_[i].depth < kNoDepth ? pixels_[i].depth : depth_behind(x, y));
        tile.add(x, y, kFlags, pixels_[i].flags);
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
  /// Of z, whatever rounding leaves open.
  struct SureRange {
    double low = 0.0;
    double high = -std::numeric_limits<double>::infinity();
  };

  /// Of a pixel, beside its light.
  struct PixelNotes {
    double depth = kNoDepth;  ///< where the medium hides half
    unsigned flags = 0;
  };

  /// Of the surface behind the medium; kNoDepth: there is none.
  [[nodiscard]] double depth_behind(int x, int y) const {
    if (!view_.scene.surfaces) {
      return kNoDepth;
    }
    return std::min(static_cast<double>(view_.scene.surfaces->depth(y, x)), kNoDepth);
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
    for (std::size_t i = 0; i < 3; ++i) {  // from outside, seen along the ray: turned round
      passed.corners.at(i) = corner_of(face.nodes.at(2 - i));
    }
    return has_all_on_its_left(passed);
  }

  /// Fills in the sides.
  [[nodiscard]] bool has_all_on_its_left(PassedFace& passed) {
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
      const VolumeView::SeenBox box = view_.box_of(face);
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
                                .z = passed.crossing(Passing::earliest).z});
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
    const int x = area_.x0 + static_cast<int>(pixel) % width;
    const int y = area_.y0 + static_cast<int>(pixel) / width;
    set_ray(x, y);
    const double behind = depth_behind(x, y);
    far_ = behind < kNoDepth ? std::min(view_.far, behind) : view_.far;
    pixel_ = pixel;
    sum_.begin_ray(pixel);
    ++counts_.rays;
    std::uint32_t last_cell = kNoCell;
    double left_at = -std::numeric_limits<double>::infinity();
    // Where the ray surely was in the part of the mesh that it left last, and in this one.
    SureRange before;
    for (const Entry& entry : entries) {
      const BoundaryFace& face = view_.mesh.boundary[entry.face];
      PassedFace passed;
      static_cast<void>(passes_into(face, passed));  // it does: that made the entry
      Crossing at = passed.crossing(Passing::earliest);
      if (at.z > left_at) {
        contours_.begin();
      }
      begin_z_ = left_at;
      surely_.low = passed.crossing(Passing::latest).z;
      const std::uint32_t cell = view_.mesh.tetrahedra.empty()
                                     ? walk_cells(face.cell, at)
                                     : walk_tetrahedra(face.cell, passed, at);
      if (cell == kNoCell) {
        ++counts_.opaque_rays;
        pixels_[pixel].flags |= PixelFlag::kEnded;
        return;
      }
      if (std::min(before.high, surely_.high) - std::max(before.low, surely_.low) >
          kOverlap * view_.size) {
        note_overlap(last_cell, face.cell);
      }
      if (surely_.high > before.high) {
        before = surely_;
        last_cell = cell;
      }
      left_at = std::max(left_at, at.z);
    }
  }

  /// From the face into the cell and on, until the ray leaves the mesh.
  /// @param at  where it enters; then where it left
  /// @return  the last cell; kNoCell: the ray ended
  std::uint32_t walk_tetrahedra(std::uint32_t cell, PassedFace face, Crossing& at) {
    for (std::size_t n = 0; n <= view_.mesh.tetrahedra.size(); ++n) {
      const Tetrahedron& tetrahedron = view_.mesh.tetrahedra[cell];
      const std::size_t left_behind = pass(tetrahedron, face);
      const std::uint32_t next = tetrahedron.neighbours.at(left_behind);
      ++counts_.cells;
      const Crossing out = face.crossing(next == kNoCell ? Passing::latest : Passing::any);
      if (out.z > at.z) {  // otherwise nothing but rounding, or the eye
        add_linear(cell, at, out);
        at = out;
      }
      if (sum_.optical_depth() > most_depth_) {
        return kNoCell;
      }
      if (next == kNoCell) {
        surely_.high = face.crossing(Passing::earliest).z;
        return cell;
      }
      cell = next;
    }
    note_overlap(cell, cell);  // it turns in a ring
    return kNoCell;
  }

  /// The same of cells of any type.
  std::uint32_t walk_cells(std::uint32_t cell, Crossing& at) {
    for (std::size_t n = 0; n <= view_.scene.mesh.n_cells(); ++n) {
      PassedFace in;
      PassedFace out;
      const std::uint32_t left_by = find_passage(cell, at.z, in, out);
      ++counts_.cells;
      if (left_by == kNoCell) {
        note_overlap(cell, cell);
        return kNoCell;
      }
      const std::uint32_t next = view_.mesh.faces[left_by].neighbour;
      const Crossing end = out.crossing(next == kNoCell ? Passing::latest : Passing::any);
      if (end.z > at.z) {
        add_general(cell, in, out, at, end);
        at = end;
      }
      if (sum_.optical_depth() > most_depth_) {
        return kNoCell;
      }
      if (next == kNoCell) {
        surely_.high = out.crossing(Passing::earliest).z;
        return cell;
      }
      cell = next;
    }
    note_overlap(cell, cell);
    return kNoCell;
  }

  /// The faces by which a ray enters a cell and leaves it. Where there are several (the cell is not
  /// convex): the first that it leaves by at z or behind it, else the last; the last that it enters by
  /// up to z, else the first.
  /// @return  the number of the face that it leaves by; kNoCell: none, or it enters by none
  std::uint32_t find_passage(std::uint32_t cell, double z, PassedFace& in, PassedFace& out) {
    std::uint32_t left_by = kNoCell;
    double leaves = 0.0;
    double enters = 0.0;
    bool has_entered = false;
    const std::span<const std::uint32_t> nodes = view_.scene.mesh.nodes_of(cell);
    std::array<Corner, 8> corners;
    for (std::size_t i = 0; i < shape_of(view_.scene.mesh.types[cell]).n_corners; ++i) {
      corners.at(i) = corner_of(nodes[i]);
    }
    for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
      PassedFace face;
      for (std::size_t k = 0; k < 3; ++k) {
        face.corners.at(k) = corners.at(view_.mesh.faces[i].corners.at(k));
      }
      if (has_all_on_its_left(face)) {
        const double at = face.crossing().z;
        if (left_by == kNoCell || (at >= z ? leaves < z || at < leaves : at > leaves)) {
          leaves = at;
          out = face;
          left_by = i;
        }
        continue;
      }
      std::swap(face.corners[0], face.corners[1]);
      if (has_all_on_its_left(face)) {
        const double at = face.crossing().z;
        if (!has_entered || (at <= z ? enters > z || at > enters : at < enters)) {
          enters = at;
          in = face;
          has_entered = true;
        }
      }
    }
    return has_entered ? left_by : kNoCell;
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

  /// Where z is between `from` and `to`.
  [[nodiscard]] static double fraction_at(double z, double from, double to) {
    return to > from ? std::clamp((z - from) / (to - from), 0.0, 1.0) : 0.0;
  }

  /// The part of [from, to] that is between the clipping planes, in front of the surface behind the
  /// medium, and behind what has been passed, as fractions; nothing: none is.
  [[nodiscard]] std::optional<std::array<double, 2>> clipped(double from, double to) const {
    const double near = std::max(view_.near, begin_z_);
    if (!(to > near && from < far_ && near < far_)) {
      return std::nullopt;
    }
    const double thickness = to - from;
    return std::array{from < near ? (near - from) / thickness : 0.0,
                      to > far_ ? (far_ - from) / thickness : 1.0};
  }

  /// Adds what the ray gathers on a part of a stretch, and notes where half is hidden.
  /// @param from, thickness  where the stretch begins, and its length, in z @param u, v  the part, as
  /// fractions @param add  (sum, u, v): adds a part to a sum @param density_at  (s): the field there
  template <class Add, class Density>
  void gather(double from, double thickness, double u, double v, const Add& add,
              const Density& density_at) {
    const double before = sum_.optical_depth();
    add(sum_, u, v);
    double& depth = pixels_[pixel_].depth;
    if (depth < kNoDepth || !(sum_.optical_depth() >= kHalfDepth)) {
      return;
    }
    const auto too_deep = [&](double end) {
      probe_.begin_ray(0);
      add(probe_, u, end);
      return before + probe_.optical_depth() - kHalfDepth;
    };
    // Where the extinction is linear: the part x of the way at which the part r of the depth is reached.
    const double a = view_.scene.density.at(density_at(u));
    const double b = view_.scene.density.at(density_at(v));
    const double r = (kHalfDepth - before) / (sum_.optical_depth() - before);
    const double x = r * (a + b) / (a + std::sqrt(a * a + (b * b - a * a) * r));
    depth = from + thickness * zero_of(too_deep, {u, before - kHalfDepth},
                                       {v, sum_.optical_depth() - kHalfDepth}, u + x * (v - u));
  }

  /// What the ray gathers within a cell where its fields are linear.
  void add_linear(std::uint32_t cell, Crossing from, Crossing to) {
    const std::optional<std::array<double, 2>> part = clipped(from.z, to.z);
    set_cell_fields(cell, from);
    set_cell_fields(cell, to);
    double s = part ? (*part)[0] : 0.0;
    const auto add_part = [&](LightSum& sum, double u, double v) {
      const Crossing near = between(from, to, u);
      const Crossing far = between(from, to, v);
      sum.add({.length = stretch_ * (far.z - near.z),
               .density_near = near.density,
               .density_far = far.density,
               .colour_near = near.colour,
               .colour_far = far.colour});
    };
    const auto add_until = [&](double end) {
      gather(from.z, to.z - from.z, s, end, add_part,
             [&](double at) { return between(from, to, at).density; });
      s = end;
    };
    if (!view_.scene.contours.empty()) {
      for (const ContourTracker::Hit& hit : contours_.between(from.contour, to.contour)) {
        if (part && hit.s >= (*part)[0] && hit.s <= (*part)[1]) {
          add_until(hit.s);
          add_surface(hit.contour, slope_in_tetrahedron(cell), from.z + s * (to.z - from.z));
        }
      }
    }
    if (part) {
      add_until((*part)[1]);
    }
  }

  /// Of the contours' field, where a tetrahedron has it linear.
  [[nodiscard]] Vector3d slope_in_tetrahedron(std::uint32_t cell) const {
    const std::span<const std::uint32_t> nodes = view_.scene.mesh.nodes_of(cell);
    Eigen::Matrix3d edges;
    Vector3d changes;
    for (int i = 0; i < 3; ++i) {
      edges.row(i) =
          (position_of(nodes[static_cast<std::size_t>(i) + 1]) - position_of(nodes[0]))
              .transpose();
      changes[i] = view_.points[nodes[static_cast<std::size_t>(i) + 1]].contour -
                   view_.points[nodes[0]].contour;
    }
    return edges.inverse() * changes;
  }

  /// In the camera's frame.
  [[nodiscard]] Vector3d position_of(std::uint32_t node) const {
    const SeenPoint& seen = view_.points[node].seen;
    return {seen.x, seen.y, seen.z};
  }

  /// @param slope  of the field, across the surface @param z  where it is
  void add_surface(std::size_t contour, const Vector3d& slope, double z) {
    const Vector3d along = view_.point_at(p_, 1.0) - view_.point_at(p_, 0.0);
    const double cosine = std::abs(slope.dot(along)) / (slope.norm() * along.norm());
    sum_.add(seen_of(view_.scene.contours[contour], std::isfinite(cosine) ? cosine : 0.0));
    double& depth = pixels_[pixel_].depth;
    if (!(depth < kNoDepth) && sum_.optical_depth() >= kHalfDepth) {
      depth = z;
    }
  }

  void set_cell_fields(std::uint32_t cell, Crossing& at) const {
    const VolumeScene& scene = view_.scene;
    if (scene.density_field.is_per_cell) {
      at.density = scene.density_field.values[cell];
    }
    if (scene.colour_field.is_per_cell) {
      at.colour = scene.colour_field.values[cell];
    }
  }

  /// What it gathers within a cell of any type.
  /// @param end  where it leaves; of linear cells also their fields there
  void add_general(std::uint32_t cell, const PassedFace& in, const PassedFace& out,
                   const Crossing& from, const Crossing& end) {
    const CellType type = view_.scene.mesh.types[cell];
    if (type == CellType::tetrahedron) {
      const Crossing begin = in.crossing();
      add_linear(cell, between(begin, end, fraction_at(from.z, begin.z, end.z)), end);
      return;
    }
    if (type == CellType::quadratic_tetrahedron) {
      add_quadratic(cell, in, out, from.z, end.z);
      return;
    }
    const VolumeScene& scene = view_.scene;
    if (scene.density_field.is_per_cell && scene.colour_field.is_per_cell &&
        scene.contours.empty()) {
      add_linear(cell, from, end);
      return;
    }
    std::array<Vector3d, 8> corners;
    std::array<MappedFields, 8> fields;
    const std::span<const std::uint32_t> nodes = scene.mesh.nodes_of(cell);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      const FieldPoint& point = view_.points[nodes[i]];
      corners.at(i) = position_of(nodes[i]);
      fields.at(i) = {
          .density = point.density, .colour = point.colour, .contour = point.contour};
    }
    CellMap map(type, std::span(corners).first(nodes.size()),
                std::span(fields).first(nodes.size()));
    constexpr int kHalvings = 20;
    add_mapped(cell, map, from.z, end.z, kHalvings, std::numeric_limits<double>::infinity());
    counts_.lost_points += map.n_lost();
  }

  static double over(double tail, double noise) { return tail > 0.0 ? tail / noise : 0.0; }

  /// By polynomials of a degree that is high enough, on as many parts as it takes.
  /// @param before  what the stretch of which this is a half left out, in units of rounding
  void add_mapped(std::uint32_t cell, CellMap& map, double from, double to, int n_halvings,
                  double before) {
    std::array<double, Curve::kPoints> densities{};
    std::array<double, Curve::kPoints> colours{};
    std::array<double, Curve::kPoints> contours{};
    const Vector3d first = view_.point_at(p_, from);
    const Vector3d last = view_.point_at(p_, to);
    const std::array<Vector3d, 2> ends =
        map.is_affine() ? std::array{map.find(first), map.find(last)} : std::array{first, last};
    for (std::size_t i = 0; i < Curve::kPoints; ++i) {
      const double s = Curve::points().at(i);
      const Vector3d at = (1.0 - s) * ends[0] + s * ends[1];
      const MappedFields fields = map.is_affine() ? map.fields_of(at) : map.at(at);
      densities.at(i) = fields.density;
      colours.at(i) = fields.colour;
      contours.at(i) = fields.contour;
    }
    const auto curve_of = [&](const ScalarField& field,
                              const std::array<double, Curve::kPoints>& values, double noise) {
      return field.is_per_cell ? Curve::linear(field.values[cell], field.values[cell])
                               : Curve::through(values, noise);
    };
    const MappedFields& noise = map.noise();
    const CellCurves curves = {
        .density = curve_of(view_.scene.density_field, densities, noise.density),
        .colour = curve_of(view_.scene.colour_field, colours, noise.colour),
        .contour = Curve::through(contours, noise.contour),
        .contour_noise = noise.contour};
    // What is left out, in units of what rounding makes of the fields.
    const double excess = std::max({over(curves.density.tail(), noise.density),
                                    over(curves.colour.tail(), noise.colour),
                                    over(curves.contour.tail(), noise.contour)});
    const bool is_resolved = excess <= 1.0;
    // Of a field that a polynomial can fit half the stretch leaves a two hundredth.
    constexpr double kPerhapsNoise = 1e3;
    const bool is_noise = excess < kPerhapsNoise && excess > 0.7 * before;
    if (is_resolved || is_noise || n_halvings == 0) {
      counts_.unresolved += is_resolved ? 0 : 1;
      add_curves(curves, clipped(from, to), from, to - from, [&](double s) {
        return map.contour_slope(view_.point_at(p_, from + s * (to - from)));
      });
      return;
    }
    const double middle = 0.5 * (from + to);
    add_mapped(cell, map, from, middle, n_halvings - 1, excess);
    add_mapped(cell, map, middle, to, n_halvings - 1, excess);
  }

  /// The fields along a ray's stretch within a cell.
  struct CellCurves {
    Curve density;
    Curve colour;
    Curve contour;
    double contour_noise = 0.0;
  };

  /// @param part      what is between the clipping planes
  /// @param from, thickness  where the stretch begins, and its length, in z
  /// @param slope_at  (s): how the contours' field changes
  template <class Slope>
  void add_curves(const CellCurves& curves, const std::optional<std::array<double, 2>>& part,
                  double from, double thickness, const Slope& slope_at) {
    const double length = stretch_ * thickness;
    const auto add_part = [&](LightSum& sum, double u, double v) {
      sum.add(length, curves.density, curves.colour, u, v);
    };
    double s = part ? (*part)[0] : 0.0;
    if (!view_.scene.contours.empty()) {
      for (const ContourTracker::Hit& hit :
           contours_.along(curves.contour, curves.contour_noise)) {
        if (part && hit.s >= (*part)[0] && hit.s <= (*part)[1]) {
          gather(from, thickness, s, hit.s, add_part, curves.density);
          s = hit.s;
          add_surface(hit.contour, slope_at(s), from + s * thickness);
        }
      }
    }
    if (part) {
      gather(from, thickness, s, (*part)[1], add_part, curves.density);
    }
  }

  /// Of a quadratic tetrahedron with straight edges: by its barycentric coordinates, which are linear
  /// along the ray.
  void add_quadratic(std::uint32_t cell, const PassedFace& in, const PassedFace& out,
                     double from, double to) {
    const std::span<const std::uint32_t> nodes = view_.scene.mesh.nodes_of(cell);
    const Eigen::Vector4d entry = barycentric(in, nodes);
    const Eigen::Vector4d end = barycentric(out, nodes);
    const double skipped = fraction_at(from, in.crossing().z, to);
    const Eigen::Vector4d begin = (1.0 - skipped) * entry + skipped * end;
    const auto fields_at = [&](double s) {
      const Eigen::Vector4d b = (1.0 - s) * begin + s * end;
      Crossing at;
      const auto add = [&](std::size_t node, double weight) {
        const FieldPoint& point = view_.points[nodes[node]];
        at.density += weight * point.density;
        at.colour += weight * point.colour;
        at.contour += weight * point.contour;
      };
      for (int i = 0; i < 4; ++i) {
        add(static_cast<std::size_t>(i), b[i] * (2.0 * b[i] - 1.0));
      }
      for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
        const auto [i, j] = kQuadraticEdges.at(e);
        add(4 + e, 4.0 * b[i] * b[j]);
      }
      set_cell_fields(cell, at);
      return at;
    };
    const Crossing near = fields_at(0.0);
    const Crossing middle = fields_at(0.5);
    const Crossing far = fields_at(1.0);
    add_curves({.density = Curve::quadratic(near.density, middle.density, far.density),
                .colour = Curve::quadratic(near.colour, middle.colour, far.colour),
                .contour = Curve::quadratic(near.contour, middle.contour, far.contour),
                .contour_noise = kQuadraticNoise *
                                 std::max({std::abs(near.contour), std::abs(middle.contour),
                                           std::abs(far.contour)})},
               clipped(from, to), from, to - from, [&](double s) {
                 return slope_in_quadratic(nodes, (1.0 - s) * begin + s * end);
               });
  }

  /// Of the contours' field at barycentric coordinates b.
  [[nodiscard]] Vector3d slope_in_quadratic(std::span<const std::uint32_t> nodes,
                                            const Eigen::Vector4d& b) const {
    Eigen::Vector4d by_b;
    for (int i = 0; i < 4; ++i) {
      by_b[i] = (4.0 * b[i] - 1.0) * view_.points[nodes[static_cast<std::size_t>(i)]].contour;
    }
    for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
      const auto [i, j] = kQuadraticEdges.at(e);
      const double value = view_.points[nodes[4 + e]].contour;
      by_b[i] += 4.0 * b[j] * value;
      by_b[j] += 4.0 * b[i] * value;
    }
    Eigen::Matrix3d edges;
    for (int i = 0; i < 3; ++i) {
      edges.row(i) =
          (position_of(nodes[static_cast<std::size_t>(i) + 1]) - position_of(nodes[0]))
              .transpose();
    }
    return edges.inverse() * Vector3d(by_b[1] - by_b[0], by_b[2] - by_b[0], by_b[3] - by_b[0]);
  }

  /// Of where a ray passes a face of the tetrahedron.
  static Eigen::Vector4d barycentric(const PassedFace& face,
                                     std::span<const std::uint32_t> nodes) {
    const std::array<double, 3> weights = face.weights();
    Eigen::Vector4d b = Eigen::Vector4d::Zero();
    for (std::size_t i = 0; i < 3; ++i) {
      const auto* const corner =
          std::ranges::find(nodes.first(4), face.corners.at(i).node).base();
      b[corner - nodes.data()] = weights.at(i);
    }
    return b;
  }

  void note_overlap(std::uint32_t a, std::uint32_t b) {
    pixels_[pixel_].flags |= PixelFlag::kOverlap;
    if (!overlap_) {
      overlap_ =
          fmt::format("cells {} and {} overlap, in pixel ({}, {})", view_.cell_name(a),
                      view_.cell_name(b), area_.x0 + static_cast<int>(pixel_) % area_.width(),
                      area_.y0 + static_cast<int>(pixel_) / area_.width());
    }
  }

  const VolumeView& view_;
  Tile area_;
  double most_depth_;
  ContourTracker contours_;
  LightSum sum_;
  LightSum probe_;  ///< of parts of one stretch, to find a depth
  std::vector<PixelNotes> pixels_;
  std::vector<Entry> entries_;
  VolumeCounts counts_;
  std::optional<std::string> overlap_;
  // Of the ray that is being followed.
  Vector2d p_ = Vector2d::Zero();
  double stretch_ = 1.0;
  std::uint32_t pixel_ = 0;
  double far_ = 0.0;      ///< of the camera, or of the surface behind the medium
  double begin_z_ = 0.0;  ///< what is nearer has been passed in other cells
  SureRange surely_;      ///< of the part of the mesh that it is in
};

VolumeRayCaster::VolumeRayCaster(const VolumeScene& scene, const VolumeOptions& options) {
  require_sizes(scene);
  const auto begin = std::chrono::steady_clock::now();
  view_ = std::make_unique<VolumeView>(scene, options.faces);
  double of_colour = 0.0;
  for (const Array3d& colour : scene.colour.values()) {
    of_colour = std::max(of_colour, colour.maxCoeff());
  }
  // Of a chromaticity the weights add up to the opacity, of a glow to less than the length.
  brightest_ =
      std::max(scene.glow == Glow::own ? of_colour * view_->longest() : of_colour,
               scene.surfaces ? brightest_of(*scene.surfaces) : brightest_of(scene.background));
  for (const Contour& contour : scene.contours) {  // all of them in front of each other
    brightest_ +=
        contour.colour.maxCoeff() * (contour.ambient + contour.diffuse) + contour.specular;
  }
  if (options.max_error > 0.0 && brightest_ > 0.0) {
    least_transparency_ = std::min(options.max_error / brightest_, 1.0);
  }
  prepare_seconds_ =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

std::uint64_t VolumeRayCaster::bytes_needed(const VolumeScene& scene) {
  const CellMesh& mesh = scene.mesh;
  const std::uint64_t n_points = mesh.points.size();
  const std::uint64_t of_pictures =
      scene.background.picture.pixels().size_bytes() +
      (scene.surfaces ? scene.surfaces->light.pixels().size_bytes() +
                            scene.surfaces->depth.pixels().size_bytes()
                      : 0);
  const std::uint64_t of_mesh = mesh.nodes.size() * sizeof(std::uint32_t) +
                                mesh.n_cells() * (sizeof(std::size_t) + sizeof(CellType)) +
                                n_points * (sizeof(Vector3d) + 3 * sizeof(double));
  std::uint64_t n_faces = 0;
  bool are_tetrahedra = true;
  for (const CellType type : mesh.types) {
    for (const std::array<std::uint8_t, 4>& face : shape_of(type).faces) {
      n_faces += face[3] == kNone ? 1 : 2;
    }
    are_tetrahedra = are_tetrahedra && type == CellType::tetrahedron;
  }
  constexpr std::uint64_t kPerFace = 16;  // while neighbours are found
  const std::uint64_t of_faces =
      n_faces * kPerFace +
      (are_tetrahedra ? mesh.n_cells() * sizeof(Tetrahedron) : n_faces * sizeof(CellFace));
  return of_pictures + of_mesh + of_faces +
         n_points * (sizeof(FieldPoint) + sizeof(std::size_t));
}

VolumeRayCaster::~VolumeRayCaster() = default;

std::vector<FilmLayer> VolumeRayCaster::layers() {
  return {{.name = "light", .channels = 3},
          {.name = "opacity", .channels = 1},
          {.name = "depth", .channels = 1},
          {.name = "flags", .channels = 1}};
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
  counts_.lost_points += counts.lost_points;
  counts_.unresolved += counts.unresolved;
  if (picture.overlap() && (!overlap_ || *picture.overlap() < *overlap_)) {
    overlap_ = picture.overlap();
  }
  return counts.rays;
}

VolumeCounts VolumeRayCaster::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

void VolumeRayCaster::require_no_overlap() const {
  const std::scoped_lock lock(mutex_);
  if (overlap_) {
    throw Error(*overlap_, view_->scene.mesh_file.string(),
                "a ray can be in one cell at a time: mend the mesh");
  }
}

}  // namespace haarlight::render
