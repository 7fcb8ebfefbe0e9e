// SPDX-License-Identifier: Apache-2.0
#include "session/frame_tiff.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <tiffio.h>

#include "core/json_value.h"
#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::session {

static_assert(std::endian::native == std::endian::little, "frames hold little-endian samples");

namespace {

constexpr const char* kDamagedHint =
    "the file is damaged: restore it from a backup, or take the shot again (haarlight reshoot)";

/// The memory file that libtiff reads or writes, and its last error.
struct Memory {
  std::span<const std::byte> input;
  std::vector<std::byte>* output = nullptr;
  std::uint64_t position = 0;
  std::string complaint;
};

Memory& memory_of(thandle_t handle) { return *static_cast<Memory*>(handle); }

tmsize_t read_memory(thandle_t handle, void* buffer, tmsize_t size) {
  Memory& memory = memory_of(handle);
  const std::span<const std::byte> bytes =
      memory.output != nullptr ? std::span<const std::byte>(*memory.output) : memory.input;
  if (size < 0 || memory.position > bytes.size()) {
    return 0;
  }
  const std::size_t n = std::min(static_cast<std::size_t>(size),
                                 bytes.size() - static_cast<std::size_t>(memory.position));
  if (n > 0) {
    std::memcpy(buffer, bytes.data() + memory.position, n);
    memory.position += n;
  }
  return static_cast<tmsize_t>(n);
}

tmsize_t write_memory(thandle_t handle, void* buffer, tmsize_t size) {
  Memory& memory = memory_of(handle);
  if (memory.output == nullptr || size < 0) {
    return 0;
  }
  const auto n = static_cast<std::size_t>(size);
  const auto end = static_cast<std::size_t>(memory.position) + n;
  if (memory.output->size() < end) {
    memory.output->resize(end);
  }
  std::memcpy(memory.output->data() + memory.position, buffer, n);
  memory.position = end;
  return size;
}

toff_t size_memory(thandle_t handle) {
  const Memory& memory = memory_of(handle);
  return memory.output != nullptr ? memory.output->size() : memory.input.size();
}

toff_t seek_memory(thandle_t handle, toff_t offset, int whence) {
  Memory& memory = memory_of(handle);
  std::uint64_t base = 0;
  if (whence == SEEK_CUR) {
    base = memory.position;
  } else if (whence == SEEK_END) {
    base = size_memory(handle);
  }
  memory.position = base + offset;
  return memory.position;
}

int close_memory(thandle_t /*handle*/) { return 0; }

int map_memory(thandle_t handle, void** base, toff_t* size) {
  const Memory& memory = memory_of(handle);
  if (memory.output != nullptr) {
    return 0;
  }
  *base = const_cast<std::byte*>(memory.input.data());  // libtiff only reads from a mapping
  *size = memory.input.size();
  return 1;
}

void unmap_memory(thandle_t /*handle*/, void* /*base*/, toff_t /*size*/) {}

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

/// @param mode  "rc": c keeps libtiff from presenting a single strip as several smaller ones
TiffHandle open_memory(Memory& memory, const char* mode) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  TIFFOpenOptionsSetErrorHandlerExtR(options, keep_complaint, &memory);
  TIFFOpenOptionsSetWarningHandlerExtR(options, ignore_warning, &memory);
  TiffHandle tiff(TIFFClientOpenExt("frame", mode, &memory, read_memory, write_memory,
                                    seek_memory, close_memory, size_memory, map_memory,
                                    unmap_memory, options));
  TIFFOpenOptionsFree(options);
  return tiff;
}

template <class T>
constexpr int kSampleFormat =
    std::is_floating_point_v<T> ? SAMPLEFORMAT_IEEEFP : SAMPLEFORMAT_UINT;

