// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/rays/ray_caster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include <Eigen/Geometry>
#ifdef HAARLIGHT_EMBREE4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

// Embree 4 asks the same questions by other words.
#ifdef HAARLIGHT_EMBREE4
void ask_intersect(RTCScene scene, RTCRayHit& ray) { rtcIntersect1(scene, &ray); }
void ask_occluded(const int* valid, RTCScene scene, RTCRay16& rays) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
  rtcOccluded16(valid, scene, &rays, &arguments);
}
#else
void ask_intersect(RTCScene scene, RTCRayHit& ray) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene, &context, &ray);
}
void ask_occluded(const int* valid, RTCScene scene, RTCRay16& rays) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcOccluded16(valid, scene, &context, &rays);
}
#endif

struct DeviceRelease {
  void operator()(RTCDevice device) const noexcept { rtcReleaseDevice(device); }
};
struct SceneRelease {
  void operator()(RTCScene scene) const noexcept { rtcReleaseScene(scene); }
};
using DeviceHandle = std::unique_ptr<std::remove_pointer_t<RTCDevice>, DeviceRelease>;
using SceneHandle = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneRelease>;

constexpr int kPacket = 16;
/// 64 single-precision roundings: of the vertices, a ray's origin and Embree's own sums.
constexpr double kOffset = 0x1p-18;

/// Middle of the vertices' bounding box.
Vector3d middle_of(const Scene& scene) {
  Eigen::AlignedBox3d box;
  for (const Mesh& mesh : scene.meshes) {
    for (const Vector3d& vertex : mesh.vertices) {
      box.extend(vertex);
    }
  }
  return box.isEmpty() ? Vector3d::Zero().eval() : box.center();
}

}  // namespace

struct RayCaster::Impl {
  DeviceHandle device;
  SceneHandle scene;
  std::vector<Mesh> meshes;            ///< a hit is told in double precision
  Vector3d middle = Vector3d::Zero();  ///< Embree's origin: scenes far from ours lose nothing
  double offset_mm = 0.0;

  void build(const Scene& source);
};

void RayCaster::Impl::build(const Scene& source) {
  // Without a number of threads: one given here would hold for every loop of the process.
  device.reset(rtcNewDevice(nullptr));
  if (device == nullptr) {
    throw Error(
        "Embree does not start (code " + std::to_string(rtcGetDeviceError(nullptr)) + ")",
        "ray caster", "Embree 3 needs a processor with SSE2 and memory for its tables");
  }
  scene.reset(rtcNewScene(device.get()));
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(scene.get(), RTC_BUILD_QUALITY_HIGH);
  middle = middle_of(source);
  double reach = 0.0;
  for (const Mesh& mesh : source.meshes) {
    HAARLIGHT_EXPECTS(mesh.normals.empty() || mesh.normals.size() == mesh.vertices.size(),
                      "no normals, or one a vertex");
    RTCGeometry geometry = rtcNewGeometry(device.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float),
        std::max<std::size_t>(1, mesh.vertices.size())));
    auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned),
        std::max<std::size_t>(1, mesh.triangles.size())));
    HAARLIGHT_EXPECTS(vertices != nullptr && indices != nullptr, "memory for the mesh");
    std::fill_n(vertices, 3, 0.0F);
    std::fill_n(indices, 3, 0U);
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
      const Vector3d vertex = mesh.vertices[i] - middle;
      reach = std::max(reach, vertex.norm());
      for (int c = 0; c < 3; ++c) {
        vertices[3 * i + static_cast<std::size_t>(c)] = static_cast<float>(vertex[c]);
      }
    }
    const int n_vertices = static_cast<int>(mesh.vertices.size());
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      for (int c = 0; c < 3; ++c) {
        const int index = mesh.triangles[i][c];
        HAARLIGHT_EXPECTS(index >= 0 && index < n_vertices, "triangle indices within the mesh");
        indices[3 * i + static_cast<std::size_t>(c)] = static_cast<unsigned>(index);
      }
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene.get(), geometry);
    rtcReleaseGeometry(geometry);
  }
  meshes = source.meshes;
  offset_mm = kOffset * reach;
  rtcCommitScene(scene.get());
  const RTCError error = rtcGetDeviceError(device.get());
  if (error != RTC_ERROR_NONE) {
    throw Error("Embree cannot build the scene (code " + std::to_string(error) + ")",
                "ray caster", "check the mesh for coordinates beyond 1e18 mm, and the memory");
  }
}

RayCaster::RayCaster(const Scene& scene) : impl_(std::make_unique<Impl>()) {
  impl_->build(scene);
}
RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

double RayCaster::ray_offset_mm() const noexcept { return impl_->offset_mm; }

const std::vector<Mesh>& RayCaster::meshes() const noexcept { return impl_->meshes; }

