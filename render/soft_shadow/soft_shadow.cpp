// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/soft_shadow.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <numbers>
#include <optional>

#include <Eigen/Geometry>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/rays/ray_offset.h"
#include "render/soft_shadow/d_buffer.h"
#include "render/soft_shadow/light_outline.h"
#include "render/soft_shadow/ray_ends.h"
#include "render/soft_shadow/shadow_grid.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector4d;

constexpr std::size_t kPointsTogether = 1024;

/// An area that no more than its rounding may be: a tenth of the 1e-6 that exact stands for.
constexpr double kIgnoredArea = 1e-7;

/// Of a plane's distance to the light, whose sign is certain then.
constexpr double kCertain = 1e-12;

/// How near the least of 1 - z / z_x an edge is cut off before a point, where its image goes to
/// infinity.
constexpr double kNearestPoint = 1e-12;

/// What a ray's ends, its direction and the occluder's corners are off by, in units of 2^-24 of the
/// scene's radius: RayCaster::offset_mm() has the terms.
constexpr double kRoundings = 16.0;

/// Points by which the rays of all traced ones are chosen, and how many times as many strata tell
/// what those are off by.
constexpr std::size_t kPilot = 512;
constexpr int kFiner = 2;

/// Jittered n x n strata of a light that a straight border parts: 99 % of the errors are below
/// 1.4 / n^1.5 (docs/numerics/soft-shadow.md). Where to begin.
int strata_for(double max_error) {
  return static_cast<int>(std::ceil(std::pow(1.4 / max_error, 2.0 / 3.0)));
}
constexpr int kMostStrata = 256;

double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

std::size_t index(ShadowKind kind) { return static_cast<std::size_t>(kind); }

/// Which part of a segment is in the unit disk, [first, second] of [0, 1]; none: nothing.
std::optional<std::pair<double, double>> part_in_disk(const Vector2d& a, const Vector2d& b) {
  const Vector2d way = b - a;
  const double length2 = way.squaredNorm();
  const double middle = length2 > 0.0 ? -a.dot(way) / length2 : 0.0;
  const double off2 = (a + middle * way).squaredNorm();
  if (!(off2 < 1.0)) {
    return std::nullopt;
  }
  const double half = length2 > 0.0 ? std::sqrt((1.0 - off2) / length2) : 0.0;
  const double first = std::max(0.0, middle - half);
  const double second = std::min(1.0, middle + half);
  return first <= second ? std::optional(std::pair(first, second)) : std::nullopt;
}

/// How much more a rounding across the light's plane moves an image than one along it: a ray's length
/// over its height, for the farthest point of the light.
double flatness(const Vector3d& x) { return (x.norm() + 1.0) / x.z(); }

double distance(const OutlineSegment& segment, const Vector2d& point) {
  const Vector2d way = segment.to - segment.from;
  const double length2 = way.squaredNorm();
  const double s =
      length2 > 0.0 ? std::clamp((point - segment.from).dot(way) / length2, 0.0, 1.0) : 0.0;
  return (segment.from + s * way - point).norm();
}

/// Uniform over the light by strata, (u, v) in [0, 1)^2.
Vector2d point_of(const FlatLight& light, double u, double v) {
  if (light.is_disk()) {
    const double radius = std::sqrt(u);
    const double angle = 2.0 * std::numbers::pi * v;
    return {radius * std::cos(angle), radius * std::sin(angle)};
  }
  // One triangle of the fan by area, then over it.
  double rest = u * light.area();
  const Vector2d& a = light.corners[0];
  for (std::size_t i = 2;; ++i) {
    const Vector2d b = light.corners[i - 1] - a;
    const Vector2d c = light.corners[i] - a;
    const double area = 0.5 * (b.x() * c.y() - b.y() * c.x());
    if (rest < area || i + 1 == light.corners.size()) {
      const double along = std::sqrt(std::clamp(rest / area, 0.0, 1.0));
      return a + along * ((1.0 - v) * b + v * c);
    }
    rest -= area;
  }
}

}  // namespace

