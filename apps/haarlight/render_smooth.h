// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/haarlight/verb.h"

namespace haarlight::apps {

/// `haarlight render smooth IN.exr -o PICTURE`: less noise in a rendered picture, for a bias.
void add_render_smooth(Command root, Invocation& invocation);

}  // namespace haarlight::apps