std::optional<Hit> RayCaster::intersect(const Vector3d& origin, const Vector3d& direction,
                                        double min_distance_mm) const {
  RTCRayHit ray{};
  const Vector3d from = origin - impl_->middle;
  ray.ray.org_x = static_cast<float>(from.x());
  ray.ray.org_y = static_cast<float>(from.y());
  ray.ray.org_z = static_cast<float>(from.z());
  ray.ray.dir_x = static_cast<float>(direction.x());
  ray.ray.dir_y = static_cast<float>(direction.y());
  ray.ray.dir_z = static_cast<float>(direction.z());
  ray.ray.tnear = static_cast<float>(min_distance_mm);
  ray.ray.tfar = std::numeric_limits<float>::infinity();
  ray.ray.mask = ~0U;
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  ask_intersect(impl_->scene.get(), ray);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
    return std::nullopt;
  }
  const Mesh& mesh = impl_->meshes[ray.hit.geomID];
  const Eigen::Vector3i& t = mesh.triangles[ray.hit.primID];
  const auto corner = [&](int i) -> const Vector3d& {
    return mesh.vertices[static_cast<std::size_t>(t[i])];
  };
  Hit hit;
  hit.mesh = static_cast<int>(ray.hit.geomID);
  hit.triangle = static_cast<int>(ray.hit.primID);
  hit.material = mesh.material;
  // The triangle is from Embree; the point is the ray's intersection with that triangle's plane
  // in double, unless the ray grazes it.
  const Vector3d flat = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
  const double slope = flat.dot(direction);
  const double u = ray.hit.u;
  const double v = ray.hit.v;
  const double t_plane = flat.dot(corner(0) - origin) / slope;
  const double t_float = ray.ray.tfar;
  if (std::abs(slope) > 1e-6 &&
      std::abs(t_plane - t_float) <= 1e-4 * t_float + impl_->offset_mm) {
    hit.distance_mm = t_plane;
    hit.point = origin + t_plane * direction;
  } else {
    hit.point = (1.0 - u - v) * corner(0) + u * corner(1) + v * corner(2);
    hit.distance_mm = (hit.point - origin).dot(direction);
  }
  hit.flat_normal = slope > 0.0 ? Vector3d(-flat) : flat;
  hit.normal = hit.flat_normal;
  if (!mesh.normals.empty()) {
    const auto normal_at = [&](int i) -> const Vector3d& {
      return mesh.normals[static_cast<std::size_t>(t[i])];
    };
    const Vector3d smooth = (1.0 - u - v) * normal_at(0) + u * normal_at(1) + v * normal_at(2);
    const double length = smooth.norm();
    if (length > 1e-12) {
      hit.normal = smooth / (smooth.dot(hit.flat_normal) < 0.0 ? -length : length);
    }
  }
  return hit;
}

void RayCaster::are_blocked(const Vector3d& from, std::span<const Vector3d> to,
                            std::span<std::uint8_t> blocked) const {
  HAARLIGHT_EXPECTS(to.size() == blocked.size(), "one answer per target");
  alignas(64) std::array<int, kPacket> valid{};
  alignas(64) RTCRay16 rays;
  const Vector3d origin = from - impl_->middle;
  for (std::size_t begin = 0; begin < to.size(); begin += kPacket) {
    const std::size_t n = std::min<std::size_t>(kPacket, to.size() - begin);
    for (std::size_t i = 0; i < kPacket; ++i) {
      const Vector3d& target = to[begin + std::min(i, n - 1)];
      const Vector3d way = target - from;
      const double shortened = impl_->offset_mm / std::max(way.norm(), 1e-300);
      valid.at(i) = i < n && shortened < 0.5 ? -1 : 0;
      rays.org_x[i] = static_cast<float>(origin.x());
      rays.org_y[i] = static_cast<float>(origin.y());
      rays.org_z[i] = static_cast<float>(origin.z());
      rays.dir_x[i] = static_cast<float>(way.x());
      rays.dir_y[i] = static_cast<float>(way.y());
      rays.dir_z[i] = static_cast<float>(way.z());
      rays.tnear[i] = static_cast<float>(shortened);
      rays.tfar[i] = static_cast<float>(1.0 - shortened);
      rays.time[i] = 0.0F;
      rays.mask[i] = ~0U;
      rays.id[i] = 0;
      rays.flags[i] = 0;
    }
    ask_occluded(valid.data(), impl_->scene.get(), rays);
    for (std::size_t i = 0; i < n; ++i) {
      // Embree marks a blocked ray by tfar = -infinity.
      blocked[begin + i] = valid.at(i) != 0 && rays.tfar[i] < 0.0F ? 1 : 0;
    }
  }
}

}  // namespace haarlight::render