template <class T>
std::vector<std::byte> encode(ImageView<const T> pixels, const std::string& description) {
  HAARLIGHT_EXPECTS(!pixels.is_empty(), "a frame with pixels");
  HAARLIGHT_EXPECTS(pixels.channels() == 1 || pixels.channels() == 3, "1 or 3 channels");
  std::vector<std::byte> bytes;
  const std::size_t row_bytes = static_cast<std::size_t>(pixels.width()) *
                                static_cast<std::size_t>(pixels.channels()) * sizeof(T);
  bytes.reserve(row_bytes * static_cast<std::size_t>(pixels.height()) + description.size() +
                4096);
  Memory memory{.input = {}, .output = &bytes, .position = 0, .complaint = {}};
  const auto require = [&memory](bool is_good) {
    if (!is_good) {
      throw Error("a frame cannot be encoded: " + memory.complaint, "frame",
                  "this is our own bug, please report it", ExitCode::internal);
    }
  };
  {
    const TiffHandle tiff = open_memory(memory, "wlm");  // little-endian, not mapped
    require(tiff != nullptr);
    TIFF* t = tiff.get();
    require(TIFFSetField(t, TIFFTAG_IMAGEWIDTH, pixels.width()) == 1 &&
            TIFFSetField(t, TIFFTAG_IMAGELENGTH, pixels.height()) == 1 &&
            TIFFSetField(t, TIFFTAG_SAMPLESPERPIXEL, pixels.channels()) == 1 &&
            TIFFSetField(t, TIFFTAG_BITSPERSAMPLE, static_cast<int>(8 * sizeof(T))) == 1 &&
            TIFFSetField(t, TIFFTAG_SAMPLEFORMAT, kSampleFormat<T>) == 1 &&
            TIFFSetField(t, TIFFTAG_COMPRESSION, COMPRESSION_NONE) == 1 &&
            TIFFSetField(t, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) == 1 &&
            TIFFSetField(t, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT) == 1 &&
            TIFFSetField(t, TIFFTAG_PHOTOMETRIC,
                         pixels.channels() == 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK) ==
                1 &&
            TIFFSetField(t, TIFFTAG_ROWSPERSTRIP, kStripRows) == 1 &&
            TIFFSetField(t, TIFFTAG_IMAGEDESCRIPTION, description.c_str()) == 1);
    std::vector<std::byte> strip(row_bytes * kStripRows);
    for (int y0 = 0; y0 < pixels.height(); y0 += kStripRows) {
      const int rows = std::min(kStripRows, pixels.height() - y0);
      for (int y = 0; y < rows; ++y) {
        std::memcpy(strip.data() + static_cast<std::size_t>(y) * row_bytes,
                    pixels.row(y0 + y).data(), row_bytes);
      }
      const auto n = static_cast<tmsize_t>(row_bytes * static_cast<std::size_t>(rows));
      require(TIFFWriteEncodedStrip(t, static_cast<std::uint32_t>(y0 / kStripRows),
                                    strip.data(), n) == n);
    }
    require(TIFFWriteDirectory(t) == 1);
  }
  return bytes;
}

template <class T>
std::string hash_rows(ImageView<const T> pixels) {
  const std::ptrdiff_t packed = static_cast<std::ptrdiff_t>(pixels.width()) * pixels.channels();
  const auto n = static_cast<std::size_t>(packed) * static_cast<std::size_t>(pixels.height());
  if (pixels.row_stride() == packed) {
    return content_hash(std::as_bytes(std::span<const T>(pixels.data(), n)));
  }
  std::vector<T> rows;
  rows.reserve(n);
  for (int y = 0; y < pixels.height(); ++y) {
    rows.insert(rows.end(), pixels.row(y).begin(), pixels.row(y).end());
  }
  return content_hash(std::as_bytes(std::span<const T>(rows)));
}

}  // namespace

std::string setup_hash(const SessionInfo& info) {
  Sha256 hash;
  const auto add_number = [&hash](double value) {
    hash.add(std::as_bytes(std::span(&value, 1)));
  };
  const auto add_text = [&hash](std::string_view text) {
    hash.add(fmt::format("{}:", text.size())).add(text);
  };
  for (const SessionLight& light : info.lights) {
    add_text(light.name);
    add_text(light.is_position ? "position_mm" : "direction");
    for (int i = 0; i < 3; ++i) {
      add_number(light.coordinates[i]);
    }
    add_number(light.relative_power);
    if (light.lobe) {
      add_text("lobe");
      for (const double value : light.lobe->axis) {
        add_number(value);
      }
      add_number(light.lobe->mu);
    }
  }
  const FrameForm& form = info.form;
  const auto number = [](auto value) { return static_cast<double>(value); };
  for (const double value :
       {number(form.width), number(form.height), number(form.stored_height),
        number(form.channels), 8.0 * number(bytes_per_sample(form.sample)),
        number(form.transfer), number(form.bayer), form.black_level, form.white_level,
        form.saturation_dn(), number(info.grid_rows), number(info.grid_cols)}) {
    add_number(value);
  }
  if (!form.gains.empty()) {
    add_text("gains");
    for (const double gain : form.gains) {
      add_number(gain);
    }
  }
  if (form.crop) {
    add_text("crop");
    for (const int value :
         {form.crop->x, form.crop->y, form.crop->whole_width, form.crop->whole_height}) {
      add_number(value);
    }
  }
  return to_hex(hash.digest());
}

