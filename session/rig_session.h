#pragma once

#include "core/rig.h"
#include "session/session.h"

/// @file
/// What a session takes from its rig. Its own function so that `verify` can hold session.json
/// to rig.toml.

namespace haarlight {

/// Fills form, lights, grid_rows and grid_cols as a capture with the rig's first camera has
/// them.
void describe_rig(const Rig& rig, SessionInfo& info);

}  // namespace haarlight
