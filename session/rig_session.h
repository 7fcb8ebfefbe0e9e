// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/rig/rig.h"
#include "haarlight/session/session.h"

/// @file
/// What a session takes from its rig. Separate functions so that `verify` can check
/// session.json against rig.toml.

namespace haarlight::session {

/// For the frames that a rig's first camera delivers.
[[nodiscard]] FrameForm frame_form_of(const Rig& rig);

/// Fills in form, lights, grid_rows and grid_cols as for a capture with the rig's first camera.
void describe_rig(const Rig& rig, SessionInfo& info);

}  // namespace haarlight::session
