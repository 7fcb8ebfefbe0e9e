// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "capture/plan/advice.h"
#include "core/report.h"

/// @file
/// Advice as text for the user and for a report. Pure.

namespace haarlight::capture {

/// Every family with its predictions, notes and refusals, and which is advised. Whole lines.
[[nodiscard]] std::string advice_text(const Rig& rig, const AdviceScene& scene,
                                      const Advice& advice, double target_db);
void add_to_report(const Advice& advice, Report& report);

}  // namespace haarlight::capture
