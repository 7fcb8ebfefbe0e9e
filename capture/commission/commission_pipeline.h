// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/commission/commission.h"
#include "capture/commission/commission_page.h"
#include "core/report.h"

/// @file
/// Commissions a rig from its file: opens its devices, measures (commission.h), writes a page,
/// and stores what was measured in NAME.measured.toml next to the file, unless that contradicts
/// it.

namespace haarlight::capture {

struct CommissionRigOptions {
  std::string rig;     ///< the rig file
  std::string camera;  ///< id; empty: the first
  std::string page;    ///< empty: NAME.commission.html next to the rig file
  int steps = CommissionOptions{}.fine_steps;
  bool measures_timing_only = false;
  bool may_overwrite = false;  ///< replace an existing page and measured values
  /// GET of a local address: empty without an answer. A daemon that answers holds the devices.
  std::function<std::string(const std::string& url)> fetch;
  /// Called when all else is checked, before a device is touched: an operator who was warned
  /// starts the flashing. Throws without consent.
  std::function<void()> require_consent;
  /// Called before the devices are opened and their threads start; may be empty.
  std::function<void()> begin;
  std::function<bool()> should_stop;  ///< polled between frames
  std::function<void(std::string_view stage, double fraction)> progress;
};

struct CommissionRigSummary {
  CommissionResult result;
  std::vector<CommissionRow> rows;
  std::string page;
  std::string measured;     ///< the file; empty: contradictions, nothing was stored
  std::string warning;      ///< of an older measured file that was replaced; empty: none
  std::uint64_t bytes = 0;  ///< of the measured file
  /// Nothing contradicts the rig file, and no light needs repair.
  [[nodiscard]] bool is_good() const {
    return result.contradictions.empty() && result.faults.empty();
  }
};

/// @throws Error(unavailable)  a daemon holds the devices, or a device does not answer; as
///     commission()
/// @throws Error  no such camera, outputs that exist
[[nodiscard]] CommissionRigSummary commission_rig(const CommissionRigOptions& options);

/// What was measured, and where it was written.
[[nodiscard]] std::string commission_text(const CommissionRigSummary& summary);
/// What is wrong, with a hint; empty: nothing.
[[nodiscard]] std::string commission_faults(const CommissionRigOptions& options,
                                            const CommissionRigSummary& summary);
void add_to_report(const CommissionRigSummary& summary, Report& report);

}  // namespace haarlight::capture
