// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene_io.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

static_assert(std::endian::native == std::endian::little, "binary PLY is read in place");

enum class Number { i8, u8, i16, u16, i32, u32, f32, f64 };

std::optional<Number> number_type(std::string_view word) {
  constexpr std::array<std::pair<std::string_view, Number>, 16> kNames = {
      {{"char", Number::i8},
       {"int8", Number::i8},
       {"uchar", Number::u8},
       {"uint8", Number::u8},
       {"short", Number::i16},
       {"int16", Number::i16},
       {"ushort", Number::u16},
       {"uint16", Number::u16},
       {"int", Number::i32},
       {"int32", Number::i32},
       {"uint", Number::u32},
       {"uint32", Number::u32},
       {"float", Number::f32},
       {"float32", Number::f32},
       {"double", Number::f64},
       {"float64", Number::f64}}};
  for (const auto& [name, type] : kNames) {
    if (name == word) {
      return type;
    }
  }
  return std::nullopt;
}

struct Property {
  std::string name;
  Number type = Number::f32;
  bool is_list = false;
  Number count_type = Number::u8;
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

class PlyReader {
 public:
  PlyReader(std::string_view bytes, std::string name) : bytes_(bytes), name_(std::move(name)) {}

  Scene read() {
    read_header();
    Mesh mesh;
    mesh.name = "ply";
    for (const Element& element : elements_) {
      // Each item takes at least one byte, so a count beyond the file's size is invalid.
      if (element.count > bytes_.size() && !element.properties.empty()) {
        fail_here(fmt::format("{} items of '{}' in a file of {} bytes", element.count,
                              element.name, bytes_.size()),
                  "the file is cut short or its header is wrong");
      }
      if (element.properties.empty()) {
        continue;
      }
      if (element.name == "vertex") {
        read_vertices(element, mesh);
      } else if (element.name == "face") {
        read_faces(element, mesh);
      } else {
        for (std::uint64_t i = 0; i < element.count; ++i) {
          skip_item(element);
        }
      }
    }
    if (mesh.triangles.empty()) {
      throw Error("the file holds no triangles", name_, "export the mesh with its faces");
    }
    if (n_degenerate_ > 0) {
      log_warning(fmt::format("{}: {} triangles without area left out", name_, n_degenerate_));
    }
    Scene scene;
    scene.materials.emplace_back();
    scene.materials.back().name = "default";
    scene.meshes.push_back(std::move(mesh));
    return scene;
  }

 private:
  [[noreturn]] void fail_here(const std::string& what, const std::string& hint) const {
    const std::string where =
        is_ascii_ ? fmt::format("{}:{}", name_, line_) : fmt::format("{}: byte {}", name_, at_);
    throw Error(what, where, hint);
  }

  std::string_view next_line() {
    if (at_ >= bytes_.size()) {
      fail_here("the file ends too early", "the file is cut short: copy it again");
    }
    const std::size_t end = std::min(bytes_.find('\n', at_), bytes_.size());
    std::string_view line = bytes_.substr(at_, end - at_);
    at_ = std::min(end + 1, bytes_.size());
    ++line_;
    if (!line.empty() && line.back() == '\r') {
      line.remove_suffix(1);
    }
    return line;
  }

  static std::vector<std::string_view> words_of(std::string_view line) {
    std::vector<std::string_view> words;
    std::size_t begin = 0;
    while (begin < line.size()) {
      const std::size_t end = std::min(line.find(' ', begin), line.size());
      if (end > begin) {
        words.push_back(line.substr(begin, end - begin));
      }
      begin = end + 1;
    }
    return words;
  }

  void read_header() {
    if (next_line() != "ply") {
      fail_here("not a PLY file", "its first line must be 'ply'");
    }
    bool has_format = false;
    bool is_binary = false;
    for (std::string_view line = next_line(); line != "end_header"; line = next_line()) {
      const std::vector<std::string_view> words = words_of(line);
      if (words.empty() || words[0] == "comment" || words[0] == "obj_info") {
        continue;
      }
      if (words[0] == "format" && words.size() == 3) {
        if (words[1] != "ascii" && words[1] != "binary_little_endian") {
          fail_here(fmt::format("format '{}' is not read", words[1].substr(0, 40)),
                    "save as ascii or binary_little_endian");
        }
        is_binary = words[1] != "ascii";
        has_format = true;
      } else if (words[0] == "element" && words.size() == 3) {
        Element element;
        element.name = std::string(words[1]);
        const auto [end, error] =
            std::from_chars(words[2].data(), words[2].data() + words[2].size(), element.count);
        if (error != std::errc{} || end != words[2].data() + words[2].size()) {
          fail_here("an element's count is not a number", "correct the header");
        }
        elements_.push_back(std::move(element));
      } else if (words[0] == "property" && !elements_.empty() && words.size() >= 3) {
        add_property(words);
      } else {
        fail_here(fmt::format("'{}' is not understood in a PLY header", line.substr(0, 60)),
                  "correct the header");
      }
    }
    if (!has_format) {
      fail_here("the header names no format", "add 'format ascii 1.0'");
    }
    is_ascii_ = !is_binary;
  }

