// SPDX-License-Identifier: Apache-2.0
#include "render/scene/metals.h"

namespace haarlight::render {

// Copper, gold and silver: the films of [Johnson72], between two rows of its table (e.g. 616.8 and
// 659.5 nm) linear in the wavelength. Aluminium: the evaporated films of [McPeak15], rows of its
// table.
ComplexIor ior_of(Metal metal) {
  switch (metal) {
    case Metal::aluminium:
      return {.eta = {1.24636, 0.78941, 0.48922}, .k = {6.85233, 5.85194, 4.77832}};
    case Metal::copper:
      return {.eta = {0.23780, 1.00663, 1.24044}, .k = {3.62642, 2.58231, 2.39294}};
    case Metal::gold:
      return {.eta = {0.15557, 0.42415, 1.38309}, .k = {3.60245, 2.47205, 1.91550}};
    case Metal::silver:
      return {.eta = {0.05222, 0.05958, 0.04000}, .k = {4.40936, 3.59737, 2.64840}};
  }
  return {.eta = Eigen::Vector3d::Ones(), .k = Eigen::Vector3d::Zero()};
}

}  // namespace haarlight::render
