// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <charconv>
#include <optional>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/mesh_numbers.h"
#include "render/cell_mesh/vtk_cells.h"

namespace haarlight::render {

namespace {

constexpr const char* kExportAgain = "the file is damaged: export the mesh again";
constexpr const char* kCutShort = "the file is cut short: copy it again";

using Words = std::vector<std::string_view>;

std::string lower(std::string_view word) {
  std::string result(word);
  for (char& c : result) {
    c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  }
  return result;
}

std::string_view shown(std::string_view text) { return text.substr(0, 60); }

std::optional<std::size_t> whole_number(std::string_view word) {
  std::size_t number = 0;
  const auto [end, problem] = std::from_chars(word.data(), word.data() + word.size(), number);
  return problem == std::errc() && end == word.data() + word.size() ? std::optional(number)
                                                                    : std::nullopt;
}

/// VTK writes a blank or a quote in a name as %20 and the like.
std::string decode_name(std::string_view text) {
  std::string name;
  for (std::size_t i = 0; i < text.size(); ++i) {
    unsigned code = 0;
    if (text[i] == '%' && i + 2 < text.size() &&
        std::from_chars(text.data() + i + 1, text.data() + i + 3, code, 16).ptr ==
            text.data() + i + 3) {
      name += static_cast<char>(code);
      i += 2;
    } else {
      name += text[i];
    }
  }
  return name;
}

std::optional<NumberType> number_type(std::string_view word) {
  // long as on 64-bit Unix; VTK writes its own index type as int.
  constexpr std::array<std::pair<std::string_view, NumberType>, 14> kNames = {
      {{"char", NumberType::i8},
       {"signed_char", NumberType::i8},
       {"unsigned_char", NumberType::u8},
       {"short", NumberType::i16},
       {"unsigned_short", NumberType::u16},
       {"int", NumberType::i32},
       {"vtkidtype", NumberType::i32},
       {"unsigned_int", NumberType::u32},
       {"long", NumberType::i64},
       {"vtktypeint64", NumberType::i64},
       {"unsigned_long", NumberType::u64},
       {"vtktypeuint64", NumberType::u64},
       {"float", NumberType::f32},
       {"double", NumberType::f64}}};
  const std::string type = lower(word);
  for (const auto& [name, number] : kNames) {
    if (name == type) {
      return number;
    }
  }
  return std::nullopt;
}

class VtkReader {
 public:
  VtkReader(std::string_view bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  CellMesh read() {
    read_head();
    while (const std::optional<Words> words = next_words()) {
      read_section(*words);
    }
    if (!has_points_ || !has_cells_ || !has_types_) {
      fail(fmt::format("no {} before the end", !has_points_  ? "POINTS"
                                               : !has_cells_ ? "CELLS"
                                                             : "CELL_TYPES"),
           kCutShort);
    }
    if (piece_.types.size() != piece_.ends.size()) {
      throw Error(
          fmt::format("{} CELL_TYPES for {} CELLS", piece_.types.size(), piece_.ends.size()),
          cells_location_, kExportAgain);
    }
    require_items(piece_.point_fields, piece_.points.size() / 3, "points");
    require_items(piece_.cell_fields, piece_.types.size(), "cells");
    CellMesh mesh;
    append_piece(std::move(piece_), cells_location_, mesh);
    if (mesh.n_left_out == 0) {
      mesh.numbers_in_file.clear();
    }
    return mesh;
  }

 private:
  [[nodiscard]] std::string location(std::size_t at) const {
    if (is_binary_) {
      return fmt::format("{}: byte {}", name_, at);
    }
    const auto end = bytes_.begin() + static_cast<std::ptrdiff_t>(std::min(at, bytes_.size()));
    return fmt::format("{}:{}", name_, 1 + std::count(bytes_.begin(), end, '\n'));
  }
  /// At the line that was read last.
  [[noreturn]] void fail(const std::string& what, const std::string& hint) const {
    throw Error(what, location(line_at_), hint);
  }

  std::string_view next_line() {
    line_at_ = at_;
    const std::size_t end = std::min(bytes_.find('\n', at_), bytes_.size());
    std::string_view line = bytes_.substr(at_, end - at_);
    at_ = std::min(end + 1, bytes_.size());
    if (!line.empty() && line.back() == '\r') {
      line.remove_suffix(1);
    }
    return line;
  }

  static Words words_of(std::string_view line) {
    Words words;
    std::size_t begin = 0;
    while ((begin = line.find_first_not_of(" \t\r", begin)) != std::string_view::npos) {
      const std::size_t end = std::min(line.find_first_of(" \t\r", begin), line.size());
      words.push_back(line.substr(begin, end - begin));
      begin = end;
    }
    return words;
  }

  /// Of the next line that is not blank; nothing at the end.
  std::optional<Words> next_words() {
    while (at_ < bytes_.size()) {
      Words words = words_of(next_line());
      if (!words.empty()) {
        return words;
      }
    }
    line_at_ = bytes_.size();
    return std::nullopt;
  }

  Words require_words(std::string_view what) {
    std::optional<Words> words = next_words();
    if (!words) {
      fail(fmt::format("the file ends before {}", what), kCutShort);
    }
    return std::move(*words);
  }

  void read_head() {
    constexpr std::string_view kMagic = "# vtk DataFile Version ";
    const std::string_view first = next_line();
    if (lower(first.substr(0, kMagic.size())) != lower(kMagic)) {
      fail("not a legacy VTK file", "its first line must be '# vtk DataFile Version 3.0'");
    }
    const std::string_view version = first.substr(kMagic.size());
    const std::optional<std::size_t> major = whole_number(version.substr(0, version.find('.')));
    if (!major || *major < 1 || *major > 5) {
      fail(fmt::format("version '{}' is not read", shown(version)),
           "save as version 2.0 to 5.1");
    }
    has_offsets_ = *major == 5;
    next_line();  // the title
    const std::string coding = lower(require_words("ASCII or BINARY").front());
    if (coding != "ascii" && coding != "binary") {
      fail(fmt::format("'{}' instead of ASCII or BINARY", shown(coding)), kExportAgain);
    }
    const Words dataset = require_words("DATASET");
    if (dataset.size() != 2 || lower(dataset[0]) != "dataset") {
      fail("no DATASET after the head", kExportAgain);
    }
    if (lower(dataset[1]) != "unstructured_grid") {
      fail(fmt::format("a dataset of type {}", shown(dataset[1])),
           "only UNSTRUCTURED_GRID is read: convert it, for example in ParaView");
    }
    is_binary_ = coding == "binary";
  }

  void read_section(const Words& words) {
    const std::string word = lower(words[0]);
    if (word == "points") {
      require_once(has_points_, words[0]);
      const std::size_t n = count(words, 1, 3);
      piece_.points = read_numbers(n, 3, type(words, 2));
    } else if (word == "cells") {
      require_once(has_cells_, words[0]);
      cells_location_ = location(line_at_);
      read_cells(count(words, 1, 3), count(words, 2, 3));
    } else if (word == "cell_types") {
      require_once(has_types_, words[0]);
      piece_.types = read_numbers(count(words, 1, 2), 1, NumberType::i32);
    } else if (word == "point_data" || word == "cell_data") {
      n_items_ = count(words, 1, 2);
      fields_ = word == "point_data" ? &piece_.point_fields : &piece_.cell_fields;
    } else if (word == "metadata") {
      while (at_ < bytes_.size() && !words_of(next_line()).empty()) {
      }
    } else if (word == "field") {
      read_field(words);
    } else if (word == "lookup_table") {
      static_cast<void>(
          read_numbers(count(words, 2, 3), 4, is_binary_ ? NumberType::u8 : NumberType::f32));
    } else {
      read_attribute(word, words);
    }
  }

  void require_once(bool& has, std::string_view word) const {
    if (has) {
      fail(fmt::format("{} for the second time", word), kExportAgain);
    }
    has = true;
  }

  [[nodiscard]] std::size_t count(const Words& words, std::size_t i,
                                  std::size_t n_words) const {
    const std::optional<std::size_t> number =
        words.size() >= n_words ? whole_number(words[i]) : std::nullopt;
    if (!number) {
      fail(fmt::format("{} without its numbers", shown(words[0])), kExportAgain);
    }
    return *number;
  }

  [[nodiscard]] NumberType type(const Words& words, std::size_t i) const {
    const std::optional<NumberType> found =
        i < words.size() ? number_type(words[i]) : std::nullopt;
    if (!found) {
      fail(fmt::format("{} of an unknown type of numbers", shown(words[0])),
           "char, short, int, long, their unsigned_ forms, float or double");
    }
    return *found;
  }

  /// `n` times `n_components` numbers from here on.
  std::vector<double> read_numbers(std::size_t n, std::size_t n_components, NumberType type) {
    // In ASCII a number takes two bytes, but for the last.
    const std::size_t left = bytes_.size() - at_;
    const std::size_t most = is_binary_ ? left / size_of(type) : (left + 1) / 2;
    if (n_components == 0 || n > most / n_components) {
      fail(fmt::format("{} times {} numbers in the {} bytes that are left", n, n_components,
                       left),
           "the file is cut short, or its counts are wrong");
    }
    const std::size_t n_values = n * n_components;
    std::vector<double> values;
    if (is_binary_) {
      const std::size_t n_bytes = n_values * size_of(type);
      append_numbers(bytes_.substr(at_, n_bytes), type, std::endian::big, values);
      at_ += n_bytes;
    } else {
      values.reserve(n_values);
      NumberText numbers(bytes_, at_);
      while (values.size() < n_values) {
        const std::optional<double> value = numbers.take();
        if (!value) {
          throw Error(
              numbers.at() == bytes_.size() ? "the file ends too early" : "not a number",
              location(numbers.at()), kExportAgain);
        }
        values.push_back(*value);
      }
      at_ = numbers.at();
    }
    return values;
  }

  void read_cells(std::size_t n, std::size_t n_numbers) {
    if (!has_offsets_) {
      read_counted_cells(n, read_numbers(n_numbers, 1, NumberType::i32));
      return;
    }
    const Words offsets = require_words("OFFSETS");
    if (lower(offsets[0]) != "offsets") {
      fail(fmt::format("'{}' instead of OFFSETS", shown(offsets[0])), kExportAgain);
    }
    piece_.ends = read_numbers(n, 1, type(offsets, 1));
    const Words connectivity = require_words("CONNECTIVITY");
    if (lower(connectivity[0]) != "connectivity") {
      fail(fmt::format("'{}' instead of CONNECTIVITY", shown(connectivity[0])), kExportAgain);
    }
    piece_.nodes = read_numbers(n_numbers, 1, type(connectivity, 1));
    // One more than cells: where each begins, and the last ends.
    if (!piece_.ends.empty()) {
      if (piece_.ends.front() != 0.0) {
        fail(fmt::format("OFFSETS begin at {} instead of 0", piece_.ends.front()),
             kExportAgain);
      }
      piece_.ends.erase(piece_.ends.begin());
    }
  }

  /// Before each cell's nodes their number.
  void read_counted_cells(std::size_t n, const std::vector<double>& numbers) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < n; ++i) {
      if (at >= numbers.size()) {
        throw Error(fmt::format("CELLS end within cell {} of {}", i, n), cells_location_,
                    "its two counts do not fit: export the mesh again");
      }
      const double n_nodes = numbers[at];
      const std::size_t left = numbers.size() - at - 1;
      if (!(n_nodes >= 0.0 && n_nodes <= static_cast<double>(left)) ||
          n_nodes != static_cast<double>(static_cast<std::size_t>(n_nodes))) {
        throw Error(
            fmt::format("cell {} of {} nodes, where {} numbers are left", i, n_nodes, left),
            cells_location_, kExportAgain);
      }
      const auto first = numbers.begin() + static_cast<std::ptrdiff_t>(at) + 1;
      piece_.nodes.insert(piece_.nodes.end(), first,
                          first + static_cast<std::ptrdiff_t>(n_nodes));
      piece_.ends.push_back(static_cast<double>(piece_.nodes.size()));
      at += 1 + static_cast<std::size_t>(n_nodes);
    }
    if (at != numbers.size()) {
      throw Error(fmt::format("{} numbers of CELLS belong to no cell", numbers.size() - at),
                  cells_location_, "its two counts do not fit: export the mesh again");
    }
  }

