// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/rays/ray_caster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
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
RTCRayQueryFlags flags_of(RayOrder order) {
  return order == RayOrder::coherent ? RTC_RAY_QUERY_FLAG_COHERENT
                                     : RTC_RAY_QUERY_FLAG_INCOHERENT;
}
void ask_intersect(RTCScene scene, RTCRayHit& ray) { rtcIntersect1(scene, &ray); }
void ask_occluded(RTCScene scene, RTCRay& ray) { rtcOccluded1(scene, &ray); }
void ask_intersect(const int* valid, RTCScene scene, RayOrder order, RTCRayHit16& rays) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = flags_of(order);
  rtcIntersect16(valid, scene, &rays, &arguments);
}
void ask_occluded(const int* valid, RTCScene scene, RayOrder order, RTCRay16& rays) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.flags = flags_of(order);
  rtcOccluded16(valid, scene, &rays, &arguments);
}
#else
RTCIntersectContext context_of(RayOrder order) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = order == RayOrder::coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT
                                              : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  return context;
}
void ask_intersect(RTCScene scene, RTCRayHit& ray) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene, &context, &ray);
}
void ask_occluded(RTCScene scene, RTCRay& ray) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(scene, &context, &ray);
}
void ask_intersect(const int* valid, RTCScene scene, RayOrder order, RTCRayHit16& rays) {
  RTCIntersectContext context = context_of(order);
  rtcIntersect16(valid, scene, &context, &rays);
}
void ask_occluded(const int* valid, RTCScene scene, RayOrder order, RTCRay16& rays) {
  RTCIntersectContext context = context_of(order);
  rtcOccluded16(valid, scene, &context, &rays);
}
#endif

struct DeviceRelease {
  void operator()(RTCDevice device) const noexcept { rtcReleaseDevice(device); }
};
struct SceneRelease {
  void operator()(RTCScene scene) const noexcept { rtcReleaseScene(scene); }
};
struct GeometryRelease {
  void operator()(RTCGeometry geometry) const noexcept { rtcReleaseGeometry(geometry); }
};
using GeometryHandle = std::unique_ptr<std::remove_pointer_t<RTCGeometry>, GeometryRelease>;
using DeviceHandle = std::unique_ptr<std::remove_pointer_t<RTCDevice>, DeviceRelease>;
using SceneHandle = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneRelease>;

constexpr std::size_t kPacket = 16;
using Valid = std::array<int, kPacket>;
/// 64 single-precision roundings: of the vertices, a ray's origin and Embree's own sums.
constexpr double kOffset = 0x1p-18;

/// Texture coordinates of a point on the plane of triangle `t`: by its barycentric coordinates,
/// which are ratios of areas to that of the triangle.
Eigen::Vector2d uv_at(const Mesh& mesh, const Eigen::Vector3i& t, const Vector3d& point) {
  const auto index = [&](int i) { return static_cast<std::size_t>(t[i]); };
  const Vector3d& first = mesh.vertices[index(0)];
  const Vector3d to_second = mesh.vertices[index(1)] - first;
  const Vector3d to_third = mesh.vertices[index(2)] - first;
  const Vector3d to_point = point - first;
  const Vector3d area = to_second.cross(to_third);
  const double u = to_point.cross(to_third).dot(area) / area.squaredNorm();
  const double v = to_second.cross(to_point).dot(area) / area.squaredNorm();
  return mesh.uvs[index(0)] + u * (mesh.uvs[index(1)] - mesh.uvs[index(0)]) +
         v * (mesh.uvs[index(2)] - mesh.uvs[index(0)]);
}

/// Middle of the surfaces' bounding box.
Vector3d middle_of(const Scene& scene) {
  Eigen::AlignedBox3d box;
  for (const Mesh& mesh : scene.meshes) {
    for (const Vector3d& vertex : mesh.vertices) {
      box.extend(vertex);
    }
  }
  const auto extend = [&box](const auto& round) {
    const Vector3d reach = Vector3d::Constant(round.radius_mm);
    box.extend((round.centre - reach).eval());
    box.extend((round.centre + reach).eval());
  };
  for (const Sphere& sphere : scene.spheres) {
    extend(sphere);
  }
  for (const Disk& disk : scene.disks) {
    extend(disk);
  }
  return box.isEmpty() ? Vector3d::Zero().eval() : box.center();
}

