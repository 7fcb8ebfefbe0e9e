// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/render/analytic/plane_irradiance.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// The clean plate B[pixel][light]: the empty shadow plane under every light. What compress
/// stores of the light transport matrix T is T - g B with one gain per pixel: the array's
/// smooth ramp over the lights, present in every unshadowed pixel, would cost piecewise
/// constants hundreds of coefficients. Source: docs/numerics/relight.md, "The clean plate".

namespace haarlight::relight {

/// A point of the plane and the ray that hits it.
struct PlateView {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< on the camera's side
  double slope = 0.0;  ///< n . the ray's unit direction: 0 on the plane's horizon
};

/// The clean plate computed from a rig: at the plane point that each pixel's centre sees, the
/// irradiance from every LED's square, times 1/pi (a white plane, LED radiance 1): Lambert's
/// closed form or Gauss points, to 1e-12 of each value. A pixel that does not see the plane is
/// 0 under every light.
class ComputedPlate final : public StackSource {
 public:
  /// @throws Error  the rig has no camera or no such plane, or no light reaches the plane
  ComputedPlate(const Rig& rig, int i_camera = 0, int i_plane = 0);
  [[nodiscard]] StackDims dims() const override;
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  [[nodiscard]] bool is_closed_form() const override { return true; }

  /// Where the plane is seen at a picture position, in pixels; nothing: not visible.
  [[nodiscard]] std::optional<PlateView> look(double x, double y) const;
  /// The plate at any picture position, (n_lights); all 0 where the plane is not seen.
  void evaluate(double x, double y, std::span<double> out) const;
  /// The same by light_irradiance(), which shares no quadrature with evaluate(): for checks.
  void evaluate_exactly(double x, double y, std::span<double> out) const;
  [[nodiscard]] std::span<const render::SquareLight> lights() const noexcept {
    return squares_;
  }

 private:
  CameraModel camera_;
  ShadowPlane plane_;
  std::vector<render::SquareLight> squares_;
  std::array<std::optional<render::PlaneIrradiance>, 2>
      irradiance_;  ///< one per side of the plane
};

/// The gain g of one pixel: the median of T/B over the lights with B > 1e-6 of the pixel's
/// largest B; 0 when there is none, or when T - g B has more energy than T.
/// Of many pixels: PlateGain.
[[nodiscard]] float plate_gain(std::span<const float> t, std::span<const float> b);

/// The directions of the clean plate's rows as combinations of a few vectors: B ~ U V. The
/// approximation error goes into the residual, so nothing is lost.
struct PlateVectors {
  int rank = 0;
  std::vector<float> vectors;  ///< V, (rank, n_lights), orthonormal rows
  double missed = 0.0;         ///< rms over pixels of ||B - U V|| / ||B||, on the sample
};

/// Randomised subspace iteration [Halko11] on at most 4096 rows of the clean plate, each scaled
/// to norm 1. Deterministic.
/// @param target    stop at this `missed`
/// @param max_rank  at most 64
[[nodiscard]] PlateVectors fit_plate_vectors(const StackSource& plate, double target,
                                             int max_rank = 24);

/// A subspace close to given rows over the lights: orthonormal vectors, the most important
/// first.
struct RowSpace {
  Eigen::MatrixXd vectors;   ///< (n_lights, n)
  Eigen::VectorXd energies;  ///< (n): sum over the rows of their squared components along each
};
/// Randomised subspace iteration [Halko11]. Deterministic.
/// @param rows          (any number, n_lights)
/// @param n_vectors     fewer where there are fewer rows or lights
/// @param n_iterations  2 where only the subspace matters, 4 where its vectors are used
///                      individually
[[nodiscard]] RowSpace fit_row_space(std::span<const double> rows, int n_lights, int n_vectors,
                                     int n_iterations);

/// The first vectors of a space, as many as needed; their signs are flipped so that sums are
/// positive, in `space`, too.
/// @param energy  of all rows, each of norm 1: their number
[[nodiscard]] PlateVectors choose_vectors(RowSpace& space, double energy, double target,
                                          int max_rank);

}  // namespace haarlight::relight
