// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct/direct_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/direct/light_cells.h"
#include "render/direct/silhouette_edges.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kJitterTables = 64;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

enum class Sight : std::uint8_t { hidden, seen, mixed, dark };  // dark: no light can arrive

/// Gauss-Legendre nodes on [-1, 1] and weights of sum 1.
struct Rule {
  int n;
  std::array<double, 8> x;
  std::array<double, 8> w;
};
constexpr Rule kRule2 = {2, {-0.5773502691896257645, 0.5773502691896257645}, {0.5, 0.5}};
constexpr Rule kRule4 = {4,
                         {-0.8611363115940525752, -0.3399810435848562648, 0.3399810435848562648,
                          0.8611363115940525752},
                         {0.1739274225687269287, 0.3260725774312730713, 0.3260725774312730713,
                          0.1739274225687269287}};
constexpr Rule kRule8 = {8,
                         {-0.9602898564975362317, -0.7966664774136267396,
                          -0.5255324099163289858, -0.1834346424956498049, 0.1834346424956498049,
                          0.5255324099163289858, 0.7966664774136267396, 0.9602898564975362317},
                         {0.0506142681451881296, 0.1111905172266872352, 0.1568533229389436437,
                          0.1813418916891809915, 0.1813418916891809915, 0.1568533229389436437,
                          0.1111905172266872352, 0.0506142681451881296}};

/// The integrands of D and S at a point of a light, for unit radiance.
struct Integrand {
  const SurfacePoint& surface;
  double exponent = 0.0;
  double lobe_scale = 0.0;  ///< (n + 8)/(8 pi), 0 when there is no lobe
  double h = 0.0;           ///< distance of the surface point from the light's plane
  double mu = 1.0;

  /// (D, S) per unit of area of the light.
  [[nodiscard]] Vector2d at(const Vector3d& light_point) const {
    const Vector3d r = light_point - surface.point;
    const double r2 = r.squaredNorm();
    const double inverse = 1.0 / std::sqrt(r2);
    const double cos_theta = surface.normal.dot(r) * inverse;
    if (!(cos_theta > 0.0)) {
      return Vector2d::Zero();
    }
    const double cos_l = h * inverse;
    const double base = cos_theta * (mu == 1.0 ? cos_l : std::pow(cos_l, mu)) / r2;
    double specular = 0.0;
    if (lobe_scale > 0.0) {
      const Vector3d half = r * inverse + surface.to_eye;
      const double cos_h = surface.normal.dot(half) / half.norm();
      specular = cos_h > 0.0 ? base * lobe_scale * std::pow(cos_h, exponent) : 0.0;
    }
    return {base * std::numbers::inv_pi, specular};
  }
};

}  // namespace

/// What the outline of a scene may part: the lights' cells, and the edges.
struct DirectLight::Outline {
  SilhouetteEdges edges;
  std::vector<LightCells> grids;
  std::vector<int> grid_of;  ///< by light
  std::vector<std::uint8_t>
      crossing;  ///< by light: kLightCrossed where geometry cuts its plane
};

struct DirectLight::Scratch {
  Vector3d origin;  ///< of shadow rays
  std::vector<Sight> sight;
  std::vector<Vector3d> targets;
  std::vector<std::uint8_t> blocked;
  std::vector<std::uint8_t> marks;  ///< by light, what the outline crosses
  std::vector<Pyramid> pyramids;
  std::vector<int> grid_of;  ///< of each pyramid
  SilhouetteEdges::Scratch edges;
  struct Crossing {
    FlatSegment segment;
    int next;  ///< crossing of the same light, or -1
  };
  std::vector<Crossing> crossings;
  std::vector<int> crossing_of;  ///< by light, the last one, or -1
  std::vector<int> ray_of;       ///< by light: the ray that tells of it, or -1
  std::vector<int> regions;      ///< of lights, or of one light's strata
  std::vector<int> cell_of;
  std::vector<int> labels;
  std::vector<std::uint8_t> strata;
  std::uint64_t n_rays = 0;

  void cast(const RayCaster& caster) {
    blocked.resize(targets.size());
    caster.are_blocked(origin, targets, blocked);
    n_rays += targets.size();
  }
};

