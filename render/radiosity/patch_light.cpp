// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/patch_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <numeric>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>

#include <Eigen/Geometry>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/bsdf/shading_frame.h"
#include "render/light/scene_lights.h"
#include "render/radiosity/exchange.h"
#include "render/sampling/sampler.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

enum Question : std::uint32_t { point, direction, light, eye };
/// Whose numbers: the second key of a point's samples, that of no pixel.
enum Numbers : int { of_elements = -1, of_vertices = -2 };

constexpr std::uint32_t kLightSamples = 256;  // of each side: direct light is smooth over most
constexpr std::size_t kElementsAtOnce = 16;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

[[noreturn]] void refuse(const Material& material, const char* what, const char* hint) {
  throw Error(what, material.name.empty() ? "a material" : "material " + material.name, hint);
}

/// All that looks at the scene's surfaces, as its patches see them.
class PatchRays {
 public:
  PatchRays(const Scene& scene, const RayCaster& caster, const Environment* environment,
            const Patches& patches, const RadiosityOptions& options)
      : scene_(&scene),
        caster_(&caster),
        patches_(&patches),
        options_(options),
        lights_(scene, environment, caster.scene_radius_mm(), LightChoice::tree) {
    for (std::size_t i = 0; i < lights_.size(); ++i) {
      const std::optional<std::uint32_t> surface = lights_.surface_of(i);
      light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
    }
  }

  [[nodiscard]] PixelSamples numbers(std::size_t of, Numbers whose) const {
    return {SamplerKind::sobol, options_.seed, static_cast<int>(of), static_cast<int>(whose)};
  }

  /// A point of a triangle's side, as if a ray had met it.
  [[nodiscard]] Hit on(const CutTriangle& triangle, bool is_front, const Vector2d& uv) const {
    const Vector3d normal = is_front ? triangle.normal : Vector3d(-triangle.normal);
    const double away = std::sqrt(triangle.area_mm2);
    return caster_->surface_at(
        {.origin = triangle.at(uv) + away * normal, .direction = -normal},
        {.t = static_cast<float>(away),
         .u = static_cast<float>(uv.x()),
         .v = static_cast<float>(uv.y()),
         .mesh = triangle.surface,
         .triangle = triangle.triangle});
  }

  /// A ray from there by the cosine law.
  [[nodiscard]] static Ray leaving(const Hit& hit, const Vector2d& square) {
    return {.origin = hit.point + hit.offset_mm * hit.flat_normal,
            .direction = frame_of(hit.flat_normal) * cosine_direction(square)};
  }

  /// The element that a ray has met.
  [[nodiscard]] std::optional<std::size_t> element_of(const Ray& ray, const RawHit& raw) const {
    if (!raw.is_hit()) {
      return std::nullopt;
    }
    const std::optional<PatchPoint> found = patches_->find(raw);
    if (!found) {
      return std::nullopt;
    }
    const bool is_front = patches_->triangle_of(found->patch).normal.dot(ray.direction) < 0.0;
    return 2 * found->patch + (is_front ? 0 : 1);
  }

  void cast(const std::vector<Ray>& rays, std::vector<RawHit>& hits) const {
    hits.resize(rays.size());
    caster_->intersect(rays, RayOrder::scattered, hits);
  }

  /// What an element's rays meet.
  [[nodiscard]] std::vector<RayCount> met_by(std::size_t element) const;
  struct Direct {
    Vector3d irradiance = Vector3d::Zero();  ///< of lights, mean over the element
    Vector3d albedo = Vector3d::Zero();
    std::uint64_t n_rays = 0;
  };
  /// By points of lights and by directions, weighted by the power heuristic [Veach95].
  [[nodiscard]] Direct direct_at(std::size_t element) const;
  /// The mean over rays by the cosine law of the radiosity of what they meet.
  [[nodiscard]] Vector3d arriving(const Hit& hit, const PixelSamples& numbers,
                                  const std::vector<Vector3d>& radiosity) const;

 private:
  /// Rays to points of lights, and what arrives along each.
  struct Towards {
    std::vector<Ray> rays;
    std::vector<Vector3d> arrives;
  };
  void ask(const Hit& hit, const Vector2d& square, Towards& towards) const;
  [[nodiscard]] Vector3d met_light(const Hit& from, const Ray& ray, const RawHit& raw) const;

