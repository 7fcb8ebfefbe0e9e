// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/shadow/shadow_points.h"

/// @file
/// A plate over hills under a ceiling of lights: what the tests of shadows at many points
/// share.

namespace haarlight::shadow_scene {

using Eigen::Vector3d;

inline constexpr double kH = 900.0;
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

inline std::vector<render::SquareLight> ceiling(int side, double extent = 960.0) {
  std::vector<render::SquareLight> lights;
  const double pitch = extent / side;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      render::SquareLight light;
      light.centre = {(col - 0.5 * (side - 1)) * pitch, (row - 0.5 * (side - 1)) * pitch, kH};
      light.width_mm = light.height_mm = pitch * 28.0 / 30.0;
      lights.push_back(light);
    }
  }
  return lights;
}

inline relight::PlaneFrame ground(double z = 0.0, double texel = 4.0) {
  ShadowPlane plane;
  plane.d = -z;
  plane.origin = {0.0, 0.0, z};
  plane.extent_u_mm = plane.extent_v_mm = 400.0;
  plane.texel_mm = texel;
  return relight::make_plane_frame(plane);
}

/// Dark and unknown everywhere.
inline relight::Visibility blank_picture(const relight::PlaneFrame& frame) {
  return {Image<float>(frame.height, frame.width, 1),
          Image<std::uint8_t>(frame.height, frame.width, 1),
          {}};
}

/// A rectangle hovering at z = 100: a light seen past it from a parallel plane is a product of
/// two shares.
inline relight::Visibility plate_shadow(const relight::PlaneFrame& frame,
                                        const render::SquareLight& light, double noise = 0.0,
                                        std::uint64_t seed = 0) {
  relight::Visibility v = blank_picture(frame);
  const double floor = frame.origin.z();
  const auto hidden = [&](double x, double from, double to, double centre, double side) {
    const auto at = [&](double y) { return x + (y - x) * (kH - floor) / (100.0 - floor); };
    const double low = std::max(at(from), centre - 0.5 * side);
    const double high = std::min(at(to), centre + 0.5 * side);
    return std::max(0.0, high - low) / side;
  };
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const Vector3d p = frame.world_of(x + 0.5, y + 0.5);
      double value = 1.0 - hidden(p.x(), -40.0, 25.0, light.centre.x(), light.width_mm) *
                               hidden(p.y(), -15.0, 40.0, light.centre.y(), light.height_mm);
      if (noise > 0.0) {
        const int pixel = y * frame.width + x;
        const auto at = static_cast<std::uint64_t>(pixel);
        value += noise * std::sqrt(12.0) * (uniform_unit(hash_key(seed, at)) - 0.5);
      }
      v.value(y, x) = static_cast<float>(std::clamp(value, 0.0, 1.0));
      v.known(y, x) = 1;
    }
  }
  return v;
}

/// sqrt(12) times the rms width of an edge, from samples of its profile.
inline double edge_width(const std::vector<double>& v, double step) {
  double sum = 0.0;
  double first = 0.0;
  double second = 0.0;
  for (std::size_t i = 1; i < v.size(); ++i) {
    const double density = v[i] - v[i - 1];
    const double x = (static_cast<double>(i) - 0.5) * step;
    sum += density;
    first += density * x;
    second += density * x * x;
  }
  const double mean = first / sum;
  return std::sqrt(12.0 * (second / sum - mean * mean));
}

/// Hills between -100 and 50 mm.
inline std::vector<render::SurfacePoint> hills(int side, double extent = 300.0) {
  std::vector<render::SurfacePoint> points;
  for (int row = 0; row < side; ++row) {
    for (int col = 0; col < side; ++col) {
      const double x = ((col + 0.5) / side - 0.5) * extent;
      const double y = ((row + 0.5) / side - 0.5) * extent;
      const Vector3d normal = Vector3d(-1.5 * std::cos(x / 50.0) * std::cos(y / 50.0),
                                       1.5 * std::sin(x / 50.0) * std::sin(y / 50.0), 1.0)
                                  .normalized();
      points.push_back({{x, y, -25.0 + 75.0 * std::sin(x / 50.0) * std::cos(y / 50.0)},
                        normal,
                        normal,
                        Vector3d::UnitZ(),
                        0});
    }
  }
  return points;
}

