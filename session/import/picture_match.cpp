// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/picture_match.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "core/config_table.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

/// The end of the run of digits at `at`.
std::size_t end_of_digits(const std::string& text, std::size_t at) {
  while (at < text.size() && is_digit(text[at])) {
    ++at;
  }
  return at;
}

/// "a2" before "a10": runs of digits compare as numbers.
bool is_before_naturally(const std::string& a, const std::string& b) {
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      const std::size_t i_end = end_of_digits(a, i);
      const std::size_t j_end = end_of_digits(b, j);
      while (i + 1 < i_end && a[i] == '0') {
        ++i;
      }
      while (j + 1 < j_end && b[j] == '0') {
        ++j;
      }
      if (i_end - i != j_end - j) {
        return i_end - i < j_end - j;
      }
      const int order = a.compare(i, i_end - i, b, j, j_end - j);
      if (order != 0) {
        return order < 0;
      }
      i = i_end;
      j = j_end;
    } else if (a[i] != b[j]) {
      return a[i] < b[j];
    } else {
      ++i;
      ++j;
    }
  }
  return a.size() - i < b.size() - j;
}

/// ASCII letters only: the case of other letters depends on the language.
std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) {
    return c < 128 ? static_cast<char>(std::tolower(c)) : static_cast<char>(c);
  });
  return text;
}

bool has_picture_ending(const fs::path& path) {
  static const std::set<std::string> kEndings = {".jpg",  ".jpeg", ".png", ".tif",
                                                 ".tiff", ".exr",  ".tga", ".hdr"};
  return kEndings.count(lower(path.extension().string())) > 0;
}

