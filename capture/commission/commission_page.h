// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "capture/commission/commission.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// A commissioning on one page: what was measured with its uncertainty, the step response, the
/// photon transfer curve, the linearity, and a map of the lights. One HTML file with embedded
/// figures that loads nothing from elsewhere.

namespace haarlight::capture {

/// @param rig  as written: its values are shown next to the measured ones
[[nodiscard]] std::string commission_page(const Rig& rig, int camera,
                                          const CommissionResult& result);

/// One measured quantity next to the rig file's value.
struct CommissionRow {
  std::string name;
  std::string measured;  ///< "812 us"
  std::string sigma;     ///< "20 us", or empty
  std::string written;   ///< of the rig file, or empty
  std::string meaning;
};
/// The rows printed by the page's table and the command.
[[nodiscard]] std::vector<CommissionRow> commission_rows(const Rig& rig, int camera,
                                                         const CommissionResult& result);

}  // namespace haarlight::capture
