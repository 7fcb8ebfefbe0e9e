// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/volume/curve.h"

/// @file
/// Semi-transparent surfaces on which a field has a value: where a ray meets them, and what it sees.

namespace haarlight::render {

/// A surface of constant field value. Lit from the eye, on both sides alike [Phong75].
struct Contour {
  double value = 0.0;
  Eigen::Array3d colour = Eigen::Array3d::Ones();  ///< RGB
  double opacity = 0.5;                            ///< seen along its normal, 0..1
  double ambient = 0.2;
  double diffuse = 0.7;
  double specular = 0.3;
  double exponent = 30.0;
};

/// What a ray sees of it.
struct SurfaceLight {
  Eigen::Array3d light;  ///< as if nothing were behind
  double opacity = 0.0;
};

/// Edge-on it is as opaque as a sheet of glass that the ray passes at a slant [Williams98]:
/// alpha' = 1 - (1 - alpha)^(1/|n.v|), |n.v| >= 1e-6.
/// @param cosine  |n.v| of the normal and the ray's direction, unit both
[[nodiscard]] SurfaceLight seen_of(const Contour& contour, double cosine);

/// Where one ray meets a scene's surfaces, stretch by stretch. A value that is met where two stretches
/// meet counts once, whatever rounding makes of it.
class ContourTracker {
 public:
  explicit ContourTracker(const std::vector<Contour>& contours);

  struct Hit {
    double s = 0.0;  ///< along the stretch, 0..1
    std::size_t contour = 0;
  };

  /// The next stretch does not begin where the last ended.
  void begin() { is_new_ = true; }
  /// On a stretch along which the field runs linearly, in order; valid until the next call.
  [[nodiscard]] const std::vector<Hit>& between(double from, double to);
  /// On one along which it is a curve. @param noise  of its values: nearer ones are alike
  [[nodiscard]] const std::vector<Hit>& along(const Curve& curve, double noise);

 private:
  template <class Find>
  void add_hits(double at_begin, double at_end, double begin, double end, double noise,
                const Find& find);

  const std::vector<Contour>& contours_;
  std::vector<std::int8_t> sides_;  ///< of each value, where the last stretch ended: -1, 0, 1
  std::vector<Hit> hits_;
  std::vector<double> turns_;
  bool is_new_ = true;
};

}  // namespace haarlight::render
