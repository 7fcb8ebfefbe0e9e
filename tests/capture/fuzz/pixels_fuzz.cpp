// SPDX-License-Identifier: Apache-2.0
/// @file
/// What a camera or its driver may put into a buffer: any bytes, in any layout. The first byte
/// chooses the layout, the next three the size and the padding.

#include <cstddef>
#include <cstdint>
#include <span>

#include "capture/camera/grey_jpeg.h"
#include "capture/camera/pixel_unpack.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using haarlight::PixelPacking;
  if (size < 4) {
    return 0;
  }
  constexpr unsigned kPackings = static_cast<unsigned>(PixelPacking::motion_jpeg) + 1;
  const auto packing = static_cast<PixelPacking>(data[0] % kPackings);
  const int width = 1 + data[1] % 64;
  const int height = 1 + data[2] % 64;
  const std::span<const std::byte> bytes =
      std::as_bytes(std::span<const std::uint8_t>(data + 4, size - 4));
  haarlight::Image<std::uint16_t> words(height, width, 1);
  if (packing == PixelPacking::motion_jpeg) {
    (void)haarlight::capture::decode_grey_jpeg(bytes, words.view());
    return 0;
  }
  const std::size_t stride = haarlight::capture::packed_row_bytes(packing, width) + data[3];
  if (bytes.size() >= haarlight::capture::packed_frame_bytes(packing, width, height, stride)) {
    (void)haarlight::capture::unpack_pixels(packing, bytes, stride, words.view());
  }
  return 0;
}
