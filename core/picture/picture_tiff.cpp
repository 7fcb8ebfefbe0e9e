// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <bit>
#include <cstdio>
#include <cstring>
#include <memory>
#include <vector>

#include <fmt/format.h>
#include <tiffio.h>

#include "core/picture/picture_colour.h"
#include "core/picture/picture_formats.h"

namespace haarlight {

static_assert(std::endian::native == std::endian::little, "libtiff gives native samples");

namespace {

/// The file in memory that libtiff reads or writes, and its first error message.
struct Memory {
  std::span<const std::byte> input;
  std::vector<std::byte>* output = nullptr;
  std::uint64_t position = 0;
  std::string complaint;

  [[nodiscard]] std::span<const std::byte> bytes() const {
    return output != nullptr ? std::span<const std::byte>(*output) : input;
  }
};

Memory& memory_of(thandle_t handle) { return *static_cast<Memory*>(handle); }

tmsize_t read_memory(thandle_t handle, void* buffer, tmsize_t size) {
  Memory& memory = memory_of(handle);
  const std::span<const std::byte> bytes = memory.bytes();
  if (size <= 0 || memory.position >= bytes.size()) {
    return 0;
  }
  const std::size_t n = std::min(static_cast<std::size_t>(size),
                                 bytes.size() - static_cast<std::size_t>(memory.position));
  std::memcpy(buffer, bytes.data() + memory.position, n);
  memory.position += n;
  return static_cast<tmsize_t>(n);
}

tmsize_t write_memory(thandle_t handle, void* buffer, tmsize_t size) {
  Memory& memory = memory_of(handle);
  if (memory.output == nullptr || size < 0) {
    return 0;
  }
  const std::uint64_t end = memory.position + static_cast<std::uint64_t>(size);
  if (memory.output->size() < end) {
    memory.output->resize(end);
  }
  std::memcpy(memory.output->data() + memory.position, buffer, static_cast<std::size_t>(size));
  memory.position = end;
  return size;
}

toff_t size_memory(thandle_t handle) { return memory_of(handle).bytes().size(); }

toff_t seek_memory(thandle_t handle, toff_t offset, int whence) {
  Memory& memory = memory_of(handle);
  const std::uint64_t base = whence == SEEK_CUR   ? memory.position
                             : whence == SEEK_END ? size_memory(handle)
                                                  : 0;
  memory.position = base + offset;
  return memory.position;
}

int close_memory(thandle_t /*handle*/) { return 0; }

int keep_complaint(TIFF* /*tiff*/, void* user, const char* /*module*/, const char* format,
                   va_list arguments) {
  auto& memory = *static_cast<Memory*>(user);
  if (memory.complaint.empty()) {
    char text[256] = {};
    std::vsnprintf(text, sizeof text, format, arguments);
    memory.complaint = text;
  }
  return 1;
}

int ignore_warning(TIFF* /*tiff*/, void* /*user*/, const char* /*module*/,
                   const char* /*format*/, va_list /*arguments*/) {
  return 1;
}

struct CloseTiff {
  void operator()(TIFF* tiff) const noexcept { TIFFClose(tiff); }
};
using TiffHandle = std::unique_ptr<TIFF, CloseTiff>;

TiffHandle open_memory(Memory& memory, const char* mode) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  TIFFOpenOptionsSetErrorHandlerExtR(options, keep_complaint, &memory);
  TIFFOpenOptionsSetWarningHandlerExtR(options, ignore_warning, &memory);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options, static_cast<tmsize_t>(picture_memory()));
  TiffHandle tiff(TIFFClientOpenExt("picture", mode, &memory, read_memory, write_memory,
                                    seek_memory, close_memory, size_memory, nullptr, nullptr,
                                    options));
  TIFFOpenOptionsFree(options);
  return tiff;
}

