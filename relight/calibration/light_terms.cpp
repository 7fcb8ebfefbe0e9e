// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/light_terms.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"

namespace haarlight::relight {

namespace {

constexpr Eigen::Index kSurfaceTerms = 6;

/// Heights and slopes of the surface's terms, for one unit of each.
void fill_surface(TargetColumns& t) {
  const Eigen::Index n = t.point.rows();
  const Eigen::RowVector2d low = t.point.leftCols<2>().colwise().minCoeff();
  const Eigen::RowVector2d high = t.point.leftCols<2>().colwise().maxCoeff();
  const double half = std::max(0.5 * (high - low).maxCoeff(), 1e-300);
  const Eigen::ArrayXd x = (t.point.col(0) - 0.5 * (low[0] + high[0])) / half;
  const Eigen::ArrayXd y = (t.point.col(1) - 0.5 * (low[1] + high[1])) / half;
  t.height.resize(n, kSurfaceTerms);
  t.height << Eigen::ArrayXd::Ones(n), x, y, x.square(), x * y, y.square();
  t.slope_x.setZero(n, kSurfaceTerms);
  t.slope_y.setZero(n, kSurfaceTerms);
  t.slope_x.col(1).setConstant(1.0 / half);
  t.slope_y.col(2).setConstant(1.0 / half);
  t.slope_x.col(3) = 2.0 * x / half;
  t.slope_x.col(4) = y / half;
  t.slope_y.col(4) = x / half;
  t.slope_y.col(5) = 2.0 * y / half;
  if (t.per_lens.rows() == 0) {
    t.per_lens.setZero(n, 3);
    const Eigen::ArrayXd r2 = x.square() + y.square();
    t.per_lens.col(0) = half * x * r2;
    t.per_lens.col(1) = half * y * r2;
  }
}

Eigen::ArrayX3d columns_of(const std::vector<Eigen::Vector3d>& rows) {
  Eigen::ArrayX3d out(static_cast<Eigen::Index>(rows.size()), 3);
  for (Eigen::Index p = 0; p < out.rows(); ++p) {
    out.row(p) = rows[static_cast<std::size_t>(p)].transpose();
  }
  return out;
}

}  // namespace

TargetColumns::TargetColumns(const TargetSamples& samples, const SheetValues& sheet)
    : point(columns_of(samples.points_mm)),
      normal(columns_of(samples.normals)),
      view(columns_of(samples.to_camera)),
      roughness(sheet[SheetTerm::roughness]),
      sheen(sheet[SheetTerm::sheen]),
      per_lens(columns_of(samples.lens_mm)) {
  const Eigen::Index n = point.rows();
  fill_surface(*this);
  per_height.setZero(n, 3);
  per_height.col(2).setOnes();
  if (view.rows() > 0) {
    // The point the camera sees at height z lies on its ray.
    per_height = view.colwise() / view.col(2).max(0.05);
  }
  const Eigen::Map<const Eigen::VectorXd> surface(
      sheet.of.data() + static_cast<std::size_t>(SheetTerm::height), kSurfaceTerms);
  const double lens = sheet[SheetTerm::lens];
  if (!surface.isZero(0.0) || lens != 0.0) {
    const Eigen::ArrayXd z = (height.matrix() * surface).array();
    point += per_height.colwise() * z + lens * per_lens;
    normal.col(0) -= (slope_x.matrix() * surface).array();
    normal.col(1) -= (slope_y.matrix() * surface).array();
    const Eigen::ArrayXd length = normal.square().rowwise().sum().sqrt();
    normal.colwise() /= length;
  }
  if (view.rows() > 0) {
    cos_view = (normal * view).rowwise().sum();
    across = view - normal.colwise() * cos_view;
  }
}

namespace {

/// The sheet's reflectance over Lambert's, F = 1 + q g + s b, and what it adds to the terms.
void add_reflectance(const TargetColumns& target, const Eigen::ArrayX3d& way,
                     const Eigen::ArrayXd& inverse_r, bool is_wanted, LightTerms& t) {
  constexpr double kLeast = 0.05;  // keeps the sign after too long a step
  const Eigen::ArrayXd cos_light = (target.normal * way).rowwise().sum();
  const Eigen::ArrayXd s = (target.across * way).rowwise().sum();
  const Eigen::ArrayX3d towards = way + target.view;
  const Eigen::ArrayXd inverse_sum = towards.square().rowwise().sum().sqrt().inverse();
  const Eigen::ArrayX3d middle = towards.colwise() * inverse_sum;
  const Eigen::ArrayXd cos_middle = (target.normal * middle).rowwise().sum().max(0.0);
  const Eigen::ArrayXd lobe = cos_middle.pow(kSheenExponent);
  const Eigen::ArrayXd steeper = cos_light.max(target.cos_view).max(1e-6);
  const Eigen::ArrayXd g = s.max(0.0) / steeper;
  const Eigen::ArrayXd f = (1.0 + target.roughness * g + target.sheen * lobe).max(kLeast);
  t.h *= f;
  if (is_wanted) {
    t.roughness = g / f;
    t.sheen = lobe / f;
  }
  // By the direction to the light, then by the position across it.
  const Eigen::ArrayXd rises = (s > 0.0).select(target.roughness / steeper, 0.0);
  const Eigen::ArrayXd falls = (cos_light > target.cos_view).select(rises * g, 0.0);
  const Eigen::ArrayXd by_lobe =
      target.sheen * kSheenExponent * cos_middle.pow(kSheenExponent - 1.0) * inverse_sum;
  Eigen::ArrayX3d by_way = target.across.colwise() * rises;
  by_way -= target.normal.colwise() * falls;
  by_way += (target.normal - middle.colwise() * cos_middle).colwise() * by_lobe;
  if (is_wanted) {
    // By the surface's normal: s = way.view - cos_light cos_view.
    Eigen::ArrayX3d by_normal =
        way.colwise() * Eigen::ArrayXd(-rises * target.cos_view - falls);
    const Eigen::ArrayXd view_falls =
        (cos_light > target.cos_view).select(Eigen::ArrayXd::Zero(g.size()), rises * g);
    by_normal -= target.view.colwise() * Eigen::ArrayXd(rises * cos_light + view_falls);
    by_normal += middle.colwise() * Eigen::ArrayXd(by_lobe / inverse_sum);
    t.normal += by_normal.colwise() / f;
  }
  const Eigen::ArrayXd along = (by_way * way).rowwise().sum();
  const Eigen::ArrayXd scale = inverse_r / f;
  t.position += (by_way - way.colwise() * along).colwise() * scale;
}

/// Terms of a light at one point.
LightTerms point_terms(const TargetColumns& target, const NearLight& light,
                       const Eigen::Vector3d& emitter_mm, const std::uint8_t* used,
                       WantedTerms wanted) {
  const Eigen::Index n = target.point.rows();
  LightTerms t;
  Eigen::ArrayX3d w(n, 3);
  for (int c = 0; c < 3; ++c) {
    w.col(c) = emitter_mm[c] - target.point.col(c);
  }
  const Eigen::ArrayXd inverse_r2 = w.square().rowwise().sum().max(1e-300).inverse();
  Eigen::ArrayXd facing = (target.normal * w).rowwise().sum();
  Eigen::ArrayXd off =
      -(light.axis.x() * w.col(0) + light.axis.y() * w.col(1) + light.axis.z() * w.col(2));
  Eigen::ArrayXd lit = Eigen::ArrayXd::Ones(n);
  for (Eigen::Index p = 0; p < n; ++p) {
    const bool is_lit = facing[p] > 0.0 && (light.mu == 0.0 || off[p] > 0.0);
    if (!is_lit) {
      lit[p] = 0.0;
      t.reaches_used = t.reaches_used && used[p] == 0;
    }
    facing[p] = facing[p] > 0.0 ? facing[p] : 1.0;
    off[p] = off[p] > 0.0 ? off[p] : 1.0;
  }
  t.log_cos = 0.5 * (off.square() * inverse_r2).log();
  t.h = lit * facing * inverse_r2 * inverse_r2.sqrt();
  if (light.mu != 0.0) {
    t.h *= (light.mu * t.log_cos).exp();
  }
  // -d ln h / d l = (3 + mu) w / r^2 - n / (n.w) + mu axis / off
  const Eigen::ArrayXd per_off = light.mu * off.inverse();
  t.position.resize(n, 3);
  for (int c = 0; c < 3; ++c) {
    t.position.col(c) = target.normal.col(c) / facing -
                        (3.0 + light.mu) * w.col(c) * inverse_r2 - light.axis[c] * per_off;
  }
  if (wanted.axis) {
    t.axis = w.colwise() * Eigen::ArrayXd(-per_off);
  }
  if (wanted.sheet) {
    t.normal = w.colwise() / facing;
  }
  const bool has_reflectance = target.roughness != 0.0 || target.sheen != 0.0;
  if (target.view.rows() > 0 && (has_reflectance || wanted.sheet)) {
    const Eigen::ArrayXd inverse_r = inverse_r2.sqrt();
    const Eigen::ArrayX3d way = w.colwise() * inverse_r;
    add_reflectance(target, way, inverse_r, wanted.sheet, t);
  }
  return t;
}

/// sum += weight * values, where values were requested.
template <class Values>
void add_weighted(Values& sum, const Values& values, const Eigen::ArrayXd& weight) {
  if (values.rows() > 0) {
    sum += values.colwise() * weight;
  }
}

template <class Values>
void scale(Values& values, const Eigen::ArrayXd& weight) {
  if (values.rows() > 0) {
    values.colwise() *= weight;
  }
}

}  // namespace

LightTerms light_terms(const TargetColumns& target, const NearLight& light,
                       const std::uint8_t* used, WantedTerms wanted) {
  wanted.axis = wanted.axis || light.aim_mm.has_value();
  const EmitterPoints from = emitter_points(light);
  LightTerms sum = point_terms(target, light, from.at[0], used, wanted);
  if (from.n == 1) {
    return sum;
  }
  // d ln (sum h_j) = sum h_j d ln h_j / sum h_j; a point without any light keeps zeros.
  const auto for_each = [](auto&& act, LightTerms& a, const LightTerms& b) {
    act(a.log_cos, b.log_cos);
    act(a.position, b.position);
    act(a.axis, b.axis);
    act(a.normal, b.normal);
    act(a.roughness, b.roughness);
    act(a.sheen, b.sheen);
  };
  const Eigen::ArrayXd first = sum.h;
  for_each([&](auto& a, const auto&) { scale(a, first); }, sum, sum);
  for (int i = 1; i < from.n; ++i) {
    const LightTerms t =
        point_terms(target, light, from.at[static_cast<std::size_t>(i)], used, wanted);
    for_each([&](auto& a, const auto& b) { add_weighted(a, b, t.h); }, sum, t);
    sum.h += t.h;
    sum.reaches_used = sum.reaches_used && t.reaches_used;
  }
  const Eigen::ArrayXd inverse = (sum.h > 0.0).select(sum.h.max(1e-300).inverse(), 0.0);
  for_each([&](auto& a, const auto&) { scale(a, inverse); }, sum, sum);
  sum.h /= from.n;
  return sum;
}

Eigen::Matrix<double, Eigen::Dynamic, 3> per_position(const LightTerms& terms,
                                                      const NearLight& light) {
  Eigen::Matrix<double, Eigen::Dynamic, 3> out = terms.position.matrix();
  if (light.aim_mm) {
    out.noalias() += terms.axis.matrix() * axis_per_position(light);
  }
  return out;
}

std::vector<float> inverse_variances(const TargetSamples& samples, const TargetColumns& target,
                                     std::span<const NearLight> lights,
                                     std::span<const double> albedo) {
  const std::size_t n = samples.n_points();
  const auto n_channels = static_cast<std::size_t>(samples.n_channels);
  std::vector<float> out(lights.size() * n_channels * n);
  parallel_for(lights.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint8_t* used = samples.used(static_cast<int>(k));
      const LightTerms terms = light_terms(target, lights[k], used);
      for (std::size_t c = 0; c < n_channels; ++c) {
        for (std::size_t p = 0; p < n; ++p) {
          const double m = albedo[c * n + p] * lights[k].power[static_cast<Eigen::Index>(c)] *
                           terms.h[static_cast<Eigen::Index>(p)];
          const double variance = samples.noise.variance(m);
          out[(k * n_channels + c) * n + p] =
              used[p] != 0 && variance > 0.0 ? static_cast<float>(1.0 / variance) : 0.0F;
        }
      }
    }
  });
  return out;
}

