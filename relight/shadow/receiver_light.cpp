// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/receiver_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/vector_clones.h"
#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"

namespace haarlight::relight {
namespace {

constexpr double kFarSides = 10.0;  // from here on four Gauss points suffice

HAARLIGHT_CLONES("avx2")
void four_points(const render::SquareLight& light, const PointRows& chunk, double* out) {
  const double lx = light.centre.x();
  const double ly = light.centre.y();
  const double lz = light.centre.z();
  const double ex = light.emits.x();
  const double ey = light.emits.y();
  const double ez = light.emits.z();
  const double side = std::max(light.width_mm, light.height_mm);
  const double q = 0.5 / std::numbers::sqrt3;
  const Eigen::Vector3d du = q * light.width_mm * light.u;
  const Eigen::Vector3d dv = q * light.height_mm * light.v;
  const std::array<Eigen::Vector3d, 4> steps{-du - dv, -du + dv, du - dv, du + dv};
  const double scale = 0.25 * light.width_mm * light.height_mm;
  const double least = kFarSides * kFarSides * side * side;
  const std::size_t n = chunk.size();
  const double* px = chunk.px.data();
  const double* py = chunk.py.data();
  const double* pz = chunk.pz.data();
  const double* nx = chunk.nx.data();
  const double* ny = chunk.ny.data();
  const double* nz = chunk.nz.data();
  for (std::size_t i = 0; i < n; ++i) {
    const double x = lx - px[i];
    const double y = ly - py[i];
    const double z = lz - pz[i];
    const double r2 = x * x + y * y + z * z;
    const double over = nx[i] * x + ny[i] * y + nz[i] * z;
    const double before = std::max(-(ex * x + ey * y + ez * z), 0.0);
    const double along_u = nx[i] * du.x() + ny[i] * du.y() + nz[i] * du.z();
    const double along_v = nx[i] * dv.x() + ny[i] * dv.y() + nz[i] * dv.z();
    const double reach = std::numbers::sqrt3 * (std::abs(along_u) + std::abs(along_v));
    double sum = 0.0;
    for (int s = 0; s < 4; ++s) {
      const double sx = x + steps[static_cast<std::size_t>(s)].x();
      const double sy = y + steps[static_cast<std::size_t>(s)].y();
      const double sz = z + steps[static_cast<std::size_t>(s)].z();
      const double d2 = sx * sx + sy * sy + sz * sz;
      sum += (nx[i] * sx + ny[i] * sy + nz[i] * sz) * before / (d2 * d2);
    }
    const double far = r2 >= least && over >= reach ? scale * sum : -1.0;
    out[i] = before > 0.0 && over + reach > 0.0 ? far : 0.0;  // -1: left to the exact form
  }
}

}  // namespace

void PointRows::reserve(std::size_t n) {
  for (std::vector<double>* row : {&px, &py, &pz, &nx, &ny, &nz}) {
    row->reserve(n);
  }
}

void PointRows::add(const render::SurfacePoint& at) {
  px.push_back(at.point.x());
  py.push_back(at.point.y());
  pz.push_back(at.point.z());
  nx.push_back(at.normal.x());
  ny.push_back(at.normal.y());
  nz.push_back(at.normal.z());
}

void irradiance_far(const render::SquareLight& light, const PointRows& rows,
                    std::span<double> out) {
  HAARLIGHT_EXPECTS(out.size() == rows.size(), "one element per receiver");
  if (light.lobe_mu == 1.0) {
    four_points(light, rows, out.data());
  } else {
    std::fill(out.begin(), out.end(), -1.0);
  }
}

double block_irradiance(const render::SquareLight& light, const render::SurfacePoint& at) {
  const Eigen::Vector3d to_light = light.centre - at.point;
  const double before = -light.emits.dot(to_light);
  const double q = 0.5 / std::numbers::sqrt3;
  const Eigen::Vector3d du = q * light.width_mm * light.u;
  const Eigen::Vector3d dv = q * light.height_mm * light.v;
  double sum = 0.0;
  for (const auto& [su, sv] : {std::pair{-1.0, -1.0}, {-1.0, 1.0}, {1.0, -1.0}, {1.0, 1.0}}) {
    const Eigen::Vector3d to = to_light + su * du + sv * dv;
    const double d2 = to.squaredNorm();
    const double lobe =
        light.lobe_mu == 1.0 ? 1.0 : std::pow(before / std::sqrt(d2), light.lobe_mu - 1.0);
    sum += at.normal.dot(to) * lobe / (d2 * d2);
  }
  return 0.25 * light.width_mm * light.height_mm * before * sum;
}

double receiver_irradiance(const render::SquareLight& light, const Eigen::Vector3d& point,
                           const Eigen::Vector3d& normal) {
  const Eigen::Vector3d to_light = light.centre - point;
  const double side = std::max(light.width_mm, light.height_mm);
  const double r2 = to_light.squaredNorm();
  const double over_surface = normal.dot(to_light);
  const double before_light = -light.emits.dot(to_light);
  const double reach = 0.5 * (std::abs(normal.dot(light.u)) * light.width_mm +
                              std::abs(normal.dot(light.v)) * light.height_mm);
  if (before_light <= 0.0 || over_surface + reach <= 0.0) {
    return 0.0;  // behind the light, or below the receiver's horizon
  }
  if (r2 < kFarSides * kFarSides * side * side || over_surface < reach) {
    return render::light_irradiance(light, point, normal) / light.radiance;
  }
  // 2 x 2 Gauss-Legendre points: error O((side/r)^4).
  const double q = 0.5 / std::numbers::sqrt3;
  const Eigen::Vector3d du = q * light.width_mm * light.u;
  const Eigen::Vector3d dv = q * light.height_mm * light.v;
  double sum = 0.0;
  for (const double su : {-1.0, 1.0}) {
    for (const double sv : {-1.0, 1.0}) {
      const Eigen::Vector3d to = to_light + su * du + sv * dv;
      const double d2 = to.squaredNorm();
      const double cos_cos = normal.dot(to) * before_light / d2;
      const double lobe = light.lobe_mu == 1.0
                              ? 1.0
                              : std::pow(before_light / std::sqrt(d2), light.lobe_mu - 1.0);
      sum += cos_cos * lobe / d2;
    }
  }
  return 0.25 * light.width_mm * light.height_mm * sum;
}

}  // namespace haarlight::relight
