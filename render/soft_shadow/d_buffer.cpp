// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/d_buffer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/counted.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/soft_shadow/extrusion.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector4d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Of a length: what rounding may leave outside of a volume's side.
constexpr double kOnSide = 1e-12;

/// Of t: no tilted edge, but rounding.
constexpr double kRoundedT = 1e-9;

/// Surfaces on one ray. Where there are more, what is behind them is left out.
constexpr int kMostCrossings = 64;

constexpr std::size_t kTexelsTogether = 1024;

std::string point_words(const Vector3d& p) {
  return fmt::format("({:.6g}, {:.6g}, {:.6g})", p.x(), p.y(), p.z());
}

double distance_to_plane(const Vector3d& plane, const Vector3d& direction) {
  const double slope = plane.dot(direction);
  return slope > 0.0 ? 1.0 / slope : kInfinity;
}

/// Whether a point of the plane through `rim` and an edge lies beyond the edge, seen from there.
bool is_beyond(const Vector3d& point, const Vector2d& rim, const Vector3d& v1,
               const Vector3d& v2) {
  const Vector3d p(rim.x(), rim.y(), 0.0);
  const Vector3d a = v1 - p;
  const Vector3d b = v2 - p;
  const Vector3d normal = a.cross(b);
  const double scale = normal.squaredNorm();
  const double alpha = (point - p).cross(b).dot(normal) / scale;
  const double beta = a.cross(point - p).dot(normal) / scale;
  return alpha >= -kOnSide && beta >= -kOnSide && alpha + beta >= 1.0 - kOnSide;
}

}  // namespace

DBuffer::DBuffer(const Scene& scene, const OccluderEdges& edges, const FlatLight& light,
                 std::span<const Vector3d> vertices, std::span<const Vector4d> planes,
                 const DBufferOptions& options, const std::string& where)
    : scene_(scene),
      edges_(edges),
      light_(light),
      options_(options),
      vertices_(vertices),
      planes_(planes) {
  HAARLIGHT_EXPECTS(light.is_disk(), "a D-buffer is a disk light's");
  HAARLIGHT_EXPECTS(options.texels > 0, "a D-buffer has texels");
  const std::size_t n_disks =
      scene.disks.size() -
      (light.surface >= static_cast<int>(scene.meshes.size() + scene.spheres.size()) ? 1 : 0);
  if (!scene.spheres.empty() || n_disks > 0) {
    throw Error(fmt::format("a D-buffer is made of triangles' edges; the scene has {} and {} "
                            "besides the light",
                            counted(scene.spheres.size(), "sphere"), counted(n_disks, "disk")),
                where, "use --method exact, or give meshes instead");
  }
  for (const Mesh& mesh : scene.meshes) {
    faces_of_.emplace_back(mesh.triangles.size(), kNone);
  }
  for (std::uint32_t f = 0; f < edges.faces.size(); ++f) {
    const OccluderFace& face = edges.faces[f];
    faces_of_[face.mesh][face.triangle] = f;
  }
  set_pieces();
  set_edges(where);
}

/// Pieces are what edges connect.
void DBuffer::set_pieces() {
  pieces_.resize(vertices_.size());
  std::iota(pieces_.begin(), pieces_.end(), 0U);
  const auto root = [this](std::uint32_t v) {
    while (pieces_[v] != v) {
      pieces_[v] = pieces_[pieces_[v]];
      v = pieces_[v];
    }
    return v;
  };
  for (const OccluderEdge& edge : edges_.edges) {
    const std::uint32_t a = root(edge.from);
    const std::uint32_t b = root(edge.to);
    pieces_[std::max(a, b)] = std::min(a, b);
  }
  for (std::uint32_t v = 0; v < pieces_.size(); ++v) {
    pieces_[v] = root(v);
  }
}