struct SoftShadow::Impl {
  const Scene& scene;
  const OccluderEdges& edges;
  const RayCaster& caster;
  FlatLight light;
  SoftShadowOptions options;
  ShadowCounts counts;
  LightOutline outline;
  std::vector<Vector3d> vertices;  // light frame
  std::vector<Vector4d> planes;    // light frame: unit normal, offset; of each face
  std::vector<OccluderEdge> candidates;
  std::optional<ShadowGrid> grid;
  std::vector<Vector3d>
      reached;  // light frame: of all receivers so far those that bound the grid
  std::optional<DBuffer> buffer;
  std::optional<RayEnds> ends;
  bool is_asked = false;         // evaluate() was called
  bool is_cut = false;           // occluders pass through the light
  double rounding = 0.0;         // of rays, light frame
  double light_offset_mm = 0.0;  // how far before the light rays end

  Impl(const Scene& scene_in, const OccluderEdges& edges_in, const RayCaster& caster_in,
       FlatLight light_in, const SoftShadowOptions& options_in)
      : scene(scene_in),
        edges(edges_in),
        caster(caster_in),
        light(std::move(light_in)),
        options(options_in),
        outline(light.corners) {}

  [[nodiscard]] bool is_of_light(std::uint32_t mesh) const {
    return static_cast<int>(mesh) == light.surface;
  }
  void set_frame();
  void set_candidates();
  void set_cut();
  void forget_last();
  void provide_grid(std::span<const Vector3d> receivers);
  void make_grid();

  /// Of one thread.
  struct Work {
    LightOutline::Scratch scratch;
    std::vector<OutlineSegment> segments;
    std::vector<double>
        leverage;  // of each: how far off its image is, over its edge's rounding
    std::vector<Vector3d> receivers;
    std::vector<Ray> rays;
    std::vector<std::size_t> of_ray;  // point
    std::vector<std::uint8_t> blocked;
    ShadowCounts counts;
  };
  void evaluate(std::span<const Vector3d> points, std::span<LightShadow> shadows,
                Work& work) const;
  void find(std::size_t i, const Vector3d& point, const Vector3d& x, LightShadow& shadow,
            Work& work) const;
  void project(const Vector3d& x, std::span<const std::uint32_t> listed, Work& work) const;
  [[nodiscard]] bool may_pass_edge(const Vector3d& x, const LeastCovered& least,
                                   const Work& work) const;
  void decide(std::size_t i, const Vector3d& point, const Vector3d& x,
              const LeastCovered& least, LightShadow& shadow, Work& work) const;
  void read_buffer(const Vector3d& x, LightShadow& shadow, Work& work) const;
  [[nodiscard]] double traced(const Vector3d& point, int strata, std::uint64_t key,
                              std::int64_t& n_rays) const;
  [[nodiscard]] TracedError pilot(std::span<const Vector3d> points,
                                  std::span<const std::size_t> chosen, int strata);
  void trace(std::span<const Vector3d> points, std::span<LightShadow> shadows);
  [[nodiscard]] std::optional<Ray> traced_ray_to(const Vector3d& point,
                                                 const Vector2d& target) const;
};

void SoftShadow::Impl::set_frame() {
  vertices.reserve(edges.vertices.size());
  for (const Vector3d& vertex : edges.vertices) {
    vertices.push_back(light.to_light(vertex));
  }
  planes.reserve(edges.faces.size());
  for (const OccluderFace& face : edges.faces) {
    const Vector3d& a = vertices[face.corners[0]];
    const Vector3d normal =
        (vertices[face.corners[1]] - a).cross(vertices[face.corners[2]] - a).normalized();
    planes.emplace_back(normal.x(), normal.y(), normal.z(), -normal.dot(a));
  }
  if (light.surface != FlatLight::kNoSurface) {
    light_offset_mm = caster.most_offset_mm(static_cast<std::uint32_t>(light.surface));
  }
  rounding = kRoundings * kRounding * caster.scene_radius_mm() / light.radius_mm;
}

/// What was counted of the points before these.
void SoftShadow::Impl::forget_last() {
  if (is_asked) {
    counts = {.n_edges = counts.n_edges,
              .n_candidates = counts.n_candidates,
              .n_listed = counts.n_listed,
              .n_without_extrusion = counts.n_without_extrusion};
  }
  is_asked = true;
}

