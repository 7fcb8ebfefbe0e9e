// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/files.h"
#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"

/// @file
/// The light transport matrix on disk: one float plane per light, in order, so that a virtual
/// camera reads the planes it needs and nothing else. Little-endian:
///
///     0   "HLTRANS1"            8   u32 width, height, n_lights, 0     24  f64 scale
///     32  u64 rays  40  f64 seconds  48  32 characters: content hash of the planes
///     80  32 characters: the key of its inputs                         4096  the planes
///
/// Needs neither a ray caster nor TBB: the virtual camera links only this.

namespace haarlight::sim {

/// Radiance of every sensor pixel under each light at unit radiance. Move-only, thread-safe.
class Transport {
 public:
  /// Reads all planes once, for their hash (docs/reference/simulator.md has the time).
  /// @throws Error  not such a file, truncated, or its planes don't have their hash
  [[nodiscard]] static Transport open(const std::filesystem::path& file,
                                      ProgressStyle progress = ProgressStyle::none);

  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }
  [[nodiscard]] int n_lights() const noexcept { return n_lights_; }
  /// What a lit pixel of the plane shows under one light: the median over pixels of the mean
  /// over lights (of the pixels that see anything, when most see nothing). Divide by it.
  [[nodiscard]] double scale() const noexcept { return scale_; }
  [[nodiscard]] const std::string& key() const noexcept { return key_; }
  /// Of the run that computed it.
  [[nodiscard]] std::uint64_t n_rays() const noexcept { return n_rays_; }
  [[nodiscard]] double seconds() const noexcept { return seconds_; }

  /// Plane of light k, (height, width, 1), not divided by scale().
  [[nodiscard]] ImageView<const float> plane(int k) const;

 private:
  friend class TransportWriter;
  /// Everything but the hash.
  [[nodiscard]] static Transport map(const std::filesystem::path& file);
  [[nodiscard]] std::string hash_planes(ProgressStyle style) const;

  int width_ = 0;
  int height_ = 0;
  int n_lights_ = 0;
  double scale_ = 1.0;
  std::uint64_t n_rays_ = 0;
  double seconds_ = 0.0;
  std::string key_;
  MappedFile file_;
};

/// The parts of a file to write.
struct TransportData {
  int width = 0;
  int height = 0;
  int n_lights = 0;
  std::uint64_t n_rays = 0;
  double seconds = 0.0;
  std::string key;                ///< 32 characters
  std::span<const float> planes;  ///< (n_lights, height, width)
};

/// Writes a file in strips of rows, whose heights leave no trace in it. Memory: 8 bytes for each
/// pixel, for the scale. The file appears in finish(), whole, or not at all. Move-only.
class TransportWriter {
 public:
  /// Takes the room on the disk.
  /// @param data  without planes, rays and seconds
  /// @throws Error(io)
  TransportWriter(std::filesystem::path file, const TransportData& data);

  /// The next rows of every plane. @param strip  (n_lights, rows, width) @throws Error(io)
  void append_rows(std::span<const float> strip);
  /// After the last row. Reads the planes once more, for their hash. @throws Error(io)
  [[nodiscard]] Transport finish(std::uint64_t n_rays, double seconds,
                                 ProgressStyle progress = ProgressStyle::none);

 private:
  std::filesystem::path path_;
  TransportData data_;
  PendingFile file_;
  std::size_t n_rows_ = 0;
  std::vector<double> sums_;  ///< over the lights, by pixel
};

/// Computes the scale and writes the file whole. @throws Error(io)
void write_transport(const std::filesystem::path& file, const TransportData& data);

}  // namespace haarlight::sim
