// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/shape/corrected_light.h"

/// @file
/// A capture's pictures without their near lights' fall-off. What `haarlight correct` does, for
/// programs that link it. Source: corrected_light.h.

namespace haarlight::relight {

struct CorrectOptions {
  std::filesystem::path session;  ///< with lights of known positions
  std::filesystem::path out;      ///< folder to write
  FallOff fall_off = FallOff::plane;
  std::optional<Transfer> transfer{};  ///< used for an unknown curve
  double width_mm = 0.0;               ///< of an import: width shown by the picture; 0: unknown
  std::optional<double> height_mm{};   ///< mean height of the object above the rig's plane
  PipelineSettings settings{};
};

struct CorrectSummary {
  int n_lights = 0;
  /// Least light of any pixel under any light, relative to the picture's middle; 1 if none is
  /// weaker.
  double least_fall_off = 1.0;
  std::uint64_t bytes = 0;  ///< of the pictures written
};

/// Writes light_0000.exr ... (linear), fall-off/light_0000.exr ... (each light's attenuation, 1
/// in the middle) and lights.lp with directions, since the lights are far once corrected.
/// @throws Error  a folder that exists, lights known by direction only, an import without a
///                width; as what opens and develops sessions
[[nodiscard]] CorrectSummary correct_fall_off(const CorrectOptions& options);

}  // namespace haarlight::relight