/// Leaves out edges that no point can see part the light. A point x sees a point p of the light
/// through an edge only from the other side of the planes of its faces: where the whole light is on
/// one side of them (none-front-facing or all-front-facing, [Jakobsen04] section 2.1), x is on the
/// other, and the layers on the edge's sides are known without it.
void SoftShadow::Impl::set_candidates() {
  counts.n_edges = static_cast<std::int64_t>(edges.edges.size());
  const auto side_of_light = [this](std::uint32_t face) {
    const Vector4d& plane = planes[face];
    const double reach = plane.head<2>().norm();
    const double margin = kCertain * (1.0 + std::abs(plane[3]));
    return plane[3] - reach > margin ? 1 : plane[3] + reach < -margin ? -1 : 0;
  };
  for (const OccluderEdge& edge : edges.edges) {
    int jump = 0;
    bool is_certain = true;
    bool is_own = false;
    for (std::size_t f = 0; f < 2; ++f) {
      if (edge.ways.at(f) != 0) {
        const int side = side_of_light(edge.faces.at(f));
        is_certain = is_certain && side != 0;
        jump -= edge.ways.at(f) * side;
        is_own = is_own || is_of_light(edges.faces[edge.faces.at(f)].mesh);
      }
    }
    if (!is_own && (!is_certain || jump != 0)) {
      candidates.push_back(edge);
    }
  }
  counts.n_candidates = static_cast<std::int64_t>(candidates.size());
}

/// Whether something passes through the light itself: cells then have borders that are no edges.
void SoftShadow::Impl::set_cut() {
  for (const OccluderFace& face : edges.faces) {
    if (is_of_light(face.mesh)) {
      continue;
    }
    std::array<Vector2d, 3> crossings;
    std::size_t n = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      const Vector3d& a = vertices[face.corners.at(c)];
      const Vector3d& b = vertices[face.corners.at((c + 1) % 3)];
      if ((a.z() >= kNearestZ) != (b.z() >= kNearestZ)) {
        const double s = (kNearestZ - a.z()) / (b.z() - a.z());
        crossings.at(n++) = (a + s * (b - a)).head<2>();
      }
    }
    is_cut = is_cut || (n >= 2 && part_in_disk(crossings[0], crossings[1]));
  }
}

/// Which cells a curved surface may hide depends on the cells' size, and so do values that are traced: such
/// a grid is no other receivers'.
void SoftShadow::Impl::provide_grid(std::span<const Vector3d> receivers) {
  const std::size_t n_own_disks =
      light.surface >= static_cast<int>(scene.meshes.size()) ? 1 : 0;
  const bool has_curved = !scene.spheres.empty() || scene.disks.size() > n_own_disks;
  if (has_curved) {
    reached.clear();
  } else if (grid && std::ranges::all_of(receivers, [this](const Vector3d& x) {
               return !(x.z() > kNearestZ) || grid->covers(x);
             })) {
    return;
  }
  ShadowGrid::add_bounding(receivers, reached);
  make_grid();
}

void SoftShadow::Impl::make_grid() {
  grid.emplace(reached, options.grid, rounding);
  for (const OccluderEdge& edge : candidates) {
    grid->count_edge(vertices[edge.from], vertices[edge.to]);
  }
  grid->start_lists();
  for (std::uint32_t i = 0; i < candidates.size(); ++i) {
    grid->list_edge(i, vertices[candidates[i].from], vertices[candidates[i].to]);
  }
  for (const OccluderFace& face : edges.faces) {
    if (!is_of_light(face.mesh)) {
      grid->add_face(vertices[face.corners[0]], vertices[face.corners[1]],
                     vertices[face.corners[2]]);
    }
  }
  // What comes as near to a curved surface as single precision tells counts as behind it.
  const Vector3d off = Vector3d::Constant(ends->least_slack());
  const auto add_curved = [this, &off](const Vector3d& centre, const Vector3d& half) {
    const Vector3d middle = light.to_light(centre);
    if (middle.z() + half.z() > kNearestZ) {
      grid->add_curved(middle, half + off);
    }
  };
  for (const Sphere& sphere : scene.spheres) {
    add_curved(sphere.centre, Vector3d::Constant(sphere.radius_mm / light.radius_mm));
  }
  const std::size_t first_disk = scene.meshes.size() + scene.spheres.size();
  for (std::size_t i = 0; i < scene.disks.size(); ++i) {
    if (static_cast<int>(first_disk + i) != light.surface) {
      const Vector3d n = light.light_from_world * scene.disks[i].normal;
      const Vector3d across(std::hypot(n.y(), n.z()), std::hypot(n.x(), n.z()),
                            std::hypot(n.x(), n.y()));
      add_curved(scene.disks[i].centre, scene.disks[i].radius_mm / light.radius_mm * across);
    }
  }
  counts.n_listed = static_cast<std::int64_t>(grid->n_listed());
}

