// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/patterns.h"

/// @file
/// Predicts what a pattern of lights should look like at some points of the picture from the
/// frames seen so far. Pictures are sums of lights, and neighbouring lights look alike: at
/// point i light k gives x_k, a Gaussian process over its face,
///
///     E x = 0,  cov(x_a, x_b) = s_i^2 (c + m(|a - b|)),  m Matern 3/2
///
/// (c: the mean is not known beforehand), and a frame of drive levels p is y = p'x + noise of
/// variance s_i^2 rho. Each frame is one step of recursive least squares, which can be undone:
///
///     h = C p,  v = p'h,   x += h (y - p'x) / (v + rho),   C -= h h' / (v + rho)
///
/// Method and measured figures: docs/numerics/light-proof.md.

namespace haarlight::capture {

inline constexpr int kProofPoints = 64;  ///< 8 x 8 over the picture
using PointValues = Eigen::Array<double, kProofPoints, 1>;

/// A light and its drive, 0 .. 1.
using DrivenLight = std::pair<int, double>;

/// One thread. The scale s_i of a point is estimated from the prediction errors.
class LightPredictor {
 public:
  /// @param faces  the rig's, in the lights' order. Memory: 8 n^2 bytes per face of n lights.
  /// Lights of different faces are assumed independent.
  explicit LightPredictor(std::span<const FaceGrid> faces);

  struct Prediction {
    PointValues mean = PointValues::Zero();
    PointValues variance = PointValues::Zero();  ///< without the frame's own noise
    double spread = 0.0;  ///< v; rho where this pattern itself was seen once
  };
  /// O(lit lights of a face x its lights); O(64) for a single light.
  [[nodiscard]] Prediction predict(std::span<const DrivenLight> lit) const;
  /// @param noise  variances of `seen`
  void learn(std::span<const DrivenLight> lit, const PointValues& seen,
             const PointValues& noise);

  /// Variance of a single light, in units of s_i^2: 1 means nothing is known of it.
  [[nodiscard]] double spread_of(int light) const;
  [[nodiscard]] int n_learned() const noexcept { return n_learned_; }
  [[nodiscard]] int n_lights() const noexcept { return n_lights_; }
  /// Scales and mean are known: predictions are meaningful.
  [[nodiscard]] bool is_ready() const noexcept;

 private:
  struct FaceState {
    int first = 0;
    int n = 0;
    Eigen::MatrixXd covariance;  ///< C
    Eigen::MatrixXd mean;        ///< (points, lights)
  };
  struct Gain {
    std::vector<Eigen::VectorXd> h;  ///< one per face; empty: none of its lights
    double v = 0.0;
    PointValues mean = PointValues::Zero();
  };
  [[nodiscard]] Gain gain_of(std::span<const DrivenLight> lit) const;
  [[nodiscard]] const FaceState& face_of(int light) const;
  void learn_scale(const Gain& gain, double n_equal, const PointValues& seen,
                   const PointValues& noise);
  void update(const Gain& gain, const PointValues& seen, double rho);

  std::vector<FaceState> faces_;
  int n_lights_ = 0;
  int n_learned_ = 0;
  PointValues scale2_ = PointValues::Zero();  ///< s_i^2
  PointValues scale_sum_ = PointValues::Zero();
  double scale_weight_ = 0.0;
};

}  // namespace haarlight::capture
