// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/progress.h"

/// @file
/// How raw frames become a light stack: the choices that develop.h's functions take.

namespace haarlight::session {

/// Conversion of a Bayer mosaic to three channels.
enum class Demosaic {
  bilinear,    ///< mean of the nearest samples of a colour: exact where the picture is linear
  edge_aware,  ///< green along the smaller gradient, then colour differences [Hamilton97]
  none,        ///< leave the mosaic as one channel
};
inline constexpr auto kDemosaicWords =
    std::to_array<std::string_view>({"bilinear", "edge-aware", "none"});
constexpr std::span<const std::string_view> words_of(Demosaic) { return kDemosaicWords; }

/// Which part of the flat frames is sensitivity.
enum class FlatKind {
  whole,  ///< all of it: the target was lit evenly (integrating sphere, opal glass, sky)
  /// What a polynomial of degree 4 in x and y does not explain: pixels, dust, fixed pattern.
  /// For a white sheet lit by the rig itself; the lens's vignetting stays in the pictures.
  fine,
};
inline constexpr auto kFlatKindWords = std::to_array<std::string_view>({"whole", "fine"});
constexpr std::span<const std::string_view> words_of(FlatKind) { return kFlatKindWords; }

/// What develop does with bad pixels.
enum class BadPixels {
  inpaint,  ///< the median of the good neighbours in 3 x 3 (mosaic, or none good: 5 x 5)
  keep,     ///< as measured; still counted
};
inline constexpr auto kBadPixelsWords = std::to_array<std::string_view>({"inpaint", "keep"});
constexpr std::span<const std::string_view> words_of(BadPixels) { return kBadPixelsWords; }

/// The steps that can be disabled, and how the others work.
struct RadiometryOptions {
  bool has_dark = true;   ///< subtract the dark frames' picture
  bool has_flat = true;   ///< divide by the flat field
  bool has_drift = true;  ///< divide by the sentinel's brightness
  FlatKind flat = FlatKind::whole;
  /// A session of flat frames (or of an evenly lit target under every light) instead of this
  /// session's own; empty: its own.
  std::filesystem::path flat_session{};
  BadPixels bad_pixels = BadPixels::inpaint;
  double max_drift = 0.25;  ///< refused beyond
  /// Relative deviation between two exposures' levels beyond which the merge is refused.
  double max_level_error = 0.1;
  [[nodiscard]] std::string key() const;
};

/// The clean plate, pixel by pixel: how the light of a shot is distributed among its LEDs.
struct PlatePixels {
  /// Writes (x1 - x0, n_lights) of row y, not negative. Called from several threads.
  std::function<void(int y, int x0, int x1, std::span<float> out)> read;
  std::string key;  ///< identifies its inputs: part of the light stack's key
  [[nodiscard]] bool is_empty() const { return !read; }
};

struct DevelopOptions {
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  Demosaic demosaic = Demosaic::bilinear;
  bool keep_bayer = false;  ///< the same as Demosaic::none
  /// The curve assumed instead of an unknown one (Transfer::unknown); empty: refused.
  std::optional<Transfer> unknown_as{};
  bool use_cache = true;  ///< false: recompute even if the cached one matches
  /// Empty: SESSION/cache. Give a folder for a read-only archive.
  std::filesystem::path cache_folder{};
  ProgressStyle progress = ProgressStyle::none;
  /// For bins, target and partial haar captures: clean plate by which a shot's light is
  /// distributed. Empty: an error for these, unless distribute_evenly.
  PlatePixels plate{};
  bool distribute_evenly = false;
  RadiometryOptions radiometry{};
  /// Make a second stack of the values' standard errors; -1 where every exposure (of a shot
  /// that the light needs) is clipped. Noise only: does not include what a clean plate
  /// distributes wrongly.
  bool has_standard_error = false;
  /// For Developer::rows(): mark the values that are lower bounds.
  bool marks_clipped = false;
};

}  // namespace haarlight::session
