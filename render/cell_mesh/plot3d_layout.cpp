// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/plot3d_layout.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

/// More along one axis is the other byte order's.
constexpr std::size_t kMostAlong = std::size_t{1} << 24U;
constexpr std::size_t kMostPoints = std::numeric_limits<std::uint32_t>::max() - 1U;
constexpr std::size_t kMark = 4;
constexpr std::size_t kFreeStreamNumbers = 4;

std::string_view word_of(Plot3dKind kind) {
  return kind == Plot3dKind::grid ? "grid" : "solution";
}

std::string grids_text(const Plot3dLayout& layout) {
  const auto& size = layout.grids.front().size;
  const std::string first = fmt::format("{} x {} x {}", size[0], size[1], size[2]);
  return !layout.is_multiple ? fmt::format("one grid of {}", first)
                             : fmt::format("a list of {}, the first of {}",
                                           counted(layout.grids.size(), "grid"), first);
}

std::string coding_text(const Plot3dLayout& layout) {
  return fmt::format("{}-endian, {} record marks, {}",
                     layout.order == std::endian::big ? "big" : "little",
                     layout.has_marks ? "with" : "without", grids_text(layout));
}

std::string precision_text(const Plot3dLayout& layout) {
  return fmt::format("{} precision{}", layout.is_double ? "double" : "single",
                     layout.has_blanks ? ", iblank" : "");
}

class Recogniser {
 public:
  Recogniser(const NamedBytes& file, Plot3dKind kind) : file_(file), kind_(kind) {}

  Plot3dLayout recognise() {
    refuse_text();
    try_all();
    std::vector<Plot3dLayout>& fitting = exact_.empty() ? padded_ : exact_;
    // Marks that are right at every record are no chance; of a size alone that may be one.
    if (std::any_of(fitting.begin(), fitting.end(),
                    [](const Plot3dLayout& layout) { return layout.has_marks; })) {
      std::erase_if(fitting, [](const Plot3dLayout& layout) { return !layout.has_marks; });
    }
    if (fitting.size() > 1) {
      throw Error(fmt::format("the {} may be '{}' or '{}': {} bytes fit both", word_of(kind_),
                              text_of(fitting[0]), text_of(fitting[1]), bytes().size()),
                  place(0),
                  exact_.empty()
                      ? "cut off the zero bytes behind its end, or write it with record marks"
                      : "write it with record marks, or in the other precision");
    }
    if (fitting.empty()) {
      refuse();
    }
    return std::move(fitting.front());
  }

 private:
  [[nodiscard]] std::string_view bytes() const { return file_.bytes; }
  [[nodiscard]] std::string place(std::size_t at) const {
    return fmt::format("{}: byte {}", file_.name, at);
  }

  void refuse_text() const {
    const std::string_view head = bytes().substr(0, 64);
    if (!head.empty() &&
        head.find_first_not_of(" \t\r\n0123456789.+-eEdD,*") == std::string_view::npos) {
      throw Error(fmt::format("a {} as text (formatted)", word_of(kind_)), place(0),
                  "write it unformatted, as binary numbers");
    }
  }

  void try_all() {
    for (const std::endian order : {std::endian::big, std::endian::little}) {
      for (const bool has_marks : {false, true}) {
        for (const bool is_multiple : {false, true}) {
          Plot3dLayout layout;
          layout.order = order;
          layout.has_marks = has_marks;
          layout.is_multiple = is_multiple;
          if (read_sizes(layout)) {
            try_precisions(layout);
          }
        }
      }
    }
  }

  void try_precisions(Plot3dLayout& layout) {
    std::string sizes;
    for (const bool is_double : {false, true}) {
      for (const bool has_blanks : {false, true}) {
        if (has_blanks && kind_ == Plot3dKind::solution) {
          continue;
        }
        layout.is_double = is_double;
        layout.has_blanks = has_blanks;
        place_grids(layout);
        sizes += fmt::format("{}{} bytes ({})", sizes.empty() ? "" : ", ", layout.end,
                             precision_text(layout));
        const bool is_exact = layout.end == bytes().size();
        const bool is_padded =
            layout.end < bytes().size() &&
            bytes().find_first_not_of('\0', layout.end) == std::string_view::npos;
        if ((is_exact || is_padded) && has_right_marks(layout)) {
          (is_exact ? exact_ : padded_).push_back(layout);
        }
      }
    }
    tried_.push_back(fmt::format("{}: {}", coding_text(layout), sizes));
  }

  /// Where each grid's numbers are, and the end.
  void place_grids(Plot3dLayout& layout) const {
    const std::size_t mark = layout.has_marks ? kMark : 0;
    std::size_t at = head_end_;
    for (Plot3dGrid& grid : layout.grids) {
      grid.at = grid.values_at = at + mark;
      if (kind_ == Plot3dKind::solution) {
        grid.values_at = grid.at + kFreeStreamNumbers * layout.real_bytes() + 2 * mark;
      }
      at = grid.values_at + values_bytes(layout, grid) + mark;
    }
    layout.end = at;
  }