/// What the first directory says.
struct TiffForm {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint16_t samples = 1;
  std::uint16_t bits = 1;
  std::uint16_t format = SAMPLEFORMAT_UINT;
  std::uint16_t photometric = PHOTOMETRIC_MINISBLACK;
  std::uint16_t planar = PLANARCONFIG_CONTIG;
  std::uint16_t compression = COMPRESSION_NONE;
  std::uint16_t orientation = ORIENTATION_TOPLEFT;
  const std::uint16_t* map[3] = {};  ///< palette's red, green, blue; 2^bits entries each

  [[nodiscard]] bool is_palette() const { return photometric == PHOTOMETRIC_PALETTE; }
  [[nodiscard]] bool is_floating() const { return format == SAMPLEFORMAT_IEEEFP; }
  [[nodiscard]] std::uint16_t channels() const {
    return photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_MINISWHITE ? 1
                                                                                          : 3;
  }
  /// Samples of a pixel that are stored together.
  [[nodiscard]] std::uint16_t packed_samples() const {
    return planar == PLANARCONFIG_SEPARATE ? std::uint16_t{1} : samples;
  }
};

TiffForm form_of(const PictureSource& source, TIFF* tiff) {
  TiffForm form;
  TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &form.width);
  TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &form.height);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &form.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &form.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &form.format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &form.planar);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_COMPRESSION, &form.compression);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_ORIENTATION, &form.orientation);
  if (TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &form.photometric) != 1 && form.samples >= 3) {
    form.photometric = PHOTOMETRIC_RGB;
  }
  if (form.format == SAMPLEFORMAT_VOID) {
    form.format = SAMPLEFORMAT_UINT;
  }
  if (form.photometric == PHOTOMETRIC_YCBCR && form.compression == COMPRESSION_JPEG &&
      form.planar == PLANARCONFIG_CONTIG) {
    TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    form.photometric = PHOTOMETRIC_RGB;
  }
  std::uint32_t depth = 1;
  TIFFGetFieldDefaulted(tiff, TIFFTAG_IMAGEDEPTH, &depth);
  if (depth != 1) {
    refuse_picture(source, fmt::format("{} layers", depth), "a picture must have one layer");
  }
  return form;
}

void require_readable(const PictureSource& source, TIFF* tiff, TiffForm& form) {
  constexpr const char* kHint = "convert it to a grey or an RGB picture (sRGB)";
  if (form.photometric != PHOTOMETRIC_MINISBLACK &&
      form.photometric != PHOTOMETRIC_MINISWHITE && form.photometric != PHOTOMETRIC_RGB &&
      !form.is_palette()) {
    refuse_picture(source,
                   form.photometric == PHOTOMETRIC_SEPARATED
                       ? "its colours are inks (CMYK)"
                       : fmt::format("its colours are of a kind that is not read "
                                     "(PhotometricInterpretation {})",
                                     form.photometric),
                   kHint);
  }
  if (form.samples > 64 || (form.channels() == 3 && !form.is_palette() && form.samples < 3)) {
    refuse_picture(source, fmt::format("{} channels", form.samples), kHint);
  }
  const bool is_integer = form.format == SAMPLEFORMAT_UINT || form.format == SAMPLEFORMAT_INT;
  const bool is_good =
      form.is_floating() ? form.bits == 16 || form.bits == 32 || form.bits == 64
      : form.format == SAMPLEFORMAT_INT
          ? form.bits == 8 || form.bits == 16 || form.bits == 32
          : is_integer && ((form.bits >= 1 && form.bits <= 16) || form.bits == 32);
  if (!is_good || (form.is_palette() && (form.format != SAMPLEFORMAT_UINT || form.bits > 16))) {
    refuse_picture(source,
                   fmt::format("samples of {} bits, SampleFormat {}", form.bits, form.format),
                   "save it with 8 or 16 bits, or as 32-bit floats");
  }
  std::uint16_t* map[3] = {};
  if (form.is_palette()) {
    if (TIFFGetField(tiff, TIFFTAG_COLORMAP, &map[0], &map[1], &map[2]) != 1) {
      refuse_damaged(source, "it has no palette");
    }
    std::copy_n(map, 3, form.map);
  }
}

