#pragma once

#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "session/picture_match.h"

/// @file
/// What the verbs that take a folder of pictures and a list of lights share.

namespace haarlight {

struct PictureListArguments {
  std::string places = "automatic";
  std::vector<std::string> exclude;
  std::string pictures_from;
  bool is_strict = false;
};

/// Adds --places, --exclude, --pictures-from and --strict.
void add_picture_list_options(Command verb, PictureListArguments& list);

[[nodiscard]] LightPlaces light_places(const PictureListArguments& list);
[[nodiscard]] MatchOptions match_options(const PictureListArguments& list);

/// Notes unless --quiet, and warnings, to standard error.
void tell_match(const std::vector<std::string>& notes,
                const std::vector<std::string>& disagreements, const CommonOptions& common);

}  // namespace haarlight
