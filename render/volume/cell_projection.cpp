// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_projection.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/film/no_depth.h"
#include "render/volume/cell_light.h"
#include "render/volume/passed_face.h"
#include "render/volume/ray_sides.h"
#include "render/volume/volume_ray_caster.h"
#include "render/volume/volume_view.h"

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Of a mesh's size: by how much two cells may be in one place without a violation.
constexpr double kOverlap = 1e-9;

/// A field is what its corners tell, linear along each edge, and the other nodes' differences from that by
/// their shape functions, whose absolute values sum to no more than this: 3/2 in a quadratic tetrahedron,
/// 2.77 in a cubic one, 3 and 2 in hexahedra of 20 and 27 nodes, 7/3 in wedges, 9/4 in pyramids.
constexpr double kMostOfOthers = 3.0;

constexpr std::uint32_t kNoSplat = std::numeric_limits<std::uint32_t>::max();

std::span<const std::uint32_t> corners_of(const CellMesh& mesh, std::uint32_t cell) {
  return mesh.nodes_of(cell).first(shape_of(mesh.types[cell]).n_corners);
}

struct ValueRange {
  double low = kInfinity;
  double high = -kInfinity;

  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

/// How far a field's nodes behind the corners are off what the corners alone tell there, at most.
double most_off_corners(const ScalarField& field, const CellMesh& mesh, std::uint32_t cell) {
  const CellShape& shape = shape_of(mesh.types[cell]);
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(cell);
  const auto value = [&](std::size_t node) { return field.values[nodes[node]]; };
  double most = 0.0;
  std::size_t node = shape.n_corners;
  for (const auto& [a, b] : shape.edges) {
    for (std::size_t k = 1; k <= shape.on_edge; ++k, ++node) {
      const double t = static_cast<double>(k) / static_cast<double>(shape.on_edge + 1);
      most = std::max(most, std::abs(value(node) - std::lerp(value(a), value(b), t)));
    }
  }
  for (std::size_t side = 0; side < shape.in_faces.size(); ++side) {
    double sum = 0.0;
    double n = 0.0;
    for (const std::uint8_t corner : shape.faces[side]) {
      if (corner != kNone) {
        sum += value(corner);
        n += 1.0;
      }
    }
    most = std::max(most, std::abs(value(shape.in_faces[side]) - sum / n));
  }
  if (shape.centre != kNone) {
    double sum = 0.0;
    for (std::size_t corner = 0; corner < shape.n_corners; ++corner) {
      sum += value(corner);
    }
    most = std::max(most,
                    std::abs(value(shape.centre) - sum / static_cast<double>(shape.n_corners)));
  }
  return most;
}

/// Of a field within a cell, or a wider one.
ValueRange range_of(const ScalarField& field, const CellMesh& mesh, std::uint32_t cell) {
  ValueRange range;
  if (field.is_per_cell) {
    range.add(field.values[cell]);
    return range;
  }
  for (const std::uint32_t node : corners_of(mesh, cell)) {
    range.add(field.values[node]);
  }
  if (shape_of(mesh.types[cell]).may_bend()) {
    const double off = kMostOfOthers * most_off_corners(field, mesh, cell);
    range.add(range.low - off);
    range.add(range.high + off);
  }
  return range;
}

bool is_empty_within(const PiecewiseLinear<double>& density, const ValueRange& range) {
  const std::span<const double> breakpoints = density.breakpoints();
  const auto first = std::ranges::upper_bound(breakpoints, range.low) - breakpoints.begin();
  const auto end = std::ranges::lower_bound(breakpoints, range.high) - breakpoints.begin();
  for (auto i = first; i < end; ++i) {
    if (density.values()[static_cast<std::size_t>(i)] > 0.0) {
      return false;
    }
  }
  return !(density.at(range.low) > 0.0) && !(density.at(range.high) > 0.0);
}

bool is_transparent(const VolumeScene& scene, std::uint32_t cell) {
  if (scene.glow == Glow::own ||
      !is_empty_within(scene.density, range_of(scene.density_field, scene.mesh, cell))) {
    return false;
  }
  if (scene.contours.empty()) {
    return true;
  }
  const ValueRange range = range_of(scene.contour_field, scene.mesh, cell);
  return std::ranges::none_of(scene.contours, [&range](const Contour& contour) {
    return contour.value >= range.low && contour.value <= range.high;
  });
}

}  // namespace