  [[nodiscard]] std::size_t values_bytes(const Plot3dLayout& layout,
                                         const Plot3dGrid& grid) const {
    const std::size_t n_bytes = kind_ == Plot3dKind::solution
                                    ? 5 * layout.real_bytes()
                                    : 3 * layout.real_bytes() + (layout.has_blanks ? 4 : 0);
    return grid.n_points() * n_bytes;
  }

  bool has_right_marks(const Plot3dLayout& layout) {
    if (!layout.has_marks) {
      return true;
    }
    return std::all_of(layout.grids.begin(), layout.grids.end(), [&](const Plot3dGrid& grid) {
      return (kind_ == Plot3dKind::grid ||
              is_record(layout.order, grid.at, kFreeStreamNumbers * layout.real_bytes())) &&
             is_record(layout.order, grid.values_at, values_bytes(layout, grid));
    });
  }

  bool is_record(std::endian order, std::size_t at, std::size_t n_bytes) {
    for (const std::size_t mark_at : {at - kMark, at + n_bytes}) {
      const std::optional<std::size_t> mark = integer(order, mark_at);
      if (!mark || *mark != n_bytes) {
        wrong_mark_ = {mark_at, n_bytes};
        return false;
      }
    }
    return true;
  }

  [[nodiscard]] std::optional<std::size_t> integer(std::endian order, std::size_t at) const {
    std::array<char, 4> number{};
    if (bytes().size() < number.size() || at > bytes().size() - number.size()) {
      return std::nullopt;
    }
    std::memcpy(number.data(), bytes().data() + at, number.size());
    if (order != std::endian::native) {
      std::reverse(number.begin(), number.end());
    }
    return std::bit_cast<std::uint32_t>(number);
  }

  /// @return  whether the file may begin so
  bool read_sizes(Plot3dLayout& layout) {
    const std::size_t mark = layout.has_marks ? kMark : 0;
    const auto is_marked = [&](std::size_t at, std::size_t n) {
      return !layout.has_marks ||
             (integer(layout.order, at - kMark) == n && integer(layout.order, at + n) == n);
    };
    std::size_t at = mark;
    std::size_t n_grids = 1;
    if (layout.is_multiple) {
      n_grids = integer(layout.order, at).value_or(0);
      if (n_grids == 0 || n_grids > bytes().size() / 12 || !is_marked(at, 4)) {
        return false;
      }
      at += 4 + 2 * mark;
    }
    if (!is_marked(at, 12 * n_grids)) {
      return false;
    }
    std::size_t n_points = 0;
    for (std::size_t g = 0; g < n_grids; ++g) {
      Plot3dGrid grid;
      for (std::size_t& size : grid.size) {
        size = integer(layout.order, at).value_or(0);
        at += 4;
        if (size == 0 || size >= kMostAlong) {
          return false;
        }
      }
      if (grid.size[0] * grid.size[1] > kMostPoints / grid.size[2]) {
        return false;
      }
      n_points += grid.n_points();
      if (n_points > kMostPoints) {
        return false;
      }
      layout.grids.push_back(grid);
    }
    head_end_ = at + mark;
    return true;
  }

  [[noreturn]] void refuse() const {
    if (wrong_mark_) {
      throw Error(fmt::format("no record mark of {} bytes, where a record begins or ends",
                              wrong_mark_->second),
                  place(wrong_mark_->first),
                  "the file is damaged, or was copied as text: write it again");
    }
    if (tried_.empty()) {
      throw Error(
          fmt::format("the first numbers of the {} are no sizes of grids: tried were big- and "
                      "little-endian, with and without record marks, one grid and a list",
                      word_of(kind_)),
          place(0), "give an unformatted PLOT3D file in three dimensions");
    }
    std::string tried;
    for (std::size_t i = 0; i < std::min<std::size_t>(tried_.size(), 3); ++i) {
      tried += (i > 0 ? "; " : "") + tried_[i];
    }
    throw Error(fmt::format("the {}'s {} bytes fit no layout; tried were {}", word_of(kind_),
                            bytes().size(), tried),
                place(bytes().size()),
                kind_ == Plot3dKind::grid
                    ? "the file is cut short, or no PLOT3D grid: copy or write it again"
                    : "the file is cut short, or has other variables than PLOT3D's five: copy "
                      "or write it again");
  }

  const NamedBytes& file_;
  Plot3dKind kind_;
  std::size_t head_end_ = 0;
  std::vector<Plot3dLayout> exact_;
  std::vector<Plot3dLayout> padded_;  ///< followed by zero bytes
  std::vector<std::string> tried_;
  std::optional<std::pair<std::size_t, std::size_t>> wrong_mark_;  ///< where, and what it is
};

}  // namespace

std::string text_of(const Plot3dLayout& layout) {
  return coding_text(layout) + ", " + precision_text(layout);
}

Plot3dLayout recognise_plot3d(const NamedBytes& file, Plot3dKind kind) {
  return Recogniser(file, kind).recognise();
}

}  // namespace haarlight::render
