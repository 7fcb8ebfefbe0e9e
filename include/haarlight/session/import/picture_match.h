// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "haarlight/core/picture/picture_facts.h"
#include "haarlight/session/light_file.h"

/// @file
/// Which picture of a folder belongs to which light of a list. Every command that takes a
/// folder and a list uses this, so that none accepts a picture that another refuses.

namespace haarlight::session {

struct MatchOptions {
  /// Pictures whose names contain one of these belong to no light.
  std::vector<std::string> exclude = {};
  /// Nor do these: pictures with all lights off.
  std::vector<std::filesystem::path> dark = {};
  /// Where the list's names may lead besides the folder itself; empty: nowhere.
  std::filesystem::path pictures_from = {};
  /// Treats every disagreement between list and folder that would be noted as an error.
  bool is_strict = false;
};

struct LightPicture {
  std::string name;  ///< as written in the list; where that names none, the file's own
  std::filesystem::path path;
};

/// The names of a folder's pictures, recognised by extension, in natural order: a2 before a10.
/// @throws Error  a folder that cannot be listed
[[nodiscard]] std::vector<std::string> picture_names(const std::filesystem::path& folder);

/// The same without those that `options` exclude.
[[nodiscard]] std::vector<std::string> light_picture_names(const std::filesystem::path& folder,
                                                           const MatchOptions& options);

/// One picture per light, in the list's order. A name is searched for in `folder` as written
/// (with / or \), then by its last part alone (lists carry another machine's folders), then
/// likewise ignoring case; finally in `pictures_from`. Each step but the first leaves a note in
/// `list`, as do pictures of the folder that belong to no light, and lines that the list's own
/// count excludes and that have no picture: these are dropped. A list without names takes the
/// folder's pictures in natural order, which must be as many, and its lights get their names.
/// @throws Error  naming the picture: missing, matched twice, two that differ only in case; a
///                wrong count; with is_strict anything that would be noted
[[nodiscard]] std::vector<LightPicture> match_pictures(const std::filesystem::path& folder,
                                                       const std::filesystem::path& light_file,
                                                       LightList& list,
                                                       const MatchOptions& options = {});

/// @return  of each file's bytes (haarlight/core/files.h, content_hash), in order
/// @throws Error  two of the first `n_lights` have the same bytes: one was saved twice
[[nodiscard]] std::vector<std::string> hashes_of_different(
    const std::vector<LightPicture>& pictures, std::size_t n_lights);

/// Reports what the pictures' cameras recorded: in `notes`, and in `disagreements` a rotation
/// that only some of them carry (it is not applied).
/// @return  the facts on which all of them agree
[[nodiscard]] PictureFacts tell_facts(const std::vector<PictureFacts>& pictures,
                                      std::vector<std::string>& notes,
                                      std::vector<std::string>& disagreements);

}  // namespace haarlight::session