/// One tile's pixels, while a single thread works on them.
class CellProjection::TilePicture {
 public:
  TilePicture(const VolumeView& view, const VisibilityOrder& order, const Tile& area)
      : view_(view),
        order_(order),
        area_(area),
        sides_(view),
        light_(view, n_pixels()),
        // Without contours one will do for all: it is not asked.
        contours_(view.scene.contours.empty() ? 1 : n_pixels(),
                  ContourTracker(view.scene.contours)),
        pixels_(n_pixels()) {}

  void add(std::uint32_t number) {
    const OrderedPiece& piece = order_.back_to_front[number];
    const VolumeView::SeenBox box =
        view_.box_of(render::corners_of(view_.scene.mesh, piece.cell));
    const PixelRange across = pixels_within(box.low.x(), box.high.x(), area_.x0, area_.x1);
    const PixelRange down = pixels_within(box.low.y(), box.high.y(), area_.y0, area_.y1);
    for (int y = down.first; y < down.end; ++y) {
      for (int x = across.first; x < across.end; ++x) {
        sides_.set_ray(view_.ray(x, y));
        const double behind = depth_behind(view_.scene, x, y);
        far_ = kInfinity;
        if (behind < kNoDepth) {
          far_ = behind;
        }
        add_ray(piece,
                static_cast<std::uint32_t>((y - area_.y0) * area_.width() + x - area_.x0));
      }
    }
  }

  void add(const CellSplat& splat) {
    const std::array<int, 2> first = splat.first_pixel();
    for (int y = std::max(first[1], area_.y0); y < std::min(first[1] + 3, area_.y1); ++y) {
      for (int x = std::max(first[0], area_.x0); x < std::min(first[0] + 3, area_.x1); ++x) {
        const auto pixel =
            static_cast<std::uint32_t>((y - area_.y0) * area_.width() + x - area_.x0);
        const double behind = depth_behind(view_.scene, x, y);
        if (behind < kNoDepth && splat.depth >= behind) {
          continue;
        }
        light_.begin_ray(view_.ray(x, y), pixel,
                         contours_.size() == 1 ? contours_[0] : contours_[pixel],
                         pixels_[pixel].hidden);
        light_.add_summed(splat.at(x, y, view_.scene.glow), splat.depth);
      }
    }
  }

  void add_to(FilmTile& tile) {
    const std::vector<PixelLight>& light_of = light_.finish();
    counts_.segments = light_.n_segments();
    counts_.exact_sides = sides_.n_exact();
    counts_.lost_points = light_.n_lost_points();
    counts_.unresolved = light_.n_unresolved();
    std::size_t i = 0;
    for (int y = area_.y0; y < area_.y1; ++y) {
      for (int x = area_.x0; x < area_.x1; ++x, ++i) {
        add_pixel(view_.scene, x, y, light_of[i], pixels_[i].hidden, pixels_[i].flags, tile);
      }
    }
  }

  [[nodiscard]] const ProjectionCounts& counts() const { return counts_; }
  [[nodiscard]] const std::string& violation() const { return violation_; }

 private:
  /// What a pixel's ray has passed so far.
  struct Passed {
    double until = -kInfinity;   ///< z of its end
    double surely = -kInfinity;  ///< the same, whatever rounding leaves open
    std::uint32_t last_cell = kNoCell;
    bool was_cut = false;  ///< the last stretch, at its end
    HiddenFrom hidden;
    unsigned flags = 0;  ///< PixelFlag
  };
  /// A face of the cell that a ray passes.
  struct Passage {
    PassedFace face;
    Crossing at;
    double surely = 0.0;  ///< z, the farther into the cell of what rounding leaves open
  };
  /// Of a bent cell there may be several.
  class Passages {
   public:
    void clear() { n_ = 0; }
    Passage& add() { return items_.at(n_++); }
    [[nodiscard]] std::span<Passage> all() { return std::span(items_).first(n_); }

