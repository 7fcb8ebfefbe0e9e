// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "haarlight/session/evidence.h"
#include "haarlight/session/session.h"

/// @file
/// A frame's evidence in plain words, for the page and for `haarlight shot`. Pure.

namespace haarlight::capture {

/// Why the operator should look at a committed frame; empty when there is no reason. Nothing
/// here refuses a frame: that is left to the clean rule and frame_checks.
/// @param kind  a dark frame may be black
[[nodiscard]] std::string doubt_of(const session::FrameEvidence& evidence,
                                   const session::FrameForm& form, session::ShotKind kind);

/// One sentence per fact: the light's proof, the times, the camera's number, exposure, pixels.
[[nodiscard]] std::vector<std::string> describe_evidence(const session::FrameEvidence& evidence,
                                                         const session::FrameForm& form);

}  // namespace haarlight::capture
