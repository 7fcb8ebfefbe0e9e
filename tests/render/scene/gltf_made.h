// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>

/// @file
/// glTF files written by hand, for tests.

namespace haarlight::render {

/// Accessors in the order in which they were added, all of them in one buffer.
class MadeGltf {
 public:
  template <class Number>
  std::size_t add(const std::vector<Number>& numbers, int component_type, std::string_view type,
                  std::size_t width, std::string_view more = "") {
    const std::size_t view = add_view(
        {reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(Number)});
    return add_accessor(
        fmt::format(R"({{"bufferView":{},"componentType":{},"count":{},"type":"{}"{}}})", view,
                    component_type, numbers.size() / width, type, more));
  }
  std::size_t add_points(const std::vector<float>& numbers) {
    return add(numbers, 5126, "VEC3", 3);
  }
  std::size_t add_uvs(const std::vector<float>& numbers) {
    return add(numbers, 5126, "VEC2", 2);
  }
  std::size_t add_indices(const std::vector<std::uint16_t>& numbers) {
    return add(numbers, 5123, "SCALAR", 1);
  }
  std::size_t add_view(std::string_view bytes, std::string_view more = "") {
    binary_.resize((binary_.size() + 3) / 4 * 4);
    views_ += fmt::format(R"({}{{"buffer":0,"byteOffset":{},"byteLength":{}{}}})",
                          n_views_ > 0 ? "," : "", binary_.size(), bytes.size(), more);
    binary_ += bytes;
    return n_views_++;
  }
  std::size_t add_accessor(std::string_view json) {
    accessors_ += fmt::format("{}{}", n_accessors_ > 0 ? "," : "", json);
    return n_accessors_++;
  }

  /// @param body  the rest of the JSON's members, after a comma
  [[nodiscard]] std::string json(std::string_view body, std::string_view uri = "",
                                 std::string_view asset = R"("version":"2.0")") const {
    return fmt::format(
        R"({{"asset":{{{}}},"buffers":[{{"byteLength":{}{}}}],"bufferViews":[{}],)"
        R"("accessors":[{}]{}}})",
        asset, binary_.size(), uri, views_, accessors_, body);
  }
  [[nodiscard]] std::string glb(std::string_view body,
                                std::string_view asset = R"("version":"2.0")") const {
    std::string text = json(body, "", asset);
    text.resize((text.size() + 3) / 4 * 4, ' ');
    std::string padded = binary_;
    padded.resize((padded.size() + 3) / 4 * 4);
    const std::string chunks =
        chunk(text, "JSON") + chunk(padded, std::string_view("BIN\0", 4));
    return "glTF" + number(2) + number(12 + chunks.size()) + chunks;
  }
  [[nodiscard]] const std::string& binary() const { return binary_; }

  [[nodiscard]] static std::string number(std::size_t value) {
    std::string bytes;
    for (unsigned i = 0; i < 4; ++i) {
      bytes.push_back(static_cast<char>(value >> (8U * i) & 0xffU));
    }
    return bytes;
  }

  [[nodiscard]] static std::string base64(std::string_view bytes) {
    constexpr std::string_view kLetters =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string text;
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
      std::uint32_t group = 0;
      for (std::size_t j = i; j < i + 3; ++j) {
        group = group << 8U | (j < bytes.size() ? static_cast<unsigned char>(bytes[j]) : 0U);
      }
      for (unsigned j = 0; j < 4; ++j) {
        text.push_back(i + j > bytes.size() ? '=' : kLetters[group >> (18U - 6U * j) & 63U]);
      }
    }
    return text;
  }

 private:
  static std::string chunk(std::string_view body, std::string_view kind) {
    return number(body.size()) + std::string(kind) + std::string(body);
  }

  std::string binary_;
  std::string views_;
  std::string accessors_;
  std::size_t n_views_ = 0;
  std::size_t n_accessors_ = 0;
};

/// A square from -1 to 1 on the floor (y = 0), its front up: accessors 0 (positions), 1 (indices)
/// and 2 (texture coordinates, the picture upright as seen from above, with north up).
inline MadeGltf made_floor() {
  MadeGltf made;
  made.add_points({-1, 0, 1, 1, 0, 1, 1, 0, -1, -1, 0, -1});
  made.add_indices({0, 1, 2, 0, 2, 3});
  made.add_uvs({0, 1, 1, 1, 1, 0, 0, 0});
  return made;
}
inline constexpr std::string_view kFloorMesh =
    R"({"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":2},"indices":1,"material":0}]})";

/// A file that shows it. @param material  its JSON @param nodes  further ones, after a comma
inline std::string floor_body(std::string_view material, std::string_view nodes = "",
                              std::string_view more = "") {
  std::string roots = "0";
  std::size_t depth = 0;
  int n = 1;
  for (const char c : nodes) {
    if (c == '{' && depth++ == 0) {
      roots += fmt::format(",{}", n++);
    }
    depth -= c == '}' ? 1 : 0;
  }
  return fmt::format(
      R"(,"scenes":[{{"nodes":[{}]}}],"nodes":[{{"mesh":0}}{}],"meshes":[{}],"materials":[{}]{})",
      roots, nodes, kFloorMesh, material, more);
}

/// Without a coat, so that it is a Lambertian surface. @param colour  "1,1,1"
inline std::string matte(std::string_view colour) {
  return fmt::format(
      R"({{"pbrMetallicRoughness":{{"baseColorFactor":[{},1],"metallicFactor":0}},)"
      R"("extensions":{{"KHR_materials_specular":{{"specularFactor":0}}}}}})",
      colour);
}

}  // namespace haarlight::render
