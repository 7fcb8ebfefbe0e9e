// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

/// @file
/// What a camera wrote next to the pixels, and how haarlight carries it from the photographs to
/// what is made from them. Owners, locations and serial numbers are excluded.

namespace haarlight {

/// The smallest and largest plausible camera number; anything outside counts as unknown.
inline constexpr double kLeastCameraNumber = 1e-9;
inline constexpr double kMostCameraNumber = 1e9;

/// What the camera wrote (EXIF); empty where it did not. Numbers lie within these bounds.
struct PictureFacts {
  int orientation = 1;  ///< EXIF's 1..8; 1: as stored
  std::optional<double> exposure_s;
  std::optional<double> f_number;
  std::optional<double> iso;
  std::string model;  ///< printable ASCII, at most 64 characters
  std::string taken;  ///< "2026:11:22 20:30:21", the camera's clock
  friend bool operator==(const PictureFacts&, const PictureFacts&) = default;
};

/// A number from a file; nothing where it is implausible for a camera.
[[nodiscard]] std::optional<double> camera_number(double number) noexcept;

/// Whether anything but an orientation is known.
[[nodiscard]] bool has_facts(const PictureFacts& facts) noexcept;

/// What holds for a whole set: each fact on which all pictures agree, and the earliest `taken`.
/// No orientation: pixels are used as stored, and so is everything made from them.
[[nodiscard]] PictureFacts common_facts(std::span<const PictureFacts> pictures);

/// "NIKON D800, 1/125 s, f/8, ISO 100, 2026-11-22 20:30:21"; empty where nothing is known.
[[nodiscard]] std::string words_of(const PictureFacts& facts);

/// The facts as EXIF, from the byte order mark on, without an orientation; empty where nothing
/// is known. Source: CIPA DC-008 (EXIF 2.32), 4.6. A number that does not fit EXIF (ISO from
/// 65535 up, times beyond 2^32 s) is left out.
[[nodiscard]] std::vector<std::byte> exif_block(const PictureFacts& facts);

}  // namespace haarlight
