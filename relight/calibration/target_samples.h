// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/relight/light/near_light.h"

/// @file
/// Pictures of a matte calibration target, one per light, as numbers: the input of near-light
/// calibration. Everything in mm, in one right-handed frame in which +z points away from the
/// target, towards the lights. Linear light, black subtracted. Source: [Huang15], section IV.

namespace haarlight::relight {

/// Standard deviation of an intensity I: sqrt(floor^2 + shot I + (relative I)^2).
struct SampleNoise {
  double relative = 0.005;
  double shot = 0.0;   ///< in units of intensity: 1 / (electrons per unit)
  double floor = 0.0;  ///< in units of intensity

  [[nodiscard]] double variance(double intensity) const noexcept {
    return floor * floor + (shot + relative * relative * intensity) * intensity;
  }
};

/// K lights, C channels, P points of the target.
struct TargetSamples {
  int n_lights = 0;
  int n_channels = 1;  ///< 1 or 3
  /// Points on a picture-like grid, row by row: (rows x cols) = P; 0: unordered. A coarse start
  /// averages blocks of such a grid; of other points it takes a subset.
  int rows = 0;
  int cols = 0;
  std::vector<Eigen::Vector3d> points_mm;  ///< (P)
  std::vector<Eigen::Vector3d> normals;    ///< (P), unit
  /// (P), unit, from the point to the camera; empty: unknown. A not quite Lambertian
  /// reflectance depends on it (relight/calibration/sheet_model.h).
  std::vector<Eigen::Vector3d> to_camera;
  /// (P), mm: how each point would move if the lens had 1 more radial distortion at the
  /// picture's corner (relative to the distance from its middle); empty: the target's own
  /// middle is used for the picture's, and its half side for the corner.
  std::vector<Eigen::Vector3d> lens_mm;
  std::vector<float> intensity;       ///< (K, C, P)
  std::vector<std::uint8_t> is_used;  ///< (K, P), 0: masked out
  SampleNoise noise;

  [[nodiscard]] std::size_t n_points() const noexcept { return points_mm.size(); }
  [[nodiscard]] const float* values(int light, int channel = 0) const noexcept {
    return intensity.data() +
           (static_cast<std::size_t>(light) * static_cast<std::size_t>(n_channels) +
            static_cast<std::size_t>(channel)) *
               n_points();
  }
  [[nodiscard]] const std::uint8_t* used(int light) const noexcept {
    return is_used.data() + static_cast<std::size_t>(light) * n_points();
  }
};

/// @throws Error  inconsistent sizes, a normal that is not unit, NaN; gives the index
void require_consistent(const TargetSamples& samples);

/// Centre of the points and the longer side of their bounding box in x and y, mm.
struct TargetExtent {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double size_mm = 0.0;
};
/// @throws Error  fewer than three points, or all collinear
[[nodiscard]] TargetExtent target_extent(const TargetSamples& samples);

// ---- what is left out ----

/// How many samples of one light were kept, and why the others were not.
struct SampleCounts {
  std::int64_t used = 0;
  std::int64_t saturated = 0;
  std::int64_t dark = 0;
  std::int64_t shadowed = 0;   ///< far below what a fit with the other samples expects
  std::int64_t outlying = 0;   ///< far above it (a highlight, dust)
  std::int64_t by_caller = 0;  ///< already masked on input
};

struct MaskOptions {
  double saturation = 1.0;  ///< at or above, in any channel: saturated
  /// Below this fraction of the light's own brightest sample in every channel: dark; a light
  /// whose brightest is below this fraction of the overall brightest is compared with that
  /// instead.
  double dark_fraction = 1e-3;
};

/// Clears is_used of saturated and dark samples. @return (K)
std::vector<SampleCounts> mask_samples(TargetSamples& samples, const MaskOptions& options);

/// Block averages, `factor` x `factor` points each, of samples on a grid; a block with a masked
/// sample is masked for that light. Unordered points: every factor^2-th. Averaging lowers the
/// noise; its bias on a curved falloff is of second order in the block size.
[[nodiscard]] TargetSamples coarse_samples(const TargetSamples& samples, int factor);

// ---- simulation ----

struct SimulatedTarget {
  int rows = 48;
  int cols = 48;
  double size_mm = 200.0;  ///< of the longer side
  int n_channels = 1;
  double noise = 0.005;        ///< relative, normal; also stated in the samples' noise model
  double saturation = 0.0;     ///< > 0: values are clipped there
  int bits = 0;                ///< > 0: rounded to 2^bits - 1 steps of the brightest sample
  double albedo_spread = 0.0;  ///< albedo uniform in 1 -+ spread, by point
  double vignetting = 0.0;     ///< loss at the target's corner
  /// Height over z = 0, mm, by (x, y); empty: flat. Normals by finite differences.
  std::function<double(double x, double y)> height = {};
  std::uint64_t seed = 1;
};

/// I = a eta e f(l, p) (1 + noise), every sample used; 0 where a light is behind the surface.
[[nodiscard]] TargetSamples simulate_target(std::span<const NearLight> lights,
                                            const SimulatedTarget& target);

/// rows x cols lights of a flat array facing down from z = height_mm, its middle over the
/// origin, powers uniform in 1 -+ spread and of mean 1.
[[nodiscard]] std::vector<NearLight> array_lights(int rows, int cols, double pitch_mm,
                                                  double height_mm, double mu,
                                                  double power_spread, std::uint64_t seed);

}  // namespace haarlight::relight
