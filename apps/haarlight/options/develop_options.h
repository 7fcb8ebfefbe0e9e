// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/develop/develop.h"

/// @file
/// What the verbs that develop a session share: the unknown curve's stand-in, and how large an
/// imported picture is.

namespace haarlight::apps {

/// The curves that a --transfer may name.
[[nodiscard]] std::vector<std::string> known_transfers();
/// The word of a --transfer for what the picture files say themselves.
inline constexpr const char* kAsFile = "file";

/// Adds --transfer; nothing where it is not given.
void add_transfer_option(Command verb, std::optional<Transfer>& transfer);

/// The common options' memory and progress, the session's own clean plate.
[[nodiscard]] session::DevelopOptions develop_options(const session::Session& session,
                                                      const CommonOptions& common);

/// Where the picture's reference plane is.
struct PlaneArguments {
  double width_mm = 0.0;              ///< 0: not given
  std::optional<double> height_mm{};  ///< above the rig's plane
};

/// Adds --width-mm and --height-mm.
void add_plane_options(Command verb, PlaneArguments& plane);

}  // namespace haarlight::apps
