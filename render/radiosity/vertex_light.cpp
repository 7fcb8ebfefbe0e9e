// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/vertex_light.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <tuple>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector2i;
using Eigen::Vector3d;
using Eigen::Vector3f;

/// How much irradiance changes over a part that is cut in four, and how far at least it is from what is
/// interpolated: of the part's brightest corner, but not of less than kDark of the mean.
constexpr double kChange = 0.08;
constexpr double kOff = 0.02;
constexpr double kDark = 0.1;
/// A vertex that gets less of the brightest corner's is covered by what stands on it.
constexpr double kCovered = 0.01;
constexpr int kFine = 1 << VertexLight::kLevels;
constexpr std::size_t kVerticesAtOnce = 4;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

/// Vertices on the edges of a mesh's triangles that are at one place: by the ends of the edge and
/// where on it.
using EdgePoint = std::array<int, 4>;
struct Joined {
  std::size_t number;
  Vector3d normal;  ///< of that side
};

/// Numbers of a mesh's vertices: one for all at one position.
std::vector<int> positions_of(const Mesh& mesh) {
  std::map<std::array<double, 3>, int> known;
  std::vector<int> positions;
  for (const Vector3d& v : mesh.vertices) {
    positions.push_back(
        known.emplace(std::array{v.x(), v.y(), v.z()}, static_cast<int>(known.size()))
            .first->second);
  }
  return positions;
}

EdgePoint edge_point(int from, int to, int step, int n) {
  if (step == 0 || step == n) {
    const int at = step == 0 ? from : to;
    return {at, at, 0, 1};
  }
  const int divisor = std::gcd(step, n);
  return from < to ? EdgePoint{from, to, step / divisor, n / divisor}
                   : EdgePoint{to, from, (n - step) / divisor, n / divisor};
}

bool is_on_edge(const Vector2i& at, int n) {
  return at.x() == 0 || at.y() == 0 || at.sum() == n;
}

/// Makes vertices at one place of a surface one, but for creases: each is the mean of those whose
/// sides are less than 30 degrees apart. What nothing reaches is covered and does not count.
void join_vertices(const std::map<EdgePoint, std::vector<Joined>>& shared,
                   std::vector<Vector3f>& irradiance) {
  constexpr double kCrease = 0.866;
  for (const auto& [place, vertices] : shared) {
    std::vector<Vector3f> means;
    for (const Joined& own : vertices) {
      Vector3f sum = Vector3f::Zero();
      int n = 0;
      for (const Joined& other : vertices) {
        const Vector3f& value = irradiance[other.number];
        if (own.normal.dot(other.normal) > kCrease && value.maxCoeff() > 0.0F) {
          sum += value;
          ++n;
        }
      }
      means.emplace_back(n > 0 ? Vector3f(sum / static_cast<float>(n)) : sum);
    }
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      irradiance[vertices[i].number] = means[i];
    }
  }
}

/// The surfaces' shared edges, of one mesh or instance each.
void share_edges(const Scene& scene, const Patches& patches,
                 const std::vector<SideVertex>& vertices, std::vector<Vector3f>& irradiance) {
  const auto mesh_number = [&scene](std::uint32_t surface) {
    const std::size_t n_others =
        scene.meshes.size() + scene.spheres.size() + scene.disks.size();
    return surface < scene.meshes.size()
               ? surface
               : static_cast<std::size_t>(scene.instances[surface - n_others].mesh);
  };
  const std::vector<CutTriangle>& triangles = patches.triangles();
  std::vector<std::vector<std::size_t>> on_edges(triangles.size());
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const SideVertex& vertex = vertices[v];
    if (is_on_edge(vertex.at, triangles[vertex.triangle].n * kFine)) {
      on_edges[vertex.triangle].push_back(v);
    }
  }
  for (std::size_t begin = 0; begin < triangles.size();) {
    const std::uint32_t surface = triangles[begin].surface;
    const Mesh& mesh = scene.meshes[mesh_number(surface)];
    const std::vector<int> positions = positions_of(mesh);
    std::map<EdgePoint, std::vector<Joined>> shared;
    std::size_t end = begin;
    for (; end < triangles.size() && triangles[end].surface == surface; ++end) {
      const CutTriangle& triangle = triangles[end];
      const int n = triangle.n * kFine;
      const Eigen::Vector3i& corners = mesh.triangles[triangle.triangle];
      const auto at = [&](int corner) { return positions[to_index(corners[corner])]; };
      for (const std::size_t v : on_edges[end]) {
        const SideVertex& vertex = vertices[v];
        const int i = vertex.at.x();
        const int j = vertex.at.y();
        const EdgePoint place = j == 0   ? edge_point(at(0), at(1), i, n)
                                : i == 0 ? edge_point(at(0), at(2), j, n)
                                         : edge_point(at(1), at(2), j, n);
        shared[place].push_back(
            {.number = v,
             .normal = vertex.is_front ? triangle.normal : Vector3d(-triangle.normal)});
      }
    }
    join_vertices(shared, irradiance);
    begin = end;
  }
}

}  // namespace

