// SPDX-License-Identifier: Apache-2.0
/// @file
/// Near-light calibration on simulated targets: error beside the Cramer-Rao bound, by group of
/// lights; the stages and modes side by side; convergence from random starts; the real
/// positions of eight LEDs; mirror spheres. Prints the tables of docs/numerics/near-light.md.

#include "relight/calibration/near_calibration.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <numbers>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/calibration/mirror_sphere.h"
#include "tests/relight/calibration/mat_file.h"

namespace haarlight {
namespace {

using Eigen::Vector3d;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct Case {
  double height_mm = 300.0;
  double target_mm = 200.0;
  int side = 32;
  int samples = 48;
  double noise = 0.005;
  double mu = 1.0;
  std::uint64_t seed = 1;
};

struct Setting {
  std::vector<relight::NearLight> lights;
  relight::TargetSamples samples;
  std::vector<double> albedo;
};

Setting simulate(const Case& c, double albedo_spread = 0.1) {
  Setting s;
  s.lights =
      relight::array_lights(c.side, c.side, 30.0 * 32 / c.side, c.height_mm, c.mu, 0.3, c.seed);
  relight::SimulatedTarget target;
  target.rows = target.cols = c.samples;
  target.size_mm = c.target_mm;
  target.noise = c.noise;
  target.albedo_spread = albedo_spread;
  target.vignetting = 0.2;
  target.seed = c.seed;
  s.samples = relight::simulate_target(s.lights, target);
  // The truth's albedo times vignetting, for the bound: from a picture without noise.
  target.noise = 1e-12;
  const relight::TargetSamples clean =
      relight::simulate_target(std::span<const relight::NearLight>(s.lights).first(1), target);
  for (std::size_t p = 0; p < clean.n_points(); ++p) {
    s.albedo.push_back(
        static_cast<double>(clean.values(0)[p]) /
        (s.lights[0].power[0] *
         relight::light_stencil(s.lights[0], clean.points_mm[p], clean.normals[p])));
  }
  return s;
}

double rms(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double v : values) {
    sum += v * v;
  }
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(values.size(), 1)));
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1))];
}

struct Group {
  const char* name;
  double from;
  double to;
};
constexpr std::array<Group, 4> kGroups{Group{"0..200", 0, 200}, Group{"200..400", 200, 400},
                                       Group{"over 400", 400, 1e9}, Group{"all", 0, 1e9}};

/// Errors of groups of lights by their distance from the axis, each with its bound.
void print_groups(std::span<const relight::NearLight> truth,
                  std::span<const relight::NearLight> found,
                  std::span<const relight::LightBound> bound) {
  fmt::print("{:>9} {:>6} {:>7} {:>7} {:>7} {:>9} {:>9} {:>6} {:>9} {:>9} {:>6}\n", "from axis",
             "lights", "x", "y", "z", "an axis", "bound", "ratio", "power", "bound", "ratio");
  for (const Group& group : kGroups) {
    std::array<std::vector<double>, 3> error;
    std::vector<double> all;
    std::vector<double> limit;
    std::vector<double> power;
    std::vector<double> power_limit;
    for (std::size_t k = 0; k < truth.size(); ++k) {
      const double away = truth[k].position_mm.head<2>().norm();
      if (away < group.from || away >= group.to) {
        continue;
      }
      for (int c = 0; c < 3; ++c) {
        const double e = found[k].position_mm[c] - truth[k].position_mm[c];
        error[static_cast<std::size_t>(c)].push_back(e);
        all.push_back(e);
        limit.push_back(std::sqrt(bound[k].position_mm2(c, c)));
      }
      power.push_back(found[k].power[0] / truth[k].power[0] - 1.0);
      power_limit.push_back(bound[k].power);
    }
    fmt::print(
        "{:>9} {:>6} {:7.3f} {:7.3f} {:7.3f} {:9.4f} {:9.4f} {:6.3f} {:8.3f}% {:8.3f}% "
        "{:6.3f}\n",
        group.name, all.size() / 3, rms(error[0]), rms(error[1]), rms(error[2]), rms(all),
        rms(limit), rms(all) / rms(limit), 100 * rms(power), 100 * rms(power_limit),
        rms(power) / rms(power_limit));
  }
}

