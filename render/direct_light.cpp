// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <Eigen/Geometry>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kJitterTables = 64;
/// Lights share tests up to this distance from centre to centre, in sides: the rays to the cells'
/// corners then pass within a quarter of a side of the light that they test.
constexpr double kSharedStep = 1.5;

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

bool almost_equal(const Vector3d& a, const Vector3d& b, double scale) {
  return (a - b).norm() <= 1e-9 * scale;
}

/// Whether the rays between a grid's lights tell what each light sees. Few lights save nothing,
/// lights that stand apart are sampled in full like lone ones: shadows fit between their rays.
bool shares_tests(const LightGrid& grid, const SquareLight& light) {
  return grid.rows * grid.cols >= 4 && grid.step_u.norm() <= kSharedStep * light.width_mm &&
         grid.step_v.norm() <= kSharedStep * light.height_mm;
}

bool same_form(const SquareLight& a, const SquareLight& b) {
  return a.u == b.u && a.v == b.v && a.emits == b.emits && a.width_mm == b.width_mm &&
         a.height_mm == b.height_mm;
}

}  // namespace

struct DirectLight::Scratch {
  Vector3d origin;  ///< of shadow rays
  std::vector<Sight> sight;
  std::vector<Vector3d> targets;
  std::vector<std::uint8_t> blocked;
  std::vector<int> requested;  ///< lights that need a test of their own
  std::uint64_t n_rays = 0;

  void cast(const RayCaster& caster) {
    blocked.resize(targets.size());
    caster.are_blocked(origin, targets, blocked);
    n_rays += targets.size();
  }
};

std::vector<LightGrid> find_light_grids(std::span<const SquareLight> lights) {
  std::vector<LightGrid> grids;
  std::size_t i = 0;
  while (i < lights.size()) {
    LightGrid grid;
    grid.first = static_cast<int>(i);
    const double scale = lights[i].centre.norm() + lights[i].width_mm + lights[i].height_mm;
    // Columns: equal steps along u, no shorter than the light.
    if (i + 1 < lights.size() && same_form(lights[i], lights[i + 1])) {
      const Vector3d step = lights[i + 1].centre - lights[i].centre;
      const double along = step.dot(lights[i].u);
      if (along >= lights[i].width_mm && almost_equal(step, along * lights[i].u, scale)) {
        grid.step_u = step;
        std::size_t end = i + 1;
        while (end < lights.size() && same_form(lights[i], lights[end]) &&
               almost_equal(lights[end].centre,
                            lights[i].centre + static_cast<double>(end - i) * step, scale)) {
          ++end;
        }
        grid.cols = static_cast<int>(end - i);
      }
    }
    const auto cols = static_cast<std::size_t>(grid.cols);
    const auto row_fits = [&](std::size_t row) {
      if (i + (row + 1) * cols > lights.size()) {
        return false;
      }
      for (std::size_t c = 0; c < cols; ++c) {
        const SquareLight& light = lights[i + row * cols + c];
        const Vector3d wanted = lights[i + c].centre + static_cast<double>(row) * grid.step_v;
        if (!same_form(lights[i], light) || !almost_equal(light.centre, wanted, scale)) {
          return false;
        }
      }
      return true;
    };
    if (grid.cols > 1 && i + cols < lights.size()) {
      const Vector3d step = lights[i + cols].centre - lights[i].centre;
      const double along = step.dot(lights[i].v);
      if (along >= lights[i].height_mm && almost_equal(step, along * lights[i].v, scale)) {
        grid.step_v = step;
        std::size_t rows = 1;
        while (row_fits(rows)) {
          ++rows;
        }
        grid.rows = static_cast<int>(rows);
      }
    }
    i += cols * static_cast<std::size_t>(grid.rows);
    grids.push_back(grid);
  }
  return grids;
}

DirectLight::DirectLight(const RayCaster& caster, std::span<const SquareLight> lights,
                         const DirectLightOptions& options)
    : caster_(&caster),
      lights_(lights.begin(), lights.end()),
      grids_(find_light_grids(lights)),
      options_(options) {
  HAARLIGHT_EXPECTS(options.uniform_grid >= 1 && options.uniform_grid <= options.mixed_grid &&
                        options.mixed_grid <= 64,
                    "1 <= uniform_grid <= mixed_grid <= 64");
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
}

