// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cctype>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include <ImfChannelList.h>
#include <ImfChromaticitiesAttribute.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputPart.h>
#include <ImfMultiPartInputFile.h>
#include <ImfOutputFile.h>
#include <ImfPartType.h>
#include <ImfStandardAttributes.h>
#include <ImfStringAttribute.h>
#include <ImfTiledInputPart.h>
#include <fmt/format.h>

#include "core/picture/picture_formats.h"

namespace haarlight {

namespace {

/// A file in memory, for reading.
class MemoryInput final : public Imf::IStream {
 public:
  explicit MemoryInput(std::span<const std::byte> bytes) : IStream("picture"), bytes_(bytes) {}

  bool read(char to[], int n) override {
    if (n < 0 || at_ > bytes_.size() || static_cast<std::size_t>(n) > bytes_.size() - at_) {
      throw std::runtime_error("it ends before the picture does");
    }
    std::memcpy(to, bytes_.data() + at_, static_cast<std::size_t>(n));
    at_ += static_cast<std::size_t>(n);
    return at_ < bytes_.size();
  }
  std::uint64_t tellg() override { return at_; }
  void seekg(std::uint64_t position) override { at_ = position; }

 private:
  std::span<const std::byte> bytes_;
  std::uint64_t at_ = 0;
};

class MemoryOutput final : public Imf::OStream {
 public:
  MemoryOutput() : OStream("picture") {}

  void write(const char from[], int n) override {
    const std::size_t end = at_ + static_cast<std::size_t>(n);
    bytes.resize(std::max(bytes.size(), end));
    std::memcpy(bytes.data() + at_, from, static_cast<std::size_t>(n));
    at_ = end;
  }
  std::uint64_t tellp() override { return at_; }
  void seekp(std::uint64_t position) override { at_ = position; }

  std::vector<std::byte> bytes;