  void read_attribute(const std::string& word, const Words& words) {
    if (fields_ == nullptr) {
      fail(fmt::format("'{}' is not understood here", shown(words[0])), kExportAgain);
    }
    if (words.size() < 3) {
      fail(fmt::format("'{}' is not understood, or too short", shown(words[0])), kExportAgain);
    }
    std::size_t n_components = 1;
    std::optional<NumberType> values;
    if (word == "scalars") {
      n_components = words.size() > 3 ? count(words, 3, 4) : 1;
      values = type(words, 2);
      skip_table_name();
    } else if (word == "color_scalars") {
      n_components = count(words, 2, 3);
      values = is_binary_ ? NumberType::u8 : NumberType::f32;
    } else if (word == "texture_coordinates") {
      n_components = count(words, 2, 4);
      values = type(words, 3);
    } else {
      constexpr std::array<std::pair<std::string_view, std::size_t>, 7> kFixed = {
          {{"vectors", 3},
           {"normals", 3},
           {"tensors", 9},
           {"tensors6", 6},
           {"global_ids", 1},
           {"pedigree_ids", 1},
           {"edge_flags", 1}}};
      const auto* const found = std::find_if(
          kFixed.begin(), kFixed.end(), [&](const auto& item) { return item.first == word; });
      if (found == kFixed.end()) {
        fail(fmt::format("'{}' is not understood", shown(words[0])), kExportAgain);
      }
      n_components = found->second;
      values = type(words, 2);
    }
    add_field(words[1], n_items_, n_components, *values);
  }