bool is_file(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

/// A list's name as a path below some folder; nothing: absolute, or it leads outside.
std::optional<fs::path> path_within(std::string name) {
  std::replace(name.begin(), name.end(), '\\', '/');
  const fs::path path = fs::path(name).lexically_normal();
  const bool has_drive = name.size() > 1 && name[1] == ':';
  if (path.empty() || path.is_absolute() || has_drive || *path.begin() == "..") {
    return std::nullopt;
  }
  return path;
}

std::string last_part(const std::string& name) {
  const std::size_t slash = name.find_last_of("/\\");
  return slash == std::string::npos ? name : name.substr(slash + 1);
}

bool is_same_file(const fs::path& a, const fs::path& b) {
  std::error_code ignored;
  return fs::equivalent(a, b, ignored);
}

/// What the notes of a match collect: one line each, however many pictures it concerns.
struct MatchNotes {
  std::vector<std::string> bare;   ///< found by their last part
  std::vector<std::string> cased;  ///< found with different case
  std::vector<std::string> away;   ///< found in pictures_from
};

std::string names_of(const std::vector<std::string>& names) {
  constexpr std::size_t kShown = 3;
  std::string out;
  for (std::size_t i = 0; i < std::min(names.size(), kShown); ++i) {
    out += (i > 0 ? ", " : "") + names[i];
  }
  return names.size() > kShown ? fmt::format("{} and {} more", out, names.size() - kShown)
                               : out;
}

class PictureFinder {
 public:
  PictureFinder(fs::path folder, const fs::path& light_file, const MatchOptions& options)
      : folder_(std::move(folder)),
        list_folder_(light_file.parent_path()),
        options_(options),
        present_(picture_names(folder_)) {
    for (const std::string& name : present_) {
      by_lower_[lower(name)].push_back(name);
    }
  }

  [[nodiscard]] const std::vector<std::string>& present() const { return present_; }

  /// Nothing: no such picture.
  [[nodiscard]] std::optional<fs::path> seek(const std::string& name, MatchNotes& notes) const {
    const std::optional<fs::path> within = path_within(name);
    if (within && is_file(folder_ / *within)) {
      return folder_ / *within;
    }
    const std::string bare = last_part(name);
    if (!bare.empty() && bare != ".." && is_file(folder_ / bare)) {
      // A name relative to the list's own folder is not from another machine.
      if (!within || !is_same_file(list_folder_ / *within, folder_ / bare)) {
        notes.bare.push_back(name);
      }
      return folder_ / bare;
    }
    const auto cased = by_lower_.find(lower(bare));
    if (cased != by_lower_.end()) {
      if (cased->second.size() > 1) {
        throw Error(
            fmt::format("\"{}\" may be {} or {}", name, cased->second[0], cased->second[1]),
            folder_.string(), "write one of them into the list of lights");
      }
      notes.cased.push_back(name);
      return folder_ / cased->second[0];
    }
    if (!options_.pictures_from.empty()) {
      for (const fs::path& path : {within.value_or(bare), fs::path(bare)}) {
        if (is_file(options_.pictures_from / path)) {
          notes.away.push_back(name);
          return options_.pictures_from / path;
        }
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] fs::path find(const std::string& name, MatchNotes& notes) const {
    if (const std::optional<fs::path> found = seek(name, notes)) {
      return *found;
    }
    const std::string nearest = nearest_word(last_part(name), present_);
    throw Error(fmt::format("the picture \"{}\" is missing", name), folder_.string(),
                nearest.empty()
                    ? "put it there, take its line out of the list of lights, or say where it "
                      "lies: --pictures-from; where the pictures have other names but the "
                      "list's order, take all names out of the list"
                    : fmt::format("is it \"{}\"? correct the name in the list; or say where it "
                                  "lies: --pictures-from",
                                  nearest));
  }

 private:
  fs::path folder_;
  fs::path list_folder_;
  const MatchOptions& options_;
  std::vector<std::string> present_;
  std::map<std::string, std::vector<std::string>> by_lower_;
};

void require_once(const std::vector<LightPicture>& pictures, const fs::path& light_file) {
  std::map<fs::path, std::string> seen;
  for (const LightPicture& picture : pictures) {
    const auto [at, is_new] = seen.emplace(fs::weakly_canonical(picture.path), picture.name);
    if (!is_new) {
      throw Error(fmt::format("\"{}\" and \"{}\" are one picture, {}", at->second, picture.name,
                              picture.path.string()),
                  light_file.string(), "each light has a picture of its own: correct the list");
    }
  }
}

/// Pictures of the folder that belong to no light.
std::vector<std::string> unnamed_pictures(const fs::path& folder,
                                          const std::vector<std::string>& present,
                                          const std::vector<LightPicture>& pictures) {
  std::set<fs::path> taken;
  for (const LightPicture& picture : pictures) {
    taken.insert(fs::weakly_canonical(picture.path));
  }
  std::vector<std::string> out;
  std::copy_if(present.begin(), present.end(), std::back_inserter(out),
               [&](const std::string& name) {
                 return taken.count(fs::weakly_canonical(folder / name)) == 0;
               });
  return out;
}

std::vector<std::string> lights_pictures(const std::vector<std::string>& present,
                                         const MatchOptions& options) {
  std::vector<std::string> out;
  std::copy_if(
      present.begin(), present.end(), std::back_inserter(out), [&](const std::string& name) {
        const bool is_excluded = std::any_of(
            options.exclude.begin(), options.exclude.end(),
            [&](const std::string& part) { return name.find(part) != std::string::npos; });
        return !is_excluded &&
               std::none_of(options.dark.begin(), options.dark.end(),
                            [&](const fs::path& dark) { return dark.filename() == name; });
      });
  return out;
}

std::vector<LightPicture> match_in_order(const fs::path& folder, const fs::path& light_file,
                                         const std::vector<std::string>& present,
                                         LightList& list) {
  if (present.size() != list.lights.size()) {
    throw Error(
        fmt::format("{} pictures for {} lights", present.size(), list.lights.size()),
        folder.string(),
        fmt::format("{} names no pictures, so there must be one per light: leave others "
                    "out with --exclude",
                    light_file.string()));
  }
  std::vector<LightPicture> pictures;
  for (std::size_t k = 0; k < present.size(); ++k) {
    pictures.push_back({present[k], folder / present[k]});
    list.lights[k].name = present[k];
  }
  list.notes.push_back(fmt::format("{} names no pictures: lights follow {} .. {}",
                                   light_file.filename().string(), present.front(),
                                   present.back()));
  return pictures;
}

/// Drops lines at the list's end that its own count excludes and whose pictures are absent.
void drop_uncounted(const PictureFinder& finder, LightList& list) {
  std::vector<std::string> dropped;
  while (list.announced > 0 && list.lights.size() > list.announced) {
    MatchNotes ignored;
    const std::string& name = list.lights.back().name;
    if (finder.seek(name, ignored)) {
      break;
    }
    dropped.push_back(name);
    list.lights.pop_back();
  }
  if (!dropped.empty()) {
    list.disagreements.push_back(
        fmt::format("{}: left out, being behind the number of lights announced and without a "
                    "picture",
                    names_of(dropped)));
  }
}

void add_notes(const MatchNotes& found, const fs::path& folder, const MatchOptions& options,
               LightList& list) {
  if (!found.bare.empty()) {
    list.disagreements.push_back(fmt::format("{}: taken from {} by the last part of the name",
                                             names_of(found.bare), folder.string()));
  }
  if (!found.cased.empty()) {
    list.disagreements.push_back(fmt::format("{}: in {} in letters of another case",
                                             names_of(found.cased), folder.string()));
  }
  if (!found.away.empty()) {
    list.notes.push_back(
        fmt::format("{}: taken from {}", names_of(found.away), options.pictures_from.string()));
  }
}

}  // namespace

std::vector<std::string> picture_names(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->is_regular_file(error) && has_picture_ending(it->path())) {
      names.push_back(it->path().filename().string());
    }
  }
  if (error) {
    throw Error("cannot be listed: " + error.message(), folder.string(),
                "name the folder with the pictures");
  }
  std::sort(names.begin(), names.end(), is_before_naturally);
  return names;
}

