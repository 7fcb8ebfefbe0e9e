#include "core/image_io.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
#include <span>

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include "core/files.h"
#include "core/picture_claim.h"

#if defined(HAARLIGHT_TSAN)
// OpenImageIO's pool starts its threads, to end them at once, before it hears that it shall
// have none (below).
extern "C" const char* __tsan_default_suppressions() { return "race:libOpenImageIO_Util.so\n"; }
#endif

namespace haarlight {

namespace {

#if defined(HAARLIGHT_TSAN)
// OpenImageIO's and OpenEXR's pools are built without ThreadSanitizer, which takes their
// hand-overs for races: every picture is read and written by the thread that asks.
const bool kHasNoPools = OIIO::attribute("threads", 1) && OIIO::attribute("exr_threads", -1);
#endif

constexpr std::uint64_t kMaxPixels = std::uint64_t{1} << 28U;
constexpr std::uint64_t kMaxSide = std::uint64_t{1} << 17U;
constexpr std::uint64_t kSmall = std::uint64_t{1} << 20U;  // bytes; headers of small pictures

std::atomic<std::uint64_t> most_memory = std::uint64_t{4} << 30U;

/// The formats we read, by their first bytes; empty when it is none of them.
std::string format_by_magic(std::span<const std::byte> bytes) {
  const auto starts = [&](std::string_view magic, std::size_t at = 0) {
    return bytes.size() >= at + magic.size() &&
           std::memcmp(bytes.data() + at, magic.data(), magic.size()) == 0;
  };
  using namespace std::string_view_literals;
  if (starts("\xff\xd8\xff"sv)) {
    return "jpeg";
  }
  if (starts("\x89PNG\r\n\x1a\n"sv)) {
    return "png";
  }
  if (starts("II*\0"sv) || starts("MM\0*"sv) || starts("II+\0"sv) || starts("MM\0+"sv)) {
    return "tiff";
  }
  if (starts("\x76\x2f\x31\x01"sv)) {
    return "openexr";
  }
  if (starts("#?RADIANCE"sv) || starts("#?RGBE"sv)) {
    return "hdr";
  }
  // TGA has no magic: an image type that is one of the six, and no colour map or a 256-entry
  // one.
  if (bytes.size() >= 18) {
    const auto type = std::to_integer<int>(bytes[2]);
    const auto map = std::to_integer<int>(bytes[1]);
    const auto depth = std::to_integer<int>(bytes[16]);
    const bool is_type =
        type == 1 || type == 2 || type == 3 || type == 9 || type == 10 || type == 11;
    const bool is_depth =
        depth == 8 || depth == 15 || depth == 16 || depth == 24 || depth == 32;
    if (map <= 1 && is_type && is_depth) {
      return "targa";
    }
  }
  return {};
}

/// Offset just behind the JPEG's end marker, or 0 when the file ends before it. libjpeg fills
/// what is missing with grey and only warns, so a cut file would pass as a picture.
std::size_t jpeg_end(std::span<const std::byte> bytes) {
  const auto at = [&](std::size_t i) { return std::to_integer<unsigned>(bytes[i]); };
  constexpr unsigned kStartOfScan = 0xda;
  constexpr unsigned kEndOfImage = 0xd9;
  std::size_t i = 2;
  while (i + 4 <= bytes.size()) {
    if (at(i) != 0xff) {
      return 0;
    }
    const unsigned marker = at(i + 1);
    if (marker == 0xff) {  // fill byte
      ++i;
      continue;
    }
    if (marker == kEndOfImage) {
      return i + 2;
    }
    i += 2 + 256 * at(i + 2) + at(i + 3);
    if (marker != kStartOfScan) {
      continue;
    }
    // Entropy-coded data up to the next marker that is neither a stuffed 0xff nor a restart.
    while (i + 1 < bytes.size() &&
           (at(i) != 0xff || at(i + 1) == 0 || (at(i + 1) >= 0xd0 && at(i + 1) <= 0xd7))) {
      ++i;
    }
  }
  return i + 2 == bytes.size() && at(i) == 0xff && at(i + 1) == kEndOfImage ? i + 2 : 0;
}

/// A whole PNG has its IEND chunk (length 0, so its checksum is always the same).
bool has_png_end(std::span<const std::byte> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  return text.rfind("IEND\xae\x42\x60\x82") != std::string_view::npos;
}

[[noreturn]] void refuse(const std::string& what, const std::filesystem::path& path,
                         const std::string& cure) {
  throw Error(what, path.string(), cure);
}

/// @param channels  that will be kept
void require_claim(const PictureClaim& claim, std::uint64_t channels, std::uint64_t file_bytes,
                   const std::filesystem::path& path) {
  if (claim.width < 1 || claim.height < 1 || claim.width > kMaxSide ||
      claim.height > kMaxSide || claim.width * claim.height > kMaxPixels) {
    refuse(fmt::format("{} x {} pixels", claim.width, claim.height), path,
           "a picture must have from 1 to 2^28 pixels, 2^17 a side");
  }
  if (claim.raw_bytes > kSmall && claim.raw_bytes / claim.most_per_byte > file_bytes) {
    refuse(fmt::format("it claims {} x {} pixels, which its {} bytes cannot hold", claim.width,
                       claim.height, file_bytes),
           path, "the file is damaged: replace it");
  }
  const std::uint64_t needed =
      claim.width * claim.height * channels * sizeof(float) + claim.raw_bytes;
  if (needed > most_memory) {
    refuse(fmt::format("{} x {} pixels take {} MB of memory, more than the {} MB allowed",
                       claim.width, claim.height, needed >> 20U, most_memory.load() >> 20U),
           path, "give a smaller picture, or more by --memory");
  }
}

/// A picture whose header has been read and believed.
struct OpenPicture {
  std::string format;
  PictureClaim claim;
  std::unique_ptr<OIIO::ImageInput> input;
  OIIO::ImageSpec spec;
};

OpenPicture open_picture(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  OpenPicture out;
  out.format = format_by_magic(bytes);
  const std::string& format = out.format;
  if (format.empty()) {
    refuse("not a picture that haarlight reads", path,
           "give a JPEG, PNG, TIFF, OpenEXR, Radiance HDR or TGA file");
  }
  if ((format == "jpeg" && jpeg_end(bytes) == 0) || (format == "png" && !has_png_end(bytes))) {
    refuse("ends before the picture does", path, "the file was cut: copy it again");
  }
  out.claim = picture_claim(format, bytes);
  const PictureClaim& claim = out.claim;
  if (claim.is_cut) {
    refuse("ends before its header does, or the header is damaged", path,
           "the file was cut or damaged: copy it again");
  }
  if (format == "openexr" || claim.width * claim.height != 0) {
    require_claim(claim, 1, bytes.size(), path);
  }
  out.input = OIIO::ImageInput::create(format);
  if (!out.input) {
    throw Error("OpenImageIO has no reader for " + format, path.string(),
                "install Debian's libopenimageio2.4", ExitCode::unavailable);
  }
  OIIO::ImageSpec& spec = out.spec;
  OIIO::ImageSpec wanted;
  wanted.attribute("oiio:UnassociatedAlpha", 1);
  wanted.attribute("oiio:RawColor", 1);
  if (!out.input->open(path.string(), spec, wanted)) {
    refuse("cannot be decoded: " + out.input->geterror(), path,
           "the file is damaged: replace it");
  }
  if (spec.depth > 1 || spec.width < 1 || spec.height < 1) {
    refuse(fmt::format("{} x {} pixels, {} layers", spec.width, spec.height, spec.depth), path,
           "a picture must have pixels and one layer");
  }
  if (spec.nchannels < 1 || spec.nchannels > 64) {
    refuse(fmt::format("{} channels", spec.nchannels), path, "give a grey or an RGB picture");
  }
  return out;
}

}  // namespace

void limit_picture_memory(std::uint64_t bytes) noexcept { most_memory = bytes; }

bool is_picture_turned(const std::filesystem::path& path) {
  const MappedFile mapped(path);
  return open_picture(path, mapped.bytes()).spec.get_int_attribute("Orientation", 1) != 1;
}

PictureFile read_picture(const std::filesystem::path& path) {
  const MappedFile mapped(path);
  const OpenPicture open = open_picture(path, mapped.bytes());
  const OIIO::ImageSpec& spec = open.spec;
  const std::unique_ptr<OIIO::ImageInput>& input = open.input;
  const std::string& format = open.format;
  const std::uint64_t file_bytes = mapped.bytes().size();
  const int channels = spec.nchannels >= 3 ? 3 : 1;
  const std::uint64_t tile_pixels =
      std::uint64_t(spec.tile_width) * std::uint64_t(spec.tile_height);
  require_claim(
      {static_cast<std::uint64_t>(spec.width), static_cast<std::uint64_t>(spec.height),
       std::max<std::uint64_t>(spec.image_bytes(true), tile_pixels * spec.pixel_bytes(true)),
       open.claim.most_per_byte},
      static_cast<std::uint64_t>(channels), file_bytes, path);
  PictureFile picture;
  picture.is_floating = spec.format.is_floating_point();
  picture.bits_per_sample = static_cast<int>(spec.format.basesize()) * 8;
  const std::string space = spec.get_string_attribute("oiio:ColorSpace");
  const bool says_linear = space == "Linear" || space == "linear" || space == "scene_linear";
  picture.transfer = picture.is_floating || (says_linear && format != "jpeg") ? Transfer::linear
                                                                              : Transfer::srgb;
  picture.is_turned = spec.get_int_attribute("Orientation", 1) != 1;
  picture.pixels = Image<float>(spec.height, spec.width, channels);
  if (!input->read_image(0, 0, 0, channels, OIIO::TypeDesc::FLOAT,
                         picture.pixels.pixels().data()) ||
      input->has_error()) {
    refuse("cannot be decoded: " + input->geterror(), path, "the file is damaged: replace it");
  }
  input->close();
  return picture;
}

Image<float> read_linear_image(const std::filesystem::path& path) {
  PictureFile picture = read_picture(path);
  const std::span<float> pixels = picture.pixels.pixels();
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    if (!std::isfinite(pixels[i])) {
      const auto pixel =
          static_cast<int>(i / static_cast<std::size_t>(picture.pixels.channels()));
      refuse(fmt::format("pixel (x {}, y {}) is not a finite number",
                         pixel % picture.pixels.width(), pixel / picture.pixels.width()),
             path, "repair or replace the picture");
    }
    if (picture.transfer == Transfer::srgb) {
      pixels[i] = linear_from_srgb(pixels[i]);
    }
  }
  return std::move(picture.pixels);
}