void DBuffer::set_edges(const std::string& where) {
  around_.resize(vertices_.size());
  std::vector<std::pair<std::uint32_t, std::int8_t>> sides;
  for (std::size_t i = 0; i < edges_.edges.size();) {
    const OccluderEdge& edge = edges_.edges[i];
    sides.clear();
    for (; i < edges_.edges.size() && edges_.edges[i].from == edge.from &&
           edges_.edges[i].to == edge.to;
         ++i) {
      for (std::size_t f = 0; f < 2; ++f) {
        if (edges_.edges[i].ways.at(f) != 0) {
          sides.emplace_back(edges_.edges[i].faces.at(f), edges_.edges[i].ways.at(f));
        }
      }
    }
    // Meshes that only touch are pieces of their own.
    std::ranges::stable_sort(
        sides, {}, [this](const auto& side) { return edges_.faces[side.first].mesh; });
    for (std::size_t first = 0; first < sides.size();) {
      const std::uint32_t mesh = edges_.faces[sides[first].first].mesh;
      std::size_t end = first;
      std::vector<std::uint32_t> faces;
      for (; end < sides.size() && edges_.faces[sides[end].first].mesh == mesh; ++end) {
        faces.push_back(sides[end].first);
      }
      if (faces.size() > 2 ||
          (faces.size() == 2 && sides[first].second == sides[first + 1].second)) {
        const std::string& name = scene_.meshes[mesh].name;
        throw Error(
            fmt::format("mesh {}{}: the edge from {} to {} has {}", mesh,
                        name.empty() ? "" : fmt::format(" ({})", name),
                        point_words(edges_.vertices[edge.from]),
                        point_words(edges_.vertices[edge.to]),
                        faces.size() > 2 ? fmt::format("{} triangles", faces.size())
                                         : "two triangles that run the same way along it"),
            where, "a D-buffer needs two-manifolds: mend the mesh, or use --method exact");
      }
      if (static_cast<int>(mesh) != light_.surface) {
        add_edge(edge, faces);
      }
      first = end;
    }
  }
}

void DBuffer::add_edge(const OccluderEdge& edge, std::span<const std::uint32_t> faces) {
  const auto class_of = [this](std::uint32_t face) {
    return face_class(planes_[face].head<3>(), vertices_[edges_.faces[face].corners[0]], 1.0);
  };
  const FaceClass first = class_of(faces[0]);
  const FaceClass second = faces.size() > 1 ? class_of(faces[1]) : first;
  // A sheet's border is seen from both sides.
  const bool is_open = faces.size() == 1;
  const bool is_umbra = is_open || is_umbra_edge(first, second);
  const bool is_penumbra = is_open || is_penumbra_edge(first, second);
  if (!is_umbra && !is_penumbra) {
    return;
  }
  VolumeEdge volume{.v1 = vertices_[edge.from],
                    .v2 = vertices_[edge.to],
                    .piece = pieces_[edge.from],
                    .vertices = {edge.from, edge.to},
                    .faces = {faces[0], is_open ? kNone : faces[1]}};
  if (std::max(volume.v1.z(), volume.v2.z()) < kNearestZ) {
    return;
  }
  for (std::size_t end = 0; end < 2; ++end) {
    Vector3d& v = end == 0 ? volume.v1 : volume.v2;
    const Vector3d& other = end == 0 ? volume.v2 : volume.v1;
    if (v.z() < kNearestZ) {
      v += ((kNearestZ - v.z()) / (other.z() - v.z())) * (other - v);
      v.z() = kNearestZ;
      volume.vertices.at(end) = kNone;
    }
  }
  const auto opposite = [&](std::uint32_t face) {
    for (const std::uint32_t corner : edges_.faces[face].corners) {
      if (corner != edge.from && corner != edge.to) {
        return vertices_[corner];
      }
    }
    return vertices_[edge.from];
  };
  const auto extrude = [&](bool is_wanted, FaceClass wanted, bool of_umbra) {
    if (!is_wanted) {
      return;
    }
    const std::uint32_t face = first == wanted || is_open ? faces[0] : faces[1];
    const auto points = extrusion_points(volume.v1, volume.v2, opposite(face), 1.0);
    if (!points) {
      ++counts_.n_without_extrusion;
      return;
    }
    const Vector3d& edge_point = volume.v1.z() > volume.v2.z() ? volume.v1 : volume.v2;
    (of_umbra ? volume.umbra_rim : volume.penumbra_rim) =
        of_umbra ? points->umbra : points->penumbra;
    (of_umbra ? volume.umbra : volume.penumbra) =
        touching_plane(of_umbra ? points->umbra : points->penumbra, edge_point);
    ++(of_umbra ? counts_.n_umbra_edges : counts_.n_penumbra_edges);
  };
  extrude(is_umbra, FaceClass::none_front_facing, true);
  extrude(is_penumbra, FaceClass::all_front_facing, false);
  if (volume.penumbra) {
    around_[edge.from].push_back(edge.to);
    around_[edge.to].push_back(edge.from);
  }
  if (volume.umbra || volume.penumbra) {
    silhouette_.push_back(volume);
  }
}

