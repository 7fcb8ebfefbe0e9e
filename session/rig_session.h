// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/rig/rig.h"
#include "session/session.h"

/// @file
/// What a session takes from its rig. Functions of their own so that `verify` can hold
/// session.json to rig.toml.

namespace haarlight {

/// Of the frames that a rig's first camera delivers.
[[nodiscard]] FrameForm frame_form_of(const Rig& rig);

/// Fills form, lights, grid_rows and grid_cols as a capture with the rig's first camera has
/// them.
void describe_rig(const Rig& rig, SessionInfo& info);

}  // namespace haarlight
