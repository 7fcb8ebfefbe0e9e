// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "render/volume/cell_map.h"
#include "render/volume/contours.h"
#include "render/volume/curve.h"
#include "render/volume/light_sum.h"
#include "render/volume/passed_face.h"
#include "render/volume/volume_view.h"

/// @file
/// What a ray gathers within one cell, of any type: shared by all ways to the exact picture.

namespace haarlight::render {

/// The optical depth that hides half of what is behind.
inline constexpr double kHalfDepth = std::numbers::ln2;

/// From where on a pixel's medium hides half of what is behind it.
struct HiddenFrom {
  double optical_depth = 0.0;  ///< so far, until it does
  double z = std::numeric_limits<double>::infinity();

  [[nodiscard]] double depth_or(double other) const { return std::isfinite(z) ? z : other; }
};

/// Of the pixels of a tile. For one thread.
class CellLight {
 public:
  /// @param rule, most_depth  as LightSum
  CellLight(const VolumeView& view, std::size_t n_pixels, const VolumeRule& rule = {},
            double most_depth = std::numeric_limits<double>::infinity())
      : view_(view), sum_(view.scene, n_pixels, rule, most_depth), probe_(view.scene, 1) {}

  /// The ray of which stretches follow, from the eye on; may come back to a pixel later.
  /// @param p         (x, y) of side_of_ray.h @param pixel  of the tile
  /// @param contours, hidden  outlive what follows; of this pixel
  void begin_ray(const Eigen::Vector2d& p, std::uint32_t pixel, ContourTracker& contours,
                 HiddenFrom& hidden) {
    p_ = p;
    hidden_ = &hidden;
    stretch_ = view_.stretch(p);
    contours_ = &contours;
    sum_.begin_ray(pixel);
  }
  /// Of what follows only what is within these counts.
  void limit(double from_z, double to_z) {
    begin_z_ = from_z;
    end_z_ = to_z;
  }

  /// A stretch within a tetrahedron, or a cell whose fields are its own.
  void add_linear(std::uint32_t cell, Crossing from, Crossing to);
  /// A face by which a ray enters a cell or leaves it, and where in what rounding leaves open.
  struct Passage {
    const PassedFace& face;
    Passing passing = Passing::any;
  };
  /// Within a cell of any type.
  /// @param from  where the stretch begins @param end  where the ray leaves
  void add_general(std::uint32_t cell, const Passage& in, const Passage& out,
                   const Crossing& from, const Crossing& end);

  /// Where a ray enters a bent cell.
  struct BentEntry {
    Eigen::Vector3d rst = Eigen::Vector3d::Zero();  ///< about: on the face
    double z = 0.0;
  };
  /// Within a bent cell. @param from, end  as add_general(); z alone counts
  void add_bent(std::uint32_t cell, const BentEntry& entry, const Crossing& from,
                const Crossing& end);

  /// What a splat is in the ray's pixel. @param z  where it is
  void add_summed(const PixelLight& sum, double z);

  /// Of the ray since begin_ray().
  [[nodiscard]] double optical_depth() const noexcept { return sum_.optical_depth(); }
  /// Once the last ray is done.
  [[nodiscard]] const std::vector<PixelLight>& finish() { return sum_.finish(); }
  [[nodiscard]] std::uint64_t n_segments() const noexcept { return sum_.n_segments(); }
  [[nodiscard]] RuleCounts rule_counts() const { return sum_.rule_counts(); }
  /// As VolumeCounts.
  [[nodiscard]] std::uint64_t n_lost_points() const noexcept { return n_lost_points_; }
  [[nodiscard]] std::uint64_t n_unresolved() const noexcept { return n_unresolved_; }

 private:
  /// The fields along a ray's stretch within a cell.
  struct CellCurves {
    Curve density;
    Curve colour;
    Curve contour;
    double contour_noise = 0.0;
  };

  [[nodiscard]] std::optional<std::array<double, 2>> clipped(double from, double to) const;
  [[nodiscard]] Eigen::Vector3d position_of(std::uint32_t node) const;
  [[nodiscard]] Eigen::Vector3d slope_in_tetrahedron(std::uint32_t cell) const;
  [[nodiscard]] Eigen::Vector3d slope_in_quadratic(std::span<const std::uint32_t> nodes,
                                                   const Eigen::Vector4d& b) const;
  template <class Add, class Density>
  void gather(double from, double thickness, double u, double v, const Add& add,
              const Density& density_at);
  void add_surface(std::size_t contour, const Eigen::Vector3d& slope, double z);
  void note_hidden(double optical_depth, double z);
  void set_cell_fields(std::uint32_t cell, Crossing& at) const;
  void add_isoparametric(std::uint32_t cell, const BentEntry* entry, const Crossing& from,
                         const Crossing& end);
  void add_mapped(std::uint32_t cell, CellMap& map, double from, double to, int n_halvings,
                  double before);
  template <class Slope>
  void add_curves(const CellCurves& curves, const std::optional<std::array<double, 2>>& part,
                  double from, double thickness, const Slope& slope_at);
  void add_quadratic(std::uint32_t cell, const Passage& in, const Passage& out, double from,
                     double to);

  const VolumeView& view_;
  LightSum sum_;
  LightSum probe_;  ///< of parts of one stretch, to find a depth
  std::uint64_t n_lost_points_ = 0;
  std::uint64_t n_unresolved_ = 0;
  // Of the ray.
  Eigen::Vector2d p_ = Eigen::Vector2d::Zero();
  double stretch_ = 1.0;
  ContourTracker* contours_ = nullptr;
  HiddenFrom* hidden_ = nullptr;
  double begin_z_ = -std::numeric_limits<double>::infinity();
  double end_z_ = std::numeric_limits<double>::infinity();
};

}  // namespace haarlight::render
