// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/volume/curve.h"
#include "render/volume/volume_scene.h"

/// @file
/// What rays gather, stretch by stretch from the eye on.

namespace haarlight::render {

/// The optical depth beyond which e^-x is 0 in doubles.
inline constexpr double kNoLight = 745.2;

struct PixelLight {
  Eigen::Array3d light = Eigen::Array3d::Zero();
  double opacity = 0.0;
  double transparency = 1.0;
};

/// A stretch of a ray within one cell: its ends' fields where they are linear.
struct Stretch {
  double length = 0.0;
  double density_near = 0.0;
  double density_far = 0.0;
  double colour_near = 0.0;
  double colour_far = 0.0;
};

/// Of the pixels of a tile, one after the other.
class LightSum {
 public:
  LightSum(const VolumeScene& scene, std::size_t n_pixels);

  void begin_ray(std::uint32_t pixel);
  /// Cut at the breakpoints of the transfer functions; each piece in closed form.
  void add(const Stretch& stretch);
  /// The same of fields that are polynomials: by Gauss' rules, within rounding.
  /// @param length    from s = 0 to 1 @param from, to  the part of it that is added
  void add(double length, const Curve& density, const Curve& colour, double from, double to);
  /// A surface that the ray passes.
  void add(const SurfaceLight& surface);
  /// What has been summed already.
  void add_summed(const PixelLight& sum);
  /// Of the ray so far.
  [[nodiscard]] double optical_depth() const noexcept { return depth_; }

  /// Once the last ray is done.
  [[nodiscard]] const std::vector<PixelLight>& finish();
  /// Pieces that were not empty.
  [[nodiscard]] std::uint64_t n_segments() const noexcept { return n_segments_; }

 private:
  /// Between breakpoints; its depths are in columns of their own.
  struct Piece {
    Eigen::Array3d near;  ///< colours at its ends; or the light of the whole
    Eigen::Array3d far;
    double length = 0.0;
    double opacity = -1.0;  ///< of one that is summed already; else -1
    double transparency = 1.0;
    std::uint32_t pixel = 0;
  };

  void add_linear_piece(double length, double rho_near, double rho_far,
                        const Eigen::Array3d& near, const Eigen::Array3d& far);
  void add_parts(double length, const Curve& density, const Curve& colour, double from,
                 double to);
  void add_part(double length, const Curve& density, const Curve& colour, double from,
                double to);
  void add_quadratic(double length, const Curve& density, const Curve& colour, double from,
                     double to);
  void add_smooth(double length, const Curve& density, const Curve& colour, double from,
                  double to);
  void composite();

  const VolumeScene& scene_;
  bool is_glowing_;
  std::vector<PixelLight> light_;
  std::uint64_t n_segments_ = 0;
  std::uint32_t pixel_ = 0;
  double depth_ = 0.0;
  std::size_t density_part_ = 0;  ///< where the last stretch ended
  std::size_t colour_part_ = 0;
  std::vector<double> splits_;
  std::vector<double> cuts_;
  // Pieces that are not composited yet.
  std::vector<double> depths_near_;
  std::vector<double> depths_far_;
  std::vector<Piece> pieces_;
  std::array<std::vector<double>, 5> weights_;
};

}  // namespace haarlight::render