/// Its origin seen from `middle`. Embree reads four floats at once, which stalls where they have
/// just been written one by one.
RTCRay single(const Ray& ray, const Vector3d& middle) {
  using Float4 = float __attribute__((vector_size(16)));
  const Float4 origin = {static_cast<float>(ray.origin.x() - middle.x()),
                         static_cast<float>(ray.origin.y() - middle.y()),
                         static_cast<float>(ray.origin.z() - middle.z()),
                         static_cast<float>(ray.t_min)};
  const Float4 direction = {static_cast<float>(ray.direction.x()),
                            static_cast<float>(ray.direction.y()),
                            static_cast<float>(ray.direction.z()), 0.0F};
  RTCRay asked;
  static_assert(offsetof(RTCRay, tnear) == 12 && offsetof(RTCRay, dir_x) == 16 &&
                offsetof(RTCRay, time) == 28);
  std::memcpy(&asked.org_x, &origin, sizeof origin);
  std::memcpy(&asked.dir_x, &direction, sizeof direction);
  asked.tfar = static_cast<float>(ray.t_max);
  asked.mask = ~0U;
  asked.id = 0;
  asked.flags = 0;
  return asked;
}

/// One of a packet, its origin seen from `middle`.
void put(const Ray& ray, const Vector3d& middle, std::size_t i, RTCRay16& rays) {
  rays.org_x[i] = static_cast<float>(ray.origin.x() - middle.x());
  rays.org_y[i] = static_cast<float>(ray.origin.y() - middle.y());
  rays.org_z[i] = static_cast<float>(ray.origin.z() - middle.z());
  rays.dir_x[i] = static_cast<float>(ray.direction.x());
  rays.dir_y[i] = static_cast<float>(ray.direction.y());
  rays.dir_z[i] = static_cast<float>(ray.direction.z());
  rays.tnear[i] = static_cast<float>(ray.t_min);
  rays.tfar[i] = static_cast<float>(ray.t_max);
  rays.time[i] = 0.0F;
  rays.mask[i] = ~0U;
  rays.id[i] = 0;
  rays.flags[i] = 0;
}

/// Puts up to 16 of the rays from `begin` into a packet. @return how many
std::size_t fill(std::span<const Ray> rays, std::size_t begin, const Vector3d& middle,
                 Valid& valid, RTCRay16& packet) {
  const std::size_t n = std::min(kPacket, rays.size() - begin);
  for (std::size_t i = 0; i < n; ++i) {
    put(rays[begin + i], middle, i, packet);
  }
  for (std::size_t i = 0; i < kPacket; ++i) {
    valid.at(i) = i < n ? -1 : 0;
  }
  for (std::size_t i = n; i < kPacket; ++i) {
    put(rays[begin], middle, i, packet);
  }
  return n;
}

}  // namespace

struct RayCaster::Impl {
  explicit Impl(const Scene& scene_to_cast)
      : meshes(scene_to_cast.meshes),
        spheres(scene_to_cast.spheres),
        disks(scene_to_cast.disks) {}

  // The scene's own: a hit is told in double precision, and Embree reads the indices.
  const std::vector<Mesh>& meshes;
  const std::vector<Sphere>& spheres;
  const std::vector<Disk>& disks;
  std::vector<std::uint8_t> needs_uvs;  ///< by mesh: whether its material has a texture
  DeviceHandle device;
  SceneHandle scene;
  Vector3d middle = Vector3d::Zero();  ///< Embree's origin: scenes far from ours lose nothing
  double offset_mm = 0.0;
  double radius_mm = 0.0;

  void build(const Scene& source);
  /// Adds a sphere or a disk as the surface after those before it.
  template <class Round>
  void add_round(const Round& round, std::size_t surface);
  [[nodiscard]] Hit sphere_at(const Ray& ray, const RawHit& raw) const;
  [[nodiscard]] Hit disk_at(const Ray& ray, const RawHit& raw) const;
};

