// SPDX-License-Identifier: Apache-2.0
#include "render/direct/silhouette_edges.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include <Eigen/Geometry>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr int kLeafEdges = 4;
constexpr int kPieces = 32;  ///< of an edge as long as the scene

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

}  // namespace

SilhouetteEdges::SilhouetteEdges(std::span<const Mesh> meshes) {
  std::vector<Vector3d> corners;
  for (const Mesh& mesh : meshes) {
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      for (const int corner : triangle) {
        corners.push_back(mesh.vertices[to_index(corner)]);
      }
    }
  }
  std::vector<int> order(corners.size());
  std::iota(order.begin(), order.end(), 0);
  const auto place = [&](int i) {
    const Vector3d& p = corners[to_index(i)];
    return std::tuple(p.x(), p.y(), p.z());
  };
  std::sort(order.begin(), order.end(), [&](int i, int j) { return place(i) < place(j); });
  std::vector<int> vertex_of(corners.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (i == 0 || place(order[i]) != place(order[i - 1])) {
      vertices_.push_back(corners[to_index(order[i])]);
    }
    vertex_of[to_index(order[i])] = static_cast<int>(vertices_.size()) - 1;
  }
  for (std::size_t i = 0; i < corners.size(); i += 3) {
    const Eigen::Vector3i t(vertex_of[i], vertex_of[i + 1], vertex_of[i + 2]);
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) {
      continue;
    }
    const Vector3d& a = vertices_[to_index(t[0])];
    const Vector3d normal =
        (vertices_[to_index(t[1])] - a).cross(vertices_[to_index(t[2])] - a).normalized();
    triangles_.push_back(t);
    planes_.emplace_back(normal.x(), normal.y(), normal.z(), -normal.dot(a));
  }
  add_edges();
  cut_long_edges();
  build();
}

void SilhouetteEdges::add_edges() {
  struct Side {
    int a;
    int b;
    int triangle;
    bool is_turned;  ///< the triangle goes from b to a
  };
  std::vector<Side> sides;
  sides.reserve(3 * triangles_.size());
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    for (int c = 0; c < 3; ++c) {
      const int a = triangles_[t][c];
      const int b = triangles_[t][(c + 1) % 3];
      sides.push_back({std::min(a, b), std::max(a, b), static_cast<int>(t), a > b});
    }
  }
  const auto key = [](const Side& side) {
    return std::tuple(side.a, side.b, side.triangle, side.is_turned);
  };
  std::sort(sides.begin(), sides.end(),
            [&](const Side& p, const Side& q) { return key(p) < key(q); });
  for (std::size_t i = 0; i < sides.size();) {
    std::size_t end = i + 1;
    while (end < sides.size() && sides[end].a == sides[i].a && sides[end].b == sides[i].b) {
      ++end;
    }
    if (end == i + 2 && sides[i].is_turned != sides[i + 1].is_turned) {
      edges_.push_back({sides[i].a, sides[i].b, sides[i].triangle, sides[i + 1].triangle});
    } else {
      for (std::size_t j = i; j < end; ++j) {
        edges_.push_back({sides[j].a, sides[j].b, sides[j].triangle, -1});
      }
    }
    i = end;
  }
}

/// So that a few long edges do not make boxes that hold everything.
void SilhouetteEdges::cut_long_edges() {
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : vertices_) {
    box.extend(vertex);
  }
  const double longest = box.isEmpty() ? 0.0 : box.diagonal().norm() / kPieces;
  const std::size_t n_whole = edges_.size();
  for (std::size_t e = 0; e < n_whole; ++e) {
    const Edge whole = edges_[e];
    const Vector3d a = vertices_[to_index(whole.a)];
    const Vector3d way = vertices_[to_index(whole.b)] - a;
    const int n = static_cast<int>(std::ceil(way.norm() / longest));
    for (int i = 1; i < n; ++i) {
      vertices_.emplace_back(a + (static_cast<double>(i) / n) * way);
      const int cut = static_cast<int>(vertices_.size()) - 1;
      edges_.push_back(edges_[e]);
      edges_.back().b = cut;
      edges_[e].a = cut;
    }
  }
}

void SilhouetteEdges::fit(Node& node, int first, int count) const {
  Eigen::AlignedBox3d box;
  Vector3d sum = Vector3d::Zero();
  bool is_open = false;
  const auto normal = [&](int triangle) -> Vector3d {
    return planes_[to_index(triangle)].head<3>();
  };
  const auto edges = std::span(edges_).subspan(to_index(first), to_index(count));
  for (const Edge& edge : edges) {
    box.extend(vertices_[to_index(edge.a)]);
    box.extend(vertices_[to_index(edge.b)]);
    is_open = is_open || edge.right < 0;
    sum += normal(edge.left);
    sum += edge.right < 0 ? Vector3d::Zero().eval() : normal(edge.right);
  }
  node.centre = box.center();
  node.half_size = box.max() - node.centre;
  node.radius = node.half_size.norm();
  node.axis = sum.normalized();
  node.cosine = -1.0;
  if (!is_open && sum.norm() > 0.0) {
    node.cosine = 1.0;
    for (const Edge& edge : edges) {
      node.cosine = std::min(
          {node.cosine, node.axis.dot(normal(edge.left)), node.axis.dot(normal(edge.right))});
    }
  }
  node.sine = std::sqrt(std::max(0.0, 1.0 - node.cosine * node.cosine));
}