  const Scene* scene_;
  const RayCaster* caster_;
  const Patches* patches_;
  RadiosityOptions options_;
  SceneLights lights_;
  std::vector<double> light_offsets_;
};

std::vector<RayCount> PatchRays::met_by(std::size_t element) const {
  const std::size_t patch = element / 2;
  const CutTriangle& triangle = patches_->triangle_of(patch);
  const PixelSamples numbers = this->numbers(element, of_elements);
  std::vector<Ray> rays(options_.rays);
  for (std::uint32_t i = 0; i < options_.rays; ++i) {
    const Hit hit =
        on(triangle, element % 2 == 0, patches_->uv_in(patch, numbers.two(i, point)));
    rays[i] = leaving(hit, numbers.two(i, direction));
  }
  std::vector<RawHit> hits;
  cast(rays, hits);
  std::vector<std::uint32_t> met;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const std::optional<std::size_t> other = element_of(rays[i], hits[i]);
    if (other && *other != element) {
      met.push_back(static_cast<std::uint32_t>(*other));
    }
  }
  std::ranges::sort(met);
  std::vector<RayCount> counts;
  for (const std::uint32_t other : met) {
    if (counts.empty() || counts.back().element != other) {
      counts.push_back({.element = other});
    }
    ++counts.back().n;
  }
  return counts;
}

PatchRays::Direct PatchRays::direct_at(std::size_t element) const {
  const std::size_t patch = element / 2;
  const CutTriangle& triangle = patches_->triangle_of(patch);
  const PixelSamples numbers = this->numbers(element, of_elements);
  Direct direct;
  Towards towards;
  std::vector<Ray> onward;
  std::vector<Hit> from;
  for (std::uint32_t i = 0; i < kLightSamples; ++i) {
    const Hit hit =
        on(triangle, element % 2 == 0, patches_->uv_in(patch, numbers.two(i, point)));
    direct.albedo +=
        diffuse_albedo(bsdf_of(*scene_, hit), cosine_direction(numbers.two(i, eye)));
    if (lights_.size() > 0) {
      ask(hit, numbers.two(i, light), towards);
      if (lights_.is_any_met()) {
        onward.push_back(leaving(hit, numbers.two(i, direction)));
        from.push_back(hit);
      }
    }
  }
  std::vector<std::uint8_t> blocked(towards.rays.size());
  caster_->are_blocked(towards.rays, RayOrder::scattered, blocked);
  for (std::size_t i = 0; i < blocked.size(); ++i) {
    if (blocked[i] == 0) {
      direct.irradiance += towards.arrives[i];
    }
  }
  std::vector<RawHit> hits;
  cast(onward, hits);
  for (std::size_t i = 0; i < hits.size(); ++i) {
    direct.irradiance += met_light(from[i], onward[i], hits[i]);
  }
  direct.irradiance /= kLightSamples;
  direct.albedo /= kLightSamples;
  direct.n_rays = blocked.size() + hits.size();
  return direct;
}

/// Puts a ray to a point of a light among those that wait.
void PatchRays::ask(const Hit& hit, const Vector2d& square, Towards& towards) const {
  const std::optional<ChosenLight> chosen =
      lights_.choose({.point = hit.point, .normal = hit.flat_normal}, square);
  if (!chosen) {
    return;
  }
  const double light_offset = light_offsets_[chosen->index];
  const LightSample sample = render::sample(lights_[chosen->index], hit.point, chosen->square);
  const double cosine = hit.flat_normal.dot(sample.direction);
  if (!sample.is_found || !(sample.distance_mm > nearest_asked(hit.offset_mm, light_offset)) ||
      !(cosine > 0.0)) {
    return;
  }
  const double asked = chosen->probability * sample.density;
  const double weight = !sample.is_delta && lights_.is_met(chosen->index)
                            ? power_heuristic(asked, cosine * std::numbers::inv_pi)
                            : 1.0;
  towards.rays.push_back(light_ray(hit, sample, light_offset));
  towards.arrives.emplace_back(weight * cosine / asked * sample.radiance);
}

