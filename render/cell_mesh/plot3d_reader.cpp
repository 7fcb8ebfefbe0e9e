// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/mesh_numbers.h"
#include "render/cell_mesh/plot3d_layout.h"

namespace haarlight::render {

namespace {

constexpr std::size_t kDensity = 0;
constexpr std::size_t kMomentum = 1;
constexpr std::size_t kEnergy = 2;

class Plot3dReader {
 public:
  explicit Plot3dReader(const NamedBytes& grid)
      : file_(grid), layout_(recognise_plot3d(grid, Plot3dKind::grid)) {}

  CellMesh read(const std::optional<NamedBytes>& solution) {
    note(file_, layout_);
    if (std::all_of(layout_.grids.begin(), layout_.grids.end(),
                    [](const Plot3dGrid& grid) { return n_cells_of(grid) == 0; })) {
      throw Error(fmt::format("no volume: {}", text_of(layout_)),
                  fmt::format("{}: byte 0", file_.name),
                  "a volume has two points or more along each of i, j and k");
    }
    for (const Plot3dGrid& grid : layout_.grids) {
      add_grid(grid);
    }
    if (mesh_.n_blanked == 0) {
      mesh_.numbers_in_file.clear();
    }
    if (solution) {
      add_solution(*solution);
    }
    return std::move(mesh_);
  }

 private:
  static std::size_t n_cells_of(const Plot3dGrid& grid) {
    return (grid.size[0] - 1) * (grid.size[1] - 1) * (grid.size[2] - 1);
  }

  void note(const NamedBytes& file, const Plot3dLayout& layout) {
    mesh_.notes.push_back(fmt::format("{}: {}", file.name, text_of(layout)));
    if (layout.end < file.bytes.size()) {
      mesh_.notes.push_back(fmt::format("{}: {} zero bytes behind the end, from byte {} on",
                                        file.name, file.bytes.size() - layout.end, layout.end));
    }
  }

  /// The i-th array of `n` reals from `at` on.
  static std::vector<double> reals(const NamedBytes& file, const Plot3dLayout& layout,
                                   std::size_t at, std::size_t i, std::size_t n) {
    const std::size_t n_bytes = n * layout.real_bytes();
    std::vector<double> values;
    append_numbers(file.bytes.substr(at + i * n_bytes, n_bytes),
                   layout.is_double ? NumberType::f64 : NumberType::f32, layout.order, values);
    return values;
  }

  void add_grid(const Plot3dGrid& grid) {
    const std::size_t n = grid.n_points();
    const std::size_t first_point = mesh_.points.size();
    const std::size_t first_cell = mesh_.n_cells();
    const std::vector<double> x = reals(file_, layout_, grid.values_at, 0, n);
    const std::vector<double> y = reals(file_, layout_, grid.values_at, 1, n);
    const std::vector<double> z = reals(file_, layout_, grid.values_at, 2, n);
    mesh_.points.reserve(first_point + n);
    for (std::size_t i = 0; i < n; ++i) {
      mesh_.points.emplace_back(x[i], y[i], z[i]);
    }
    std::vector<double> blanks;
    if (layout_.has_blanks) {
      append_numbers(file_.bytes.substr(grid.values_at + 3 * n * layout_.real_bytes(), 4 * n),
                     NumberType::i32, layout_.order, blanks);
    }
    for (std::size_t k = 0; k + 1 < grid.size[2]; ++k) {
      for (std::size_t j = 0; j + 1 < grid.size[1]; ++j) {
        for (std::size_t i = 0; i + 1 < grid.size[0]; ++i) {
          add_cell(grid, i + grid.size[0] * (j + grid.size[1] * k), first_point, blanks);
        }
      }
    }
    turn_if_left_handed(first_cell);
  }

