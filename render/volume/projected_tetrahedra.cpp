// SPDX-License-Identifier: Apache-2.0
#include "render/volume/projected_tetrahedra.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <limits>
#include <utility>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/volume/tetrahedron_clipping.h"
#include "render/volume/tetrahedron_fan.h"
#include "render/volume/visibility_order.h"
#include "render/volume/volume_ray_caster.h"
#include "render/volume/volume_view.h"

namespace haarlight::render {

using Eigen::Array3d;
using Eigen::Vector3d;

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kGrain = 4096;
/// Of the mesh's largest coordinate in the camera's frame: nearer to an eye within the mesh nothing is
/// drawn.
constexpr double kNearest = 1e-4;
/// What is farther at one end than this many times the other is cut: a depth is taken to run linearly
/// over the picture.
constexpr double kSpread = 1.25;
/// Pixels by which all is moved: more than rounding, so that of cells that were cut apart no two both have
/// a pixel whose centre is on their border, or neither. To the side, and much less across it, as
/// side_of_ray.h moves rays: of a mesh's two opposite borders the same one is seen.
constexpr std::array<double, 2> kAside = {-1.3e-7, -1.3e-9};
/// How many tetrahedra are drawn between two looks at whether a tile is opaque.
constexpr std::size_t kBetweenLooks = 512;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

std::size_t index_of(const ScalarField& field, std::uint32_t node, std::uint32_t cell) {
  return field.is_per_cell ? cell : node;
}

/// Stable, by 32 bits of a number each.
void sort_by_bits(std::vector<std::pair<std::uint32_t, std::uint32_t>>& items) {
  constexpr unsigned kBits = 11;
  constexpr std::size_t kBuckets = std::size_t{1} << kBits;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> others(items.size());
  for (unsigned shift = 0; shift < 32; shift += kBits) {
    std::vector<std::size_t> places(kBuckets + 1);
    for (const auto& item : items) {
      ++places[((item.first >> shift) & (kBuckets - 1)) + 1];
    }
    for (std::size_t i = 1; i <= kBuckets; ++i) {
      places[i] += places[i - 1];
    }
    for (const auto& item : items) {
      others[places[(item.first >> shift) & (kBuckets - 1)]++] = item;
    }
    items.swap(others);
  }
}

}  // namespace

PreviewMesh::PreviewMesh(const VolumeScene& the_scene) : scene(the_scene) {
  HAARLIGHT_EXPECTS(scene.contours.empty() && !scene.surfaces,
                    "no contours and surfaces: previews do not draw them");
  require_sizes(scene);
  const Clock::time_point begin = Clock::now();
  tetrahedra = cut_into_tetrahedra(scene.mesh);
  extinction.resize(scene.density_field.values.size());
  parallel_for(extinction.size(), kGrain, [this](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) {
      extinction[i] = bounded_float(scene.density.at(scene.density_field.values[i]));
    }
  });
  colour.resize(scene.colour_field.values.size());
  parallel_for(colour.size(), kGrain, [this](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) {
      const Array3d of = scene.colour.at(scene.colour_field.values[i]);
      colour[i] = {bounded_float(of[0]), bounded_float(of[1]), bounded_float(of[2])};
    }
  });
  prepare_seconds = seconds_since(begin);
}

ProjectedTetrahedra::ProjectedTetrahedra(const PreviewMesh& mesh, const PreviewOptions& options)
    : mesh_(mesh),
      options_(options),
      is_perspective_(mesh.scene.optics.pixel_mm == 0.0),
      near_(mesh.scene.optics.near_mm),
      far_(mesh.scene.optics.far_mm > 0.0 ? mesh.scene.optics.far_mm
                                          : std::numeric_limits<double>::infinity()),
      camera_from_world_(mesh.scene.camera.world_from_cam.inverse()) {
  const Clock::time_point begin = Clock::now();
  counts_.tetrahedra = mesh.tetrahedra.size();
  see_points();
  place_tetrahedra();
  sort_by_distance();
  if (options.order == PreviewOrder::exact) {
    sort_by_cells();
  }
  sort_into_tiles();
  view_seconds_ = seconds_since(begin);
}

ProjectedTetrahedra::~ProjectedTetrahedra() = default;

