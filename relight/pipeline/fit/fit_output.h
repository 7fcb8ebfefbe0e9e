// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "relight/reflectance/formats/reflectance_file.h"
#include "relight/reflectance/formats/web_target.h"

/// @file
/// What a fit writes: a file of a size or of a fidelity, and what it is worth when it is read
/// again.

namespace haarlight {

/// What a folder's pictures shall be; at most one of the three.
struct FitSize {
  std::optional<double> quality{};       ///< 1..100
  std::optional<std::uint64_t> bytes{};  ///< the most: the best quality that they hold
  std::optional<double> psnr_db{};       ///< the least, read again: the fewest bytes
};

/// @throws Error(usage)  two of the three; any of them where no folder is written
void require_one_size(const FitSize& size, std::optional<ReflectanceFormat> format);

/// A file as it stands on the disk.
struct FitFile {
  std::string name;  ///< "folder", ".ptm", ".rti"
  std::uint64_t bytes = 0;
  double psnr_db = 0.0;           ///< of its pictures, by the measure
  std::optional<double> quality;  ///< of a folder
};

/// Writes the model and reads it again.
/// @param model         its planes are let go once they are written, unless keeps_planes
/// @param measure       what its pictures are worth; also what FitSize::psnr_db is
/// @throws Error  the size cannot be reached; nothing is written then
[[nodiscard]] FitFile write_fit(const std::filesystem::path& path, ReflectanceModel& model,
                                const FitSize& size, const MeasurePictures& measure,
                                bool keeps_planes);

/// The same into a folder for temporary files, which is removed again: as a web folder, or as
/// .rti where no folder holds the model. Nothing: no file holds it.
[[nodiscard]] std::optional<FitFile> try_fit_file(ReflectanceModel& model,
                                                  const MeasurePictures& measure,
                                                  bool keeps_planes);

}  // namespace haarlight
