// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/gmsh_cursor.h"
#include "render/cell_mesh/mesh_numbers.h"

namespace haarlight::render {

namespace {

constexpr const char* kSaveAgain = "the file is damaged: save the mesh again";
constexpr const char* kSaveAs41 =
    "save as version 4.1: gmsh FILE -save -format msh41 -o NEW.msh";
constexpr const char* kSaveTogether = "save mesh and values in one file";

std::string_view shown(std::string_view text) { return text.substr(0, 60); }

constexpr std::int64_t kLastType = 140;  ///< of gmsh 4: a trihedron

std::optional<CellType> type_of(std::int64_t gmsh) {
  switch (gmsh) {
    case 4:
      return CellType::tetrahedron;
    case 5:
      return CellType::hexahedron;
    case 6:
      return CellType::wedge;
    case 7:
      return CellType::pyramid;
    case 11:
      return CellType::quadratic_tetrahedron;
    case 12:
      return CellType::triquadratic_hexahedron;
    case 17:
      return CellType::quadratic_hexahedron;
    case 18:
      return CellType::quadratic_wedge;
    case 19:
      return CellType::quadratic_pyramid;
    case 29:
      return CellType::cubic_tetrahedron;
    default:
      return std::nullopt;
  }
}

/// Of cells whose nodes gmsh has in another order than cell_mesh.h: which of its nodes each of ours is.
std::span<const std::uint8_t> order_of(CellType type) {
  // Edges 01 12 20 03 23 13.
  static constexpr auto kTetrahedron =
      std::to_array<std::uint8_t>({0, 1, 2, 3, 4, 5, 6, 7, 9, 8});
  // Edges 01 12 20 30 32 31, two on each; faces 021 013 032 312.
  static constexpr auto kCubic = std::to_array<std::uint8_t>(
      {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 10, 15, 14, 13, 12, 17, 19, 18, 16});
  // Edges 01 03 04 12 15 23 26 37 45 47 56 67; sides 0321 0154 0473 1265 2376 4567; the middle.
  static constexpr auto kHexahedron =
      std::to_array<std::uint8_t>({0,  1,  2,  3,  4,  5,  6,  7,  8,  11, 13, 9,  16, 18,
                                   19, 17, 10, 12, 14, 15, 22, 23, 21, 24, 20, 25, 26});
  // Edges 01 02 03 12 14 25 34 35 45.
  static constexpr auto kWedge =
      std::to_array<std::uint8_t>({0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11});
  // Edges 01 03 04 12 14 23 24 34.
  static constexpr auto kPyramid =
      std::to_array<std::uint8_t>({0, 1, 2, 3, 4, 5, 8, 10, 6, 7, 9, 11, 12});
  switch (type) {
    case CellType::quadratic_tetrahedron:
      return kTetrahedron;
    case CellType::cubic_tetrahedron:
      return kCubic;
    case CellType::quadratic_hexahedron:
    case CellType::triquadratic_hexahedron:
      return std::span(kHexahedron).first(shape_of(type).n_nodes);
    case CellType::quadratic_wedge:
      return kWedge;
    case CellType::quadratic_pyramid:
      return kPyramid;
    default:
      return {};
  }
}

/// Of points, lines and surfaces, which have no volume to render, the number of nodes.
std::optional<std::size_t> flat_nodes(std::int64_t gmsh) {
  constexpr std::array<std::pair<int, std::size_t>, 48> kFlat = {
      {{15, 1},  {1, 2},   {8, 3},   {26, 4},  {27, 5},  {28, 6},  {62, 7},   {63, 8},
       {64, 9},  {65, 10}, {66, 11}, {2, 3},   {9, 6},   {20, 9},  {21, 10},  {22, 12},
       {23, 15}, {24, 15}, {25, 21}, {42, 28}, {43, 36}, {44, 45}, {45, 55},  {46, 66},
       {3, 4},   {10, 9},  {16, 8},  {36, 16}, {37, 25}, {38, 36}, {39, 12},  {40, 16},
       {41, 20}, {52, 18}, {53, 21}, {54, 24}, {55, 27}, {56, 30}, {57, 24},  {58, 28},
       {59, 32}, {60, 36}, {61, 40}, {47, 49}, {48, 64}, {49, 81}, {50, 100}, {51, 121}}};
  const auto* const found = std::find_if(
      kFlat.begin(), kFlat.end(), [gmsh](const auto& item) { return item.first == gmsh; });
  return found == kFlat.end() ? std::nullopt : std::optional(found->second);
}

std::string_view solid_name(std::int64_t gmsh) {
  constexpr std::array<std::pair<int, std::string_view>, 8> kNames = {
      {{13, "prism of 18 nodes"},
       {14, "pyramid of 14 nodes"},
       {30, "tetrahedron of 35 nodes"},
       {31, "tetrahedron of 56 nodes"},
       {35, "polyhedron"},
       {71, "tetrahedron of 84 nodes"},
       {92, "hexahedron of 64 nodes"},
       {93, "hexahedron of 125 nodes"}}};
  const auto* const found = std::find_if(
      kNames.begin(), kNames.end(), [gmsh](const auto& item) { return item.first == gmsh; });
  return found == kNames.end() ? "cell of another kind" : found->second;
}

/// From the tags of nodes or elements, which may have gaps and any order, to indices.
class TagIndex {
 public:
  void add(std::uint64_t tag, std::uint32_t index) { items_.emplace_back(tag, index); }
  /// @return  a tag that stands twice
  std::optional<std::uint64_t> sort() {
    std::sort(items_.begin(), items_.end());
    const auto twice =
        std::adjacent_find(items_.begin(), items_.end(),
                           [](const auto& a, const auto& b) { return a.first == b.first; });
    return twice == items_.end() ? std::nullopt : std::optional(twice->first);
  }
  [[nodiscard]] std::optional<std::uint32_t> find(std::uint64_t tag) const {
    if (items_.empty() || tag < items_.front().first || tag > items_.back().first) {
      return std::nullopt;
    }
    // Without gaps, as gmsh numbers a new mesh, it is where it must be.
    const std::uint64_t first = items_.front().first;
    if (items_.back().first - first == items_.size() - 1) {
      return items_[tag - first].second;
    }
    const auto found =
        std::lower_bound(items_.begin(), items_.end(), tag,
                         [](const auto& item, std::uint64_t t) { return item.first < t; });
    return found->first == tag ? std::optional(found->second) : std::nullopt;
  }