void DBuffer::draw(const RayCaster& caster, std::span<const Vector3d> receivers) {
  grid_.emplace(receivers, options_.texels);
  for (const VolumeEdge& edge : silhouette_) {
    grid_->count_edge(edge.v1, edge.v2);
  }
  grid_->start_lists();
  for (std::uint32_t i = 0; i < silhouette_.size(); ++i) {
    grid_->list_edge(i, silhouette_[i].v1, silhouette_[i].v2);
  }
  const std::size_t n = grid_->n_cells();
  texels_.assign(n, {});
  const std::size_t n_chunks = (n + kTexelsTogether - 1) / kTexelsTogether;
  std::vector<std::vector<Entered>> entered(n_chunks);
  std::vector<std::int64_t> n_rays(n_chunks);
  parallel_for(n, kTexelsTogether, [&](std::size_t first, std::size_t last) {
    const std::size_t chunk = first / kTexelsTogether;
    std::vector<Crossing> crossed;
    for (std::size_t i = first; i < last; ++i) {
      const Vector3d direction = grid_->direction(i);
      n_rays[chunk] += find_crossings(caster, direction, crossed);
      texels_[i].first = static_cast<std::uint32_t>(entered[chunk].size());
      fill(texels_[i], entered[chunk], crossed, grid_->cell(i), direction);
      texels_[i].n = static_cast<std::uint32_t>(entered[chunk].size()) - texels_[i].first;
    }
  });
  entered_.clear();
  for (std::size_t chunk = 0; chunk < n_chunks; ++chunk) {
    const auto begin = static_cast<std::uint32_t>(entered_.size());
    const std::size_t first = chunk * kTexelsTogether;
    for (std::size_t i = first; i < std::min(n, first + kTexelsTogether); ++i) {
      texels_[i].first += begin;
    }
    entered_.insert(entered_.end(), entered[chunk].begin(), entered[chunk].end());
    counts_.n_rays += n_rays[chunk];
  }
}

/// All surfaces on the ray from the centre, but the light's own. @return rays
int DBuffer::find_crossings(const RayCaster& caster, const Vector3d& direction,
                            std::vector<Crossing>& crossed) const {
  crossed.clear();
  const double step_mm = caster.ray_offset_mm();
  Ray ray{.origin = light_.centre,
          .direction = light_.light_from_world.transpose() * direction,
          .t_min = step_mm};
  for (int n = 1;; ++n) {
    const RawHit hit = caster.intersect(ray);
    if (!hit.is_hit() || n == kMostCrossings) {
      return n;
    }
    if (static_cast<int>(hit.mesh) != light_.surface) {
      const std::uint32_t face = faces_of_[hit.mesh][hit.triangle];
      if (face != kNone) {
        crossed.push_back({.face = face, .distance = hit.t / light_.radius_mm});
      }
    }
    ray.t_min = hit.t + step_mm;
  }
}

void DBuffer::fill(Texel& texel, std::vector<Entered>& entered,
                   std::span<const Crossing> crossed, const ShadowGrid::Cell& cell,
                   const Vector3d& direction) const {
  texel.penumbra = penumbra_at(cell, direction);
  if (options_.test == VolumeTest::farthest) {
    if (!crossed.empty()) {
      entered.push_back(
          {.face = crossed[0].face, .umbra = farthest_umbra(crossed, cell, direction)});
    }
    return;
  }
  const std::size_t first = entered.size();
  for (const Crossing& crossing : crossed) {
    const std::uint32_t piece = pieces_[edges_.faces[crossing.face].corners[0]];
    const bool is_known =
        std::any_of(entered.begin() + static_cast<std::ptrdiff_t>(first), entered.end(),
                    [&](const Entered& other) {
                      return pieces_[edges_.faces[other.face].corners[0]] == piece;
                    });
    if (is_known) {
      continue;
    }
    Winner least{.distance = kInfinity};
    for (const std::uint32_t number : cell.edges) {
      const VolumeEdge& edge = silhouette_[number];
      if (edge.umbra && edge.piece == piece) {
        const double distance = distance_to_plane(*edge.umbra, direction);
        if (distance < least.distance) {
          least.edge = number;
          least.distance = distance;
        }
      }
    }
    entered.push_back({.face = crossing.face, .umbra = least});
  }
}