/// Of those that only count: it ends before the light's own surface, and near to it may meet another.
std::optional<Ray> SoftShadow::Impl::traced_ray_to(const Vector3d& point,
                                                   const Vector2d& target) const {
  const Vector3d to = light.to_world({target.x(), target.y(), 0.0});
  const Vector3d way = to - point;
  const double length = way.norm();
  const double height = way.dot(-light.light_from_world.row(2).transpose());
  // The light's own surface is met where the ray's rounding across its plane, over the ray's slope, says.
  const bool is_surface = light.surface != FlatLight::kNoSurface;
  const double across_mm = is_surface ? kOfWay * kRounding * length + light_offset_mm : 0.0;
  const double end = 1.0 - kOfWay * kRounding - across_mm / std::max(height, 1e-300);
  if (!(end > 0.0) || !(length > 0.0)) {
    return std::nullopt;
  }
  return Ray{.origin = point, .direction = way, .t_min = 0.0, .t_max = end};
}

/// The image on the light's plane of q, seen from x: (q_xy x_z - x_xy q_z) / (x_z - q_z). A rounding
/// of q or x moves it by x_z / (x_z - q_z) times as much where the light is straight above.
void SoftShadow::Impl::project(const Vector3d& x, std::span<const std::uint32_t> listed,
                               Work& work) const {
  work.segments.clear();
  work.leverage.clear();
  const double off_image = rounding * flatness(x);
  const bool is_by_centre = options.method == ShadowMethod::point_silhouette;
  for (const std::uint32_t number : listed) {
    const OccluderEdge& edge = candidates[number];
    int jump = 0;
    for (std::size_t f = 0; f < 2; ++f) {
      if (edge.ways.at(f) != 0) {
        const Vector4d& plane = planes[edge.faces.at(f)];
        // A face that the centre sees shows its back to what is behind it.
        const bool is_front =
            is_by_centre ? plane[3] < 0.0 : plane.head<3>().dot(x) + plane[3] >= 0.0;
        jump += is_front ? edge.ways.at(f) : -edge.ways.at(f);
      }
    }
    if (jump == 0) {
      continue;
    }
    Vector3d a = vertices[edge.from];
    Vector3d b = vertices[edge.to];
    // What is behind the light's plane or beyond the point hides nothing.
    const double last = x.z() * (1.0 - kNearestPoint);
    if (std::max(a.z(), b.z()) < kNearestZ || std::min(a.z(), b.z()) > last) {
      continue;
    }
    const auto cut_at = [](Vector3d& outside, const Vector3d& inside, double z) {
      outside += ((z - outside.z()) / (inside.z() - outside.z())) * (inside - outside);
      outside.z() = z;
    };
    for (Vector3d* end : {&a, &b}) {
      const Vector3d& other = end == &a ? b : a;
      if (end->z() < kNearestZ) {
        cut_at(*end, other, kNearestZ);
      } else if (end->z() > last) {
        cut_at(*end, other, last);
      }
    }
    const double w_a = x.z() - a.z();
    const double w_b = x.z() - b.z();
    const Vector2d from = (a.head<2>() * x.z() - x.head<2>() * a.z()) / w_a;
    const Vector2d to = (b.head<2>() * x.z() - x.head<2>() * b.z()) / w_b;
    // 1 / (x_z - q_z) is linear along the image.
    const double lever_a = x.z() / w_a;
    const double lever_b = x.z() / w_b;
    const auto part = part_in_disk(from, to);
    if (!part) {
      // Beside the light, but a ray to it may be on the wrong side of the edge.
      const Vector2d way = to - from;
      const double s =
          std::clamp(-from.dot(way) / std::max(way.squaredNorm(), 1e-300), 0.0, 1.0);
      const double lever = lever_a + s * (lever_b - lever_a);
      if ((from + s * way).norm() < 1.0 + off_image * lever) {
        work.segments.push_back({.from = from, .to = to, .jump = jump});
        work.leverage.push_back(lever);
      }
      continue;
    }
    const double lever =
        lever_a + (lever_b > lever_a ? part->second : part->first) * (lever_b - lever_a);
    work.segments.push_back({.from = from, .to = to, .jump = jump});
    work.leverage.push_back(lever);
  }
}

