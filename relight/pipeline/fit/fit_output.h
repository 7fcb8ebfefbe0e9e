// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "relight/reflectance/formats/web_target.h"

/// @file
/// The output of a fit: a file of given size or fidelity, and its quality when read back.

namespace haarlight::relight {

/// The target of a folder's pictures; at most one of the three.
struct FitSize {
  std::optional<double> quality{};       ///< 1..100
  std::optional<std::uint64_t> bytes{};  ///< maximum: the best quality within it
  std::optional<double> psnr_db{};       ///< minimum, read back: the fewest bytes
};

/// @throws Error(usage)  two of the three; any of them if no folder is written
void require_one_size(const FitSize& size, std::optional<ReflectanceFormat> format);

/// A file as written to disk.
struct FitFile {
  std::string name;  ///< "folder", ".ptm", ".rti"
  std::uint64_t bytes = 0;
  double psnr_db = 0.0;           ///< of its pictures, by the measure
  std::optional<double> quality;  ///< of a folder
};

/// Writes the model and reads it back.
/// @param model         its planes are freed once written, unless keeps_planes
/// @param measure       quality of its pictures; also defines FitSize::psnr_db
/// @throws Error  the size cannot be achieved; nothing is written then
[[nodiscard]] FitFile write_fit(const std::filesystem::path& path, ReflectanceModel& model,
                                const FitSize& size, const MeasurePictures& measure,
                                bool keeps_planes);

/// The same into a folder for temporary files, which is removed again: as a web folder, or as
/// .rti if no folder can hold the model. Nothing: no file can.
[[nodiscard]] std::optional<FitFile> try_fit_file(ReflectanceModel& model,
                                                  const MeasurePictures& measure,
                                                  bool keeps_planes);

}  // namespace haarlight::relight
