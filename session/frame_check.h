// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include "haarlight/session/session.h"
#include "session/frame_tiff.h"

/// @file
/// Inspects one frame's file and decides whether it can be trusted: used by recovery before a
/// frame is adopted, and by verify.

namespace haarlight::session {

struct FrameInspection {
  FrameDescription description;
  std::string file_hash;  ///< content_hash of the file's bytes
  std::string sha256;     ///< leaf_hash of the file, named frames/NAME
  std::string problem;    ///< empty: the frame is valid; otherwise why not, in words
  [[nodiscard]] bool is_good() const { return problem.empty(); }
};

/// Reads the file once and checks: a regular file, no link; form, session and plan; its stated
/// light against the plan; hash of the active pixels, range and mean of the pixels against the
/// evidence, and the clean rule. Never throws for what the file contains.
[[nodiscard]] FrameInspection inspect_frame(const std::filesystem::path& file,
                                            const SessionInfo& info);

/// Least, greatest and mean sample of rows' bytes as the evidence stores them, and the
/// fractions of samples at or above the white and at or below the black level.
struct PixelStatistics {
  double min = 0.0;
  double max = 0.0;
  double mean = 0.0;
  double saturated_fraction = 0.0;
  double black_fraction = 0.0;
};
[[nodiscard]] PixelStatistics measure_pixels(ImageView<const std::uint16_t> pixels,
                                             double black_level, double white_level);
[[nodiscard]] PixelStatistics measure_pixels(ImageView<const std::uint8_t> pixels,
                                             double black_level, double white_level);
[[nodiscard]] PixelStatistics measure_pixels(ImageView<const float> pixels, double black_level,
                                             double white_level);

/// Stores the statistics and the hash of the active pixels in the evidence. min_dn and max_dn
/// are clamped to 0 .. 65535 (floating-point pictures keep only the mean).
template <class T>
void describe_pixels(ImageView<const T> active, const FrameForm& form, FrameEvidence& evidence);

}  // namespace haarlight::session
