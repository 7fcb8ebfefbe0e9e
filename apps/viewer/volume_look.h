// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/json_value.h"
#include "render/scene/camera_table.h"
#include "render/volume/volume_scene.h"

/// @file
/// What the viewer's page changes of a volume's scene, and the scene file with it. Lengths in mm.

namespace haarlight::apps {

/// A camera by what it looks at, and the transfer functions' rows.
struct VolumeLook {
  std::array<int, 2> size{};  ///< width, height, pixels
  std::array<double, 3> eye{};
  std::array<double, 3> target{};
  std::array<double, 3> up{};
  bool is_orthographic = false;
  double opening =
      0.0;  ///< vertical angle in degrees; of an orthographic camera the width in mm
  std::vector<std::array<double, 2>> density;  ///< field, extinction per mm; the field ascends
  std::vector<std::array<double, 4>> colour;   ///< field, red, green, blue

  friend bool operator==(const VolumeLook&, const VolumeLook&) = default;
};

/// Rows of a function that a page may send.
inline constexpr std::size_t kMostRows = 4096;

/// What a scene file says that the scene which was read of it no longer knows.
struct VolumeSceneWords {
  struct Field {
    std::string name;
    std::string on;  ///< empty: not said
    std::optional<std::int64_t> component;
  };
  std::string name;
  std::string format;  ///< of the mesh; empty: not said
  Field density;
  Field colour;   ///< that of the density where nothing is said
  Field contour;  ///< of the contours, where there are some
  VolumeLook look;
};

/// @throws Error  as ConfigTable; a camera by K that no eye, target and angle describe
[[nodiscard]] VolumeSceneWords read_scene_words(const std::filesystem::path& path,
                                                const render::VolumeScene& scene);

/// A look as JSON: size, camera (eye, target, up, and fov_y_deg or width_mm), density, colour.
/// @throws Error  naming the member and what to do: missing, of another type, out of its range
[[nodiscard]] VolumeLook read_look(const JsonValue& json);

/// The look's camera at a size. @param optics  with the scene's clipping planes
/// @throws Error  it looks along its own up direction
[[nodiscard]] render::CameraTable camera_of(const VolumeLook& look,
                                            const std::array<int, 2>& size,
                                            const render::CameraOptics& optics);

/// Puts the functions into the scene.
void set_functions(const VolumeLook& look, render::VolumeScene& scene);

/// A scene file that `haarlight render volume` makes the look's picture of, wherever it lies: its
/// files are named from the root. All numbers are written so that they are read as they were.
[[nodiscard]] std::string scene_text(const VolumeSceneWords& words,
                                     const render::VolumeScene& scene, const VolumeLook& look);

}  // namespace haarlight::apps
