// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/vtu_writer.h"

#include <cstddef>
#include <span>
#include <string_view>

#include <fmt/format.h>

#include "core/binary_writer.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr std::uint8_t kHexahedron = 12;  // VTK_HEXAHEDRON

/// VTK's numbers, by CellType.
constexpr std::array<std::uint8_t, kCellTypes> kVtkTypes = {10, kHexahedron, 13, 14, 24,
                                                            25, 29,          26, 27, 71};

/// An array of the file: what it is, and its bytes, which outlive it.
struct Array {
  std::string_view type;
  std::string name;
  std::size_t n_components = 1;  ///< per item
  std::span<const std::byte> bytes;
};

template <class T>
Array array_of(std::string_view type, std::string_view name, std::size_t n_components,
               const std::vector<T>& values) {
  return {.type = type,
          .name = std::string(name),
          .n_components = n_components,
          .bytes = std::as_bytes(std::span(values))};
}

struct Grid {
  std::size_t n_points = 0;
  std::size_t n_cells = 0;
  std::string_view unit;
  std::vector<Array> points;
  std::vector<Array> cells;
  std::vector<Array> point_data;
  std::vector<Array> cell_data;
};

/// As the value of an XML attribute.
std::string quoted(const std::string& name, const std::filesystem::path& file) {
  std::string text;
  for (const char c : name) {
    constexpr unsigned char kFirstPrinting = 0x20;
    if (static_cast<unsigned char>(c) < kFirstPrinting) {
      throw Error(fmt::format("XML has no way to write the field's name '{}'", name),
                  file.string(), "give the field a name without control characters");
    }
    switch (c) {
      case '&':
        text += "&amp;";
        break;
      case '<':
        text += "&lt;";
        break;
      case '>':
        text += "&gt;";
        break;
      case '"':
        text += "&quot;";
        break;
      default:
        text += c;
    }
  }
  return text;
}

/// Descriptions first, then the arrays in the same order, each behind its number of bytes.
void write(const Grid& grid, const std::filesystem::path& file) {
  std::string text = fmt::format(
      "<?xml version=\"1.0\"?>\n<!-- haarlight{} -->\n"
      "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" "
      "header_type=\"UInt64\">\n<UnstructuredGrid>\n"
      "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
      grid.unit, grid.n_points, grid.n_cells);
  std::size_t offset = 0;
  std::vector<std::span<const std::byte>> appended;
  const auto describe = [&](std::string_view section, const std::vector<Array>& arrays) {
    text += fmt::format("<{}>\n", section);
    for (const Array& array : arrays) {
      text += fmt::format(
          "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"appended\" "
          "offset=\"{}\"/>\n",
          array.type, quoted(array.name, file), array.n_components, offset);
      offset += sizeof(std::uint64_t) + array.bytes.size();
      appended.push_back(array.bytes);
    }
    text += fmt::format("</{}>\n", section);
  };
  describe("Points", grid.points);
  describe("Cells", grid.cells);
  if (!grid.point_data.empty()) {
    describe("PointData", grid.point_data);
  }
  describe("CellData", grid.cell_data);
  text += "</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_";
  BinaryWriter out(file);
  out.put_text(text);
  for (const std::span<const std::byte> bytes : appended) {
    out.put(std::uint64_t{bytes.size()});
    out.put_bytes(bytes);
  }
  out.put_text("\n</AppendedData>\n</VTKFile>\n");
  out.commit();
}

std::vector<Array> arrays_of(const std::vector<MeshField>& fields, std::size_t n) {
  std::vector<Array> arrays;
  for (const MeshField& field : fields) {
    HAARLIGHT_EXPECTS(field.values.size() == n * field.n_components, "a value for each");
    arrays.push_back(array_of("Float64", field.name, field.n_components, field.values));
  }
  return arrays;
}

}  // namespace

void write_vtu(const HexahedralMesh& mesh, const std::filesystem::path& file) {
  const std::size_t n = mesh.cells.size();
  std::vector<std::int64_t> ends(n);
  for (std::size_t i = 0; i < n; ++i) {
    ends[i] = static_cast<std::int64_t>(8 * (i + 1));
  }
  const std::vector<std::uint8_t> types(n, kHexahedron);
  Grid grid{.n_points = mesh.points.size(), .n_cells = n, .unit = ", mm"};
  grid.points = {array_of("Float32", "Points", 3, mesh.points)};
  grid.cells = {array_of("Int32", "connectivity", 1, mesh.cells),
                array_of("Int64", "offsets", 1, ends), array_of("UInt8", "types", 1, types)};
  for (const CellValues& cell : mesh.values) {
    std::visit(
        [&](const auto& values) {
          HAARLIGHT_EXPECTS(values.size() == n, "a value per cell");
          grid.cell_data.push_back(
              array_of(sizeof(values[0]) == 1 ? "UInt8" : "Float32", cell.name, 1, values));
        },
        cell.values);
  }
  write(grid, file);
}

void write_vtu(const CellMesh& mesh, const std::filesystem::path& file) {
  std::vector<std::int64_t> nodes;
  nodes.reserve(mesh.nodes.size());
  std::vector<std::int64_t> ends;
  std::vector<std::uint8_t> types;
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    const std::span<const std::uint32_t> own = mesh.nodes_of(i);
    nodes.insert(nodes.end(), own.begin(), own.end());
    if (shape_of(mesh.types[i]).linear == CellType::wedge) {  // VTK has the upper side first
      const auto first = nodes.end() - static_cast<std::ptrdiff_t>(own.size());
      std::swap_ranges(first, first + 3, first + 3);
      if (own.size() > 6) {
        std::swap_ranges(first + 6, first + 9, first + 9);
      }
    }
    ends.push_back(static_cast<std::int64_t>(nodes.size()));
    types.push_back(kVtkTypes.at(static_cast<std::size_t>(mesh.types[i])));
  }
  Grid grid{.n_points = mesh.points.size(), .n_cells = mesh.n_cells(), .unit = ""};
  grid.points = {array_of("Float64", "Points", 3, mesh.points)};
  grid.cells = {array_of("Int64", "connectivity", 1, nodes),
                array_of("Int64", "offsets", 1, ends), array_of("UInt8", "types", 1, types)};
  grid.point_data = arrays_of(mesh.point_fields, mesh.points.size());
  grid.cell_data = arrays_of(mesh.cell_fields, mesh.n_cells());
  write(grid, file);
}

}  // namespace haarlight::render
