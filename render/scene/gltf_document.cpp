// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_document.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr const char* kExportAgain =
    "the file is damaged or not written as glTF 2.0 wants it: export it again, or hold it to "
    "the "
    "glTF validator";
constexpr std::int64_t kMostBytes = std::int64_t{1} << 40U;

/// Those that are read, as far as docs/reference/gltf.md says.
constexpr auto kKnownExtensions = std::to_array<std::string_view>(
    {"KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_ior",
     "KHR_materials_specular", "KHR_materials_transmission", "KHR_materials_volume",
     "KHR_mesh_quantization", "KHR_texture_transform"});

bool is_known(std::string_view extension) {
  return std::ranges::find(kKnownExtensions, extension) != kKnownExtensions.end();
}

std::uint32_t little_endian(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    value |= std::uint32_t{static_cast<unsigned char>(bytes[at + i])} << (8U * i);
  }
  return value;
}

/// Nothing: a character of no base64 text.
std::optional<std::string> decoded_base64(std::string_view text) {
  while (!text.empty() && text.back() == '=') {
    text.remove_suffix(1);
  }
  std::string bytes;
  bytes.reserve(text.size() / 4 * 3 + 3);
  std::uint32_t group = 0;
  unsigned n_bits = 0;
  for (const char c : text) {
    std::uint32_t six = 0;
    if (c >= 'A' && c <= 'Z') {
      six = static_cast<std::uint32_t>(c - 'A');
    } else if (c >= 'a' && c <= 'z') {
      six = static_cast<std::uint32_t>(c - 'a') + 26U;
    } else if (c >= '0' && c <= '9') {
      six = static_cast<std::uint32_t>(c - '0') + 52U;
    } else if (c == '+' || c == '/') {
      six = c == '+' ? 62U : 63U;
    } else {
      return std::nullopt;
    }
    group = (group << 6U | six) & 0xffffffU;
    n_bits += 6;
    if (n_bits >= 8) {
      n_bits -= 8;
      bytes.push_back(static_cast<char>(group >> n_bits & 0xffU));
    }
  }
  return bytes;
}

/// %20 and the like; what is no such code stays.
std::string without_percent_codes(std::string_view text) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') {
      return c - '0';
    }
    const char lower = static_cast<char>(c | 0x20);
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
  };
  std::string plain;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool is_code = text[i] == '%' && i + 2 < text.size() && digit(text[i + 1]) >= 0 &&
                         digit(text[i + 2]) >= 0;
    plain.push_back(is_code ? static_cast<char>(16 * digit(text[i + 1]) + digit(text[i + 2]))
                            : text[i]);
    i += is_code ? 2 : 0;
  }
  return plain;
}

bool is_data(std::string_view uri) { return uri.starts_with("data:"); }

/// @throws Error  at the value: no base64
std::string bytes_of_data(const JsonValue& uri, std::string_view text) {
  const std::size_t comma = text.find(',');
  if (comma == std::string_view::npos || !text.substr(0, comma).ends_with(";base64")) {
    uri.refuse("a data: URI that is not in base64", kExportAgain);
  }
  std::optional<std::string> bytes = decoded_base64(text.substr(comma + 1));
  if (!bytes) {
    uri.refuse("characters that are no base64", kExportAgain);
  }
  return std::move(*bytes);
}

constexpr int kByte = 5120;
constexpr int kUnsignedByte = 5121;
constexpr int kShort = 5122;
constexpr int kUnsignedShort = 5123;
constexpr int kUnsignedInt = 5125;
constexpr int kFloat = 5126;

/// 0: none of glTF's.
std::size_t size_of(int component_type) {
  switch (component_type) {
    case kByte:
    case kUnsignedByte:
      return 1;
    case kShort:
    case kUnsignedShort:
      return 2;
    case kUnsignedInt:
    case kFloat:
      return 4;
    default:
      return 0;
  }
}

template <class Number>
double number_at(const char* bytes) {
  static_assert(std::endian::native == std::endian::little);
  Number number;
  std::memcpy(&number, bytes, sizeof(Number));
  return static_cast<double>(number);
}

/// As glTF 2.0 normalises: [-1, 1] of signed integers, [0, 1] of others.
double component_at(const char* bytes, int component_type, bool is_normalised) {
  const auto scaled = [&](double value, double most) {
    return is_normalised ? std::max(value / most, -1.0) : value;
  };
  switch (component_type) {
    case kByte:
      return scaled(number_at<std::int8_t>(bytes), 127.0);
    case kUnsignedByte:
      return scaled(number_at<std::uint8_t>(bytes), 255.0);
    case kShort:
      return scaled(number_at<std::int16_t>(bytes), 32767.0);
    case kUnsignedShort:
      return scaled(number_at<std::uint16_t>(bytes), 65535.0);
    case kUnsignedInt:
      return number_at<std::uint32_t>(bytes);
    default:
      return number_at<float>(bytes);
  }
}