  /// Of an index that was added; for messages, it is looked for.
  [[nodiscard]] std::uint64_t tag_of(std::uint32_t index) const {
    return std::find_if(items_.begin(), items_.end(),
                        [index](const auto& item) { return item.second == index; })
        ->first;
  }

 private:
  std::vector<std::pair<std::uint64_t, std::uint32_t>> items_;
};
constexpr std::uint32_t kLeftOut = std::numeric_limits<std::uint32_t>::max();

/// One $NodeData or $ElementData; several of a name and step are parts of one field.
struct TaggedValues {
  std::string name;
  std::int64_t step = 0;
  std::size_t n_components = 1;
  std::vector<std::uint64_t> tags;
  std::vector<double> values;  ///< (tags, n_components)
  std::size_t at = 0;          ///< of the section
};

class GmshReader {
 public:
  GmshReader(std::string_view bytes, const std::string& name)
      : cursor_(bytes, name), budget_(bytes.size()) {}

  CellMesh read() {
    read_format();
    while (!cursor_.is_at_end()) {
      read_section();
    }
    if (!has_nodes_ || !has_elements_) {
      cursor_.fail(fmt::format("no {} before the end", has_nodes_ ? "$Elements" : "$Nodes"),
                   has_nodes_ ? "the file is cut short: copy it again" : kSaveTogether,
                   cursor_.at());
    }
    is_used_.resize(mesh_.points.size());
    for (const std::uint32_t node : mesh_.nodes) {
      is_used_[node] = true;
    }
    mesh_.point_fields = fields_of(node_data_, node_index_, mesh_.points.size(), true);
    mesh_.cell_fields = fields_of(element_data_, element_index_, mesh_.n_cells(), false);
    return std::move(mesh_);
  }

