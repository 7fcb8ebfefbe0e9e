// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "apps/haarlight/verb.h"
#include "capture/commission/commission_pipeline.h"

/// @file
/// `haarlight rig commission RIG.toml`: what the rig really does, by flashing its lights.

namespace haarlight::apps {

struct CommissionArguments {
  capture::CommissionRigOptions options;
  bool flash_ok = false;
};

/// Adds --flash-ok, --timing-only and --steps.
void add_commission_options(Command verb, CommissionArguments& arguments);

/// Asks, measures, tells. Exit code 1: something is wrong with the rig or its file.
ExitCode run_commission(const CommissionArguments& arguments, const CommonOptions& common,
                        Report& report);

}  // namespace haarlight::apps
