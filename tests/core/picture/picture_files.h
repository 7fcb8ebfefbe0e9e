// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csetjmp>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include <jpeglib.h>
#include <png.h>
#include <tiffio.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

/// @file
/// Small picture files as third-party programs write them, made by the formats' libraries.

namespace haarlight::testing {

struct PngForm {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  int bits = 8;
  int colour = PNG_COLOR_TYPE_RGB;
  int interlace = PNG_INTERLACE_NONE;
  std::vector<png_color> palette;
  std::string icc;
  double gamma = 0.0;             ///< 0: none
  std::vector<double> primaries;  ///< white, red, green, blue; x and y each
};

/// @param rows  packed as the form says, 16-bit samples big-endian
inline void write_png(const std::filesystem::path& path, const PngForm& form,
                      std::span<const std::uint8_t> rows) {
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  std::FILE* file = std::fopen(path.c_str(), "wb");
  png_init_io(png, file);
  png_set_IHDR(png, info, form.width, form.height, form.bits, form.colour, form.interlace,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  if (!form.palette.empty()) {
    png_set_PLTE(png, info, form.palette.data(), static_cast<int>(form.palette.size()));
  }
  if (!form.icc.empty()) {
    png_set_iCCP(png, info, "a profile", PNG_COMPRESSION_TYPE_BASE,
                 reinterpret_cast<png_const_bytep>(form.icc.data()),
                 static_cast<png_uint_32>(form.icc.size()));
  }
  if (form.gamma > 0.0) {
    png_set_gAMA(png, info, form.gamma);
  }
  if (const std::vector<double>& p = form.primaries; !p.empty()) {
    png_set_cHRM(png, info, p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]);
  }
  png_write_info(png, info);
  const std::size_t row_bytes = png_get_rowbytes(png, info);
  std::vector<std::uint8_t> own(rows.begin(), rows.end());
  std::vector<std::uint8_t*> pointers;
  for (std::size_t y = 0; y < form.height; ++y) {
    pointers.push_back(&own[y * row_bytes]);
  }
  png_write_image(png, pointers.data());
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  std::fclose(file);
}

struct JpegForm {
  int width = 0;
  int height = 0;
  int channels = 3;  ///< 4: CMYK
  bool is_progressive = false;
  std::string exif;  ///< behind "Exif\0\0"
  std::string icc;
  int icc_piece = 65519;  ///< bytes of a piece
};

/// Quality 100, colours at full resolution.
inline void write_jpeg(const std::filesystem::path& path, const JpegForm& form,
                       std::span<const std::uint8_t> samples) {
  jpeg_compress_struct info{};
  jpeg_error_mgr errors{};
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  std::FILE* file = std::fopen(path.c_str(), "wb");
  jpeg_stdio_dest(&info, file);
  info.image_width = static_cast<JDIMENSION>(form.width);
  info.image_height = static_cast<JDIMENSION>(form.height);
  info.input_components = form.channels;
  info.in_color_space = form.channels == 1   ? JCS_GRAYSCALE
                        : form.channels == 3 ? JCS_RGB
                                             : JCS_CMYK;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, 100, TRUE);
  info.comp_info[0].h_samp_factor = 1;
  info.comp_info[0].v_samp_factor = 1;
  if (form.is_progressive) {
    jpeg_simple_progression(&info);
  }
  jpeg_start_compress(&info, TRUE);
  const auto write_marker = [&info](int marker, const std::string& data) {
    jpeg_write_marker(&info, marker, reinterpret_cast<const JOCTET*>(data.data()),
                      static_cast<unsigned>(data.size()));
  };
  if (!form.exif.empty()) {
    write_marker(JPEG_APP0 + 1, std::string("Exif\0\0", 6) + form.exif);
  }
  const auto piece = static_cast<std::size_t>(form.icc_piece);
  const std::size_t n_pieces = (form.icc.size() + piece - 1) / piece;
  for (std::size_t i = 0; i < n_pieces; ++i) {
    write_marker(JPEG_APP0 + 2, std::string("ICC_PROFILE\0", 12) + static_cast<char>(i + 1) +
                                    static_cast<char>(n_pieces) +
                                    form.icc.substr(i * piece, piece));
  }
  for (int y = 0; y < form.height; ++y) {
    const std::size_t row_bytes =
        static_cast<std::size_t>(form.width) * static_cast<std::size_t>(form.channels);
    auto* row = const_cast<JSAMPROW>(&samples[static_cast<std::size_t>(y) * row_bytes]);
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  std::fclose(file);
}

struct TiffForm {
  int width = 0;
  int height = 0;
  int samples = 1;
  int bits = 8;
  int format = SAMPLEFORMAT_UINT;
  int photometric = PHOTOMETRIC_MINISBLACK;
  int compression = COMPRESSION_NONE;
  bool is_separate = false;
  bool is_tiled = false;  ///< tiles of 16 x 16; width and height must be multiples
  int orientation = ORIENTATION_TOPLEFT;
  std::string icc;
  std::vector<std::uint16_t> map;  ///< red, then green, then blue
};

/// @param data  planes, where apart, else whole pixels; rows packed as the form says
inline void write_tiff(const std::filesystem::path& path, const TiffForm& form,
                       std::span<const std::uint8_t> data) {
  TIFF* tiff = TIFFOpen(path.c_str(), "w");
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, form.width);
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, form.height);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, form.samples);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, form.bits);
  TIFFSetField(tiff, TIFFTAG_SAMPLEFORMAT, form.format);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, form.photometric);
  TIFFSetField(tiff, TIFFTAG_COMPRESSION, form.compression);
  TIFFSetField(tiff, TIFFTAG_ORIENTATION, form.orientation);
  TIFFSetField(tiff, TIFFTAG_PLANARCONFIG,
               form.is_separate ? PLANARCONFIG_SEPARATE : PLANARCONFIG_CONTIG);
  if (!form.icc.empty()) {
    TIFFSetField(tiff, TIFFTAG_ICCPROFILE, static_cast<std::uint32_t>(form.icc.size()),
                 form.icc.data());
  }
  const std::size_t n_map = form.map.size() / 3;
  if (n_map > 0) {
    TIFFSetField(tiff, TIFFTAG_COLORMAP, &form.map[0], &form.map[n_map], &form.map[2 * n_map]);
  }
  const std::size_t together = form.is_separate ? 1U : static_cast<std::size_t>(form.samples);
  const std::size_t pixel_bits = together * static_cast<std::size_t>(form.bits);
  const std::size_t row_bytes = (static_cast<std::size_t>(form.width) * pixel_bits + 7) / 8;
  constexpr std::uint32_t kTile = 16;
  if (form.is_tiled) {
    TIFFSetField(tiff, TIFFTAG_TILEWIDTH, kTile);
    TIFFSetField(tiff, TIFFTAG_TILELENGTH, kTile);
  }
  std::vector<std::uint8_t> own(data.begin(), data.end());
  for (int plane = 0; plane < (form.is_separate ? form.samples : 1); ++plane) {
    std::uint8_t* first = &own[static_cast<std::size_t>(plane * form.height) * row_bytes];
    for (int y = 0; y < form.height && !form.is_tiled; ++y) {
      TIFFWriteScanline(tiff, first + static_cast<std::size_t>(y) * row_bytes,
                        static_cast<std::uint32_t>(y), static_cast<std::uint16_t>(plane));
    }
    for (int y = 0; y < form.height && form.is_tiled; y += kTile) {
      for (int x = 0; x < form.width; x += kTile) {
        std::vector<std::uint8_t> tile;
        const std::size_t tile_row = kTile * pixel_bits / 8;
        for (int row = y; row < y + static_cast<int>(kTile); ++row) {
          const std::uint8_t* from = first + static_cast<std::size_t>(row) * row_bytes +
                                     static_cast<std::size_t>(x) * pixel_bits / 8;
          tile.insert(tile.end(), from, from + tile_row);
        }
        TIFFWriteTile(tiff, tile.data(), static_cast<std::uint32_t>(x),
                      static_cast<std::uint32_t>(y), 0, static_cast<std::uint16_t>(plane));
      }
    }
  }
  TIFFClose(tiff);
}

