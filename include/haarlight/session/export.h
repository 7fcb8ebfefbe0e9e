// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "haarlight/session/light_file.h"
#include "haarlight/session/session.h"

/// @file
/// A session in formats that other programs read: `.lp`, Relight's `.dome`, transforms.json.
/// Pure.

namespace haarlight::session {

/// The session's lights as seen from the object: positions relative to the rig's object_centre
/// (the world origin without a rig), directions unchanged.
[[nodiscard]] std::vector<SessionLight> lights_from_object(const Session& session);

/// The raw picture of each light: its frame's file, relative to `folder`.
/// @throws Error  a light without a shot of its own (a multiplexed plan), or with several
///                (exposures, repeats): pictures must be developed first (`haarlight export
///                --exr`)
[[nodiscard]] std::vector<std::string> picture_of_each_light(
    const Session& session, const std::filesystem::path& folder);

/// @param pictures  one name per light
[[nodiscard]] std::string export_lp(const Session& session,
                                    const std::vector<std::string>& pictures);
/// Which pictures accompany a list of lights.
enum class ExportedPictures {
  raw,        ///< the frames: they contain each LED's own brightness
  developed,  ///< the LEDs' powers are divided out: ledAdjust is 1
};
[[nodiscard]] std::string export_dome(const Session& session, ExportedPictures pictures);

/// Pictures must be developed: no light's power is written.
/// @throws Error  lights without positions, or no camera of the pictures' size: an import
[[nodiscard]] std::string export_transforms(const Session& session,
                                            const std::vector<std::string>& pictures);

/// What other readers of such a list will not accept, in words; empty: nothing known. Relight's
/// reader of .lp stops at 1000 lights, and every reader splits lines at blanks.
[[nodiscard]] std::string find_lp_problem(const std::vector<std::string>& pictures);

}  // namespace haarlight::session