FrameDescription describe_frame(const SessionInfo& info, const std::string& setup, int shot,
                                int attempt, const FrameEvidence& evidence) {
  const Shot& planned = info.shots.at(static_cast<std::size_t>(shot));
  return {info.id,  info.plan_hash,
          shot,     attempt,
          evidence, LitStatement{planned.kind, planned.lit, planned.exposure_us, setup}};
}

std::string frame_description_to_json(const FrameDescription& description) {
  nlohmann::ordered_json json;
  json["haarlight_frame"] = 1;
  json["session"] = description.session;
  json["plan_hash"] = description.plan_hash;
  json["shot"] = description.shot;
  json["attempt"] = description.attempt;
  if (description.light) {
    const LitStatement& light = *description.light;
    HAARLIGHT_EXPECTS(std::isfinite(light.exposure_us), "an exposure in finite numbers");
    json["kind"] = to_string(light.kind);
    json["lit"] = nlohmann::ordered_json::array();
    for (const LightLevel& level : light.lit) {
      json["lit"].push_back({level.light, level.level});
    }
    json["exposure_us"] = light.exposure_us;
    json["setup"] = light.setup;
  }
  json["evidence"] = nlohmann::ordered_json::parse(evidence_to_json(description.evidence));
  return json.dump(-1, ' ', true, nlohmann::ordered_json::error_handler_t::replace);
}

FrameDescription frame_description_from_json(const std::string& json,
                                             const std::string& where) {
  const JsonValue value = JsonValue::parse(json, where);
  constexpr int kMaxInt = std::numeric_limits<int>::max();
  (void)value["haarlight_frame"].integer(1, 1);
  FrameDescription description;
  description.session = value["session"].text();
  description.plan_hash = value["plan_hash"].text();
  description.shot = static_cast<int>(value["shot"].integer(0, kMaxInt));
  description.attempt = static_cast<int>(value["attempt"].integer(0, kMaxInt));
  if (value.has("lit")) {
    LitStatement& light = description.light.emplace();
    light.kind = value["kind"].one_of<ShotKind>();
    for (const JsonValue& pair : value["lit"].elements()) {
      const std::vector<JsonValue> numbers = pair.elements();
      if (numbers.size() != 2) {
        pair.refuse(fmt::format("{} numbers", numbers.size()), "a light and its level");
      }
      light.lit.push_back({static_cast<int>(numbers[0].integer(0, kMaxInt)),
                           static_cast<std::uint16_t>(numbers[1].integer(0, 65535))});
    }
    light.exposure_us = value["exposure_us"].number(0.0);
    light.setup = value["setup"].text();
  }
  description.evidence = evidence_from_json(value["evidence"].dump(), where);
  return description;
}

std::vector<std::byte> encode_frame_tiff(ImageView<const std::uint8_t> pixels,
                                         const std::string& description) {
  return encode(pixels, description);
}
std::vector<std::byte> encode_frame_tiff(ImageView<const std::uint16_t> pixels,
                                         const std::string& description) {
  return encode(pixels, description);
}
std::vector<std::byte> encode_frame_tiff(ImageView<const float> pixels,
                                         const std::string& description) {
  return encode(pixels, description);
}

