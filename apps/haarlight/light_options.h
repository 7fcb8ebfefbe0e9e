// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "apps/command_line.h"
#include "core/report.h"
#include "render/light/cubemap.h"

/// @file
/// The options of every verb that lights a scene: an environment, or lights named one by one.

namespace haarlight {

struct LightOptions {
  std::string cubemap;              ///< empty: none
  std::vector<std::string> lights;  ///< words for weights_from_words()
  double rotate_deg = 0.0;
};

/// Adds --cubemap, --light and --rotate.
void add_light_options(Command verb, LightOptions& options);

/// The environment of --cubemap, turned by --rotate; both go into the report.
[[nodiscard]] Environment read_environment(const LightOptions& options, Report& report);

}  // namespace haarlight
