// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/command_line.h"
#include "relight/pipeline/light_choice.h"

/// @file
/// The options of every verb that lights a scene: an environment, or lights named one by one.

namespace haarlight::apps {

/// Adds --cubemap, --light and --rotate.
void add_light_options(Command verb, relight::LightChoice& choice);

}  // namespace haarlight::apps
