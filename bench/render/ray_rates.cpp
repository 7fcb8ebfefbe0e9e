// SPDX-License-Identifier: Apache-2.0
/// @file
/// Rays per second of RayCaster beside bare Embree, in its two forms (single rays, packets of
/// 16), for the same rays of a scene: a camera's, those that its surfaces scatter (a cosine
/// lobe), and those from there to points of a square light above. One thread, medians of REPEATS
/// in turns; the table of docs/numerics/rays.md.
///
///     ray_rates SCENE.toml [REPEATS]

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <ctime>
#include <exception>
#include <functional>
#include <numbers>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#ifdef HAARLIGHT_EMBREE4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

constexpr std::size_t kPacket = 16;

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

/// Embree as its manual has it: robust, the best tree.
class Bare {
 public:
  explicit Bare(const Scene& source) {
    rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_HIGH);
    for (const Mesh& mesh : source.meshes) {
      RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
      auto* vertices = static_cast<float*>(
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                  3 * sizeof(float), mesh.vertices.size()));
      for (const Vector3d& vertex : mesh.vertices) {
        for (int c = 0; c < 3; ++c) {
          *vertices++ = static_cast<float>(vertex[c]);
        }
      }
      auto* indices = static_cast<unsigned*>(
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                  3 * sizeof(unsigned), mesh.triangles.size()));
      for (const Eigen::Vector3i& triangle : mesh.triangles) {
        for (int c = 0; c < 3; ++c) {
          *indices++ = static_cast<unsigned>(triangle[c]);
        }
      }
      rtcCommitGeometry(geometry);
      rtcAttachGeometry(scene_, geometry);
      rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(scene_);
  }
  ~Bare() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  Bare(const Bare&) = delete;
  Bare& operator=(const Bare&) = delete;
  [[nodiscard]] RTCScene scene() const { return scene_; }

 private:
  RTCDevice device_ = rtcNewDevice(nullptr);
  RTCScene scene_ = rtcNewScene(device_);
};

#ifdef HAARLIGHT_EMBREE4
void intersect1(RTCScene scene, RTCRayHit& ray) { rtcIntersect1(scene, &ray); }
void occluded1(RTCScene scene, RTCRay& ray) { rtcOccluded1(scene, &ray); }
void intersect16(const int* valid, RTCScene scene, bool coherent, RTCRayHit16& rays) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcIntersect16(valid, scene, &rays, &arguments);
}
void occluded16(const int* valid, RTCScene scene, bool coherent, RTCRay16& rays) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcOccluded16(valid, scene, &rays, &arguments);
}
#else
RTCIntersectContext context_of(bool coherent) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags =
      coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  return context;
}
void intersect1(RTCScene scene, RTCRayHit& ray) {
  RTCIntersectContext context = context_of(false);
  rtcIntersect1(scene, &context, &ray);
}
void occluded1(RTCScene scene, RTCRay& ray) {
  RTCIntersectContext context = context_of(false);
  rtcOccluded1(scene, &context, &ray);
}
void intersect16(const int* valid, RTCScene scene, bool coherent, RTCRayHit16& rays) {
  RTCIntersectContext context = context_of(coherent);
  rtcIntersect16(valid, scene, &context, &rays);
}
void occluded16(const int* valid, RTCScene scene, bool coherent, RTCRay16& rays) {
  RTCIntersectContext context = context_of(coherent);
  rtcOccluded16(valid, scene, &context, &rays);
}
#endif

RTCRay bare_ray(const Ray& ray) {
  RTCRay bare{};
  bare.org_x = static_cast<float>(ray.origin.x());
  bare.org_y = static_cast<float>(ray.origin.y());
  bare.org_z = static_cast<float>(ray.origin.z());
  bare.dir_x = static_cast<float>(ray.direction.x());
  bare.dir_y = static_cast<float>(ray.direction.y());
  bare.dir_z = static_cast<float>(ray.direction.z());
  bare.tnear = static_cast<float>(ray.t_min);
  bare.tfar = static_cast<float>(ray.t_max);
  bare.mask = ~0U;
  return bare;
}

void set(RTCRay16& packet, std::size_t i, const RTCRay& ray) {
  packet.org_x[i] = ray.org_x;
  packet.org_y[i] = ray.org_y;
  packet.org_z[i] = ray.org_z;
  packet.dir_x[i] = ray.dir_x;
  packet.dir_y[i] = ray.dir_y;
  packet.dir_z[i] = ray.dir_z;
  packet.tnear[i] = ray.tnear;
  packet.tfar[i] = ray.tfar;
  packet.time[i] = 0.0F;
  packet.mask[i] = ray.mask;
  packet.id[i] = 0;
  packet.flags[i] = 0;
}