int count_mirrored(std::span<const relight::CalibratedLight> lights) {
  return static_cast<int>(std::count_if(lights.begin(), lights.end(), [](const auto& light) {
    return !(light.light.position_mm.z() > 0.0);
  }));
}

std::vector<relight::NearLight> positions(const relight::LightCalibration& calibration) {
  std::vector<relight::NearLight> out;
  for (const relight::CalibratedLight& light : calibration.lights) {
    out.push_back(light.light);
  }
  return out;
}

// ---- tables ----

void print_known_albedo() {
  fmt::print("\n== The bound with the albedo known (3-D, mm: median / 99 %; power) ==\n");
  for (const auto& [height, target] :
       {std::pair{300.0, 200.0}, std::pair{900.0, 200.0}, std::pair{900.0, 400.0}}) {
    const Setting s = simulate({.height_mm = height, .target_mm = target});
    for (const bool known : {true, false}) {
      for (const relight::Coupling coupling :
           {relight::Coupling::dense, relight::Coupling::modes}) {
        if (known && coupling == relight::Coupling::modes) {
          continue;
        }
        const auto start = std::chrono::steady_clock::now();
        const relight::LightBounds bounds = relight::free_light_bounds(
            s.samples, s.lights, s.albedo,
            {.is_mu_free = !known, .is_albedo_known = known, .coupling = coupling});
        std::vector<double> spread;
        std::vector<double> power;
        for (const relight::LightBound& b : bounds.lights) {
          spread.push_back(std::sqrt(b.position_mm2.trace()));
          power.push_back(b.power);
        }
        fmt::print(
            "{:4.0f} mm over {:3.0f} mm, {}: {:.4f} / {:.4f}, power {:.4f} %, mu {:.6f}, "
            "{:.2f} s\n",
            height, target,
            known                                  ? "albedo and mu known"
            : coupling == relight::Coupling::dense ? "both unknown, dense"
                                                   : "both unknown, modes",
            quantile(spread, 0.5), quantile(spread, 0.99), 100 * quantile(power, 0.5),
            bounds.mu, seconds_since(start));
      }
    }
  }
}

void print_free(const Case& c, relight::Stage stage) {
  const Setting s = simulate(c);
  relight::CalibrationOptions options;
  options.stage = stage;
  options.mask.saturation = 1e30;
  const auto start = std::chrono::steady_clock::now();
  const relight::LightCalibration found =
      relight::calibrate_free_lights(s.samples, relight::paper_start(s.samples, 1.0), options);
  const double seconds = seconds_since(start);
  fmt::print(
      "\n== Free lights, {} mm over a target of {} mm, {} ==\n{}\n{:.1f} s, {} mirrored\n",
      c.height_mm, c.target_mm,
      stage == relight::Stage::likelihood ? "variance then likelihood" : "variance alone",
      found.brief_report(), seconds, count_mirrored(found.lights));
  const relight::LightBounds bounds = relight::free_light_bounds(s.samples, s.lights, s.albedo);
  fmt::print("mu {:.5f} (bound {:.5f})\n", found.mu, bounds.mu);
  print_groups(s.lights, positions(found), bounds.lights);
}

relight::RigidArray array_of(std::span<const relight::NearLight> lights,
                             const Eigen::Isometry3d& array_from_world) {
  relight::RigidArray array;
  for (const relight::NearLight& light : lights) {
    array.positions_mm.push_back(array_from_world * light.position_mm);
    array.axes.push_back(array_from_world.linear() * light.axis);
  }
  return array;
}

Eigen::Isometry3d shifted(double mm, double degrees, std::uint64_t seed) {
  const auto u = [&](std::uint64_t i) {
    return 2.0 * uniform_unit(hash_key(seed, 77, i)) - 1.0;
  };
  Eigen::Isometry3d move = Eigen::Isometry3d::Identity();
  move.translate(mm * Vector3d(u(0), u(1), u(2)).normalized());
  move.rotate(Eigen::AngleAxisd(degrees * (std::numbers::pi / 180.0),
                                Vector3d(u(3), u(4), u(5)).normalized()));
  return move;
}

