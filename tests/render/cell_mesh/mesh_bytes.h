// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>
#include <zlib.h>

/// @file
/// The same four cells in every encoding of a .vtu, written here by the format's description.

namespace haarlight::testing {

inline std::string to_base64(std::string_view bytes) {
  constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      bits =
          bits << 8U | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      text += i + k > bytes.size() ? '=' : kDigits[bits >> (18U - 6U * k) & 63U];
    }
  }
  return text;
}

template <class T>
std::string bytes_of(std::span<const double> numbers, std::endian order = std::endian::little) {
  std::string bytes;
  for (const double number : numbers) {
    const auto value = static_cast<T>(number);
    std::string one(reinterpret_cast<const char*>(&value), sizeof value);
    if (order == std::endian::big) {
      std::reverse(one.begin(), one.end());
    }
    bytes += one;
  }
  return bytes;
}

inline std::string deflate(std::string_view bytes) {
  uLongf n = compressBound(bytes.size());
  std::string packed(n, '\0');
  if (compress(reinterpret_cast<Bytef*>(packed.data()), &n,
               reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()) != Z_OK) {
    throw std::runtime_error("zlib");
  }
  packed.resize(n);
  return packed;
}

/// How a .vtu holds its arrays.
struct VtuEncoding {
  enum class Place { ascii, binary, appended_base64, appended_raw };
  Place place = Place::ascii;
  bool is_compressed = false;
  bool has_wide_sizes = false;
  std::endian order = std::endian::little;
  std::size_t block = 16;  ///< bytes of a compressed block: small, for several of them
};

/// A .vtu, array by array.
class VtuText {
 public:
  explicit VtuText(const VtuEncoding& encoding) : encoding_(encoding) {}

  template <class T>
  std::string array(std::string_view type, std::string_view name, std::size_t n_components,
                    const std::vector<double>& numbers) {
    using Place = VtuEncoding::Place;
    std::string head = fmt::format(
        "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"{}\"", type,
        name, n_components,
        encoding_.place == Place::ascii    ? "ascii"
        : encoding_.place == Place::binary ? "binary"
                                           : "appended");
    if (encoding_.place == Place::ascii) {
      return fmt::format("{}>\n{}\n</DataArray>\n", head, fmt::join(numbers, " "));
    }
    const std::string data = encode(bytes_of<T>(numbers, encoding_.order));
    if (encoding_.place == Place::binary) {
      return fmt::format("{}>\n  {}\n</DataArray>\n", head, data);
    }
    head += fmt::format(" offset=\"{}\"/>\n", appended_.size());
    appended_ += data;
    return head;
  }

  [[nodiscard]] std::string file(const std::string& pieces) const {
    using Place = VtuEncoding::Place;
    std::string text = fmt::format(
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"{}\" "
        "header_type=\"{}\"{}>\n<UnstructuredGrid>\n{}</UnstructuredGrid>\n",
        encoding_.order == std::endian::big ? "BigEndian" : "LittleEndian",
        encoding_.has_wide_sizes ? "UInt64" : "UInt32",
        encoding_.is_compressed ? " compressor=\"vtkZLibDataCompressor\"" : "", pieces);
    if (encoding_.place == Place::appended_base64 || encoding_.place == Place::appended_raw) {
      text += fmt::format("<AppendedData encoding=\"{}\">\n_{}\n</AppendedData>\n",
                          encoding_.place == Place::appended_raw ? "raw" : "base64", appended_);
    }
    return text + "</VTKFile>\n";
  }

 private:
  [[nodiscard]] std::string size(std::size_t n) const {
    const std::vector<double> number = {static_cast<double>(n)};
    return encoding_.has_wide_sizes ? bytes_of<std::uint64_t>(number, encoding_.order)
                                    : bytes_of<std::uint32_t>(number, encoding_.order);
  }
  [[nodiscard]] std::string encode(const std::string& bytes) const {
    const bool is_raw = encoding_.place == VtuEncoding::Place::appended_raw;
    const auto in_text = [is_raw](const std::string& part) {
      return is_raw ? part : to_base64(part);
    };
    if (!encoding_.is_compressed) {
      return in_text(size(bytes.size()) + bytes);
    }
    std::string sizes;
    std::string blocks;
    std::size_t n_blocks = 0;
    for (std::size_t at = 0; at < bytes.size(); at += encoding_.block, ++n_blocks) {
      const std::string packed = deflate(std::string_view(bytes).substr(at, encoding_.block));
      sizes += size(packed.size());
      blocks += packed;
    }
    return in_text(size(n_blocks) + size(encoding_.block) +
                   size(bytes.size() % encoding_.block) + sizes) +
           in_text(blocks);
  }

  VtuEncoding encoding_;
  std::string appended_;
};

/// A hexahedron, a pyramid on it, a wedge beside it and a tetrahedron beside that, with fields
/// `height` (z of the points), `position` (the points) and `material` (1 2 2 3, of the cells): volume
/// 1 + 1/6 + 1/2 + 1/6. The same as configs/volumes/four_cells.vtu.
struct FourCells {
  std::vector<double> points = {0,   0,   0,   1, 0, 0, 1, 1, 0, 0,    1,  0,
                                0,   0,   1,   1, 0, 1, 1, 1, 1, 0,    1,  1,
                                0.5, 0.5, 1.5, 2, 0, 0, 2, 1, 0, 1.25, -1, 0.25};
  std::vector<double> height = {0, 0, 0, 0, 1, 1, 1, 1, 1.5, 0, 0, 0.25};
  std::vector<double> nodes = {0, 1, 2, 3,  4, 5, 6, 7, 4, 5, 6, 7,
                               8, 2, 6, 10, 1, 5, 9, 1, 9, 5, 11};
  /// The wedge's triangles as a CellMesh has them.
  [[nodiscard]] std::vector<double> nodes_read() const {
    std::vector<double> read = nodes;
    std::swap_ranges(read.begin() + 13, read.begin() + 16, read.begin() + 16);
    return read;
  }
  std::vector<double> ends = {8, 13, 19, 23};
  std::vector<double> types = {12, 14, 13, 10};
  std::vector<double> material = {1, 2, 2, 3};

  [[nodiscard]] std::string piece(VtuText& vtu) const {
    std::string text = fmt::format("<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
                                   points.size() / 3, types.size());
    text += "<PointData>\n" + vtu.array<double>("Float64", "height", 1, height);
    text += vtu.array<float>("Float32", "position", 3, points) + "</PointData>\n<CellData>\n";
    text +=
        vtu.array<std::uint8_t>("UInt8", "material", 1, material) + "</CellData>\n<Points>\n";
    text += vtu.array<double>("Float64", "Points", 3, points) + "</Points>\n<Cells>\n";
    text += vtu.array<std::int32_t>("Int32", "connectivity", 1, nodes);
    text += vtu.array<std::int64_t>("Int64", "offsets", 1, ends);
    text += vtu.array<std::uint8_t>("UInt8", "types", 1, types) + "</Cells>\n</Piece>\n";
    return text;
  }
  [[nodiscard]] std::string vtu(const VtuEncoding& encoding) const {
    VtuText text(encoding);
    const std::string only = piece(text);
    return text.file(only);
  }
};

/// Replaces the first `old`, which must be there.
inline std::string replaced(std::string text, std::string_view old, std::string_view by) {
  const std::size_t at = text.find(old);
  if (at == std::string::npos) {
    throw std::runtime_error(fmt::format("no '{}' to replace", old));
  }
  return text.replace(at, old.size(), by);
}

}  // namespace haarlight::testing
