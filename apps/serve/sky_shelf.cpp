// SPDX-License-Identifier: Apache-2.0
#include "apps/serve/sky_shelf.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "relight/pipeline/light_choice.h"

namespace haarlight::apps {

namespace {

std::uint64_t bytes_of(const render::Environment& environment) {
  return std::uint64_t{sizeof(float)} * static_cast<std::uint64_t>(environment.n_rows()) *
         static_cast<std::uint64_t>(environment.row_texels()) *
         (environment.is_colour() ? 3U : 1U);
}

}  // namespace

SkyShelf::SkyShelf(const std::filesystem::path& folder, std::uint64_t memory_bytes)
    : memory_bytes_(memory_bytes) {
  if (folder.empty()) {
    return;
  }
  if (!std::filesystem::is_directory(folder)) {
    throw Error("the folder of skies is missing", folder.string(),
                "name a folder of environment pictures with --skies");
  }
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (std::string name = entry.path().filename().string(); name.front() != '.') {
      paths_.emplace(std::move(name), entry.path());
    }
  }
}

std::vector<std::string> SkyShelf::names() const {
  std::vector<std::string> names;
  names.reserve(paths_.size());
  for (const auto& [name, path] : paths_) {
    names.push_back(name);
  }
  return names;
}

SkyShelf::Sky SkyShelf::keep(std::string id, render::Environment environment) {
  const std::uint64_t bytes = bytes_of(environment);
  if (bytes > memory_bytes_) {
    throw Error(fmt::format("the sky takes {} MB of memory, {} MB are there for skies",
                            bytes >> 20U, memory_bytes_ >> 20U),
                id, "send a smaller picture, or start haarlight serve with more --memory");
  }
  Kept fresh{.sky = {std::move(id),
                     std::make_shared<const render::Environment>(std::move(environment))},
             .bytes = bytes};
  const std::lock_guard lock(mutex_);
  const auto same = std::find_if(kept_.begin(), kept_.end(),
                                 [&](const Kept& kept) { return kept.sky.id == fresh.sky.id; });
  if (same != kept_.end()) {  // another thread was faster
    kept_.splice(kept_.begin(), kept_, same);
    return kept_.front().sky;
  }
  while (n_bytes_ + bytes > memory_bytes_) {
    n_bytes_ -= kept_.back().bytes;
    kept_.pop_back();
  }
  n_bytes_ += bytes;
  kept_.push_front(std::move(fresh));
  return kept_.front().sky;
}

SkyShelf::Sky SkyShelf::add(std::string_view picture) {
  return keep(content_hash(picture),
              relight::environment_from_bytes(picture, "the picture that was sent"));
}

std::optional<SkyShelf::Sky> SkyShelf::find(const std::string& id) {
  {
    const std::lock_guard lock(mutex_);
    const auto found = std::find_if(kept_.begin(), kept_.end(),
                                    [&](const Kept& kept) { return kept.sky.id == id; });
    if (found != kept_.end()) {
      kept_.splice(kept_.begin(), kept_, found);
      return kept_.front().sky;
    }
  }
  const auto file = paths_.find(id);
  if (file == paths_.end()) {
    return std::nullopt;
  }
  if (std::filesystem::is_directory(file->second)) {
    return keep(id, render::Environment::read(file->second));
  }
  // Not mapped: another program may cut the file short meanwhile.
  return keep(id,
              relight::environment_from_bytes(read_file(file->second), file->second.string()));
}

}  // namespace haarlight::apps
