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
#include "render/radiosity/elements.h"
#include "render/radiosity/exchange.h"
#include "render/radiosity/patch_rays.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr std::size_t kSidesAtOnce = 16;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

[[noreturn]] void refuse(const Material& material, const char* what, const char* hint) {
  throw Error(what, material.name.empty() ? "a material" : "material " + material.name, hint);
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
                             const Elements& elements, std::uint32_t n_rays) {
  const std::size_t n = elements.size();
  std::vector<std::vector<RayCount>> counts(n);
  std::vector<std::uint32_t> n_of_element(n, 0);
  parallel_for(elements.n_sides(), kSidesAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t side = begin; side < end; ++side) {
      PatchRays::Met met = rays.met_by(elements, side);
      counts[side] = std::move(met.counts[0]);
      n_of_element[side] = met.n_rays[0];
      if (const std::optional<std::size_t> within = elements.within(side)) {
        counts[*within] = std::move(met.counts[1]);
        n_of_element[*within] = met.n_rays[1];
      }
    }
  });
  Eigen::VectorXd root_area(static_cast<Eigen::Index>(n));
  for (std::size_t i = 0; i < n; ++i) {
    // Of its part of the side's points; where no ray began there, of half a point's.
    const double part = std::max(0.5, static_cast<double>(n_of_element[i])) / n_rays;
    root_area[static_cast<Eigen::Index>(i)] =
        std::sqrt(part * patches.area_mm2(elements.side_of(i) / 2));
  }
  return exchange_of(counts, n_of_element, root_area);
}

/// The equation once more, at the vertices: sum_j F_vj B_j.
void gather_at_vertices(const PatchRays& rays, const Patches& patches, const Elements& elements,
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
          irradiance[number] =
              rays.arriving(elements, triangle, side == 0, seen_from(i, j, n), number, radiosity)
                  .cast<float>();
        }
      }
    }
  });
}

}  // namespace

Exchange<float> form_factors(const Scene& scene, const RayCaster& caster,
                             const Patches& patches, const RadiosityOptions& options) {
  const PatchRays rays(scene, caster, nullptr, patches, options.rays, options.seed);
  return form_factors(rays, patches, rays.elements(), options.rays);
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
    : patches_(scene, options.patches), irradiance_(2 * patches_.n_vertices(), Vector3f::Zero()) {
  HAARLIGHT_EXPECTS(options.rays >= 1, "a ray for each element");
  const PatchRays rays(scene, caster, environment, patches_, options.rays, options.seed);
  const Elements elements = rays.elements();
  const std::size_t n = elements.size();
  const Exchange<float> exchange = form_factors(rays, patches_, elements, options.rays);
  n_form_factors_ = exchange.values.size();
  std::vector<PatchRays::Direct> direct(elements.n_sides());
  parallel_for(direct.size(), kSidesAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t side = begin; side < end; ++side) {
      direct[side] = rays.direct_at(elements, side);
    }
  });
  for (const PatchRays::Direct& of_side : direct) {
    n_rays_ += options.rays + of_side.n_rays;
  }
  radiosity_.assign(n, Vector3d::Zero());
  for (int colour = 0; colour < 3; ++colour) {
    Eigen::VectorXd emitted(static_cast<Eigen::Index>(n));
    Eigen::VectorXd albedo(static_cast<Eigen::Index>(n));
    for (std::size_t i = 0; i < n; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      const PatchRays::Direct& of_side = direct[elements.side_of(i)];
      const std::size_t part = i < elements.n_sides() ? 0 : 1;
      albedo[row] = std::min(of_side.albedo[colour], 1.0);
      emitted[row] = albedo[row] * of_side.irradiance.at(part)[colour];
    }
    const RadiositySolution solution = solve_radiosity(exchange, emitted, albedo);
    for (std::size_t i = 0; i < n; ++i) {
      radiosity_[i][colour] = solution.radiosity[static_cast<Eigen::Index>(i)];
    }
  }
  gather_at_vertices(rays, patches_, elements, radiosity_, irradiance_);
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