void ProjectedTetrahedra::see_points() {
  const std::vector<Vector3d>& points = mesh_.scene.mesh.points;
  points_.resize(points.size());
  parallel_for(points.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      points_[i] = camera_from_world_ * points[i];
    }
  });
  if (is_perspective_) {
    double size = 0.0;
    for (const Vector3d& point : points_) {
      size = std::max(size, point.cwiseAbs().maxCoeff());
    }
    near_ = std::max(near_, kNearest * size);
  }
  parallel_for(points.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      points_[i] = on_picture(points_[i]);
    }
  });
}

/// In pixels; z stays.
Vector3d ProjectedTetrahedra::on_picture(const Vector3d& camera) const {
  const CameraModel& model = mesh_.scene.camera;
  const double cx = model.cx - 0.5 + kAside[0];
  const double cy = model.cy - 0.5 + kAside[1];
  if (!is_perspective_) {
    const double pixel = mesh_.scene.optics.pixel_mm;
    return {camera.x() / pixel + cx, camera.y() / pixel + cy, camera.z()};
  }
  if (!(camera.z() >= near_)) {
    return {0.0, 0.0, camera.z()};
  }
  return {model.fx * camera.x() / camera.z() + cx, model.fy * camera.y() / camera.z() + cy,
          camera.z()};
}

ProjectedTetrahedra::Reach ProjectedTetrahedra::reach_of(
    const std::array<std::uint32_t, 4>& nodes) const {
  const auto [low, high] = std::minmax({points_[nodes[0]].z(), points_[nodes[1]].z(),
                                        points_[nodes[2]].z(), points_[nodes[3]].z()});
  if (high <= near_ || low >= far_) {
    return Reach::outside;
  }
  const bool is_wide = is_perspective_ && high > kSpread * low;
  return low < near_ || high > far_ || is_wide ? Reach::across : Reach::inside;
}

FanCorner ProjectedTetrahedra::corner_of(std::uint32_t node, std::uint32_t cell) const {
  const VolumeScene& scene = mesh_.scene;
  const std::size_t of_density = index_of(scene.density_field, node, cell);
  const std::size_t of_colour = index_of(scene.colour_field, node, cell);
  return {.x = points_[node].x(),
          .y = points_[node].y(),
          .z = points_[node].z(),
          .density_value = scene.density_field.values[of_density],
          .colour_value = scene.colour_field.values[of_colour],
          .extinction = mesh_.extinction[of_density],
          .colour = mesh_.colour[of_colour]};
}

std::array<FanCorner, 4> ProjectedTetrahedra::corners_of(std::uint32_t number) const {
  const std::size_t n = mesh_.tetrahedra.size();
  if (number >= n) {
    return clipped_[number - n];
  }
  const CellTetrahedron& tetrahedron = mesh_.tetrahedra[number];
  std::array<FanCorner, 4> corners;
  for (std::size_t i = 0; i < 4; ++i) {
    corners.at(i) = corner_of(tetrahedron.nodes.at(i), tetrahedron.cell);
  }
  return corners;
}

std::uint32_t ProjectedTetrahedra::cell_of(std::uint32_t number) const {
  const std::size_t n = mesh_.tetrahedra.size();
  return number < n ? mesh_.tetrahedra[number].cell : clipped_cells_[number - n];
}

/// The tiles of the pixels whose centres are in its box, and how far it is.
ProjectedTetrahedra::Placed ProjectedTetrahedra::place(
    const std::array<Vector3d, 4>& corners) const {
  const auto& [a, b, c, d] = corners;
  const CameraModel& camera = mesh_.scene.camera;
  const Vector3d low = a.cwiseMin(b).cwiseMin(c).cwiseMin(d);
  const Vector3d high = a.cwiseMax(b).cwiseMax(c).cwiseMax(d);
  const PixelRange across = pixels_within(low.x(), high.x(), 0, camera.width);
  const PixelRange down = pixels_within(low.y(), high.y(), 0, camera.height);
  if (across.first >= across.end || down.first >= down.end) {
    return {};
  }
  Placed placed;
  constexpr int kTile = Film::kTile;
  placed.first = {static_cast<std::uint16_t>(across.first / kTile),
                  static_cast<std::uint16_t>(down.first / kTile)};
  placed.end = {static_cast<std::uint16_t>((across.end - 1) / kTile + 1),
                static_cast<std::uint16_t>((down.end - 1) / kTile + 1)};
  double distance = a.z() + b.z() + c.z() + d.z();
  if (is_perspective_) {
    // Of the centroid, from where it is on the picture: what is nearer along rays, not along the axis.
    Vector3d sum = Vector3d::Zero();
    for (const Vector3d& corner : corners) {
      sum += corner.z() * Vector3d((corner.x() + 0.5 - camera.cx) / camera.fx,
                                   (corner.y() + 0.5 - camera.cy) / camera.fy, 1.0);
    }
    distance = sum.norm();
  }
  placed.distance = bounded_float(distance);
  return placed;
}