/// A DNG of 16-bit values, red, green / green, blue, of a sensor that sees linear sRGB.
inline void write_dng(const std::filesystem::path& path, const TiffForm& form,
                      std::span<const std::uint16_t> values, double black, double white) {
  constexpr std::uint8_t kPattern[4] = {0, 1, 1, 2};
  constexpr std::uint16_t kRepeat[2] = {2, 2};
  constexpr std::uint8_t kVersion[4] = {1, 1, 0, 0};
  // XYZ (D65) to linear sRGB, IEC 61966-2-1
  constexpr float kMatrix[9] = {3.2406F, -1.5372F, -0.4986F, -0.9689F, 1.8758F,
                                0.0415F, 0.0557F,  -0.2040F, 1.0570F};
  constexpr std::uint16_t kDaylight = 21;  // D65
  TIFF* tiff = TIFFOpen(path.c_str(), "w");
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, form.width);
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, form.height);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 16);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, form.photometric);
  TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_NONE);
  TIFFSetField(tiff, TIFFTAG_SUBFILETYPE, 0);
  TIFFSetField(tiff, TIFFTAG_ORIENTATION, form.orientation);
  TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  TIFFSetField(tiff, TIFFTAG_MAKE, "Haarlight");
  TIFFSetField(tiff, TIFFTAG_MODEL, "Test sensor");
  TIFFSetField(tiff, TIFFTAG_UNIQUECAMERAMODEL, "Haarlight test sensor");
  TIFFSetField(tiff, TIFFTAG_DNGVERSION, kVersion);
  TIFFSetField(tiff, TIFFTAG_DNGBACKWARDVERSION, kVersion);
  TIFFSetField(tiff, TIFFTAG_CFAREPEATPATTERNDIM, kRepeat);
  TIFFSetField(tiff, TIFFTAG_CFAPATTERN, 4, kPattern);
  TIFFSetField(tiff, TIFFTAG_COLORMATRIX1, 9, kMatrix);
  TIFFSetField(tiff, TIFFTAG_CALIBRATIONILLUMINANT1, kDaylight);
  const auto black_level = static_cast<float>(black);
  const auto white_level = static_cast<std::uint32_t>(white);
  TIFFSetField(tiff, TIFFTAG_BLACKLEVEL, 1, &black_level);
  TIFFSetField(tiff, TIFFTAG_WHITELEVEL, 1, &white_level);
  std::vector<std::uint16_t> own(values.begin(), values.end());
  for (int y = 0; y < form.height; ++y) {
    TIFFWriteScanline(tiff,
                      &own[static_cast<std::size_t>(y) * static_cast<std::size_t>(form.width)],
                      static_cast<std::uint32_t>(y), 0);
  }
  TIFFClose(tiff);
}

/// What reading the picture is refused with.
inline std::string message_of(const std::filesystem::path& path) {
  try {
    (void)read_picture(path);
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was thrown";
}

}  // namespace haarlight::testing
