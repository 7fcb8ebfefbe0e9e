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

#include "haarlight/core/error.h"
#include "render/cell_mesh/shape_functions.h"
#include "render/film/no_depth.h"
#include "render/volume/bent_face.h"
#include "render/volume/cell_light.h"
#include "render/volume/contours.h"
#include "render/volume/light_sum.h"
#include "render/volume/passed_face.h"
#include "render/volume/ray_sides.h"
#include "render/volume/volume_view.h"

namespace haarlight::render {

using Eigen::Array3d;
using Eigen::Vector3d;

namespace {

/// Of a mesh's size: by how much two cells may be in one place without overlapping.
constexpr double kOverlap = 1e-9;
/// By how much a ray is moved at first, of what is seen: some six times what rounding of bent faces
/// leaves open (bent_face.cpp). Each further time twice as far.
constexpr double kFirstMove = 1e-14;
constexpr int kMostMoves = 20;

}  // namespace

/// One tile's rays, while a single thread works on them.
class VolumeRayCaster::TilePicture {
 public:
  TilePicture(const VolumeView& view, const VolumeRule& rule, double least_transparency,
              const Tile& area)
      : view_(view),
        area_(area),
        // No ray ends before its depth is known, whatever error is allowed.
        most_depth_(std::max(
            kHalfDepth, least_transparency > 0.0 ? -std::log(least_transparency) : kNoLight)),
        contours_(view.scene.contours),
        sides_(view),
        light_(
            view,
            static_cast<std::size_t>(area.width()) * static_cast<std::size_t>(area.height()),
            rule,
            least_transparency > 0.0 ? most_depth_ : std::numeric_limits<double>::infinity()),
        pixels_(static_cast<std::size_t>(area.width()) *
                static_cast<std::size_t>(area.height())) {}

  void render() {
    find_entries();
    if (!view_.mesh.is_bent.empty()) {
      settle_rays();
    }
    std::size_t i = 0;
    while (i < entries_.size()) {
      std::size_t end = i + 1;
      while (end < entries_.size() && entries_[end].pixel == entries_[i].pixel) {
        ++end;
      }
      const std::uint64_t n_known = light_.n_lost_points() + light_.n_unresolved();
      follow(std::span(entries_).subspan(i, end - i));
      if (light_.n_lost_points() + light_.n_unresolved() > n_known) {
        pixels_[pixel_].flags |= PixelFlag::kUnresolved;
      }
      i = end;
    }
  }