void print_rigid(const Case& c, relight::Lobe lobe = relight::Lobe::free) {
  const Setting s = simulate(c);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translate(Vector3d(0, 0, c.height_mm));
  const relight::RigidArray array = array_of(s.lights, pose.inverse());
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  options.lobe = lobe;
  const auto start = std::chrono::steady_clock::now();
  const relight::LightCalibration found = relight::calibrate_rigid_array(
      s.samples, array, pose * shifted(0.1 * c.height_mm, 4.0, c.seed), options);
  const double seconds = seconds_since(start);
  fmt::print(
      "\n== Rigid array, {} mm over a target of {} mm, seed {}, lobe {} ==\n{}\n{:.1f} s\n",
      c.height_mm, c.target_mm, c.seed, lobe == relight::Lobe::free ? "free" : "paper",
      found.brief_report(), seconds);
  const relight::PoseBound bounds = relight::rigid_bound(s.samples, s.lights, s.albedo);
  fmt::print("mu {:.5f} (bound {:.5f})\n", found.mu, bounds.mu);
  print_groups(s.lights, positions(found), bounds.lights);
}

/// The same array, the lobe taken as isotropic, as the paper has it.
void print_paper(const Case& c) {
  const Setting s = simulate(c);
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  options.outlier_fraction = 0.0;
  for (const relight::Lobe lobe : {relight::Lobe::paper, relight::Lobe::free}) {
    for (const relight::Stage stage : {relight::Stage::variance, relight::Stage::likelihood}) {
      options.lobe = lobe;
      options.stage = stage;
      const auto start = std::chrono::steady_clock::now();
      const relight::LightCalibration found = relight::calibrate_free_lights(
          s.samples, relight::paper_start(s.samples, 1.0), options);
      std::vector<double> error;
      for (std::size_t k = 0; k < s.lights.size(); ++k) {
        error.push_back((found.lights[k].light.position_mm - s.lights[k].position_mm).norm());
      }
      fmt::print(
          "{:>5} {:>10}: 3-D median {:8.3f} mm, 99 % {:8.3f} mm, chi^2 {:8.3f}, D {:.3g}, "
          "{:.1f} s\n",
          lobe == relight::Lobe::paper ? "paper" : "free",
          stage == relight::Stage::variance ? "variance" : "likelihood", quantile(error, 0.5),
          quantile(error, 0.99), found.reduced_chi2, found.variance, seconds_since(start));
    }
  }
}

/// 100 random starts of an 8 x 8 array: how many end at the same position.
void print_starts(int n_starts) {
  const Case c{.side = 8};
  const Setting s = simulate(c);
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  const relight::LightCalibration best =
      relight::calibrate_free_lights(s.samples, relight::paper_start(s.samples, 1.0), options);
  fmt::print(
      "\n== {} random starts, 8 x 8 lights of one array 930 mm wide, {} mm over {} mm ==\n",
      n_starts, c.height_mm, c.target_mm);
  for (const bool is_rigid : {false, true}) {
    int same = 0;
    int failed = 0;
    int mirrored = 0;
    double worst = 0.0;
    double steps = 0.0;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translate(Vector3d(0, 0, c.height_mm));
    const relight::RigidArray array = array_of(s.lights, pose.inverse());
    const relight::LightCalibration best_rigid =
        relight::calibrate_rigid_array(s.samples, array, pose, options);
    for (const relight::Start kind : {relight::Start::given, relight::Start::uniform_albedo}) {
      if (is_rigid && kind == relight::Start::uniform_albedo) {
        continue;
      }
      options.start = kind;
      same = failed = mirrored = 0;
      worst = steps = 0.0;
      for (int i = 0; i < n_starts; ++i) {
        const auto seed = static_cast<std::uint64_t>(1000 + i);
        try {
          relight::LightCalibration found;
          if (is_rigid) {
            found = relight::calibrate_rigid_array(
                s.samples, array, pose * shifted(0.3 * c.height_mm, 20.0, seed), options);
          } else {
            std::vector<relight::NearLight> start = relight::paper_start(s.samples, 1.0);
            for (std::size_t k = 0; k < start.size(); ++k) {
              const auto u = [&](std::uint64_t j) {
                return uniform_unit(hash_key(seed, k, j));
              };
              start[k].position_mm = {600.0 * (u(0) - 0.5), 600.0 * (u(1) - 0.5),
                                      50.0 * std::pow(40.0, u(2))};
            }
            found = relight::calibrate_free_lights(s.samples, start, options);
          }
          const relight::LightCalibration& reference = is_rigid ? best_rigid : best;
          double apart = 0.0;
          for (std::size_t k = 0; k < found.lights.size(); ++k) {
            apart = std::max(apart, (found.lights[k].light.position_mm -
                                     reference.lights[k].light.position_mm)
                                        .norm());
          }
          same += apart < 0.1 ? 1 : 0;
          worst = std::max(worst, apart);
          mirrored += count_mirrored(found.lights) > 0 ? 1 : 0;
          steps += found.n_variance_iterations;
        } catch (const Error& error) {
          ++failed;
          fmt::print("  start {}: {}\n", i, error.problem());
        }
      }
      fmt::print(
          "{}, {}: {} of {} end within 0.1 mm of the same position (worst {:.3g} mm), {} "
          "mirrored, "
          "{} refused, {:.0f} L-BFGS steps each\n",
          is_rigid ? "rigid, starts 0.3 heights and 20 degrees off"
                   : "free, starts x, y within 300 mm, z 50..2000 mm",
          kind == relight::Start::given ? "from there" : "uniform albedo first", same, n_starts,
          worst, mirrored, failed, steps / n_starts);
    }
  }
}

