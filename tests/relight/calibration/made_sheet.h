// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>

#include "core/random.h"
#include "relight/calibration/rigid_likelihood.h"
#include "relight/calibration/target_samples.h"

/// @file
/// Pictures of a sheet that is not the ideal one, from a forward model of its own: LEDs summed
/// from 12 x 12 pieces, Oren and Nayar's paper by its angles, a gloss, a bent and tilted sheet
/// met by the camera's rays, a lens that bends them. It shares no code with what is fitted.

namespace haarlight::relight {

struct MadeSheet {
  const char* name = "";
  double led_mm = 0.0;  ///< side of the LEDs
  double slope = 0.0;   ///< Oren and Nayar's sigma, rad
  double gloss = 0.0;   ///< fraction of the diffuse light, Blinn and Phong
  double gloss_exponent = 10.0;
  double bow_mm = 0.0;      ///< an arch across 30 degrees from x, from edge to middle
  double tilt_deg = 0.0;    ///< about a direction in the plane that the seed chooses
  double distortion = 0.0;  ///< fraction of the radius at the target's corner in the picture
  double vignetting = 0.2;
  int bits = 0;
  double gauss_deg = 0.0;  ///< a lobe exp(-angle^2 / 2 s^2) instead of cos
  int side = 8;            ///< LEDs along a side of the array, 640 mm wide
  int samples = 24;        ///< along a side of the target
  double noise = 0.005;
};

struct MadePictures {
  TargetSamples samples;          ///< with the points where an ideal sheet would have them
  std::vector<NearLight> lights;  ///< the truth
  RigidArray array;               ///< in a frame whose pose is `pose`
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
};

namespace made_sheet {

constexpr double kHalf = 100.0;    // of the target, mm
constexpr double kHeight = 300.0;  // of the LEDs, mm

/// The bent sheet over its middle plane: height and slopes at (x, y).
struct Surface {
  double bow = 0.0;
  double slope_x = 0.0;
  double slope_y = 0.0;
  [[nodiscard]] double along(double x, double y) const {
    return (x * std::cos(std::numbers::pi / 6.0) + y * std::sin(std::numbers::pi / 6.0)) /
           kHalf;
  }
  [[nodiscard]] double z(double x, double y) const {
    return slope_x * x + slope_y * y + bow * std::cos(0.5 * std::numbers::pi * along(x, y));
  }
  [[nodiscard]] Eigen::Vector3d normal(double x, double y) const {
    const double d =
        -bow * 0.5 * std::numbers::pi / kHalf * std::sin(0.5 * std::numbers::pi * along(x, y));
    return Eigen::Vector3d(-slope_x - d * std::cos(std::numbers::pi / 6.0),
                           -slope_y - d * std::sin(std::numbers::pi / 6.0), 1.0)
        .normalized();
  }
};

/// Reflected light over Lambert's: Oren and Nayar (1994), equation 30, by its angles; a gloss.
inline double reflectance(const MadeSheet& s, const Eigen::Vector3d& n,
                          const Eigen::Vector3d& to_light, const Eigen::Vector3d& to_camera) {
  const double theta_i = std::acos(std::clamp(n.dot(to_light), -1.0, 1.0));
  const double theta_r = std::acos(std::clamp(n.dot(to_camera), -1.0, 1.0));
  const Eigen::Vector3d a = n.unitOrthogonal();
  const Eigen::Vector3d b = n.cross(a);
  const double phi = std::atan2(to_light.dot(b), to_light.dot(a)) -
                     std::atan2(to_camera.dot(b), to_camera.dot(a));
  const double s2 = s.slope * s.slope;
  const double rough = 1.0 - 0.5 * s2 / (s2 + 0.33) +
                       0.45 * s2 / (s2 + 0.09) * std::max(0.0, std::cos(phi)) *
                           std::sin(std::max(theta_i, theta_r)) *
                           std::tan(std::min(theta_i, theta_r));
  const Eigen::Vector3d half = (to_light + to_camera).normalized();
  return rough + s.gloss * std::pow(std::max(0.0, n.dot(half)), s.gloss_exponent);
}

/// What one LED gives a point: 12 x 12 pieces of it, or one of no size.
inline double from_led(const MadeSheet& s, const Eigen::Vector3d& led, const Eigen::Vector3d& p,
                       const Eigen::Vector3d& n, const Eigen::Vector3d& to_camera) {
  const int pieces = s.led_mm > 0.0 ? 12 : 1;
  double sum = 0.0;
  for (int i = 0; i < pieces * pieces; ++i) {
    const int row = i / pieces;
    const int col = i % pieces;
    const Eigen::Vector3d at =
        led +
        s.led_mm * Eigen::Vector3d((col + 0.5) / pieces - 0.5, (row + 0.5) / pieces - 0.5, 0.0);
    const double r = (at - p).norm();
    const Eigen::Vector3d way = (at - p) / r;
    const double angle = std::acos(std::clamp(way.z(), -1.0, 1.0));
    const double sigma = s.gauss_deg * std::numbers::pi / 180.0;
    const double lobe = s.gauss_deg > 0.0 ? std::exp(-0.5 * std::pow(angle / sigma, 2))
                                          : std::max(0.0, std::cos(angle));
    sum += lobe * std::max(0.0, n.dot(way)) / (r * r) * reflectance(s, n, way, to_camera);
  }
  return sum / (pieces * pieces);
}

}  // namespace made_sheet

/// @param seed  noise, albedo, powers, and the tilt's direction
inline MadePictures make_pictures(const MadeSheet& sheet, std::uint64_t seed) {
  using made_sheet::kHalf;
  using made_sheet::kHeight;
  MadePictures out;
  out.lights =
      array_lights(sheet.side, sheet.side, 640.0 / sheet.side, kHeight, 1.0, 0.3, seed);
  out.pose.translate(Eigen::Vector3d(0.0, 0.0, kHeight));
  for (NearLight& light : out.lights) {
    light.emitter_mm.topRows<2>() = sheet.led_mm * Eigen::Matrix2d::Identity();
    out.array.positions_mm.push_back(out.pose.inverse() * light.position_mm);
    out.array.axes.push_back(light.axis);
    out.array.emitters_mm.push_back(light.emitter_mm);
  }
  // A camera that looks down aslant, its axes: x right, y down, z away.
  const Eigen::Vector3d eye(60.0, -350.0, 650.0);
  Eigen::Matrix3d turn;  // world from camera
  turn.col(2) = -eye.normalized();
  turn.col(0) = turn.col(2).cross(Eigen::Vector3d::UnitY().eval()).normalized();
  turn.col(1) = turn.col(2).cross(turn.col(0));
  const auto seen_at = [&](const Eigen::Vector3d& p) -> Eigen::Vector2d {
    const Eigen::Vector3d c = turn.transpose() * (p - eye);
    return c.head<2>() / c.z();
  };
  double corner = 0.0;
  for (const double x : {-kHalf, kHalf}) {
    for (const double y : {-kHalf, kHalf}) {
      corner = std::max(corner, seen_at({x, y, 0.0}).norm());
    }
  }
  const double azimuth = 2.0 * std::numbers::pi * uniform_unit(hash_key(seed, 41));
  const double steep = std::tan(sheet.tilt_deg * std::numbers::pi / 180.0);
  const made_sheet::Surface surface{sheet.bow_mm, steep * std::cos(azimuth),
                                    steep * std::sin(azimuth)};
  TargetSamples& s = out.samples;
  s.n_lights = static_cast<int>(out.lights.size());
  s.rows = s.cols = sheet.samples;
  s.noise = {.relative = sheet.noise};
  const std::size_t n = static_cast<std::size_t>(s.rows) * static_cast<std::size_t>(s.cols);
  std::vector<Eigen::Vector3d> at(n);
  std::vector<double> albedo(n);
  const auto on_plane = [&](const Eigen::Vector2d& u) -> Eigen::Vector3d {
    const Eigen::Vector3d way = turn * Eigen::Vector3d(u.x(), u.y(), 1.0);
    return eye - eye.z() / way.z() * way;
  };
  for (std::size_t i = 0; i < n; ++i) {
    const double step = 2.0 * kHalf / s.cols;
    const int row = static_cast<int>(i) / s.cols;
    const int col = static_cast<int>(i) % s.cols;
    const Eigen::Vector3d nominal(step * (col + 0.5) - kHalf, kHalf - step * (row + 0.5), 0.0);
    s.points_mm.push_back(nominal);
    s.normals.emplace_back(Eigen::Vector3d::UnitZ());
    s.to_camera.push_back((eye - nominal).normalized());
    const Eigen::Vector2d u = seen_at(nominal);
    const double r2 = u.squaredNorm() / (corner * corner);
    // What a calibration can say without the truth: how its points move with the lens.
    constexpr double kSmall = 1e-4;
    s.lens_mm.emplace_back((on_plane(u * (1.0 + kSmall * r2)) - nominal) / kSmall);
    const Eigen::Vector2d bent = u * (1.0 + sheet.distortion * r2);
    const Eigen::Vector3d way = (turn * Eigen::Vector3d(bent.x(), bent.y(), 1.0)).normalized();
    double t = -eye.z() / way.z();
    for (int round = 0; round < 60; ++round) {
      const Eigen::Vector3d p = eye + t * way;
      t -= (p.z() - surface.z(p.x(), p.y())) / way.z();
    }
    at[i] = eye + t * way;
    albedo[i] = (1.0 - sheet.vignetting * u.squaredNorm() / (corner * corner)) *
                (1.0 + 0.1 * (2.0 * uniform_unit(hash_key(seed, 1, i)) - 1.0));
  }
  std::vector<double> values;
  double brightest = 0.0;
  for (std::size_t k = 0; k < out.lights.size(); ++k) {
    for (std::size_t i = 0; i < n; ++i) {
      const Eigen::Vector3d normal = surface.normal(at[i].x(), at[i].y());
      const double clean = albedo[i] * out.lights[k].power[0] *
                           made_sheet::from_led(sheet, out.lights[k].position_mm, at[i], normal,
                                                (eye - at[i]).normalized());
      values.push_back(clean * (1.0 + sheet.noise * standard_normal(hash_key(seed, 2, k, i))));
      brightest = std::max(brightest, values.back());
    }
  }
  const double step = sheet.bits > 0 ? brightest / (std::pow(2.0, sheet.bits) - 1.0) : 0.0;
  for (const double value : values) {
    s.intensity.push_back(
        static_cast<float>(step > 0.0 ? step * std::round(value / step) : value));
  }
  if (step > 0.0) {
    s.noise.floor = step / std::sqrt(12.0);
  }
  s.is_used.assign(out.lights.size() * n, 1);
  return out;
}

/// The cases of docs/numerics/near-light.md.
inline std::vector<MadeSheet> made_sheets() {
  return {{.name = "exact"},
          {.name = "LED 5 mm", .led_mm = 5.0},
          {.name = "LED 10 mm", .led_mm = 10.0},
          {.name = "LED 20 mm", .led_mm = 20.0},
          {.name = "LED 30 mm", .led_mm = 30.0},
          {.name = "Oren-Nayar 0.2", .slope = 0.2},
          {.name = "Oren-Nayar 0.5", .slope = 0.5},
          {.name = "gloss 3 %, exponent 10", .gloss = 0.03},
          {.name = "gloss 3 %, exponent 30", .gloss = 0.03, .gloss_exponent = 30.0},
          {.name = "bow 1 mm", .bow_mm = 1.0},
          {.name = "plane 3 degrees off", .tilt_deg = 3.0},
          {.name = "distortion 0.5 %", .distortion = 0.005},
          {.name = "12 bit", .bits = 12},
          {.name = "vignetting 50 %", .vignetting = 0.5},
          {.name = "Gaussian lobe", .gauss_deg = 51.0},
          {.name = "all at once",
           .led_mm = 20.0,
           .slope = 0.2,
           .gloss = 0.03,
           .bow_mm = 1.0,
           .tilt_deg = 3.0,
           .distortion = 0.005,
           .vignetting = 0.5,
           .bits = 12}};
}

}  // namespace haarlight::relight
