// SPDX-License-Identifier: Apache-2.0
// compressed OUT.hlb: pictures of one's own under 8 x 8 lights, compressed over the lights.
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>

#include <haarlight/core/stack/stack_source.h>
#include <haarlight/relight/basis/compress.h>

int main(int argc, char** argv) try {
  if (argc != 2) {
    return 2;
  }
  haarlight::StackDims dims;
  dims.width = dims.height = 32;
  dims.channels = 1;
  dims.n_lights = 64;
  haarlight::MemoryStack stack(dims);
  for (int y = 0; y < dims.height; ++y) {
    for (int x = 0; x < dims.width; ++x) {
      for (int k = 0; k < dims.n_lights; ++k) {
        const double distance = std::hypot(x - 4 * (k % 8), y - 4 * (k / 8));
        stack.at(0, y, x, k) = static_cast<float>(1.0 / (1.0 + distance));
      }
    }
  }
  haarlight::relight::CompressSource source;
  source.stack = &stack;
  source.grid = {8, 8};
  source.name = "made";
  source.lights.resize(64);
  for (int k = 0; k < dims.n_lights; ++k) {
    source.lights[static_cast<std::size_t>(k)].name = std::to_string(k);
    source.lights[static_cast<std::size_t>(k)].is_position = true;
    source.lights[static_cast<std::size_t>(k)].coordinates = {10.0 * (k % 8), 10.0 * (k / 8),
                                                              300.0};
  }
  haarlight::relight::CompressOptions options;
  options.relative_l2 = 0.001;
  const auto summary = haarlight::relight::compress_stack(source, argv[1], options);
  return summary.is_achieved() ? 0 : 1;
} catch (const std::exception& error) {
  std::fprintf(stderr, "compressed: %s\n", error.what());
  return 1;
}
