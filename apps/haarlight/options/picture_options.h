// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "haarlight/core/picture/picture_rectangle.h"
#include "haarlight/session/import/picture_match.h"
#include "haarlight/session/light_file.h"

/// @file
/// What the verbs that take a folder of pictures and a list of lights share.

namespace haarlight::apps {

struct PictureListArguments {
  session::LightCoordinates coordinates = session::LightCoordinates::automatic;
  std::vector<std::string> exclude;
  std::string pictures_from;
  bool is_strict = false;
  std::string crop;
};

/// Adds --places, --exclude, --pictures-from, --strict and --crop.
void add_picture_list_options(Command verb, PictureListArguments& list);

[[nodiscard]] session::MatchOptions match_options(const PictureListArguments& list);

/// What --crop says. @throws Error(usage)  no rectangle
[[nodiscard]] std::optional<PixelRectangle> crop_requested(const PictureListArguments& list);

/// Notes unless --quiet, and warnings, to standard error.
void tell_match(const std::vector<std::string>& notes,
                const std::vector<std::string>& disagreements, const CommonOptions& common);

}  // namespace haarlight::apps