 private:
  void read_format() {
    cursor_.is_at_end();
    std::size_t at = cursor_.at();
    const std::string_view first = cursor_.take_line();
    if (first == "$NOD") {
      cursor_.fail("version 1 of gmsh's format is not read", kSaveAs41, at);
    }
    if (first != "$MeshFormat") {
      cursor_.fail(fmt::format("'{}' instead of $MeshFormat", shown(first)),
                   "a .msh is gmsh's mesh format", at);
    }
    at = cursor_.at();
    const std::string_view line = cursor_.take_line();
    const std::string_view version = line.substr(0, line.find(' '));
    if (version != "4.1") {
      cursor_.fail(fmt::format("version '{}' of gmsh's format is not read", shown(version)),
                   kSaveAs41, at);
    }
    const bool is_binary = line == "4.1 1 8" || line == "4.1 1 4";
    if (!is_binary && line != "4.1 0 8" && line != "4.1 0 4") {
      cursor_.fail(fmt::format("'{}' instead of '4.1 0 8' or '4.1 1 8'", shown(line)),
                   "after the version: 0 for text or 1 for binary, and the bytes of a size",
                   at);
    }
    GmshCoding coding{.is_binary = is_binary,
                      .order = std::endian::little,
                      .size_bytes = line.back() == '4' ? std::size_t{4} : std::size_t{8}};
    cursor_.set_coding(coding);
    if (is_binary) {
      at = cursor_.at();
      const std::int64_t one = cursor_.take_int();
      if (one == 0x01000000) {
        coding.order = std::endian::big;
        cursor_.set_coding(coding);
      } else if (one != 1) {
        cursor_.fail(fmt::format("{} instead of the binary 1 that tells the byte order", one),
                     "copy it as a binary file, or save it again", at);
      }
    }
    require_end("$EndMeshFormat");
  }

  void require_end(std::string_view mark) {
    cursor_.is_at_end();
    const std::size_t at = cursor_.at();
    const std::string_view line = cursor_.take_line();
    if (line != mark) {
      cursor_.fail(fmt::format("'{}' instead of {}", shown(line), mark),
                   "the section's counts do not fit, or the file is cut short", at);
    }
  }

  void read_section() {
    const std::size_t at = cursor_.at();
    const std::string_view line = cursor_.take_line();
    if (line.size() < 2 || line[0] != '$' || line.substr(0, 4) == "$End") {
      cursor_.fail(fmt::format("'{}' instead of a section such as $Nodes", shown(line)),
                   kSaveAgain, at);
    }
    if (line == "$Nodes") {
      require_once(has_nodes_, line, at);
      read_nodes();
    } else if (line == "$Elements") {
      if (!has_nodes_) {
        cursor_.fail("$Elements before $Nodes", "put $Nodes first, as gmsh does", at);
      }
      require_once(has_elements_, line, at);
      read_elements();
    } else if (line == "$NodeData") {
      node_data_.push_back(read_data(at, "nodes"));
      require_end("$EndNodeData");
    } else if (line == "$ElementData") {
      element_data_.push_back(read_data(at, "elements"));
      require_end("$EndElementData");
    } else if (line == "$ElementNodeData") {
      cursor_.fail("values of each element at its nodes ($ElementNodeData) are not read",
                   "give one value a node ($NodeData; gmsh: Plugin(Smooth)), or leave them out",
                   at);
    } else {
      // Physical names, entities, periodic and ghost parts, comments.
      cursor_.skip_past(fmt::format("$End{}", line.substr(1)), at);
    }
  }

  void require_once(bool& has, std::string_view section, std::size_t at) const {
    if (has) {
      cursor_.fail(fmt::format("{} for the second time", section),
                   "save the mesh as one, with one section of each", at);
    }
    has = true;
  }

  void read_nodes() {
    const std::size_t at = cursor_.next_at();
    const std::uint64_t n_blocks = cursor_.take_size();
    const std::uint64_t n_nodes = cursor_.take_size();
    cursor_.take_size();  // the least and the greatest tag
    cursor_.take_size();
    if (n_nodes >= kLeftOut) {
      cursor_.fail("more than 4 thousand million nodes", "give the mesh in parts", at);
    }
    cursor_.require_room(n_nodes, {.n_sizes = 1, .n_ints = 0, .n_reals = 3}, "nodes");
    mesh_.points.reserve(n_nodes);
    for (std::uint64_t i = 0; i < n_blocks; ++i) {
      read_node_block(n_nodes);
    }
    if (mesh_.points.size() != n_nodes) {
      cursor_.fail(fmt::format("{} nodes in all blocks, where the section says {}",
                               mesh_.points.size(), n_nodes),
                   kSaveAgain, at);
    }
    require_end("$EndNodes");
    if (const std::optional<std::uint64_t> twice = node_index_.sort()) {
      cursor_.fail(fmt::format("node {} stands there twice", *twice), "number the nodes anew",
                   at);
    }
  }