/// The farthest side of an umbra, or a silhouette face, which the paper draws with them: else there
/// are gaps between the two volumes (figure 6).
DBuffer::Winner DBuffer::farthest_umbra(std::span<const Crossing> crossed,
                                        const ShadowGrid::Cell& cell,
                                        const Vector3d& direction) const {
  Winner farthest;
  const auto take = [&farthest](std::uint32_t edge, double distance, double edge_distance) {
    if (distance > farthest.distance) {
      farthest = {.edge = edge, .distance = distance, .edge_distance = edge_distance};
    }
  };
  for (const std::uint32_t number : cell.edges) {
    const VolumeEdge& edge = silhouette_[number];
    if (!edge.umbra) {
      continue;
    }
    const double distance = distance_to_plane(*edge.umbra, direction);
    if (std::isfinite(distance) &&
        is_beyond(distance * direction, edge.umbra_rim, edge.v1, edge.v2)) {
      take(number, distance, paper_edge_distance(direction, edge.v1, edge.v2));
    }
  }
  for (const Crossing& crossing : crossed) {
    const Vector4d& plane = planes_[crossing.face];
    if (face_class(plane.head<3>(), vertices_[edges_.faces[crossing.face].corners[0]], 1.0) !=
        FaceClass::silhouette) {
      continue;
    }
    // Its nearest edge on a silhouette.
    Winner nearest{.distance = crossing.distance};
    for (const std::uint32_t number : cell.edges) {
      const VolumeEdge& edge = silhouette_[number];
      if (edge.faces[0] == crossing.face || edge.faces[1] == crossing.face) {
        const double x_s = paper_edge_distance(direction, edge.v1, edge.v2);
        if (nearest.edge == kNone || std::abs(x_s - crossing.distance) <
                                         std::abs(nearest.edge_distance - crossing.distance)) {
          nearest.edge = number;
          nearest.edge_distance = x_s;
        }
      }
    }
    if (nearest.edge != kNone) {
      take(nearest.edge, nearest.distance, nearest.edge_distance);
    }
  }
  return farthest;
}

/// Where the penumbra volume is entered: through an edge's side, or through the cone of a vertex.
DBuffer::Winner DBuffer::penumbra_at(const ShadowGrid::Cell& cell,
                                     const Vector3d& direction) const {
  Winner best;
  const auto take = [&](const Winner& other) {
    const bool is_better = options_.test == VolumeTest::farthest
                               ? other.distance > best.distance
                               : other.distance < best.distance;
    if (best.edge == kNone || is_better) {
      best = other;
    }
  };
  for (const std::uint32_t number : cell.edges) {
    const VolumeEdge& edge = silhouette_[number];
    if (!edge.penumbra) {
      continue;
    }
    const double distance = distance_to_plane(*edge.penumbra, direction);
    if (std::isfinite(distance) &&
        is_beyond(distance * direction, edge.penumbra_rim, edge.v1, edge.v2)) {
      take({.edge = number, .distance = distance});
    }
    for (const bool is_second : {false, true}) {
      if (const std::optional<double> cone = cone_distance(edge, is_second, direction)) {
        take({.edge = number, .is_cone = true, .is_second = is_second, .distance = *cone});
      }
    }
  }
  if (best.edge != kNone) {
    measure(best, false, direction);
  }
  return best;
}

