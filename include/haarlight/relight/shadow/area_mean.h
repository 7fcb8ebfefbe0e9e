// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/relight/shadow/projection.h"

/// @file
/// Visibility of a square light from a point off the shadow plane: the mean of the light's
/// shadow picture over the quadrilateral that the light projects to, seen from the point
/// [Kim13, eq. (5)]. Exact only on the plane, where the window vanishes; WindowRule has the
/// choices for elsewhere, docs/numerics/shadow.md their errors.

namespace haarlight::relight {

/// The quadrilateral on the plane.
struct LightWindow {
  ProjectionStatus status = ProjectionStatus::invalid_plane;  ///< of the light's centre
  /// World; order of light_corners: (-u -v), (+u -v), (+u +v), (-u +v). Meaningful when
  /// `has_corners`.
  std::array<Eigen::Vector3d, 4> corners;
  bool has_corners = false;  ///< every corner of the light has a projection
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< projection of the light's centre
  double ratio = 0.0;                                ///< b/a of the centre
};

/// Projects each corner by eq. (4): exact for tilted planes too.
/// @param light_corners  as render::light_corners() orders them
[[nodiscard]] LightWindow project_window(const Plane& plane,
                                         const Eigen::Vector3d& light_centre,
                                         const std::array<Eigen::Vector3d, 4>& light_corners,
                                         const Eigen::Vector3d& vertex);

/// Side W = s |h|/(H - h) of the window for a plane parallel to the light; h of the vertex and
/// H of the light over the plane. Neighbouring lights d_l apart have windows D = d_l |h|/(H -
/// h) apart.
[[nodiscard]] double window_side(double side, double vertex_height, double light_height);

/// The window to average over.
enum class WindowRule {
  none,       ///< the shadow picture at the light's centre only
  plain,      ///< eq. (5) as printed: W everywhere
  corrected,  ///< W' below the plane, nothing on and above it
};
inline constexpr auto kWindowRuleWords =
    std::to_array<std::string_view>({"none", "plain", "corrected"});
constexpr std::span<const std::string_view> words_of(WindowRule) { return kWindowRuleWords; }

/// The known extent of the object: its lowest and highest point over the plane.
struct HeightRange {
  double low_mm = 0.0;
  double high_mm = 0.0;
};

/// W'/W = sqrt(1 + 2 B/W) below the plane, with B = s h_o/(H - h_o) the penumbra of an edge at
/// height h_o that the shadow picture already contains: variances add to the true (B + W)^2.
/// @param ratio  b/a of the vertex, negative
/// @param object_height_fraction  h_o/H, in [0, 1)
[[nodiscard]] double corrected_window_scale(double ratio, double object_height_fraction);

/// Above the plane no averaging helps. The factor by which the picture's penumbra is too wide
/// without a window: B/(B - W). Infinity where the vertex is at or above the edge's height.
[[nodiscard]] double widening_above(double ratio, double object_height_fraction);

/// A mean over a window and its unknown fraction.
struct WindowMean {
  double value = 1.0;    ///< middle of the bounds V = 0 and V = 1 in the unknown part
  double unknown = 0.0;  ///< unknown fraction of the window = distance between the bounds
  double outside = 0.0;  ///< fraction beyond the plane picture, taken as lit
};

/// Summed-area tables of one light's visibility and of the unknown pixels. Can be shared
/// between threads. 8 bytes per pixel; as much again for the unknown, once for all tables of
/// one mask and not at all if everything is known.
class WindowSums {
 public:
  /// @param visibility  (h, w, 1) in [0, 1]
  /// @param known       (h, w, 1) 1 or 0
  /// @param deviation   standard deviation of a value
  WindowSums(ImageView<const float> visibility, ImageView<const std::uint8_t> known,
             double deviation = 0.0);

  /// The tables of a weighted mean of pictures: sums are linear, so the pictures are not
  /// needed.
  /// @param parts   one or more, of one size
  /// @param weights  as many weights; they add up to 1
  WindowSums(std::span<const WindowSums* const> parts, std::span<const double> weights);

  /// Fractions the other's table of the unknown if both are equal.
  void share_unknown(const WindowSums& other);

  /// Mean over a rectangle in picture coordinates, pixels taken as squares of constant value:
  /// exact to rounding. Without area: the mean over a pixel's square around its middle.
  [[nodiscard]] WindowMean mean(double x0, double x1, double y0, double y1) const;

  /// Mean over a convex quadrilateral in picture coordinates: strips of at most one pixel's
  /// height, each a rectangle of the strip's area and mid-line. Exact for a rectangle along the
  /// axes. Without area: as above.
  [[nodiscard]] WindowMean mean(const std::array<Eigen::Vector2d, 4>& quad) const;

  /// True where every pixel that the rectangle touches is known and fully visible.
  [[nodiscard]] bool is_lit(double x0, double x1, double y0, double y1) const;

  /// Of a value, standard; the pictures of a mean err independently.
  [[nodiscard]] double deviation() const noexcept { return deviation_; }
  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }

 private:
  using Table = std::vector<double>;
  struct Sum {
    double visible = 0.0;
    double unknown = 0.0;
  };
  [[nodiscard]] WindowMean mean_around(const Eigen::Vector2d& at) const;
  [[nodiscard]] Sum integral(double x0, double x1, double y0, double y1) const;

  int width_ = 0;
  int height_ = 0;
  double deviation_ = 0.0;
  Table visible_;                         ///< (height + 1, width + 1)
  std::shared_ptr<const Table> unknown_;  ///< the same; null: everything is known
};

}  // namespace haarlight::relight