  void read_node_block(std::uint64_t n_nodes) {
    const std::size_t at = cursor_.next_at();
    const std::int64_t dimension = cursor_.take_int();
    cursor_.take_int();  // the entity
    const std::int64_t is_parametric = cursor_.take_int();
    if (dimension < 0 || dimension > 3 || is_parametric < 0 || is_parametric > 1) {
      cursor_.fail(fmt::format("a block of nodes of dimension {}, parametric {}", dimension,
                               is_parametric),
                   "a dimension is 0 to 3, parametric is 0 or 1: save the mesh again", at);
    }
    // Behind x y z the parameters on the curve, the surface or in the volume.
    const std::int64_t n_parameters = is_parametric == 1 ? dimension : 0;
    const std::uint64_t n = cursor_.take_size();
    cursor_.require_room(
        n, {.n_sizes = 1, .n_ints = 0, .n_reals = 3 + static_cast<std::size_t>(n_parameters)},
        "nodes");
    const std::size_t first = mesh_.points.size();
    if (n > n_nodes - first) {
      cursor_.fail(
          fmt::format("a block of {} nodes, where the section has {} left", n, n_nodes - first),
          kSaveAgain, at);
    }
    for (std::size_t i = 0; i < n; ++i) {
      node_index_.add(cursor_.take_size(), static_cast<std::uint32_t>(first + i));
    }
    for (std::size_t i = 0; i < n; ++i) {
      const double x = cursor_.take_real();
      const double y = cursor_.take_real();
      const double z = cursor_.take_real();
      mesh_.points.emplace_back(x, y, z);
      for (std::int64_t k = 0; k < n_parameters; ++k) {
        cursor_.take_real();
      }
    }
  }

  void read_elements() {
    const std::size_t at = cursor_.next_at();
    const std::uint64_t n_blocks = cursor_.take_size();
    const std::uint64_t n_elements = cursor_.take_size();
    cursor_.take_size();  // the least and the greatest tag
    cursor_.take_size();
    std::uint64_t n_read = 0;
    for (std::uint64_t i = 0; i < n_blocks; ++i) {
      n_read += read_element_block();
    }
    if (n_read != n_elements) {
      cursor_.fail(fmt::format("{} elements in all blocks, where the section says {}", n_read,
                               n_elements),
                   kSaveAgain, at);
    }
    require_end("$EndElements");
    if (const std::optional<std::uint64_t> twice = element_index_.sort()) {
      cursor_.fail(fmt::format("element {} stands there twice", *twice),
                   "number the elements anew", at);
    }
  }

  std::uint64_t read_element_block() {
    const std::size_t at = cursor_.next_at();
    cursor_.take_int();  // the entity's dimension, and the entity
    cursor_.take_int();
    const std::int64_t gmsh = cursor_.take_int();
    const std::uint64_t n = cursor_.take_size();
    const std::optional<CellType> type = type_of(gmsh);
    const std::optional<std::size_t> n_flat = flat_nodes(gmsh);
    if (n == 0) {
      return 0;
    }
    if (gmsh < 1 || gmsh > kLastType) {
      cursor_.fail(
          fmt::format("a block of {} elements of type {}, which gmsh does not have", n, gmsh),
          kSaveAgain, at);
    }
    if (!type && !n_flat) {
      cursor_.fail(fmt::format("cell {} is a {} (gmsh's type {}), which is not read",
                               cursor_.take_size(), solid_name(gmsh), gmsh),
                   "mesh with Mesh.ElementOrder = 1 (tetrahedra alone: 1 or 2) and save again",
                   at);
    }
    const std::size_t n_nodes = type ? shape_of(*type).n_nodes : *n_flat;
    cursor_.require_room(n, {.n_sizes = 1 + n_nodes, .n_ints = 0, .n_reals = 0}, "elements");
    for (std::uint64_t i = 0; i < n; ++i) {
      const std::uint64_t tag = cursor_.take_size();
      if (type) {
        element_index_.add(tag, static_cast<std::uint32_t>(mesh_.n_cells()));
        add_cell(*type, tag);
      } else {
        element_index_.add(tag, kLeftOut);
        ++mesh_.n_left_out;
        for (std::size_t k = 0; k < n_nodes; ++k) {
          cursor_.take_size();
        }
      }
    }
    return n;
  }

