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

constexpr std::size_t kSidesAtOnce = 16;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

[[noreturn]] void refuse(const Material& material, const char* what, const char* hint) {
  throw Error(what, material.name.empty() ? "a material" : "material " + material.name, hint);
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
    : patches_(scene, options.patches) {
  HAARLIGHT_EXPECTS(options.rays >= 1, "a ray for each element");
  const PatchRays rays(scene, caster, environment, patches_, options.rays, options.seed);
  const Elements elements = rays.elements();
  const std::size_t n = elements.size();
  const Exchange<float> exchange = form_factors(rays, patches_, elements, options.rays);
  std::vector<PatchRays::Direct> direct(elements.n_sides());
  parallel_for(direct.size(), kSidesAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t side = begin; side < end; ++side) {
      direct[side] = rays.direct_at(elements, side);
    }
  });
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
  std::vector<std::uint8_t> is_lit(elements.n_sides(), 0);
  for (std::size_t i = 0; i < n; ++i) {
    if (radiosity_[i].maxCoeff() > 0.0) {
      is_lit[elements.side_of(i)] = 1;
    }
  }
  const ElementSlopes light(patches_, elements, radiosity_);
  // The equation once more, at the vertices: sum_j F_vj B_j.
  shown_.emplace(
      scene, patches_, is_lit,
      [&](std::size_t number, const CutTriangle& triangle, bool is_front, const Vector2d& uv) {
        return rays.arriving(elements, triangle, is_front, uv, number, light);
      });
}

std::uint64_t PatchLight::bytes_needed(const Scene& scene, const RadiosityOptions& options) {
  const std::uint64_t n_triangles = Patches::n_triangles(scene);
  const std::uint64_t n_patches = std::max<std::uint64_t>(n_triangles, options.patches);
  // Of a side that is two elements the rays are shared, a row is not.
  constexpr std::uint64_t kOfSide = 256 + sizeof(Eigen::Matrix<float, 3, 2>);
  return n_triangles * sizeof(CutTriangle) + 2 * n_patches * kOfSide +
         VertexLight::bytes_needed(n_patches) + exchange_bytes(2 * n_patches, options.rays);
}

Vector3d PatchLight::irradiance(const RawHit& hit, bool is_front) const {
  const std::optional<PatchPoint> at = patches_.find(hit);
  return at ? shown_->irradiance(*at, is_front) : Vector3d(Vector3d::Zero());
}

}  // namespace haarlight::render
