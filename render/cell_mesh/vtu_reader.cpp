// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <charconv>
#include <limits>
#include <optional>
#include <system_error>
#include <utility>

#include <fmt/format.h>
#include <pugixml.hpp>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/mesh_numbers.h"
#include "render/cell_mesh/vtk_cells.h"
#include "render/cell_mesh/vtu_arrays.h"

namespace haarlight::render {

namespace {

constexpr std::string_view kSpaces = " \t\r\n";
constexpr const char* kExportAgain = "the file is damaged: export the mesh again";

std::optional<NumberType> number_type(std::string_view word) {
  constexpr std::array<std::pair<std::string_view, NumberType>, 10> kNames = {
      {{"Int8", NumberType::i8},
       {"UInt8", NumberType::u8},
       {"Int16", NumberType::i16},
       {"UInt16", NumberType::u16},
       {"Int32", NumberType::i32},
       {"UInt32", NumberType::u32},
       {"Int64", NumberType::i64},
       {"UInt64", NumberType::u64},
       {"Float32", NumberType::f32},
       {"Float64", NumberType::f64}}};
  for (const auto& [name, type] : kNames) {
    if (name == word) {
      return type;
    }
  }
  return std::nullopt;
}

/// Of an error: not all of what a file says.
std::string_view shown(std::string_view text) { return text.substr(0, 60); }

class VtuReader {
 public:
  VtuReader(std::string_view bytes, const std::string& name)
      : bytes_(bytes), name_(name), budget_(bytes.size()) {}

  CellMesh read() {
    parse_xml();
    const pugi::xml_node grid = read_head();
    CellMesh mesh;
    bool has_piece = false;
    for (const pugi::xml_node piece : grid.children("Piece")) {
      has_piece = true;
      const std::size_t n_points = count_of(piece, "NumberOfPoints");
      const std::size_t n_cells = count_of(piece, "NumberOfCells");
      if (n_points > 0 || n_cells > 0) {
        append_piece(read_piece(piece, n_points, n_cells), location_of(piece.child("Cells")),
                     mesh);
      }
    }
    if (!has_piece) {
      fail_at(grid, "no Piece in UnstructuredGrid", kExportAgain);
    }
    if (mesh.n_left_out == 0) {
      mesh.numbers_in_file.clear();
    }
    return mesh;
  }

 private:
  [[nodiscard]] std::string location_at(std::ptrdiff_t offset) const {
    const auto end = static_cast<std::size_t>(
        std::clamp<std::ptrdiff_t>(offset, 0, static_cast<std::ptrdiff_t>(bytes_.size())));
    return fmt::format("{}:{}", name_,
                       1 + std::count(bytes_.begin(),
                                      bytes_.begin() + static_cast<std::ptrdiff_t>(end), '\n'));
  }
  [[nodiscard]] std::string location_of(const pugi::xml_node& node) const {
    return location_at(node.offset_debug());
  }
  [[noreturn]] void fail_at(const pugi::xml_node& node, const std::string& what,
                            const std::string& hint) const {
    throw Error(what, location_of(node), hint);
  }

  /// Appended data need not be XML: they are cut off before.
  void parse_xml() {
    const std::size_t tag = bytes_.find("<AppendedData");
    pugi::xml_parse_result parsed;
    constexpr unsigned kOptions = pugi::parse_cdata | pugi::parse_escapes;
    if (tag == std::string_view::npos) {
      parsed =
          document_.load_buffer(bytes_.data(), bytes_.size(), kOptions, pugi::encoding_utf8);
    } else {
      const std::size_t end = bytes_.find('>', tag);
      const std::size_t mark =
          end == std::string_view::npos ? end : bytes_.find_first_not_of(kSpaces, end + 1);
      if (mark == std::string_view::npos || bytes_[mark] != '_') {
        throw Error("appended data without their first '_'",
                    location_at(static_cast<std::ptrdiff_t>(tag)), kExportAgain);
      }
      appended_ = bytes_.substr(mark + 1);
      const std::string head =
          std::string(bytes_.substr(0, end + 1)) + "</AppendedData></VTKFile>";
      parsed = document_.load_buffer(head.data(), head.size(), kOptions, pugi::encoding_utf8);
    }
    if (!parsed) {
      throw Error(fmt::format("not XML: {}", parsed.description()), location_at(parsed.offset),
                  "a .vtu is VTK's XML format for unstructured grids");
    }
  }