  void add_to(FilmTile& tile) {
    const std::vector<PixelLight>& light_of = light_.finish();
    counts_.segments = light_.n_segments();
    counts_.exact_sides = sides_.n_exact();
    counts_.lost_points = light_.n_lost_points();
    counts_.unresolved = light_.n_unresolved();
    counts_.rule = light_.rule_counts();
    std::size_t i = 0;
    for (int y = area_.y0; y < area_.y1; ++y) {
      for (int x = area_.x0; x < area_.x1; ++x, ++i) {
        add_pixel(view_.scene, x, y, light_of[i], pixels_[i].hidden, pixels_[i].flags, tile);
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
    HiddenFrom hidden;
    unsigned flags = 0;
    int n_moves = 0;           ///< of its ray
    bool is_doubtful = false;  ///< which bent faces of the boundary it passes
  };
  /// By which faces a ray passes a cell.
  struct CellPassage {
    std::uint32_t left_by = kNoCell;  ///< kNoCell: not known
    PassedFace in;                    ///< of a straight cell
    PassedFace out;                   ///< where it is straight
    double left_at = 0.0;             ///< where it is bent
    CellLight::BentEntry entry;       ///< of a bent cell
  };
  /// The face through which a ray comes into a cell, and where.
  struct Threshold {
    std::array<std::uint32_t, 3> nodes{};
    double z = 0.0;
  };
  /// A ray passes a face of a bent cell.
  struct BentPassage {
    double z = 0.0;
    std::uint32_t face = 0;
    bool is_left_by = false;
    PassedFace straight;
    Vector3d at = Vector3d::Zero();  ///< (r, s, t)
  };
  /// Whether a ray's cells are only found, or give their light.
  enum class Walk : bool { only_found, lit };

  /// The face as the ray passes into its cell.
  /// @return  whether it does
  [[nodiscard]] bool passes_into(const BoundaryFace& face, PassedFace& passed) {
    for (std::size_t i = 0; i < 3; ++i) {  // from outside, seen along the ray: turned round
      passed.corners.at(i) = sides_.corner_of(face.nodes.at(2 - i));
    }
    return sides_.has_all_on_its_left(passed);
  }

  /// Those that the tile may see, numbers in mesh.boundary.
  [[nodiscard]] const std::vector<std::uint32_t>& faces_of_tile() const {
    const int tile_x = area_.x0 / Film::kTile;
    const int tile_y = area_.y0 / Film::kTile;
    return view_.faces_of_tiles[static_cast<std::size_t>(tile_y) *
                                    static_cast<std::size_t>(view_.tiles_across) +
                                static_cast<std::size_t>(tile_x)];
  }

  [[nodiscard]] bool is_bent(const BoundaryFace& face) const {
    return !view_.mesh.is_bent.empty() && view_.mesh.faces[face.number].is_bent();
  }

  /// Where the ray that is set passes into the mesh by a face.
  void add_entries(std::uint32_t number, std::uint32_t pixel, std::vector<Entry>& entries) {
    const BoundaryFace& face = view_.mesh.boundary[number];
    if (!is_bent(face)) {
      PassedFace passed;
      if (passes_into(face, passed)) {
        entries.push_back(
            {.pixel = pixel, .face = number, .z = passed.crossing(Passing::earliest).z});
      }
      return;
    }
    bent_.clear();
    if (!add_bent_crossings(
            view_, sides_.p(), sides_.shift(),
            nodes_of_bent(view_.scene.mesh, face.cell, view_.mesh.faces[face.number]), bent_)) {
      pixels_[pixel].is_doubtful = true;
    }
    for (const BentCrossing& crossing : bent_) {
      if (!crossing.is_left_by) {
        entries.push_back({.pixel = pixel, .face = number, .z = crossing.z});
      }
    }
  }

  void find_entries() {
    for (const std::uint32_t number : faces_of_tile()) {
      const VolumeView::SeenBox box = view_.box_of(view_.mesh.boundary[number]);
      const PixelRange across = pixels_within(box.low.x(), box.high.x(), area_.x0, area_.x1);
      const PixelRange down = pixels_within(box.low.y(), box.high.y(), area_.y0, area_.y1);
      for (int y = down.first; y < down.end; ++y) {
        for (int x = across.first; x < across.end; ++x) {
          sides_.set_ray(view_.ray(x, y));
          add_entries(number,
                      static_cast<std::uint32_t>((y - area_.y0) * area_.width() + x - area_.x0),
                      entries_);
        }
      }
    }
    sort(entries_);
  }

  static void sort(std::vector<Entry>& entries) {
    std::ranges::sort(entries, [](const Entry& a, const Entry& b) {
      return a.pixel != b.pixel ? a.pixel < b.pixel
                                : (a.z != b.z ? a.z < b.z : a.face < b.face);
    });
  }

  /// Of a pixel, as often as it has been moved: each time twice as far, in another direction.
  void set_ray_of(std::uint32_t pixel) {
    const int n = static_cast<int>(pixel);
    const int n_moves = pixels_[pixel].n_moves;
    constexpr double kGoldenAngle = 2.399963229728653;
    const double angle = kGoldenAngle * n_moves;
    const double distance =
        n_moves == 0 ? 0.0 : std::ldexp(kFirstMove * view_.size, n_moves - 1);
    sides_.set_ray(view_.ray(area_.x0 + n % area_.width(), area_.y0 + n / area_.width()),
                   distance * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }

  /// Moves rays for which it is open which faces they pass, and finds their entries anew.
  void settle_rays() {
    std::vector<Entry> settled;
    auto first = entries_.begin();
    for (std::uint32_t pixel = 0; pixel < pixels_.size(); ++pixel) {
      const auto last = std::find_if(first, entries_.end(),
                                     [&](const Entry& entry) { return entry.pixel != pixel; });
      std::vector<Entry> entries(first, last);
      first = last;
      PixelNotes& notes = pixels_[pixel];
      set_ray_of(pixel);
      while (!is_settled(pixel, entries)) {
        if (notes.n_moves == kMostMoves) {
          ++counts_.undecided_rays;
          notes.flags |= PixelFlag::kUnresolved;
          break;
        }
        ++notes.n_moves;
        notes.is_doubtful = false;
        set_ray_of(pixel);
        entries.clear();
        for (const std::uint32_t number : faces_of_tile()) {
          add_entries(number, pixel, entries);
        }
        sort(entries);
      }
      counts_.moved_rays += notes.n_moves > 0 ? 1 : 0;
      settled.insert(settled.end(), entries.begin(), entries.end());
    }
    entries_ = std::move(settled);
  }

  [[nodiscard]] bool is_settled(std::uint32_t pixel, const std::vector<Entry>& entries) {
    return !pixels_[pixel].is_doubtful &&
           std::ranges::all_of(entries, [this](const Entry& entry) {
             Crossing at;
             return walk_cells(view_.mesh.boundary[entry.face].cell, threshold_of(entry, at),
                               at, Walk::only_found) != kNoCell;
           });
  }

  /// @param at  from where on its light counts
  [[nodiscard]] Threshold threshold_of(const Entry& entry, Crossing& at) {
    const BoundaryFace& face = view_.mesh.boundary[entry.face];
    if (is_bent(face)) {
      at = {.z = entry.z};
      surely_.low = entry.z;
      return {.nodes = face.nodes, .z = entry.z};
    }
    PassedFace passed;
    static_cast<void>(passes_into(face, passed));  // it does: that made the entry
    at = passed.crossing(Passing::earliest);
    surely_.low = passed.crossing(Passing::latest).z;
    return {.nodes = face.nodes, .z = passed.crossing().z};
  }

  /// One ray through all parts of the mesh that it meets, from the nearest on.
  void follow(std::span<const Entry> entries) {
    const int width = area_.width();
    const std::uint32_t pixel = entries.front().pixel;
    const int x = area_.x0 + static_cast<int>(pixel) % width;
    const int y = area_.y0 + static_cast<int>(pixel) / width;
    set_ray_of(pixel);
    const double behind = depth_behind(view_.scene, x, y);
    const double far = behind < kNoDepth ? behind : std::numeric_limits<double>::infinity();
    pixel_ = pixel;
    light_.begin_ray(sides_.p(), pixel, contours_, pixels_[pixel].hidden);
    ++counts_.rays;
    std::uint32_t last_cell = kNoCell;
    double left_at = -std::numeric_limits<double>::infinity();
    // Where the ray surely was in the part of the mesh that it left last, and in this one.
    SureRange before;
    for (const Entry& entry : entries) {
      const BoundaryFace& face = view_.mesh.boundary[entry.face];
      Crossing at;
      const Threshold threshold = threshold_of(entry, at);
      if (at.z > left_at) {
        contours_.begin();
      }
      light_.limit(left_at, far);
      const std::uint32_t cell = view_.mesh.tetrahedra.empty()
                                     ? walk_cells(face.cell, threshold, at, Walk::lit)
                                     : walk_tetrahedra(face, at);
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
  std::uint32_t walk_tetrahedra(const BoundaryFace& entered, Crossing& at) {
    std::uint32_t cell = entered.cell;
    PassedFace face;
    static_cast<void>(passes_into(entered, face));  // it does: that made the entry
    for (std::size_t n = 0; n <= view_.mesh.tetrahedra.size(); ++n) {
      const Tetrahedron& tetrahedron = view_.mesh.tetrahedra[cell];
      const std::size_t left_behind = pass(tetrahedron, face);
      const std::uint32_t next = tetrahedron.neighbours.at(left_behind);
      ++counts_.cells;
      const Crossing out = face.crossing(next == kNoCell ? Passing::latest : Passing::any);
      if (out.z > at.z) {  // otherwise nothing but rounding, or the eye
        light_.add_linear(cell, at, out);
        at = out;
      }
      if (light_.optical_depth() > most_depth_) {
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

  /// The same of cells of any type. Where they are only found: kNoCell, it is open by which faces the ray
  /// passes one.
  std::uint32_t walk_cells(std::uint32_t cell, Threshold entered, Crossing& at, Walk walk) {
    const bool is_lit = walk == Walk::lit;
    // A bent cell may be passed several times.
    const std::size_t most = view_.scene.mesh.n_cells() * (view_.mesh.is_bent.empty() ? 1 : 8);
    for (std::size_t n = 0; n <= most; ++n) {
      CellPassage passage;
      const bool is_bent_cell = view_.mesh.is_bent_cell(cell);
      if (is_bent_cell) {
        find_bent_passage(cell, entered, passage);
      } else {
        passage.left_by = find_passage(cell, at.z, passage.in, passage.out);
      }
      if (passage.left_by == kNoCell) {
        return is_lit ? lose(cell, at) : kNoCell;
      }
      const CellFace& left = view_.mesh.faces[passage.left_by];
      const std::uint32_t next = left.neighbour;
      const Passing leaving = next == kNoCell ? Passing::latest : Passing::any;
      const Crossing end =
          left.is_bent() ? Crossing{.z = passage.left_at} : passage.out.crossing(leaving);
      counts_.cells += is_lit ? 1 : 0;
      if (end.z > at.z) {
        if (is_lit && is_bent_cell) {
          light_.add_bent(cell, passage.entry, at, end);
        } else if (is_lit) {
          light_.add_general(cell, {passage.in}, {passage.out, leaving}, at, end);
        }
        at = end;
      }
      if (is_lit && light_.optical_depth() > most_depth_) {
        return kNoCell;
      }
      if (next == kNoCell) {
        surely_.high = left.is_bent() ? end.z : passage.out.crossing(Passing::earliest).z;
        return cell;
      }
      entered = {.nodes = left.nodes,
                 .z = left.is_bent() ? passage.left_at : passage.out.crossing().z};
      cell = next;
    }
    return is_lit ? lose(cell, at) : kNoCell;
  }

  /// A ray that is not known to leave a cell ends there: of straight cells two overlap; of a bent one the
  /// ray stays undecided, which settle_rays() has counted.
  std::uint32_t lose(std::uint32_t cell, const Crossing& at) {
    if (view_.mesh.is_bent_cell(cell)) {
      surely_.high = at.z;
      return cell;
    }
    note_overlap(cell, cell);
    return kNoCell;
  }

  /// Where the ray passes the faces of a bent cell.
  /// @return  whether that is sure
  bool find_bent_passages(std::uint32_t cell) {
    passages_.clear();
    const CellMesh& mesh = view_.scene.mesh;
    for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
      const CellFace& face = view_.mesh.faces[i];
      if (face.is_bent()) {
        bent_.clear();
        if (!add_bent_crossings(view_, sides_.p(), sides_.shift(),
                                nodes_of_bent(mesh, cell, face), bent_)) {
          return false;
        }
        for (const BentCrossing& crossing : bent_) {
          BentPassage& passage = passages_.emplace_back();
          passage = {
              .z = crossing.z,
              .face = i,
              .is_left_by = crossing.is_left_by,
              .at = coordinates_on_face(mesh.types[cell], face.bent_side, crossing.weights)};
        }
        continue;
      }
      PassedFace straight;
      std::array<std::uint8_t, 3> corners = face.corners;
      for (const bool is_left_by : {true, false}) {
        for (std::size_t k = 0; k < 3; ++k) {
          straight.corners.at(k) = sides_.corner_of(mesh.nodes_of(cell)[corners.at(k)]);
        }
        if (sides_.has_all_on_its_left(straight)) {
          BentPassage& passage = passages_.emplace_back();
          passage = {.z = straight.crossing().z,
                     .face = i,
                     .is_left_by = is_left_by,
                     .straight = straight,
                     .at = coordinates_between(mesh.types[cell], corners, straight.weights())};
        }
        std::swap(corners[0], corners[1]);
      }
    }
    return true;
  }

  /// Along the ray a cell is entered and left by turns.
  [[nodiscard]] bool are_passages_by_turns() const {
    for (std::size_t i = 0; i < passages_.size(); ++i) {
      if (passages_[i].is_left_by != (i % 2 == 1) ||
          (i > 0 && !(passages_[i].z > passages_[i - 1].z))) {
        return false;
      }
    }
    return passages_.size() % 2 == 0;
  }

  /// How the ray passes a bent cell that it comes into.
  void find_bent_passage(std::uint32_t cell, const Threshold& entered, CellPassage& passage) {
    if (!find_bent_passages(cell)) {
      return;
    }
    std::ranges::sort(passages_, {}, &BentPassage::z);
    if (!are_passages_by_turns()) {
      return;
    }
    for (std::size_t i = 0; i < passages_.size(); i += 2) {
      const CellFace& face = view_.mesh.faces[passages_[i].face];
      if (std::ranges::is_permutation(face.nodes, entered.nodes) &&
          (!face.is_bent() || passages_[i].z == entered.z)) {
        passage = {.left_by = passages_[i + 1].face,
                   .out = passages_[i + 1].straight,
                   .left_at = passages_[i + 1].z,
                   .entry = {.rst = passages_[i].at, .z = passages_[i].z}};
        return;
      }
    }
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
      corners.at(i) = sides_.corner_of(nodes[i]);
    }
    for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
      PassedFace face;
      for (std::size_t k = 0; k < 3; ++k) {
        face.corners.at(k) = corners.at(view_.mesh.faces[i].corners.at(k));
      }
      if (sides_.has_all_on_its_left(face)) {
        const double at = face.crossing().z;
        if (left_by == kNoCell || (at >= z ? leaves < z || at < leaves : at > leaves)) {
          leaves = at;
          out = face;
          left_by = i;
        }
        continue;
      }
      std::swap(face.corners[0], face.corners[1]);
      if (sides_.has_all_on_its_left(face)) {
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
    const Corner d = sides_.corner_of(node);
    // The ray has all edges of abc on its left, so of ad, bd and cd at least one and not all.
    std::array<bool, 3> is_left{};
    const double ad = sides_.side(a, d, is_left[0]);
    const double bd = sides_.side(b, d, is_left[1]);
    const double cd = sides_.side(c, d, is_left[2]);
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
  RaySides sides_;
  CellLight light_;
  std::vector<PixelNotes> pixels_;
  std::vector<Entry> entries_;
  std::vector<BentCrossing> bent_;     ///< of one face
  std::vector<BentPassage> passages_;  ///< of one cell
  VolumeCounts counts_;
  std::optional<std::string> overlap_;
  // Of the ray that is being followed.
  std::uint32_t pixel_ = 0;
  SureRange surely_;  ///< of the part of the mesh that it is in
};

VolumeRayCaster::VolumeRayCaster(const VolumeScene& scene, const VolumeOptions& options)
    : rule_(options.rule) {
  require_sizes(scene);
  const auto begin = std::chrono::steady_clock::now();
  view_ = options.connected ? std::make_unique<VolumeView>(scene, options.connected)
                            : std::make_unique<VolumeView>(scene, options.faces);
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
    const bool is_shared = rule_.mode == VolumeMode::series;
    const double max_error = (is_shared ? 0.5 : 1.0) * options.max_error;
    least_transparency_ = std::min(max_error / brightest_, 1.0);
    rule_.tolerance = is_shared ? max_error / brightest_ : 0.0;
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

void add_pixel(const VolumeScene& scene, int x, int y, const PixelLight& pixel,
               const HiddenFrom& hidden, unsigned flags, FilmTile& tile) {
  const Array3d light = pixel.light + pixel.transparency * light_behind(scene, x, y);
  tile.add(x, y, VolumeRayCaster::kLight, Vector3d(light.matrix()));
  tile.add(x, y, VolumeRayCaster::kOpacity, pixel.opacity);
  tile.add(x, y, VolumeRayCaster::kDepth, hidden.depth_or(depth_behind(scene, x, y)));
  tile.add(x, y, VolumeRayCaster::kFlags, flags);
}

std::vector<FilmLayer> VolumeRayCaster::layers() {
  return {{.name = "light", .channels = 3},
          {.name = "opacity", .channels = 1},
          {.name = "depth", .channels = 1},
          {.name = "flags", .channels = 1}};
}

std::uint64_t VolumeRayCaster::render_tile(SampleRange samples, FilmTile& tile) const {
  HAARLIGHT_EXPECTS(samples.first == 0 && samples.end == 1, "one sample per pixel");
  TilePicture picture(*view_, rule_, least_transparency_, tile.area());
  picture.render();
  picture.add_to(tile);
  const VolumeCounts& counts = picture.counts();
  const std::scoped_lock lock(mutex_);
  counts_.rays += counts.rays;
  counts_.cells += counts.cells;
  counts_.segments += counts.segments;
  counts_.exact_sides += counts.exact_sides;
  counts_.opaque_rays += counts.opaque_rays;
  counts_.moved_rays += counts.moved_rays;
  counts_.undecided_rays += counts.undecided_rays;
  counts_.lost_points += counts.lost_points;
  counts_.unresolved += counts.unresolved;
  counts_.rule.add(counts.rule);
  if (picture.overlap() && (!overlap_ || *picture.overlap() < *overlap_)) {
    overlap_ = picture.overlap();
  }
  return counts.rays;
}

VolumeCounts VolumeRayCaster::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

std::optional<double> VolumeRayCaster::error_bound() const {
  const VolumeCounts counts = this->counts();
  const std::optional<double> of_pieces = relative_bound(rule_, view_->scene.glow, counts.rule);
  return of_pieces ? std::optional(*of_pieces * brightest_ +
                                   (counts.opaque_rays > 0 ? left_out() : 0.0))
                   : std::nullopt;
}

void VolumeRayCaster::require_no_overlap() const {
  const std::scoped_lock lock(mutex_);
  if (overlap_) {
    throw Error(*overlap_, view_->scene.mesh_file.string(),
                "a ray can be in one cell at a time: mend the mesh");
  }
}

}  // namespace haarlight::render
