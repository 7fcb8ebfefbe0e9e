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
#include <Eigen/SVD>
#ifdef HAARLIGHT_EMBREE4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "haarlight/core/error.h"
#include "render/rays/ray_offset.h"
#include "render/rays/triangle_lanes.h"

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

/// Of the surface whose number it has in the scene.
GeometryHandle new_geometry(RTCDevice device, RTCGeometryType type) {
  GeometryHandle geometry(rtcNewGeometry(device, type));
  HAARLIGHT_EXPECTS(geometry != nullptr, "an Embree with triangles, points and instances");
  return geometry;
}

constexpr std::size_t kPacket = 16;
using Valid = std::array<int, kPacket>;
/// 64 single-precision roundings: of the vertices, a ray's origin and Embree's own sums.
constexpr double kOffset = 0x1p-18;

/// Texture coordinates of a point on the plane of triangle `t`: by its barycentric coordinates,
/// which are ratios of areas to that of the triangle.
Eigen::Vector2d uv_at(const Mesh& mesh, const Eigen::Vector3i& t,
                      const std::array<Vector3d, 3>& corners, const Vector3d& point) {
  const auto index = [&](int i) { return static_cast<std::size_t>(t[i]); };
  const Vector3d to_second = corners[1] - corners[0];
  const Vector3d to_third = corners[2] - corners[0];
  const Vector3d to_point = point - corners[0];
  const Vector3d area = to_second.cross(to_third);
  const double u = to_point.cross(to_third).dot(area) / area.squaredNorm();
  const double v = to_second.cross(to_point).dot(area) / area.squaredNorm();
  return mesh.uvs[index(0)] + u * (mesh.uvs[index(1)] - mesh.uvs[index(0)]) +
         v * (mesh.uvs[index(2)] - mesh.uvs[index(0)]);
}

Eigen::AlignedBox3d box_of(const Mesh& mesh) {
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : mesh.vertices) {
    box.extend(vertex);
  }
  return box;
}

/// Where the corners of a mesh's box are in an instance.
std::array<Vector3d, 8> corners_of(const Eigen::AlignedBox3d& box,
                                   const Eigen::Affine3d& world_from_mesh) {
  std::array<Vector3d, 8> corners;
  for (int i = 0; i < 8; ++i) {
    corners.at(static_cast<std::size_t>(i)) =
        world_from_mesh * box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i));
  }
  return corners;
}

/// In the world. @param instance  nothing: of the mesh itself
std::array<Vector3d, 3> corners_of(const Mesh& mesh, const Eigen::Vector3i& t,
                                   const Instance* instance) {
  std::array<Vector3d, 3> corners;
  for (int i = 0; i < 3; ++i) {
    const Vector3d& vertex = mesh.vertices[static_cast<std::size_t>(t[i])];
    corners.at(static_cast<std::size_t>(i)) =
        instance == nullptr ? vertex : instance->world_from_mesh * vertex;
  }
  return corners;
}

