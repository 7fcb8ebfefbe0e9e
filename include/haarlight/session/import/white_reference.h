// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/session/session.h"

/// @file
/// White balance from a neutral patch in the pictures (a white or grey card): one gain per
/// channel that makes it neutral. Pure. Notes: docs/reference/import.md.

namespace haarlight::session {

/// The patch under one light.
struct PatchSample {
  std::vector<double> mean;  ///< (channels), linear, dark subtracted, as fractions of the range
  bool is_clipped = false;   ///< at least one of its samples is
};

/// @param patch      its pixels, linear
/// @param clip_from  a value at or above is clipped
[[nodiscard]] PatchSample sample_patch(const Image<float>& patch, double clip_from);

struct WhiteReference {
  /// (channels), factors for linear values. Without a reflectance the least is 1: a neutral
  /// object keeps its brightest channel, and what is clipped stays white.
  std::vector<double> gains;
  /// (channels), relative: 1.4826 times the median distance of single lights' gains from the
  /// median; 0 for green, the reference channel.
  std::vector<double> scatter;
  /// The same of the patch's reflectance under single lights; nothing without one.
  std::optional<double> reflectance_scatter;
  int n_used = 0;
  int n_clipped = 0;
  int n_dark = 0;
  int furthest = -1;      ///< the light whose colour deviates most
  double distance = 0.0;  ///< relative, of its worst channel
};

/// How the patches are evaluated.
struct WhiteTask {
  std::optional<double> reflectance;  ///< of the patch, 0 .. 1
  bool are_integers = true;           ///< values end at 1
  std::string where;                  ///< for errors
};

/// The gains of all pictures: for each channel the median over the lights under which no sample
/// of the patch is clipped and its darkest channel is lit: above kLeastPatchFraction of the range,
/// or, for floating-point values, which have none, of the brightest such patch. With a
/// reflectance they also scale the patch, which lies in the picture's plane, to reflectance *
/// cos(angle of the light to the view), in the median over the lights above 3 degrees: a white
/// that faces the light is then 1.
/// @param patches  (n_lights)
/// @throws Error  no light under which the patch is usable; one channel and no reflectance
[[nodiscard]] WhiteReference find_white_reference(const std::vector<PatchSample>& patches,
                                                  const std::vector<SessionLight>& lights,
                                                  const WhiteTask& task);

/// Below this 8-bit sRGB is too coarse (a step is 4.5 % of the value), and a patch in shadow is
/// lit by other light.
inline constexpr double kLeastPatchFraction = 0.02;

/// "R 1.000, G 1.220 ... under 14 of 16 lights", for display.
[[nodiscard]] std::string words(const WhiteReference& white, std::size_t n_lights);

}  // namespace haarlight::session