void ProjectedTetrahedra::place_tetrahedra() {
  const std::vector<CellTetrahedron>& tetrahedra = mesh_.tetrahedra;
  placed_.resize(tetrahedra.size());
  std::vector<char> is_across(tetrahedra.size());
  parallel_for(tetrahedra.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::array<std::uint32_t, 4>& nodes = tetrahedra[i].nodes;
      const Reach reach = reach_of(nodes);
      is_across[i] = reach == Reach::across ? 1 : 0;
      if (reach == Reach::inside) {
        placed_[i] =
            place({points_[nodes[0]], points_[nodes[1]], points_[nodes[2]], points_[nodes[3]]});
      }
    }
  });
  for (std::uint32_t i = 0; i < is_across.size(); ++i) {
    if (is_across[i] != 0) {
      ++counts_.clipped;
      clip_tetrahedron(i);
    }
  }
}

/// Between the clipping planes, and in perspective from each plane to that twice as far: the same planes
/// for all, so that neighbours are cut alike.
void ProjectedTetrahedra::clip_tetrahedron(std::uint32_t number) {
  const CellTetrahedron& whole = mesh_.tetrahedra[number];
  ClipTetrahedron tetrahedron;
  double nearest = far_;
  double farthest = near_;
  for (std::size_t i = 0; i < 4; ++i) {
    const FanCorner corner = corner_of(whole.nodes.at(i), whole.cell);
    tetrahedron.at(i) = {
        .camera = camera_from_world_ * mesh_.scene.mesh.points[whole.nodes.at(i)],
        .density_value = corner.density_value,
        .colour_value = corner.colour_value,
        .extinction = static_cast<double>(corner.extinction),
        .colour = corner.colour.cast<double>()};
    nearest = std::min(nearest, corner.z);
    farthest = std::max(farthest, corner.z);
  }
  nearest = std::max(nearest, near_);
  farthest = std::min(farthest, far_);
  double low = near_;
  while (is_perspective_ && kSpread * low <= nearest) {
    low *= kSpread;
  }
  while (low < farthest) {
    const double high = is_perspective_ ? std::min(kSpread * low, far_) : far_;
    for (const ClipTetrahedron& part : clip(tetrahedron, low, high)) {
      std::array<FanCorner, 4> corners;
      std::array<Vector3d, 4> places;
      for (std::size_t i = 0; i < 4; ++i) {
        const ClipCorner& corner = part.at(i);
        const Vector3d at = places.at(i) = on_picture(corner.camera);
        corners.at(i) = {.x = at.x(),
                         .y = at.y(),
                         .z = at.z(),
                         .density_value = corner.density_value,
                         .colour_value = corner.colour_value,
                         .extinction = static_cast<float>(corner.extinction),
                         .colour = corner.colour.cast<float>()};
      }
      placed_.push_back(place(places));
      clipped_.push_back(corners);
      clipped_cells_.push_back(whole.cell);
    }
    low = high;
  }
}

void ProjectedTetrahedra::sort_by_distance() {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> items;
  items.reserve(placed_.size());
  for (std::uint32_t i = 0; i < placed_.size(); ++i) {
    if (placed_[i].first[0] < placed_[i].end[0]) {
      // As whole numbers in the order of the floats.
      const auto bits = std::bit_cast<std::uint32_t>(placed_[i].distance);
      constexpr std::uint32_t kSign = 0x80000000U;
      items.emplace_back((bits & kSign) != 0 ? ~bits : bits | kSign, i);
    }
  }
  counts_.drawn = items.size();
  sort_by_bits(items);
  order_.reserve(items.size());
  for (const auto& item : items) {
    order_.push_back(item.second);
  }
}