double SoftShadow::Impl::traced(const Vector3d& point, int strata, std::uint64_t key,
                                std::int64_t& n_rays) const {
  static thread_local std::vector<Ray> rays;
  static thread_local std::vector<std::uint8_t> blocked;
  rays.clear();
  std::uint64_t number = 0;
  for (int i = 0; i < strata; ++i) {
    for (int j = 0; j < strata; ++j) {
      const std::uint64_t hash = hash_key(key, number++);
      const Vector2d target = point_of(light, (i + uniform_unit(hash)) / strata,
                                       (j + uniform_unit(mix_bits(hash))) / strata);
      if (const std::optional<Ray> ray = traced_ray_to(point, target)) {
        rays.push_back(*ray);
      }
    }
  }
  blocked.resize(rays.size());
  caster.are_blocked(rays, RayOrder::coherent, blocked);
  n_rays += static_cast<std::int64_t>(rays.size());
  const auto n_blocked = std::ranges::count(blocked, std::uint8_t{1});
  return 1.0 - static_cast<double>(n_blocked) / (strata * strata);
}

/// @param chosen  of the traced points, some
TracedError SoftShadow::Impl::pilot(std::span<const Vector3d> points,
                                    std::span<const std::size_t> chosen, int strata) {
  std::vector<double> errors(chosen.size(), -1.0);
  std::vector<std::int64_t> n_rays(chosen.size());
  parallel_for(chosen.size(), 1, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      const std::size_t p = chosen[i];
      const double fine = traced(points[p], kFiner * strata, ~p, n_rays[i]);
      const double coarse = traced(points[p], strata, p, n_rays[i]);
      if (std::min(fine, coarse) < 1.0 && std::max(fine, coarse) > 0.0) {
        errors[i] = std::abs(fine - coarse);
      }
    }
  });
  TracedError found{.strata = strata};
  for (const std::int64_t n : n_rays) {
    counts.n_rays += n;
  }
  std::erase_if(errors, [](double error) { return error < 0.0; });
  std::ranges::sort(errors);
  for (const double error : errors) {
    found.mean += error / static_cast<double>(errors.size());
  }
  found.n_pilot = static_cast<std::int64_t>(errors.size());
  if (!errors.empty()) {
    // At least 99 % are not above it.
    found.at_99 = errors[(errors.size() * 99 + 99) / 100 - 1];
  }
  return found;
}

/// All points that are left to rays.
void SoftShadow::Impl::trace(std::span<const Vector3d> points, std::span<LightShadow> shadows) {
  std::vector<std::size_t> left;
  for (std::size_t i = 0; i < shadows.size(); ++i) {
    if (shadows[i].kind == ShadowKind::traced) {
      left.push_back(i);
    }
  }
  if (left.empty()) {
    return;
  }
  std::vector<std::size_t> chosen;
  const std::size_t n_chosen = std::min(kPilot, left.size());
  for (std::size_t i = 0; i < n_chosen; ++i) {
    chosen.push_back(left[(i * left.size() + left.size() / 2) / n_chosen]);
  }
  TracedError found;
  if (options.strata > 0) {
    found = pilot(points, chosen, options.strata);
  } else {
    int strata = std::min(kMostStrata, strata_for(options.max_error));
    found = pilot(points, chosen, strata);
    while (std::max(found.mean, found.at_99) > options.max_error && strata < kMostStrata) {
      const double excess = std::max(found.mean, found.at_99) / options.max_error;
      strata = std::min(
          kMostStrata, std::max(strata + 1, static_cast<int>(strata * std::pow(excess, 0.67))));
      found = pilot(points, chosen, strata);
    }
  }
  counts.traced = found;
  constexpr std::size_t kTogether = 64;
  std::vector<std::int64_t> n_rays((left.size() + kTogether - 1) / kTogether);
  parallel_for(left.size(), kTogether, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      const std::size_t p = left[i];
      shadows[p].visibility =
          static_cast<float>(traced(points[p], found.strata, p, n_rays[first / kTogether]));
    }
  });
  for (const std::int64_t n : n_rays) {
    counts.n_rays += n;
  }
}

