// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/light_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "haarlight/core/error.h"
#include "haarlight/render/light/light_grid.h"

namespace haarlight::render {
namespace {

/// A square of a grid's lights.
struct Square {
  int row = 0;
  int col = 0;
  int side = 1;
};

class Builder {
 public:
  Builder(std::span<const SquareLight> lights, std::span<const Eigen::Vector3d> weights,
          LightGrid grid)
      : lights_(lights), weights_(weights), grid_(std::move(grid)) {}

  LightRoot build(const Square& square) {
    LightRoot root;
    const std::vector<int> members = members_of(square);
    if (members.empty()) {
      return root;
    }
    root.nodes.resize(1);
    root.nodes[0].fraction = 1.0;
    fill(root, 0, square, members);
    for (std::size_t i = root.nodes.size(); i-- > 0;) {
      LightNode& node = root.nodes[i];
      node.member = node.n_children == 0
                        ? static_cast<int>(i)
                        : root.nodes[static_cast<std::size_t>(node.first_child)].member;
      if (node.n_children == 0) {
        root.leaves.push_back(static_cast<int>(i));
      }
    }
    std::sort(root.leaves.begin(), root.leaves.end(), [&](int a, int b) {
      return root.nodes[static_cast<std::size_t>(a)].light <
             root.nodes[static_cast<std::size_t>(b)].light;
    });
    return root;
  }

 private:
  [[nodiscard]] std::vector<int> members_of(const Square& square) const {
    std::vector<int> members;
    for (int row = square.row; row < std::min(square.row + square.side, grid_.rows); ++row) {
      for (int col = square.col; col < std::min(square.col + square.side, grid_.cols); ++col) {
        const int k = grid_.first + row * grid_.cols + col;
        if (!weights_[static_cast<std::size_t>(k)].isZero(0.0)) {
          members.push_back(k);
        }
      }
    }
    return members;
  }

  [[nodiscard]] double fraction_of(int k) const {
    return std::abs(weights_[static_cast<std::size_t>(k)].mean());
  }

  void fill(LightRoot& root, int at, Square square, const std::vector<int>& members) {
    LightNode node = root.nodes[static_cast<std::size_t>(at)];
    const SquareLight& one = lights_[static_cast<std::size_t>(members[0])];
    node.block = one;
    node.centres = one;
    node.centres.width_mm = node.centres.height_mm = 0.0;
    if (members.size() == 1) {
      node.light = members[0];
      node.weight = weights_[static_cast<std::size_t>(members[0])];
      root.nodes[static_cast<std::size_t>(at)] = node;
      return;
    }
    describe(node, one, members);
    // Squares with a single part are skipped.
    std::vector<std::pair<Square, std::vector<int>>> parts;
    while (parts.size() < 2) {
      parts.clear();
      const int half = square.side / 2;
      HAARLIGHT_ASSERT(half >= 1);
      for (const auto& [row, col] : {std::pair{0, 0}, {0, half}, {half, 0}, {half, half}}) {
        const Square quarter{square.row + row, square.col + col, half};
        std::vector<int> inside = members_of(quarter);
        if (!inside.empty()) {
          parts.emplace_back(quarter, std::move(inside));
        }
      }
      if (parts.size() == 1) {
        square = parts[0].first;
      }
    }
    node.first_child = static_cast<int>(root.nodes.size());
    node.n_children = static_cast<int>(parts.size());
    root.nodes[static_cast<std::size_t>(at)] = node;
    root.nodes.resize(root.nodes.size() + parts.size());
    double sum = 0.0;
    for (const auto& part : parts) {
      for (const int k : part.second) {
        sum += fraction_of(k);
      }
    }
    for (std::size_t i = 0; i < parts.size(); ++i) {
      double fraction = 0.0;
      for (const int k : parts[i].second) {
        fraction += fraction_of(k);
      }
      const std::size_t child = static_cast<std::size_t>(node.first_child) + i;
      root.nodes[child].fraction =
          sum > 0.0 ? fraction / sum : 1.0 / static_cast<double>(parts.size());
      fill(root, static_cast<int>(child), parts[i].first, parts[i].second);
    }
  }

  /// Position, size and weight of a block: first and second moments of its members'.
  void describe(LightNode& node, const SquareLight& one,
                const std::vector<int>& members) const {
    double sum = 0.0;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    Eigen::Vector2d square = Eigen::Vector2d::Zero();
    Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
    Eigen::Vector2d high = -low;
    const auto position_of = [&](int k) {
      const Eigen::Vector3d offset = lights_[static_cast<std::size_t>(k)].centre - one.centre;
      return Eigen::Vector2d(offset.dot(one.u), offset.dot(one.v));
    };
    for (const int k : members) {
      // Colours that cancel in the mean still need a position.
      const double fraction = fraction_of(k) + 1e-300;
      const Eigen::Vector2d at = position_of(k);
      sum += fraction;
      mean += fraction * at;
      square += fraction * at.cwiseProduct(at);
      low = low.cwiseMin(at);
      high = high.cwiseMax(at);
      node.weight += weights_[static_cast<std::size_t>(k)];
    }
    mean /= sum;
    const Eigen::Vector2d variance =
        (square / sum - mean.cwiseProduct(mean)).cwiseMax(Eigen::Vector2d::Zero());
    node.block.centre = one.centre + mean.x() * one.u + mean.y() * one.v;
    node.block.width_mm = std::sqrt(12.0 * variance.x() + one.width_mm * one.width_mm);
    node.block.height_mm = std::sqrt(12.0 * variance.y() + one.height_mm * one.height_mm);
    node.area_ratio =
        one.width_mm * one.height_mm / (node.block.width_mm * node.block.height_mm);
    const Eigen::Vector2d middle = 0.5 * (low + high);
    node.centres.centre = one.centre + middle.x() * one.u + middle.y() * one.v;
    node.centres.width_mm = high.x() - low.x();
    node.centres.height_mm = high.y() - low.y();
  }

  std::span<const SquareLight> lights_;
  std::span<const Eigen::Vector3d> weights_;
  LightGrid grid_;
};

}  // namespace

std::vector<LightRoot> build_light_trees(std::span<const SquareLight> lights,
                                         std::span<const Eigen::Vector3d> weights, int side) {
  HAARLIGHT_EXPECTS(lights.size() == weights.size(), "one weight per light");
  HAARLIGHT_EXPECTS(side >= 1 && (side & (side - 1)) == 0, "a power of two");
  std::vector<LightRoot> roots;
  for (const LightGrid& grid : find_light_grids(lights)) {
    Builder builder(lights, weights, grid);
    for (int row = 0; row < grid.rows; row += side) {
      for (int col = 0; col < grid.cols; col += side) {
        LightRoot root = builder.build({row, col, side});
        if (!root.nodes.empty()) {
          roots.push_back(std::move(root));
        }
      }
    }
  }
  return roots;
}

}  // namespace haarlight::render
