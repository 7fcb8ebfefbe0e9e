// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/pipeline/relight_choice.h"

/// @file
/// Predicted seconds and error bounds of the ways to sum pictures of one basis file, by a pilot on
/// a few of its tiles. Method: docs/numerics/relight.md, "Seconds".

namespace haarlight::relight {

struct RelightCostPlan {
  bool is_in_passing = true;  ///< pictures are read from the file only: one picture
  bool may_be_halved = true;  ///< half floats are fine enough
  std::size_t at_once = 1;    ///< pictures that share a pass over the file
  TermOrder order = TermOrder::transport;
  std::uint64_t memory_bytes = std::uint64_t{2} << 30U;  ///< for a form that is held
};

/// The sum of all terms costs one picture no more than predict_costs() would: of a file of a tile
/// or two.
[[nodiscard]] bool costs_less_than_prediction(const BasisFile& basis);

/// What every form takes that the file and the plan allow: seconds of a clock on as many threads
/// as parallel_for() takes, if no other program needs them.
/// @param weights  of all pictures
/// @throws Error  as relight::relight()
[[nodiscard]] std::vector<FormCost> predict_costs(const BasisFile& basis,
                                                  std::span<const LightWeights> weights,
                                                  const RelightCostPlan& plan);

}  // namespace haarlight::relight
