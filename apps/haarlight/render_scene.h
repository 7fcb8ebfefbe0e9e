// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// What all verbs of `haarlight render` have in common: a scene with a camera, a picture to write.

namespace haarlight::apps {

[[nodiscard]] bool has_ending(const std::string& file, std::string_view ending);

/// The picture to look at beside one with linear values: out.png of out.exr; none of others.
[[nodiscard]] std::string preview_of(const std::string& output);

/// Refuses names that are taken, that are no picture's, or both of which are the same.
/// @param second  a further picture; empty: none @param option  that names it
void require_outputs(const std::string& output, const std::string& second, const char* option,
                     bool force);

/// --exposure
void add_exposure_option(Command& verb, std::optional<double>& exposure);

/// The same view in pixels of another size. @param size  empty: that of the scene's [film], if any
void set_picture_size(render::SceneFile& file, std::vector<int> size);

/// A lit scene and the camera that looks at it.
/// @param size  of the picture; empty: the scene's
[[nodiscard]] render::SceneFile read_lit_scene(const std::string& path, std::vector<int> size);

}  // namespace haarlight::apps
