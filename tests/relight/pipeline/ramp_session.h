// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <fmt/format.h>

#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/import/import.h"
#include "haarlight/session/light_file.h"
#include "tests/temporary_folder.h"

/// @file
/// An imported session of rank one: light k makes (k + 1) times the same ramp.

namespace haarlight::testing {

struct RampSession {
  int width = 8;
  int height = 6;
  int n_lights = 5;

  /// Linear, as in the file.
  [[nodiscard]] static double value(int y, int x, int light) {
    return 0.01 * (1.0 + x + 2.0 * y) * (light + 1);
  }

  /// Lights on a circle, 45 degrees up: no grid of rows and columns.
  void write(const std::filesystem::path& session) const {
    const TemporaryFolder pictures;
    std::vector<Eigen::Vector3d> directions;
    std::vector<std::string> names;
    for (int k = 0; k < n_lights; ++k) {
      const double turn = 1.2 * k;
      directions.emplace_back(std::cos(turn) / std::sqrt(2.0), std::sin(turn) / std::sqrt(2.0),
                              1.0 / std::sqrt(2.0));
      names.push_back(fmt::format("light{}.exr", k));
      Image<float> picture(height, width, 1);
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          picture(y, x) = static_cast<float>(value(y, x, k));
        }
      }
      write_image(pictures / names.back(), picture.view());
    }
    write_file_atomically(pictures / "lights.lp", session::format_lp(directions, names));
    (void)session::import_pictures(pictures.path(), pictures / "lights.lp", session);
  }
};

}  // namespace haarlight::testing
