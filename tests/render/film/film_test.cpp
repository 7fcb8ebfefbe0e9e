// SPDX-License-Identifier: Apache-2.0
#include "render/film/film.h"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "core/temporary_folder.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/film/film_file.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

const std::vector<FilmLayer> kLayers{{.name = "picture", .channels = 3, .has_error = true},
                                     {.name = "depth", .channels = 1}};
constexpr std::uint64_t kRoom = 1U << 30U;

/// Adds samples of a grey value to the only pixel.
void add(Film& film, std::initializer_list<double> values) {
  FilmTile tile = film.take(0);
  for (const double value : values) {
    tile.add(0, 0, 0, Vector3d::Constant(value));
    tile.set_samples(tile.samples() + 1);
  }
  film.put(0, std::move(tile));
}

TEST(Film, NoiseDoesNotCountAsPicture) {
  // Two samples of a pixel, 0 and 2: mean 1, standard error 1. Nothing is known of its light.
  Film film(1, 1, kLayers);
  add(film, {0.0});
  EXPECT_EQ(film.error(0).relative_l2, std::numeric_limits<double>::infinity());
  add(film, {2.0});
  EXPECT_EQ(film.error(0).relative_l2, std::numeric_limits<double>::infinity());
  // 1 and 3: mean 2, standard error 1, light 2^2 - 1^2.
  Film other(1, 1, kLayers);
  add(other, {1.0, 3.0});
  EXPECT_NEAR(other.error(0).relative_l2, 1.0 / std::sqrt(3.0), 1e-12);
}

TEST(Film, WhatOverflowsIsNotKnown) {
  Film film(1, 1, kLayers);
  add(film, {1e200, 1e200});
  EXPECT_EQ(film.error(0).relative_l2, std::numeric_limits<double>::infinity());
}

TEST(Film, TilesCoverThePictureOnce) {
  const Film film(70, 33, kLayers);
  ASSERT_EQ(film.n_tiles(), 6U);
  std::vector<int> covered(std::size_t{70} * 33);
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    const Tile area = film.area_of(i);
    for (int y = area.y0; y < area.y1; ++y) {
      for (int x = area.x0; x < area.x1; ++x) {
        ++covered[std::size_t{70} * static_cast<std::size_t>(y) + static_cast<std::size_t>(x)];
      }
    }
  }
  EXPECT_THAT(covered, testing::Each(1));
}

TEST(Film, LayersDoNotMix) {
  Film film(40, 2, kLayers);
  FilmTile tile = film.take(1);
  tile.add(35, 1, 0, Vector3d(1.0, 2.0, 3.0));
  tile.add(35, 1, 1, 700.0);
  tile.add(35, 1, 0, Vector3d(3.0, 2.0, 1.0));
  tile.add(35, 1, 1, 800.0);
  tile.set_samples(2);
  film.put(1, tile);
  const Image<float> mean = film.mean(0);
  const Image<float> error = film.standard_error(0);
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 40; ++x) {
      const float seen = x == 35 && y == 1 ? 1.0F : 0.0F;
      EXPECT_EQ(film.mean(1)(y, x), 750.0F * seen);
      EXPECT_EQ(mean(y, x, 0), 2.0F * seen);
      EXPECT_EQ(mean(y, x, 2), 2.0F * seen);
      // Without samples nothing is known.
      EXPECT_EQ(error(y, x, 0), x < 32 ? std::numeric_limits<float>::infinity() : seen);
      EXPECT_EQ(error(y, x, 1), x < 32 ? std::numeric_limits<float>::infinity() : 0.0F);
    }
  }
}

TEST(Film, StatedErrorsCountTheNeighboursAs32Samples) {
  Film film(33, 3, {{.name = "picture", .channels = 1, .has_error = true}});
  for (const auto& [i, n] : {std::pair{std::size_t{0}, 4}, std::pair{std::size_t{1}, 9}}) {
    FilmTile tile = film.take(i);
    for (int sample = 0; sample < n; ++sample) {
      if (i == 0) {
        tile.add(30, 1, 0, sample % 2 == 0 ? 3.0 : -3.0);  // a variance of 12
      }
    }
    tile.set_samples(static_cast<std::uint32_t>(n));
    film.put(i, std::move(tile));
  }
  const Image<float> error = film.stated_error(0);
  EXPECT_FLOAT_EQ(film.standard_error(0)(1, 30), std::sqrt(12.0F / 4.0F));
  const float others = 32.0F / 36.0F;
  EXPECT_FLOAT_EQ(error(1, 30),
                  std::sqrt((12.0F * 4.0F / 36.0F + others * 12.0F / 9.0F) / 4.0F));
  EXPECT_FLOAT_EQ(error(1, 31), std::sqrt(others * 12.0F / 9.0F / 4.0F));
  EXPECT_FLOAT_EQ(error(0, 31), std::sqrt(others * 12.0F / 6.0F / 4.0F)) << "at the border";
  EXPECT_EQ(error(1, 32), 0.0F) << "two away";
  EXPECT_EQ(error(1, 28), 0.0F);
}

