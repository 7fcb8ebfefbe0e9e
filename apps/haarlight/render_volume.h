// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/haarlight/verb.h"

namespace haarlight::apps {

void add_render_volume(Command root, Invocation& invocation);

}  // namespace haarlight::apps
