// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/session.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// How pipelines develop a session, and where its values end.

namespace haarlight::relight {

/// The settings' memory and progress, the session's own clean plate.
/// @param unknown_as  used for the unknown curve of a camera's YUYV or NV12; nothing: such a
///                    session is refused
[[nodiscard]] session::DevelopOptions develop_options(const session::Session& session,
                                                      const PipelineSettings& settings,
                                                      std::optional<Transfer> unknown_as);

/// The level at which each light's values clip, as in develop, (n_lights), or (channels,
/// n_lights) where channels have gains; empty if pictures are not integers, or the session is a
/// rig's.
[[nodiscard]] std::vector<float> clip_levels(const session::Session& session);

}  // namespace haarlight::relight
