// SPDX-License-Identifier: Apache-2.0
#include "render/film/film_file.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/film/film_settings_file.h"

namespace haarlight::render {

namespace {

constexpr std::string_view kMagic = "HLFILM01";
constexpr std::uint32_t kSplats = 0xffffffffU;  // for a tile's number
static_assert(std::is_trivially_copyable_v<SplatPixel> &&
              sizeof(SplatPixel) == 20 * sizeof(std::int64_t));
constexpr std::size_t kHashDigits = 32;
constexpr std::size_t kMostHeader = std::size_t{1} << 20U;
constexpr int kMostSide = 1 << 16;
constexpr int kMostChannels = 1 << 16;
constexpr const char* kRemake = "delete it, and render again";

std::string header_of(const Film& film, const RenderSettings& settings) {
  nlohmann::ordered_json header = {{"width", film.width()}, {"height", film.height()}};
  header["layers"] = nlohmann::ordered_json::array();
  for (const FilmLayer& layer : film.layers()) {
    header["layers"].push_back(
        {{"name", layer.name}, {"channels", layer.channels}, {"has_error", layer.has_error}});
    if (layer.has_splats) {
      header["layers"].back()["has_splats"] = true;
    }
  }
  header["settings"] = nlohmann::ordered_json::array();
  for (const auto& [name, value] : settings) {
    header["settings"].push_back({{"name", name}, {"value", value}});
  }
  return header.dump();
}

/// Bytes of the file from where it has been read to.
class Reader {
 public:
  Reader(std::span<const std::byte> bytes, const std::filesystem::path& path)
      : bytes_(bytes), path_(path) {}

  [[nodiscard]] bool is_at_end() const { return bytes_.empty(); }
  std::span<const std::byte> take(std::size_t n) {
    if (n > bytes_.size()) {
      throw Error("the film ends too early", path_.string(), kRemake);
    }
    const auto taken = bytes_.first(n);
    bytes_ = bytes_.subspan(n);
    return taken;
  }
  std::uint32_t number() {
    std::uint32_t value = 0;
    std::memcpy(&value, take(sizeof value).data(), sizeof value);
    return value;
  }
  std::string_view text(std::size_t n) {
    const auto taken = take(n);
    return {reinterpret_cast<const char*>(taken.data()), taken.size()};
  }

 private:
  std::span<const std::byte> bytes_;
  const std::filesystem::path& path_;
};

RenderSettings settings_of(const JsonValue& header) {
  RenderSettings settings;
  for (const JsonValue& setting : header["settings"].elements()) {
    settings.emplace_back(setting["name"].text(), setting["value"].text());
  }
  return settings;
}

void require_film(std::span<const std::byte> bytes, const std::filesystem::path& path) {
  if (bytes.size() < kMagic.size() + sizeof(std::uint32_t) + kHashDigits ||
      std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) != 0) {
    throw Error("not a film", path.string(),
                "name a file that haarlight render --film has written");
  }
}

/// Its text, which comes first.
std::string_view header_of(Reader& reader, const std::filesystem::path& path) {
  const std::uint32_t header_bytes = reader.number();
  if (header_bytes > kMostHeader) {
    throw Error("the film's header is too long", path.string(), kRemake);
  }
  return reader.text(header_bytes);
}

FilmFile film_of(std::string_view text, const std::filesystem::path& path,
                 std::uint64_t most_bytes) {
  const JsonValue header = JsonValue::parse(text, path.string());
  const auto width = static_cast<int>(header["width"].integer(1, kMostSide));
  const auto height = static_cast<int>(header["height"].integer(1, kMostSide));
  std::vector<FilmLayer> layers;
  for (const JsonValue& layer : header["layers"].elements()) {
    layers.push_back({.name = layer["name"].text(),
                      .channels = static_cast<int>(layer["channels"].integer(1, kMostChannels)),
                      .has_error = layer["has_error"].truth(),
                      .has_splats = layer.has("has_splats") && layer["has_splats"].truth()});
    const FilmLayer& read = layers.back();
    if (read.has_splats && (layers.size() > 1 || read.channels != 3 || !read.has_error)) {
      layer.refuse("splats are of the first layer, RGB with an error", kRemake);
    }
  }
  if (layers.empty()) {
    header["layers"].refuse("a film without layers", kRemake);
  }
  FilmFile file;
  file.settings = settings_of(header);
  const std::uint64_t needed = Film::bytes_needed(width, height, layers);
  if (needed > most_bytes) {
    throw Error(fmt::format("the film's sums take {} MB, more than --memory allows",
                            needed / 1'000'000),
                path.string(), "give more --memory", ExitCode::usage);
  }
  file.film = std::make_unique<Film>(width, height, std::move(layers));
  return file;
}

/// What follows the tiles, to the end.
void read_splats(Reader& reader, std::uint32_t n, const std::filesystem::path& path,
                 Film& film) {
  const auto n_pixels =
      static_cast<std::size_t>(film.width()) * static_cast<std::size_t>(film.height());
  if (n != n_pixels) {
    throw Error("the film's splats are of another size", path.string(), kRemake);
  }
  std::vector<SplatPixel> splats(n_pixels);
  const std::span<SplatPixel> all(splats);
  std::memcpy(all.data(), reader.take(all.size_bytes()).data(), all.size_bytes());
  if (!std::ranges::all_of(splats, [](const SplatPixel& pixel) {
        return pixel.light.is_possible() && pixel.squares.is_possible();
      })) {
    throw Error("a splat of the film is no number", path.string(), kRemake);
  }
  film.add_splats(splats);
}

}  // namespace