  void add_cell(CellType type, std::uint64_t tag) {
    if (mesh_.n_cells() + 1 == kLeftOut) {
      cursor_.fail("more than 4 thousand million cells", "give the mesh in parts",
                   cursor_.at());
    }
    mesh_.types.push_back(type);
    mesh_.begins.push_back(mesh_.nodes.size());
    mesh_.numbers_in_file.push_back(tag);
    for (std::size_t k = 0; k < shape_of(type).n_nodes; ++k) {
      const std::size_t at = cursor_.next_at();
      const std::uint64_t node = cursor_.take_size();
      const std::optional<std::uint32_t> point = node_index_.find(node);
      if (!point) {
        cursor_.fail(fmt::format("cell {} names node {}, which is not there", tag, node),
                     "save all nodes with the cells", at);
      }
      mesh_.nodes.push_back(*point);
    }
    const std::span<const std::uint8_t> order = order_of(type);
    const std::vector<std::uint32_t> own(
        mesh_.nodes.end() - static_cast<std::ptrdiff_t>(order.size()), mesh_.nodes.end());
    for (std::size_t k = 0; k < order.size(); ++k) {
      mesh_.nodes[mesh_.begins.back() + k] = own[order[k]];
    }
  }

  std::string take_string() {
    const std::size_t at = cursor_.at();
    const std::string_view line = cursor_.take_line();
    if (line.size() < 2 || line.front() != '"' || line.back() != '"') {
      cursor_.fail(fmt::format("'{}' instead of a name in quotes", shown(line)), kSaveAgain,
                   at);
    }
    return std::string(line.substr(1, line.size() - 2));
  }

  /// What is left of the line must be blank.
  void end_line() {
    const std::size_t at = cursor_.at();
    if (const std::string_view rest = cursor_.take_line(); !rest.empty()) {
      cursor_.fail(fmt::format("'{}' behind the count or tag that ends its line", shown(rest)),
                   kSaveAgain, at);
    }
  }

  TaggedValues read_data(std::size_t at, std::string_view of) {
    TaggedValues data;
    data.at = at;
    const std::uint64_t n_strings = cursor_.take_text_count();
    end_line();
    for (std::uint64_t i = 0; i < n_strings; ++i) {
      const std::string text = take_string();
      if (i == 0) {
        data.name = text;
      } else if (i == 1 && !text.empty()) {
        cursor_.fail(fmt::format("'{}' is interpolated by a scheme of its own, '{}'",
                                 shown(data.name), shown(text)),
                     "save it without an interpolation scheme", at);
      }
    }
    for (std::uint64_t n = cursor_.take_text_count(); n > 0; --n) {
      cursor_.take_text_real();  // the time
    }
    const std::uint64_t n_integers = cursor_.take_text_count();
    if (n_strings == 0 || n_integers < 3) {
      cursor_.fail(
          fmt::format("a field of {} string tags and {} integer tags", n_strings, n_integers),
          "a name, and step, components and number of entities are needed", at);
    }
    data.step = cursor_.take_text_integer();
    data.n_components = cursor_.take_text_count();
    const std::uint64_t n = cursor_.take_text_count();
    for (std::uint64_t i = 3; i < n_integers; ++i) {
      cursor_.take_text_integer();  // the partition
    }
    end_line();
    if (data.n_components == 0 || data.n_components > 1000) {
      cursor_.fail(fmt::format("'{}' has {} components", shown(data.name), data.n_components),
                   "1, 3 or 9, and no more than 1000", at);
    }
    cursor_.require_room(n, {.n_sizes = 0, .n_ints = 1, .n_reals = data.n_components}, of);
    data.tags.reserve(n);
    data.values.reserve(n * data.n_components);
    for (std::uint64_t i = 0; i < n; ++i) {
      const std::size_t item_at = cursor_.next_at();
      const std::int64_t tag = cursor_.take_int();
      if (tag < 0) {
        cursor_.fail(fmt::format("'{}' gives a value to tag {}", shown(data.name), tag),
                     kSaveAgain, item_at);
      }
      data.tags.push_back(static_cast<std::uint64_t>(tag));
      for (std::size_t c = 0; c < data.n_components; ++c) {
        data.values.push_back(cursor_.take_real());
      }
    }
    return data;
  }

