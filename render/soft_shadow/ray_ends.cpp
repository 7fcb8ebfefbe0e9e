// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/ray_ends.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

#include "render/rays/ray_offset.h"
#include "render/soft_shadow/shadow_grid.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector4d;

/// Of a face's offset: a point that is off by just that is not near it.
constexpr double kWithin = 0.999;

/// What positions are off by in double precision, of their size: a turn into the light frame, a plane's
/// normal, and a margin.
constexpr double kOfPosition = 0x1p-48;

/// The same of boxes, of the scene's and the ray's size.
constexpr double kOfBox = 0x1p-40;

Vector3d on_plane(const Vector2d& target) { return {target.x(), target.y(), 0.0}; }

/// Whether a box and that about `middle` overlap.
auto reaching(const Vector3d& middle, double half) {
  std::array<float, 3> low;
  std::array<float, 3> high;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double at = middle[static_cast<Eigen::Index>(axis)];
    const double padded = half + 2.0 * kRounding * (std::abs(at) + half);
    low.at(axis) = static_cast<float>(at - padded);
    high.at(axis) = static_cast<float>(at + padded);
  }
  // Without branches: which of them holds cannot be predicted.
  return
      [low, high](const std::array<float, 3>& box_low, const std::array<float, 3>& box_high) {
        unsigned n_reached = 0;
        for (std::size_t axis = 0; axis < 3; ++axis) {
          n_reached += static_cast<unsigned>(box_low[axis] <= high[axis]) +
                       static_cast<unsigned>(box_high[axis] >= low[axis]);
        }
        return n_reached == 6;
      };
}

/// Whether the way meets a box that is `padding` wider on each side.
auto crossing(const Vector3d& from, const Vector3d& way, double padding) {
  const auto inverse = [](double d) { return 1.0 / (std::abs(d) > 1e-300 ? d : 1e-300); };
  return [from, padding, over = Vector3d(way.unaryExpr(inverse))](
             const std::array<float, 3>& low, const std::array<float, 3>& high) {
    double first = 0.0;
    double last = 1.0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto at = static_cast<Eigen::Index>(axis);
      const double s0 = (low[axis] - padding - from[at]) * over[at];
      const double s1 = (high[axis] + padding - from[at]) * over[at];
      first = std::max(first, std::min(s0, s1));
      last = std::min(last, std::max(s0, s1));
    }
    return first <= last;
  };
}

}  // namespace

RayEnds::RayEnds(const Scene& scene, const OccluderEdges& edges,
                 std::span<const Vector3d> vertices, std::span<const Vector4d> planes,
                 const RayCaster& caster, const FlatLight& light)
    : edges_(edges), vertices_(vertices), planes_(planes), caster_(caster), light_(light) {
  double most_mm = 0.0;
  for (const float of_face : edges.roundings_mm) {
    most_mm = std::max(most_mm, static_cast<double>(of_face));
  }
  for (const Sphere& sphere : scene.spheres) {
    most_mm = std::max(most_mm, kOfSphere * sphere.radius_mm);
  }
  for (const Disk& disk : scene.disks) {
    most_mm = std::max(most_mm, kOfDisk * disk.radius_mm);
  }
  of_surfaces_ =
      kRounding * (kOfDistance * caster.scene_radius_mm() + most_mm) / light.radius_mm;
}

bool RayEnds::is_before_light(std::uint32_t face) const {
  const OccluderFace& own = edges_.faces[face];
  return static_cast<int>(own.mesh) != light_.surface &&
         std::ranges::any_of(own.corners, [this](std::uint32_t corner) {
           return vertices_[corner].z() >= kNearestZ;
         });
}

double RayEnds::slack(double length) const {
  return of_surfaces_ + kOfWay * kRounding * length;
}

void RayEnds::look_about_light(std::span<const Vector3d> receivers) {
  double farthest = 1.0;  // of the light's points
  double flattest = 1.0;  // of rays: length over height
  for (const Vector3d& x : receivers) {
    // Nearer to the light's plane, no ray is sure.
    if (x.z() > 4.0 * of_surfaces_) {
      const double length = x.lpNorm<1>() + 1.0;
      farthest = std::max(farthest, length);
      flattest = std::max(flattest, length / x.z());
    }
  }
  const double off = slack(farthest);
  const double high = kOfWay * kRounding * farthest + 3.0 * off;
  const double half = 1.0 + high * flattest + off;
  double free = half;
  const bool is_covered = edges_.tree.any(
      reaching(light_.centre, light_.radius_mm * (half + high)), [&](std::uint32_t face) {
        Vector3d least = Vector3d::Constant(std::numeric_limits<double>::infinity());
        Vector3d most = -least;
        for (const std::uint32_t corner : edges_.faces[face].corners) {
          least = least.cwiseMin(vertices_[corner]);
          most = most.cwiseMax(vertices_[corner]);
        }
        if (is_before_light(face) && least.z() <= high + off) {
          free = std::min(free, std::max({0.0, least.x(), -most.x(), least.y(), -most.y()}));
        }
        return !(free > 0.0);
      });
  free_half_ = is_covered ? 0.0 : free;
}

/// The least distance from a face's three sides, in its plane; < 0: beyond one.
double RayEnds::room_within(std::uint32_t face, const Vector3d& q) const {
  const std::array<std::uint32_t, 3>& corners = edges_.faces[face].corners;
  const Vector3d normal = planes_[face].head<3>();
  double room = std::numeric_limits<double>::infinity();
  for (std::size_t c = 0; c < 3; ++c) {
    const Vector3d& from = vertices_[corners.at(c)];
    const Vector3d side = vertices_[corners.at((c + 1) % 3)] - from;
    room = std::min(room, normal.dot(side.cross(q - from)) / side.norm());
  }
  return room;
}