/// Middle of the surfaces' bounding box. @param boxes  of the meshes
Vector3d middle_of(const Scene& scene, std::span<const Eigen::AlignedBox3d> boxes) {
  Eigen::AlignedBox3d box;
  for (const Eigen::AlignedBox3d& of_mesh : boxes) {
    box.extend(of_mesh);
  }
  for (const Instance& instance : scene.instances) {
    const Eigen::AlignedBox3d& of_mesh = boxes[static_cast<std::size_t>(instance.mesh)];
    if (!of_mesh.isEmpty()) {
      for (const Vector3d& corner : corners_of(of_mesh, instance.world_from_mesh)) {
        box.extend(corner);
      }
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
      : source(scene_to_cast),
        meshes(scene_to_cast.meshes),
        spheres(scene_to_cast.spheres),
        disks(scene_to_cast.disks),
        instances(scene_to_cast.instances) {}

  // The scene's own: a hit is told in double precision, and Embree reads the indices.
  const Scene& source;
  std::span<const Mesh> meshes;
  std::span<const Sphere> spheres;
  std::span<const Disk> disks;
  std::span<const Instance> instances;
  /// What the transform of an instance adds to rounding.
  struct Transform {
    Vector3d centre = Vector3d::Zero();  ///< of its mesh's middle, from Embree's origin
    double condition = 0.0;              ///< of its linear part; 0: no instance
  };
  /// What a hit of an instance needs besides.
  struct Placed {
    Transform transform;
    Eigen::Matrix3d for_normals;  ///< inverse transpose of the linear part
    int material;
    bool is_mirrored;
    bool needs_uvs;
  };
  std::vector<Placed> placed;
  std::vector<Transform> of_meshes;       ///< by mesh: those that have instances are such, too
  std::vector<std::uint8_t> is_textured;  ///< by material
  std::vector<std::uint8_t> needs_uvs;    ///< by mesh: whether its material has a texture
  DeviceHandle device;
  SceneHandle scene;                   ///< its geometries have the surfaces' numbers
  Vector3d middle = Vector3d::Zero();  ///< Embree's origin: scenes far from ours lose nothing
  double offset_mm = 0.0;
  double radius_mm = 0.0;

  void build();
  void start_device();
  /// Adds a mesh, seen from `origin`, to a scene of Embree's. @return  its radius about there
  double add_mesh(const Mesh& mesh, const Vector3d& origin, RTCScene to, unsigned number) const;
  /// Adds the meshes that have instances, and these.
  void add_instances(std::span<const Eigen::AlignedBox3d> boxes);
  /// Adds one placing of a mesh as the surface of that number.
  void add_placed(RTCScene of_mesh, const Eigen::Affine3d& from_mesh, unsigned surface) const;
  /// Adds a sphere or a disk as the surface after those before it.
  template <class Round>
  void add_round(const Round& round, std::size_t surface);
  [[nodiscard]] double round_offset(const Vector3d& point, double times_radius) const {
    return kRounding * (kOfDistance * (point - middle).norm() + times_radius);
  }
  /// offset_mm() of a triangle that an instance shows, or whose mesh has instances.
  /// @param of_triangle  triangle_roundings() @param longest_side  mm
  [[nodiscard]] double moved_offset(const Vector3d& point, double of_triangle,
                                    double longest_side, const Transform& transform) const;
  /// The instance that is a surface; nothing: it is a mesh.
  [[nodiscard]] const Instance* instance_of(std::uint32_t surface) const {
    return surface < meshes.size() ? nullptr : &instances[surface - first_instance()];
  }
  [[nodiscard]] std::size_t first_instance() const {
    return meshes.size() + spheres.size() + disks.size();
  }
  /// Whether a surface has triangles.
  [[nodiscard]] bool has_triangles(std::uint32_t surface) const {
    return surface < meshes.size() ||
           (surface >= first_instance() && surface < first_instance() + instances.size());
  }
  [[nodiscard]] Hit round_at(const Ray& ray, const RawHit& raw) const;
  [[nodiscard]] Hit sphere_at(const Ray& ray, const RawHit& raw) const;
  [[nodiscard]] Hit disk_at(const Ray& ray, const RawHit& raw) const;
  void put(const Ray& ray, const RawHit& raw, std::size_t lane, TriangleLanes& lanes) const;
  void finish(const TriangleLanes& lanes, std::size_t lane, const RawHit& raw, Hit& hit) const;
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

void RayCaster::Impl::start_device() {
  // Without a number of threads: one given here would hold for every loop of the process.
  device.reset(rtcNewDevice(nullptr));
  if (device == nullptr) {
    throw Error(
        "Embree does not start (code " + std::to_string(rtcGetDeviceError(nullptr)) + ")",
        "ray caster", "Embree 3 needs a processor with SSE2 and memory for its tables");
  }
}

namespace {

SceneHandle new_scene(RTCDevice device) {
  SceneHandle scene(rtcNewScene(device));
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(scene.get(), RTC_BUILD_QUALITY_HIGH);
  return scene;
}

bool has_texture(const Scene& scene, const Mesh& mesh, int material) {
  const auto i = static_cast<std::size_t>(material);
  return !mesh.uvs.empty() && i < scene.materials.size() &&
         !scene.materials[i].kd_texture.file.empty();
}

}  // namespace

double RayCaster::Impl::add_mesh(const Mesh& mesh, const Vector3d& origin, RTCScene to,
                                 unsigned number) const {
  if (mesh.vertices.empty()) {
    return 0.0;
  }
  const GeometryHandle geometry = new_geometry(device.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(
      rtcSetNewGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                              3 * sizeof(float), mesh.vertices.size()));
  HAARLIGHT_EXPECTS(vertices != nullptr, "memory for the mesh");
  double furthest = 0.0;
  for (const Vector3d& corner : mesh.vertices) {
    const Vector3d vertex = corner - origin;
    furthest = std::max(furthest, vertex.norm());
    for (int c = 0; c < 3; ++c) {
      *vertices++ = static_cast<float>(vertex[c]);
    }
  }
  if (mesh.triangles.empty()) {
    return furthest;
  }
  // The scene's, not a copy: they are not negative, so that their bits are those of unsigned ones.
  static_assert(sizeof(Eigen::Vector3i) == 3 * sizeof(unsigned));
  rtcSetSharedGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                             mesh.triangles.data(), 0, sizeof(Eigen::Vector3i),
                             mesh.triangles.size());
  rtcCommitGeometry(geometry.get());
  rtcAttachGeometryByID(to, geometry.get(), number);
  return furthest;
}

void RayCaster::Impl::add_placed(RTCScene of_mesh, const Eigen::Affine3d& from_mesh,
                                 unsigned surface) const {
  const GeometryHandle geometry = new_geometry(device.get(), RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(geometry.get(), of_mesh);
  rtcSetGeometryTimeStepCount(geometry.get(), 1);
  const Eigen::Matrix<float, 3, 4> columns = from_mesh.affine().cast<float>();
  rtcSetGeometryTransform(geometry.get(), 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, columns.data());
  rtcCommitGeometry(geometry.get());
  rtcAttachGeometryByID(scene.get(), geometry.get(), surface);
}

void RayCaster::Impl::add_instances(std::span<const Eigen::AlignedBox3d> boxes) {
  // Each mesh about the middle of its own box, so that its vertices lose nothing by where it is.
  std::vector<SceneHandle> of_mesh(meshes.size());
  const auto seen_from_middle = [&](std::size_t m, Eigen::Affine3d world_from_mesh) {
    world_from_mesh.translation() = world_from_mesh * boxes[m].center() - middle;
    return world_from_mesh;
  };
  placed.reserve(instances.size());
  auto surface = static_cast<unsigned>(meshes.size() + spheres.size() + disks.size());
  for (const Instance& instance : instances) {
    const auto m = static_cast<std::size_t>(instance.mesh);
    const Eigen::Matrix3d linear = instance.world_from_mesh.linear();
    HAARLIGHT_EXPECTS(
        instance.world_from_mesh.matrix().allFinite() && std::abs(linear.determinant()) > 0.0,
        "a transform with an inverse");
    const int material = material_of(source, instance);
    const Eigen::Vector3d stretches = linear.jacobiSvd().singularValues();
    placed.push_back(
        {.transform = {.centre = instance.world_from_mesh * boxes[m].center() - middle,
                       .condition = stretches[0] / stretches[2]},
         .for_normals = linear.inverse().transpose(),
         .material = material,
         .is_mirrored = linear.determinant() < 0.0,
         .needs_uvs = has_texture(source, meshes[m], material)});
    if (!meshes[m].triangles.empty()) {
      if (of_mesh[m] == nullptr) {
        of_mesh[m] = new_scene(device.get());
        add_mesh(meshes[m], boxes[m].center(), of_mesh[m].get(), 0);
        rtcCommitScene(of_mesh[m].get());
        of_meshes[m] = {.centre = boxes[m].center() - middle, .condition = 1.0};
        add_placed(of_mesh[m].get(), seen_from_middle(m, Eigen::Affine3d::Identity()),
                   static_cast<unsigned>(m));
      }
      add_placed(of_mesh[m].get(), seen_from_middle(m, instance.world_from_mesh), surface);
      for (const Vector3d& corner : corners_of(boxes[m], instance.world_from_mesh)) {
        radius_mm = std::max(radius_mm, (corner - middle).norm());
      }
    }
    ++surface;
  }
}

void RayCaster::Impl::build() {
  start_device();
  scene = new_scene(device.get());
  std::vector<Eigen::AlignedBox3d> boxes;
  boxes.reserve(meshes.size());
  for (const Mesh& mesh : meshes) {
    boxes.push_back(box_of(mesh));
  }
  std::vector<std::uint8_t> has_instances(meshes.size(), 0);
  for (const Instance& instance : instances) {
    HAARLIGHT_EXPECTS(
        instance.mesh >= 0 && static_cast<std::size_t>(instance.mesh) < meshes.size(),
        "instances of the scene's meshes");
    has_instances[static_cast<std::size_t>(instance.mesh)] = 1;
  }
  middle = middle_of(source, boxes);
  needs_uvs.assign(meshes.size(), 0);
  of_meshes.assign(meshes.size(), {});
  for (const Material& material : source.materials) {
    is_textured.push_back(material.kd_texture.file.empty() ? 0 : 1);
  }
  for (std::size_t m = 0; m < meshes.size(); ++m) {
    const Mesh& mesh = meshes[m];
    HAARLIGHT_EXPECTS(mesh.normals.empty() || mesh.normals.size() == mesh.vertices.size(),
                      "no normals, or one a vertex");
    HAARLIGHT_EXPECTS(mesh.uvs.empty() || mesh.uvs.size() == mesh.vertices.size(),
                      "no texture coordinates, or one pair a vertex");
    needs_uvs[m] = has_texture(source, mesh, mesh.material) ? 1 : 0;
    const int n_vertices = static_cast<int>(mesh.vertices.size());
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      HAARLIGHT_EXPECTS(triangle.minCoeff() >= 0 && triangle.maxCoeff() < n_vertices,
                        "triangle indices within the mesh");
    }
    if (has_instances[m] == 0) {
      radius_mm =
          std::max(radius_mm, add_mesh(mesh, middle, scene.get(), static_cast<unsigned>(m)));
    } else if (!boxes[m].isEmpty()) {
      for (const Vector3d& corner : corners_of(boxes[m], Eigen::Affine3d::Identity())) {
        radius_mm = std::max(radius_mm, (corner - middle).norm());
      }
    }
  }
  std::size_t surface = meshes.size();
  for (const Sphere& sphere : spheres) {
    add_round(sphere, surface++);
  }
  for (const Disk& disk : disks) {
    add_round(disk, surface++);
  }
  add_instances(boxes);
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
  constexpr std::uint64_t kEmbreeInstance = 450;  // measured on 10^6
  constexpr std::uint64_t kEmbreeVertex = 3 * sizeof(float);
  std::uint64_t sum = 0;
  for (const Mesh& mesh : scene.meshes) {
    const std::uint64_t own = mesh.vertices.size() * sizeof(Vector3d) +
                              mesh.normals.size() * sizeof(Vector3d) +
                              mesh.uvs.size() * sizeof(Eigen::Vector2d) +
                              mesh.triangles.size() * sizeof(Eigen::Vector3i);
    sum += own + mesh.vertices.size() * kEmbreeVertex + mesh.triangles.size() * kEmbreeTriangle;
  }
  return sum +
         scene.instances.size() * (sizeof(Instance) + sizeof(Impl::Placed) + kEmbreeInstance);
}

RayCaster::RayCaster(const Scene& scene) : impl_(std::make_unique<Impl>(scene)) {
  impl_->build();
}
RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

double RayCaster::ray_offset_mm() const noexcept { return impl_->offset_mm; }

double RayCaster::scene_radius_mm() const noexcept { return impl_->radius_mm; }
const Vector3d& RayCaster::scene_middle() const noexcept { return impl_->middle; }

const std::vector<Mesh>& RayCaster::meshes() const noexcept { return impl_->source.meshes; }

bool RayCaster::has_instances() const noexcept { return !impl_->instances.empty(); }

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
          .mesh = asked.hit.instID[0] == RTC_INVALID_GEOMETRY_ID ? asked.hit.geomID
                                                                 : asked.hit.instID[0],
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
      const unsigned surface = packet.hit.instID[0][i] == RTC_INVALID_GEOMETRY_ID
                                   ? packet.hit.geomID[i]
                                   : packet.hit.instID[0][i];
      hits[begin + i] = is_hit ? RawHit{.t = packet.ray.tfar[i],
                                        .u = packet.hit.u[i],
                                        .v = packet.hit.v[i],
                                        .mesh = surface,
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
              int material, double offset_mm) {
  const bool is_front = !(normal.dot(ray.direction) > 0.0);
  const Vector3d turned = is_front ? normal : Vector3d(-normal);
  return {.distance_mm = (point - ray.origin).dot(ray.direction),
          .point = point,
          .normal = turned,
          .flat_normal = turned,
          .is_front = is_front,
          .mesh = static_cast<int>(raw.mesh),
          .triangle = static_cast<int>(raw.triangle),
          .material = material,
          .offset_mm = offset_mm};
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
  const Vector3d point = sphere.centre + sphere.radius_mm * normal;
  Hit hit = round_hit(ray, raw, point, normal, sphere.material,
                      round_offset(point, kOfSphere * sphere.radius_mm));
  const auto material = static_cast<std::size_t>(sphere.material);
  if (material < is_textured.size() && is_textured[material] != 0) {
    hit.uv = sphere_uv(normal);
  }
  return hit;
}

Hit RayCaster::Impl::disk_at(const Ray& ray, const RawHit& raw) const {
  const Disk& disk = disks[raw.mesh - meshes.size() - spheres.size()];
  const double slope = disk.normal.dot(ray.direction);
  const double t_plane = disk.normal.dot(disk.centre - ray.origin) / slope;
  const double t_float = raw.t;
  const bool is_exact =
      std::abs(slope) > 1e-6 && std::abs(t_plane - t_float) <= 1e-4 * t_float + offset_mm;
  Vector3d point = ray.origin + (is_exact ? t_plane : t_float) * ray.direction;
  if (!is_exact) {
    point -= disk.normal.dot(point - disk.centre) * disk.normal;
  }
  return round_hit(ray, raw, point, disk.normal, disk.material,
                   round_offset(point, kOfDisk * disk.radius_mm));
}

Hit RayCaster::Impl::round_at(const Ray& ray, const RawHit& raw) const {
  HAARLIGHT_EXPECTS(raw.mesh < first_instance(), "a hit of this scene");
  return raw.mesh < meshes.size() + spheres.size() ? sphere_at(ray, raw) : disk_at(ray, raw);
}

void RayCaster::Impl::put(const Ray& ray, const RawHit& raw, std::size_t lane,
                          TriangleLanes& lanes) const {
  const Instance* const instance = instance_of(raw.mesh);
  const Mesh& mesh =
      meshes[instance == nullptr ? raw.mesh : static_cast<std::size_t>(instance->mesh)];
  HAARLIGHT_EXPECTS(raw.triangle < mesh.triangles.size(), "a hit of this scene");
  const Eigen::Vector3i& t = mesh.triangles[raw.triangle];
  if (instance == nullptr) {
    lanes.first.put(lane, mesh.vertices[static_cast<std::size_t>(t[0])]);
    lanes.second.put(lane, mesh.vertices[static_cast<std::size_t>(t[1])]);
    lanes.third.put(lane, mesh.vertices[static_cast<std::size_t>(t[2])]);
    lanes.side[lane] = 1.0;
  } else {
    const std::array<Vector3d, 3> corners = corners_of(mesh, t, instance);
    lanes.first.put(lane, corners[0]);
    lanes.second.put(lane, corners[1]);
    lanes.third.put(lane, corners[2]);
    lanes.side[lane] = placed[raw.mesh - first_instance()].is_mirrored ? -1.0 : 1.0;
  }
  lanes.origin.put(lane, ray.origin);
  lanes.direction.put(lane, ray.direction);
  lanes.t[lane] = raw.t;
  lanes.u[lane] = raw.u;
  lanes.v[lane] = raw.v;
}

/// All that TriangleLanes has not found.
void RayCaster::Impl::finish(const TriangleLanes& lanes, std::size_t lane, const RawHit& raw,
                             Hit& hit) const {
  const Instance* const instance = instance_of(raw.mesh);
  const Placed* const moved =
      instance == nullptr ? nullptr : &placed[raw.mesh - first_instance()];
  const Mesh& mesh =
      meshes[instance == nullptr ? raw.mesh : static_cast<std::size_t>(instance->mesh)];
  const Eigen::Vector3i& t = mesh.triangles[raw.triangle];
  hit.distance_mm = lanes.distance[lane];
  hit.point = lanes.point[lane];
  hit.flat_normal = lanes.flat[lane];
  hit.normal = lanes.flat[lane];
  hit.uv = Eigen::Vector2d::Zero();
  hit.is_front = !(lanes.slope[lane] > 0.0);
  hit.mesh = static_cast<int>(raw.mesh);
  hit.triangle = static_cast<int>(raw.triangle);
  hit.material = moved == nullptr ? mesh.material : moved->material;
  hit.offset_mm = lanes.offset[lane];
  const Transform& transform = moved == nullptr ? of_meshes[raw.mesh] : moved->transform;
  if (transform.condition > 0.0) {
    hit.offset_mm =
        moved_offset(hit.point, lanes.of_triangle[lane], lanes.longest_side[lane], transform);
  }
  if (!mesh.normals.empty()) {
    const auto normal_at = [&](int i) -> Vector3d {
      const Vector3d& normal = mesh.normals[static_cast<std::size_t>(t[i])];
      return moved == nullptr ? normal : (moved->for_normals * normal).normalized();
    };
    const double u = raw.u;
    const double v = raw.v;
    const Vector3d smooth = (1.0 - u - v) * normal_at(0) + u * normal_at(1) + v * normal_at(2);
    const double length = smooth.norm();
    if (length > 1e-12) {
      hit.normal = smooth / (smooth.dot(hit.flat_normal) < 0.0 ? -length : length);
    }
  }
  if (moved == nullptr ? needs_uvs[raw.mesh] != 0 : moved->needs_uvs) {
    hit.uv = uv_at(mesh, t, corners_of(mesh, t, instance), hit.point);
  }
}

Hit RayCaster::surface_at(const Ray& ray, const RawHit& raw) const {
  Hit hit;
  surfaces_at({&ray, 1}, {&raw, 1}, {&hit, 1});
  return hit;
}

void RayCaster::surfaces_at(std::span<const Ray> rays, std::span<const RawHit> raw,
                            std::span<Hit> hits) const {
  HAARLIGHT_EXPECTS(rays.size() == raw.size() && rays.size() == hits.size(), "a hit per ray");
  TriangleLanes lanes;
  for (std::size_t begin = 0; begin < rays.size(); begin += kLanes) {
    const std::size_t end = std::min(begin + kLanes, rays.size());
    std::size_t n = 0;
    for (std::size_t i = begin; i < end; ++i) {
      if (impl_->has_triangles(raw[i].mesh)) {
        impl_->put(rays[i], raw[i], n++, lanes);
      } else if (raw[i].is_hit()) {
        hits[i] = impl_->round_at(rays[i], raw[i]);
      }
    }
    // The triangle is from Embree; the point is the ray's on its plane in double.
    lanes.find(n, impl_->offset_mm, impl_->middle);
    for (std::size_t i = begin, lane = 0; i < end; ++i) {
      if (impl_->has_triangles(raw[i].mesh)) {
        impl_->finish(lanes, lane++, raw[i], hits[i]);
      }
    }
  }
}

double RayCaster::Impl::moved_offset(const Vector3d& point, double of_triangle,
                                     double longest_side, const Transform& transform) const {
  const Vector3d from_origin = point - middle;
  return kRounding * transform.condition * transform.condition *
         (kOfInstance * (from_origin.norm() + transform.centre.norm()) +
          kWithinInstance * ((from_origin - transform.centre).norm() + longest_side) +
          of_triangle);
}

double RayCaster::offset_mm(std::uint32_t surface, std::uint32_t triangle,
                            const Vector3d& point) const {
  const Impl& impl = *impl_;
  if (impl.has_triangles(surface)) {
    const Instance* const instance = impl.instance_of(surface);
    const Mesh& mesh =
        impl.meshes[instance == nullptr ? surface : static_cast<std::size_t>(instance->mesh)];
    HAARLIGHT_EXPECTS(triangle < mesh.triangles.size(), "a triangle of this scene");
    const auto [a, b, c] = corners_of(mesh, mesh.triangles[triangle], instance);
    double longest_side = 0.0;
    const double of_triangle =
        triangle_roundings((b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm(),
                           (b - a).cross(c - a).squaredNorm(), longest_side);
    const Impl::Transform& transform =
        instance == nullptr ? impl.of_meshes[surface]
                            : impl.placed[surface - impl.first_instance()].transform;
    return transform.condition > 0.0
               ? impl.moved_offset(point, of_triangle, longest_side, transform)
               : impl.round_offset(point, of_triangle);
  }
  std::size_t number = surface - impl.meshes.size();
  if (number < impl.spheres.size()) {
    return impl.round_offset(point, kOfSphere * impl.spheres[number].radius_mm);
  }
  number -= impl.spheres.size();
  HAARLIGHT_EXPECTS(number < impl.disks.size(), "a surface of this scene");
  return impl.round_offset(point, kOfDisk * impl.disks[number].radius_mm);
}

double RayCaster::most_offset_mm(std::uint32_t surface) const {
  const Impl& impl = *impl_;
  double most = 0.0;
  if (impl.has_triangles(surface)) {
    const Instance* const instance = impl.instance_of(surface);
    const Mesh& mesh =
        impl.meshes[instance == nullptr ? surface : static_cast<std::size_t>(instance->mesh)];
    // Distances are convex: largest at a corner.
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      for (const Vector3d& corner : corners_of(mesh, mesh.triangles[t], instance)) {
        most = std::max(most, offset_mm(surface, static_cast<std::uint32_t>(t), corner));
      }
    }
    return most;
  }
  const auto at_rim = [&](const Vector3d& centre, double radius) {
    return offset_mm(surface, 0, centre) + kRounding * kOfDistance * radius;
  };
  const std::size_t number = surface - impl.meshes.size();
  return number < impl.spheres.size()
             ? at_rim(impl.spheres[number].centre, impl.spheres[number].radius_mm)
             : at_rim(impl.disks[number - impl.spheres.size()].centre,
                      impl.disks[number - impl.spheres.size()].radius_mm);
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