template <class Round>
void RayCaster::Impl::add_round(const Round& round, std::size_t surface) {
  constexpr bool kIsDisk = std::is_same_v<Round, Disk>;
  const GeometryHandle geometry(
      rtcNewGeometry(device.get(), kIsDisk ? RTC_GEOMETRY_TYPE_ORIENTED_DISC_POINT
                                           : RTC_GEOMETRY_TYPE_SPHERE_POINT));
  auto* numbers = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry.get(), RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, 4 * sizeof(float), 1));
  HAARLIGHT_EXPECTS(numbers != nullptr, "an Embree with spheres and disks");
  const Vector3d centre = round.centre - middle;
  for (int c = 0; c < 3; ++c) {
    *numbers++ = static_cast<float>(centre[c]);
  }
  *numbers = static_cast<float>(round.radius_mm);
  if constexpr (kIsDisk) {
    auto* normal = static_cast<float*>(rtcSetNewGeometryBuffer(
        geometry.get(), RTC_BUFFER_TYPE_NORMAL, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), 1));
    HAARLIGHT_EXPECTS(normal != nullptr, "an Embree with disks");
    for (int c = 0; c < 3; ++c) {
      *normal++ = static_cast<float>(round.normal[c]);
    }
  }
  rtcCommitGeometry(geometry.get());
  rtcAttachGeometryByID(scene.get(), geometry.get(), static_cast<unsigned>(surface));
  radius_mm = std::max(radius_mm, centre.norm() + round.radius_mm);
}

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
  needs_uvs.assign(meshes.size(), 0);
  for (std::size_t m = 0; m < meshes.size(); ++m) {
    const Mesh& mesh = meshes[m];
    HAARLIGHT_EXPECTS(mesh.normals.empty() || mesh.normals.size() == mesh.vertices.size(),
                      "no normals, or one a vertex");
    HAARLIGHT_EXPECTS(mesh.uvs.empty() || mesh.uvs.size() == mesh.vertices.size(),
                      "no texture coordinates, or one pair a vertex");
    const auto material = static_cast<std::size_t>(mesh.material);
    needs_uvs[m] = !mesh.uvs.empty() && material < source.materials.size() &&
                           !source.materials[material].kd_texture.file.empty()
                       ? 1
                       : 0;
    const int n_vertices = static_cast<int>(mesh.vertices.size());
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      HAARLIGHT_EXPECTS(triangle.minCoeff() >= 0 && triangle.maxCoeff() < n_vertices,
                        "triangle indices within the mesh");
    }
    if (mesh.vertices.empty()) {
      continue;
    }
    const GeometryHandle geometry(rtcNewGeometry(device.get(), RTC_GEOMETRY_TYPE_TRIANGLE));
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), mesh.vertices.size()));
    HAARLIGHT_EXPECTS(vertices != nullptr, "memory for the mesh");
    for (const Vector3d& corner : mesh.vertices) {
      const Vector3d vertex = corner - middle;
      radius_mm = std::max(radius_mm, vertex.norm());
      for (int c = 0; c < 3; ++c) {
        *vertices++ = static_cast<float>(vertex[c]);
      }
    }
    if (mesh.triangles.empty()) {
      continue;
    }
    // The scene's, not a copy: they are not negative, so that their bits are those of unsigned ones.
    static_assert(sizeof(Eigen::Vector3i) == 3 * sizeof(unsigned));
    rtcSetSharedGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               mesh.triangles.data(), 0, sizeof(Eigen::Vector3i),
                               mesh.triangles.size());
    rtcCommitGeometry(geometry.get());
    rtcAttachGeometryByID(scene.get(), geometry.get(), static_cast<unsigned>(m));
  }
  std::size_t surface = meshes.size();
  for (const Sphere& sphere : spheres) {
    add_round(sphere, surface++);
  }
  for (const Disk& disk : disks) {
    add_round(disk, surface++);
  }
  offset_mm = kOffset * radius_mm;
  rtcCommitScene(scene.get());
  const RTCError error = rtcGetDeviceError(device.get());
  if (error != RTC_ERROR_NONE) {
    throw Error("Embree cannot build the scene (code " + std::to_string(error) + ")",
                "ray caster", "check the mesh for coordinates beyond 1e18 mm, and the memory");
  }
}

std::uint64_t RayCaster::bytes_needed(const Scene& scene) {
  constexpr std::uint64_t kEmbreeTriangle = 100;  // measured on spheres of 10^7 triangles
  constexpr std::uint64_t kEmbreeVertex = 3 * sizeof(float);
  std::uint64_t sum = 0;
  for (const Mesh& mesh : scene.meshes) {
    const std::uint64_t own = mesh.vertices.size() * sizeof(Vector3d) +
                              mesh.normals.size() * sizeof(Vector3d) +
                              mesh.uvs.size() * sizeof(Eigen::Vector2d) +
                              mesh.triangles.size() * sizeof(Eigen::Vector3i);
    sum += own + mesh.vertices.size() * kEmbreeVertex + mesh.triangles.size() * kEmbreeTriangle;
  }
  return sum;
}