FrameTiffHeader read_frame_tiff_header(std::span<const std::byte> file,
                                       const std::string& where) {
  const auto refuse = [&where](const std::string& what) {
    throw Error(what, where, kDamagedHint);
  };
  Memory memory{.input = file, .output = nullptr, .position = 0, .complaint = {}};
  const TiffHandle tiff = open_memory(memory, "rc");
  if (!tiff) {
    refuse(file.empty() ? "the file is empty" : "not a TIFF file: " + memory.complaint);
  }
  TIFF* t = tiff.get();
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t rows_per_strip = 0;
  std::uint16_t channels = 1;
  std::uint16_t bits = 0;
  std::uint16_t format = SAMPLEFORMAT_UINT;
  std::uint16_t compression = COMPRESSION_NONE;
  std::uint16_t planar = PLANARCONFIG_CONTIG;
  TIFFGetField(t, TIFFTAG_IMAGEWIDTH, &width);
  TIFFGetField(t, TIFFTAG_IMAGELENGTH, &height);
  TIFFGetField(t, TIFFTAG_ROWSPERSTRIP, &rows_per_strip);
  TIFFGetFieldDefaulted(t, TIFFTAG_SAMPLESPERPIXEL, &channels);
  TIFFGetFieldDefaulted(t, TIFFTAG_BITSPERSAMPLE, &bits);
  TIFFGetFieldDefaulted(t, TIFFTAG_SAMPLEFORMAT, &format);
  TIFFGetFieldDefaulted(t, TIFFTAG_COMPRESSION, &compression);
  TIFFGetFieldDefaulted(t, TIFFTAG_PLANARCONFIG, &planar);
  if (width < 1 || height < 1 || width > (1U << 20U) || height > (1U << 20U)) {
    refuse(fmt::format("a frame of {} x {} pixels", width, height));
  }
  if (channels != 1 && channels != 3) {
    refuse(fmt::format("{} channels, a frame has 1 or 3", channels));
  }
  if (compression != COMPRESSION_NONE || planar != PLANARCONFIG_CONTIG || TIFFIsTiled(t) != 0 ||
      rows_per_strip != static_cast<std::uint32_t>(kStripRows) || TIFFIsByteSwapped(t) != 0) {
    refuse("not stored as a frame: uncompressed, little-endian, strips of 64 rows");
  }
  FrameTiffHeader header;
  if (format == SAMPLEFORMAT_UINT && bits == 8) {
    header.sample = SampleType::u8;
  } else if (format == SAMPLEFORMAT_UINT && bits == 16) {
    header.sample = SampleType::u16;
  } else if (format == SAMPLEFORMAT_IEEEFP && bits == 32) {
    header.sample = SampleType::f32;
  } else {
    refuse(
        fmt::format("{} bits of sample format {}, a frame has u8, u16 or f32", bits, format));
  }
  header.width = static_cast<int>(width);
  header.height = static_cast<int>(height);
  header.channels = channels;
  const std::uint64_t row_bytes =
      std::uint64_t{width} * channels * bytes_per_sample(header.sample);
  if (row_bytes * height > file.size()) {
    refuse(fmt::format("cut short: {} bytes for {} bytes of pixels", file.size(),
                       row_bytes * height));
  }
  const char* description = nullptr;
  if (TIFFGetField(t, TIFFTAG_IMAGEDESCRIPTION, &description) == 1 && description != nullptr) {
    header.description = description;
  }
  return header;
}

void require_form(const FrameForm& form, const FrameTiffHeader& header,
                  const std::string& where) {
  if (header.width != form.width || header.height != form.stored_height ||
      header.channels != form.channels || header.sample != form.sample) {
    throw Error(fmt::format("a frame of {} x {} x {}, the session has {} x {} x {}",
                            header.width, header.height, header.channels, form.width,
                            form.stored_height, form.channels),
                where, "the file does not belong to this session: restore the right one");
  }
}

