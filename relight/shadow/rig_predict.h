// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/shadow/plane_frame.h"

/// @file
/// What a rig will capture of an object's shadow, before anything is built: the formulas of
/// predict.h at every position on a plane that may be tilted relative to the lights (Figure 3
/// of [Kim13]: then spacing and penumbra vary over the plane). Every number is checked against
/// rendered pictures (tests/relight/shadow/rig_predict_test.cpp). Lengths in mm.

namespace haarlight::relight {

struct PredictOptions {
  double low_mm = 0.0;  ///< of the object, over the plane
  double high_mm = 0.0;
  double strip_mm = 10.0;         ///< width of the strip whose ripple is reported
  double sun_deg = 0.53;          ///< angular diameter of the hard sun
  std::vector<double> receivers;  ///< heights over the plane of surfaces to be drawn
};

/// Smallest and largest over the plane's picture, and under its middle.
struct Span {
  double least = 0.0;
  double middle = 0.0;
  double most = 0.0;
};

/// On a surface at another height than the plane, for an edge at the object's height.
struct ReceiverPrediction {
  double height_mm = 0.0;
  double penumbra_mm = 0.0;  ///< true width
  double drawn_mm = 0.0;     ///< width that `shadow --window corrected` draws
};

/// An edge at one height over the plane.
struct EdgePrediction {
  double height_mm = 0.0;
  Span spacing_mm;               ///< D: shadows of one edge under neighbouring lights
  Span penumbra_mm;              ///< W
  double ripple = 0.0;           ///< of the strip's shadow under all lights, peak to peak
  double sun_penumbra_mm = 0.0;  ///< a: of the hard sun
  /// Integrated squared error of its edge, mm per mm; none where the sun is larger than the
  /// LED.
  std::optional<double> hard_sun_error_mm;
  double off_grid_error_mm = 0.0;  ///< the same for a light half a pitch off the grid
  double largest_pixel_mm = 0.0;   ///< smallest W/2: larger camera pixels lose the penumbra
  std::vector<ReceiverPrediction> receivers;
};

/// One face's lights over one plane.
struct PlanePrediction {
  std::string face;
  std::string plane;
  double tilt_deg = 0.0;              ///< between the plane's normal and the lights'
  double light_height_mm = 0.0;       ///< of the face's middle over the plane
  double lowest_light_mm = 0.0;       ///< of its lights
  std::vector<EdgePrediction> edges;  ///< at the object's lowest and highest point
};

/// A camera's pixel on a plane.
struct PixelPrediction {
  std::string camera;
  std::string plane;
  double seen_fraction = 0.0;  ///< of the plane picture that lies in the camera's
  Span pixel_mm;               ///< longer side of a pixel's footprint
};

struct RigPrediction {
  std::vector<PlanePrediction> planes;
  std::vector<PixelPrediction> pixels;
  std::vector<std::string> notes;  ///< faces and cameras without a prediction, and why
};

/// @throws Error(usage)  heights out of order or below the plane; a strip, sun or receiver out
///                       of range; (bad_input) no plane, no face that lights one, an object as
///                       high as the lights
[[nodiscard]] RigPrediction predict_rig(const Rig& rig, const PredictOptions& options);

/// Distance of the shadows that one point of the object casts under two lights, eq. (1) for any
/// plane. None if a shadow does not meet the plane.
[[nodiscard]] std::optional<double> shadow_distance(const Plane& plane,
                                                    const Eigen::Vector3d& point,
                                                    const Eigen::Vector3d& light_a,
                                                    const Eigen::Vector3d& light_b);

}  // namespace haarlight::relight