/// Cuts faces in four, level by level.
class VertexLight::Maker {
 public:
  Maker(const Patches& patches, const Gather& gather, VertexLight& made)
      : patches_(&patches), gather_(&gather), made_(&made) {}

  void start(const std::vector<std::uint8_t>& is_lit);
  void refine();
  [[nodiscard]] const std::vector<SideVertex>& vertices() const { return vertices_; }

 private:
  using Middles = std::array<std::uint32_t, 3>;  ///< of the edges opposite to each corner

  [[nodiscard]] double brightness(std::uint32_t vertex) const {
    return made_->irradiance_[vertex].cast<double>().sum();
  }
  [[nodiscard]] double change(const Face& face) const;
  [[nodiscard]] std::vector<std::uint32_t> most_changing(
      const std::vector<std::uint32_t>& candidates) const;
  [[nodiscard]] std::vector<Middles> add_middles(const std::vector<std::uint32_t>& cut);
  void gather_at(const std::vector<std::uint32_t>& vertices, int level);
  [[nodiscard]] std::vector<std::uint32_t> coarse_corners(
      const std::vector<std::uint32_t>& cut, int level) const;

  const Patches* patches_;
  const Gather* gather_;
  VertexLight* made_;
  std::vector<SideVertex> vertices_;
  std::vector<int> levels_;          ///< of the vertices, as they were gathered at
  std::vector<std::uint32_t> lit_;   ///< faces of patches
  std::size_t most_vertices_ = 0;
  double dark_ = 0.0;
};

/// A vertex on the edge of a triangle is seen from a tenth of a part within it: from the edge itself
/// half of the next wall would be behind.
void VertexLight::Maker::gather_at(const std::vector<std::uint32_t>& vertices, int level) {
  parallel_for(vertices.size(), kVerticesAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const SideVertex& vertex = vertices_[vertices[k]];
      const CutTriangle& triangle = patches_->triangles()[vertex.triangle];
      const int n = triangle.n * kFine;
      Vector2d uv = vertex.at.cast<double>() / n;
      if (is_on_edge(vertex.at, n)) {
        uv += 0.3 / (triangle.n << level) * (Vector2d::Constant(1.0 / 3.0) - uv);
      }
      made_->irradiance_[vertices[k]] =
          (*gather_)(vertices[k], triangle, vertex.is_front, uv).cast<float>();
    }
  });
  for (const std::uint32_t vertex : vertices) {
    levels_[vertex] = level;
  }
  made_->n_gathered_ += vertices.size();
}

