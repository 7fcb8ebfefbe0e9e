// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/light_grid.h"
#include "render/direct/silhouette_edges.h"

/// @file
/// A grid of lights as flat cells side by side, one light in the middle of each, and which of
/// them a segment crosses as seen from a point.

namespace haarlight::render {

/// What crosses a cell, as bits: something; its light; where on the light is not known.
constexpr std::uint8_t kCellCrossed = 1;
constexpr std::uint8_t kLightCrossed = 2;
constexpr std::uint8_t kAnywhere = 4;

/// Of a light's side: an edge that passes so near a light crosses it. Covers the ray caster's
/// single precision.
constexpr double kCellMargin = 1e-3;
/// Half a cell with the margin, in cells.
constexpr double kHalfCell = 0.5 + kCellMargin;

/// Calls `work(row, col)` for the rectangles of +-half around whole numbers that a segment
/// meets; rows go with y, columns with x.
template <class Work>
void for_each_crossed(const Eigen::Vector2d& a, const Eigen::Vector2d& b,
                      const Eigen::Vector2d& half, int rows, int cols, const Work& work) {
  const Eigen::Vector2d& down = a.y() <= b.y() ? a : b;
  const Eigen::Vector2d& up = a.y() <= b.y() ? b : a;
  const auto first_of = [](double x, int n) {
    return static_cast<int>(std::clamp(std::ceil(x), 0.0, static_cast<double>(n)));
  };
  const auto last_of = [](double x, int n) {
    return static_cast<int>(std::clamp(std::floor(x), -1.0, static_cast<double>(n - 1)));
  };
  const double rise = up.y() - down.y();
  const int last_row = last_of(up.y() + half.y(), rows);
  for (int row = first_of(down.y() - half.y(), rows); row <= last_row; ++row) {
    double x0 = down.x();
    double x1 = up.x();
    if (rise > 1e-9) {
      const double from = std::clamp((row - half.y() - down.y()) / rise, 0.0, 1.0);
      const double to = std::clamp((row + half.y() - down.y()) / rise, 0.0, 1.0);
      x0 = down.x() + from * (up.x() - down.x());
      x1 = down.x() + to * (up.x() - down.x());
    }
    const int last_col = last_of(std::max(x0, x1) + half.x(), cols);
    for (int col = first_of(std::min(x0, x1) - half.x(), cols); col <= last_col; ++col) {
      work(row, col);
    }
  }
}

/// Gives cells that nothing crosses and that lie side by side the number of one region, each
/// crossed cell one of its own. @param marks  (rows * cols,), not 0: crossed
/// @param labels  working memory
/// @param regions  out, (rows * cols,), -1 where `is_left_out(cell)`
/// @param cell_of  out, the first cell of each region
template <class LeftOut>
void find_regions(int rows, int cols, std::span<const std::uint8_t> marks,
                  const LeftOut& is_left_out, std::vector<int>& labels, std::span<int> regions,
                  std::vector<int>& cell_of) {
  // Each label leads to an earlier one of the same region, the first one to itself.
  labels.clear();
  cell_of.clear();
  const auto index = [](int i) { return static_cast<std::size_t>(i); };
  const auto first_of = [&](int label) {
    while (labels[index(label)] != label) {
      label = labels[index(label)];
    }
    return label;
  };
  for (int row = 0, cell = 0; row < rows; ++row) {
    for (int col = 0; col < cols; ++col, ++cell) {
      if (is_left_out(cell)) {
        regions[index(cell)] = -1;
        continue;
      }
      const auto label_of = [&](bool is_there, int other) {
        return is_there && marks[index(other)] == 0 ? regions[index(other)] : -1;
      };
      const bool is_open = marks[index(cell)] == 0;
      const int left = label_of(is_open && col > 0, cell - 1);
      const int above = label_of(is_open && row > 0, cell - cols);
      int label = std::max(left, above);
      if (label < 0) {
        label = static_cast<int>(labels.size());
        labels.push_back(label);
        cell_of.push_back(cell);
      } else if (left >= 0 && above >= 0 && left != above) {
        const int a = first_of(left);
        const int b = first_of(above);
        label = std::min(a, b);
        labels[index(std::max(a, b))] = label;
      }
      regions[index(cell)] = label;
    }
  }
  int n_regions = 0;
  for (int label = 0; label < static_cast<int>(labels.size()); ++label) {
    const bool is_first = labels[index(label)] == label;
    if (is_first) {
      cell_of[index(n_regions)] = cell_of[index(label)];
    }
    labels[index(label)] = is_first ? n_regions++ : labels[index(labels[index(label)])];
  }
  cell_of.resize(index(n_regions));
  for (int& region : regions.first(index(rows * cols))) {
    region = region < 0 ? -1 : labels[index(region)];
  }
}

/// On the lights' plane, in cells: whole numbers are the lights' centres.
struct FlatSegment {
  Eigen::Vector2d a;
  Eigen::Vector2d b;
};

class LightCells {
 public:
  LightCells(const LightGrid& grid, const SquareLight& first);

