// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "relight/reflectance/fit/picture_rows.h"
#include "relight/reflectance/formats/reflectance.h"

/// @file
/// A fit against pictures that it has not seen.

namespace haarlight {

/// Lights whose index leaves `rest` when divided by `every` are held out.
struct HoldOut {
  int every = 0;  ///< 0: none
  int rest = 0;
  [[nodiscard]] bool has(int i_light) const { return every > 0 && i_light % every == rest; }
};

struct FitError {
  std::vector<double> psnr_db;  ///< a light: of 8-bit values as a viewer shows them, clipped
  [[nodiscard]] double mean_psnr_db() const;
};

/// The model's pictures at `directions` against the rows' own, band by band.
/// @param rows  one light a direction, coded as the model is
/// @param most  pixels times lights; of more, bands of rows are taken that lie evenly
[[nodiscard]] FitError measure_fit(const ReflectanceModel& model, PictureRows& rows,
                                   const std::vector<Eigen::Vector3d>& directions,
                                   std::uint64_t most = ~std::uint64_t{0});

}  // namespace haarlight