/// IEEE 754's 16-bit float.
float float_of_half(std::uint16_t half) {
  const std::uint32_t sign = std::uint32_t{half & 0x8000U} << 16U;
  const std::uint32_t exponent = half >> 10U & 31U;
  const std::uint32_t mantissa = half & 0x3ffU;
  if (exponent == 0) {
    const float value = static_cast<float>(mantissa) * 0x1p-24F;
    return sign != 0 ? -value : value;
  }
  const std::uint32_t raised = exponent == 31 ? 255 : exponent + (127 - 15);
  return std::bit_cast<float>(sign | raised << 23U | mantissa << 13U);
}

template <class T>
T sample_at(const std::uint8_t* packed, std::size_t i) {
  T value;
  std::memcpy(&value, packed + i * sizeof(T), sizeof(T));
  return value;
}

/// The i-th of consecutive `bits`-bit numbers, most significant bit first.
unsigned bits_at(const std::uint8_t* packed, std::size_t i, unsigned bits) {
  unsigned value = 0;
  for (std::size_t bit = i * bits; bit < (i + 1) * bits; ++bit) {
    value = value << 1U | (packed[bit / 8] >> (7U - bit % 8) & 1U);
  }
  return value;
}

unsigned index_at(const TiffForm& form, const std::uint8_t* packed, std::size_t i) {
  return form.bits == 8    ? packed[i]
         : form.bits == 16 ? sample_at<std::uint16_t>(packed, i)
                           : bits_at(packed, i, form.bits);
}

float unsigned_at(const TiffForm& form, const std::uint8_t* packed, std::size_t i) {
  const bool is_white_0 = form.photometric == PHOTOMETRIC_MINISWHITE;
  if (form.bits == 32) {
    const auto value = sample_at<std::uint32_t>(packed, i);
    return unit_of(is_white_0 ? ~value : value);
  }
  const unsigned highest = (1U << form.bits) - 1;
  const unsigned stored = index_at(form, packed, i);
  const unsigned value = is_white_0 ? highest - stored : stored;
  return form.bits <= 8 ? unit_of(static_cast<std::uint8_t>(value * 0xffU / highest))
                        : unit_of(static_cast<std::uint16_t>(value * 0xffffU / highest));
}

float sample_of(const TiffForm& form, const std::uint8_t* packed, std::size_t i) {
  if (form.is_floating()) {
    return form.bits == 16   ? float_of_half(sample_at<std::uint16_t>(packed, i))
           : form.bits == 32 ? sample_at<float>(packed, i)
                             : static_cast<float>(sample_at<double>(packed, i));
  }
  if (form.format == SAMPLEFORMAT_INT) {
    return form.bits == 8    ? unit_of(sample_at<std::int8_t>(packed, i))
           : form.bits == 16 ? unit_of(sample_at<std::int16_t>(packed, i))
                             : unit_of(sample_at<std::int32_t>(packed, i));
  }
  return unsigned_at(form, packed, i);
}

/// Some pixels of one row into the picture.
/// @param plane  the channel, where planes are separate
void put_pixels(const TiffForm& form, const std::uint8_t* packed, ImageView<float> pixels,
                int y, int x0, int n, int plane) {
  const std::size_t step = form.packed_samples();
  for (int x = 0; x < n; ++x) {
    const std::size_t first = static_cast<std::size_t>(x) * step;
    if (form.is_palette()) {
      const unsigned index = index_at(form, packed, first);
      for (int c = 0; c < 3; ++c) {
        pixels(y, x0 + x, c) =
            unit_of(static_cast<std::uint8_t>(form.map[c][index] / 257));  // as libtiff does
      }
    } else if (form.planar == PLANARCONFIG_SEPARATE) {
      pixels(y, x0 + x, plane) = sample_of(form, packed, first);
    } else {
      for (int c = 0; c < pixels.channels(); ++c) {
        pixels(y, x0 + x, c) = sample_of(form, packed, first + static_cast<std::size_t>(c));
      }
    }
  }
}