  /// @return  the grid
  pugi::xml_node read_head() {
    const pugi::xml_node file = document_.child("VTKFile");
    if (!file) {
      throw Error("no element VTKFile", location_at(0),
                  "a .vtu is VTK's XML format for unstructured grids");
    }
    const std::string_view type = file.attribute("type").value();
    if (type != "UnstructuredGrid") {
      fail_at(file, fmt::format("VTKFile of type '{}'", shown(type)),
              "only UnstructuredGrid is read: convert it, for example in ParaView");
    }
    const std::string_view order = file.attribute("byte_order").as_string("LittleEndian");
    if (order != "LittleEndian" && order != "BigEndian") {
      fail_at(file, fmt::format("byte_order '{}'", shown(order)), "LittleEndian or BigEndian");
    }
    coding_.order = order == "BigEndian" ? std::endian::big : std::endian::little;
    const std::string_view sizes = file.attribute("header_type").as_string("UInt32");
    if (sizes != "UInt32" && sizes != "UInt64") {
      fail_at(file, fmt::format("header_type '{}'", shown(sizes)), "UInt32 or UInt64");
    }
    coding_.has_wide_sizes = sizes == "UInt64";
    const std::string_view compressor = file.attribute("compressor").value();
    if (!compressor.empty() && compressor != "vtkZLibDataCompressor") {
      fail_at(file, fmt::format("compressor '{}' is not read", shown(compressor)),
              "save with vtkZLibDataCompressor or without compression");
    }
    coding_.is_compressed = !compressor.empty();
    const pugi::xml_node appended = file.child("AppendedData");
    const std::string_view encoding = appended.attribute("encoding").as_string("base64");
    if (encoding != "base64" && encoding != "raw") {
      fail_at(appended, fmt::format("encoding '{}'", shown(encoding)), "base64 or raw");
    }
    is_appended_base64_ = encoding == "base64";
    const pugi::xml_node grid = file.child("UnstructuredGrid");
    if (!grid) {
      fail_at(file, "no element UnstructuredGrid", kExportAgain);
    }
    return grid;
  }

  [[nodiscard]] std::optional<std::size_t> number_of(const pugi::xml_node& node,
                                                     const char* attribute) const {
    const pugi::xml_attribute found = node.attribute(attribute);
    if (!found) {
      return std::nullopt;
    }
    std::string_view text = found.value();
    const std::size_t begin = std::min(text.find_first_not_of(kSpaces), text.size());
    text = text.substr(begin, text.find_last_not_of(kSpaces) + 1 - begin);
    std::size_t number = 0;
    const auto [end, problem] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (problem != std::errc() || end != text.data() + text.size()) {
      fail_at(node, fmt::format("{} of {} is '{}'", attribute, node.name(), shown(text)),
              "give a whole number from 0");
    }
    return number;
  }

  [[nodiscard]] std::size_t count_of(const pugi::xml_node& node, const char* attribute) const {
    const std::optional<std::size_t> count = number_of(node, attribute);
    if (!count) {
      fail_at(node, fmt::format("{} without {}", node.name(), attribute), kExportAgain);
    }
    return *count;
  }

  VtkPiece read_piece(const pugi::xml_node& piece, std::size_t n_points, std::size_t n_cells) {
    VtkPiece read;
    const pugi::xml_node points = piece.child("Points").child("DataArray");
    if (!points) {
      fail_at(piece, "a piece without the DataArray of its Points", kExportAgain);
    }
    const std::size_t n_components = components_of(points);
    if (n_components != 3) {
      fail_at(points, fmt::format("points of {} components", n_components),
              "points have three");
    }
    read.points = read_array(points, n_points, 3);
    const pugi::xml_node cells = piece.child("Cells");
    read.ends = read_array(cell_array(piece, cells, "offsets"), n_cells, 1);
    read.types = read_array(cell_array(piece, cells, "types"), n_cells, 1);
    read.nodes = read_array(cell_array(piece, cells, "connectivity"), std::nullopt, 1);
    read.point_fields = read_fields(piece.child("PointData"), n_points);
    read.cell_fields = read_fields(piece.child("CellData"), n_cells);
    return read;
  }

  [[nodiscard]] pugi::xml_node cell_array(const pugi::xml_node& piece,
                                          const pugi::xml_node& cells, const char* name) const {
    const pugi::xml_node array = cells.find_child_by_attribute("DataArray", "Name", name);
    if (!array) {
      fail_at(cells ? cells : piece, fmt::format("no DataArray '{}' in Cells", name),
              kExportAgain);
    }
    return array;
  }

  [[nodiscard]] std::size_t components_of(const pugi::xml_node& array) const {
    const std::size_t n = number_of(array, "NumberOfComponents").value_or(1);
    if (n == 0) {
      fail_at(array, "an array of 0 components", "NumberOfComponents counts from 1");
    }
    return n;
  }

