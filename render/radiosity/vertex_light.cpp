// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/vertex_light.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <map>
#include <numeric>
#include <tuple>
#include <utility>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector2i;
using Eigen::Vector3d;
using Eigen::Vector3f;

/// How far what is interpolated may be off before a part is cut in four, of its brightest corner, but not
/// of less than kDark of the mean.
constexpr double kError = 0.01;
constexpr double kDark = 0.3;
/// New vertices that may be made where patches are few.
constexpr std::size_t kFewVertices = 500;
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
  struct Candidate {
    std::uint32_t face;
    double error;  ///< relative, of what is interpolated: an estimate
  };
  using Middles = std::array<std::uint32_t, 3>;  ///< of the edges opposite to each corner

  [[nodiscard]] double brightness(std::uint32_t vertex) const {
    return made_->irradiance_[vertex].cast<double>().sum();
  }
  [[nodiscard]] double relative(double error, std::initializer_list<double> values) const;
  [[nodiscard]] double error_of_patch(const Face& face) const;
  [[nodiscard]] std::vector<std::uint32_t> worst(std::vector<Candidate> candidates) const;
  void cut_in_four(std::uint32_t face, const Middles& middles,
                   std::vector<Candidate>& children);
  [[nodiscard]] std::vector<Middles> add_middles(const std::vector<std::uint32_t>& cut);
  void gather_at(const std::vector<std::uint32_t>& vertices, int level);
  [[nodiscard]] std::vector<std::uint32_t> coarse_corners(const std::vector<std::uint32_t>& cut,
                                                          int level) const;

  const Patches* patches_;
  const Gather* gather_;
  VertexLight* made_;
  std::vector<SideVertex> vertices_;
  std::vector<int> levels_;         ///< of the vertices, as they were gathered at
  std::vector<std::uint32_t> lit_;  ///< faces of patches
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
  most_vertices_ = vertices_.size() + std::max(wanted.size(), kFewVertices);
}

double VertexLight::Maker::relative(double error, std::initializer_list<double> values) const {
  const double most = std::max(std::max(values), dark_);
  return most > 0.0 ? error / most : 0.0;
}

// Linear interpolation is off by an eighth of the second difference; that of an edge is told by the
// vertices beyond its ends. Where there is none the light is taken to change as it does at the foot of
// a wall.
double VertexLight::Maker::error_of_patch(const Face& face) const {
  const CutTriangle& triangle = patches_->triangles()[vertices_[face.vertices[0]].triangle];
  const auto at = [&](std::size_t corner) -> Vector2i {
    return vertices_[face.vertices.at(corner)].at / kFine;
  };
  const std::uint32_t back = face.vertices[0] % 2;
  double most = 0.0;
  for (std::size_t k = 0; k < 3; ++k) {
    const std::size_t l = (k + 1) % 3;
    const double a = brightness(face.vertices.at(k));
    const double b = brightness(face.vertices.at(l));
    double second = -1.0;
    for (const auto& [near, far] : {std::pair(k, l), std::pair(l, k)}) {
      const Vector2i beyond = 2 * at(near) - at(far);
      if (beyond.minCoeff() >= 0 && beyond.sum() <= triangle.n) {
        const auto vertex =
            static_cast<std::uint32_t>(2 * triangle.vertex(beyond.x(), beyond.y())) + back;
        const double c = brightness(vertex);
        second =
            std::max(second, std::abs(c - 2.0 * (near == k ? a : b) + (near == k ? b : a)));
      }
    }
    most = std::max(most, relative((second < 0.0 ? std::abs(a - b) : second) / 8.0, {a, b}));
  }
  return most;
}

/// Candidates that are cut, of the largest errors if not all can be; ascending.
std::vector<std::uint32_t> VertexLight::Maker::worst(std::vector<Candidate> candidates) const {
  std::erase_if(candidates, [](const Candidate& face) { return !(face.error > kError); });
  // Each has three middles, most of them shared by two.
  const std::size_t most = (most_vertices_ - std::min(most_vertices_, vertices_.size())) / 3;
  if (candidates.size() > most) {
    std::ranges::sort(candidates, [](const Candidate& a, const Candidate& b) {
      return std::pair(-a.error, a.face) < std::pair(-b.error, b.face);
    });
    candidates.resize(most);
  }
  std::vector<std::uint32_t> faces(candidates.size());
  std::ranges::transform(candidates, faces.begin(), &Candidate::face);
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
      const auto [entry, is_new] = known.emplace(Place{a.triangle, a.is_front, at.x(), at.y()},
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
  corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
  return corners;
}

/// Makes a face's children. Theirs are a fourth of the errors that were seen at the middles.
void VertexLight::Maker::cut_in_four(std::uint32_t face, const Middles& middles,
                                     std::vector<Candidate>& children) {
  const std::array<std::uint32_t, 3> corners = made_->faces_[face].vertices;
  std::array<double, 3> errors{};
  for (std::size_t k = 0; k < 3; ++k) {
    const double a = brightness(corners.at((k + 1) % 3));
    const double b = brightness(corners.at((k + 2) % 3));
    const double found = brightness(middles.at(k));
    errors.at(k) = relative(std::abs(found - 0.5 * (a + b)) / 4.0, {a, b, found});
  }
  made_->faces_[face].first_child = static_cast<std::uint32_t>(made_->faces_.size());
  for (std::size_t child = 0; child < 4; ++child) {
    Face part{.vertices = middles};
    double error = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      error = k != child ? std::max(error, errors.at(k)) : error;
      if (child < 3) {
        part.vertices.at(k) = k == child ? corners.at(k) : middles.at(3 - k - child);
      }
    }
    children.push_back(
        {.face = static_cast<std::uint32_t>(made_->faces_.size()), .error = error});
    made_->faces_.push_back(part);
  }
}

void VertexLight::Maker::refine() {
  std::vector<Candidate> candidates;
  for (const std::uint32_t face : lit_) {
    candidates.push_back({.face = face, .error = error_of_patch(made_->faces_[face])});
  }
  for (int level = 1; level <= kLevels; ++level) {
    const std::vector<std::uint32_t> cut = worst(std::move(candidates));
    const std::size_t n_before = vertices_.size();
    const std::vector<Middles> middles = add_middles(cut);
    std::vector<std::uint32_t> wanted = coarse_corners(cut, level);
    for (std::size_t v = n_before; v < vertices_.size(); ++v) {
      wanted.push_back(static_cast<std::uint32_t>(v));
    }
    gather_at(wanted, level);
    candidates.clear();
    for (std::size_t c = 0; c < cut.size(); ++c) {
      cut_in_four(cut[c], middles[c], candidates);
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

// A patch has at most three vertices of its own on each side, and as many are made. Each is a node of a
// map on the way and a few numbers, and each cut makes one at least.
std::uint64_t VertexLight::bytes_needed(std::uint64_t n_patches) {
  constexpr std::uint64_t kNode = 96;
  constexpr std::uint64_t kFaces = 24;
  constexpr std::uint64_t kOfVertex =
      2 * (sizeof(Vector3f) + sizeof(SideVertex) + sizeof(int)) + kNode;  // vectors grow
  return 2 * std::max<std::uint64_t>(n_patches, kFewVertices) *
         (6 * kOfVertex + kFaces * sizeof(Face));
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
