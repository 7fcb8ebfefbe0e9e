// SPDX-License-Identifier: Apache-2.0
#include "sim/transport_stack.h"

#include <algorithm>
#include <vector>

#include "haarlight/core/stack/light_stack.h"

namespace haarlight::sim {

void write_light_stack(const Transport& transport, const std::filesystem::path& file) {
  constexpr std::size_t kBandBytes = std::size_t{64} << 20U;
  const auto width = static_cast<std::size_t>(transport.width());
  const auto n_lights = static_cast<std::size_t>(transport.n_lights());
  const std::size_t row_bytes = width * n_lights * sizeof(float);
  StackDims shape;
  shape.width = transport.width();
  shape.height = transport.height();
  shape.n_lights = transport.n_lights();
  const auto band_rows = static_cast<int>(std::clamp<std::size_t>(
      kBandBytes / row_bytes, 1, static_cast<std::size_t>(transport.height())));
  LightStackWriter writer(file, shape, band_rows);
  const auto unit = static_cast<float>(1.0 / transport.scale());
  std::vector<float> band;
  for (int y0 = 0; y0 < shape.height; y0 += band_rows) {
    const int y1 = std::min(shape.height, y0 + band_rows);
    band.resize(static_cast<std::size_t>(y1 - y0) * width * n_lights);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const ImageView<const float> plane = transport.plane(static_cast<int>(k));
      for (int y = y0; y < y1; ++y) {
        const float* row = plane.row(y).data();
        float* out = band.data() + static_cast<std::size_t>(y - y0) * width * n_lights + k;
        for (std::size_t x = 0; x < width; ++x) {
          out[x * n_lights] = row[x] * unit;
        }
      }
    }
    writer.append_band(band);
  }
  writer.finish();
}

}  // namespace haarlight::sim