/// Those of a cell are together then, and stay in the order of their distances.
void ProjectedTetrahedra::sort_by_cells() {
  const VolumeView view(mesh_.scene, FaceForm::general);
  const VisibilityOrder exact = visibility_order(view);
  constexpr std::uint32_t kNoRank = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> ranks(mesh_.scene.mesh.n_cells(), kNoRank);
  std::uint32_t n = 0;
  for (std::size_t i = exact.back_to_front.size(); i-- > 0;) {
    std::uint32_t& rank = ranks[exact.back_to_front[i].cell];
    rank = rank == kNoRank ? n++ : rank;
  }
  for (const CyclicCells& cyclic : exact.cyclic) {
    counts_.split_cells += cyclic.cells.size();
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> items;
  items.reserve(order_.size());
  for (const std::uint32_t number : order_) {
    items.emplace_back(ranks[cell_of(number)], number);
  }
  sort_by_bits(items);
  for (std::size_t i = 0; i < items.size(); ++i) {
    order_[i] = items[i].second;
  }
}

void ProjectedTetrahedra::sort_into_tiles() {
  const CameraModel& camera = mesh_.scene.camera;
  tiles_across_ = (camera.width + Film::kTile - 1) / Film::kTile;
  const int tiles_down = (camera.height + Film::kTile - 1) / Film::kTile;
  tile_begins_.assign(
      static_cast<std::size_t>(tiles_across_) * static_cast<std::size_t>(tiles_down) + 1, 0);
  const auto for_each_tile = [this](const auto& visit) {
    for (const std::uint32_t number : order_) {
      const Placed& placed = placed_[number];
      for (std::size_t y = placed.first[1]; y < placed.end[1]; ++y) {
        for (std::size_t x = placed.first[0]; x < placed.end[0]; ++x) {
          visit(y * static_cast<std::size_t>(tiles_across_) + x, number);
        }
      }
    }
  };
  for_each_tile([this](std::size_t tile, std::uint32_t) { ++tile_begins_[tile + 1]; });
  for (std::size_t i = 1; i < tile_begins_.size(); ++i) {
    tile_begins_[i] += tile_begins_[i - 1];
  }
  of_tiles_.resize(tile_begins_.back());
  std::vector<std::size_t> places(tile_begins_.begin(), tile_begins_.end() - 1);
  for_each_tile(
      [&](std::size_t tile, std::uint32_t number) { of_tiles_[places[tile]++] = number; });
}

std::uint64_t ProjectedTetrahedra::bytes_needed(const VolumeScene& scene, PreviewOrder order) {
  std::uint64_t n_tetrahedra = 0;
  for (const CellType type : scene.mesh.types) {
    constexpr std::uint64_t kMost = 8;  // of a quadratic tetrahedron
    n_tetrahedra += type == CellType::tetrahedron ? 1 : kMost;
  }
  // Sorted twice over, and in one or two tiles each.
  const std::uint64_t of_tetrahedra =
      n_tetrahedra * (sizeof(CellTetrahedron) + sizeof(Placed) + 32);
  const std::uint64_t of_points =
      scene.mesh.points.size() * (sizeof(Vector3d) + sizeof(float) + sizeof(Eigen::Array3f));
  return VolumeRayCaster::bytes_needed(scene) * (order == PreviewOrder::exact ? 2 : 1) +
         of_tetrahedra + of_points;
}

std::uint64_t ProjectedTetrahedra::render_tile(SampleRange samples, FilmTile& tile) const {
  HAARLIGHT_EXPECTS(samples.first == 0 && samples.end == 1, "one sample per pixel");
  const Tile& area = tile.area();
  const std::size_t i_tile = static_cast<std::size_t>(area.y0 / Film::kTile) *
                                 static_cast<std::size_t>(tiles_across_) +
                             static_cast<std::size_t>(area.x0 / Film::kTile);
  const std::span<const std::uint32_t> numbers = std::span(of_tiles_).subspan(
      tile_begins_[i_tile], tile_begins_[i_tile + 1] - tile_begins_[i_tile]);
  FanTile picture(mesh_.scene, options_.method, area);
  std::size_t n = 0;
  for (const std::uint32_t number : numbers) {
    if (n > 0 && n % kBetweenLooks == 0 && picture.is_opaque()) {
      break;
    }
    picture.add(corners_of(number));
    ++n;
  }
  picture.add_to(tile);
  return n;
}

}  // namespace haarlight::render