enum class Kind { one, nine, sparse, smooth, rough, coloured };

inline std::vector<Vector3d> environment(Kind kind,
                                         const std::vector<render::SquareLight>& lights,
                                         std::uint64_t seed) {
  std::vector<Vector3d> weights(lights.size(), Vector3d::Zero());
  auto draw = [&, i = std::uint64_t{0}]() mutable {
    return uniform_unit(hash_key(seed, 77, ++i));
  };
  const auto any = [&] {
    return static_cast<std::size_t>(draw() * static_cast<double>(lights.size()));
  };
  const double a = 6.3 * draw();
  const double b = 6.3 * draw();
  switch (kind) {
    case Kind::one:
      weights[any()] = Vector3d(1.0, 0.5, 2.0);
      break;
    case Kind::nine:
      for (int i = 0; i < 9; ++i) {
        weights[any()] = Vector3d::Constant(0.5 + draw());
      }
      break;
    case Kind::sparse:  // forty lights here and there
      for (int i = 0; i < 40; ++i) {
        weights[any()] = Vector3d::Constant(0.5 + draw());
      }
      break;
    case Kind::smooth:
      for (std::size_t k = 0; k < lights.size(); ++k) {
        weights[k].setConstant(1.2 + std::sin(a + lights[k].centre.x() / 300.0) *
                                         std::cos(b + lights[k].centre.y() / 300.0));
      }
      break;
    case Kind::rough:
      for (Vector3d& weight : weights) {
        weight.setConstant(std::pow(draw(), 8.0));
      }
      break;
    case Kind::coloured:
      for (Vector3d& weight : weights) {
        weight = Vector3d(draw(), draw() * draw(), draw());
      }
      break;
  }
  return weights;
}

struct Difference {
  double relative_l2 = 0.0;
  double worst = 0.0;  ///< of the largest value
};

inline Difference compare(const relight::PointsResult& found,
                          const relight::PointsResult& exact) {
  double square = 0.0;
  double norm = 0.0;
  double worst = 0.0;
  double peak = 0.0;
  for (std::size_t i = 0; i < exact.totals.size(); ++i) {
    const Vector3d e = found.totals[i].shadowed - exact.totals[i].shadowed;
    square += e.squaredNorm();
    norm += exact.totals[i].shadowed.squaredNorm();
    worst = std::max(worst, e.cwiseAbs().maxCoeff());
    peak = std::max(peak, exact.totals[i].shadowed.maxCoeff());
  }
  return {norm > 0.0 ? std::sqrt(square / norm) : 0.0, peak > 0.0 ? worst / peak : 0.0};
}

inline bool same_bits(const relight::PointsResult& a, const relight::PointsResult& b) {
  for (std::size_t i = 0; i < a.totals.size(); ++i) {
    if (a.totals[i].shadowed != b.totals[i].shadowed ||
        a.totals[i].unshadowed != b.totals[i].unshadowed ||
        a.totals[i].unseen != b.totals[i].unseen || a.totals[i].spread != b.totals[i].spread ||
        a.totals[i].light != b.totals[i].light) {
      return false;
    }
  }
  return a.totals.size() == b.totals.size();
}

/// Fewer receivers than a job would check.
inline relight::PointsOptions few() {
  relight::PointsOptions options;
  options.n_checked = 512;
  return options;
}

class ShadowPoints : public ::testing::Test {
 protected:
  [[nodiscard]] std::vector<relight::SamplingPlane> planes(double noise = 0.0) const {
    return {{frame_,
             [this, noise](int k) {
               return plate_shadow(frame_, lights_[static_cast<std::size_t>(k)], noise,
                                   static_cast<std::uint64_t>(k) + 1);
             },
             relight::HeightRange{100.0, 100.0}}};
  }
  [[nodiscard]] relight::PointsResult run(const std::vector<render::SurfacePoint>& receivers,
                                          const std::vector<Vector3d>& weights, double l2 = 0.0,
                                          double worst = kInfinity) const {
    relight::PointsOptions options = few();
    options.tolerance = {l2, worst};
    return relight::shadow_at_points(receivers, planes(), lights_, weights, options);
  }

  relight::PlaneFrame frame_ = ground();
  std::vector<render::SquareLight> lights_ = ceiling(16);
};

}  // namespace haarlight::shadow_scene
