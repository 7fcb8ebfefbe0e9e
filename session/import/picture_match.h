// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/picture/picture_facts.h"
#include "session/light_file.h"

/// @file
/// Which picture of a folder belongs to which light of a list. Every command that takes a
/// folder and a list goes through here, so that none of them takes a picture that another
/// refuses.

namespace haarlight {

struct MatchOptions {
  /// Pictures whose names contain one of these are no light's.
  std::vector<std::string> exclude = {};
  /// Neither are these: pictures with all lights off.
  std::vector<std::filesystem::path> dark = {};
  /// Where the list's names may lead to beside the folder itself; empty: nowhere.
  std::filesystem::path pictures_from = {};
  /// Whatever would be noted of a list and a folder that disagree is an error.
  bool is_strict = false;
};

struct LightPicture {
  std::string name;  ///< as the list writes it; where it names none, the file's own
  std::filesystem::path path;
};

/// The names of a folder's pictures, known by their endings, in natural order: a2 before a10.
/// @throws Error  a folder that cannot be listed
[[nodiscard]] std::vector<std::string> picture_names(const std::filesystem::path& folder);

/// The same without those that are no light's by `options`.
[[nodiscard]] std::vector<std::string> light_picture_names(const std::filesystem::path& folder,
                                                           const MatchOptions& options);

/// One picture for each light, in the list's order. A name is looked for in `folder` as written
/// (with / or \), then by its last part alone (lists carry another machine's folders), then
/// likewise whatever the case of its letters; last in `pictures_from`. Each step but the first
/// leaves a note in `list`, as do pictures of the folder that no light has, and lines that the
/// list's own count leaves out and that have no picture: they are taken off it. A list without
/// names takes the folder's pictures in natural order, which must be as many, and its lights
/// get their names.
/// @throws Error  naming the picture: missing, meant twice, two that differ only in case; a
///                wrong count; with is_strict whatever is noted
[[nodiscard]] std::vector<LightPicture> match_pictures(const std::filesystem::path& folder,
                                                       const std::filesystem::path& light_file,
                                                       LightList& list,
                                                       const MatchOptions& options = {});

/// @return  of each file's bytes (core/files.h, content_hash), in order
/// @throws Error  two of the first `n_lights` have the same bytes: one was saved twice
[[nodiscard]] std::vector<std::string> hashes_of_different(
    const std::vector<LightPicture>& pictures, std::size_t n_lights);

/// Tells what the pictures' cameras wrote: in `notes`, and in `disagreements` a rotation that
/// only some of them carry (it is not applied).
/// @return  what all of them tell alike
[[nodiscard]] PictureFacts tell_facts(const std::vector<PictureFacts>& pictures,
                                      std::vector<std::string>& notes,
                                      std::vector<std::string>& disagreements);

}  // namespace haarlight