/// Eight LEDs as others calibrated them, over a target 800 mm from their camera.
void print_leds() {
  const std::filesystem::path file = "../shared/data/near_leds/light.mat";
  if (!std::filesystem::exists(file)) {
    fmt::print("\n== Eight real LEDs: {} is absent, skipped ==\n", file.string());
    return;
  }
  std::vector<relight::NearLight> lights = relight::read_near_leds(file, 800.0);
  relight::SimulatedTarget target;
  target.size_mm = 200.0;
  target.n_channels = 3;
  target.albedo_spread = 0.1;
  target.vignetting = 0.2;
  const relight::TargetSamples samples = relight::simulate_target(lights, target);
  fmt::print("\n== Eight real LEDs, a target of 200 mm, 3 channels ==\n");
  std::vector<double> albedo;
  relight::PowerFit truth = relight::fit_powers(samples, lights);
  const relight::LightBounds bounds =
      relight::free_light_bounds(samples, truth.lights, truth.albedo);
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  std::vector<Vector3d> axes;
  for (const relight::NearLight& light : lights) {
    axes.push_back(light.axis);
  }
  const std::vector<relight::NearLight> start =
      relight::start_along_axes(samples, axes, 400.0, 1.0);
  const auto report = [&](const char* name, const relight::LightCalibration& found,
                          std::span<const relight::LightBound> limit) {
    fmt::print("{}: {}\n", name, found.brief_report());
    std::vector<double> error;
    std::vector<double> bound;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const Vector3d e = found.lights[k].light.position_mm - lights[k].position_mm;
      fmt::print("  LED {}: x {:7.3f} y {:7.3f} z {:7.3f} mm, bound {:.3f} {:.3f} {:.3f}\n", k,
                 e.x(), e.y(), e.z(), std::sqrt(limit[k].position_mm2(0, 0)),
                 std::sqrt(limit[k].position_mm2(1, 1)),
                 std::sqrt(limit[k].position_mm2(2, 2)));
      for (int c = 0; c < 3; ++c) {
        error.push_back(e[c]);
        bound.push_back(std::sqrt(limit[k].position_mm2(c, c)));
      }
    }
    fmt::print("  an axis {:.4f} mm, bound {:.4f}, ratio {:.3f}; mu {:.4f}\n", rms(error),
               rms(bound), rms(error) / rms(bound), found.mu);
  };
  report("free", relight::calibrate_free_lights(samples, start, options), bounds.lights);
  const relight::RigidArray array = array_of(lights, Eigen::Isometry3d::Identity());
  const relight::PoseBound pose = relight::rigid_bound(samples, truth.lights, truth.albedo);
  report("rigid",
         relight::calibrate_rigid_array(samples, array, shifted(40.0, 5.0, 3), options),
         pose.lights);
}

