// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

/// @file
/// Many lights in a bounding volume hierarchy, from which one is drawn by what it could contribute
/// at a point at most [Conty18]: its intensity, over the squared distance, times the largest
/// cosines at which the point may see it and it may see the point. A light that could contribute
/// is always drawn with some probability.

namespace haarlight::render {

/// Where a light is, where it shines, and how brightly.
struct LightBounds {
  Eigen::AlignedBox3d box;
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< unit, of the cone of its normals
  double cos_normals = -1.0;  ///< of the cone's half angle; -1: all directions
  bool has_cosine = true;  ///< shines by the cosine to its normals; else within the cone alone
  double intensity = 0.0;  ///< largest over the directions, mean of the colours, U mm^2
};

class LightBvh {
 public:
  struct Choice {
    std::size_t light = 0;
    double probability = 0.0;
    double within = 0.0;  ///< where in its part of [0, 1) the number was
  };

  LightBvh() = default;
  /// Lights of intensity above 0; split by [Conty18]'s cost: intensity, area, width of the cone.
  explicit LightBvh(std::span<const LightBounds> lights);

  /// Nothing: no light could contribute there.
  /// @param normal  unit, of the side that is lit @param number  in [0, 1)
  [[nodiscard]] std::optional<Choice> choose(const Eigen::Vector3d& point,
                                             const Eigen::Vector3d& normal,
                                             double number) const;
  /// With which `choose` finds a light there.
  [[nodiscard]] double probability(std::size_t light, const Eigen::Vector3d& point,
                                   const Eigen::Vector3d& normal) const;

 private:
  struct Node {
    LightBounds bounds;
    std::size_t second = 0;  ///< index of its second child, the first follows it; of a leaf: 0
    std::size_t light = 0;   ///< of a leaf
  };
  std::size_t build(std::span<const LightBounds> lights, std::span<std::size_t> which,
                    std::uint64_t trail, unsigned depth);
  /// Of the first child.
  [[nodiscard]] std::optional<double> first_probability(std::size_t node,
                                                        const Eigen::Vector3d& point,
                                                        const Eigen::Vector3d& normal) const;

  std::vector<Node> nodes_;
  std::vector<std::uint64_t>
      trails_;  ///< by light: bit d is set where it is in the second child
};

/// What a light within the bounds contributes at most, up to a factor: 0 only where it cannot.
[[nodiscard]] double importance(const LightBounds& bounds, const Eigen::Vector3d& point,
                                const Eigen::Vector3d& normal);

}  // namespace haarlight::render