void require_for_direct_light(const Scene& scene, const std::string& where,
                              std::string_view program) {
  if (!scene.spheres.empty() || !scene.disks.empty()) {
    throw Error(
        fmt::format("an exact sphere or a disk; {} renders triangles only", program), where,
        "leave out exact = true, describe the [[disk]] as a mesh, or use `haarlight render "
        "surface`");
  }
  for (const Material& material : scene.materials) {
    if (material.bsdf != BsdfKind::blinn_phong) {
      throw Error(
          fmt::format("material '{}' has bsdf = \"{}\"; {} renders \"blinn_phong\" only",
                      material.name, to_string(material.bsdf), program),
          where, "describe it by kd, ks and exponent, or use `haarlight render surface`");
    }
    if (!material.kd_texture.file.empty()) {
      throw Error(fmt::format("material '{}' has a texture; {} renders plain colours only",
                              material.name, program),
                  where,
                  "give it kd without a texture, on a [[mesh]] by its key material, or use "
                  "`haarlight render surface`");
    }
  }
}

DirectLight::DirectLight(const RayCaster& caster, std::span<const SquareLight> lights,
                         const DirectLightOptions& options)
    : caster_(&caster), lights_(lights.begin(), lights.end()), options_(options) {
  HAARLIGHT_EXPECTS(options.mixed_grid >= 1 && options.mixed_grid <= 64,
                    "1 <= mixed_grid <= 64");
  const int n = options.mixed_grid;
  jitter_.reserve(to_index(kJitterTables * n * n));
  for (int table = 0; table < kJitterTables; ++table) {
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const auto cell = to_index((table * n + j) * n + i);
        jitter_.emplace_back((i + uniform_unit(hash_key(options.seed, 1, cell))) / n,
                             (j + uniform_unit(hash_key(options.seed, 2, cell))) / n);
      }
    }
  }
  if (options.sample_all) {
    return;
  }
  HAARLIGHT_EXPECTS(!caster.has_instances(),
                    "a scene without instances: with_instances_expanded()");
  auto outline = std::make_shared<Outline>(Outline{
      .edges = SilhouetteEdges(caster.meshes()), .grids = {}, .grid_of = {}, .crossing = {}});
  outline->crossing.assign(lights_.size(), 0);
  for (const LightGrid& grid : find_light_grids(lights)) {
    const LightCells& cells = outline->grids.emplace_back(grid, lights_[to_index(grid.first)]);
    outline->grid_of.resize(to_index(grid.first + cells.size()),
                            static_cast<int>(outline->grids.size()) - 1);
    cells.mark_crossing(
        outline->edges, caster.ray_offset_mm(),
        std::span(outline->crossing).subspan(to_index(grid.first), to_index(cells.size())));
  }
  outline_ = std::move(outline);
}

void DirectLight::mark_outline(const SurfacePoint& surface, Scratch& scratch) const {
  scratch.marks = outline_->crossing;
  scratch.crossings.clear();
  scratch.crossing_of.assign(lights_.size(), -1);
  scratch.pyramids.clear();
  scratch.grid_of.clear();
  for (std::size_t g = 0; g < outline_->grids.size(); ++g) {
    const LightCells& cells = outline_->grids[g];
    const auto first = scratch.sight.begin() + cells.grid().first;
    const bool is_dark = std::all_of(first, first + cells.size(),
                                     [](Sight sight) { return sight == Sight::dark; });
    if (!is_dark && cells.height(scratch.origin) > 0.0) {
      scratch.pyramids.push_back(cells.pyramid(scratch.origin));
      scratch.grid_of.push_back(static_cast<int>(g));
    }
  }
  outline_->edges.find(scratch.origin, scratch.pyramids, scratch.edges);
  for (const OutlineEdge& edge : scratch.edges.found) {
    const auto pyramid = to_index(edge.pyramid);
    const LightCells& cells = outline_->grids[to_index(scratch.grid_of[pyramid])];
    const std::optional<FlatSegment> segment =
        cells.project(scratch.pyramids[pyramid], edge.a, edge.b);
    if (segment) {
      const int first = cells.grid().first;
      cells.mark(*segment,
                 std::span(scratch.marks).subspan(to_index(first), to_index(cells.size())),
                 [&](int cell) {
                   int& last = scratch.crossing_of[to_index(first + cell)];
                   scratch.crossings.push_back({*segment, last});
                   last = static_cast<int>(scratch.crossings.size()) - 1;
                 });
    }
  }
  // The surface's own horizon is too near for its edges to be told.
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    const SquareLight& light = lights_[k];
    const double reach = 0.5 * std::hypot(light.width_mm, light.height_mm);
    if (surface.flat_normal.dot(light.centre - scratch.origin) < reach) {
      scratch.marks[k] = kCellCrossed | kLightCrossed | kAnywhere;
    }
  }
}