LightResidual light_residual(const TargetSamples& samples, int light, const LightTerms& terms,
                             const Eigen::Vector3d& power, std::span<const double> albedo,
                             std::span<const float> inverse_variance) {
  const auto n = static_cast<Eigen::Index>(samples.n_points());
  LightResidual r{Eigen::ArrayXd::Zero(n), Eigen::ArrayXd::Zero(n)};
  for (int c = 0; c < samples.n_channels; ++c) {
    const auto at =
        static_cast<std::size_t>(light * samples.n_channels + c) * static_cast<std::size_t>(n);
    const Eigen::Map<const Eigen::ArrayXf> weight(inverse_variance.data() + at, n);
    const Eigen::Map<const Eigen::ArrayXf> intensity(samples.values(light, c), n);
    const Eigen::Map<const Eigen::ArrayXd> a(
        albedo.data() + static_cast<std::size_t>(c) * static_cast<std::size_t>(n), n);
    const Eigen::ArrayXd m = power[c] * a * terms.h;
    const Eigen::ArrayXd weighted_m = weight.cast<double>() * m;
    const Eigen::ArrayXd miss = intensity.cast<double>() - m;
    r.w += weighted_m * m;
    r.w_rho += weighted_m * miss;
    r.chi2 += (weight.cast<double>() * miss.square()).sum();
  }
  return r;
}