int component_type_of(const JsonValue& value) {
  const auto type = static_cast<int>(value.integer(0, 1 << 16));
  if (size_of(type) == 0) {
    value.refuse(fmt::format("{} is no componentType of glTF 2.0", type), kExportAgain);
  }
  return type;
}

std::size_t width_of(const JsonValue& type) {
  const std::string word = type.text();
  if (word == "SCALAR") {
    return 1;
  }
  return word == "VEC2" ? 2 : word == "VEC3" ? 3 : word == "VEC4" ? 4 : 16;
}

}  // namespace

GltfDocument::GltfDocument(std::string_view bytes, std::string name,
                           std::filesystem::path folder, std::size_t max_numbers)
    : name_(std::move(name)), folder_(std::move(folder)), room_for_numbers_(max_numbers) {
  root_ = JsonValue::parse(open_container(bytes), name_, kExportAgain);
  const JsonValue version = root()["asset"]["version"];
  if (!version.text().starts_with("2.")) {
    version.refuse(fmt::format("glTF {}, not 2.0", version.text().substr(0, 40)),
                   "export the scene as glTF 2.0");
  }
  if (root().has("extensionsRequired")) {
    for (const JsonValue& extension : root()["extensionsRequired"].elements()) {
      if (!is_known(extension.text())) {
        extension.refuse(
            fmt::format(
                "the file cannot be shown without the extension {}, which haarlight does "
                "not read",
                extension.text().substr(0, 80)),
            extension.text().find("compression") != std::string::npos
                ? "export the scene without compression"
                : "export the scene without it");
      }
    }
  }
  const auto fill = [](const JsonValue& of, std::string_view key,
                       std::vector<JsonValue>& list) {
    if (of.has(key)) {
      list = of[key].elements();
    }
    for (const JsonValue& entry : list) {
      if (!entry.is_object()) {
        entry.refuse("expected an object", kExportAgain);
      }
    }
  };
  fill(root(), "accessors", accessors);
  fill(root(), "bufferViews", buffer_views);
  fill(root(), "buffers", buffers);
  fill(root(), "cameras", cameras);
  fill(root(), "images", images);
  fill(root(), "materials", materials);
  fill(root(), "meshes", meshes);
  fill(root(), "nodes", nodes);
  fill(root(), "samplers", samplers);
  fill(root(), "scenes", scenes);
  fill(root(), "textures", textures);
  if (root().has("extensions") && root()["extensions"].has("KHR_lights_punctual")) {
    fill(root()["extensions"]["KHR_lights_punctual"], "lights", lights);
  }
  contents_.resize(buffers.size());
}

/// @return  the JSON
std::string_view GltfDocument::open_container(std::string_view bytes) {
  if (!bytes.starts_with("glTF")) {
    return bytes;
  }
  constexpr std::size_t kHeader = 12;
  constexpr std::size_t kChunkHeader = 8;
  const auto refuse = [&](std::size_t at, const std::string& what, const char* hint) {
    throw Error(what, fmt::format("{}: byte {}", name_, at), hint);
  };
  constexpr const char* kCut = "the file was cut or damaged: copy it again, or export it again";
  if (bytes.size() < kHeader + kChunkHeader) {
    refuse(bytes.size(), "the file ends within its header", kCut);
  }
  if (little_endian(bytes, 4) != 2) {
    refuse(4, fmt::format("a .glb of version {}, not 2", little_endian(bytes, 4)),
           "export the scene as glTF 2.0");
  }
  const std::size_t length = little_endian(bytes, 8);
  if (length > bytes.size()) {
    refuse(8, fmt::format("{} bytes by its header, but there are {}", length, bytes.size()),
           kCut);
  }
  bytes = bytes.substr(0, length);
  std::optional<std::string_view> json;
  constexpr std::uint32_t kJson = 0x4e4f534a;
  constexpr std::uint32_t kBinary = 0x004e4942;
  for (std::size_t at = kHeader; at + kChunkHeader <= bytes.size();) {
    const std::size_t size = little_endian(bytes, at);
    const std::uint32_t kind = little_endian(bytes, at + 4);
    if (size > bytes.size() - at - kChunkHeader) {
      refuse(at, fmt::format("a chunk of {} bytes, which are not there", size), kCut);
    }
    const std::string_view chunk = bytes.substr(at + kChunkHeader, size);
    if (!json && kind != kJson) {
      refuse(at + 4, "the first chunk is not JSON", kCut);
    }
    if (!json) {
      json = chunk;
    } else if (kind == kBinary && !binary_chunk_) {
      binary_chunk_ = chunk;
    }
    at += kChunkHeader + size;
  }
  if (!json) {
    refuse(kHeader, "the file has no JSON chunk", kCut);
  }
  return *json;
}

