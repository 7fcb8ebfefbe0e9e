// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstring>
#include <ctime>
#include <memory>
#include <string_view>

#include <fmt/format.h>
#include <libraw/libraw.h>

#include "core/picture/picture_formats.h"

namespace haarlight {

namespace {

/// EXIF's orientation of libraw's quarter turns.
int orientation_of(int flip) { return flip == 3 ? 3 : flip == 5 ? 8 : flip == 6 ? 6 : 1; }

std::string local_time(std::time_t time) {
  std::tm parts{};
  std::array<char, 32> text{};
  if (time <= 0 || localtime_r(&time, &parts) == nullptr ||
      std::strftime(text.data(), text.size(), "%Y:%m:%d %H:%M:%S", &parts) == 0) {
    return {};
  }
  return text.data();
}

PictureFacts facts_of(const libraw_data_t& data) {
  PictureFacts facts{.orientation = orientation_of(data.sizes.flip)};
  facts.exposure_s = camera_number(data.other.shutter);
  facts.f_number = camera_number(data.other.aperture);
  facts.iso = camera_number(data.other.iso_speed);
  facts.taken = local_time(data.other.timestamp);
  const std::string_view model(data.idata.model,
                               strnlen(data.idata.model, sizeof data.idata.model));
  for (const char c : model) {
    facts.model += c >= ' ' && c <= '~' ? c : '?';
  }
  return facts;
}

/// The same for every picture of a camera, so that the pictures of a set stay comparable.
void set_fixed_development(libraw_output_params_t& params) {
  params.use_camera_wb = 0;  // daylight, from the camera's matrix
  params.use_auto_wb = 0;
  params.no_auto_bright = 1;
  params.adjust_maximum_thr = 0.0F;  // white does not depend on the picture
  params.highlight = 0;              // clip
  params.output_color = 0;           // the camera's: to Rec. 709 below, in floats
  params.output_bps = 16;
  params.gamm[0] = params.gamm[1] = 1.0;
  params.half_size = 0;
  params.user_qual = 3;  // adaptive homogeneity-directed demosaicing
}

// libraw 0.21 has the limit elsewhere, and says nothing when memory lacks anyway.
#if LIBRAW_VERSION >= LIBRAW_MAKE_VERSION(0, 21, 0)
constexpr unsigned kSilent = LIBRAW_OPTIONS_NO_DATAERR_CALLBACK;
unsigned& most_memory_mb(libraw_data_t& data) { return data.rawparams.max_raw_memory_mb; }
#else
constexpr unsigned kSilent =
    LIBRAW_OPIONS_NO_DATAERR_CALLBACK | LIBRAW_OPIONS_NO_MEMERR_CALLBACK;
unsigned& most_memory_mb(libraw_data_t& data) { return data.params.max_raw_memory_mb; }
#endif

constexpr unsigned kWhite = 65535;

/// A pixel with any saturated colour is white: clipped, whatever it was.
void develop_pixel(const libraw_data_t& data, const std::uint16_t* cam, std::span<float> out) {
  const int n_colours = data.idata.colors;
  if (std::find(cam, cam + n_colours, kWhite) != cam + n_colours) {
    std::fill(out.begin(), out.end(), 1.0F);
    return;
  }
  if (out.size() == 1) {
    out[0] = unit_of(cam[0]);
    return;
  }
  for (std::size_t c = 0; c < 3; ++c) {
    float sum = 0.0F;
    for (int k = 0; k < n_colours; ++k) {
      sum += data.color.rgb_cam[c][k] * unit_of(cam[k]);
    }
    out[c] = sum;
  }
}

void require(const PictureSource& source, int code) {
  if (code != LIBRAW_SUCCESS) {
    refuse_picture(
        source, fmt::format("cannot be decoded: {}", libraw_strerror(code)),
        "a raw file of a camera that libraw does not know, or a damaged one: convert "
        "it to DNG or to a linear TIFF");
  }
}

}  // namespace

PictureContent read_raw(const PictureSource& source, PictureWish wish) {
  const auto raw = std::make_unique<LibRaw>(kSilent);
  libraw_data_t& data = raw->imgdata;
  set_fixed_development(data.params);
  most_memory_mb(data) = static_cast<unsigned>(picture_memory() >> 20U);
  // libraw only reads it.
  require(source,
          raw->open_buffer(const_cast<std::byte*>(source.bytes.data()), source.bytes.size()));
  PictureContent content{.bits_per_sample = 16, .is_floating = false, .is_linear = true};
  content.tags.facts = facts_of(data);
  if (wish == PictureWish::header) {
    return content;
  }
  const int channels = data.idata.colors == 1 ? 1 : 3;
  if (data.idata.colors < 1 || data.idata.colors > 4) {
    refuse_damaged(source, fmt::format("{} colours", data.idata.colors));
  }
  const libraw_image_sizes_t& sizes = data.sizes;
  // The sensor's values, then four 16-bit values per pixel, and demosaicing's second copy.
  require_room(source, sizes.raw_width, sizes.raw_height, static_cast<std::uint64_t>(channels),
               std::uint64_t{sizes.raw_width} * sizes.raw_height * (2 + 8 + 8));
  require(source, raw->unpack());
  require(source, raw->dcraw_process());
  const auto width = static_cast<std::size_t>(sizes.iwidth);
  if (data.image == nullptr || width < 1 || sizes.iheight < 1) {
    refuse_damaged(source, "it has no pixels");
  }
  content.pixels = Image<float>(sizes.iheight, sizes.iwidth, channels);
  const ImageView<float> pixels = content.pixels.view();
  for (int y = 0; y < pixels.height(); ++y) {
    const std::span<float> row = pixels.row(y);
    for (std::size_t x = 0; x < width; ++x) {
      const auto n = static_cast<std::size_t>(channels);
      develop_pixel(data, data.image[static_cast<std::size_t>(y) * width + x],
                    row.subspan(x * n, n));
    }
  }
  return content;
}

bool is_raw(std::span<const std::byte> bytes) {
  using namespace std::string_view_literals;
  const auto has = [&](std::string_view magic, std::size_t at = 0) {
    return bytes.size() >= at + magic.size() &&
           std::memcmp(bytes.data() + at, magic.data(), magic.size()) == 0;
  };
  if (has("FUJIFILMCCD-RAW"sv) || has("IIRO"sv) || has("IIRS"sv) || has("MMOR"sv) ||
      has("IIU\0"sv) || has("ftypcrx "sv, 4) || has("HEAPCCDR"sv, 6) || has("\0MRM"sv) ||
      has("FOVb"sv)) {
    return true;
  }
  const bool is_tiff = has("II*\0"sv) || has("MM\0*"sv);
  return is_tiff && (has("CR\2"sv, 8) || is_raw_tiff(bytes));
}

}  // namespace haarlight