void VertexLight::Maker::start(const std::vector<std::uint8_t>& is_lit) {
  const std::vector<CutTriangle>& triangles = patches_->triangles();
  vertices_.resize(2 * patches_->n_vertices());
  levels_.assign(vertices_.size(), 0);
  made_->irradiance_.assign(vertices_.size(), Vector3f::Zero());
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const int n = triangles[t].n;
    for (int j = 0; j <= n && n > 0; ++j) {
      for (int i = 0; i + j <= n; ++i) {
        for (const bool is_front : {true, false}) {
          vertices_[2 * triangles[t].vertex(i, j) + (is_front ? 0 : 1)] = {
              .triangle = static_cast<std::uint32_t>(t),
              .is_front = is_front,
              .at = kFine * Vector2i(i, j)};
        }
      }
    }
  }
  made_->faces_.resize(2 * patches_->size());
  std::vector<std::uint8_t> is_wanted(vertices_.size(), 0);
  for (std::size_t side = 0; side < made_->faces_.size(); ++side) {
    const std::size_t patch = side / 2;
    const Vector2d middle = patches_->uv_in(patch, {4.0 / 9.0, 0.5});
    const PatchPoint point = Patches::find_in(patches_->triangle_of(patch), middle);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t vertex = 2 * point.vertices.at(k) + side % 2;
      made_->faces_[side].vertices.at(k) = static_cast<std::uint32_t>(vertex);
      is_wanted[vertex] |= is_lit[side];
    }
    if (is_lit[side] != 0) {
      lit_.push_back(static_cast<std::uint32_t>(side));
    }
  }
  std::vector<std::uint32_t> wanted;
  for (std::size_t v = 0; v < is_wanted.size(); ++v) {
    if (is_wanted[v] != 0) {
      wanted.push_back(static_cast<std::uint32_t>(v));
    }
  }
  gather_at(wanted, 0);
  double sum = 0.0;
  for (const std::uint32_t vertex : wanted) {
    sum += brightness(vertex);
  }
  dark_ = wanted.empty() ? 0.0 : kDark * sum / static_cast<double>(wanted.size());
  most_vertices_ = vertices_.size() + wanted.size();
}

double VertexLight::Maker::change(const Face& face) const {
  const auto [least, most] = std::minmax(
      {brightness(face.vertices[0]), brightness(face.vertices[1]), brightness(face.vertices[2])});
  return most > 0.0 ? (most - least) / std::max(most, dark_) : 0.0;
}

std::vector<std::uint32_t> VertexLight::Maker::most_changing(
    const std::vector<std::uint32_t>& candidates) const {
  std::vector<std::pair<double, std::uint32_t>> found;
  for (const std::uint32_t face : candidates) {
    const double much = change(made_->faces_[face]);
    if (much > kChange) {
      found.emplace_back(-much, face);
    }
  }
  // Each has three middles, most of them shared by two.
  const std::size_t most = (most_vertices_ - std::min(most_vertices_, vertices_.size())) / 3;
  if (found.size() > most) {
    std::ranges::sort(found);
    found.resize(most);
  }
  std::vector<std::uint32_t> faces;
  for (const auto& [minus_change, face] : found) {
    faces.push_back(face);
  }
  std::ranges::sort(faces);
  return faces;
}

std::vector<VertexLight::Maker::Middles> VertexLight::Maker::add_middles(
    const std::vector<std::uint32_t>& cut) {
  using Place = std::tuple<std::uint32_t, bool, int, int>;
  std::map<Place, std::uint32_t> known;
  std::vector<Middles> middles;
  for (const std::uint32_t face : cut) {
    const auto& corners = made_->faces_[face].vertices;
    Middles& own = middles.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) {
      const SideVertex& a = vertices_[corners.at((k + 1) % 3)];
      const SideVertex& b = vertices_[corners.at((k + 2) % 3)];
      const Vector2i at = (a.at + b.at) / 2;
      const auto [entry, is_new] =
          known.emplace(Place{a.triangle, a.is_front, at.x(), at.y()},
                        static_cast<std::uint32_t>(vertices_.size()));
      if (is_new) {
        vertices_.push_back({.triangle = a.triangle, .is_front = a.is_front, .at = at});
      }
      own.at(k) = entry->second;
    }
  }
  levels_.resize(vertices_.size(), 0);
  made_->irradiance_.resize(vertices_.size(), Vector3f::Zero());
  return middles;
}