/// Neighbours in cells that nothing crosses see the same: one ray tells for all of them.
void DirectLight::classify(const SurfacePoint& surface, Scratch& scratch) const {
  mark_outline(surface, scratch);
  scratch.targets.clear();
  scratch.ray_of.assign(lights_.size(), -1);
  for (const LightCells& cells : outline_->grids) {
    const LightGrid& grid = cells.grid();
    const auto sight = std::span(scratch.sight).subspan(to_index(grid.first));
    const auto marks = std::span(scratch.marks).subspan(to_index(grid.first));
    scratch.regions.resize(to_index(cells.size()));
    find_regions(
        grid.rows, grid.cols, marks,
        [&](int cell) {
          return sight[to_index(cell)] == Sight::dark ||
                 (marks[to_index(cell)] & kLightCrossed) != 0;
        },
        scratch.labels, scratch.regions, scratch.cell_of);
    for (int i = 0; i < cells.size(); ++i) {
      const int region = scratch.regions[to_index(i)];
      scratch.ray_of[to_index(grid.first + i)] =
          region < 0 ? -1 : static_cast<int>(scratch.targets.size()) + region;
    }
    for (const int cell : scratch.cell_of) {
      scratch.targets.push_back(lights_[to_index(grid.first + cell)].centre);
    }
  }
  scratch.cast(*caster_);
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    if (scratch.ray_of[k] >= 0) {
      const bool is_blocked = scratch.blocked[to_index(scratch.ray_of[k])] != 0;
      scratch.sight[k] = is_blocked ? Sight::hidden : Sight::seen;
    } else if (scratch.sight[k] != Sight::dark) {
      scratch.sight[k] = Sight::mixed;
    }
  }
}

/// One ray for strata side by side that nothing crosses, one for each other stratum. Afterwards
/// scratch.blocked tells of the first of each region, scratch.regions of which region each is.
void DirectLight::cast_strata(int k, std::span<const Vector2d> cells, Scratch& scratch) const {
  const SquareLight& light = lights_[to_index(k)];
  const int n = options_.mixed_grid;
  const bool is_anywhere = outline_ == nullptr || (scratch.marks[to_index(k)] & kAnywhere) != 0;
  scratch.strata.assign(to_index(n * n), is_anywhere ? 1 : 0);
  if (!is_anywhere) {
    const LightCells& grid = outline_->grids[to_index(outline_->grid_of[to_index(k)])];
    for (int i = scratch.crossing_of[to_index(k)]; i >= 0;
         i = scratch.crossings[to_index(i)].next) {
      grid.mark_strata(scratch.crossings[to_index(i)].segment, k - grid.grid().first, n,
                       scratch.strata);
    }
  }
  scratch.regions.resize(to_index(n * n));
  find_regions(
      n, n, scratch.strata, [](int) { return false; }, scratch.labels, scratch.regions,
      scratch.cell_of);
  scratch.targets.clear();
  for (const int i : scratch.cell_of) {
    const Vector2d& cell = cells[to_index(i)];
    scratch.targets.emplace_back(light.centre + (cell.x() - 0.5) * light.width_mm * light.u +
                                 (cell.y() - 0.5) * light.height_mm * light.v);
  }
  scratch.cast(*caster_);
}