   private:
    std::array<Passage, 12> items_;
    std::size_t n_ = 0;
  };

  [[nodiscard]] std::size_t n_pixels() const {
    return static_cast<std::size_t>(area_.width()) * static_cast<std::size_t>(area_.height());
  }

  void add_ray(const OrderedPiece& piece, std::uint32_t pixel) {
    find_passages(piece.cell);
    const std::span<Passage> entries = entries_.all();
    const std::span<Passage> exits = exits_.all();
    const auto by_z = [](const Passage& passage) { return passage.at.z; };
    if (entries.size() > 1) {
      std::ranges::sort(entries, {}, by_z);
      std::ranges::sort(exits, {}, by_z);
    }
    HAARLIGHT_ASSERT(entries.size() == exits.size());
    for (std::size_t i = 0; i < entries.size(); ++i) {
      add_stretch(piece, pixel, entries[i], exits[i]);
    }
  }

  void find_passages(std::uint32_t cell) {
    entries_.clear();
    exits_.clear();
    std::array<Corner, 8> corners;
    const std::span<const std::uint32_t> nodes = render::corners_of(view_.scene.mesh, cell);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      corners.at(i) = sides_.corner_of(nodes[i]);
    }
    for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
      const CellFace& face = view_.mesh.faces[i];
      PassedFace passed;
      for (std::size_t k = 0; k < 3; ++k) {
        passed.corners.at(k) = corners.at(face.corners.at(k));
      }
      if (sides_.has_all_on_its_left(passed)) {
        add_passage(exits_, passed, Passing::latest, Passing::earliest);
        continue;
      }
      std::swap(passed.corners[0], passed.corners[1]);
      if (sides_.has_all_on_its_left(passed)) {
        add_passage(entries_, passed, Passing::earliest, Passing::latest);
      }
    }
  }

  /// A ray within a face, to rounding, may be in the cells on both sides of it all along. What is drawn
  /// first takes all, and the other what is left.
  static void add_passage(Passages& passages, const PassedFace& face, Passing passing,
                          Passing surely) {
    Passage& passage = passages.add();
    passage.face = face;
    passage.at = face.crossing(passing);
    passage.surely = face.crossing(surely).z;
  }

  /// What of a piece's cell is within its cuts, along the ray, in z.
  [[nodiscard]] std::array<double, 2> within_cuts(const OrderedPiece& piece) const {
    std::array<double, 2> range = {-kInfinity, kInfinity};
    const Vector3d origin = view_.point_at(sides_.p(), 0.0);
    const Vector3d along = view_.point_at(sides_.p(), 1.0) - origin;
    for (const HalfSpace& cut : std::span(order_.cuts).subspan(piece.first_cut, piece.n_cuts)) {
      // The opposite cut has the same z to the last bit.
      const double slope = cut.normal.dot(along);
      const double rest = cut.offset - cut.normal.dot(origin);
      if (slope > 0.0) {
        range[1] = std::min(range[1], rest / slope);
      } else if (slope < 0.0) {
        range[0] = std::max(range[0], rest / slope);
      } else if (rest < 0.0 || (rest == 0.0 && cut.normal.x() + cut.normal.y() < 0.0)) {
        range[1] = -kInfinity;
      }
    }
    return range;
  }

  void add_stretch(const OrderedPiece& piece, std::uint32_t pixel, const Passage& entry,
                   const Passage& exit) {
    const std::array<double, 2> within = within_cuts(piece);
    const double begin = std::max(entry.at.z, within[0]);
    const double end = std::min(exit.at.z, within[1]);
    if (!(end > begin)) {
      return;  // nothing but rounding
    }
    ++counts_.stretches;
    Passed& passed = pixels_[pixel];
    // What is behind the eye has no order.
    const double surely_begin = std::max({entry.surely, within[0], view_.near});
    const double surely_end = std::min(exit.surely, within[1]);
    const bool is_violation =
        std::min(passed.surely, surely_end) - surely_begin > kOverlap * view_.size;
    if (is_violation) {
      note_violation(piece.cell, passed.last_cell, pixel);
    }
    ContourTracker& contours = contours_.size() == 1 ? contours_[0] : contours_[pixel];
    const bool begins_cut = begin > entry.at.z;
    const bool ends_cut = end < exit.at.z;
    if (begin > passed.until || begins_cut || passed.was_cut || is_violation) {
      contours.begin();
    }
    light_.begin_ray(sides_.p(), pixel, contours, passed.hidden);
    // What has been gathered already in other cells, by rounding; not in those that are wrongly ordered.
    light_.limit(is_violation ? within[0] : std::max(within[0], passed.until),
                 std::min(within[1], far_));
    const std::uint64_t n_known = light_.n_lost_points() + light_.n_unresolved();
    light_.add_general(piece.cell, {entry.face, Passing::earliest},
                       {exit.face, Passing::latest}, entry.at, exit.at);
    if (light_.n_lost_points() + light_.n_unresolved() > n_known) {
      passed.flags |= PixelFlag::kUnresolved;
    }
    passed.until = std::max(passed.until, end);
    if (surely_end > passed.surely) {
      passed.surely = surely_end;
      passed.last_cell = piece.cell;
    }
    passed.was_cut = ends_cut;
  }

  void note_violation(std::uint32_t cell, std::uint32_t before, std::uint32_t pixel) {
    ++counts_.violations;
    if (violation_.empty()) {
      violation_ = fmt::format(
          "cell {} is nearer than cell {}, which was drawn before it, in pixel ({}, {})",
          view_.cell_name(cell), view_.cell_name(before),
          area_.x0 + static_cast<int>(pixel) % area_.width(),
          area_.y0 + static_cast<int>(pixel) / area_.width());
    }
  }

  const VolumeView& view_;
  const VisibilityOrder& order_;
  Tile area_;
  RaySides sides_;
  CellLight light_;
  std::vector<ContourTracker> contours_;
  std::vector<Passed> pixels_;
  double far_ = kInfinity;  ///< of the surface behind the medium
  Passages entries_;
  Passages exits_;
  ProjectionCounts counts_;
  std::string violation_;
};

