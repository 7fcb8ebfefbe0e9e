// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "haarlight/relight/reflectance/formats/web_folder.h"

/// @file
/// A web folder of a given size or picture quality: finds the quality setting that yields it,
/// each trial coded and decoded in full.

namespace haarlight::relight {

/// The best quality whose files take no more than `most_bytes`, found to 1/256 of the range.
/// @throws Error  naming the size at quality 1
[[nodiscard]] WebFiles code_to_bytes(const ReflectanceModel& model, std::uint64_t most_bytes,
                                     const std::string& where);

/// PSNR in dB of the pictures of a decoded model.
using MeasurePictures = std::function<double(const ReflectanceModel& decoded)>;

/// The lowest quality whose decoded pictures achieve `psnr_db`, found to 1/256 of the range.
/// @throws Error  naming the PSNR at quality 100
[[nodiscard]] WebFiles code_to_psnr(const ReflectanceModel& model, double psnr_db,
                                    const MeasurePictures& measure, const std::string& where);

}  // namespace haarlight::relight