std::vector<std::string> light_picture_names(const fs::path& folder,
                                             const MatchOptions& options) {
  return lights_pictures(picture_names(folder), options);
}

std::vector<LightPicture> match_pictures(const fs::path& folder, const fs::path& light_file,
                                         LightList& list, const MatchOptions& options) {
  const PictureFinder finder(folder, light_file, options);
  const std::vector<std::string> present = lights_pictures(finder.present(), options);
  std::vector<LightPicture> pictures;
  if (list.lights[0].name.empty()) {
    pictures = match_in_order(folder, light_file, present, list);
  } else {
    drop_uncounted(finder, list);
    MatchNotes notes;
    for (const SessionLight& light : list.lights) {
      pictures.push_back({light.name, finder.find(light.name, notes)});
    }
    require_once(pictures, light_file);
    add_notes(notes, folder, options, list);
    const std::vector<std::string> others = unnamed_pictures(folder, present, pictures);
    if (!others.empty()) {
      const bool is_one = others.size() == 1;
      list.disagreements.push_back(
          fmt::format("{} of {} {} not in the list: {} (--exclude: no light's)",
                      is_one ? "a picture" : fmt::format("{} pictures", others.size()),
                      folder.string(), is_one ? "is" : "are", names_of(others)));
    }
  }
  if (options.is_strict && !list.disagreements.empty()) {
    throw Error(list.disagreements.front(), light_file.string(),
                "correct the list or the folder, or leave --strict out");
  }
  return pictures;
}

std::vector<std::string> hashes_of_different(const std::vector<LightPicture>& pictures,
                                             std::size_t n_lights) {
  std::vector<std::string> hashes(pictures.size());
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      hashes[i] = content_hash(MappedFile(pictures[i].path).bytes());
    }
  });
  std::map<std::string, std::size_t> seen;
  for (std::size_t i = 0; i < n_lights; ++i) {
    const auto [at, is_new] = seen.emplace(hashes[i], i);
    if (!is_new) {
      throw Error(
          fmt::format("the same bytes as {}", pictures[at->second].path.filename().string()),
          pictures[i].path.string(),
          "two lights cannot give the same picture: one was saved twice, or leave it out "
          "with --exclude");
    }
  }
  return hashes;
}

PictureFacts tell_facts(const std::vector<PictureFacts>& pictures,
                        std::vector<std::string>& notes,
                        std::vector<std::string>& disagreements) {
  const auto n_turned =
      std::count_if(pictures.begin(), pictures.end(),
                    [](const PictureFacts& one) { return one.orientation != 1; });
  if (n_turned > 0) {  // of all: the camera was rotated; of some: the pictures differ
    const bool are_all = static_cast<std::size_t>(n_turned) == pictures.size();
    (are_all ? notes : disagreements)
        .push_back(fmt::format("{} of {} pictures carry an EXIF rotation: ignored, pixels are "
                               "taken as stored",
                               n_turned, pictures.size()));
  }
  PictureFacts common = common_facts(pictures);
  if (has_facts(common)) {
    notes.push_back("photographed: " + words_of(common));
  }
  return common;
}

}  // namespace haarlight::session