  void add_property(const std::vector<std::string_view>& words) {
    Property property;
    property.is_list = words[1] == "list";
    if (property.is_list && words.size() != 5) {
      fail_here("a list property has five words", "property list COUNT_TYPE TYPE NAME");
    }
    const std::optional<Number> type = number_type(property.is_list ? words[3] : words[1]);
    const std::optional<Number> count_type =
        property.is_list ? number_type(words[2]) : std::optional(Number::u8);
    if (!type || !count_type || *count_type == Number::f32 || *count_type == Number::f64) {
      fail_here("a property's type is not known",
                "use char, uchar, short, ushort, int, uint, "
                "float or double");
    }
    property.type = *type;
    property.count_type = *count_type;
    property.name = std::string(words.back());
    elements_.back().properties.push_back(std::move(property));
  }

  template <class T>
  double take_binary() {
    if (bytes_.size() - at_ < sizeof(T)) {
      fail_here("the file ends too early", "the file is cut short: copy it again");
    }
    T value{};
    std::memcpy(&value, bytes_.data() + at_, sizeof(T));
    at_ += sizeof(T);
    return static_cast<double>(value);
  }

  double take_ascii() {
    while (at_ < bytes_.size() && (bytes_[at_] == ' ' || bytes_[at_] == '\n' ||
                                   bytes_[at_] == '\r' || bytes_[at_] == '\t')) {
      line_ += bytes_[at_] == '\n' ? 1 : 0;
      ++at_;
    }
    double value = 0.0;
    const char* begin = bytes_.data() + at_;
    const char* limit = bytes_.data() + bytes_.size();
    const auto [end, error] = std::from_chars(begin, limit, value);
    if (error != std::errc{} || end == begin) {
      fail_here(at_ == bytes_.size() ? "the file ends too early" : "not a number",
                "the file is cut short or damaged: export it again");
    }
    at_ += static_cast<std::size_t>(end - begin);
    return value;
  }

  double take(Number type) {
    if (is_ascii_) {
      return take_ascii();
    }
    switch (type) {
      case Number::i8:
        return take_binary<std::int8_t>();
      case Number::u8:
        return take_binary<std::uint8_t>();
      case Number::i16:
        return take_binary<std::int16_t>();
      case Number::u16:
        return take_binary<std::uint16_t>();
      case Number::i32:
        return take_binary<std::int32_t>();
      case Number::u32:
        return take_binary<std::uint32_t>();
      case Number::f32:
        return take_binary<float>();
      case Number::f64:
        return take_binary<double>();
    }
    return 0.0;
  }

  std::uint64_t take_count(const Property& property) {
    const double count = take(property.count_type);
    if (!(count >= 0.0 && count <= 1e6) || count != std::floor(count)) {
      fail_here(fmt::format("a list of {} items", count),
                "the file is damaged: export it again");
    }
    return static_cast<std::uint64_t>(count);
  }

  void skip_item(const Element& element) {
    for (const Property& property : element.properties) {
      const std::uint64_t n = property.is_list ? take_count(property) : 1;
      for (std::uint64_t i = 0; i < n; ++i) {
        take(property.type);
      }
    }
  }

  /// Of the last property of that name that is no list, or -1.
  static int property_of(const Element& element, std::string_view name) {
    int index = -1;
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      if (element.properties[p].name == name && !element.properties[p].is_list) {
        index = static_cast<int>(p);
      }
    }
    return index;
  }

  /// Indices of the properties that hold texture coordinates, by any of their usual names.
  static std::optional<std::array<std::size_t, 2>> uv_of(const Element& element) {
    constexpr auto kNames = std::to_array<std::array<std::string_view, 2>>(
        {{"u", "v"}, {"s", "t"}, {"texture_u", "texture_v"}});
    for (const auto& [u_name, v_name] : kNames) {
      const int u = property_of(element, u_name);
      const int v = property_of(element, v_name);
      if (u >= 0 && v >= 0) {
        return std::array{static_cast<std::size_t>(u), static_cast<std::size_t>(v)};
      }
    }
    return std::nullopt;
  }