int planes_of(const TiffForm& form) {
  return form.planar == PLANARCONFIG_SEPARATE && !form.is_palette() ? form.channels() : 1;
}

void read_rows(TIFF* tiff, const Memory& memory, const PictureSource& source,
               const TiffForm& form, ImageView<float> pixels) {
  std::vector<std::uint8_t> row(static_cast<std::size_t>(TIFFScanlineSize64(tiff)));
  for (int plane = 0; plane < planes_of(form); ++plane) {
    for (int y = 0; y < pixels.height(); ++y) {
      if (TIFFReadScanline(tiff, row.data(), static_cast<std::uint32_t>(y),
                           static_cast<std::uint16_t>(plane)) != 1) {
        refuse_damaged(source, memory.complaint);
      }
      put_pixels(form, row.data(), pixels, y, 0, pixels.width(), plane);
    }
  }
}

void read_tiles(TIFF* tiff, const Memory& memory, const PictureSource& source,
                const TiffForm& form, ImageView<float> pixels) {
  std::uint32_t tile_width = 0;
  std::uint32_t tile_height = 0;
  TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
  TIFFGetField(tiff, TIFFTAG_TILELENGTH, &tile_height);
  std::vector<std::uint8_t> tile(static_cast<std::size_t>(TIFFTileSize64(tiff)));
  const auto row_bytes = static_cast<std::size_t>(TIFFTileRowSize64(tiff));
  for (int plane = 0; plane < planes_of(form); ++plane) {
    for (std::uint32_t y0 = 0; y0 < form.height; y0 += tile_height) {
      for (std::uint32_t x0 = 0; x0 < form.width; x0 += tile_width) {
        if (TIFFReadTile(tiff, tile.data(), x0, y0, 0, static_cast<std::uint16_t>(plane)) < 0) {
          refuse_damaged(source, memory.complaint);
        }
        const std::uint32_t n = std::min(tile_width, form.width - x0);
        for (std::uint32_t y = 0; y < std::min(tile_height, form.height - y0); ++y) {
          put_pixels(form, &tile[y * row_bytes], pixels, static_cast<int>(y0 + y),
                     static_cast<int>(x0), static_cast<int>(n), plane);
        }
      }
    }
  }
}

/// Bytes of the samples that libtiff delivers in one piece: the whole picture's, or a tile's
/// where that is more.
std::uint64_t raw_bytes_of(const PictureSource& source, TIFF* tiff, const TiffForm& form) {
  const std::uint64_t bits = std::uint64_t{form.packed_samples()} * form.bits;
  const std::uint64_t row = TIFFScanlineSize64(tiff);
  std::uint64_t piece = row;
  std::uint64_t needed = (form.width * bits + 7) / 8;
  if (TIFFIsTiled(tiff) != 0) {
    std::uint32_t tile_width = 0;
    std::uint32_t tile_height = 0;
    TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
    TIFFGetField(tiff, TIFFTAG_TILELENGTH, &tile_height);
    if (tile_width == 0 || tile_height == 0 || tile_width > (1U << 24U) ||
        tile_height > (1U << 24U)) {
      refuse_damaged(source, fmt::format("tiles of {} x {} pixels", tile_width, tile_height));
    }
    piece = TIFFTileSize64(tiff);
    needed = (tile_width * bits + 7) / 8 * tile_height;
  }
  if (piece < needed) {
    refuse_damaged(source, "its rows or tiles have no size that fits its pixels");
  }
  return std::max(row * form.height * static_cast<std::uint64_t>(planes_of(form)), piece);
}

}  // namespace