void SilhouetteEdges::build() {
  if (edges_.empty()) {
    return;
  }
  struct Range {
    int node;
    int first;
    int count;
  };
  std::vector<Range> open{{0, 0, static_cast<int>(edges_.size())}};
  nodes_.emplace_back();
  while (!open.empty()) {
    const Range range = open.back();
    open.pop_back();
    fit(nodes_[to_index(range.node)], range.first, range.count);
    if (range.count <= kLeafEdges) {
      nodes_[to_index(range.node)].first = range.first;
      nodes_[to_index(range.node)].count = range.count;
      continue;
    }
    int axis = 0;
    nodes_[to_index(range.node)].half_size.maxCoeff(&axis);
    const auto middle_of = [&](const Edge& edge) {
      return vertices_[to_index(edge.a)][axis] + vertices_[to_index(edge.b)][axis];
    };
    const int half = range.count / 2;
    const auto begin = edges_.begin() + range.first;
    std::nth_element(begin, begin + half, begin + range.count,
                     [&](const Edge& p, const Edge& q) {
                       return std::tuple(middle_of(p), p.a, p.b, p.left) <
                              std::tuple(middle_of(q), q.a, q.b, q.left);
                     });
    const int children = static_cast<int>(nodes_.size());
    nodes_[to_index(range.node)].first = children;
    nodes_.resize(nodes_.size() + 2);
    open.push_back({children, range.first, half});
    open.push_back({children + 1, range.first + half, range.count - half});
  }
}

bool SilhouetteEdges::faces(int triangle, const Vector3d& eye) const {
  const Eigen::Vector4d& plane = planes_[to_index(triangle)];
  return plane.head<3>().dot(eye) + plane[3] > 0.0;
}

bool SilhouetteEdges::is_outline(const Edge& edge, const Vector3d& eye) const {
  return edge.right < 0 || faces(edge.left, eye) != faces(edge.right, eye);
}

void SilhouetteEdges::find(const Vector3d& eye, std::span<const Pyramid> pyramids,
                           Scratch& scratch) const {
  scratch.found.clear();
  scratch.visits.clear();
  scratch.meets.resize(pyramids.size());
  std::iota(scratch.meets.begin(), scratch.meets.end(), 0);
  if (!nodes_.empty() && !pyramids.empty()) {
    scratch.visits.push_back({0, 0, static_cast<int>(pyramids.size())});
  }
  while (!scratch.visits.empty()) {
    const Scratch::Visit visit = scratch.visits.back();
    scratch.visits.pop_back();
    const Node& node = nodes_[to_index(visit.node)];
    // All triangles face the eye, or none does: their normals are within `cosine` of the axis,
    // the eye is seen from the box's points within asin(radius / distance) of its centre's.
    const Vector3d way = eye - node.centre;
    const double distance2 = way.squaredNorm();
    const double radius = node.radius;
    const bool is_outside = distance2 > radius * radius;
    const double along = is_outside ? std::sqrt(distance2 - radius * radius) : 0.0;
    if (node.cosine > 0.0 && is_outside) {
      const double least = node.sine * along + node.cosine * radius;
      const double rounding = 1e-9 * along;
      if (node.cosine * along > node.sine * radius + rounding &&
          std::abs(node.axis.dot(way)) > least + rounding) {
        continue;
      }
    }
    scratch.meets.resize(to_index(visit.end));
    for (int i = visit.begin; i < visit.end; ++i) {
      const int index = scratch.meets[to_index(i)];
      const Pyramid& pyramid = pyramids[to_index(index)];
      if (!is_outside || pyramid.cosine <= 0.0 ||
          -pyramid.axis.dot(way) >= pyramid.cosine * along - pyramid.sine * radius) {
        scratch.meets.push_back(index);
      }
    }
    const int end = static_cast<int>(scratch.meets.size());
    if (end == visit.end) {
      continue;
    }
    if (node.count == 0) {
      scratch.visits.push_back({node.first, visit.end, end});
      scratch.visits.push_back({node.first + 1, visit.end, end});
      continue;
    }
    for (int e = node.first; e < node.first + node.count; ++e) {
      const Edge& edge = edges_[to_index(e)];
      if (is_outline(edge, eye)) {
        for (int i = visit.end; i < end; ++i) {
          scratch.found.push_back({scratch.meets[to_index(i)], vertices_[to_index(edge.a)],
                                   vertices_[to_index(edge.b)]});
        }
      }
    }
  }
}

std::vector<Vector3d> SilhouetteEdges::triangles_at(const Vector3d& normal, double low,
                                                    double high) const {
  std::vector<Vector3d> corners;
  std::vector<int> open;
  if (!nodes_.empty()) {
    open.push_back(0);
  }
  const auto add = [&](int triangle) {
    for (const int corner : triangles_[to_index(triangle)]) {
      corners.push_back(vertices_[to_index(corner)]);
    }
  };
  while (!open.empty()) {
    const Node& node = nodes_[to_index(open.back())];
    open.pop_back();
    const double middle = normal.dot(node.centre);
    const double reach = normal.cwiseAbs().dot(node.half_size);
    if (middle + reach < low || middle - reach > high) {
      continue;
    }
    if (node.count == 0) {
      open.push_back(node.first);
      open.push_back(node.first + 1);
      continue;
    }
    for (int e = node.first; e < node.first + node.count; ++e) {
      const Edge& edge = edges_[to_index(e)];
      const double a = normal.dot(vertices_[to_index(edge.a)]);
      const double b = normal.dot(vertices_[to_index(edge.b)]);
      if (std::max(a, b) >= low && std::min(a, b) <= high) {
        add(edge.left);
        if (edge.right >= 0) {
          add(edge.right);
        }
      }
    }
  }
  return corners;
}

}  // namespace haarlight::render