std::vector<std::string> GltfDocument::unknown_extensions() const {
  std::vector<std::string> unknown;
  if (root().has("extensionsUsed")) {
    for (const JsonValue& extension : root()["extensionsUsed"].elements()) {
      if (!is_known(extension.text())) {
        unknown.push_back(extension.text().substr(0, 80));
      }
    }
  }
  return unknown;
}

std::size_t GltfDocument::number_of(const JsonValue& index,
                                    const std::vector<JsonValue>& list) const {
  const std::int64_t number = index.integer(0, std::numeric_limits<std::int64_t>::max());
  if (number >= static_cast<std::int64_t>(list.size())) {
    index.refuse(fmt::format("number {}, counted from 0, of {}", number, list.size()),
                 kExportAgain);
  }
  return static_cast<std::size_t>(number);
}

std::filesystem::path GltfDocument::path_of(const JsonValue& uri,
                                            const std::string& text) const {
  const std::size_t colon = text.find(':');
  if (colon != std::string::npos && colon > 1 && text.find('/') > colon) {
    uri.refuse(fmt::format("no file: {}", text.substr(0, 80)),
               "export the scene with its files beside it, or as one .glb");
  }
  const std::string name = without_percent_codes(text);
  if (folder_.empty() || name.empty() || name.find('\0') != std::string::npos) {
    uri.refuse("names no file that can be read here", "export the scene as one .glb");
  }
  return (folder_ / name).lexically_normal();
}

std::string_view GltfDocument::buffer(std::size_t number) {
  Buffer& content = contents_[number];
  if (content.is_read) {
    return content.bytes;
  }
  const JsonValue& json = buffers[number];
  const auto length = static_cast<std::size_t>(json["byteLength"].integer(1, kMostBytes));
  if (!json.has("uri")) {
    if (number != 0 || !binary_chunk_) {
      json.refuse("a buffer without a uri, and no binary chunk of a .glb for it",
                  "a .glb that was renamed, or cut after its JSON: export the scene again");
    }
    content.bytes = *binary_chunk_;
  } else {
    const JsonValue uri = json["uri"];
    const std::string text = uri.text();
    if (is_data(text)) {
      content.decoded = bytes_of_data(uri, text);
      content.bytes = content.decoded;
    } else {
      const std::filesystem::path path = path_of(uri, text);
      try {
        content.file = MappedFile(path);
      } catch (const Error& error) {
        throw Error(fmt::format("{} ({})", error.problem(), error.where()), uri.location(),
                    "put the file where the scene names it, or export the scene as one .glb",
                    error.code());
      }
      content.bytes = {reinterpret_cast<const char*>(content.file.bytes().data()),
                       content.file.bytes().size()};
      files_.push_back(path.string());
    }
  }
  if (content.bytes.size() < length) {
    json.refuse(
        fmt::format("{} bytes by byteLength, but there are {}", length, content.bytes.size()),
        "the file was cut: copy it again, or export the scene again");
  }
  content.bytes = content.bytes.substr(0, length);
  content.is_read = true;
  return content.bytes;
}

std::string_view GltfDocument::view(const JsonValue& index) {
  const JsonValue& json = buffer_views[number_of(index, buffer_views)];
  const std::string_view bytes = buffer(number_of(json["buffer"], buffers));
  const auto offset = static_cast<std::size_t>(
      json.has("byteOffset") ? json["byteOffset"].integer(0, kMostBytes) : 0);
  const auto length = static_cast<std::size_t>(json["byteLength"].integer(1, kMostBytes));
  if (offset + length > bytes.size()) {
    json.refuse(
        fmt::format("bytes {} to {} of a buffer of {}", offset, offset + length, bytes.size()),
        kExportAgain);
  }
  return bytes.substr(offset, length);
}

