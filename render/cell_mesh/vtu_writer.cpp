// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/vtu_writer.h"

#include <cstddef>
#include <string_view>

#include <fmt/format.h>

#include "core/binary_writer.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr std::uint8_t kHexahedron = 12;  // VTK_HEXAHEDRON

/// The description of the arrays that follow it, in their order.
class Header {
 public:
  /// @param components  per item; 1: a scalar
  std::string array(std::string_view type, std::string_view name, std::size_t components,
                    std::size_t bytes) {
    std::string text = fmt::format(
        "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"appended\" "
        "offset=\"{}\"/>\n",
        type, name, components, offset_);
    offset_ += sizeof(std::uint64_t) + bytes;
    return text;
  }

 private:
  std::size_t offset_ = 0;
};

template <class T>
std::size_t bytes_of(const std::vector<T>& values) {
  return values.size() * sizeof(T);
}

/// An array as it is appended: its bytes' number, then they.
template <class T>
void put_array(const std::vector<T>& values, BinaryWriter& out) {
  out.put(std::uint64_t{bytes_of(values)});
  out.put_all(values);
}

}  // namespace

void write_vtu(const HexahedralMesh& mesh, const std::filesystem::path& file) {
  const std::size_t n = mesh.cells.size();
  std::vector<std::int64_t> ends(n);
  for (std::size_t i = 0; i < n; ++i) {
    ends[i] = static_cast<std::int64_t>(8 * (i + 1));
  }
  const std::vector<std::uint8_t> types(n, kHexahedron);
  Header header;
  std::string text = fmt::format(
      "<?xml version=\"1.0\"?>\n<!-- haarlight, mm -->\n"
      "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" "
      "header_type=\"UInt64\">\n<UnstructuredGrid>\n"
      "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
      mesh.points.size(), n);
  // One statement each: the offsets count up in this order.
  text += "<Points>\n";
  text += header.array("Float32", "Points", 3, bytes_of(mesh.points));
  text += "</Points>\n<Cells>\n";
  text += header.array("Int32", "connectivity", 1, bytes_of(mesh.cells));
  text += header.array("Int64", "offsets", 1, bytes_of(ends));
  text += header.array("UInt8", "types", 1, bytes_of(types));
  text += "</Cells>\n<CellData>\n";
  for (const CellValues& cell : mesh.values) {
    std::visit(
        [&](const auto& values) {
          HAARLIGHT_EXPECTS(values.size() == n, "a value per cell");
          text += header.array(sizeof(values[0]) == 1 ? "UInt8" : "Float32", cell.name, 1,
                               bytes_of(values));
        },
        cell.values);
  }
  text += "</CellData>\n</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_";
  BinaryWriter out(file);
  out.put_text(text);
  put_array(mesh.points, out);
  put_array(mesh.cells, out);
  put_array(ends, out);
  put_array(types, out);
  for (const CellValues& cell : mesh.values) {
    std::visit([&](const auto& values) { put_array(values, out); }, cell.values);
  }
  out.put_text("\n</AppendedData>\n</VTKFile>\n");
  out.commit();
}

}  // namespace haarlight::render
