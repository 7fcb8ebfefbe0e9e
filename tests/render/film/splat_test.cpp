// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "core/temporary_folder.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/film/film.h"
#include "render/film/film_file.h"
#include "render/film/splat_sum.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

bool are_same(const SplatSum& a, const SplatSum& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

/// Numbers of both signs over 80 orders of magnitude.
std::vector<Vector3d> values(std::size_t n, double decades) {
  std::vector<Vector3d> found;
  for (std::size_t i = 0; i < n; ++i) {
    const auto unit = [i](std::uint64_t key) { return uniform_unit(hash_key(i, key)); };
    const double size = std::pow(10.0, decades * (unit(0) - 0.5));
    found.emplace_back(size * (unit(1) - 0.3), size * (unit(2) - 0.7), -size * unit(3));
  }
  return found;
}

TEST(SplatSum, DoesNotDependOnTheOrderOrOnParts) {
  const std::vector<Vector3d> all = values(500, 80.0);
  SplatSum forwards;
  SplatSum backwards;
  SplatSum thirds[3];
  for (std::size_t i = 0; i < all.size(); ++i) {
    forwards.add(all[i]);
    backwards.add(all[all.size() - 1 - i]);
    thirds[i % 3].add(all[i]);
  }
  EXPECT_TRUE(are_same(forwards, backwards));
  SplatSum joined;
  for (const int part : {1, 2, 0}) {
    joined.add(thirds[part]);
  }
  EXPECT_TRUE(are_same(forwards, joined));
}

TEST(SplatSum, IsTheSumToTheLastBitsOfADouble) {
  for (const double scale : {1e-40, 1e-20, 1.0, 1e20, 1e40}) {
    SplatSum sum;
    long double truth[3] = {};
    for (const Vector3d& value : values(2000, 3.0)) {
      sum.add(scale * value);
      for (int c = 0; c < 3; ++c) {
        truth[c] += static_cast<long double>(scale * value[c]);
      }
    }
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(sum.value()[c] / static_cast<double>(truth[c]), 1.0, 1e-14) << scale;
    }
  }
}

TEST(SplatSum, ManyDimOnesBesideABrightOneAreNotLost) {
  SplatSum sum;
  sum.add(Vector3d::Constant(1.0));
  for (int i = 0; i < 100'000; ++i) {
    sum.add(Vector3d::Constant(1e-9));
  }
  // Each loses less than 2^-64 of the bright one, 5e-15 together; singly they would be 1e-4 of it.
  EXPECT_NEAR(sum.value().x(), 1.0 + 1e-4, 1e5 * 0x1p-64 + 2e-16);
}

TEST(SplatSum, WhatItDoesNotHoldIsRefused) {
  SplatSum sum;
  EXPECT_THROW(sum.add(Vector3d::Constant(1e290)), Error);
  // Doubled 31 times, a word is full.
  SplatSum full;
  full.add(Vector3d::Constant(0x1.fffffffffffffp+31));
  EXPECT_THROW(
      {
        for (int i = 0; i < 40; ++i) {
          const SplatSum same = full;
          full.add(same);
        }
      },
      Error);
}

const std::vector<FilmLayer> kLayers{
    {.name = "picture", .channels = 3, .has_error = true, .has_splats = true}};

TEST(Film, SplatsAreMeansOverTheSamplesOfAllPixels) {
  Film film(40, 2, kLayers);  // tiles of 64 and 16 pixels
  for (const std::size_t i : {std::size_t{0}, std::size_t{1}}) {
    FilmTile tile = film.take(i);
    tile.add_splat(39, 1, Vector3d(80.0, 160.0, 0.0));
    tile.set_samples(4);
    film.put(i, std::move(tile));
  }
  // 320 samples, two of them 80: mean 0.5, variance of it (12800/320 - 0.25)/319.
  EXPECT_FLOAT_EQ(film.mean(0)(1, 39, 0), 0.5F);
  EXPECT_FLOAT_EQ(film.mean(0)(1, 39, 1), 1.0F);
  EXPECT_FLOAT_EQ(film.mean(0)(1, 38, 0), 0.0F);
  EXPECT_FLOAT_EQ(film.standard_error(0)(1, 39, 0),
                  static_cast<float>(std::sqrt((40.0 - 0.25) / 319.0)));
}

TEST(FilmFile, SplatsComeBackAndAreJoined) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "splats.film";
  const RenderSettings settings{{"scene", "of nothing"}};
  Film film(40, 2, kLayers);
  FilmTile tile = film.take(1);
  tile.add_splat(3, 1, Vector3d(1e20, -2.0, 1e-20));
  tile.set_samples(4);
  film.put(1, std::move(tile));
  write_film(path, film, settings);
  const FilmFile found = read_film(path, 1U << 30U);
  require_same_render(found, path, settings, film);
  const auto a = film.state().splats;
  const auto b = found.film->state().splats;
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size() * sizeof(SplatPixel)), 0);
  // Joined to another part.
  FilmFile whole{.settings = settings, .film = std::make_unique<Film>(40, 2, kLayers)};
  FilmTile first = whole.film->take(0);
  first.add_splat(3, 1, Vector3d(1e20, 0.0, 0.0));
  first.set_samples(4);
  whole.film->put(0, std::move(first));
  join_film(found, path, whole);
  EXPECT_FLOAT_EQ(whole.film->mean(0)(1, 3, 0), 2e20F / 320.0F);
  // Cut short at a tile, or with a sum that cannot be: a named cause.
  const std::string bytes = read_file(path);
  const auto forge = [&](const std::string& content) {
    write_file_atomically(path, content + content_hash(content));
    EXPECT_THROW(static_cast<void>(read_film(path, 1U << 30U)), Error);
  };
  const std::string content = bytes.substr(0, bytes.size() - 32);
  forge(content.substr(0, content.size() - 8));
  forge(content + "more");
  std::string impossible = content;
  impossible[content.size() - 1] = '\x7f';  // of the last sum's position
  forge(impossible);
}

}  // namespace
}  // namespace haarlight::render