GltfDocument::Layout GltfDocument::layout(const JsonValue& object, const JsonValue& view_index,
                                          std::size_t count, std::size_t size,
                                          bool may_be_strided) {
  const std::string_view bytes = view(view_index);
  const JsonValue& json = buffer_views[number_of(view_index, buffer_views)];
  const auto stride = may_be_strided && json.has("byteStride")
                          ? static_cast<std::size_t>(json["byteStride"].integer(1, 252))
                          : size;
  const auto offset = static_cast<std::size_t>(
      object.has("byteOffset") ? object["byteOffset"].integer(0, kMostBytes) : 0);
  if (stride < size || offset + stride * (count - 1) + size > bytes.size()) {
    object.refuse(
        fmt::format("{} elements of {} bytes from byte {} on, {} apart, in a view of {}", count,
                    size, offset, stride, bytes.size()),
        kExportAgain);
  }
  return {.bytes = bytes.substr(offset), .stride = stride};
}

GltfNumbers GltfDocument::numbers(const JsonValue& index, std::string_view type) {
  const JsonValue& json = accessors[number_of(index, accessors)];
  if (json["type"].text() != type) {
    json["type"].refuse(fmt::format("\"{}\", where {} wants {}",
                                    json["type"].text().substr(0, 40), index.location(), type),
                        kExportAgain);
  }
  GltfNumbers read;
  read.width = width_of(json["type"]);
  read.count = static_cast<std::size_t>(json["count"].integer(1, std::int64_t{1} << 32U));
  const int component_type = component_type_of(json["componentType"]);
  const std::size_t n_bytes = size_of(component_type);
  const bool is_normalised = json.has("normalized") && json["normalized"].truth();
  std::optional<Layout> place;
  if (json.has("bufferView")) {
    place = layout(json, json["bufferView"], read.count, read.width * n_bytes, true);
  }
  constexpr std::size_t kMostZeros = std::size_t{1} << 20U;
  if (!place && read.count > kMostZeros) {
    json.refuse(fmt::format("{} elements without bytes for them: all are 0", read.count),
                kExportAgain);
  }
  if (read.count > room_for_numbers_ / read.width) {
    json.refuse("more numbers than are read of one scene", "make the scene smaller");
  }
  room_for_numbers_ -= read.count * read.width;
  read.values.assign(read.count * read.width, 0.0);
  for (std::size_t i = 0; place && i < read.count; ++i) {
    for (std::size_t c = 0; c < read.width; ++c) {
      read.values[i * read.width + c] = component_at(
          place->bytes.data() + i * place->stride + c * n_bytes, component_type, is_normalised);
    }
  }
  if (json.has("sparse")) {
    apply_sparse(json, read, component_type, is_normalised);
  }
  for (std::size_t i = 0; i < read.values.size(); ++i) {
    if (!std::isfinite(read.values[i])) {
      json.refuse(fmt::format("its element {} is not a finite number", i / read.width),
                  "repair the mesh in the program that made it, and export it again");
    }
  }
  return read;
}

void GltfDocument::apply_sparse(const JsonValue& accessor, GltfNumbers& numbers,
                                int component_type, bool is_normalised) {
  const JsonValue sparse = accessor["sparse"];
  const auto count = static_cast<std::size_t>(
      sparse["count"].integer(1, static_cast<std::int64_t>(numbers.count)));
  const JsonValue indices = sparse["indices"];
  const int index_type = component_type_of(indices["componentType"]);
  const std::size_t n_bytes = size_of(component_type);
  const Layout at = layout(indices, indices["bufferView"], count, size_of(index_type), false);
  const JsonValue values = sparse["values"];
  const Layout from =
      layout(values, values["bufferView"], count, numbers.width * n_bytes, false);
  for (std::size_t i = 0; i < count; ++i) {
    const double index = component_at(at.bytes.data() + i * at.stride, index_type, false);
    if (!(index >= 0.0 && index < static_cast<double>(numbers.count))) {
      indices.refuse(fmt::format("its index {} is {}, of {} elements", i, index, numbers.count),
                     kExportAgain);
    }
    for (std::size_t c = 0; c < numbers.width; ++c) {
      numbers.values[static_cast<std::size_t>(index) * numbers.width + c] = component_at(
          from.bytes.data() + i * from.stride + c * n_bytes, component_type, is_normalised);
    }
  }
}

GltfDocument::Picture GltfDocument::picture(const JsonValue& image) {
  if (image.has("bufferView")) {
    return {.bytes = std::make_shared<const std::string>(view(image["bufferView"])),
            .file = image.location()};
  }
  const JsonValue uri = image["uri"];
  const std::string text = uri.text();
  if (is_data(text)) {
    return {.bytes = std::make_shared<const std::string>(bytes_of_data(uri, text)),
            .file = image.location()};
  }
  return {.bytes = nullptr, .file = path_of(uri, text).string()};
}

}  // namespace haarlight::render
