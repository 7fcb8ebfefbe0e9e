// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "apps/haarlight/verb.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/develop/develop.h"

/// @file
/// What the verbs that develop a session share: the unknown curve's stand-in, and how large an
/// imported picture is.

namespace haarlight::apps {

/// Adds --transfer.
void add_transfer_option(Command verb, std::string& transfer);

/// What --transfer says; nothing where it was not given.
[[nodiscard]] std::optional<Transfer> transfer_requested(const std::string& transfer);

/// The common options' memory and progress, the session's own clean plate, --transfer.
[[nodiscard]] session::DevelopOptions develop_options(const session::Session& session,
                                                      const CommonOptions& common,
                                                      const std::string& transfer = {});

/// Where the picture's reference plane is.
struct PlaneArguments {
  double width_mm = 0.0;              ///< 0: not given
  std::optional<double> height_mm{};  ///< above the rig's plane
};

/// Adds --width-mm and --height-mm.
void add_plane_options(Command verb, PlaneArguments& plane);

}  // namespace haarlight::apps
