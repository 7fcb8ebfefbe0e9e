// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/files.h"
#include "core/image.h"

/// @file
/// The light stack: the light transport matrix T[pixel][light], linear radiance of every pixel
/// under each light at unit drive, exposure, gain and power. A cache inside the session, tiled
/// in bands of rows, with lights varying fastest.

namespace haarlight {

struct StackShape {
  int width = 0;
  int height = 0;
  int channels = 1;
  int n_lights = 0;
  int band_rows = 0;  ///< rows per band; the last band may have fewer
  [[nodiscard]] int n_bands() const { return (height + band_rows - 1) / band_rows; }
  friend bool operator==(const StackShape&, const StackShape&) = default;
};

/// A stack file mapped read-only. Thread-safe.
class LightStack {
 public:
  /// @throws Error  not a stack file, truncated, wrong version or checksum
  [[nodiscard]] static LightStack open(const std::filesystem::path& file);

  [[nodiscard]] const StackShape& shape() const noexcept { return shape_; }

  /// The band's values in C order (channels, rows, width, n_lights), float.
  [[nodiscard]] std::span<const float> band(int i_band) const;

  /// Reads everything once and compares with the bands' stored checksums; `open` checks only
  /// the header and the size, since a stack can be larger than memory.
  /// @throws Error  naming the first damaged band
  void check() const;

  /// One light's picture gathered from all bands, (height, width, channels). O(size of the
  /// stack): for many lights use for_each_light_image().
  [[nodiscard]] Image<float> light_image(int k) const;
  /// The pictures of lights [first, first + n) in one pass over the stack.
  [[nodiscard]] std::vector<Image<float>> light_images(int first, int n) const;

 private:
  LightStack(std::filesystem::path path, const StackShape& shape, MappedFile file);

  std::filesystem::path path_;
  StackShape shape_;
  MappedFile file_;
  std::uint64_t data_offset_ = 0;
};

/// Calls visit(k, picture) for every light in order. As many pictures as fit in `memory_bytes`
/// (at least one) are gathered in one pass over the stack.
void for_each_light_image(const LightStack& stack, std::uint64_t memory_bytes,
                          const std::function<void(int, const Image<float>&)>& visit);

/// Writes a stack band by band, in order; the file appears in `finish()`.
class LightStackWriter {
 public:
  LightStackWriter(const std::filesystem::path& file, const StackShape& shape);
  /// @param values  (channels, rows of this band, width, n_lights)
  /// @throws Error  on NaN or infinity (naming light and pixel), or when writing fails
  void append_band(std::span<const float> values);
  void finish();

 private:
  StackShape shape_;
  std::filesystem::path path_;
  PendingFile file_;
  std::string band_hashes_;
  int next_band_ = 0;
};

}  // namespace haarlight
