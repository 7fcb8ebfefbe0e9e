// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "sim/transport_file.h"
#include "tests/temporary_folder.h"

/// @file
/// Transport matrices made by hand for tests of the camera.

namespace haarlight::testing {

inline sim::Transport made_transport(const TemporaryFolder& folder, int width, int height,
                                     const std::vector<float>& planes) {
  sim::TransportData data;
  data.width = width;
  data.height = height;
  data.n_lights = static_cast<int>(planes.size() / static_cast<std::size_t>(width * height));
  data.key = std::string(32, 'a');
  data.seconds = 1.0;
  data.planes = planes;
  sim::write_transport(folder / "transport.bin", data);
  return sim::Transport::open(folder / "transport.bin");
}

/// Each light k shows `values[k]` in every pixel.
inline sim::Transport flat_transport(const TemporaryFolder& folder, int width, int height,
                                     const std::vector<float>& values) {
  std::vector<float> planes;
  for (const float value : values) {
    planes.insert(planes.end(),
                  static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value);
  }
  return made_transport(folder, width, height, planes);
}

/// Each light shows another smooth picture, between a half and one and a half.
inline sim::Transport waved_transport(const TemporaryFolder& folder, int width, int height,
                                      int n_lights) {
  std::vector<float> planes;
  for (int k = 0; k < n_lights; ++k) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double across = (1.0 + 0.3 * (k % 7)) * 6.0 * x / width;
        const double down = (1.0 + 0.2 * (k % 5)) * 6.0 * y / height;
        planes.push_back(static_cast<float>(1.0 + 0.5 * std::sin(2.4 * k + across + down)));
      }
    }
  }
  return made_transport(folder, width, height, planes);
}

/// A camera of 64 x 56, 48 rows active, without noise unless requested.
inline CameraSpec test_camera() {
  CameraSpec spec;
  spec.id = "main";
  spec.format = "Y16 ";
  spec.frame_width = 64;
  spec.frame_height = 56;
  spec.active_rows = 48;
  spec.bits = 14;
  spec.fps = 240.0;
  spec.exposure_us = 2000.0;
  spec.read_us = 2500.0;
  spec.timestamp = TimestampMeaning::end_frame;
  spec.noise = {1.0, 3.0, 16000.0, 256.0};
  return spec;
}

}  // namespace haarlight::testing