std::vector<std::uint64_t> frame_tiff_strips(std::span<const std::byte> file,
                                             const FrameTiffHeader& header,
                                             const std::string& where) {
  Memory memory{.input = file, .output = nullptr, .position = 0, .complaint = {}};
  const TiffHandle tiff = open_memory(memory, "rc");
  const std::uint64_t row_bytes = std::uint64_t{bytes_per_sample(header.sample)} *
                                  static_cast<std::uint64_t>(header.width) *
                                  static_cast<std::uint64_t>(header.channels);
  std::vector<std::uint64_t> offsets;
  for (int y0 = 0; y0 < header.height; y0 += kStripRows) {
    const int y1 = std::min(y0 + kStripRows, header.height);
    const auto i_strip = static_cast<std::uint32_t>(y0 / kStripRows);
    const std::uint64_t n_bytes = row_bytes * static_cast<std::uint64_t>(y1 - y0);
    const std::uint64_t offset = tiff ? TIFFGetStrileOffset(tiff.get(), i_strip) : 0;
    if (!tiff || TIFFGetStrileByteCount(tiff.get(), i_strip) != n_bytes || offset == 0 ||
        offset > file.size() || file.size() - offset < n_bytes) {
      throw Error(fmt::format("rows {} .. {} cannot be read: {}", y0, y1,
                              memory.complaint.empty() ? "the file does not contain them"
                                                       : memory.complaint),
                  where, kDamagedHint);
    }
    offsets.push_back(offset);
  }
  return offsets;
}

std::vector<std::byte> read_frame_tiff_rows(std::span<const std::byte> file,
                                            const FrameTiffHeader& header, int y0, int y1,
                                            const std::string& where) {
  HAARLIGHT_EXPECTS(0 <= y0 && y0 <= y1, "a range of rows");
  if (y1 > header.height) {
    throw Error(fmt::format("rows {} .. {} of {}", y0, y1, header.height), where, kDamagedHint);
  }
  Memory memory{.input = file, .output = nullptr, .position = 0, .complaint = {}};
  const TiffHandle tiff = open_memory(memory, "rc");
  const std::size_t row_bytes = static_cast<std::size_t>(header.width) *
                                static_cast<std::size_t>(header.channels) *
                                bytes_per_sample(header.sample);
  std::vector<std::byte> rows(row_bytes * static_cast<std::size_t>(y1 - y0));
  std::vector<std::byte> strip(row_bytes * kStripRows);
  for (int y = y0; y < y1;) {
    const int i_strip = y / kStripRows;
    const int strip_y0 = i_strip * kStripRows;
    const int strip_y1 = std::min(strip_y0 + kStripRows, header.height);
    const auto n =
        static_cast<tmsize_t>(row_bytes * static_cast<std::size_t>(strip_y1 - strip_y0));
    if (!tiff || TIFFReadEncodedStrip(tiff.get(), static_cast<std::uint32_t>(i_strip),
                                      strip.data(), n) != n) {
      throw Error(
          fmt::format("rows {} .. {} cannot be read: {}", strip_y0, strip_y1, memory.complaint),
          where, kDamagedHint);
    }
    const int end = std::min(strip_y1, y1);
    std::memcpy(rows.data() + static_cast<std::size_t>(y - y0) * row_bytes,
                strip.data() + static_cast<std::size_t>(y - strip_y0) * row_bytes,
                static_cast<std::size_t>(end - y) * row_bytes);
    y = end;
  }
  return rows;
}

std::string hash_pixels(ImageView<const std::uint8_t> pixels) { return hash_rows(pixels); }
std::string hash_pixels(ImageView<const std::uint16_t> pixels) { return hash_rows(pixels); }
std::string hash_pixels(ImageView<const float> pixels) { return hash_rows(pixels); }

std::size_t bytes_per_sample(SampleType sample) noexcept {
  switch (sample) {
    case SampleType::u8:
      return 1;
    case SampleType::u16:
      return 2;
    case SampleType::f32:
      return 4;
  }
  return 0;
}

std::string frame_file_name(int shot, int attempt) {
  return fmt::format("frames/{:06}_a{}.tif", shot, attempt);
}

bool parse_frame_file_name(const std::string& name, int& shot, int& attempt) {
  int length = 0;
  int found_shot = -1;
  int found_attempt = -1;
  if (name.size() > 40 ||
      std::sscanf(name.c_str(), "%9d_a%9d.tif%n", &found_shot, &found_attempt, &length) != 2 ||
      static_cast<std::size_t>(length) != name.size() || found_shot < 0 || found_attempt < 0 ||
      frame_file_name(found_shot, found_attempt) != "frames/" + name) {
    return false;
  }
  shot = found_shot;
  attempt = found_attempt;
  return true;
}

}  // namespace haarlight::session
