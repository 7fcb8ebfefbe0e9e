// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Core>

#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// A relightable picture in another basis, or coded with another transfer: least squares over
/// directions. Not a lossless conversion: the difference of the pictures is measured.

namespace haarlight::relight {

/// Unit directions spread evenly over the hemisphere by a golden spiral, down to an elevation
/// of about ten degrees.
/// @param turn  a spiral other than that of 0: for measuring at directions not fitted
[[nodiscard]] std::vector<Eigen::Vector3d> spread_over_hemisphere(int n, double turn = 0.0);

/// The sample directions of a refit: the model's own lights if there are at least twice as many
/// as terms (only there were its colours observed), else 200 directions over the hemisphere.
[[nodiscard]] std::vector<Eigen::Vector3d> refit_directions(const ReflectanceModel& model,
                                                            int n_terms);

struct RefitTarget {
  ReflectanceBasis basis = ReflectanceBasis::hsh;  ///< ptm or hsh; colour is rgb
  int n_terms = 9;
  ScaleRule rule = ScaleRule::any;
};

/// The model of the target's basis whose pictures are closest to the source's at the
/// directions, in srgb (a linear source is coded first; negative light counts as zero). Two
/// passes over the rows; memory besides the two models' planes is a few rows.
/// @throws Error  fewer directions than terms, or directions that do not separate the terms
[[nodiscard]] ReflectanceModel refit(const ReflectanceModel& source, const RefitTarget& target,
                                     const std::vector<Eigen::Vector3d>& directions);

/// The difference of the pictures of two models, as bytes on a screen, peak 255. Above four
/// million pixels, evenly spaced rows are compared.
struct PictureDifference {
  bool is_same = true;    ///< every byte
  double mean_db = 0.0;   ///< PSNR over all pictures together; nothing where is_same
  double worst_db = 0.0;  ///< of the worst direction
};
[[nodiscard]] PictureDifference compare_pictures(
    const ReflectanceModel& first, const ReflectanceModel& second,
    const std::vector<Eigen::Vector3d>& directions);

/// The picture under a light from `direction`, coded as srgb whatever the model's transfer.
[[nodiscard]] Image<float> relit_srgb(const ReflectanceModel& model,
                                      const Eigen::Vector3d& direction);

}  // namespace haarlight::relight
