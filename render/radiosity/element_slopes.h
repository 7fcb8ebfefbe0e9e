// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "render/radiosity/elements.h"
#include "render/radiosity/patches.h"

/// @file
/// Radiosity that is linear in each element, for the last gather: of a wall beside a vertex the nearest
/// patch fills half of what the vertex sees, and it is not as bright at its edge as in its middle. The
/// mean over an element stays what was solved for.

namespace haarlight::render {

class ElementSlopes {
 public:
  /// The plane through each element's value that is nearest to those of the patches beside it in its
  /// triangle, as steep as leaves nothing below 0. None in elements of split sides.
  /// @param radiosity  (elements,); is kept by reference
  ElementSlopes(const Patches& patches, const Elements& elements,
                const std::vector<Eigen::Vector3d>& radiosity);

  /// @param at  in the element's patch
  [[nodiscard]] Eigen::Vector3d radiosity(std::size_t element, const PatchPoint& at) const {
    const Eigen::Vector3d& mean = (*radiosity_)[element];
    return element < slopes_.size()
               ? Eigen::Vector3d(mean + slopes_[element].cast<double>() *
                                            Eigen::Vector2d(at.weights[1] - 1.0 / 3.0,
                                                            at.weights[2] - 1.0 / 3.0))
               : mean;
  }

 private:
  /// By side: per weight of the patch's second and third vertex.
  std::vector<Eigen::Matrix<float, 3, 2>> slopes_;
  const std::vector<Eigen::Vector3d>* radiosity_;
};

}  // namespace haarlight::render
