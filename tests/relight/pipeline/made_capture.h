// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <filesystem>
#include <functional>
#include <numbers>
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
/// Tiny captures by closed form, as pipelines read them: a folder of pictures with a list of
/// lights, or a session made of it.

namespace haarlight::testing {

/// `n` directions over the upper hemisphere, none lower than `lowest` (z), by the golden angle.
inline std::vector<Eigen::Vector3d> spiral_directions(int n, double lowest) {
  std::vector<Eigen::Vector3d> out;
  for (int k = 0; k < n; ++k) {
    const double z = lowest + (1.0 - lowest) * (k + 0.5) / n;
    const double phi = k * std::numbers::pi * (3.0 - std::sqrt(5.0));
    const double rho = std::sqrt(1.0 - z * z);
    out.emplace_back(rho * std::cos(phi), rho * std::sin(phi), z);
  }
  return out;
}

struct PictureSize {
  int width = 0;
  int height = 0;
};

/// What pixel (y, x) shows under a light at `position`, linear.
using PixelOfLight = std::function<double(const Eigen::Vector3d& position, int y, int x)>;

/// Writes light_00.png ... (or .exr: floats as they are) and lights.lp; grey pictures.
/// @param positions  directions, or positions in mm
inline void write_capture(const std::filesystem::path& folder,
                          const std::vector<Eigen::Vector3d>& positions, PictureSize size,
                          const std::string& ending, const PixelOfLight& value) {
  std::filesystem::create_directories(folder);
  std::vector<std::string> names;
  for (const Eigen::Vector3d& position : positions) {
    Image<float> picture(size.height, size.width, 1);
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        picture(y, x) = static_cast<float>(value(position, y, x));
      }
    }
    names.push_back(fmt::format("light_{:02}{}", names.size(), ending));
    write_image(folder / names.back(), picture.view());
  }
  write_file_atomically(folder / "lights.lp", session::format_lp(positions, names));
}

/// A session of such a folder of .exr: linear floats.
inline void write_session(const std::filesystem::path& folder,
                          const std::vector<Eigen::Vector3d>& positions,
                          session::LightCoordinates meant, PictureSize size,
                          const PixelOfLight& value) {
  const TemporaryFolder pictures;
  write_capture(pictures.path(), positions, size, ".exr", value);
  session::ImportOptions options;
  options.coordinates = meant;
  (void)session::import_pictures(pictures.path(), pictures / "lights.lp", folder, options);
}

}  // namespace haarlight::testing
