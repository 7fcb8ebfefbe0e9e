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
/// A rig commissioned from its file: opens its devices, measures (commission.h), writes a page,
/// and keeps what was measured in NAME.measured.toml beside the file, unless that contradicts
/// it.

namespace haarlight {

struct CommissionRigOptions {
  std::string rig;     ///< the rig file
  std::string camera;  ///< id; empty: the first
  std::string page;    ///< empty: NAME.commission.html beside the rig file
  int steps = CommissionOptions{}.fine_steps;
  bool measures_timing_only = false;
  bool may_overwrite = false;  ///< page and measured values that exist
  /// GET of a local address: empty where nobody answers. A daemon that answers holds the
  /// devices.
  std::function<std::string(const std::string& url)> fetch;
  /// Called when all else is checked, before a device is touched: flashing is begun by a person
  /// who was told. Throws where nobody agrees.
  std::function<void()> require_consent;
  /// Called before the devices are opened and their threads start; may be empty.
  std::function<void()> begin;
  std::function<bool()> should_stop;  ///< asked between frames
  std::function<void(std::string_view stage, double share)> progress;
};

struct CommissionRigSummary {
  CommissionResult result;
  std::vector<CommissionRow> rows;
  std::string page;
  std::string measured;     ///< the file; empty: contradictions, nothing was stored
  std::string warning;      ///< of an older measured file that was replaced; empty: none
  std::uint64_t bytes = 0;  ///< of the measured file
  /// Nothing contradicts the rig file, and no light needs hands.
  [[nodiscard]] bool is_good() const {
    return result.contradictions.empty() && result.faults.empty();
  }
};

/// @throws Error(unavailable)  a daemon or nobody answers; as commission()
/// @throws Error  no such camera, outputs that exist
[[nodiscard]] CommissionRigSummary commission_rig(const CommissionRigOptions& options);

/// What was measured, where it was written.
[[nodiscard]] std::string commission_text(const CommissionRigSummary& summary);
/// What is wrong and its cure; empty: nothing.
[[nodiscard]] std::string commission_faults(const CommissionRigOptions& options,
                                            const CommissionRigSummary& summary);
void add_to_report(const CommissionRigSummary& summary, Report& report);

}  // namespace haarlight
