// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/files.h"
#include "haarlight/core/image.h"
#include "haarlight/core/stack/stack_source.h"

/// @file
/// The light stack: the light transport matrix T[pixel][light], linear radiance of every pixel
/// under each light at unit drive, exposure, gain and power. A cache inside the session, tiled
/// in bands of rows, with lights varying fastest.

namespace haarlight {

/// The bands that a picture's rows are stored in.
struct StackBands {
  int height = 0;  ///< of the picture
  int rows = 1;    ///< of each band; the last may have fewer
  [[nodiscard]] int n() const { return (height + rows - 1) / rows; }
  [[nodiscard]] int first_row(int i_band) const { return i_band * rows; }
  [[nodiscard]] int end_row(int i_band) const { return std::min((i_band + 1) * rows, height); }
  [[nodiscard]] int n_rows(int i_band) const { return end_row(i_band) - first_row(i_band); }
};

/// A stack file mapped read-only. Thread-safe.
class LightStack final : public StackSource {
 public:
  /// @throws Error  not a stack file, truncated, wrong version or checksum
  [[nodiscard]] static LightStack open(const std::filesystem::path& file);

  [[nodiscard]] StackDims dims() const override { return dims_; }
  void read_tile(const TileRect& rect, std::span<float> out) const override;

  [[nodiscard]] const StackBands& bands() const noexcept { return bands_; }
  /// The band's values in C order (channels, rows, width, n_lights), float.
  [[nodiscard]] std::span<const float> band(int i_band) const;

  /// Reads everything once and compares with the bands' stored checksums; `open` checks only
  /// the header and the size, since a stack can be larger than memory.
  /// @throws Error  naming the first damaged band
  void check() const;

  /// The pictures of lights [first, first + n), (height, width, channels), in one pass over the
  /// stack. For many lights use for_each_light_image().
  [[nodiscard]] std::vector<Image<float>> light_images(int first, int n) const;

 private:
  LightStack(std::filesystem::path path, const StackDims& dims, int band_rows, MappedFile file);

  std::filesystem::path path_;
  StackDims dims_;
  StackBands bands_;
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
  /// @param band_rows  1..dims.height
  LightStackWriter(const std::filesystem::path& file, const StackDims& dims, int band_rows);
  /// @param values  (channels, rows of this band, width, n_lights)
  /// @throws Error  on NaN or infinity (naming light and pixel), or when writing fails
  void append_band(std::span<const float> values);
  void finish();

 private:
  StackDims dims_;
  StackBands bands_;
  std::filesystem::path path_;
  PendingFile file_;
  std::string band_hashes_;
  int next_band_ = 0;
};

}  // namespace haarlight
