// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdlib>

#include "haarlight/core/error.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// What the fuzz targets of the readers share.

namespace haarlight::test {

/// Any bytes either read as a model that can be relit or are refused with Error.
template <class Parse>
void read_or_refuse(const Parse& parse) {
  try {
    const relight::ReflectanceModel model = parse();
    relight::require_consistent(model, "fuzz");
    if (model.planes.width() > 64 || model.planes.height() > 64) {
      return;  // enough is tested without so many pixels
    }
    const Image<float> picture = relight::relit(model, {0.6, 0.0, 0.8});
    for (const float value : picture.pixels()) {
      if (std::isnan(value)) {
        std::abort();
      }
    }
  } catch (const Error&) {  // NOLINT(bugprone-empty-catch): the only way out for bad bytes
  }
}

}  // namespace haarlight::test
