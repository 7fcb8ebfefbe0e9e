// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "core/report.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/reflectance/formats/refit.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// Converts relightable pictures between formats, refitted where the target uses another basis,
/// and measured from the written file; or renders one picture of them under a light; or
/// converts lists of lights. The output's name decides.

namespace haarlight::relight {

struct ConvertOptions {
  std::string input;   ///< .ptm, .rti, folder with Relight's info.json; .lp, .dome
  std::string output;  ///< .ptm, .rti, no extension for a web folder; .lp, .dome; a picture
  Transfer transfer = Transfer::srgb;  ///< transfer of IN's colours
  HshOrder4 order4 = HshOrder4::exact;
  std::optional<ReflectanceBasis> basis;  ///< for a web folder; nothing: as IN
  std::optional<int> terms;               ///< for hsh: 4, 9 or 16; nothing: as IN, else 9
  /// Write one picture, lit from here: x right, y up, z to the camera; any length but 0.
  std::optional<Eigen::Vector3d> light;
  bool is_jpeg = false;           ///< the .ptm with JPEG pictures
  std::optional<double> quality;  ///< of JPEG pictures, 1 to 100
  PipelineSettings settings;
};

/// What was written.
enum class ConvertedKind { model, picture, lights };

struct ConvertSummary {
  ConvertedKind kind = ConvertedKind::model;
  std::size_t n_lights = 0;                        ///< lights
  ReflectanceBasis basis = ReflectanceBasis::ptm;  ///< model: as written
  int n_terms = 0;
  bool is_refitted = false;
  PictureDifference difference;  ///< model: between IN's and OUT's pictures under 25 lights
  std::uint64_t bytes = 0;
  std::vector<PipelineNote> notes;  ///< all messages
};

/// @throws Error(usage)  options that the format cannot hold
/// @throws Error  an input that cannot be read, an output that exists
[[nodiscard]] ConvertSummary convert_reflectance(const ConvertOptions& options);

/// What was requested and achieved.
void add_to_report(const ConvertOptions& options, const ConvertSummary& summary,
                   Report& report);

}  // namespace haarlight::relight