/// The irradiance of a light that a ray by the cosine law has met: pi L, weighted.
Vector3d PatchRays::met_light(const Hit& from, const Ray& ray, const RawHit& raw) const {
  std::optional<std::size_t> met = lights_.environment();
  LightHit at{.direction = ray.direction,
              .distance_mm = std::numeric_limits<double>::infinity(),
              .cosine = 1.0};
  Vector3d radiance = Vector3d::Zero();
  if (raw.is_hit()) {
    met = lights_.of_surface(raw.mesh);
    if (!met) {
      return Vector3d::Zero();
    }
    const Hit hit = caster_->surface_at(ray, raw);
    at.distance_mm = hit.distance_mm;
    at.cosine = -hit.flat_normal.dot(ray.direction);
    radiance = hit.is_front ? lights_.radiance_of_surface(raw.mesh) : Vector3d::Zero();
  } else if (met) {
    radiance = std::get<EnvironmentSourceLight>(lights_[*met]).light.radiance(ray.direction);
  }
  if (!(radiance.maxCoeff() > 0.0)) {
    return Vector3d::Zero();
  }
  const double asked = at.distance_mm > nearest_asked(from.offset_mm, light_offsets_[*met])
                           ? lights_.probability(*met, {from.point, from.flat_normal}) *
                                 density(lights_[*met], from.point, at)
                           : 0.0;
  const double followed = from.flat_normal.dot(ray.direction) * std::numbers::inv_pi;
  return std::numbers::pi * power_heuristic(followed, asked) * radiance;
}

Vector3d PatchRays::arriving(const Hit& hit, const PixelSamples& numbers,
                             const std::vector<Vector3d>& radiosity) const {
  std::vector<Ray> rays(options_.rays);
  for (std::uint32_t i = 0; i < options_.rays; ++i) {
    rays[i] = leaving(hit, numbers.two(i, direction));
  }
  std::vector<RawHit> hits;
  cast(rays, hits);
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (const std::optional<std::size_t> element = element_of(rays[i], hits[i])) {
      sum += radiosity[*element];
    }
  }
  return sum / options_.rays;
}