TEST(Film, StatedErrorsKnowTheSamplesOfTheirPixelAndWhereThereAreNone) {
  Film film(64, 1, {{.name = "picture", .channels = 1, .has_error = true}});
  FilmTile tile = film.take(1);
  for (int sample = 0; sample < 4; ++sample) {
    tile.add(32, 0, 0, sample % 2 == 0 ? 3.0 : -3.0);
  }
  tile.set_samples(4);
  film.put(1, std::move(tile));
  const Image<float> error = film.stated_error(0);
  EXPECT_EQ(error(0, 31), std::numeric_limits<float>::infinity());
  EXPECT_FLOAT_EQ(error(0, 32), std::sqrt((12.0F * 4.0F / 36.0F + 6.0F * 32.0F / 36.0F) / 4.0F))
      << "of two that are known";
}

/// Few samples of rare bright light: exactly what a pixel's own variance knows badly.
TEST(Film, StatedErrorsCoverTheTruthMoreOften) {
  constexpr int kSide = 64;
  constexpr int kSamples = 16;
  Film film(kSide, kSide, {{.name = "picture", .channels = 1, .has_error = true}});
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    FilmTile tile = film.take(i);
    const Tile area = tile.area();
    for (int y = area.y0; y < area.y1; ++y) {
      for (int x = area.x0; x < area.x1; ++x) {
        for (int s = 0; s < kSamples; ++s) {
          const auto key =
              hash_key(static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y),
                       static_cast<std::uint64_t>(s));
          const double u = uniform_unit(key);
          tile.add(x, y, 0, u * u * u * u);  // mean 1/5
        }
      }
    }
    tile.set_samples(kSamples);
    film.put(i, std::move(tile));
  }
  const auto within = [&](const Image<float>& error) {
    const Image<float> mean = film.mean(0);
    int n = 0;
    for (std::size_t i = 0; i < mean.pixels().size(); ++i) {
      n += std::abs(mean.pixels()[i] - 0.2F) <= 1.96F * error.pixels()[i] ? 1 : 0;
    }
    return static_cast<double>(n) / (kSide * kSide);
  };
  // Of 4096 pixels 95 % have a standard deviation of 0.34 %. What is left is the mean's own skewness.
  const double alone = within(film.standard_error(0));
  const double stated = within(film.stated_error(0));
  EXPECT_GT(stated, alone + 0.02) << alone;
  EXPECT_NEAR(stated, 0.95, 0.02);
}

/// A film of two tiles on disk.
struct Stored {
  TemporaryFolder folder;
  std::filesystem::path path = folder.path() / "a.film";
  RenderSettings settings{{"scene", "of nothing"}, {"seed", "7"}};
  Film film{40, 2, kLayers};

  Stored() {
    for (const std::size_t i : {std::size_t{0}, std::size_t{1}}) {
      FilmTile tile = film.take(i);
      tile.add(tile.area().x0, 0, 0, Vector3d(1.0 / 3.0, 2.0, -5e-324));
      tile.set_samples(9);
      film.put(i, std::move(tile));
    }
    write_film(path, film, settings);
  }

  /// The file with other content and the right hash.
  void forge(const std::string& content) const {
    std::ofstream(path, std::ios::binary) << content << content_hash(content);
  }
  [[nodiscard]] std::string content() const {
    const std::string bytes = read_file(path);
    return bytes.substr(0, bytes.size() - 32);
  }
  /// What read_film says of it.
  [[nodiscard]] std::string problem() const {
    try {
      (void)read_film(path, kRoom);
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr(path.string()));
      return error.what();
    }
    return "";
  }
};

TEST(FilmFile, ComesBackToTheBit) {
  const Stored stored;
  const FilmFile found = read_film(stored.path, kRoom);
  require_same_render(found, stored.path, stored.settings, stored.film);
  EXPECT_EQ(found.settings, stored.settings);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(found.film->samples_of(i), 9U);
    const FilmTile a = found.film->take(i);
    const FilmTile b = stored.film.take(i);
    EXPECT_EQ(std::memcmp(a.sums().data(), b.sums().data(), a.sums().size_bytes()), 0);
  }
}