  /// SCALARS may name the table of its colours in the next line.
  void skip_table_name() {
    const std::size_t before = at_;
    const std::size_t line_before = line_at_;
    // In binary the next line could be numbers: it is a short one, or no name.
    const std::string_view line = next_line();
    const Words words = words_of(line.substr(0, 300));
    if (words.size() != 2 || lower(words[0]) != "lookup_table") {
      at_ = before;
    }
    line_at_ = line_before;
  }

  void add_field(std::string_view name, std::size_t n, std::size_t n_components,
                 NumberType type) {
    MeshField field;
    field.name = decode_name(name);
    field.n_components = n_components;
    field.values = read_numbers(n, n_components, type);
    if (fields_ != nullptr) {
      fields_->push_back(std::move(field));
    }
  }

  /// FIELD name n_arrays; those before POINT_DATA and CELL_DATA belong to the file: not kept.
  void read_field(const Words& words) {
    const std::size_t n_arrays = count(words, 2, 3);
    for (std::size_t i = 0; i < n_arrays; ++i) {
      Words array = require_words(fmt::format("array {} of {}", i, n_arrays));
      if (lower(array[0]) == "metadata") {
        while (at_ < bytes_.size() && !words_of(next_line()).empty()) {
        }
        array = require_words(fmt::format("array {} of {}", i, n_arrays));
      }
      if (lower(array[0]) == "null_array") {
        continue;
      }
      const std::size_t n_components = count(array, 1, 4);
      const std::size_t n = count(array, 2, 4);
      add_field(array[0], n, n_components, type(array, 3));
    }
  }

  void require_items(const std::vector<MeshField>& fields, std::size_t n,
                     std::string_view what) const {
    for (const MeshField& field : fields) {
      const std::size_t n_values = field.values.size() / field.n_components;
      if (n_values != n) {
        throw Error(fmt::format("the field '{}' has {} items for {} {}", shown(field.name),
                                n_values, n, what),
                    name_, kExportAgain);
      }
    }
  }

  std::string_view bytes_;
  const std::string& name_;
  std::size_t at_ = 0;
  std::size_t line_at_ = 0;
  bool is_binary_ = false;
  bool has_offsets_ = false;
  bool has_points_ = false;
  bool has_cells_ = false;
  bool has_types_ = false;
  std::string cells_location_;
  VtkPiece piece_;
  std::size_t n_items_ = 0;
  std::vector<MeshField>* fields_ = nullptr;  ///< where attributes belong
};

}  // namespace

CellMesh parse_vtk(std::string_view bytes, const std::string& name) {
  return VtkReader(bytes, name).read();
}

}  // namespace haarlight::render