  /// Fields in the order in which they first appear.
  std::vector<MeshField> fields_of(const std::vector<TaggedValues>& data, const TagIndex& index,
                                   std::size_t n, bool is_of_nodes) {
    std::map<std::string_view, std::map<std::int64_t, std::vector<const TaggedValues*>>> parts;
    for (const TaggedValues& part : data) {
      parts[part.name][part.step].push_back(&part);
    }
    std::vector<MeshField> fields;
    for (const TaggedValues& part : data) {
      const auto& steps = parts[part.name];
      const auto& same = steps.at(part.step);
      if (same.front() == &part) {
        fields.push_back(joined(same, index, n, is_of_nodes));
        fields.back().name += steps.size() > 1 ? fmt::format(", step {}", part.step) : "";
      }
    }
    return fields;
  }

  /// @throws Error  a tag that is not there or has two values, a node of a cell or a cell
  ///                without a value
  MeshField joined(const std::vector<const TaggedValues*>& parts, const TagIndex& index,
                   std::size_t n, bool is_of_nodes) {
    const std::string_view item = is_of_nodes ? "node" : "element";
    const TaggedValues& first = *parts.front();
    const std::size_t n_components = first.n_components;
    const auto refuse = [&](const TaggedValues& part, const std::string& what) {
      cursor_.fail(fmt::format("'{}' {}", shown(part.name), what),
                   fmt::format("give one value a{} {}", is_of_nodes ? "" : "n", item), part.at);
    };
    if (n_components > budget_.left() / std::max<std::size_t>(n, 1)) {
      refuse(first, fmt::format("has {} components for {} {}s", n_components, n, item));
    }
    static_cast<void>(budget_.take(n * n_components));
    MeshField field{.name = first.name, .n_components = n_components, .values = {}};
    field.values.assign(n * n_components, std::numeric_limits<double>::quiet_NaN());
    std::vector<bool> has_value(n);
    for (const TaggedValues* part : parts) {
      if (part->n_components != n_components) {
        refuse(*part, fmt::format("has {} components, and {} before", part->n_components,
                                  n_components));
      }
      for (std::size_t i = 0; i < part->tags.size(); ++i) {
        const std::optional<std::uint32_t> place = index.find(part->tags[i]);
        if (!place) {
          refuse(*part, fmt::format("gives a value to {} {}, which is not there", item,
                                    part->tags[i]));
        }
        if (*place == kLeftOut) {
          continue;
        }
        const double* const values = part->values.data() + i * n_components;
        double* const kept = field.values.data() + *place * n_components;
        // Parts of a partitioned mesh share the nodes between them.
        if (has_value[*place] && !std::equal(values, values + n_components, kept)) {
          refuse(*part, fmt::format("gives {} {} a second value", item, part->tags[i]));
        }
        has_value[*place] = true;
        std::copy_n(values, n_components, kept);
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      if (!has_value[i] && (!is_of_nodes || is_used_[i])) {
        refuse(first, fmt::format("has no value for {} {}", item,
                                  index.tag_of(static_cast<std::uint32_t>(i))));
      }
    }
    return field;
  }

  GmshCursor cursor_;
  ValueBudget budget_;
  CellMesh mesh_;
  bool has_nodes_ = false;
  bool has_elements_ = false;
  TagIndex node_index_;
  TagIndex element_index_;
  std::vector<bool> is_used_;  ///< points of solid cells
  std::vector<TaggedValues> node_data_;
  std::vector<TaggedValues> element_data_;
};

}  // namespace

CellMesh parse_msh(std::string_view bytes, const std::string& name) {
  return GmshReader(bytes, name).read();
}

}  // namespace haarlight::render
