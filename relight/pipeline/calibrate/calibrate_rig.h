// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/calibrate_pipeline.h"

/// @file
/// Lights of a rig from its own capture of a sheet, as a list.

namespace haarlight::relight {

/// Each face as a rigid array (rig_lights_pipeline.h). With options.rig its measured values and
/// its page are written too.
/// @param session  with a rig
/// @param summary  of the faces: filled in
/// @throws Error  as calibrate_rig_lights
[[nodiscard]] FoundLights find_by_rig(const CalibratePipelineOptions& options,
                                      const session::Session& session,
                                      RigLightsSummary& summary, PipelineNotes& notes);

}  // namespace haarlight::relight
