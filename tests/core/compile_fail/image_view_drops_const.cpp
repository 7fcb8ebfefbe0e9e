// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/image.h"

haarlight::ImageView<float> wrong(haarlight::ImageView<const float> view) { return view; }
