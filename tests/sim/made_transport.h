#pragma once

#include <vector>

#include "sim/transport_file.h"
#include "tests/temporary_folder.h"

/// @file
/// Transport matrices made by hand for tests of the camera.

namespace haarlight::testing {

/// Each light k shows `values[k]` in every pixel.
inline Transport flat_transport(const TemporaryFolder& folder, int width, int height,
                                const std::vector<float>& values) {
  TransportData data;
  data.width = width;
  data.height = height;
  data.n_lights = static_cast<int>(values.size());
  data.key = std::string(32, 'a');
  data.seconds = 1.0;
  std::vector<float> planes;
  for (const float value : values) {
    planes.insert(planes.end(),
                  static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value);
  }
  data.planes = planes;
  write_transport(folder / "transport.bin", data);
  return Transport::open(folder / "transport.bin");
}

/// A camera of 64 x 56, 48 rows active, without noise unless asked.
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
