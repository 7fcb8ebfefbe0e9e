#include "core/image.h"

haarlight::ImageView<float> wrong(haarlight::ImageView<const float> view) { return view; }
