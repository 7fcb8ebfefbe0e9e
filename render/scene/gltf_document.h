// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/json_value.h"
#include "haarlight/core/files.h"

/// @file
/// A glTF 2.0 file [Gltf21] as far as it is JSON and bytes: its container, buffers, views and
/// accessors, each held to its limits before it is read. docs/decisions/0016-gltf-by-our-own-reader.md
/// says why no library does that.

namespace haarlight::render {

/// The numbers of an accessor, normalised where it says so: `width` for each of `count`.
struct GltfNumbers {
  std::size_t count = 0;
  std::size_t width = 1;
  std::vector<double> values;

  [[nodiscard]] double operator()(std::size_t i, std::size_t component) const {
    return values[i * width + component];
  }
};

class GltfDocument {
 public:
  /// @param bytes        of the file, .glb or .gltf; must outlive this
  /// @param name         for errors
  /// @param folder       of files it names; empty: they are not read
  /// @param max_numbers  that all accessors that are read may have together
  /// @throws Error  no glTF 2.0, an extension that is required and not read
  GltfDocument(std::string_view bytes, std::string name, std::filesystem::path folder,
               std::size_t max_numbers);

  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] const JsonValue& root() const noexcept { return *root_; }
  /// Names of the extensions that the file uses and that are not read.
  [[nodiscard]] std::vector<std::string> unknown_extensions() const;

  std::vector<JsonValue> accessors;
  std::vector<JsonValue> buffer_views;
  std::vector<JsonValue> buffers;
  std::vector<JsonValue> cameras;
  std::vector<JsonValue> images;
  std::vector<JsonValue> lights;
  std::vector<JsonValue> materials;
  std::vector<JsonValue> meshes;
  std::vector<JsonValue> nodes;
  std::vector<JsonValue> samplers;
  std::vector<JsonValue> scenes;
  std::vector<JsonValue> textures;

  /// @param index  a value that is the number of an entry of `list` @throws Error  of none
  [[nodiscard]] std::size_t number_of(const JsonValue& index,
                                      const std::vector<JsonValue>& list) const;

  /// @param index  of an accessor @param type  "SCALAR", "VEC2", "VEC3"
  /// @throws Error  another type, bytes that are not there, a number that is not finite
  [[nodiscard]] GltfNumbers numbers(const JsonValue& index, std::string_view type);

  /// The bytes of an image within the file, or nothing: `file` is its path then.
  struct Picture {
    std::shared_ptr<const std::string> bytes;
    std::string file;
  };
  [[nodiscard]] Picture picture(const JsonValue& image);

  /// The files that were read beside it.
  [[nodiscard]] const std::vector<std::string>& files() const noexcept { return files_; }

 private:
  struct Buffer {
    bool is_read = false;
    std::string decoded;
    MappedFile file;
    std::string_view bytes;
  };
  /// Where numbers lie, how far apart.
  struct Layout {
    std::string_view bytes;
    std::size_t stride;
  };

  std::string_view open_container(std::string_view bytes);
  std::string_view buffer(std::size_t number);
  std::string_view view(const JsonValue& index);
  /// @param object  that has the byteOffset @param size  of one element, bytes
  Layout layout(const JsonValue& object, const JsonValue& view_index, std::size_t count,
                std::size_t size, bool may_be_strided);
  void apply_sparse(const JsonValue& accessor, GltfNumbers& numbers, int component_type,
                    bool is_normalised);
  [[nodiscard]] std::filesystem::path path_of(const JsonValue& uri,
                                              const std::string& text) const;

  std::string name_;
  std::filesystem::path folder_;
  std::size_t room_for_numbers_;
  std::optional<std::string_view> binary_chunk_;
  std::optional<JsonValue> root_;
  std::vector<Buffer> contents_;  ///< of buffers
  std::vector<std::string> files_;
};

}  // namespace haarlight::render
