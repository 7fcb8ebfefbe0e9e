// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_rectangle.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/session.h"

/// @file
/// The pictures of a capture under all its lights, read in lockstep from top to bottom: memory
/// for a few rows of each, whatever the pictures' size. Values are what a viewer would show:
/// coded in `transfer`, 65535 = white.

namespace haarlight::relight {

class PictureRows {
 public:
  PictureRows() = default;
  virtual ~PictureRows() = default;
  PictureRows(const PictureRows&) = delete;
  PictureRows& operator=(const PictureRows&) = delete;

  [[nodiscard]] virtual StackDims dims() const = 0;
  [[nodiscard]] virtual Transfer transfer() const = 0;
  /// Back to the first row.
  virtual void rewind() = 0;
  /// Skips rows as cheaply as the files allow.
  virtual void skip(int n_rows) = 0;
  /// The next rows.
  /// @param out  (n_rows, n_lights, width, 3); grey pictures give three equal channels
  /// @throws Error  naming the picture that cannot be read
  virtual void read(int n_rows, std::span<std::uint16_t> out) = 0;
};

/// How a session's values are converted to a viewer's.
struct SessionRowsOptions {
  Transfer transfer = Transfer::srgb;
  /// Linear value that becomes white; 0: the 99.9th percentile over a sample of rows. Pictures
  /// that are already sRGB-coded 8- or 16-bit files are used as they are.
  double white = 0.0;
  session::DevelopOptions develop{};
};

/// A session's pictures. Borrows the session.
[[nodiscard]] std::unique_ptr<PictureRows> session_rows(const session::Session& session,
                                                        const SessionRowsOptions& options);

/// Baseline JPEGs, decoded line by line in parallel: no temporary files.
/// @throws Error  naming the file: not a JPEG, of another size, CMYK, or progressive (it would
///                have to be held whole: import it as a session)
[[nodiscard]] std::unique_ptr<PictureRows> jpeg_rows(
    std::vector<std::filesystem::path> pictures);

/// Whether jpeg_rows can read a JPEG line by line; true for a damaged one, which it refuses.
[[nodiscard]] bool is_line_jpeg(const std::filesystem::path& path);

/// Pictures in memory, for tests and small captures: (n_lights) of (height, width, 1 or 3),
/// 0..1 in `transfer`; values outside are clipped.
[[nodiscard]] std::unique_ptr<PictureRows> image_rows(std::vector<Image<float>> pictures,
                                                      Transfer transfer = Transfer::srgb);

/// Some lights of other rows only, in the order given. Borrows `all`.
[[nodiscard]] std::unique_ptr<PictureRows> selected_rows(PictureRows& all,
                                                         std::vector<int> lights);

/// A rectangle of other rows only, which it owns.
/// @param rectangle  within the pictures
[[nodiscard]] std::unique_ptr<PictureRows> cropped_rows(std::unique_ptr<PictureRows> whole,
                                                        const PixelRectangle& rectangle);

}  // namespace haarlight::relight
