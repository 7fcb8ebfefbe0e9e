// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/plate_sample.h"

#include <algorithm>
#include <memory>
#include <span>

#include "haarlight/relight/basis/plate/plate_source.h"
#include "relight/basis/plate/planes_plate.h"
#include "relight/basis/plate/plate.h"

namespace haarlight::relight {

std::vector<float> sample_plate(const Rig& rig, int max_pixels) {
  const ComputedPlate plate(rig);
  const StackDims dims = plate.dims();
  const std::size_t n = dims.n_pixels();
  const std::size_t n_kept = std::min(n, static_cast<std::size_t>(max_pixels));
  const auto n_lights = static_cast<std::size_t>(dims.n_lights);
  std::vector<float> values(n_kept * n_lights);
  for (std::size_t i = 0; i < n_kept; ++i) {
    const auto pixel = static_cast<int>(i * n / n_kept);
    plate.read_tile({pixel % dims.width, pixel / dims.width, 1, 1},
                    std::span(values).subspan(i * n_lights, n_lights));
  }
  return values;
}

session::PlatePixels computed_pixels(const Rig& rig, int width, int height) {
  session::PlatePixels pixels;
  const int camera = camera_of_size(rig, width, height);
  if (!rig.planes.empty() && camera >= 0) {
    const std::shared_ptr<const StackSource> computed = make_rig_plate(rig, camera);
    pixels.read = [computed](int y, int x0, int x1, std::span<float> out) {
      computed->read_tile({x0, y, x1 - x0, 1}, out);
    };
  }
  return pixels;
}

}  // namespace haarlight::relight
