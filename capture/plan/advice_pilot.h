// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "capture/plan/advice.h"
#include "haarlight/core/stack/light_stack.h"
#include "haarlight/session/develop/develop_options.h"
#include "haarlight/session/session.h"

/// @file
/// A capture of the object, or of a similar one, as the basis of advice: the signal of every
/// light, what blocks of lights hide, and how much of that is the pilot's own noise.

namespace haarlight::capture {

/// At most `max_pixels` pixels of a developed pilot, spread evenly over the picture. From a
/// pilot that lit several lights at once without resolving them all (bins, target, some
/// wavelets) the signal is used, but no bias predicted.
/// @param stack   of develop(session), preferably without demosaicing, whose averaging hides
/// noise
/// @param camera  whose noise to use: the pilot's own and the advised capture's
/// @param plate   clean plate by which develop distributes light, may be empty
/// @throws Error  a pilot without exposures
[[nodiscard]] AdviceScene pilot_scene(const session::Session& session, const LightStack& stack,
                                      const CameraSpec& camera,
                                      const session::PlatePixels& plate, int max_pixels = 4096);

}  // namespace haarlight::capture
