// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// Normals as cultural-heritage software derives them from a PTM or HSH: for comparison with
/// photometric stereo, which they approximate. Frame: x right, y up, z out of the picture.

namespace haarlight::relight {

/// The origin of a PTM's normal.
enum class PeakState : std::uint8_t {
  peak,     ///< the maximum, within the unit circle
  outside,  ///< the maximum lies beyond the circle: its direction, on the horizon
  no_peak,  ///< a saddle, a valley or a ramp: (0, 0, 1)
};

struct PtmPeak {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  PeakState state = PeakState::no_peak;
};

/// Where a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v + a5 is largest:
/// u = (a2 a4 - 2 a1 a3) / (4 a0 a1 - a2^2), v = (a2 a3 - 2 a0 a4) / (4 a0 a1 - a2^2)
/// (Malzbender 2001, eqs. 16, 17); a maximum where 4 a0 a1 > a2^2 and a0 < 0.
[[nodiscard]] PtmPeak ptm_peak(const Eigen::Matrix<double, 6, 1>& a) noexcept;

struct RtiNormals {
  Image<float> normal;           ///< (height, width, 3) unit
  Image<std::uint8_t> is_known;  ///< 0: no peak, or black in all three pictures
};

/// For a PTM: peaks, of the luminance factor or of the channels' mean. For an HSH: three
/// pictures relit from 45 degrees above, at 30, 150 and 270 degrees, solved for a Lambertian
/// surface; mean of the colours, decoded to linear light.
/// @throws Error  another basis
[[nodiscard]] RtiNormals rti_normals(const ReflectanceModel& model);

/// The same as a surface: its normals in the lights' frame, and in place of the albedo the
/// picture under a light from the camera, in linear light. No errors, no counts.
/// @param mask  (height, width): 0 is left out; empty: all pixels
[[nodiscard]] SurfaceEstimate rti_surface(const ReflectanceModel& model,
                                          ImageView<const std::uint8_t> mask,
                                          const Eigen::Matrix3d& picture_from_world);

}  // namespace haarlight::relight