// A dome of 81 lights, five mirror balls or one sheet.
constexpr double kRadius = 500.0;    // of the dome, mm
constexpr double kBall = 12.0;       // radius of a ball, mm
constexpr double kPixelError = 0.3;  // of a highlight and of an outline point, pixels

/// @param elevation  gets one per light, in degrees
std::vector<relight::NearLight> dome_lights(std::vector<double>& elevation) {
  std::vector<relight::NearLight> lights;
  for (const auto& [degrees, count] :
       {std::pair{20.0, 20}, std::pair{35.0, 19}, std::pair{50.0, 16}, std::pair{62.0, 12},
        std::pair{74.0, 9}, std::pair{85.0, 5}}) {
    for (int i = 0; i < count; ++i) {
      const double up = degrees * std::numbers::pi / 180.0;
      const double round = 2.0 * std::numbers::pi * (i + 0.3) / count;
      relight::NearLight light;
      light.position_mm = kRadius * Vector3d(std::cos(up) * std::cos(round),
                                             std::cos(up) * std::sin(round), std::sin(up));
      light.axis = -light.position_mm.normalized();
      light.mu = 1.0;
      lights.push_back(light);
      elevation.push_back(degrees);
    }
  }
  return lights;
}

CameraModel camera_above() {
  CameraModel camera;
  camera.width = 5760;
  camera.height = 3840;
  camera.fx = camera.fy = 8000.0;
  camera.cx = 2880.0;
  camera.cy = 1920.0;
  camera.world_from_cam = look_at({0.0, 0.0, 700.0}, {0, 0, 0}, {0, 1, 0});
  return camera;
}

/// The outline of ball `j` at `at` that the camera sees, each point with its error.
std::vector<Eigen::Vector2d> seen_outline(const CameraModel& camera, const Vector3d& at,
                                          std::size_t j) {
  const Vector3d way = camera.centre_world() - at;
  const double c = kBall / way.norm();
  const Vector3d a = way.unitOrthogonal();
  const Vector3d b = way.normalized().cross(a);
  std::vector<Eigen::Vector2d> outline;
  for (int i = 0; i < 60; ++i) {
    const double t = 2.0 * std::numbers::pi * i / 60.0;
    const Vector3d n =
        c * way.normalized() + std::sqrt(1.0 - c * c) * (std::cos(t) * a + std::sin(t) * b);
    const auto key = static_cast<std::uint64_t>(i);
    outline.push_back(project(camera, at + kBall * n).value() +
                      kPixelError * Eigen::Vector2d(standard_normal(hash_key(9, j, key, 1)),
                                                    standard_normal(hash_key(9, j, key, 2))));
  }
  return outline;
}

struct BallLights {
  std::vector<Vector3d> by_rays;
  std::vector<Vector3d> by_parallel;  ///< as is usual: each ball seen from straight above
  double ball_error = 0.0;            ///< of the worst ball's centre, mm
};

BallLights lights_from_balls(const std::vector<relight::NearLight>& lights) {
  const CameraModel camera = camera_above();
  const std::array<Vector3d, 5> truth{Vector3d(0, 0, kBall), Vector3d(-90, 60, kBall),
                                      Vector3d(90, 60, kBall), Vector3d(-90, -60, kBall),
                                      Vector3d(90, -60, kBall)};
  std::vector<relight::MirrorSphere> spheres;
  std::vector<relight::PictureCircle> circles;
  for (std::size_t j = 0; j < truth.size(); ++j) {
    const std::vector<Eigen::Vector2d> outline = seen_outline(camera, truth[j], j);
    spheres.push_back(relight::sphere_from_outline(camera, outline, kBall));
    circles.push_back(relight::fit_circle(outline));
  }
  BallLights found;
  for (std::size_t j = 0; j < spheres.size(); ++j) {
    found.ball_error = std::max(found.ball_error, (spheres[j].centre_mm - truth[j]).norm());
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    std::vector<relight::ReflectedRay> rays;
    std::vector<relight::ReflectedRay> parallel;
    for (std::size_t j = 0; j < spheres.size(); ++j) {
      const Eigen::Vector2d glint =
          relight::glint_of(camera, {truth[j], kBall}, lights[k].position_mm) +
          kPixelError * Eigen::Vector2d(standard_normal(hash_key(8, k, j, 1)),
                                        standard_normal(hash_key(8, k, j, 2)));
      rays.push_back(relight::reflect_off(camera, spheres[j], glint));
      // As is usual: the camera far away, each ball seen from straight above.
      parallel.push_back({truth[j], relight::mirror_direction(circles[j], glint)});
    }
    found.by_parallel.push_back(relight::intersect(parallel).position_mm);
    found.by_rays.push_back(relight::intersect(rays).position_mm);
  }
  return found;
}

