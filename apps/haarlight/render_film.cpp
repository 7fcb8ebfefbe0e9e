// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_film.h"

#include <charconv>
#include <filesystem>
#include <utility>

#include <fmt/format.h>

#include "core/log.h"
#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

/// Refuses a film with tiles of another part.
void require_part(const render::Film& film, const render::Part& part, const std::string& path) {
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    if (i % part.n_parts != part.index && film.samples_of(i) != 0) {
      throw Error(
          fmt::format("the film is that of part {}/{}", i % part.n_parts + 1, part.n_parts),
          path, "give each part a film of its own");
    }
  }
}

/// @throws Error(interrupted)  another process is at that film
FileLock lock_film(const std::string& path) {
  std::optional<FileLock> lock = FileLock::try_lock(path);
  if (!lock) {
    throw Error("another haarlight render is at work on this film", path,
                "wait for it or end it, or give --film another name", ExitCode::interrupted);
  }
  return std::move(*lock);
}

}  // namespace

void add_film_options(Command& verb, FilmArguments& arguments, const std::string& kept) {
  verb.option("--film", &arguments.film,
              "Keep " + kept +
                  " in this file, every minute, when interrupted, and at the end; where it "
                  "exists, go on from it",
              {.type = "FILE"});
  verb.option("--keep-every", &arguments.keep_seconds, "How often, in seconds (default: 60)",
              {.type = "T", .bounds = Bounds{0.01, 1e6}});
  verb.option(
      "--part", &arguments.part,
      "This computer's part of N: tiles I, I + N, ... into --film, for haarlight render "
      "join",
      {.type = "I/N"});
}

void require_film_words(const FilmArguments& arguments, const std::string& output,
                        bool is_enough) {
  if (output.empty() && arguments.film.empty() && !is_enough) {
    throw Error("no picture to write", "-o", "give -o PICTURE, or --film FILE",
                ExitCode::usage);
  }
  if (arguments.keep_seconds && arguments.film.empty()) {
    throw Error("no film to keep", "--keep-every", "give --film FILE too", ExitCode::usage);
  }
}

render::Part part_of(const FilmArguments& arguments, const std::string& output) {
  if (arguments.part.empty()) {
    return {};
  }
  const std::string& text = arguments.part;
  const std::size_t slash = text.find('/');
  std::size_t index = 0;
  std::size_t n = 0;
  const auto number = [&](std::size_t begin, std::size_t end, std::size_t& value) {
    const auto [last, problem] = std::from_chars(text.data() + begin, text.data() + end, value);
    return problem == std::errc() && last == text.data() + end;
  };
  constexpr std::size_t kMostParts = 100'000;
  if (slash == std::string::npos || !number(0, slash, index) ||
      !number(slash + 1, text.size(), n) || index < 1 || index > n || n > kMostParts) {
    throw Error(fmt::format("no part of a picture: {}", text), "--part",
                "give --part 1/3, 2/3 and 3/3 for three computers", ExitCode::usage);
  }
  if (arguments.film.empty() || !output.empty()) {
    throw Error("a part is no picture yet", "--part",
                "give --film FILE instead of -o, and join the films: haarlight render join",
                ExitCode::usage);
  }
  return {.index = index - 1, .n_parts = n};
}

std::size_t tiles_of(const render::Film& film, const render::Part& part) {
  return part.index < film.n_tiles() ? (film.n_tiles() - part.index - 1) / part.n_parts + 1 : 0;
}

FilmKeeper::FilmKeeper(std::string path, const render::Part& part,
                       const render::RenderSettings& settings, std::uint64_t most_bytes,
                       std::unique_ptr<render::Film>& film)
    : path_(std::move(path)), lock_(lock_film(path_)), settings_(settings) {
  if (std::filesystem::exists(path_)) {
    render::FilmFile found = render::read_film(path_, most_bytes);
    require_same_render(found, path_, settings, *film);
    require_part(*found.film, part, path_);
    film = std::move(found.film);
  }
  film_ = film.get();
  keep_last();
}

void FilmKeeper::keep() const {
  try {
    write_film(path_, *film_, settings_);
  } catch (const Error& error) {
    log_warning(fmt::format("the film is not kept yet: {}", error.what()));
  }
}

void FilmKeeper::keep_last() const { write_film(path_, *film_, settings_); }

}  // namespace haarlight::apps
