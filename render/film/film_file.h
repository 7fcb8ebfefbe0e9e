// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "render/film/film.h"

/// @file
/// A film on disk: a render that goes on after an interruption, or one computer's part of it.
///
/// Little-endian: "HLFILM01"; the length of a JSON text (u32) and the text (size, layers,
/// settings); of each tile that has samples its number (u32), their number (u32) and its sums
/// (f64, as FilmTile::sums()); of a film with splats 2^32 - 1 and the number of pixels (u32), and of
/// each the words of its SplatPixel (i64); the content hash of all this, 32 hexadecimal digits.

namespace haarlight::render {

/// Name and value of all that a picture's samples depend on, in a fixed order.
using RenderSettings = std::vector<std::pair<std::string, std::string>>;

struct FilmFile {
  RenderSettings settings;
  std::unique_ptr<Film> film;
};

/// Whole or not at all. @throws Error(io)
void write_film(const std::filesystem::path& path, const Film& film,
                const RenderSettings& settings);

/// @param most_bytes  a film that takes more memory is refused
/// @throws Error  not a film, damaged, too large
[[nodiscard]] FilmFile read_film(const std::filesystem::path& path, std::uint64_t most_bytes);

/// @param path  of `found`, for the error
/// @throws Error  naming the first setting that is another one
void require_same_render(const FilmFile& found, const std::filesystem::path& path,
                         const RenderSettings& settings, const Film& film);

/// Adds the tiles of one part to those of others.
/// @throws Error  another render's, or both have a tile
void join_film(const FilmFile& part, const std::filesystem::path& path, FilmFile& whole);

}  // namespace haarlight::render
