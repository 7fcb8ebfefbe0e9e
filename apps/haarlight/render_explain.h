// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/report.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/surface/path_integrator.h"

namespace haarlight::apps {

/// Prints which terms of path tracing the scene requires, and what each of the others would have
/// cost: some tiles are rendered in turns with and without it, on one thread.
/// @param width, height  of the picture, a crop from options.first_x, first_y on
void explain_terms(const render::SceneFile& file, int width, int height,
                   const render::RayCaster& caster, const render::Environment* environment,
                   const render::PathOptions& options, Report& report);

}  // namespace haarlight::apps
