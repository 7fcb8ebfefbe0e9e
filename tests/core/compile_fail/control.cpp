// SPDX-License-Identifier: Apache-2.0
/// @file
/// Does compile: proves that the files beside it fail for their own fault.

#include "haarlight/core/image.h"
#include "haarlight/core/units.h"

haarlight::Watts right() { return haarlight::Watts(5.0) + haarlight::Watts(3.0); }
haarlight::ImageView<const float> right(haarlight::ImageView<float> view) { return view; }
