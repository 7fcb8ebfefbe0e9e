// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/haarlight/file_kind.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// One input file of any room, read as the programs read it.

namespace haarlight::apps {

/// @param rig           the last good rig, to which a plan is held; set by a rig file
/// @param memory_bytes  for a scene's textures, a volume's mesh, which are read too
/// @return  what is in it, in words
/// @throws Error  every problem in it
[[nodiscard]] std::string check_file(const std::string& file, FileKind kind,
                                     std::optional<Rig>& rig, std::uint64_t memory_bytes);

}  // namespace haarlight::apps