CellProjection::CellProjection(const VolumeScene& scene, SmallCells small_cells) {
  require_straight(scene.mesh, scene.mesh_file.string());
  require_sizes(scene);
  const auto begin = std::chrono::steady_clock::now();
  view_ = std::make_unique<VolumeView>(scene, FaceForm::general);
  order_ = visibility_order(*view_);
  leave_out_transparent();
  if (small_cells == SmallCells::splatted) {
    find_splats();
  }
  sort_into_tiles();
  prepare_seconds_ =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

CellProjection::CellProjection(const VolumeScene& scene, VisibilityOrder order)
    : view_(std::make_unique<VolumeView>(scene, FaceForm::general)), order_(std::move(order)) {
  require_straight(scene.mesh, scene.mesh_file.string());
  require_sizes(scene);
  sort_into_tiles();
}

CellProjection::~CellProjection() = default;

void CellProjection::leave_out_transparent() {
  const VolumeScene& scene = view_->scene;
  n_transparent_ = std::erase_if(order_.back_to_front, [&scene](const OrderedPiece& piece) {
    return is_transparent(scene, piece.cell);
  });
}

void CellProjection::find_splats() {
  const std::vector<OrderedPiece>& pieces = order_.back_to_front;
  splat_of_piece_.assign(pieces.size(), kNoSplat);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    if (pieces[i].n_cuts > 0) {
      continue;  // of a ring: drawn as it is
    }
    if (const std::optional<CellSplat> splat = splat_of(*view_, pieces[i].cell)) {
      splat_of_piece_[i] = static_cast<std::uint32_t>(splats_.size());
      splats_.push_back(*splat);
    }
  }
}

