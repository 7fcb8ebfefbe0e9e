// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_file.h"

#include <algorithm>
#include <string>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/relight/shadow/shadow_scene.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

const std::string kKey = "0123456789abcdef0123456789abcdef";

ShadowHull some_hull() {
  ShadowHull hull;
  hull.grid =
      make_voxel_grid(shadow_scene::ground(), 1.0, {{-8.0, -6.0, 4.0}, {8.0, 6.0, 10.0}}, 2.0);
  for (std::size_t i = 0; i < hull.grid.size(); ++i) {
    hull.states.push_back(static_cast<VoxelState>(hash_key(3, i / 5) % 4));
    if (hull.states.back() != VoxelState::empty) {
      hull.evidence.push_back(
          {static_cast<std::uint8_t>(i % 251), static_cast<std::uint8_t>(i)});
    }
  }
  hull.summary.n_matter = 17;
  hull.summary.voxel_mm = 2.0;
  hull.summary.high_mm = 9.5;
  hull.summary.leaves_camera = true;
  hull.summary.offset.most_mm = 4.5;
  hull.summary.offset.is_noticeable = true;
  hull.summary.offset_plane = "a.hlb: plane \"ground\"";
  for (const int width : {7, 12}) {
    FoundPlane& plane = hull.planes.emplace_back();
    plane.scale = 0.1 * width;
    plane.offset.n_pixels = 81;
    plane.shows_plane = Image<std::uint8_t>(5, width, 1);
    plane.shows_object = Image<std::uint8_t>(5, width, 1);
    for (std::size_t i = 0; i < plane.shows_plane.pixels().size(); ++i) {
      plane.shows_plane.pixels()[i] = hash_key(4, i / 3) % 2 != 0;
      plane.shows_object.pixels()[i] = hash_key(5, i / 4) % 2 != 0;
    }
  }
  return hull;
}

TEST(HullFile, IsReadBack) {
  const testing::TemporaryFolder folder;
  const ShadowHull hull = some_hull();
  write_hull(hull, kKey, folder / "a.hull");
  const auto found = read_hull_of(folder / "a.hull", kKey);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->states, hull.states);
  EXPECT_EQ(found->evidence, hull.evidence);
  EXPECT_EQ(found->grid.nx, hull.grid.nx);
  EXPECT_EQ(found->grid.low, hull.grid.low);
  EXPECT_EQ(found->summary.n_matter, 17);
  EXPECT_EQ(found->summary.high_mm, 9.5);
  EXPECT_TRUE(found->summary.leaves_camera);
  EXPECT_FALSE(found->summary.touches_border);
  EXPECT_EQ(found->summary.offset.most_mm, 4.5);
  EXPECT_TRUE(found->summary.offset.is_noticeable);
  EXPECT_EQ(found->summary.offset_plane, hull.summary.offset_plane);
  ASSERT_EQ(found->planes.size(), hull.planes.size());
  for (std::size_t i = 0; i < hull.planes.size(); ++i) {
    EXPECT_EQ(found->planes[i].scale, hull.planes[i].scale);
    EXPECT_EQ(found->planes[i].offset.n_pixels, 81);
    EXPECT_TRUE(std::ranges::equal(found->planes[i].shows_plane.pixels(),
                                   hull.planes[i].shows_plane.pixels()));
    EXPECT_TRUE(std::ranges::equal(found->planes[i].shows_object.pixels(),
                                   hull.planes[i].shows_object.pixels()));
  }
}

TEST(HullFile, ThatAUserNamesIsReadWhateverItsKey) {
  const testing::TemporaryFolder folder;
  write_hull(some_hull(), kKey, folder / "a.hull");
  EXPECT_EQ(read_hull(folder / "a.hull").states, some_hull().states);
  EXPECT_THROW((void)read_hull(folder / "b.hull"), Error);
  write_file_atomically(folder / "c.hull", std::string_view("a basis file"));
  EXPECT_THROW((void)read_hull(folder / "c.hull"), Error);
  std::string bytes = read_file(folder / "a.hull");
  bytes[bytes.size() / 2] ^= 1;
  write_file_atomically(folder / "d.hull", std::string_view(bytes));
  EXPECT_THROW((void)read_hull(folder / "d.hull"), Error);
  write_file_atomically(folder / "e.hull", std::string_view(bytes).substr(0, 9));
  EXPECT_THROW((void)read_hull(folder / "e.hull"), Error);
}

TEST(HullFile, OfAnotherKeyOrMissingIsCarvedAgain) {
  const testing::TemporaryFolder folder;
  write_hull(some_hull(), kKey, folder / "a.hull");
  std::string other = kKey;
  other[0] = 'f';
  EXPECT_FALSE(read_hull_of(folder / "a.hull", other));
  EXPECT_FALSE(read_hull_of(folder / "b.hull", kKey));
  EXPECT_FALSE(read_hull_of(folder / "", kKey));
}

TEST(HullFile, DamagedAnywhereIsCarvedAgain) {
  const testing::TemporaryFolder folder;
  write_hull(some_hull(), kKey, folder / "a.hull");
  const std::string good = read_file(folder / "a.hull");
  for (std::size_t i = 0; i < good.size(); i += 3) {
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ 0x10);
    write_file_atomically(folder / "a.hull", std::string_view(bad));
    EXPECT_FALSE(read_hull_of(folder / "a.hull", kKey)) << i;
    write_file_atomically(folder / "a.hull", std::string_view(good).substr(0, i));
    EXPECT_FALSE(read_hull_of(folder / "a.hull", kKey)) << i;
  }
}

TEST(HullFile, LiesWithAGoodHashAreCarvedAgain) {
  // A file whose hash is right and whose contents are not: sizes that overflow, runs too long.
  const testing::TemporaryFolder folder;
  write_hull(some_hull(), kKey, folder / "a.hull");
  const std::string good = read_file(folder / "a.hull");
  const std::size_t body = good.size() - 32;
  for (std::size_t i = 40; i < body; ++i) {
    std::string bad = good.substr(0, body);
    bad[i] = static_cast<char>(0xff);
    bad += content_hash(std::string_view(bad));
    write_file_atomically(folder / "a.hull", std::string_view(bad));
    const auto found = read_hull_of(folder / "a.hull", kKey);
    if (found) {  // what was changed is a number that may be anything
      EXPECT_EQ(found->states.size(), found->grid.size()) << i;
      EXPECT_EQ(static_cast<std::ptrdiff_t>(found->evidence.size()),
                std::count_if(found->states.begin(), found->states.end(),
                              [](VoxelState s) { return s != VoxelState::empty; }))
          << i;
    }
  }
}

TEST(HullFile, NeverReplacesSomethingElse) {
  const testing::TemporaryFolder folder;
  write_file_atomically(folder / "a.hull", "somebody's drawing of a ship");
  EXPECT_THROW(write_hull(some_hull(), kKey, folder / "a.hull"), Error);
  EXPECT_EQ(read_file(folder / "a.hull"), "somebody's drawing of a ship");
}

TEST(HullFile, SaysThatItCannotBeWritten) {
  EXPECT_THROW(write_hull(some_hull(), kKey, "/proc/none/a.hull"), Error);
}

}  // namespace
}  // namespace haarlight::relight
