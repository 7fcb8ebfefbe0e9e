// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "core/image.h"
#include "core/rig/camera_model.h"
#include "relight/calibration/mirror_sphere.h"

/// @file
/// Mirror balls in photographs: found, measured, and the lights they show, each number with its
/// standard error. Pixels with centres at +0.5, y down; directions x right, y up, z to the
/// camera. Notes and measured errors: docs/numerics/near-light.md.

namespace haarlight {

/// A ball's outline in the pictures and the circle through it.
struct MeasuredBall {
  PictureCircle circle;
  /// Of (x, y, radius), pixels^2: from how the outline leaves the circle, 10 degrees of it
  /// taken as one observation, since a drawn or blurred edge errs along a stretch. What moves
  /// the whole outline (a wide brush) is not seen in it: the caller's to add.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  std::vector<Eigen::Vector2d> outline;
  double seen = 1.0;  ///< share of the circumference whose edge was found
};

/// @throws Error  fewer than 12 points, points on less than a third of a circle
[[nodiscard]] MeasuredBall measure_ball(std::vector<Eigen::Vector2d> outline);

/// Of a mask: white on one ball, black around it. @throws Error  no outline, or no circle: its
/// points miss it by more than 5 % of the radius
[[nodiscard]] MeasuredBall ball_of_mask(ImageView<const float> mask);

/// What all pictures together show: balls stand still, highlights move.
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
  int most = 40;             ///< circles looked at
};

/// Circles that may be balls, best seen first: edges of the mean picture vote along their
/// normals for centres and radii at a picture of some 320 pixels, then each edge is measured
/// along 360 radii of the full picture. What is no ball (a cup, a ring) is told by its
/// highlights: choose_balls().
[[nodiscard]] std::vector<MeasuredBall> find_circles(ImageView<const float> mean,
                                                     const BallSearchOptions& options = {});

/// A light's reflection on one ball.
struct BallHighlight {
  Eigen::Vector2d at = Eigen::Vector2d::Zero();  ///< pixels
  /// A coordinate: what the pixels' grid leaves, and how far the centroid moves between 50 and
  /// 80 % of the peak.
  double sigma_px = 0.0;
};
/// @throws Error  as find_highlight()
[[nodiscard]] BallHighlight measure_highlight(ImageView<const float> picture,
                                              const PictureCircle& ball);

/// What the pictures say of one circle.
struct BallEvidence {
  int n_highlights = 0;    ///< pictures with a small highlight that rivals the brightest pixel
  double wander_px = 0.0;  ///< rms distance of the highlights from their mean
};

/// Picks the balls among circles: a highlight in four fifths of the pictures, which moves.
/// Of circles that overlap the best seen is taken.
/// What was picked.
struct BallChoice {
  std::vector<std::size_t> balls;
  /// Circles with highlights that overlap a chosen one, are seen nearly as well (0.1) and lie
  /// elsewhere by more than a twentieth of the radius.
  std::vector<std::size_t> rivals;
};
[[nodiscard]] BallChoice choose_balls(std::span<const MeasuredBall> circles,
                                      std::span<const BallEvidence> evidence, int n_pictures);

// ---- lights ----

struct BallDirection {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, to the light
  double sigma_rad = 0.0;                                ///< along each of two axes across it
};
/// A far light. With a camera (its pose is not used) the ball is seen in perspective, else from
/// straight ahead and far away.
/// @throws Error  the highlight lies outside the ball
[[nodiscard]] BallDirection ball_direction(const MeasuredBall& ball,
                                           const BallHighlight& highlight,
                                           const CameraModel* camera);

/// Where balls of one radius lie before a camera, in the picture's frame: x right, y up, z to
/// the camera, its origin where the camera's axis meets the plane on which the balls lie.
struct BallScene {
  std::vector<MirrorSphere> spheres;
  double camera_mm = 0.0;  ///< height of the camera over that plane
};
/// @param radii_mm  one for all, or one each
/// @throws Error  a ball that is no outline of a cone
[[nodiscard]] BallScene ball_scene(const CameraModel& camera,
                                   std::span<const MeasuredBall> balls,
                                   std::span<const double> radii_mm);

struct BallPlace {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_mm2 = Eigen::Matrix3d::Zero();
  double chi2 = 0.0;  ///< of the rays' distances from it
  int freedom = 0;    ///< 2 a ball less 3; 0: fewer than two balls showed the light
};
struct BallPlaces {
  std::vector<BallPlace> lights;
  double chi2 = 0.0;
  int freedom = 0;
  /// The rays meet as well as their errors promise. The balls' own errors are the lights'
  /// common ones, so that no more than 3 a ball count as independent; the limit is passed by
  /// one honest calibration in 10 000.
  [[nodiscard]] bool is_model_wrong() const;
  int n_balls = 0;
};
/// Each light where its reflected rays pass nearest, weighted by their errors; the covariance
/// is propagated from highlights and outlines. Radii count as certain: all lengths are in their
/// proportion.
/// @param highlights  (K, B); nothing: that ball does not show that light
[[nodiscard]] BallPlaces ball_places(
    const CameraModel& camera, std::span<const MeasuredBall> balls,
    std::span<const double> radii_mm,
    const std::vector<std::vector<std::optional<BallHighlight>>>& highlights);

}  // namespace haarlight