  void read_vertices(const Element& element, Mesh& mesh) {
    constexpr std::array<std::string_view, 6> kNames = {"x", "y", "z", "nx", "ny", "nz"};
    std::array<int, 6> indices{};
    for (std::size_t i = 0; i < kNames.size(); ++i) {
      indices.at(i) = property_of(element, kNames.at(i));
    }
    if (indices[0] < 0 || indices[1] < 0 || indices[2] < 0) {
      fail_here("vertices without x, y and z", "export the mesh with its positions");
    }
    const bool has_normals = indices[3] >= 0 && indices[4] >= 0 && indices[5] >= 0;
    const std::optional<std::array<std::size_t, 2>> uv_indices = uv_of(element);
    std::vector<double> values(element.properties.size());
    for (std::uint64_t i = 0; i < element.count; ++i) {
      for (std::size_t p = 0; p < element.properties.size(); ++p) {
        const Property& property = element.properties[p];
        const std::uint64_t n = property.is_list ? take_count(property) : 1;
        for (std::uint64_t k = 0; k < n; ++k) {
          values[p] = take(property.type);
        }
      }
      const auto vector_at = [&](std::size_t first) {
        return Vector3d(values[static_cast<std::size_t>(indices.at(first))],
                        values[static_cast<std::size_t>(indices.at(first + 1))],
                        values[static_cast<std::size_t>(indices.at(first + 2))]);
      };
      const Vector3d position = vector_at(0);
      if (!position.allFinite()) {
        fail_here(fmt::format("vertex {} is not finite", i), "repair the mesh before export");
      }
      mesh.vertices.push_back(position);
      if (has_normals) {
        const Vector3d n = vector_at(3);
        const double length = n.norm();
        if (!(length > 0.0) || !std::isfinite(length)) {
          fail_here(fmt::format("vertex {} has no usable normal", i),
                    "recompute the normals on export, or leave them out");
        }
        mesh.normals.emplace_back(n / length);
      }
      if (uv_indices) {
        const Eigen::Vector2d uv(values[uv_indices->at(0)], values[uv_indices->at(1)]);
        if (!(uv.cwiseAbs().maxCoeff() <= kMaxUv)) {
          fail_here(fmt::format("vertex {} has no usable texture coordinates", i),
                    "give finite numbers, at most 1e9 in size, or leave them out");
        }
        mesh.uvs.push_back(uv);
      }
    }
  }

  int take_index(const Property& property, std::uint64_t face, std::size_t n_vertices) {
    const double value = take(property.type);
    if (!(value >= 0.0 && value < static_cast<double>(n_vertices)) ||
        value != std::floor(value)) {
      fail_here(fmt::format("face {} names vertex {} of {}", face, value, n_vertices),
                "indices count from 0 to the number of vertices minus 1");
    }
    return static_cast<int>(value);
  }

  void read_faces(const Element& element, Mesh& mesh) {
    std::vector<int> corners;
    for (std::uint64_t i = 0; i < element.count; ++i) {
      bool has_corners = false;
      for (const Property& property : element.properties) {
        const std::uint64_t n = property.is_list ? take_count(property) : 1;
        if (property.name == "vertex_indices" || property.name == "vertex_index") {
          corners.clear();
          for (std::uint64_t k = 0; k < n; ++k) {
            corners.push_back(take_index(property, i, mesh.vertices.size()));
          }
          has_corners = true;
        } else {
          for (std::uint64_t k = 0; k < n; ++k) {
            take(property.type);
          }
        }
      }
      if (!has_corners || corners.size() < 3) {
        fail_here(fmt::format("face {} has {} corners", i, corners.size()),
                  "a face needs vertex_indices of three corners or more");
      }
      for (std::size_t k = 1; k + 1 < corners.size(); ++k) {
        add_triangle(mesh, {corners[0], corners[k], corners[k + 1]});
      }
    }
  }

  void add_triangle(Mesh& mesh, const Eigen::Vector3i& t) {
    const auto at = [&](int i) -> const Vector3d& {
      return mesh.vertices[static_cast<std::size_t>(t[i])];
    };
    const double area2 = (at(1) - at(0)).cross(at(2) - at(0)).norm();
    if (!std::isfinite(area2)) {
      fail_here("a triangle too large for the numbers used", "scale the mesh down");
    }
    if (area2 == 0.0) {
      ++n_degenerate_;
      return;
    }
    mesh.triangles.push_back(t);
  }

  std::string_view bytes_;
  std::string name_;
  std::size_t at_ = 0;
  int line_ = 0;
  bool is_ascii_ = true;
  std::vector<Element> elements_;
  std::size_t n_degenerate_ = 0;
};

}  // namespace

Scene parse_ply(std::string_view bytes, const std::string& name) {
  return PlyReader(bytes, name).read();
}

Scene read_ply(const std::filesystem::path& path) {
  const MappedFile file(path);
  const auto bytes = file.bytes();
  return parse_ply({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path.string());
}

}  // namespace haarlight::render