  std::vector<MeshField> read_fields(const pugi::xml_node& data, std::size_t n) {
    std::vector<MeshField> fields;
    for (const pugi::xml_node array : data.children("DataArray")) {
      if (std::string_view(array.attribute("type").value()) == "String") {
        continue;
      }
      MeshField field;
      field.name = array.attribute("Name").as_string("unnamed");
      field.n_components = components_of(array);
      field.values = read_array(array, n, field.n_components);
      fields.push_back(std::move(field));
    }
    return fields;
  }

  /// @param n  items; nothing: as many as there are
  std::vector<double> read_array(const pugi::xml_node& array, std::optional<std::size_t> n,
                                 std::size_t n_components) {
    std::optional<std::size_t> n_values;
    if (n) {
      if (*n > budget_.left() / n_components) {
        fail_at(array,
                fmt::format("{} items of {} components in a file of {} bytes", *n, n_components,
                            bytes_.size()),
                "the file is cut short, or its Piece says a wrong number");
      }
      n_values = *n * n_components;
    }
    const std::string_view word = array.attribute("type").value();
    const std::optional<NumberType> type = number_type(word);
    if (!type) {
      fail_at(array, fmt::format("numbers of type '{}'", shown(word)),
              "Int8 to Int64, UInt8 to UInt64, Float32 or Float64");
    }
    const std::string_view format = array.attribute("format").as_string("ascii");
    if (format == "ascii") {
      return read_ascii(array, n_values);
    }
    if (format != "binary" && format != "appended") {
      fail_at(array, fmt::format("format '{}'", shown(format)), "ascii, binary or appended");
    }
    std::string_view text = text_of(array).value();
    if (format == "appended") {
      const std::size_t offset = count_of(array, "offset");
      if (offset >= appended_.size()) {
        fail_at(array,
                fmt::format("offset {} in {} bytes of appended data", offset, appended_.size()),
                "the file is cut short: copy it again");
      }
      text = appended_.substr(offset);
    }
    const bool is_base64 = format == "binary" || is_appended_base64_;
    ArraySize size{.n_bytes = {}, .most_bytes = budget_.left() * size_of(*type)};
    if (n_values) {
      size.n_bytes = *n_values * size_of(*type);
    }
    std::vector<double> values;
    try {
      const std::string bytes = decode_array(text, is_base64, coding_, size);
      append_numbers(bytes, *type, coding_.order, values);
    } catch (const Error& error) {
      const std::string_view array_name = array.attribute("Name").as_string("Points");
      fail_at(array, fmt::format("'{}': {}", shown(array_name), error.problem()), error.hint());
    }
    static_cast<void>(budget_.take(values.size()));
    return values;
  }

  /// Its first text: what describes the array may follow in elements.
  [[nodiscard]] static pugi::xml_node text_of(const pugi::xml_node& array) {
    return array.find_child([](const pugi::xml_node& child) {
      return child.type() == pugi::node_pcdata || child.type() == pugi::node_cdata;
    });
  }

  std::vector<double> read_ascii(const pugi::xml_node& array, std::optional<std::size_t> n) {
    const pugi::xml_node content = text_of(array);
    const std::string_view text = content.value();
    const std::size_t most = n.value_or(budget_.left());
    NumberText numbers(text);
    std::vector<double> values;
    while (!numbers.is_at_end()) {
      if (values.size() == most) {
        fail_at(array, fmt::format("an array of more than its {} numbers", most), kExportAgain);
      }
      const std::optional<double> value = numbers.take();
      if (!value) {
        const std::size_t at = numbers.at();
        throw Error(fmt::format("'{}' is not a number",
                                text.substr(at, std::min(text.find_first_of(kSpaces, at) - at,
                                                         std::size_t{20}))),
                    location_at(content.offset_debug() + static_cast<std::ptrdiff_t>(at)),
                    kExportAgain);
      }
      values.push_back(*value);
    }
    if (n && values.size() != *n) {
      fail_at(array, fmt::format("an array of {} numbers instead of {}", values.size(), *n),
              kExportAgain);
    }
    static_cast<void>(budget_.take(values.size()));
    return values;
  }

  std::string_view bytes_;
  const std::string& name_;
  pugi::xml_document document_;
  std::string_view appended_;  ///< behind its '_'
  bool is_appended_base64_ = true;
  ArrayCoding coding_;
  ValueBudget budget_;
};

}  // namespace

CellMesh parse_vtu(std::string_view bytes, const std::string& name) {
  return VtuReader(bytes, name).read();
}

}  // namespace haarlight::render
