// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

/// @file
/// JPEG in memory, grey or R, G, B: the only user of libjpeg. Decoding trusts nothing: what
/// libjpeg only warns about, and then invents, is damage here.

namespace haarlight {

/// libjpeg's message about a picture that it cannot decode. The caller adds the file's name and
/// a hint.
class JpegDamage : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A picture being decoded, row by row. One thread. After JpegDamage only destruction.
class JpegDecoder {
 public:
  /// Reads the header. Borrows the bytes. @throws JpegDamage
  explicit JpegDecoder(std::span<const std::byte> source);
  ~JpegDecoder();
  JpegDecoder(JpegDecoder&&) noexcept;
  JpegDecoder& operator=(JpegDecoder&&) noexcept;
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;

  [[nodiscard]] int width() const;
  [[nodiscard]] int height() const;
  [[nodiscard]] int n_components() const;  ///< as stored: 1 grey, 3 colour, 4 CMYK
  /// Progressive, or components one after the other: all coefficients are held in memory, at 2
  /// bytes each.
  [[nodiscard]] bool has_multiple_scans() const;

  /// Before the first row. @param channels  1 (grey) or 3 (R, G, B) to decode to
  /// @throws JpegDamage  also beyond 100 scans: encoders write about 10, and each costs time
  ///                     for every pixel
  void start(int channels);
  [[nodiscard]] int next_row() const;
  /// @param row  (width, channels) samples
  void read(std::span<std::uint8_t> row);
  /// Skips rows without colour conversion.
  void skip(int n_rows);
  /// After the last row: reads what follows it. @throws JpegDamage
  void finish();
  /// Bytes of the source not yet consumed.
  [[nodiscard]] std::size_t n_bytes_left() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct JpegShape {
  int height = 0;
  int width = 0;
};

/// The picture's size from its header alone; nothing is decoded.
/// @param where  names the picture, for messages
/// @throws Error  not a JPEG picture, or larger than `source` can possibly hold
[[nodiscard]] JpegShape jpeg_shape(std::string_view source, const std::string& where);

/// Takes row after row, top first: width * channels samples.
using TakeRow = std::function<void(int y, std::span<const std::uint8_t> samples)>;

/// Decodes to 1 (grey) or 3 (R, G, B) channels.
/// @throws Error  as jpeg_shape; also any damage, such as an end too early
void decode_jpeg(std::string_view source, int channels, const std::string& where,
                 const TakeRow& take);

/// Fills one row: width * channels samples.
using GiveRow = std::function<void(int y, std::span<std::uint8_t> samples)>;

/// How to code a three-channel picture whose values are not perceptual colours: one
/// quantisation step for all frequencies, the least squared error that JPEG offers for its
/// bytes.
struct JpegSteps {
  bool is_ycc = false;               ///< code Y, Cb, Cr instead of R, G, B directly
  std::array<int, 3> step{1, 1, 1};  ///< of each of the three, 1 to 255
};

/// @throws Error  as below
[[nodiscard]] std::string encode_jpeg(JpegShape shape, const JpegSteps& steps,
                                      const std::string& where, const GiveRow& give);

/// Settings for viewing.
struct JpegQuality {
  int channels = 3;  ///< 1 (grey) or 3 (R, G, B, stored as YCbCr, colours at full size)
  int quality = 90;  ///< 1 to 100
  /// Huffman tables made for the picture: fewer bytes, for a second pass over it.
  bool has_own_tables = true;
};

/// @throws Error  beyond JPEG's 65500 pixels per side, or libjpeg refused
[[nodiscard]] std::string encode_jpeg(JpegShape shape, const JpegQuality& quality,
                                      const std::string& where, const GiveRow& give);

}  // namespace haarlight