void DirectLight::sample_mixed(int k, const SurfacePoint& surface, const Material& material,
                               std::uint64_t key, Scratch& scratch,
                               LightContribution& contribution) const {
  const SquareLight& light = lights_[static_cast<std::size_t>(k)];
  const int n = options_.mixed_grid;
  const auto n_cells = to_index(n * n);
  const std::uint64_t table =
      hash_key(options_.seed, key, static_cast<std::uint64_t>(k)) % kJitterTables;
  const std::span<const Vector2d> cells(jitter_.data() + table * n_cells, n_cells);
  cast_strata(k, cells, scratch);
  const auto is_blocked = [&](std::size_t stratum) {
    return scratch.blocked[to_index(scratch.regions[stratum])] != 0;
  };
  const bool has_lobe = material.ks > 0.0;
  const Integrand f{surface, material.exponent,
                    has_lobe ? (material.exponent + 8.0) / (8.0 * std::numbers::pi) : 0.0,
                    light.emits.dot(surface.point - light.centre), light.lobe_mu};
  Vector2d sum = Vector2d::Zero();
  int n_seen = 0;
  for (std::size_t i = 0; i < n_cells; ++i) {
    if (!is_blocked(i)) {
      sum += f.at(light.centre + (cells[i].x() - 0.5) * light.width_mm * light.u +
                  (cells[i].y() - 0.5) * light.height_mm * light.v);
      ++n_seen;
    }
  }
  // Strata that the shadow's edge crosses: neighbours that disagree. A stratum cut at a random
  // position has variance 1/6 on average.
  int n_edges = 0;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const bool here = is_blocked(to_index(j * n + i));
      n_edges += i + 1 < n && here != is_blocked(to_index(j * n + i + 1));
      n_edges += j + 1 < n && here != is_blocked(to_index((j + 1) * n + i));
    }
  }
  const double cells_inverse = 1.0 / static_cast<double>(n_cells);
  const double scale = light.radiance * light.width_mm * light.height_mm * cells_inverse;
  contribution.diffuse = scale * sum.x();
  contribution.specular = scale * sum.y();
  contribution.visible = n_seen * cells_inverse;
  contribution.error = std::sqrt(n_edges / 6.0) * cells_inverse;
}

std::uint64_t DirectLight::evaluate(const SurfacePoint& surface, const Material& material,
                                    std::uint64_t key,
                                    std::span<LightContribution> contributions) const {
  HAARLIGHT_EXPECTS(contributions.size() == lights_.size(), "one fraction per light");
  HAARLIGHT_EXPECTS(material.bsdf == BsdfKind::blinn_phong, "a material that is known here");
  Scratch scratch;
  scratch.origin = surface.point + caster_->ray_offset_mm() * surface.flat_normal;
  scratch.sight.assign(lights_.size(), Sight::seen);
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    const SquareLight& light = lights_[k];
    const Vector3d r = light.centre - surface.point;
    const double reach = 0.5 * (light.width_mm + light.height_mm);
    if (!(light.emits.dot(r) < 0.0) || surface.normal.dot(r) < -reach ||
        surface.flat_normal.dot(r) < -reach) {
      scratch.sight[k] = Sight::dark;
    }
  }
  if (outline_ != nullptr) {
    classify(surface, scratch);
  } else {
    for (Sight& sight : scratch.sight) {
      sight = sight == Sight::dark ? Sight::dark : Sight::mixed;
    }
  }
  const bool has_lobe = material.ks > 0.0;
  const double lobe_scale =
      has_lobe ? (material.exponent + 8.0) / (8.0 * std::numbers::pi) : 0.0;
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    LightContribution& contribution = contributions[k];
    contribution = LightContribution{};
    const Sight sight = scratch.sight[k];
    if (sight == Sight::dark || sight == Sight::hidden) {
      continue;
    }
    const SquareLight& light = lights_[k];
    const Vector3d r = light.centre - surface.point;
    const double reach = 0.5 * std::hypot(light.width_mm, light.height_mm);
    // A light cut by the horizon is not a smooth integrand: strata.
    if (sight == Sight::mixed || surface.normal.dot(r) < reach) {
      sample_mixed(static_cast<int>(k), surface, material, key, scratch, contribution);
      continue;
    }
    // How fast the integrand varies over the light: by distance, and by the lobe's width.
    const double angle = reach / std::max(r.norm() - reach, 1e-300);
    const double turn =
        std::max(angle, 0.5 * angle * std::sqrt(has_lobe ? material.exponent : 0.0));
    const Rule& rule = turn < 0.1 ? kRule2 : turn < 0.6 ? kRule4 : kRule8;
    const Integrand f{surface, material.exponent, lobe_scale,
                      light.emits.dot(surface.point - light.centre), light.lobe_mu};
    const Vector3d half_u = 0.5 * light.width_mm * light.u;
    const Vector3d half_v = 0.5 * light.height_mm * light.v;
    Vector2d sum = Vector2d::Zero();
    for (std::size_t j = 0; j < static_cast<std::size_t>(rule.n); ++j) {
      for (std::size_t i = 0; i < static_cast<std::size_t>(rule.n); ++i) {
        sum += rule.w[i] * rule.w[j] *
               f.at(light.centre + rule.x[i] * half_u + rule.x[j] * half_v);
      }
    }
    sum *= light.radiance * light.width_mm * light.height_mm;
    contribution.diffuse = sum.x();
    contribution.specular = sum.y();
    contribution.visible = 1.0;
  }
  return scratch.n_rays;
}

}  // namespace haarlight::render