  [[nodiscard]] const LightGrid& grid() const noexcept { return grid_; }
  [[nodiscard]] int size() const noexcept { return grid_.rows * grid_.cols; }
  /// Distance of a point from the lights' plane, positive on the side that they shine on.
  [[nodiscard]] double height(const Eigen::Vector3d& point) const {
    return emits_.dot(point - first_);
  }
  [[nodiscard]] Pyramid pyramid(const Eigen::Vector3d& apex) const;
  /// The part of a segment that is seen through the cells from the pyramid's apex, on the
  /// lights' plane; what is behind the apex or beyond the plane is not.
  [[nodiscard]] std::optional<FlatSegment> project(const Pyramid& pyramid,
                                                   const Eigen::Vector3d& a,
                                                   const Eigen::Vector3d& b) const;
  /// Adds the bits of the cells that it crosses; calls `on_light(cell)` for each light.
  /// @param marks  (size(),)
  template <class OnLight>
  void mark(const FlatSegment& segment, std::span<std::uint8_t> marks,
            const OnLight& on_light) const {
    const auto add = [&](int row, int col, std::uint8_t bit) {
      const int cell = row * grid_.cols + col;
      std::uint8_t& at = marks[static_cast<std::size_t>(cell)];
      at = static_cast<std::uint8_t>(at | bit);
      return cell;
    };
    for_each_crossed(segment.a, segment.b, Eigen::Vector2d::Constant(kHalfCell), grid_.rows,
                     grid_.cols, [&](int row, int col) { add(row, col, kCellCrossed); });
    for_each_crossed(segment.a, segment.b, kHalfCell * side_, grid_.rows, grid_.cols,
                     [&](int row, int col) { on_light(add(row, col, kLightCrossed)); });
  }
  /// Marks those of n x n strata of a light that a segment crosses. @param marks  (n * n,)
  void mark_strata(const FlatSegment& segment, int cell, int n,
                   std::span<std::uint8_t> marks) const;
  /// Sets all bits wherever geometry crosses the lights' plane or ends at it: within `reach`
  /// on the side that they shine on, where shadow rays end.
  void mark_crossing(const SilhouetteEdges& edges, double reach,
                     std::span<std::uint8_t> marks) const;

 private:
  [[nodiscard]] Eigen::Vector2d low() const;
  [[nodiscard]] Eigen::Vector2d high() const;
  LightGrid grid_;
  Eigen::Vector3d first_;  ///< centre of the first light
  Eigen::Vector3d u_;
  Eigen::Vector3d v_;
  Eigen::Vector3d emits_;
  Eigen::Vector2d step_;  ///< mm from cell to cell
  Eigen::Vector2d side_;  ///< of a light, in cells
};

}  // namespace haarlight::render