/// Corners on edges of triangles that were seen from farther within.
std::vector<std::uint32_t> VertexLight::Maker::coarse_corners(
    const std::vector<std::uint32_t>& cut, int level) const {
  std::vector<std::uint32_t> corners;
  for (const std::uint32_t face : cut) {
    for (const std::uint32_t v : made_->faces_[face].vertices) {
      const SideVertex& vertex = vertices_[v];
      const int n = patches_->triangles()[vertex.triangle].n * kFine;
      if (is_on_edge(vertex.at, n) && levels_[v] < level) {
        corners.push_back(v);
      }
    }
  }
  std::ranges::sort(corners);
  corners.erase(std::ranges::unique(corners).begin(), corners.end());
  return corners;
}

void VertexLight::Maker::refine() {
  std::vector<std::uint32_t> candidates = lit_;
  for (int level = 1; level <= kLevels; ++level) {
    const std::vector<std::uint32_t> cut = most_changing(candidates);
    const std::size_t n_before = vertices_.size();
    const std::vector<Middles> middles = add_middles(cut);
    std::vector<std::uint32_t> wanted = coarse_corners(cut, level);
    for (std::size_t v = n_before; v < vertices_.size(); ++v) {
      wanted.push_back(static_cast<std::uint32_t>(v));
    }
    gather_at(wanted, level);
    candidates.clear();
    for (std::size_t c = 0; c < cut.size(); ++c) {
      const std::array<std::uint32_t, 3> corners = made_->faces_[cut[c]].vertices;
      std::array<bool, 3> is_off{};
      for (std::size_t k = 0; k < 3; ++k) {
        const double a = brightness(corners.at((k + 1) % 3));
        const double b = brightness(corners.at((k + 2) % 3));
        const double found = brightness(middles[c].at(k));
        is_off.at(k) =
            std::abs(found - 0.5 * (a + b)) > kOff * std::max({a, b, found, dark_});
      }
      made_->faces_[cut[c]].first_child = static_cast<std::uint32_t>(made_->faces_.size());
      for (std::size_t child = 0; child < 4; ++child) {
        Face face{.vertices = middles[c]};
        bool is_candidate = false;
        for (std::size_t k = 0; k < 3; ++k) {
          is_candidate = is_candidate || (k != child && is_off.at(k));
          if (child < 3) {
            face.vertices.at(k) = k == child ? corners.at(k) : middles[c].at(3 - k - child);
          }
        }
        if (is_candidate) {
          candidates.push_back(static_cast<std::uint32_t>(made_->faces_.size()));
        }
        made_->faces_.push_back(face);
      }
    }
  }
}

VertexLight::VertexLight(const Scene& scene, const Patches& patches,
                         const std::vector<std::uint8_t>& is_lit, const Gather& gather) {
  HAARLIGHT_EXPECTS(is_lit.size() == 2 * patches.size(), "a word for each side");
  Maker maker(patches, gather, *this);
  maker.start(is_lit);
  maker.refine();
  share_edges(scene, patches, maker.vertices(), irradiance_);
}

Vector3d VertexLight::irradiance(const PatchPoint& at, bool is_front) const {
  std::array<double, 3> weights = at.weights;
  const Face* face = &faces_[2 * at.patch + (is_front ? 0 : 1)];
  while (face->first_child != 0) {
    std::size_t child = 3;
    for (std::size_t k = 0; k < 3; ++k) {
      child = weights.at(k) > 0.5 ? k : child;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      weights.at(k) = child == 3 ? 1.0 - 2.0 * weights.at(k)
                                 : 2.0 * weights.at(k) - (k == child ? 1.0 : 0.0);
    }
    face = &faces_[face->first_child + child];
  }
  std::array<Vector3d, 3> values;
  double most = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    values.at(i) = irradiance_[face->vertices.at(i)].cast<double>();
    most = std::max(most, values.at(i).sum());
  }
  Vector3d sum = Vector3d::Zero();
  double used = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (values.at(i).sum() > kCovered * most) {
      sum += weights.at(i) * values.at(i);
      used += weights.at(i);
    }
  }
  return used > 0.0 ? Vector3d(sum / used) : Vector3d::Zero();
}

}  // namespace haarlight::render