void require_picture_name(const std::filesystem::path& path) {
  const std::string ending = path.extension().string();
  if (ending != ".png" && ending != ".exr" && ending != ".tif") {
    throw Error(fmt::format("cannot write a picture named \"{}\"", ending), path.string(),
                "end the name in .exr (linear), .png (to look at) or .tif", ExitCode::usage);
  }
}

void write_image(const std::filesystem::path& path, ImageView<const float> image,
                 double exposure, std::span<const PictureNote> notes) {
  HAARLIGHT_EXPECTS(image.channels() == 1 || image.channels() == 3, "1 or 3 channels");
  HAARLIGHT_EXPECTS(!image.is_empty(), "a picture with pixels");
  require_picture_name(path);
  const std::string ending = path.extension().string();
  const bool is_png = ending == ".png";
  const auto type = is_png ? OIIO::TypeDesc::UINT8 : OIIO::TypeDesc::FLOAT;
  OIIO::ImageSpec spec(image.width(), image.height(), image.channels(), type);
  spec.attribute("oiio:ColorSpace", is_png ? "sRGB" : "Linear");
  for (const PictureNote& note : notes) {
    spec.attribute(note.name, note.text);
  }
  spec.attribute("haarlightProgram", "haarlight " HAARLIGHT_VERSION);
  spec.attribute("haarlightExposure", fmt::format("{:.9g}", is_png ? exposure : 1.0));
  std::vector<float> packed;
  packed.reserve(static_cast<std::size_t>(image.width()) *
                 static_cast<std::size_t>(image.height() * image.channels()));
  for (int y = 0; y < image.height(); ++y) {
    for (const float value : image.row(y)) {
      if (std::isinf(value)) {
        throw Error(
            fmt::format("a pixel of row {} would be infinite: single precision ends at 3.4e38",
                        y),
            path.string(), "scale the light or the pictures that it is made of down");
      }
      packed.push_back(is_png ? srgb_from_linear(value * static_cast<float>(exposure)) : value);
    }
  }
  std::vector<unsigned char> encoded;
  OIIO::Filesystem::IOVecOutput memory(encoded);
  const std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(
      is_png ? "png" : (ending == ".exr" ? "openexr" : "tiff"), &memory);
  if (!output) {
    throw Error("OpenImageIO has no writer for " + ending, path.string(),
                "install Debian's libopenimageio2.4", ExitCode::unavailable);
  }
  if (!output->supports("ioproxy") || !output->set_ioproxy(&memory) ||
      !output->open(path.string(), spec) ||
      !output->write_image(OIIO::TypeDesc::FLOAT, packed.data()) || !output->close()) {
    throw Error("cannot be encoded: " + output->geterror(), path.string(),
                "this is our own bug", ExitCode::internal);
  }
  write_file_atomically(path, std::as_bytes(std::span(encoded)));
}

float srgb_from_linear(float linear) noexcept {
  if (linear < 0.0F) {
    return -srgb_from_linear(-linear);
  }
  return linear <= 0.0031308F ? 12.92F * linear
                              : 1.055F * std::pow(linear, 1.0F / 2.4F) - 0.055F;
}

float linear_from_srgb(float encoded) noexcept {
  if (encoded < 0.0F) {
    return -linear_from_srgb(-encoded);
  }
  return encoded <= 0.04045F ? encoded / 12.92F : std::pow((encoded + 0.055F) / 1.055F, 2.4F);
}

}  // namespace haarlight