void DirectLight::test_grid(const LightGrid& grid, const SurfacePoint& /*surface*/,
                            Scratch& scratch) const {
  const Vector3d first = lights_[static_cast<std::size_t>(grid.first)].centre;
  scratch.targets.clear();
  for (int row = 0; row <= grid.rows; ++row) {
    for (int col = 0; col <= grid.cols; ++col) {
      scratch.targets.emplace_back(first + (col - 0.5) * grid.step_u +
                                   (row - 0.5) * grid.step_v);
    }
  }
  const std::size_t n_corners = scratch.targets.size();
  for (int row = 0; row < grid.rows; ++row) {
    for (int col = 0; col < grid.cols; ++col) {
      scratch.targets.emplace_back(first + col * grid.step_u + row * grid.step_v);
    }
  }
  scratch.cast(*caster_);
  const auto corner = [&](int row, int col) {
    return scratch.blocked[to_index(row * (grid.cols + 1) + col)];
  };
  const auto sight_at = [&](int row, int col) -> Sight& {
    return scratch.sight[to_index(grid.first + row * grid.cols + col)];
  };
  std::vector<int> fresh;
  for (int row = 0; row < grid.rows; ++row) {
    for (int col = 0; col < grid.cols; ++col) {
      Sight& sight = sight_at(row, col);
      if (sight == Sight::dark) {
        continue;
      }
      const int n_blocked = corner(row, col) + corner(row, col + 1) + corner(row + 1, col) +
                            corner(row + 1, col + 1) +
                            scratch.blocked[n_corners + to_index(row * grid.cols + col)];
      sight = n_blocked == 0 ? Sight::seen : n_blocked == 5 ? Sight::hidden : Sight::mixed;
      if (sight == Sight::mixed) {
        fresh.push_back(row * grid.cols + col);
      }
    }
  }
  // Neighbours of a mixed light are tested by their own strata, and so on while more are found.
  std::vector<std::uint8_t> is_tested(to_index(grid.rows * grid.cols), 0);
  const auto n = static_cast<std::size_t>(options_.uniform_grid);
  while (!fresh.empty()) {
    scratch.requested.clear();
    for (const int index : fresh) {
      const int row = index / grid.cols;
      const int col = index % grid.cols;
      for (int y = std::max(0, row - 1); y <= std::min(grid.rows - 1, row + 1); ++y) {
        for (int x = std::max(0, col - 1); x <= std::min(grid.cols - 1, col + 1); ++x) {
          const Sight sight = sight_at(y, x);
          std::uint8_t& tested = is_tested[to_index(y * grid.cols + x)];
          if (tested == 0 && (sight == Sight::seen || sight == Sight::hidden)) {
            tested = 1;
            scratch.requested.push_back(y * grid.cols + x);
          }
        }
      }
    }
    fresh.clear();
    scratch.targets.clear();
    for (const int index : scratch.requested) {
      const SquareLight& light = lights_[to_index(grid.first + index)];
      for (std::size_t j = 0; j < n; ++j) {
        for (std::size_t i = 0; i < n; ++i) {
          const double s = (static_cast<double>(i) + 0.5) / static_cast<double>(n) - 0.5;
          const double t = (static_cast<double>(j) + 0.5) / static_cast<double>(n) - 0.5;
          scratch.targets.emplace_back(light.centre + s * light.width_mm * light.u +
                                       t * light.height_mm * light.v);
        }
      }
    }
    scratch.cast(*caster_);
    for (std::size_t a = 0; a < scratch.requested.size(); ++a) {
      const int index = scratch.requested[a];
      Sight& sight = scratch.sight[to_index(grid.first + index)];
      const std::uint8_t expected = sight == Sight::hidden ? 1 : 0;
      const auto begin = scratch.blocked.begin() + static_cast<std::ptrdiff_t>(a * n * n);
      if (!std::all_of(begin, begin + static_cast<std::ptrdiff_t>(n * n),
                       [&](std::uint8_t b) { return b == expected; })) {
        sight = Sight::mixed;
        fresh.push_back(index);
      }
    }
  }
}