/// Rays of one kind, ready in Embree's own forms: that is not timed.
struct Rays {
  std::string name;
  RayOrder order = RayOrder::coherent;
  bool is_shadow = false;
  std::vector<Ray> ours;
  std::vector<RTCRay> single;
  std::vector<RTCRayHit16> packets;

  void make_bare() {
    ours.resize(ours.size() / kPacket * kPacket);
    packets.resize(ours.size() / kPacket);
    for (std::size_t i = 0; i < ours.size(); ++i) {
      single.push_back(bare_ray(ours[i]));
      set(packets[i / kPacket].ray, i % kPacket, single.back());
    }
  }
};

std::uint64_t bare_single(const Rays& rays, RTCScene scene) {
  std::uint64_t n = 0;
  for (const RTCRay& ray : rays.single) {
    if (rays.is_shadow) {
      RTCRay asked = ray;
      occluded1(scene, asked);
      n += asked.tfar < 0.0F ? 1 : 0;
    } else {
      RTCRayHit asked;
      asked.ray = ray;
      asked.hit.geomID = RTC_INVALID_GEOMETRY_ID;
      asked.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
      intersect1(scene, asked);
      n += asked.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    }
  }
  return n;
}

std::uint64_t bare_packets(const Rays& rays, RTCScene scene) {
  alignas(64) std::array<int, kPacket> valid{};
  valid.fill(-1);
  const bool coherent = rays.order == RayOrder::coherent;
  std::uint64_t n = 0;
  for (const RTCRayHit16& packet : rays.packets) {
    alignas(64) RTCRayHit16 asked;
    asked.ray = packet.ray;
    if (rays.is_shadow) {
      occluded16(valid.data(), scene, coherent, asked.ray);
    } else {
      std::fill_n(asked.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
      std::fill_n(asked.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
      intersect16(valid.data(), scene, coherent, asked);
    }
    for (std::size_t i = 0; i < kPacket; ++i) {
      n += (rays.is_shadow ? asked.ray.tfar[i] < 0.0F
                           : asked.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID)
               ? 1
               : 0;
    }
  }
  return n;
}

std::uint64_t our_single(const Rays& rays, const RayCaster& caster) {
  std::uint64_t n = 0;
  for (const Ray& ray : rays.ours) {
    if (rays.is_shadow) {
      std::uint8_t blocked = 0;
      caster.are_blocked({&ray, 1}, rays.order, {&blocked, 1});
      n += blocked;
    } else {
      n += caster.intersect(ray).is_hit() ? 1 : 0;
    }
  }
  return n;
}

std::uint64_t our_span(const Rays& rays, const RayCaster& caster) {
  constexpr std::size_t kSpan = 1024;
  std::array<RawHit, kSpan> hits;
  std::array<std::uint8_t, kSpan> blocked{};
  std::uint64_t n = 0;
  for (std::size_t begin = 0; begin < rays.ours.size(); begin += kSpan) {
    const auto part =
        std::span(rays.ours).subspan(begin, std::min(kSpan, rays.ours.size() - begin));
    if (rays.is_shadow) {
      caster.are_blocked(part, rays.order, std::span(blocked).first(part.size()));
      n += static_cast<std::uint64_t>(std::count(
          blocked.begin(), blocked.begin() + static_cast<std::ptrdiff_t>(part.size()), 1));
    } else {
      caster.intersect(part, rays.order, std::span(hits).first(part.size()));
      n += static_cast<std::uint64_t>(
          std::count_if(hits.begin(), hits.begin() + static_cast<std::ptrdiff_t>(part.size()),
                        [](const RawHit& hit) { return hit.is_hit(); }));
    }
  }
  return n;
}

Vector3d cosine_direction(const Vector3d& normal, double a, double b) {
  const double phi = 2.0 * std::numbers::pi * a;
  const Vector3d u = normal.unitOrthogonal();
  return (std::sqrt(b) * (std::cos(phi) * u + std::sin(phi) * normal.cross(u)) +
          std::sqrt(1.0 - b) * normal)
      .normalized();
}

std::vector<Rays> make_rays(const SceneFile& file, const RayCaster& caster) {
  Rays camera{.name = "camera", .order = RayOrder::coherent};
  Rays scattered{.name = "scattered", .order = RayOrder::scattered};
  Rays shadow{.name = "to a light", .order = RayOrder::scattered, .is_shadow = true};
  Rays shadow_scattered{
      .name = "scattered, to a light", .order = RayOrder::scattered, .is_shadow = true};
  Eigen::AlignedBox3d box;
  for (const Mesh& mesh : file.scene.meshes) {
    for (const Vector3d& vertex : mesh.vertices) {
      box.extend(vertex);
    }
  }
  const double offset = caster.ray_offset_mm();
  const auto light_point = [&](double a, double b) -> Vector3d {
    return {0.3 * (a - 0.5) * box.sizes().x(), 0.3 * (b - 0.5) * box.sizes().y(),
            box.max().z() + 0.3 * box.diagonal().norm()};
  };
  const auto to_light = [&](const Hit& hit, double a, double b) -> Ray {
    const Vector3d from = hit.point + offset * hit.flat_normal;
    return {.origin = from, .direction = light_point(a, b) - from, .t_max = 1.0 - 1e-6};
  };
  const CameraModel& model = file.camera;
  for (int y = 0; y < model.height; ++y) {
    for (int x = 0; x < model.width; ++x) {
      const CameraRay ray = ray_through(model, x + 0.5, y + 0.5);
      camera.ours.push_back({.origin = ray.origin_world, .direction = ray.direction_world});
      const auto hit = caster.intersect(ray.origin_world, ray.direction_world);
      if (!hit) {
        continue;
      }
      const auto key = static_cast<std::uint64_t>(y) * 65536U + static_cast<std::uint64_t>(x);
      const auto random = [&](std::uint64_t k) { return uniform_unit(hash_key(key, k)); };
      shadow.ours.push_back(to_light(*hit, random(0), random(1)));
      scattered.ours.push_back(
          {.origin = hit->point + offset * hit->flat_normal,
           .direction = cosine_direction(hit->flat_normal, random(2), random(3))});
      const auto next =
          caster.intersect(scattered.ours.back().origin, scattered.ours.back().direction);
      if (next) {
        shadow_scattered.ours.push_back(to_light(*next, random(4), random(5)));
      }
    }
  }
  std::vector<Rays> all{std::move(camera), std::move(shadow), std::move(scattered),
                        std::move(shadow_scattered)};
  for (Rays& rays : all) {
    rays.make_bare();
  }
  return all;
}

int run(const std::string& scene_file, int repeats) {
  SceneFile file = read_scene(scene_file);
  file.scene = with_instances_expanded(std::move(file.scene), scene_file);
  if (!file.has_camera) {
    fmt::print(stderr, "{}: no [camera]\n", scene_file);
    return 2;
  }
  const RayCaster caster(file.scene);
  const Bare bare(file.scene);
  fmt::print("Embree {}. Mray/s on one thread; ours / bare of the same form\n",
             RTC_VERSION_STRING);
  for (const Rays& rays : make_rays(file, caster)) {
    const std::array<std::function<std::uint64_t()>, 4> forms = {
        [&] { return bare_single(rays, bare.scene()); },
        [&] { return our_single(rays, caster); },
        [&] { return bare_packets(rays, bare.scene()); },
        [&] { return our_span(rays, caster); }};
    std::array<std::vector<double>, 4> rates;
    std::array<std::uint64_t, 4> hits{};
    for (int r = 0; r < repeats; ++r) {
      for (std::size_t f = 0; f < forms.size(); ++f) {
        const double start = cpu_seconds();
        hits.at(f) = forms.at(f)();
        rates.at(f).push_back(1e-6 * static_cast<double>(rays.ours.size()) /
                              (cpu_seconds() - start));
      }
    }
    std::array<double, 4> median{};
    for (std::size_t f = 0; f < forms.size(); ++f) {
      std::vector<double>& of_form = rates.at(f);
      std::nth_element(of_form.begin(), of_form.begin() + repeats / 2, of_form.end());
      median.at(f) = of_form[static_cast<std::size_t>(repeats / 2)];
    }
    fmt::print(
        "{:22} {:7} rays, {:7} {:7} {:7} {:7} hits: single {:5.1f} of {:5.1f} = {:.2f}, "
        "16 {:5.1f} of {:5.1f} = {:.2f}\n",
        rays.name, rays.ours.size(), hits[0], hits[1], hits[2], hits[3], median[1], median[0],
        median[1] / median[0], median[3], median[2], median[3] / median[2]);
  }
  return 0;
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  if (argc < 2 || argc > 3) {
    fmt::print(stderr, "usage: ray_rates SCENE.toml [REPEATS]\n");
    return 2;
  }
  try {
    return haarlight::render::run(argv[1], argc > 2 ? std::stoi(argv[2]) : 7);
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