PictureContent read_tiff(const PictureSource& source, PictureWish wish) {
  Memory memory{.input = source.bytes};
  const TiffHandle handle = open_memory(memory, "r");
  if (handle == nullptr) {
    refuse_damaged(source, memory.complaint);
  }
  TIFF* tiff = handle.get();
  TiffForm form = form_of(source, tiff);
  // Before libtiff computes sizes of its own.
  require_room(source, form.width, form.height, 1,
               std::min<std::uint64_t>(form.width, 1U << 20U) *
                   std::min<std::uint64_t>(form.height, 1U << 20U) * form.bits / 8);
  require_readable(source, tiff, form);
  PictureContent content{.bits_per_sample = form.is_palette() || form.bits <= 8 ? 8
                                            : form.bits <= 16                   ? 16
                                                                                : 32,
                         .is_floating = form.is_floating(),
                         .is_linear = form.is_floating(),
                         .tags = exif_tags(source.bytes)};
  const bool is_turned =
      form.orientation > ORIENTATION_TOPLEFT && form.orientation <= ORIENTATION_LEFTBOT;
  content.tags.facts.orientation = is_turned ? form.orientation : 1;
  std::uint32_t n_profile = 0;
  const std::byte* profile = nullptr;
  if (TIFFGetField(tiff, TIFFTAG_ICCPROFILE, &n_profile, &profile) == 1 && n_profile > 0) {
    content.tags.colour.icc.assign(profile, profile + n_profile);
  }
  if (form.is_floating() && form.bits == 64) {
    content.bits_per_sample = 64;
  }
  if (wish == PictureWish::header) {
    return content;
  }
  require_room(source, form.width, form.height, form.channels(),
               raw_bytes_of(source, tiff, form));
  content.pixels = Image<float>(static_cast<int>(form.height), static_cast<int>(form.width),
                                form.channels());
  if (TIFFIsTiled(tiff) != 0) {
    read_tiles(tiff, memory, source, form, content.pixels.view());
  } else {
    read_rows(tiff, memory, source, form, content.pixels.view());
  }
  return content;
}

std::vector<std::byte> tiff_bytes(ImageView<const float> image) {
  std::vector<std::byte> bytes;
  Memory memory{.output = &bytes};
  const auto require = [&memory](bool is_good) {
    if (!is_good) {
      refuse_encoding(memory.complaint);
    }
  };
  {
    constexpr int kStripRows = 32;
    const std::vector<std::byte> profile = linear_profile(image.channels());
    const TiffHandle handle = open_memory(memory, "wlm");  // little-endian, not mapped
    require(handle != nullptr);
    TIFF* t = handle.get();
    require(TIFFSetField(t, TIFFTAG_IMAGEWIDTH, image.width()) == 1 &&
            TIFFSetField(t, TIFFTAG_IMAGELENGTH, image.height()) == 1 &&
            TIFFSetField(t, TIFFTAG_SAMPLESPERPIXEL, image.channels()) == 1 &&
            TIFFSetField(t, TIFFTAG_BITSPERSAMPLE, 32) == 1 &&
            TIFFSetField(t, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_IEEEFP) == 1 &&
            TIFFSetField(t, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE) == 1 &&
            TIFFSetField(t, TIFFTAG_PREDICTOR, PREDICTOR_FLOATINGPOINT) == 1 &&
            TIFFSetField(t, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) == 1 &&
            TIFFSetField(t, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT) == 1 &&
            TIFFSetField(t, TIFFTAG_PHOTOMETRIC,
                         image.channels() == 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK) ==
                1 &&
            TIFFSetField(t, TIFFTAG_ROWSPERSTRIP, kStripRows) == 1 &&
            TIFFSetField(t, TIFFTAG_ICCPROFILE, static_cast<std::uint32_t>(profile.size()),
                         profile.data()) == 1);
    std::vector<float> row;
    for (int y = 0; y < image.height(); ++y) {
      row.assign(image.row(y).begin(), image.row(y).end());  // libtiff's predictor writes to it
      require(TIFFWriteScanline(t, row.data(), static_cast<std::uint32_t>(y), 0) == 1);
    }
    require(TIFFFlush(t) == 1);
  }
  return bytes;
}

}  // namespace haarlight
