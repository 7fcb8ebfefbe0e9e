// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <Eigen/Core>

/// @file
/// Loops over one pixel's samples, in vectors as wide as the machine has. Nothing is reordered
/// by width: every machine gives the same bits.

namespace haarlight::relight {

/// Borrowed columns of n samples: directions to the lights, weights, brightness.
struct SampleColumns {
  const double* x = nullptr;
  const double* y = nullptr;
  const double* z = nullptr;
  const double* w = nullptr;
  const double* value = nullptr;
  int n = 0;
};

/// Borrowed columns of n near lights.
struct LightColumns {
  const double* position[3] = {};  ///< mm
  const double* axis[3] = {};      ///< unit
  int n = 0;
};

/// The sums over i of w s s^T (upper half) and w s value.
struct SampleSums {
  double xx = 0.0, xy = 0.0, xz = 0.0, yy = 0.0, yz = 0.0, zz = 0.0;
  double xv = 0.0, yv = 0.0, zv = 0.0;
};
/// Four partial sums, as Eigen adds a column up two by two: samples i, i + 4, i + 8, ...
[[nodiscard]] SampleSums weighted_sums(const SampleColumns& samples);

/// The sums of w r^2 and of w, likewise, and how many w are above 0.
struct ResidualSums {
  double square = 0.0;
  double weight = 0.0;
  int n_used = 0;
};
[[nodiscard]] ResidualSums residual_sums(const double* w, const double* r, int n);

/// |value - b.s|, and the same as floats.
void find_residuals(const SampleColumns& samples, const Eigen::Vector3d& b, double* r,
                    float* ranked);

void to_floats(const double* from, int n, float* to);
[[nodiscard]] int count_within(const float* values, int n, float limit);
/// The largest of values >= 0 that is at most `limit`; 0: none is.
[[nodiscard]] float largest_within(const float* values, int n, float limit);
/// kept = value <= limit, and changed: where it was another before.
void keep_within(const float* values, int n, float limit, std::uint8_t* kept,
                 std::uint8_t* changed);

/// Weights of the residuals r over `scale`, for RobustLoss of the same name.
void huber_weights(const double* r, int n, double scale, double c, double* w);
void cauchy_weights(const double* r, int n, double scale, double c, double* w);
void tukey_weights(const double* r, int n, double scale, double c, double* w);

/// b.s of each sample.
void find_products(const SampleColumns& samples, const Eigen::Vector3d& b, double* products);

/// Unit directions from `point` to the lights, and what their brightness is multiplied by to be
/// that under unit irradiance: squared distance, over the cosine at the light if
/// `are_lambertian` (0 behind it; else the cosine is left in `lobe`).
void aim_at(const LightColumns& lights, const Eigen::Vector3d& point, bool are_lambertian,
            double* const direction[3], double* scale, double* lobe);

/// value += raw gain.
void add_channel(const float* raw, const double* gain, int n, double* value);
/// value *= scale / n_channels.
void scale_mean(const double* scale, int n_channels, int n, double* value);
/// Marks values at or above their limits.
void mark_reaching(const float* raw, const float* limit, int n, std::uint8_t* marks);
/// Marks samples that are void (scale not above 0) or clipped. @return  how many are clipped,
/// the void ones not counted
[[nodiscard]] int leave_out(const double* scale, const std::uint8_t* clipped, int n,
                            std::uint8_t* left_out);

}  // namespace haarlight::relight
