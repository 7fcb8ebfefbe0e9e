// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/haarlight/verb.h"

namespace haarlight::apps {

/// `haarlight render join FILM... -o PICTURE`: a picture of several computers' parts.
void add_render_join(Command root, Invocation& invocation);

}  // namespace haarlight::apps