/// Whether the ray to that point may be on the wrong side of an edge by single precision's rounding.
bool SoftShadow::Impl::may_pass_edge(const Vector3d& x, const LeastCovered& least,
                                     const Work& work) const {
  const double off_image = rounding * flatness(x);
  for (std::size_t i = 0; i < work.segments.size(); ++i) {
    const double off = off_image * work.leverage[i];
    if (least.clearance < off && distance(work.segments[i], least.point) < off) {
      return true;
    }
  }
  return false;
}

void SoftShadow::Impl::find(std::size_t i, const Vector3d& point, const Vector3d& x,
                            LightShadow& shadow, Work& work) const {
  shadow = {};
  if (!(x.z() > kNearestZ)) {
    return;
  }
  if (options.method == ShadowMethod::rays) {
    shadow.kind = ShadowKind::traced;
    return;
  }
  if (buffer) {
    read_buffer(x, shadow, work);
    return;
  }
  const ShadowGrid::Cell cell = grid->at(x);
  const double inverse_z = 1.0 / x.z();
  if (is_cut || inverse_z < cell.curved_inverse_z) {
    shadow.kind = ShadowKind::traced;
    return;
  }
  project(x, cell.edges, work);
  shadow.visibility = 1.0F;
  if (work.segments.empty() && inverse_z >= cell.nearest_inverse_z) {
    return;
  }
  std::optional<LeastCovered> least;
  if (static_cast<int>(work.segments.size()) <= options.most_edges) {
    least = outline.least_covered(work.segments, kIgnoredArea, work.scratch);
  }
  if (!least) {
    shadow.kind = ShadowKind::traced;
    return;
  }
  shadow.visibility = static_cast<float>(least->fraction);
  shadow.kind = least->n_segments == 0 ? ShadowKind::whole
                : least->is_chord      ? ShadowKind::edge
                                       : ShadowKind::outline;
  decide(i, point, x, *least, shadow, work);
  if (options.method == ShadowMethod::point_silhouette && least->n_segments > 0) {
    shadow.kind = ShadowKind::assumed;
  }
}

/// Whether the least covered part is seen: by a ray in single precision where that can tell.
void SoftShadow::Impl::decide(std::size_t i, const Vector3d& point, const Vector3d& x,
                              const LeastCovered& least, LightShadow& shadow,
                              Work& work) const {
  std::optional<double> end;
  if (!may_pass_edge(x, least, work)) {
    end = ends->end_if_sure(point, x, least.point);
  }
  if (end) {
    const Vector3d to = light.to_world({least.point.x(), least.point.y(), 0.0});
    work.rays.push_back(
        {.origin = point, .direction = to - point, .t_min = 0.0, .t_max = 1.0 - *end / x.z()});
    work.of_ray.push_back(i);
    return;
  }
  ++work.counts.n_double_rays;
  const Passage passage = ends->passage(point, x, least.point, least.clearance);
  if (passage == Passage::hidden) {
    shadow.visibility = 0.0F;
  } else if (passage == Passage::unknown) {
    shadow.kind = ShadowKind::unsure;
  }
}

void SoftShadow::Impl::read_buffer(const Vector3d& x, LightShadow& shadow, Work& work) const {
  const DBuffer::Value value = buffer->at(x);
  shadow.visibility = static_cast<float>(value.visibility);
  shadow.kind = value.is_assumed ? ShadowKind::assumed : ShadowKind::whole;
  work.counts.n_clamped += value.is_clamped ? 1 : 0;
}

void SoftShadow::Impl::evaluate(std::span<const Vector3d> points,
                                std::span<LightShadow> shadows, Work& work) const {
  work.rays.clear();
  work.of_ray.clear();
  for (std::size_t i = 0; i < points.size(); ++i) {
    find(i, points[i], work.receivers[i], shadows[i], work);
  }
  work.blocked.resize(work.rays.size());
  caster.are_blocked(work.rays, RayOrder::coherent, work.blocked);
  work.counts.n_rays += static_cast<std::int64_t>(work.rays.size());
  for (std::size_t i = 0; i < work.rays.size(); ++i) {
    if (work.blocked[i] != 0) {
      shadows[work.of_ray[i]].visibility = 0.0F;
    }
  }
}