bool RayEnds::is_about_point(std::uint32_t face, double from_middle_mm,
                             const Vector3d& x) const {
  const Vector4d& plane = planes_[face];
  const double off = std::abs(plane.head<3>().dot(x) + plane[3]);
  if (off >= of_surfaces_) {
    return false;
  }
  // RayCaster::offset_mm()
  const double least =
      kRounding * (kOfDistance * from_middle_mm + edges_.roundings_mm[face]) / light_.radius_mm;
  return off < kWithin * least && room_within(face, x) > -least;
}

bool RayEnds::has_face_about_target(const Vector3d& x, const Vector3d& target) const {
  const Vector3d way = x - target;
  const double off = slack(way.norm());
  const double end = kOfWay * kRounding * x.z() + 2.0 * off;
  const Vector3d last = target + (end + off) / x.z() * way;
  const Vector3d low = target.cwiseMin(last) - Vector3d::Constant(off);
  const Vector3d high = target.cwiseMax(last) + Vector3d::Constant(off);
  const Vector3d middle = light_.to_world(0.5 * (target + last));
  const double half_mm = light_.radius_mm * (0.5 * (last - target).norm() + off);
  return edges_.tree.any(reaching(middle, half_mm), [&](std::uint32_t face) {
    const Vector4d& plane = planes_[face];
    const double at_target = plane.head<3>().dot(target) + plane[3];
    const double at_last = plane.head<3>().dot(last) + plane[3];
    if (!is_before_light(face) || std::min(at_target, at_last) > off ||
        std::max(at_target, at_last) < -off) {
      return false;
    }
    const auto [a, b, c] = edges_.faces[face].corners;
    const Vector3d least = vertices_[a].cwiseMin(vertices_[b]).cwiseMin(vertices_[c]);
    const Vector3d most = vertices_[a].cwiseMax(vertices_[b]).cwiseMax(vertices_[c]);
    return (least.array() <= high.array()).all() && (most.array() >= low.array()).all();
  });
}

std::optional<double> RayEnds::end_if_sure(const Vector3d& point, const Vector3d& x,
                                           const Vector2d& target) const {
  const double length = (x - on_plane(target)).norm();
  const double off = slack(length);
  const double end = kOfWay * kRounding * x.z() + 2.0 * off;
  if (!(x.z() > 2.0 * end)) {
    return std::nullopt;
  }
  const double half = 1.0 + (end + off) * length / x.z() + off;
  if (half >= free_half_ && has_face_about_target(x, on_plane(target))) {
    return std::nullopt;
  }
  const double from_middle_mm = (point - caster_.scene_middle()).norm();
  const bool has_face = edges_.tree.any(
      reaching(point, of_surfaces_ * light_.radius_mm),
      [&](std::uint32_t face) { return is_about_point(face, from_middle_mm, x); });
  return has_face ? std::nullopt : std::optional(end);
}

Passage RayEnds::past(std::uint32_t face, const Vector3d& x, const Vector3d& target,
                      double clearance) const {
  const Vector4d& plane = planes_[face];
  const auto [a, b, c] = edges_.faces[face].corners;
  const Vector3d& origin = vertices_[a];
  const double size =
      1.0 + std::max({x.norm(), origin.norm(), vertices_[b].norm(), vertices_[c].norm()});
  const double off = kOfPosition * size;
  // What turns the normal: a corner that is off, over the triangle's height.
  const double longest =
      std::max({(vertices_[b] - origin).norm(), (vertices_[c] - vertices_[b]).norm(),
                (origin - vertices_[c]).norm()});
  const double height = (vertices_[b] - origin).cross(vertices_[c] - origin).norm() / longest;
  const double off_plane = off * (1.0 + std::max((x - origin).norm(), longest) / height);
  const double at_x = plane.head<3>().dot(x) + plane[3];
  const double at_target = plane.head<3>().dot(target) + plane[3];
  if (std::abs(at_x) <= off_plane) {
    return room_within(face, x) > -off_plane ? Passage::unknown : Passage::open;
  }
  const double between = at_x - at_target;
  if (std::abs(between) <= off_plane) {
    return Passage::open;  // it stays on its side
  }
  const double s = at_x / between;
  const double off_s = 4.0 * off_plane / std::abs(between);
  const double z = x.z() * (-at_target / between);
  const double off_z = x.z() * off_s;
  if (s < 0.0 || z < kNearestZ - off_z) {
    return Passage::open;
  }
  const Vector3d way = target - x;
  const double off_side = off + off_s * way.norm();
  const double room = room_within(face, x + s * way);
  if (room < -off_side) {
    return Passage::open;
  }
  if (z < kNearestZ + off_z) {
    return Passage::unknown;
  }
  // Where it may pass a side, that is none of a silhouette: these are farther away.
  const bool is_within = room > off_side || off_side * way.norm() < clearance * s * x.z();
  return is_within ? Passage::hidden : Passage::unknown;
}

Passage RayEnds::passage(const Vector3d& point, const Vector3d& x, const Vector2d& target,
                         double clearance) const {
  const Vector3d end = on_plane(target);
  const Vector3d way = light_.to_world(end) - point;
  const double padding = kOfBox * (caster_.scene_radius_mm() + way.norm());
  bool is_unknown = false;
  const bool is_hidden =
      edges_.tree.any(crossing(point, way, padding), [&](std::uint32_t face) {
        const Passage one =
            is_before_light(face) ? past(face, x, end, clearance) : Passage::open;
        is_unknown = is_unknown || one == Passage::unknown;
        return one == Passage::hidden;
      });
  return is_hidden ? Passage::hidden : is_unknown ? Passage::unknown : Passage::open;
}

}  // namespace haarlight::render