void write_film(const std::filesystem::path& path, const Film& film,
                const RenderSettings& settings) {
  PendingFile file(path);
  ContentHash hash;
  const auto put = [&](std::span<const std::byte> bytes) {
    file.append(bytes);
    hash.add(bytes);
  };
  const auto put_number = [&](std::uint32_t number) {
    put(std::as_bytes(std::span<const std::uint32_t, 1>(&number, 1)));
  };
  const std::string header = header_of(film, settings);
  put(std::as_bytes(std::span(kMagic)));
  put_number(static_cast<std::uint32_t>(header.size()));
  put(std::as_bytes(std::span(header)));
  const auto [tiles, splats] = film.state();
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    if (tiles[i] != nullptr) {
      put_number(static_cast<std::uint32_t>(i));
      put_number(tiles[i]->samples());
      put(std::as_bytes(tiles[i]->sums()));
    }
  }
  if (!splats.empty()) {
    put_number(kSplats);
    put_number(static_cast<std::uint32_t>(splats.size()));
    put(std::as_bytes(std::span(splats)));
  }
  const std::string digits = hash.text();
  file.append(std::as_bytes(std::span(digits)));
  file.commit();
}

FilmFile read_film(const std::filesystem::path& path, std::uint64_t most_bytes) {
  const MappedFile mapped(path);
  const std::span<const std::byte> bytes = mapped.bytes();
  require_film(bytes, path);
  const auto content = bytes.first(bytes.size() - kHashDigits);
  Reader digits(bytes.last(kHashDigits), path);
  if (content_hash(content) != digits.text(kHashDigits)) {
    throw Error("the film is damaged: its hash is not that of its bytes", path.string(),
                kRemake);
  }
  Reader reader(content.subspan(kMagic.size()), path);
  FilmFile file = film_of(header_of(reader, path), path, most_bytes);
  Film& film = *file.film;
  while (!reader.is_at_end()) {
    const std::size_t i = reader.number();
    const std::uint32_t samples = reader.number();
    if (i == kSplats && film.layers().front().has_splats) {
      read_splats(reader, samples, path, film);
      break;
    }
    if (i >= film.n_tiles() || samples == 0 || film.samples_of(i) != 0) {
      throw Error(fmt::format("the film has no room for tile {}", i), path.string(), kRemake);
    }
    FilmTile tile = film.take(i);
    const std::span<double> sums = tile.sums();
    std::memcpy(sums.data(), reader.take(sums.size_bytes()).data(), sums.size_bytes());
    if (!std::all_of(sums.begin(), sums.end(), [](double sum) { return std::isfinite(sum); })) {
      throw Error(fmt::format("a sum of tile {} is not finite", i), path.string(), kRemake);
    }
    tile.set_samples(samples);
    film.put(i, std::move(tile));
  }
  if (!reader.is_at_end()) {
    throw Error("the film goes on after its splats", path.string(), kRemake);
  }
  return file;
}

RenderSettings read_film_settings(const std::filesystem::path& path) {
  const MappedFile mapped(path);
  require_film(mapped.bytes(), path);
  Reader reader(mapped.bytes().subspan(kMagic.size()), path);
  return settings_of(JsonValue::parse(header_of(reader, path), path.string()));
}

void require_same_render(const FilmFile& found, const std::filesystem::path& path,
                         const RenderSettings& settings, const Film& film) {
  const auto refuse = [&](const std::string& what) {
    throw Error("the film is of another render: " + what, path.string(),
                "name another file, or delete this one");
  };
  for (std::size_t i = 0; i < settings.size(); ++i) {
    const auto& [name, value] = settings[i];
    if (i >= found.settings.size() || found.settings[i].first != name) {
      refuse(fmt::format("it does not say its {}", name));
    } else if (found.settings[i].second != value) {
      refuse(fmt::format("{} is {} there, {} here", name, found.settings[i].second, value));
    }
  }
  if (found.settings.size() > settings.size()) {
    refuse(fmt::format("it has a {}", found.settings[settings.size()].first));
  }
  if (found.film->width() != film.width() || found.film->height() != film.height() ||
      found.film->layers() != film.layers()) {
    refuse("its size or its layers differ");
  }
}

void join_film(const FilmFile& part, const std::filesystem::path& path, FilmFile& whole) {
  require_same_render(part, path, whole.settings, *whole.film);
  for (std::size_t i = 0; i < part.film->n_tiles(); ++i) {
    if (part.film->samples_of(i) == 0) {
      continue;
    }
    if (whole.film->samples_of(i) != 0) {
      throw Error("the film has tiles that another one has too", path.string(),
                  "name each part once: those of --part 1/N to N/N");
    }
    whole.film->put(i, part.film->take(i));
  }
  whole.film->add_splats(part.film->state().splats);
}

}  // namespace haarlight::render
