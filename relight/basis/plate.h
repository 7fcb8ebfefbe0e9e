#pragma once

#include <memory>
#include <span>
#include <vector>

#include "core/rig.h"
#include "relight/basis/stack_source.h"
#include "render/scene.h"

/// @file
/// The clean plate B[pixel][light]: the empty shadow plane under every light. What compress
/// stores is T - g B with one gain a pixel, because the array's smooth ramp over the lights,
/// which every unshadowed pixel carries, costs piecewise constants hundreds of coefficients.
/// Source: docs/numerics/relight.md, "The clean plate".

namespace haarlight {

/// The plate computed from a rig: at the plane point that each pixel's centre sees, Lambert's
/// closed form of every LED's square, times 1/pi (a white plane, LED radiance 1). A pixel that
/// does not see the plane is 0 under every light.
class ComputedPlate final : public StackSource {
 public:
  /// @throws Error  the rig has no camera or no such plane, or no light reaches the plane
  ComputedPlate(const Rig& rig, int i_camera = 0, int i_plane = 0);
  [[nodiscard]] StackDims dims() const override;
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  [[nodiscard]] bool is_closed_form() const override { return true; }

 private:
  CameraModel camera_;
  ShadowPlane plane_;
  std::vector<SquareLight> squares_;
};

/// The gain g of one pixel: the median of T/B over the lights with B > 1e-6 of the pixel's
/// largest B; 0 when there is none, or when T - g B has more energy than T.
/// @param scratch  kept between calls to save allocations
[[nodiscard]] float plate_gain(std::span<const float> t, std::span<const float> b,
                               std::vector<float>& scratch);
[[nodiscard]] float plate_gain(std::span<const float> t, std::span<const float> b);

/// The directions of the plate's rows as combinations of a few vectors: B ~ U V. What U V
/// misses goes into the residual, so no error comes of it.
struct PlateVectors {
  int rank = 0;
  std::vector<float> vectors;  ///< V, (rank, n_lights), orthonormal rows
  double missed = 0.0;         ///< rms over pixels of ||B - U V|| / ||B||, on the sample
};

/// Randomised subspace iteration [Halko11] on at most 4096 rows of the plate, each scaled to
/// norm 1. Deterministic.
/// @param target    stop at this `missed`
/// @param max_rank  at most 64
[[nodiscard]] PlateVectors fit_plate_vectors(const StackSource& plate, double target,
                                             int max_rank = 24);

}  // namespace haarlight