  /// @param corner  the cell's point of least i, j and k
  void add_cell(const Plot3dGrid& grid, std::size_t corner, std::size_t first_point,
                const std::vector<double>& blanks) {
    const std::size_t along_j = grid.size[0];
    const std::size_t along_k = grid.size[0] * grid.size[1];
    const std::array<std::size_t, 8> points = {corner,
                                               corner + 1,
                                               corner + 1 + along_j,
                                               corner + along_j,
                                               corner + along_k,
                                               corner + 1 + along_k,
                                               corner + 1 + along_j + along_k,
                                               corner + along_j + along_k};
    const std::size_t number = n_numbered_++;
    if (!blanks.empty() && std::any_of(points.begin(), points.end(), [&](std::size_t point) {
          return blanks[point] == 0.0;
        })) {
      ++mesh_.n_blanked;
      return;
    }
    mesh_.types.push_back(CellType::hexahedron);
    mesh_.begins.push_back(mesh_.nodes.size());
    mesh_.numbers_in_file.push_back(number);
    for (const std::size_t point : points) {
      mesh_.nodes.push_back(static_cast<std::uint32_t>(first_point + point));
    }
  }

  /// Of the grid whose cells are the last: i, j, k are left-handed if their volume is negative.
  void turn_if_left_handed(std::size_t first_cell) {
    double volume = 0.0;
    for (std::size_t i = first_cell; i < mesh_.n_cells(); ++i) {
      volume += cell_volume(mesh_, i);
    }
    if (!(volume < 0.0)) {
      return;
    }
    for (std::size_t i = first_cell; i < mesh_.n_cells(); ++i) {
      auto* const nodes = mesh_.nodes.data() + mesh_.begins[i];
      std::swap_ranges(nodes, nodes + 4, nodes + 4);
    }
    mesh_.n_turned += mesh_.n_cells() - first_cell;
  }

  void add_solution(const NamedBytes& file) {
    const Plot3dLayout layout = recognise_plot3d(file, Plot3dKind::solution);
    if (!std::equal(layout.grids.begin(), layout.grids.end(), layout_.grids.begin(),
                    layout_.grids.end(), [](const Plot3dGrid& a, const Plot3dGrid& b) {
                      return a.size == b.size;
                    })) {
      throw Error(fmt::format("a solution of another grid: {}; the grid is {}", text_of(layout),
                              text_of(layout_)),
                  fmt::format("{}: byte 0", file.name),
                  "give the solution that was written with this grid");
    }
    note(file, layout);
    const std::vector<double> stream = reals(file, layout, layout.grids.front().at, 0, 4);
    mesh_.notes.push_back(fmt::format(
        "{}: Mach {:.6g}, angle of attack {:.6g}, Reynolds number {:.6g}, time {:.6g}",
        file.name, stream[0], stream[1], stream[2], stream[3]));
    std::array<MeshField, 3> fields = {{{.name = "density", .n_components = 1, .values = {}},
                                        {.name = "momentum", .n_components = 3, .values = {}},
                                        {.name = "energy", .n_components = 1, .values = {}}}};
    for (const Plot3dGrid& grid : layout.grids) {
      const std::size_t n = grid.n_points();
      const auto append = [&](MeshField& field, std::size_t i) {
        const std::vector<double> values = reals(file, layout, grid.values_at, i, n);
        field.values.insert(field.values.end(), values.begin(), values.end());
      };
      append(fields[kDensity], 0);
      append(fields[kEnergy], 4);
      const std::vector<double> x = reals(file, layout, grid.values_at, 1, n);
      const std::vector<double> y = reals(file, layout, grid.values_at, 2, n);
      const std::vector<double> z = reals(file, layout, grid.values_at, 3, n);
      for (std::size_t i = 0; i < n; ++i) {
        fields[kMomentum].values.insert(fields[kMomentum].values.end(), {x[i], y[i], z[i]});
      }
    }
    mesh_.point_fields.assign(std::make_move_iterator(fields.begin()),
                              std::make_move_iterator(fields.end()));
  }

  const NamedBytes& file_;
  Plot3dLayout layout_;
  CellMesh mesh_;
  std::size_t n_numbered_ = 0;  ///< cells so far, blanked ones too
};

}  // namespace

CellMesh parse_plot3d(const NamedBytes& grid, const std::optional<NamedBytes>& solution) {
  return Plot3dReader(grid).read(solution);
}

}  // namespace haarlight::render
