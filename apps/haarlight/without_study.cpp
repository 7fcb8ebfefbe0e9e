// SPDX-License-Identifier: Apache-2.0
/// @file
/// A build without the study of bases (HAARLIGHT_STUDY off): what its verb says when it is named.

#include "apps/haarlight/verb.h"

namespace haarlight::apps {

void add_bases(Command root, Invocation& /*invocation*/) {
  root.leave_out("bases", "HAARLIGHT_STUDY");
}

}  // namespace haarlight::apps
