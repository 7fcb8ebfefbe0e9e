// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "apps/haarlight/verb.h"
#include "core/file_lock.h"
#include "render/film/film_file.h"
#include "render/loop/tile_renderer.h"

/// @file
/// What renders that can go on have in common: a film that is kept in a file, parts of a picture.

namespace haarlight::apps {

struct FilmArguments {
  std::string film;
  std::string part;
  std::optional<double> keep_seconds;
};

/// --film, --keep-every, --part.
/// @param kept  what the film holds, for its help: "the samples' sums"
void add_film_options(Command& verb, FilmArguments& arguments, const std::string& kept);

/// Refuses options that another one leaves without a meaning.
/// @param output       of -o @param is_enough  whether there is work without -o and --film
void require_film_words(const FilmArguments& arguments, const std::string& output,
                        bool is_enough);

/// "2/3": the second of three parts; all of it where none is named.
/// @param output  of -o: a part has none
[[nodiscard]] render::Part part_of(const FilmArguments& arguments, const std::string& output);

/// How many tiles of a film are of a part.
[[nodiscard]] std::size_t tiles_of(const render::Film& film, const render::Part& part);

/// Keeps a render's film in a file. A write that fails is told and tried again later: the picture
/// in memory is not lost for it.
class FilmKeeper {
 public:
  /// Goes on from the film's file where there is one, and writes it for the first time: a folder
  /// that cannot be written is known before the work is done.
  /// @param film  as it is at the beginning; replaced by what the file holds @param settings  outlive it
  /// @throws Error  another process is at that film (interrupted); it is of another render, or another
  ///                part; it takes more than most_bytes; it cannot be written (io)
  FilmKeeper(std::string path, const render::Part& part, const render::RenderSettings& settings,
             std::uint64_t most_bytes, std::unique_ptr<render::Film>& film);

  void keep() const;
  /// @throws Error(io)
  void keep_last() const;

 private:
  std::string path_;
  FileLock lock_;
  const render::RenderSettings& settings_;
  const render::Film* film_ = nullptr;
};

}  // namespace haarlight::apps
