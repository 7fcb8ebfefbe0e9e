// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/square_light.h"

/// @file
/// The lights of a job in blocks of 2 x 2, 4 x 4 ...: each block is one square light that
/// represents its members, and its shadow picture is their mean, weighted by their light
/// weights. With equal weights that is the coarse Haar scaling coefficient of the block. Its
/// position and size are the mean and the spread of its members', so that its irradiance agrees
/// with theirs to the third moment.

namespace haarlight::render {

struct LightNode {
  SquareLight block;    ///< radiance of one member; size of the block
  SquareLight centres;  ///< square between the outermost members' centres; no size at a leaf
  Eigen::Vector3d weight = Eigen::Vector3d::Zero();  ///< sum of the members'
  double fraction = 0.0;    ///< fraction of its parent's weight, mean of the colours
  double area_ratio = 1.0;  ///< a member's area over the block's
  int first_child = 0;      ///< children are contiguous, after their parent
  int n_children = 0;       ///< 0: a leaf
  int light = -1;           ///< of a leaf: its index in the list of lights
  int member = 0;           ///< some leaf below it, itself at a leaf
};

/// At most side x side lights of one face.
struct LightRoot {
  std::vector<LightNode> nodes;  ///< [0] is the root; parents precede their children
  std::vector<int> leaves;       ///< their nodes, row by row: the order of exact sums
};

/// Regular grids in the list are found and cut at multiples of `side`; a light without
/// neighbours is a root of its own. Lights of zero weight are in no tree, and no node has a
/// single child.
/// @param side  a power of two
[[nodiscard]] std::vector<LightRoot> build_light_trees(std::span<const SquareLight> lights,
                                                       std::span<const Eigen::Vector3d> weights,
                                                       int side);

}  // namespace haarlight::render