/// Vertices on the edges of a mesh's triangles that are at one place: by the ends of the edge and
/// where on it.
using EdgePoint = std::array<int, 4>;
struct SideVertex {
  std::size_t number;  ///< 2 vertex + side
  Vector3d normal;     ///< of that side
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

/// Barycentric coordinates of a triangle's vertex, a tenth of a patch within it where it is on its
/// edge: seen from the edge itself half of the next wall would be behind.
Vector2d seen_from(int i, int j, int n) {
  Vector2d uv = Vector2d(i, j) / n;
  if (i > 0 && j > 0 && i + j < n) {
    return uv;
  }
  return uv + 0.3 / n * (Vector2d::Constant(1.0 / 3.0) - uv);
}

/// Makes vertices at one place of a surface one, but for creases: each is the mean of those whose
/// sides are less than 30 degrees apart. What nothing reaches is covered and does not count.
void join_vertices(const std::map<EdgePoint, std::vector<SideVertex>>& shared,
                   std::vector<Vector3f>& irradiance) {
  constexpr double kCrease = 0.866;
  for (const auto& [place, vertices] : shared) {
    std::vector<Vector3f> means;
    for (const SideVertex& own : vertices) {
      Vector3f sum = Vector3f::Zero();
      int n = 0;
      for (const SideVertex& other : vertices) {
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
                 std::vector<Vector3f>& irradiance) {
  const auto mesh_number = [&scene](std::uint32_t surface) {
    const std::size_t n_others =
        scene.meshes.size() + scene.spheres.size() + scene.disks.size();
    return surface < scene.meshes.size()
               ? surface
               : static_cast<std::size_t>(scene.instances[surface - n_others].mesh);
  };
  const std::vector<CutTriangle>& triangles = patches.triangles();
  for (std::size_t begin = 0; begin < triangles.size();) {
    const std::uint32_t surface = triangles[begin].surface;
    const Mesh& mesh = scene.meshes[mesh_number(surface)];
    const std::vector<int> positions = positions_of(mesh);
    std::map<EdgePoint, std::vector<SideVertex>> shared;
    std::size_t end = begin;
    for (; end < triangles.size() && triangles[end].surface == surface; ++end) {
      const CutTriangle& triangle = triangles[end];
      const int n = triangle.n;
      const Eigen::Vector3i& corners = mesh.triangles[triangle.triangle];
      const auto at = [&](int corner) { return positions[to_index(corners[corner])]; };
      for (int j = 0; j <= n && n > 0; ++j) {
        for (int i = 0; i + j <= n; ++i) {
          const std::size_t vertex = triangle.vertex(i, j);
          EdgePoint place{};
          if (j == 0) {
            place = edge_point(at(0), at(1), i, n);
          } else if (i == 0) {
            place = edge_point(at(0), at(2), j, n);
          } else if (i + j == n) {
            place = edge_point(at(1), at(2), j, n);
          } else {
            continue;
          }
          shared[place].push_back({.number = 2 * vertex, .normal = triangle.normal});
          shared[place].push_back({.number = 2 * vertex + 1, .normal = -triangle.normal});
        }
      }
    }
    join_vertices(shared, irradiance);
    begin = end;
  }
}

Exchange<float> form_factors(const PatchRays& rays, const Patches& patches,
                             const RadiosityOptions& options) {
  const std::size_t n = patches.n_elements();
  std::vector<std::vector<RayCount>> counts(n);
  parallel_for(n, kElementsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      counts[i] = rays.met_by(i);
    }
  });
  Eigen::VectorXd root_area(static_cast<Eigen::Index>(n));
  for (std::size_t i = 0; i < n; ++i) {
    root_area[static_cast<Eigen::Index>(i)] = std::sqrt(patches.area_mm2(i / 2));
  }
  return exchange_of(counts, root_area, options.rays);
}

/// The equation once more, at the vertices: sum_j F_vj B_j.
void gather_at_vertices(const PatchRays& rays, const Patches& patches,
                        const std::vector<Vector3d>& radiosity,
                        std::vector<Vector3f>& irradiance) {
  struct Place {
    std::size_t triangle;
    int j;
  };
  std::vector<Place> rows;  // of vertices
  const std::vector<CutTriangle>& triangles = patches.triangles();
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    for (int j = 0; j <= triangles[t].n && triangles[t].n > 0; ++j) {
      rows.push_back({.triangle = t, .j = j});
    }
  }
  parallel_for(rows.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t row = begin; row < end; ++row) {
      const CutTriangle& triangle = triangles[rows[row].triangle];
      const int n = triangle.n;
      const int j = rows[row].j;
      for (int i = 0; i + j <= n; ++i) {
        for (std::size_t side = 0; side < 2; ++side) {
          const std::size_t number = 2 * triangle.vertex(i, j) + side;
          const Hit hit = rays.on(triangle, side == 0, seen_from(i, j, n));
          irradiance[number] =
              rays.arriving(hit, rays.numbers(number, of_vertices), radiosity).cast<float>();
        }
      }
    }
  });
}

}  // namespace

Exchange<float> form_factors(const Scene& scene, const RayCaster& caster,
                             const Patches& patches, const RadiosityOptions& options) {
  return form_factors(PatchRays(scene, caster, nullptr, patches, options), patches, options);
}

void require_diffuse(const Scene& scene) {
  const auto require = [&scene](int number, bool is_cut) {
    const Material& material = scene.materials[to_index(number)];
    switch (material.bsdf) {
      case BsdfKind::blinn_phong:
      case BsdfKind::oren_nayar:
        break;
      case BsdfKind::mirror:
      case BsdfKind::dielectric:
      case BsdfKind::conductor:
      case BsdfKind::coated:
        refuse(material, "radiosity is of diffuse surfaces, and this material has a direction",
               "give it bsdf = \"blinn_phong\" or \"oren_nayar\", or render with --integrator "
               "path");
    }
    if (!is_cut && material.kd.maxCoeff() > 0.0) {
      refuse(material,
             "radiosity cuts triangles into patches, and this is an exact sphere or disk",
             "leave out exact, make a disk a mesh, or give a lamp's material kd = [0, 0, 0]");
    }
  };
  for (const Mesh& mesh : scene.meshes) {
    if (!mesh.triangles.empty()) {
      require(mesh.material, true);
    }
  }
  for (const Instance& instance : scene.instances) {
    require(material_of(scene, instance), true);
  }
  for (const Sphere& sphere : scene.spheres) {
    require(sphere.material, false);
  }
  for (const Disk& disk : scene.disks) {
    require(disk.material, false);
  }
}