std::vector<bool> lights_in_use(const TargetSamples& samples) {
  std::vector<bool> in_use;
  for (int k = 0; k < samples.n_lights; ++k) {
    const std::uint8_t* used = samples.used(k);
    in_use.push_back(
        std::any_of(used, used + samples.n_points(), [](std::uint8_t u) { return u != 0; }));
  }
  return in_use;
}

void fix_power_scale(const TargetSamples& samples, std::span<NearLight> lights,
                     std::span<double> albedo) {
  const std::vector<bool> in_use = lights_in_use(samples);
  const auto n = samples.n_points();
  for (int c = 0; c < samples.n_channels; ++c) {
    double sum = 0.0;
    double count = 0.0;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      sum += in_use[k] ? lights[k].power[c] : 0.0;
      count += in_use[k] ? 1.0 : 0.0;
    }
    const double scale = count > 0.0 && sum > 0.0 ? count / sum : 1.0;
    for (NearLight& light : lights) {
      light.power[c] *= scale;
      if (samples.n_channels == 1) {
        light.power = Eigen::Vector3d::Constant(light.power[0]);
      }
    }
    for (std::size_t p = 0; p < n; ++p) {
      albedo[static_cast<std::size_t>(c) * n + p] /= scale;
    }
  }
}

}  // namespace haarlight::relight