void DirectLight::test_alone(const SurfacePoint& /*surface*/, std::uint64_t key,
                             Scratch& scratch) const {
  // n x n jittered strata per light; mixed where they disagree or where a neighbour's visible
  // fraction differs.
  const int n = options_.uniform_grid;
  std::vector<int> contribution(lights_.size(), -1);
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    if (scratch.sight[k] == Sight::dark) {
      continue;
    }
    const SquareLight& light = lights_[k];
    scratch.targets.clear();
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const auto cell = to_index(j * n + i);
        const std::uint64_t hash = hash_key(options_.seed ^ 3U, key, k, cell);
        const double s = (i + uniform_unit(hash)) / n - 0.5;
        const double t = (j + uniform_unit(hash_key(hash))) / n - 0.5;
        scratch.targets.emplace_back(light.centre + s * light.width_mm * light.u +
                                     t * light.height_mm * light.v);
      }
    }
    scratch.cast(*caster_);
    contribution[k] =
        static_cast<int>(std::count(scratch.blocked.begin(), scratch.blocked.end(), 1));
  }
  for (const LightGrid& grid : grids_) {
    for (int row = 0; row < grid.rows; ++row) {
      for (int col = 0; col < grid.cols; ++col) {
        const auto k = to_index(grid.first + row * grid.cols + col);
        if (scratch.sight[k] == Sight::dark) {
          continue;
        }
        bool is_mixed = contribution[k] > 0 && contribution[k] < n * n;
        for (int y = std::max(0, row - 1); y <= std::min(grid.rows - 1, row + 1); ++y) {
          for (int x = std::max(0, col - 1); x <= std::min(grid.cols - 1, col + 1); ++x) {
            const int other = contribution[to_index(grid.first + y * grid.cols + x)];
            is_mixed = is_mixed || (other >= 0 && other != contribution[k]);
          }
        }
        scratch.sight[k] = is_mixed               ? Sight::mixed
                           : contribution[k] == 0 ? Sight::seen
                                                  : Sight::hidden;
      }
    }
  }
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
  scratch.targets.clear();
  for (const Vector2d& cell : cells) {
    scratch.targets.emplace_back(light.centre + (cell.x() - 0.5) * light.width_mm * light.u +
                                 (cell.y() - 0.5) * light.height_mm * light.v);
  }
  scratch.cast(*caster_);
  const bool has_lobe = material.ks > 0.0;
  const Integrand f{surface, material.exponent,
                    has_lobe ? (material.exponent + 8.0) / (8.0 * std::numbers::pi) : 0.0,
                    light.emits.dot(surface.point - light.centre), light.lobe_mu};
  Vector2d sum = Vector2d::Zero();
  int n_seen = 0;
  for (std::size_t i = 0; i < n_cells; ++i) {
    if (scratch.blocked[i] == 0) {
      sum += f.at(scratch.targets[i]);
      ++n_seen;
    }
  }
  // Strata that the shadow's edge crosses: neighbours that disagree. A stratum cut at a random
  // position has variance 1/6 on average.
  int n_edges = 0;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const std::uint8_t here = scratch.blocked[to_index(j * n + i)];
      n_edges += i + 1 < n && here != scratch.blocked[to_index(j * n + i + 1)];
      n_edges += j + 1 < n && here != scratch.blocked[to_index((j + 1) * n + i)];
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
  if (options_.share_tests) {
    for (const LightGrid& grid : grids_) {
      if (shares_tests(grid, lights_[to_index(grid.first)])) {
        test_grid(grid, surface, scratch);
      } else {
        for (int i = 0; i < grid.rows * grid.cols; ++i) {
          Sight& sight = scratch.sight[to_index(grid.first + i)];
          sight = sight == Sight::dark ? Sight::dark : Sight::mixed;
        }
      }
    }
  } else {
    test_alone(surface, key, scratch);
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