/// The cone of v and the rim: lambda d = v + mu (v - p) with |p| = 1, p_z = 0. With k = d_z/v_z,
/// mu = lambda k - 1 and lambda (k v_xy - d_xy) = mu p, hence lambda = 1/(k - |k v_xy - d_xy|). It is
/// a side of the volume where the plane through v that touches the rim in p has the piece beyond it.
std::optional<double> DBuffer::cone_distance(const VolumeEdge& edge, bool is_second,
                                             const Vector3d& direction) const {
  const std::uint32_t vertex = edge.vertices.at(is_second ? 1 : 0);
  if (vertex == kNone) {
    return std::nullopt;
  }
  const Vector3d& v = is_second ? edge.v2 : edge.v1;
  const double k = direction.z() / v.z();
  const Vector2d across = k * v.head<2>() - direction.head<2>();
  const double reach = across.norm();
  if (!(k > reach) || reach == 0.0) {
    return std::nullopt;
  }
  const Vector3d plane = touching_plane(across / reach, v);
  for (const std::uint32_t other : around_[vertex]) {
    const Vector3d& w = vertices_[other];
    if (plane.dot(w - v) < -kOnSide * (w - v).norm()) {
      return std::nullopt;
    }
  }
  return 1.0 / (k - reach);
}

double DBuffer::plane_of_edge(const VolumeEdge& edge, const Vector3d& direction) const {
  return options_.test == VolumeTest::farthest
             ? paper_edge_distance(direction, edge.v1, edge.v2)
             : edge_plane_distance(direction, edge.v1, edge.v2);
}

void DBuffer::measure(Winner& winner, bool is_umbra, const Vector3d& direction) const {
  const VolumeEdge& edge = silhouette_[winner.edge];
  if (winner.is_cone) {
    const Vector3d& v = winner.is_second ? edge.v2 : edge.v1;
    // Another ray than the texel's may pass beside the cone: its distance then stays.
    winner.distance =
        cone_distance(edge, winner.is_second, direction).value_or(winner.distance);
    winner.edge_distance = v.z() / direction.z();
    return;
  }
  winner.distance = distance_to_plane(is_umbra ? *edge.umbra : *edge.penumbra, direction);
  winner.edge_distance = plane_of_edge(edge, direction);
}

DBuffer::Value DBuffer::value_of(double t, const Winner& winner) const {
  Value value{.is_assumed = true};
  value.is_clamped = !(t >= -kRoundedT && t <= 1.0 + kRoundedT);
  t = std::isnan(t) ? 0.5 : std::clamp(t, 0.0, 1.0);
  if (options_.test == VolumeTest::by_piece && !winner.is_cone) {
    const VolumeEdge& edge = silhouette_[winner.edge];
    const Vector3d a = point_in_disk_plane(edge.v1, edge.v2);
    t = t_of_tilted_edge(t, std::min(1.0, std::abs(a.z()) / a.head<2>().norm()));
  }
  value.visibility = disk_visibility(t, options_.form);
  return value;
}

DBuffer::Value DBuffer::at(const Vector3d& receiver) const {
  const std::size_t cell = grid_->cell_of(receiver);
  const Texel& texel = texels_[cell];
  // A texel's face hides what is behind it by more than a texel: not its neighbours on a round body.
  const double bias = grid_->side(cell) * receiver.z();
  const double x = receiver.norm();
  const Vector3d direction = receiver / x;
  const bool is_own_ray = options_.test == VolumeTest::by_piece;
  // The piece in the way whose umbra ends last.
  const Entered* hiding = nullptr;
  for (const Entered& entered : std::span(entered_).subspan(texel.first, texel.n)) {
    const Vector4d& plane = planes_[entered.face];
    const double beyond =
        -std::copysign(1.0, plane[3]) * (plane.head<3>().dot(receiver) + plane[3]);
    const bool is_beyond_plane = beyond > bias;
    if (is_beyond_plane &&
        (hiding == nullptr || entered.umbra.distance > hiding->umbra.distance)) {
      hiding = &entered;
    }
  }
  Winner winner = hiding != nullptr ? hiding->umbra : texel.penumbra;
  if (winner.edge == kNone) {
    return {.visibility = hiding != nullptr ? 0.0 : 1.0};
  }
  if (is_own_ray) {
    measure(winner, hiding != nullptr, direction);
  }
  if (x <= winner.distance) {
    return {.visibility = hiding != nullptr ? 0.0 : 1.0};
  }
  const double t = hiding != nullptr
                       ? t_from_umbra(x, winner.edge_distance, winner.distance)
                       : t_from_penumbra(x, winner.edge_distance, winner.distance);
  return value_of(t, winner);
}

}  // namespace haarlight::render
