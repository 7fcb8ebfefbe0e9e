// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/picture_options.h"

#include <fmt/format.h>

#include "core/log.h"

namespace haarlight::apps {

void add_picture_list_options(Command verb, PictureListArguments& list) {
  verb.option("--places", &list.coordinates,
              "What the numbers of a .lp are: unit directions, or positions in mm",
              {.shows_default = true});
  verb.option("--exclude", &list.exclude,
              "Leave out pictures whose names contain this; may be repeated", {.type = "TEXT"});
  verb.option(
      "--pictures-from", &list.pictures_from,
      "Where pictures that the list names and the folder lacks are looked for (default: "
      "nowhere)",
      {.type = "FOLDER"});
  verb.flag("--strict", &list.is_strict,
            "Refuse a list and a folder that disagree instead of warning");
  verb.option("--crop", &list.crop,
              "Only these pixels of each picture, from the upper left corner as it is seen "
              "upright",
              {.type = "X,Y,W,H"});
}

session::MatchOptions match_options(const PictureListArguments& list) {
  session::MatchOptions options;
  options.exclude = list.exclude;
  options.pictures_from = list.pictures_from;
  options.is_strict = list.is_strict;
  return options;
}

std::optional<PixelRectangle> crop_requested(const PictureListArguments& list) {
  if (list.crop.empty()) {
    return {};
  }
  return parse_rectangle(list.crop, "--crop");
}

void tell_match(const std::vector<std::string>& notes,
                const std::vector<std::string>& disagreements, const CommonOptions& common) {
  for (const std::string& warning : disagreements) {
    log_warning(warning);
  }
  for (const std::string& note : notes) {
    if (!common.quiet) {
      fmt::print(stderr, "note: {}\n", note);
    }
  }
}

}  // namespace haarlight::apps