/// Across and down, those of the film that a piece may be seen in.
std::array<PixelRange, 2> CellProjection::pixels_of(std::uint32_t number) const {
  const CameraModel& camera = view_->scene.camera;
  if (!splat_of_piece_.empty() && splat_of_piece_[number] != kNoSplat) {
    const auto [x, y] = splats_[splat_of_piece_[number]].first_pixel();
    const auto on_film = [](int first, int end) {
      return PixelRange{.first = std::clamp(first, 0, end),
                        .end = std::clamp(first + 3, 0, end)};
    };
    return {on_film(x, camera.width), on_film(y, camera.height)};
  }
  const VolumeView::SeenBox box =
      view_->box_of(render::corners_of(view_->scene.mesh, order_.back_to_front[number].cell));
  return {pixels_within(box.low.x(), box.high.x(), 0, camera.width),
          pixels_within(box.low.y(), box.high.y(), 0, camera.height)};
}

void CellProjection::sort_into_tiles() {
  pieces_of_tiles_.resize(view_->faces_of_tiles.size());
  for (std::size_t i = order_.back_to_front.size(); i-- > 0;) {
    const auto [across, down] = pixels_of(static_cast<std::uint32_t>(i));
    if (across.first >= across.end || down.first >= down.end) {
      continue;  // between the pixels' centres
    }
    for (int y = down.first / Film::kTile; y * Film::kTile < down.end; ++y) {
      for (int x = across.first / Film::kTile; x * Film::kTile < across.end; ++x) {
        pieces_of_tiles_[number_of_tile(x, y)].push_back(static_cast<std::uint32_t>(i));
      }
    }
  }
}

std::size_t CellProjection::number_of_tile(int x, int y) const {
  return static_cast<std::size_t>(y) * static_cast<std::size_t>(view_->tiles_across) +
         static_cast<std::size_t>(x);
}

std::size_t CellProjection::n_tiles() const {
  return static_cast<std::size_t>(std::ranges::count_if(
      pieces_of_tiles_, [](const auto& pieces) { return !pieces.empty(); }));
}

std::uint64_t CellProjection::bytes_needed(const VolumeScene& scene, SmallCells small_cells) {
  const std::uint64_t n = scene.mesh.n_cells();
  std::uint64_t n_faces = 0;
  for (const CellType type : scene.mesh.types) {
    for (const std::array<std::uint8_t, 4>& face : shape_of(type).faces) {
      n_faces += face[3] == kNone ? 1 : 2;
    }
  }
  // The faces, whatever their cells; relations; numbers in lists of tiles, of small cells in one or two.
  constexpr std::uint64_t kPerCell = 64;
  const std::uint64_t of_splat =
      small_cells == SmallCells::splatted ? sizeof(CellSplat) + sizeof(std::uint32_t) : 0;
  return VolumeRayCaster::bytes_needed(scene) + n_faces * (sizeof(CellFace) + 4) +
         n * (sizeof(OrderedPiece) + kPerCell + of_splat);
}

std::uint64_t CellProjection::render_tile(SampleRange samples, FilmTile& tile) const {
  HAARLIGHT_EXPECTS(samples.first == 0 && samples.end == 1, "one sample per pixel");
  const Tile& area = tile.area();
  TilePicture picture(*view_, order_, area);
  for (const std::uint32_t piece :
       pieces_of_tiles_[number_of_tile(area.x0 / Film::kTile, area.y0 / Film::kTile)]) {
    if (!splat_of_piece_.empty() && splat_of_piece_[piece] != kNoSplat) {
      picture.add(splats_[splat_of_piece_[piece]]);
    } else {
      picture.add(piece);
    }
  }
  picture.add_to(tile);
  const ProjectionCounts& counts = picture.counts();
  const std::scoped_lock lock(mutex_);
  counts_.stretches += counts.stretches;
  counts_.segments += counts.segments;
  counts_.exact_sides += counts.exact_sides;
  counts_.lost_points += counts.lost_points;
  counts_.unresolved += counts.unresolved;
  counts_.violations += counts.violations;
  if (!picture.violation().empty() &&
      (violation_.empty() || picture.violation() < violation_)) {
    violation_ = picture.violation();
  }
  return counts.stretches;
}

ProjectionCounts CellProjection::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

std::string CellProjection::violation() const {
  const std::scoped_lock lock(mutex_);
  return violation_;
}

}  // namespace haarlight::render