SoftShadow::SoftShadow(const Scene& scene, const OccluderEdges& edges, const RayCaster& caster,
                       FlatLight light, const SoftShadowOptions& options,
                       const std::string& where)
    : impl_(std::make_unique<Impl>(scene, edges, caster, std::move(light), options)) {
  HAARLIGHT_EXPECTS(scene.instances.empty(), "instances are expanded");
  HAARLIGHT_EXPECTS(options.grid > 0 && options.strata >= 0 && options.most_edges >= 0 &&
                        options.max_error > 0.0,
                    "a grid has cells, a traced point rays");
  const auto begin = std::chrono::steady_clock::now();
  impl_->set_frame();
  if (is_buffered(options.method)) {
    const bool is_paper = options.method == ShadowMethod::paper;
    impl_->buffer.emplace(
        scene, edges, impl_->light, impl_->vertices, impl_->planes,
        DBufferOptions{.texels = options.texels,
                       .test = is_paper ? VolumeTest::farthest : VolumeTest::by_piece,
                       .form = options.form},
        where);
    const DBufferCounts& drawn = impl_->buffer->counts();
    impl_->counts.n_edges = static_cast<std::int64_t>(edges.edges.size());
    impl_->counts.n_candidates = drawn.n_umbra_edges + drawn.n_penumbra_edges;
    impl_->counts.n_without_extrusion = drawn.n_without_extrusion;
  } else if (options.method != ShadowMethod::rays) {
    impl_->set_candidates();
    impl_->set_cut();
    impl_->ends.emplace(scene, edges, impl_->vertices, impl_->planes, caster, impl_->light);
  }
  impl_->counts.grid_seconds += seconds_since(begin);
}

SoftShadow::~SoftShadow() = default;
SoftShadow::SoftShadow(SoftShadow&&) noexcept = default;
SoftShadow& SoftShadow::operator=(SoftShadow&&) noexcept = default;

const FlatLight& SoftShadow::light() const noexcept { return impl_->light; }
const ShadowCounts& SoftShadow::counts() const noexcept { return impl_->counts; }

void SoftShadow::evaluate(std::span<const Vector3d> points, std::span<LightShadow> shadows) {
  HAARLIGHT_EXPECTS(points.size() == shadows.size(), "a shadow for each point");
  Impl& impl = *impl_;
  impl.forget_last();
  auto begin = std::chrono::steady_clock::now();
  std::vector<Vector3d> receivers(points.size());
  parallel_for(points.size(), kPointsTogether, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      receivers[i] = impl.light.to_light(points[i]);
    }
  });
  if (impl.buffer) {
    const std::int64_t before = impl.buffer->counts().n_rays;
    impl.buffer->draw(impl.caster, receivers);
    impl.counts.n_rays += impl.buffer->counts().n_rays - before;
  } else if (impl.options.method != ShadowMethod::rays) {
    impl.provide_grid(receivers);
    impl.ends->look_about_light(receivers);
  }
  impl.counts.grid_seconds += seconds_since(begin);
  begin = std::chrono::steady_clock::now();
  const std::size_t n_chunks = (points.size() + kPointsTogether - 1) / kPointsTogether;
  std::vector<ShadowCounts> counts(n_chunks);
  parallel_for(points.size(), kPointsTogether, [&](std::size_t first, std::size_t last) {
    static thread_local Impl::Work work;
    work.counts = {};
    work.receivers.assign(receivers.begin() + static_cast<std::ptrdiff_t>(first),
                          receivers.begin() + static_cast<std::ptrdiff_t>(last));
    impl.evaluate(points.subspan(first, last - first), shadows.subspan(first, last - first),
                  work);
    counts[first / kPointsTogether] = work.counts;
  });
  for (const ShadowCounts& part : counts) {
    impl.counts.n_rays += part.n_rays;
    impl.counts.n_double_rays += part.n_double_rays;
    impl.counts.n_clamped += part.n_clamped;
  }
  impl.trace(points, shadows);
  for (const LightShadow& shadow : shadows) {
    ++impl.counts.by_kind.at(index(shadow.kind));
    impl.counts.n_penumbra += shadow.visibility > 0.0F && shadow.visibility < 1.0F ? 1 : 0;
  }
  impl.counts.shadow_seconds += seconds_since(begin);
}

}  // namespace haarlight::render
