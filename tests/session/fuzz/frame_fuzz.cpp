// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a frame's TIFF: an Error, or rows of the size that the header says.

#include <cstdint>
#include <span>

#include "haarlight/core/error.h"
#include "session/frame_tiff.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span<const std::byte> file = std::as_bytes(std::span(data, size));
  try {
    const haarlight::session::FrameTiffHeader header =
        haarlight::session::read_frame_tiff_header(file, "frame.tif");
    const std::vector<std::byte> rows =
        haarlight::session::read_frame_tiff_rows(file, header, 0, header.height, "frame.tif");
    HAARLIGHT_EXPECTS(rows.size() <= size, "no more pixels than the file has bytes");
    (void)haarlight::session::frame_description_from_json(header.description, "frame.tif");
  } catch (const haarlight::Error&) {
  }
  return 0;
}