Vector3d diffuse_albedo(const Bsdf& bsdf, const Vector3d& to_eye) {
  return std::visit(
      [&to_eye](const auto& kind) -> Vector3d {
        using Kind = std::decay_t<decltype(kind)>;
        if constexpr (std::is_same_v<Kind, Lambert> || std::is_same_v<Kind, BlinnPhong>) {
          return kind.kd;
        } else if constexpr (std::is_same_v<Kind, OrenNayar>) {
          return kind.albedo(to_eye);
        } else {
          return Vector3d::Zero();
        }
      },
      bsdf);
}

PatchLight::PatchLight(const Scene& scene, const RayCaster& caster,
                       const Environment* environment, const RadiosityOptions& options)
    : patches_(scene, options.patches),
      radiosity_(patches_.n_elements(), Vector3d::Zero()),
      irradiance_(2 * patches_.n_vertices(), Vector3f::Zero()) {
  HAARLIGHT_EXPECTS(options.rays >= 1, "a ray for each element");
  const PatchRays rays(scene, caster, environment, patches_, options);
  const std::size_t n = patches_.n_elements();
  const Exchange<float> exchange = form_factors(rays, patches_, options);
  n_form_factors_ = exchange.values.size();
  std::vector<PatchRays::Direct> direct(n);
  parallel_for(n, kElementsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      direct[i] = rays.direct_at(i);
    }
  });
  for (const PatchRays::Direct& of_element : direct) {
    n_rays_ += options.rays + of_element.n_rays;
  }
  for (int colour = 0; colour < 3; ++colour) {
    Eigen::VectorXd emitted(static_cast<Eigen::Index>(n));
    Eigen::VectorXd albedo(static_cast<Eigen::Index>(n));
    for (std::size_t i = 0; i < n; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      albedo[row] = std::min(direct[i].albedo[colour], 1.0);
      emitted[row] = albedo[row] * direct[i].irradiance[colour];
    }
    const RadiositySolution solution = solve_radiosity(exchange, emitted, albedo);
    for (std::size_t i = 0; i < n; ++i) {
      radiosity_[i][colour] = solution.radiosity[static_cast<Eigen::Index>(i)];
    }
  }
  gather_at_vertices(rays, patches_, radiosity_, irradiance_);
  n_rays_ += std::uint64_t{options.rays} * irradiance_.size();
  share_edges(scene, patches_, irradiance_);
}

std::uint64_t PatchLight::bytes_needed(const Scene& scene, const RadiosityOptions& options) {
  const std::uint64_t n_triangles = Patches::n_triangles(scene);
  const std::uint64_t n_patches = std::max<std::uint64_t>(n_triangles, options.patches);
  constexpr std::uint64_t kOfVertex =
      2 * sizeof(Vector3f) + std::uint64_t{3} * 64;  // a few at edges
  return n_triangles * sizeof(CutTriangle) + 3 * n_patches * kOfVertex +
         exchange_bytes(2 * n_patches, options.rays);
}

Vector3d PatchLight::irradiance(const RawHit& hit, bool is_front) const {
  const std::optional<PatchPoint> at = patches_.find(hit);
  if (!at) {
    return Vector3d::Zero();
  }
  const std::size_t side = is_front ? 0 : 1;
  std::array<Vector3d, 3> values;
  double most = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    values.at(i) = irradiance_[2 * at->vertices.at(i) + side].cast<double>();
    most = std::max(most, values.at(i).sum());
  }
  constexpr double kCovered = 0.01;
  Vector3d sum = Vector3d::Zero();
  double weights = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (values.at(i).sum() > kCovered * most) {
      sum += at->weights.at(i) * values.at(i);
      weights += at->weights.at(i);
    }
  }
  if (weights > 0.0) {
    return sum / weights;
  }
  return Vector3d::Zero();
}

}  // namespace haarlight::render