RayCaster::RayCaster(const Scene& scene) : impl_(std::make_unique<Impl>(scene)) {
  impl_->build(scene);
}
RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

double RayCaster::ray_offset_mm() const noexcept { return impl_->offset_mm; }

double RayCaster::scene_radius_mm() const noexcept { return impl_->radius_mm; }

const std::vector<Mesh>& RayCaster::meshes() const noexcept { return impl_->meshes; }

RawHit RayCaster::intersect(const Ray& ray) const {
  RTCRayHit asked;
  asked.ray = single(ray, impl_->middle);
  asked.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  asked.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  ask_intersect(impl_->scene.get(), asked);
  static_assert(RTC_INVALID_GEOMETRY_ID == RawHit::kNone);
  if (asked.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
    return {};
  }
  return {.t = asked.ray.tfar,
          .u = asked.hit.u,
          .v = asked.hit.v,
          .mesh = asked.hit.geomID,
          .triangle = asked.hit.primID};
}

void RayCaster::intersect(std::span<const Ray> rays, RayOrder order,
                          std::span<RawHit> hits) const {
  HAARLIGHT_EXPECTS(rays.size() == hits.size(), "one hit per ray");
  alignas(64) Valid valid{};
  alignas(64) RTCRayHit16 packet;
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t n = fill(rays, begin, impl_->middle, valid, packet.ray);
    std::fill_n(packet.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
    std::fill_n(packet.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
    ask_intersect(valid.data(), impl_->scene.get(), order, packet);
    for (std::size_t i = 0; i < n; ++i) {
      const bool is_hit = packet.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
      hits[begin + i] = is_hit ? RawHit{.t = packet.ray.tfar[i],
                                        .u = packet.hit.u[i],
                                        .v = packet.hit.v[i],
                                        .mesh = packet.hit.geomID[i],
                                        .triangle = packet.hit.primID[i]}
                               : RawHit{};
    }
  }
}

void RayCaster::are_blocked(std::span<const Ray> rays, RayOrder order,
                            std::span<std::uint8_t> blocked) const {
  HAARLIGHT_EXPECTS(rays.size() == blocked.size(), "one answer per ray");
  if (rays.size() == 1) {
    RTCRay asked = single(rays[0], impl_->middle);
    ask_occluded(impl_->scene.get(), asked);
    blocked[0] = asked.tfar < 0.0F ? 1 : 0;  // Embree's mark: -infinity
    return;
  }
  alignas(64) Valid valid{};
  alignas(64) RTCRay16 packet;
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t n = fill(rays, begin, impl_->middle, valid, packet);
    ask_occluded(valid.data(), impl_->scene.get(), order, packet);
    for (std::size_t i = 0; i < n; ++i) {
      blocked[begin + i] = packet.tfar[i] < 0.0F ? 1 : 0;
    }
  }
}

std::optional<Hit> RayCaster::intersect(const Vector3d& origin, const Vector3d& direction,
                                        double min_distance_mm) const {
  const Ray ray{.origin = origin, .direction = direction, .t_min = min_distance_mm};
  const RawHit raw = intersect(ray);
  return raw.is_hit() ? std::optional(surface_at(ray, raw)) : std::nullopt;
}

namespace {

/// Of a surface without interpolated normals. @param normal  of its front
Hit round_hit(const Ray& ray, const RawHit& raw, const Vector3d& point, const Vector3d& normal,
              int material) {
  const bool is_front = !(normal.dot(ray.direction) > 0.0);
  const Vector3d turned = is_front ? normal : Vector3d(-normal);
  return {.distance_mm = (point - ray.origin).dot(ray.direction),
          .point = point,
          .normal = turned,
          .flat_normal = turned,
          .is_front = is_front,
          .mesh = static_cast<int>(raw.mesh),
          .triangle = static_cast<int>(raw.triangle),
          .material = material};
}

}  // namespace

