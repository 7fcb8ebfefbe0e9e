// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "relight/reflectance/formats/web_folder.h"

/// @file
/// A web folder of so many bytes, or of so good pictures: the quality that gives it is searched
/// for, each trial coded and decoded in full.

namespace haarlight {

/// The best quality whose files take no more than `most_bytes`, found to a 256th of the way.
/// @throws Error  naming the least bytes that quality 1 takes
[[nodiscard]] WebFiles code_to_bytes(const ReflectanceModel& model, std::uint64_t most_bytes,
                                     const std::string& where);

/// PSNR in dB of the pictures of a decoded model.
using MeasurePictures = std::function<double(const ReflectanceModel& decoded)>;

/// The lowest quality whose decoded pictures reach `psnr_db`, found to a 256th of the way.
/// @throws Error  naming what quality 100 reaches
[[nodiscard]] WebFiles code_to_psnr(const ReflectanceModel& model, double psnr_db,
                                    const MeasurePictures& measure, const std::string& where);

}  // namespace haarlight