 private:
  std::uint64_t at_ = 0;
};

/// A channel's name and its rank among those of its layer.
struct ChannelRank {
  std::string layer;  ///< "left" of "left.R"
  std::size_t order = 0;
  std::string suffix;
  std::string name;
  Imf::PixelType type = Imf::HALF;
};

std::string lower(std::string_view text) {
  std::string result(text);
  std::transform(result.begin(), result.end(), result.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return result;
}

/// Red, green, blue before luminance; coordinates in their order; alpha and depth, which are
/// not colours, from kColours on.
constexpr std::size_t kColours = 100;
std::size_t order_of(std::string_view suffix, bool is_coordinates) {
  constexpr std::array<std::string_view, 9> kNames{"r",    "red", "g", "green", "b",
                                                   "blue", "x",   "y", "z"};
  constexpr std::array<std::string_view, 12> kOthers{
      "a", "alpha", "ar", "ra", "ag", "ga", "ab", "ba", "z", "depth", "zback", "id"};
  const std::string name = lower(suffix);
  const auto* const found = std::find(kNames.begin(), kNames.end(), name);
  if (found != kNames.end() && (name != "z" || is_coordinates)) {
    return static_cast<std::size_t>(found - kNames.begin());
  }
  const auto* const other = std::find(kOthers.begin(), kOthers.end(), name);
  return other == kOthers.end() ? kNames.size()
                                : kColours + static_cast<std::size_t>(other - kOthers.begin());
}

/// The channels in order of preference.
std::vector<ChannelRank> ranks_of(const PictureSource& source,
                                  const Imf::ChannelList& channels) {
  std::vector<ChannelRank> ranks;
  for (auto i = channels.begin(); i != channels.end(); ++i) {
    const std::string_view name = i.name();
    if (i.channel().xSampling != 1 || i.channel().ySampling != 1) {
      refuse_picture(source, fmt::format("channel {} is stored at a lower resolution", name),
                     "save it with all channels whole (RGB)");
    }
    const std::size_t dot = name.rfind('.');
    ChannelRank rank;
    rank.layer = dot == std::string_view::npos ? "" : name.substr(0, dot);
    rank.suffix = dot == std::string_view::npos ? name : name.substr(dot + 1);
    rank.name = name;
    rank.type = i.channel().type;
    ranks.push_back(rank);
  }
  for (ChannelRank& rank : ranks) {
    const bool is_coordinates =
        std::any_of(ranks.begin(), ranks.end(), [&](const ChannelRank& other) {
          return other.layer == rank.layer && lower(other.suffix) == "x";
        });
    rank.order = order_of(rank.suffix, is_coordinates);
  }
  std::sort(ranks.begin(), ranks.end(), [](const ChannelRank& a, const ChannelRank& b) {
    return std::tie(a.layer, a.order, a.suffix) < std::tie(b.layer, b.order, b.suffix);
  });
  return ranks;
}

/// Three colours of the first layer, or one.
std::vector<ChannelRank> wanted_of(std::vector<ChannelRank> ranks) {
  std::size_t n_colours = 0;
  while (n_colours < ranks.size() && ranks[n_colours].layer == ranks[0].layer &&
         ranks[n_colours].order < kColours) {
    ++n_colours;
  }
  ranks.resize(n_colours >= 3 ? 3 : 1);
  return ranks;
}

/// Those that the source names. @throws Error  one is missing, or the picture is a part of a larger one
std::vector<ChannelRank> named_of(const PictureSource& source, const Imf::Header& header,
                                  const std::vector<ChannelRank>& ranks) {
  std::vector<ChannelRank> named;
  for (const std::string_view name : source.channels) {
    const auto found = std::ranges::find(ranks, name, &ChannelRank::name);
    if (found == ranks.end()) {
      refuse_picture(source, fmt::format("has no channel {}", name),
                     "give a picture that haarlight render surface -o PICTURE.exr has written");
    }
    named.push_back(*found);
  }
  if (header.dataWindow() != header.displayWindow()) {
    refuse_picture(source, "is a part of a larger picture",
                   "give the whole picture: render it without --crop");
  }
  return named;
}

void read_pixels(const PictureSource& source, Imf::MultiPartInputFile& file,
                 const std::vector<ChannelRank>& wanted, Image<float>& pixels) {
  const Imf::Header& header = file.header(0);
  const Imath::Box2i window = header.dataWindow();
  const std::size_t n = wanted.size();
  const std::size_t stride = sizeof(float) * n;
  Imf::FrameBuffer frame;
  for (std::size_t c = 0; c < n; ++c) {
    // An integer has a float's size, and is made one below.
    frame.insert(wanted[c].name,
                 Imf::Slice::Make(wanted[c].type == Imf::UINT ? Imf::UINT : Imf::FLOAT,
                                  pixels.pixels().data() + c, window, stride,
                                  stride * static_cast<std::size_t>(pixels.width())));
  }
  if (header.hasType() && Imf::isTiled(header.type())) {
    Imf::TiledInputPart part(file, 0);
    part.setFrameBuffer(frame);
    part.readTiles(0, part.numXTiles(0) - 1, 0, part.numYTiles(0) - 1, 0, 0);
  } else if (!header.hasType() || header.type() == Imf::SCANLINEIMAGE) {
    Imf::InputPart part(file, 0);
    part.setFrameBuffer(frame);
    part.readPixels(window.min.y, window.max.y);
  } else {
    refuse_picture(source, "its pixels are of type " + header.type(),
                   "flatten it to one sample per pixel");
  }
  for (std::size_t c = 0; c < n; ++c) {
    for (std::size_t i = c; wanted[c].type == Imf::UINT && i < pixels.pixels().size(); i += n) {
      std::uint32_t value = 0;
      std::memcpy(&value, &pixels.pixels()[i], sizeof value);
      pixels.pixels()[i] = unit_of(value);
    }
  }
}

std::vector<PictureNote> notes_of(const Imf::Header& header) {
  std::vector<PictureNote> notes;
  for (auto i = header.begin(); i != header.end(); ++i) {
    if (i.attribute().typeName() == std::string_view(Imf::StringAttribute::staticTypeName())) {
      notes.push_back(
          {i.name(), static_cast<const Imf::StringAttribute&>(i.attribute()).value()});
    }
  }
  return notes;
}

constexpr const char* kCameraModel = "cameraModel";  // of OpenEXR 3.2's standard attributes
constexpr const char* kTaken = "capDate";

PictureFacts facts_of(const Imf::Header& header) {
  PictureFacts facts;
  const auto text = [&header](const char* name, std::string_view among, std::size_t most) {
    const auto* found = header.findTypedAttribute<Imf::StringAttribute>(name);
    std::string value = found == nullptr ? std::string() : found->value().substr(0, most);
    for (char& c : value) {
      c = c >= ' ' && c <= '~' ? c : '?';
    }
    return among.empty() || value.find_first_not_of(among) == std::string::npos ? value
                                                                                : std::string();
  };
  const auto number = [](bool is_there, auto read) {
    return camera_number(is_there ? static_cast<double>(read()) : 0.0);
  };
  constexpr std::size_t kMostModel = 64;
  constexpr std::size_t kDate = 19;
  facts.model = text(kCameraModel, "", kMostModel);
  facts.taken = text(kTaken, "0123456789: ", kDate);
  facts.exposure_s =
      number(Imf::hasExpTime(header), [&header] { return Imf::expTime(header); });
  facts.f_number =
      number(Imf::hasAperture(header), [&header] { return Imf::aperture(header); });
  facts.iso = number(Imf::hasIsoSpeed(header), [&header] { return Imf::isoSpeed(header); });
  return facts;
}

void add_facts(const PictureFacts& facts, Imf::Header& header) {
  if (!facts.model.empty()) {
    header.insert(kCameraModel, Imf::StringAttribute(facts.model));
  }
  if (!facts.taken.empty()) {
    header.insert(kTaken, Imf::StringAttribute(facts.taken));
  }
  if (facts.exposure_s) {
    Imf::addExpTime(header, static_cast<float>(*facts.exposure_s));
  }
  if (facts.f_number) {
    Imf::addAperture(header, static_cast<float>(*facts.f_number));
  }
  if (facts.iso) {
    Imf::addIsoSpeed(header, static_cast<float>(*facts.iso));
  }
}

}  // namespace

PictureContent read_exr(const PictureSource& source, PictureWish wish) {
  try {
    MemoryInput stream(source.bytes);
    constexpr int kOwnThread = 0;  // callers distribute pictures over threads
    Imf::MultiPartInputFile file(stream, kOwnThread, false);
    const Imf::Header& header = file.header(0);
    const std::vector<ChannelRank> ranks = ranks_of(source, header.channels());
    if (ranks.empty()) {
      refuse_picture(source, "has no channels", "give a grey or an RGB picture");
    }
    const auto is_all = [&](Imf::PixelType type) {
      return std::all_of(ranks.begin(), ranks.end(),
                         [type](const ChannelRank& rank) { return rank.type == type; });
    };
    PictureContent content{.bits_per_sample = is_all(Imf::HALF) ? 16 : 32,
                           .is_floating = !is_all(Imf::UINT)};
    content.notes = notes_of(header);
    content.tags.facts = facts_of(header);
    if (wish == PictureWish::header) {
      return content;
    }
    if (Imf::hasChromaticities(header)) {
      const Imf::Chromaticities& c = Imf::chromaticities(header);
      content.tags.colour.primaries = {c.red.x,  c.red.y,  c.green.x, c.green.y,
                                       c.blue.x, c.blue.y, c.white.x, c.white.y};
    }
    const Imath::Box2i window = header.dataWindow();
    const auto side = [](int low, int high) {
      return static_cast<std::uint64_t>(std::int64_t{high} - low + 1);
    };
    const std::uint64_t width = side(window.min.x, window.max.x);
    const std::uint64_t height = side(window.min.y, window.max.y);
    const std::vector<ChannelRank> wanted =
        source.channels.empty() ? wanted_of(ranks) : named_of(source, header, ranks);
    require_room(source, width, height, wanted.size(),
                 std::min(width, std::uint64_t{1} << 20U) *
                     std::min(height, std::uint64_t{1} << 20U) * ranks.size() * 2);
    content.pixels = Image<float>(static_cast<int>(height), static_cast<int>(width),
                                  static_cast<int>(wanted.size()));
    read_pixels(source, file, wanted, content.pixels);
    return content;
  } catch (const Error&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    refuse_damaged(source, error.what());
  }
}

std::vector<std::byte> exr_bytes(ImageView<const float> image, const PictureNotes& notes,
                                 std::span<const PictureLayer> layers,
                                 const PictureWindow& window) {
  MemoryOutput stream;
  try {
    Imf::Header header(image.width(), image.height());
    const Imath::V2i first(window.x, window.y);
    header.dataWindow() =
        Imath::Box2i(first, first + Imath::V2i(image.width() - 1, image.height() - 1));
    header.displayWindow() = Imath::Box2i(
        Imath::V2i(0, 0), Imath::V2i(window.full_width - 1, window.full_height - 1));
    header.compression() = Imf::ZIP_COMPRESSION;
    Imf::addChromaticities(header, Imf::Chromaticities());  // the default is Rec. 709
    for (const PictureNote& note : notes.texts) {
      header.insert(note.name, Imf::StringAttribute(note.text));
    }
    add_facts(notes.facts, header);
    Imf::FrameBuffer frame;
    const auto add = [&](const std::string& name, ImageView<const float> from, int channel) {
      header.channels().insert(name, Imf::Channel(Imf::FLOAT));
      // OpenEXR takes a non-const pointer to what it only reads.
      frame.insert(
          name, Imf::Slice::Make(Imf::FLOAT, const_cast<float*>(from.data() + channel),
                                 header.dataWindow(),
                                 sizeof(float) * static_cast<std::size_t>(from.channels()),
                                 sizeof(float) * static_cast<std::size_t>(from.row_stride())));
    };
    for (int c = 0; c < image.channels(); ++c) {
      add(std::string(1, image.channels() == 3 ? "RGB"[c] : 'Y'), image, c);
    }
    for (const PictureLayer& layer : layers) {
      for (int c = 0; c < layer.image.channels(); ++c) {
        add(layer.channels[static_cast<std::size_t>(c)], layer.image, c);
      }
    }
    Imf::OutputFile file(stream, header, 0);
    file.setFrameBuffer(frame);
    file.writePixels(image.height());
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    refuse_encoding(error.what());
  }
  return std::move(stream.bytes);
}

}  // namespace haarlight