Hit RayCaster::Impl::sphere_at(const Ray& ray, const RawHit& raw) const {
  const Sphere& sphere = spheres[raw.mesh - meshes.size()];
  const Vector3d from_centre = ray.origin - sphere.centre;
  const double middle_t = -from_centre.dot(ray.direction);
  const double across = (from_centre + middle_t * ray.direction).norm();
  const double half_chord =
      std::sqrt(std::max(0.0, (sphere.radius_mm - across) * (sphere.radius_mm + across)));
  const double t = double{raw.t} < middle_t ? middle_t - half_chord : middle_t + half_chord;
  const Vector3d normal = (from_centre + t * ray.direction).normalized();
  return round_hit(ray, raw, sphere.centre + sphere.radius_mm * normal, normal,
                   sphere.material);
}

Hit RayCaster::Impl::disk_at(const Ray& ray, const RawHit& raw) const {
  const Disk& disk = disks[raw.mesh - meshes.size() - spheres.size()];
  const double slope = disk.normal.dot(ray.direction);
  const double t_plane = disk.normal.dot(disk.centre - ray.origin) / slope;
  const double t_float = raw.t;
  const bool is_exact =
      std::abs(slope) > 1e-6 && std::abs(t_plane - t_float) <= 1e-4 * t_float + offset_mm;
  return round_hit(ray, raw, ray.origin + (is_exact ? t_plane : t_float) * ray.direction,
                   disk.normal, disk.material);
}

Hit RayCaster::surface_at(const Ray& ray, const RawHit& raw) const {
  const std::size_t n_meshes = impl_->meshes.size();
  if (raw.mesh >= n_meshes) {
    HAARLIGHT_EXPECTS(raw.mesh < n_meshes + impl_->spheres.size() + impl_->disks.size(),
                      "a hit of this scene");
    return raw.mesh < n_meshes + impl_->spheres.size() ? impl_->sphere_at(ray, raw)
                                                       : impl_->disk_at(ray, raw);
  }
  HAARLIGHT_EXPECTS(raw.mesh < impl_->meshes.size() &&
                        raw.triangle < impl_->meshes[raw.mesh].triangles.size(),
                    "a hit of this scene");
  const Mesh& mesh = impl_->meshes[raw.mesh];
  const Eigen::Vector3i& t = mesh.triangles[raw.triangle];
  const auto corner = [&](int i) -> const Vector3d& {
    return mesh.vertices[static_cast<std::size_t>(t[i])];
  };
  Hit hit;
  hit.mesh = static_cast<int>(raw.mesh);
  hit.triangle = static_cast<int>(raw.triangle);
  hit.material = mesh.material;
  // The triangle is from Embree; the point is the ray's intersection with that triangle's plane
  // in double, unless the ray grazes it.
  const Vector3d flat = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
  const double slope = flat.dot(ray.direction);
  const double u = raw.u;
  const double v = raw.v;
  const double t_plane = flat.dot(corner(0) - ray.origin) / slope;
  const double t_float = raw.t;
  if (std::abs(slope) > 1e-6 &&
      std::abs(t_plane - t_float) <= 1e-4 * t_float + impl_->offset_mm) {
    hit.distance_mm = t_plane;
    hit.point = ray.origin + t_plane * ray.direction;
  } else {
    hit.point = (1.0 - u - v) * corner(0) + u * corner(1) + v * corner(2);
    hit.distance_mm = (hit.point - ray.origin).dot(ray.direction);
  }
  hit.is_front = !(slope > 0.0);
  hit.flat_normal = hit.is_front ? flat : Vector3d(-flat);
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
  if (impl_->needs_uvs[raw.mesh] != 0) {
    hit.uv = uv_at(mesh, t, hit.point);
  }
  return hit;
}

void RayCaster::are_blocked(const Vector3d& from, std::span<const Vector3d> to,
                            std::span<std::uint8_t> blocked) const {
  HAARLIGHT_EXPECTS(to.size() == blocked.size(), "one answer per target");
  alignas(64) Valid valid{};
  alignas(64) RTCRay16 rays;
  const Vector3d origin = from - impl_->middle;
  for (std::size_t begin = 0; begin < to.size(); begin += kPacket) {
    const std::size_t n = std::min(kPacket, to.size() - begin);
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
    ask_occluded(valid.data(), impl_->scene.get(), RayOrder::coherent, rays);
    for (std::size_t i = 0; i < n; ++i) {
      // Embree marks a blocked ray by tfar = -infinity.
      blocked[begin + i] = valid.at(i) != 0 && rays.tfar[i] < 0.0F ? 1 : 0;
    }
  }
}

}  // namespace haarlight::render