TEST(FilmFile, EveryChangedByteIsFound) {
  const Stored stored;
  const std::string whole = read_file(stored.path);
  for (std::size_t i = 0; i < whole.size(); i += i < 300 ? 1 : 37) {
    std::string damaged = whole;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x10);
    std::ofstream(stored.path, std::ios::binary) << damaged;
    EXPECT_NE(stored.problem(), "") << i;
  }
  for (const std::size_t length :
       {std::size_t{0}, std::size_t{7}, std::size_t{40}, whole.size() - 1}) {
    std::ofstream(stored.path, std::ios::binary) << whole.substr(0, length);
    EXPECT_NE(stored.problem(), "") << length;
  }
}

TEST(FilmFile, ContentThatCannotBeIsRefusedThoughItsHashIsRight) {
  const Stored stored;
  const std::string content = stored.content();
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string changed = content;
    const std::size_t at = changed.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return changed.replace(at, from.size(), to);
  };
  stored.forge(content.substr(0, content.size() - 8));
  EXPECT_THAT(stored.problem(), HasSubstr("ends too early"));
  stored.forge(content + content.substr(content.size() - 2 * sizeof(double)));
  EXPECT_NE(stored.problem(), "");
  stored.forge(with("\"width\":40", "\"width\":-4"));
  EXPECT_THAT(stored.problem(), HasSubstr("width"));
  stored.forge(with("\"width\":40,\"height\":2", "\"width\":65536,\"height\":9"));
  EXPECT_NE(stored.problem(), "");  // the length of the header is another one
  stored.forge(with("\"channels\":3", "\"channels\":0"));
  EXPECT_THAT(stored.problem(), HasSubstr("channels"));
  // The first tile twice: numbers follow the header.
  std::string twice = content;
  std::uint32_t header = 0;
  std::memcpy(&header, content.data() + 8, sizeof header);
  const std::size_t first = 12 + header;
  twice += content.substr(first, 8 + sizeof(double) * 32 * 2 * 7);
  stored.forge(twice);
  EXPECT_THAT(stored.problem(), HasSubstr("no room for tile 0"));
  // A sum that is no number.
  std::string nan = content;
  const double none = std::numeric_limits<double>::quiet_NaN();
  std::memcpy(nan.data() + first + 8, &none, sizeof none);
  stored.forge(nan);
  EXPECT_THAT(stored.problem(), HasSubstr("not finite"));
}

TEST(FilmFile, MoreThanTheMemoryIsRefusedBeforeItIsTaken) {
  const Stored stored;
  try {
    (void)read_film(stored.path, 1000);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("--memory"));
  }
}

TEST(FilmFile, AnotherRenderIsNamed) {
  const Stored stored;
  const FilmFile found = read_film(stored.path, kRoom);
  const auto problem = [&](const RenderSettings& settings, const Film& film) -> std::string {
    try {
      require_same_render(found, stored.path, settings, film);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(problem({{"scene", "of nothing"}, {"seed", "8"}}, stored.film),
              HasSubstr("seed is 7 there, 8 here"));
  EXPECT_NE(problem({{"scene", "of nothing"}}, stored.film), "");
  EXPECT_NE(problem({{"scene", "of nothing"}, {"seed", "7"}, {"parts", "1"}}, stored.film), "");
  EXPECT_THAT(problem(stored.settings, Film(40, 3, kLayers)), HasSubstr("size"));
}

TEST(FilmFile, PartsMakeTheWholeAndDoNotOverlap) {
  const Stored stored;
  FilmFile whole = read_film(stored.path, kRoom);
  const FilmFile same = read_film(stored.path, kRoom);
  EXPECT_THROW(join_film(same, stored.path, whole), Error);
  FilmFile first{.settings = stored.settings, .film = std::make_unique<Film>(40, 2, kLayers)};
  FilmFile second{.settings = stored.settings, .film = std::make_unique<Film>(40, 2, kLayers)};
  first.film->put(0, stored.film.take(0));
  second.film->put(1, stored.film.take(1));
  join_film(second, stored.path, first);
  write_film(stored.folder.path() / "joined.film", *first.film, first.settings);
  EXPECT_EQ(read_file(stored.folder.path() / "joined.film"), read_file(stored.path));
}

}  // namespace
}  // namespace haarlight::render
