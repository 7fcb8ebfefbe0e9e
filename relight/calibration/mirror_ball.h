// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/relight/calibration/mirror_sphere.h"

/// @file
/// Mirror balls in photographs: found, measured, and the lights they show, each number with its
/// standard error. Pixels with centres at +0.5, y down; directions x right, y up, z to the
/// camera. Notes and measured errors: docs/numerics/near-light.md.

namespace haarlight::relight {

/// A ball's outline in the pictures and the circle through it.
struct MeasuredBall {
  PictureCircle circle;
  /// Of (x, y, radius), pixels^2: from the outline's deviation from the circle, each 10 degrees
  /// counted as one observation, since the errors of a drawn or blurred edge are correlated. A
  /// shift of the whole outline (a wide brush) is not included: the caller must add it.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  std::vector<Eigen::Vector2d> outline;
  double seen = 1.0;  ///< fraction of the circumference whose edge was found
};

/// @throws Error  fewer than 12 points, points on less than a third of a circle
[[nodiscard]] MeasuredBall measure_ball(std::vector<Eigen::Vector2d> outline);

/// From a mask: white on one ball, black around it. @throws Error  no outline, or not a circle:
/// its points deviate by more than 5 % of the radius
[[nodiscard]] MeasuredBall ball_of_mask(ImageView<const float> mask);

/// Accumulates what all pictures show together: balls stay fixed, highlights move.
class BallPictures {
 public:
  /// @param picture  (h, w, 1 or 3), linear; all of one size
  void add(ImageView<const float> picture);
  [[nodiscard]] int size() const { return n_; }
  /// Mean over the pictures of the square root of each pixel's light, 0 .. 1.
  [[nodiscard]] Image<float> mean() const;

 private:
  Image<float> sum_;
  int n_ = 0;
};

struct BallSearchOptions {
  double least_radius = 0.03;  ///< of the picture's shorter side
  double most_radius = 0.6;
  double least_seen = 0.35;  ///< of a circle's circumference must be an edge
  int most = 40;             ///< circles examined
};

/// Circles that may be balls, best seen first: edges of the mean picture vote along their
/// normals for centres and radii in a picture of about 320 pixels, then each edge is measured
/// along 360 radii of the full picture. Non-balls (a cup, a ring) are rejected by their
/// highlights: choose_balls().
[[nodiscard]] std::vector<MeasuredBall> find_circles(ImageView<const float> mean,
                                                     const BallSearchOptions& options = {});

/// A light's reflection on one ball.
struct BallHighlight {
  Eigen::Vector2d at = Eigen::Vector2d::Zero();  ///< pixels
  /// Per coordinate: from the pixel grid, and from the centroid's shift between thresholds of
  /// 50 and 80 % of the peak.
  double sigma_px = 0.0;
};
/// @throws Error  as find_highlight()
[[nodiscard]] BallHighlight measure_highlight(ImageView<const float> picture,
                                              const PictureCircle& ball);

/// The pictures' evidence for one circle.
struct BallEvidence {
  int n_highlights = 0;    ///< pictures with a small highlight close to the brightest pixel
  double wander_px = 0.0;  ///< rms distance of the highlights from their mean
};

/// Picks the balls among circles: a highlight in four fifths of the pictures, which moves. Of
/// overlapping circles the best seen is taken. The choice.
struct BallChoice {
  std::vector<std::size_t> balls;
  /// Circles with highlights that overlap a chosen one, are seen nearly as well (within 0.1),
  /// and differ in position by more than a twentieth of the radius.
  std::vector<std::size_t> rivals;
};
[[nodiscard]] BallChoice choose_balls(std::span<const MeasuredBall> circles,
                                      std::span<const BallEvidence> evidence, int n_pictures);

// ---- lights ----

struct BallDirection {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, to the light
  double sigma_rad = 0.0;  ///< along each of two axes perpendicular to it
};
/// A far light. With a camera (its pose is not used) the ball is seen in perspective, else from
/// straight ahead and far away.
/// @throws Error  the highlight lies outside the ball
[[nodiscard]] BallDirection ball_direction(const MeasuredBall& ball,
                                           const BallHighlight& highlight,
                                           const CameraModel* camera);

/// Where balls of known radius lie before a camera, in the picture's frame: x right, y up, z to
/// the camera, its origin where the camera's axis meets the plane on which the balls lie.
struct BallScene {
  std::vector<MirrorSphere> spheres;
  double camera_mm = 0.0;  ///< height of the camera over that plane
};
/// @param radii_mm  one for all, or one each
/// @throws Error  a ball whose outline is not that of a cone
[[nodiscard]] BallScene ball_scene(const CameraModel& camera,
                                   std::span<const MeasuredBall> balls,
                                   std::span<const double> radii_mm);

struct BallPosition {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_mm2 = Eigen::Matrix3d::Zero();
  double chi2 = 0.0;  ///< of the rays' distances from it
  int freedom = 0;    ///< 2 per ball minus 3; 0: fewer than two balls showed the light
};
struct BallPositions {
  std::vector<BallPosition> lights;
  double chi2 = 0.0;
  int freedom = 0;
  /// True if the rays miss each other by more than their errors allow. The balls' own errors
  /// are common to all lights, so that no more than 3 per ball count as independent; one sound
  /// calibration in 10 000 exceeds the limit.
  [[nodiscard]] bool is_model_wrong() const;
  int n_balls = 0;
};
/// Each light at the point closest to its reflected rays, weighted by their errors; the
/// covariance is propagated from highlights and outlines. Radii are taken as exact: all lengths
/// scale with them.
/// @param highlights  (K, B); nothing: that light is not seen on that ball
[[nodiscard]] BallPositions ball_positions(
    const CameraModel& camera, std::span<const MeasuredBall> balls,
    std::span<const double> radii_mm,
    const std::vector<std::vector<std::optional<BallHighlight>>>& highlights);

}  // namespace haarlight::relight
