// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <tuple>

#include <fmt/format.h>

#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene_io.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

/// Takes the next word off the front of a line; empty at its end.
std::string_view next_word(std::string_view& line) {
  std::size_t begin = 0;
  while (begin < line.size() && is_blank(line[begin])) {
    ++begin;
  }
  std::size_t end = begin;
  while (end < line.size() && !is_blank(line[end])) {
    ++end;
  }
  const std::string_view word = line.substr(begin, end - begin);
  line.remove_prefix(end);
  return word;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) {
    text.remove_prefix(1);
  }
  while (!text.empty() && is_blank(text.back())) {
    text.remove_suffix(1);
  }
  return text;
}

std::optional<double> to_number(std::string_view word) {
  double value = 0.0;
  if (!word.empty() && word.front() == '+') {
    word.remove_prefix(1);
  }
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc{} || end != word.data() + word.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

/// One corner of a face: indices into v, vn and vt, from 0; -1 when it has none.
struct Corner {
  int vertex = 0;
  int normal = -1;
  int uv = -1;
};

class ObjReader {
 public:
  ObjReader(std::string name, std::filesystem::path folder)
      : name_(std::move(name)), folder_(std::move(folder)) {}

  Scene read(std::string_view text) {
    while (!text.empty()) {
      const std::size_t end = text.find('\n');
      std::string_view line = text.substr(0, end);
      text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
      ++line_;
      line = line.substr(0, line.find('#'));
      read_line(line);
    }
    if (n_triangles_ == 0) {
      throw Error("the file holds no triangles", name_,
                  "export the mesh with faces (lines that begin with f)");
    }
    if (n_degenerate_ > 0) {
      log_warning(fmt::format("{}: {} triangles without area left out", name_, n_degenerate_));
    }
    return std::move(scene_);
  }

 private:
  [[noreturn]] void fail_here(const std::string& what, const std::string& hint) const {
    throw Error(what, fmt::format("{}:{}", name_, line_), hint);
  }

  [[nodiscard]] Vector3d read_vector(std::string_view line) const {
    Vector3d v;
    for (int i = 0; i < 3; ++i) {
      const std::string_view word = next_word(line);
      const std::optional<double> value = to_number(word);
      if (!value) {
        fail_here(fmt::format("'{}' is not a finite number", word.substr(0, 40)),
                  "give three finite numbers, separated by spaces");
      }
      v[i] = *value;
    }
    return v;
  }

  /// `u [v [w]]`; w is not used.
  [[nodiscard]] Vector2d read_uv(std::string_view line) const {
    Vector2d uv = Vector2d::Zero();
    std::string_view word = next_word(line);
    for (int i = 0; i < 2 && (i == 0 || !word.empty()); ++i) {
      const std::optional<double> value = to_number(word);
      if (!value || std::abs(*value) > kMaxUv) {
        fail_here(fmt::format("'{}' is no texture coordinate", word.substr(0, 40)),
                  "give one or two finite numbers, at most 1e9 in size");
      }
      uv[i] = *value;
      word = next_word(line);
    }
    return uv;
  }

  void read_line(std::string_view line) {
    const std::string_view word = next_word(line);
    if (word == "v") {
      vertices_.emplace_back(read_vector(line));
    } else if (word == "vn") {
      Vector3d n = read_vector(line);
      const double length = n.norm();
      if (!(length > 0.0) || !std::isfinite(length)) {
        fail_here("a normal of length zero or beyond range", "recompute the normals on export");
      }
      normals_.emplace_back(n / length);
    } else if (word == "vt") {
      uvs_.emplace_back(read_uv(line));
    } else if (word == "f") {
      read_face(line);
    } else if (word == "usemtl") {
      use_material(std::string(trimmed(line)));
    } else if (word == "o" || word == "g") {
      part_ = std::string(trimmed(line));
      parts_.clear();
    } else if (word == "mtllib" && !folder_.empty()) {
      read_mtl(std::string(trimmed(line)));
    }
    // Everything else (s, l, ...) is irrelevant to triangles.
  }

  [[nodiscard]] int to_index(std::string_view word, std::size_t count, const char* kind) const {
    int index = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), index);
    if (error != std::errc{} || end != word.data() + word.size() || index == 0) {
      fail_here(fmt::format("'{}' is not the index of a {}", word.substr(0, 40), kind),
                "indices count from 1, or backwards from -1");
    }
    const auto n = static_cast<std::int64_t>(count);
    const std::int64_t from_zero = index > 0 ? index - std::int64_t{1} : n + index;
    if (from_zero < 0 || from_zero >= n) {
      fail_here(fmt::format("{} {} of {}", kind, index, count),
                "an index must name a line that stands above the face");
    }
    return static_cast<int>(from_zero);
  }

  void read_face(std::string_view line) {
    std::vector<Corner> corners;
    std::vector<std::string_view> uv_words;
    for (std::string_view word = next_word(line); !word.empty(); word = next_word(line)) {
      Corner corner;
      const std::size_t slash = word.find('/');
      corner.vertex = to_index(word.substr(0, slash), vertices_.size(), "vertex");
      if (slash != std::string_view::npos) {
        const std::size_t second = word.find('/', slash + 1);
        const std::string_view uv = word.substr(slash + 1, second - slash - 1);
        if (!uv.empty()) {
          uv_words.push_back(uv);
        }
        if (second != std::string_view::npos && second + 1 < word.size()) {
          corner.normal = to_index(word.substr(second + 1), normals_.size(), "normal");
        }
      }
      corners.push_back(corner);
    }
    if (corners.size() < 3) {
      fail_here(fmt::format("a face of {} corners", corners.size()),
                "a face needs three corners or more");
    }
    const bool has_normals = std::all_of(corners.begin(), corners.end(),
                                         [](const Corner& c) { return c.normal >= 0; });
    const bool has_uvs = uv_words.size() == corners.size();
    for (std::size_t i = 0; i < corners.size(); ++i) {
      corners[i].normal = has_normals ? corners[i].normal : -1;
      corners[i].uv = has_uvs ? to_index(uv_words[i], uvs_.size(), "texture coordinate") : -1;
    }
    Part& part = part_for(has_normals, has_uvs);
    for (std::size_t i = 1; i + 1 < corners.size(); ++i) {
      add_triangle(part, {corners[0], corners[i], corners[i + 1]});
    }
  }

  struct Part {
    std::size_t mesh = 0;
    std::map<std::array<int, 3>, int> shared;  ///< (v, vn, vt) -> vertex of the mesh
  };

  Part& part_for(bool has_normals, bool has_uvs) {
    const auto [position, is_new] =
        parts_.try_emplace(std::make_tuple(material_index(), has_normals, has_uvs));
    if (is_new) {
      position->second.mesh = scene_.meshes.size();
      Mesh mesh;
      mesh.name = part_;
      mesh.material = material_;
      scene_.meshes.push_back(std::move(mesh));
    }
    return position->second;
  }

  void add_triangle(Part& part, const std::array<Corner, 3>& corners) {
    const auto at = [&](std::size_t i) -> const Vector3d& {
      return vertices_[static_cast<std::size_t>(corners.at(i).vertex)];
    };
    const double area2 = (at(1) - at(0)).cross(at(2) - at(0)).norm();
    if (!std::isfinite(area2)) {
      fail_here("a triangle too large for the numbers used", "scale the mesh down");
    }
    if (area2 == 0.0) {
      ++n_degenerate_;
      return;
    }
    Mesh& mesh = scene_.meshes[part.mesh];
    Eigen::Vector3i triangle;
    for (int i = 0; i < 3; ++i) {
      const Corner& corner = corners.at(static_cast<std::size_t>(i));
      const auto [position, is_new] = part.shared.try_emplace(
          {corner.vertex, corner.normal, corner.uv}, static_cast<int>(mesh.vertices.size()));
      if (is_new) {
        mesh.vertices.push_back(vertices_[static_cast<std::size_t>(corner.vertex)]);
        if (corner.normal >= 0) {
          mesh.normals.push_back(normals_[static_cast<std::size_t>(corner.normal)]);
        }
        if (corner.uv >= 0) {
          mesh.uvs.push_back(uvs_[static_cast<std::size_t>(corner.uv)]);
        }
      }
      triangle[i] = position->second;
    }
    mesh.triangles.push_back(triangle);
    ++n_triangles_;
  }

  int material_index() {
    if (material_ < 0) {
      use_material("default");
    }
    return material_;
  }

  void use_material(const std::string& wanted) {
    const auto known = std::find_if(scene_.materials.begin(), scene_.materials.end(),
                                    [&](const Material& m) { return m.name == wanted; });
    if (known != scene_.materials.end()) {
      material_ = static_cast<int>(known - scene_.materials.begin());
      return;
    }
    Material material;
    material.name = wanted;
    const auto from_file = library_.find(wanted);
    if (from_file != library_.end()) {
      material = from_file->second;
    } else if (!decode_material_name(wanted, material) && wanted != "default") {
      log_warning(
          fmt::format("{}:{}: material '{}' is described nowhere; Lambert, kd 0.5 is used",
                      name_, line_, wanted));
    }
    material_ = static_cast<int>(scene_.materials.size());
    scene_.materials.push_back(std::move(material));
  }

  void read_mtl(const std::string& file) {
    const std::filesystem::path path = folder_ / file;
    if (!std::filesystem::exists(path)) {
      log_warning(fmt::format("{}:{}: {} is not there; materials by name", name_, line_,
                              path.string()));
      return;
    }
    const std::string text = read_file(path, std::uintmax_t{64} << 20U);
    std::string_view rest = text;
    Material* current = nullptr;
    bool has_kd = false;
    int line_number = 0;
    while (!rest.empty()) {
      const std::size_t end = rest.find('\n');
      std::string_view line = rest.substr(0, end);
      rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
      ++line_number;
      line = line.substr(0, line.find('#'));
      const std::string_view word = next_word(line);
      if (word == "newmtl") {
        const std::string material_name(trimmed(line));
        current = &library_[material_name];
        current->name = material_name;
        has_kd = false;
      } else if (current != nullptr && word == "map_Kd") {
        current->kd_texture =
            texture_of(line, fmt::format("{}:{}", path.string(), line_number));
        current->kd = has_kd ? current->kd : Vector3d::Ones();
      } else if (current != nullptr && (word == "Kd" || word == "Ks" || word == "Ns")) {
        Vector3d value;
        for (int i = 0; i < (word == "Ns" ? 1 : 3); ++i) {
          const std::optional<double> number = to_number(next_word(line));
          if (!number || *number < 0.0) {
            throw Error(fmt::format("{} needs numbers of 0 or more", word),
                        fmt::format("{}:{}", path.string(), line_number), "correct the number");
          }
          value[i] = *number;
        }
        if (word == "Kd") {
          current->kd = value;
          has_kd = true;
        } else if (word == "Ks") {
          current->ks = value.mean();
        } else {
          current->exponent = value[0];
        }
      }
    }
  }

  /// `[-s u [v [w]]] FILE`, the file's name to the line's end.
  [[nodiscard]] MaterialTexture texture_of(std::string_view line,
                                           const std::string& where) const {
    MaterialTexture texture;
    texture.where = where;
    line = trimmed(line);
    while (line.starts_with('-')) {
      const std::string_view option = next_word(line);
      if (option != "-s") {
        throw Error(fmt::format("map_Kd's option '{}' is not read", option.substr(0, 40)),
                    where, "remove it, or apply it to the picture or the texture coordinates");
      }
      for (int i = 0; i < 3; ++i) {
        std::string_view rest = line;
        const std::optional<double> number = to_number(next_word(rest));
        if (!number && i > 0) {
          break;
        }
        if (!number || std::abs(*number) > kMaxTextureScale) {
          throw Error("map_Kd's -s needs numbers, at most 1e6 in size", where,
                      "correct the number");
        }
        if (i < 2) {
          texture.scale[i] = *number;
        }
        line = rest;
      }
      line = trimmed(line);
    }
    if (line.empty()) {
      throw Error("map_Kd names no file", where, "name a picture, or remove the line");
    }
    texture.file = (folder_ / line).lexically_normal().string();
    return texture;
  }

  std::string name_;
  std::filesystem::path folder_;
  int line_ = 0;
  std::vector<Vector3d> vertices_;
  std::vector<Vector3d> normals_;
  std::vector<Vector2d> uvs_;
  std::map<std::string, Material> library_;
  std::map<std::tuple<int, bool, bool>, Part> parts_;
  std::string part_;
  int material_ = -1;
  std::size_t n_triangles_ = 0;
  std::size_t n_degenerate_ = 0;
  Scene scene_;
};

}  // namespace

bool decode_material_name(std::string_view name, Material& material) {
  Material decoded = material;
  const auto take = [&](std::string_view prefix, double& value) {
    if (name.substr(0, prefix.size()) != prefix) {
      return false;
    }
    name.remove_prefix(prefix.size());
    const std::size_t end = std::min(name.find('_'), name.size());
    const std::optional<double> number = to_number(name.substr(0, end));
    name.remove_prefix(std::min(end + 1, name.size()));
    value = number.value_or(-1.0);
    return value >= 0.0;
  };
  double kd = 0.0;
  if (!take("kd", kd) || !take("ks", decoded.ks) || !take("n", decoded.exponent)) {
    return false;
  }
  if (!name.empty() && name != "smooth") {
    return false;
  }
  decoded.kd.setConstant(kd);
  material = decoded;
  return true;
}

Scene parse_obj(std::string_view text, const std::string& name,
                const std::filesystem::path& folder) {
  return ObjReader(name, folder).read(text);
}

Scene read_obj(const std::filesystem::path& path) {
  const MappedFile file(path);
  const auto bytes = file.bytes();
  const std::filesystem::path folder = path.parent_path();
  return parse_obj({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path.string(),
                   folder.empty() ? "." : folder);
}

}  // namespace haarlight::render