relight::LightCalibration lights_from_sheet(const std::vector<relight::NearLight>& lights) {
  relight::SimulatedTarget target;
  target.size_mm = 200.0;
  target.albedo_spread = 0.1;
  target.vignetting = 0.2;
  const relight::TargetSamples samples = relight::simulate_target(lights, target);
  std::vector<Vector3d> axes;
  for (const relight::NearLight& light : lights) {
    axes.push_back(light.axis);
  }
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  return relight::calibrate_free_lights(
      samples, relight::start_along_axes(samples, axes, 400.0, 1.0), options);
}

/// Errors by elevation.
void print_spheres() {
  std::vector<double> elevation;
  const std::vector<relight::NearLight> lights = dome_lights(elevation);
  const BallLights by_balls = lights_from_balls(lights);
  const relight::LightCalibration found = lights_from_sheet(lights);
  fmt::print(
      "\n== A dome of 81 lights, {} mm: five mirror balls of {} mm (edges and highlights to "
      "{} px, balls found to {:.2f} mm) beside a sheet of 200 mm ==\n{}\n",
      kRadius, kBall, kPixelError, by_balls.ball_error, found.brief_report());
  fmt::print("{:>9} {:>6} {:>16} {:>12} {:>12} {:>12} {:>12}\n", "elevation", "lights",
             "parallel view", "balls: 3-D", "along", "across", "sheet: 3-D");
  for (const double degrees : {20.0, 35.0, 50.0, 62.0, 74.0, 85.0}) {
    std::vector<double> balls;
    std::vector<double> far;
    std::vector<double> along;
    std::vector<double> across;
    std::vector<double> sheet;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      if (elevation[k] != degrees) {
        continue;
      }
      const Vector3d e = by_balls.by_rays[k] - lights[k].position_mm;
      const Vector3d way = lights[k].position_mm.normalized();
      balls.push_back(e.norm());
      far.push_back((by_balls.by_parallel[k] - lights[k].position_mm).norm());
      along.push_back(e.dot(way));
      across.push_back((e - e.dot(way) * way).norm());
      sheet.push_back((found.lights[k].light.position_mm - lights[k].position_mm).norm());
    }
    fmt::print("{:9.0f} {:6} {:13.2f} mm {:9.2f} mm {:9.2f} mm {:9.2f} mm {:9.2f} mm\n",
               degrees, balls.size(), rms(far), rms(balls), rms(along), rms(across),
               rms(sheet));
  }
}

int run(const std::string& what, int n_starts) {
  const bool all = what == "all";
  if (all || what == "bounds") {
    print_known_albedo();
  }
  if (all || what == "free") {
    print_free({}, relight::Stage::likelihood);
    print_free({.height_mm = 900.0, .target_mm = 400.0}, relight::Stage::likelihood);
  }
  if (all || what == "variance") {
    print_free({}, relight::Stage::variance);
  }
  if (all || what == "rigid") {
    for (const std::uint64_t seed : {1, 2, 3}) {
      print_rigid({.seed = seed});
      print_rigid({.height_mm = 900.0, .target_mm = 400.0, .seed = seed});
    }
    print_rigid({.height_mm = 900.0, .target_mm = 200.0});
  }
  if (all || what == "paper") {
    fmt::print("\n== 16 x 16 lights with mu = 1, taken as isotropic (paper) or free ==\n");
    print_paper({.side = 16});
    print_rigid({.side = 16}, relight::Lobe::paper);
  }
  if (all || what == "spheres") {
    print_spheres();
  }
  if (all || what == "leds") {
    print_leds();
  }
  if (all || what == "starts") {
    print_starts(n_starts);
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "all";
  return haarlight::run(what, argc > 2 ? std::atoi(argv[2]) : 100);
}
