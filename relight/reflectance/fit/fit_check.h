// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "relight/reflectance/fit/picture_rows.h"

/// @file
/// Tests a fit on held-out pictures.

namespace haarlight::relight {

/// Lights whose index leaves `rest` when divided by `every` are held out.
struct HoldOut {
  int every = 0;  ///< 0: none
  int rest = 0;
  [[nodiscard]] bool has(int i_light) const { return every > 0 && i_light % every == rest; }
};

struct FitError {
  std::vector<double> psnr_db;  ///< per light: of 8-bit values as a viewer shows them, clipped
  [[nodiscard]] double mean_psnr_db() const;
};

/// The model's pictures at `directions` against the rows' own, band by band.
/// @param rows  one light per direction, coded like the model
/// @param most  pixels times lights; beyond, evenly spaced bands of rows are used
[[nodiscard]] FitError measure_fit(const ReflectanceModel& model, PictureRows& rows,
                                   const std::vector<Eigen::Vector3d>& directions,
                                   std::uint64_t most = ~std::uint64_t{0});

}  // namespace haarlight::relight
