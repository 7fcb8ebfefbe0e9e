// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/haarlight/verb.h"

/// @file
/// The verbs of `haarlight rig` that need the rig's devices.

namespace haarlight::apps {

void add_rig_doctor(Command rig, Invocation& invocation);
void add_rig_commission(Command rig, Invocation& invocation);

}  // namespace haarlight::apps
