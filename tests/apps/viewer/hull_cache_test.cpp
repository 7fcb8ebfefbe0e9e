// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/hull_cache.h"

#include <chrono>
#include <cstring>
#include <filesystem>
#include <thread>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "apps/viewer/viewer_site.h"
#include "haarlight/render/light/rig_lights.h"
#include "http/server.h"
#include "relight/hull/hull_file.h"
#include "relight/hull/hull_surface.h"
#include "tests/apps/viewer/small_basis.h"
#include "tests/http/raw_client.h"
#include "tests/relight/pipeline/captured_box.h"

namespace haarlight::apps {
namespace {

using Json = nlohmann::json;
using State = HullCache::State;

HullCache::Look wait_for(const HullCache& cache) {
  HullCache::Look now = cache.look();
  for (int i = 0; i < 12000 && now.state == State::carving; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    now = cache.look();
  }
  return now;
}

/// A box of 60 mm, 20 mm over the plane, under 64 lights.
class HullCacheOfABox : public testing::CapturedBox {
 protected:
  void SetUp() override {
    capture("box.hlb", rig_);
    request_.captured.basis = folder_ / "box.hlb";
  }
  [[nodiscard]] std::string kept_file() const { return folder_ / "box.hlb.hull"; }

  HullRequest request_;
};

TEST_F(HullCacheOfABox, CarvesOnRequestAndKeepsTheHull) {
  HullCache cache(request_);
  EXPECT_EQ(cache.look().state, State::waiting);
  EXPECT_FALSE(std::filesystem::exists(kept_file())) << "nobody has asked";
  cache.begin();
  const HullCache::Look found = wait_for(cache);
  ASSERT_EQ(found.state, State::ready);
  EXPECT_TRUE(std::filesystem::exists(kept_file()));
  cache.begin();
  EXPECT_EQ(cache.look().hull, found.hull) << "it is carved once";

  HullCache again(request_);
  again.begin();
  const HullCache::Look read = wait_for(again);
  ASSERT_EQ(read.state, State::ready);
  EXPECT_EQ(read.hull->voxels, found.hull->voxels);
  EXPECT_EQ(read.hull->hash, found.hull->hash);
}

TEST_F(HullCacheOfABox, GivesEveryVoxelSurfaceAndLight) {
  request_.voxel_mm = 4.0;
  request_.options = {"--voxel", "4"};
  HullCache cache(request_);
  cache.begin();
  ASSERT_EQ(wait_for(cache).state, State::ready);
  const HullForPage& page = *cache.look().hull;
  const relight::ShadowHull hull = relight::read_hull(kept_file());
  const Json about = Json::parse(page.description);
  EXPECT_EQ(about.at("grid").at("size"), (Json{hull.grid.nx, hull.grid.ny, hull.grid.nz}));
  ASSERT_EQ(page.voxels.size(), (hull.states.size() + 3) / 4);
  std::size_t n_other = 0;
  for (std::size_t i = 0; i < hull.states.size(); ++i) {
    const auto byte = static_cast<unsigned char>(page.voxels[i / 4]);
    n_other += ((byte >> (2 * (i % 4))) & 3U) != static_cast<unsigned>(hull.states[i]) ? 1 : 0;
  }
  EXPECT_EQ(n_other, 0U);

  const render::SurfaceMesh mesh = relight::hull_surface(hull);
  const std::size_t n = about.at("surface").at("vertices");
  const std::size_t n_triangles = about.at("surface").at("triangles");
  ASSERT_EQ(n, mesh.vertices.size());
  ASSERT_EQ(n_triangles, mesh.triangles.size());
  ASSERT_EQ(page.surface.size(), 27 * n + 12 * n_triangles);
  EXPECT_EQ(std::memcmp(page.surface.data(), mesh.vertices.data(), 12 * n), 0);
  EXPECT_EQ(std::memcmp(page.surface.data() + 24 * n, mesh.triangles.data(), 12 * n_triangles),
            0);

  const auto lights = render::rig_lights(parse_rig(rig_, "rig"));
  ASSERT_EQ(about.at("lights").size(), lights.size());
  const Json& last = about.at("lights").back();
  EXPECT_EQ(last.at("centre")[1], lights.back().centre.y());
  EXPECT_EQ(last.at("size")[0], lights.back().width_mm);
  EXPECT_EQ(about.at("plane").at("width_mm"), 400.0);
  EXPECT_EQ(about.at("grid").at("voxel_mm"), 4.0);
  EXPECT_EQ(about.at("options"), (Json{"--voxel", "4"}));
}

TEST_F(HullCacheOfABox, IsServed) {
  const auto basis = std::make_shared<const relight::BasisFile>(
      relight::BasisFile::open(request_.captured.basis));
  const auto cache = std::make_shared<HullCache>(request_);
  const http::HttpServer server(
      {}, viewer_site(basis, std::make_shared<EnvironmentCache>(*basis), cache, {}));
  const auto get = [&](const std::string& path) {
    return http::exchange(server.port(), "GET", path);
  };
  EXPECT_EQ(Json::parse(get("/v1/hull").body), (Json{{"state", "waiting"}}));
  EXPECT_EQ(http::exchange(server.port(), "POST", "/v1/hull").status, 202);
  ASSERT_EQ(wait_for(*cache).state, State::ready);
  const http::RawResponse ready = get("/v1/hull");
  EXPECT_EQ(ready.status, 200);
  const std::string hash = Json::parse(ready.body).at("hash");
  EXPECT_EQ(get(fmt::format("/v1/hull/{}/voxels", hash)).body, cache->look().hull->voxels);
  EXPECT_EQ(get(fmt::format("/v1/hull/{}/surface", hash)).body, cache->look().hull->surface);
  EXPECT_EQ(get("/v1/hull/0123456789abcdef/voxels").status, 400);
  EXPECT_EQ(get(fmt::format("/v1/hull/{}/nothing", hash)).status, 404);
}

void expect_refused(const HullCache::Look& look, const std::string& words) {
  EXPECT_EQ(look.state, State::refused);
  ASSERT_TRUE(look.problem.has_value());
  EXPECT_NE(std::string(look.problem->what()).find(words), std::string::npos)
      << look.problem->what();
  EXPECT_FALSE(look.problem->hint().empty());
}

TEST_F(HullCacheOfABox, SaysWhyThereIsNone) {
  const std::string few = testing::replaced(testing::replaced(rig_, "rows = 8", "rows = 1"),
                                            "cols = 8", "cols = 3");
  store("few.hlb", few, render(few), {1, 3});
  request_.captured.basis = folder_ / "few.hlb";
  HullCache cache(request_);
  expect_refused(cache.look(), "3 lights shine on the shadow plane: too few");
  cache.begin();
  expect_refused(cache.look(), "too few");

  std::string planeless = rig_;
  const std::size_t at = planeless.find("[[plane]]");
  planeless.erase(at, planeless.find("[[camera]]") - at);
  store("planeless.hlb", planeless, render(rig_));
  request_.captured.basis = folder_ / "planeless.hlb";
  expect_refused(HullCache(request_).look(), "no [[plane]]");

  request_.captured.basis = folder_ / "import.hlb";
  (void)test::small_import_basis(folder_.path());
  expect_refused(HullCache(request_).look(), "no rig");
}

TEST_F(HullCacheOfABox, SaysThatTheCaptureShowsNoObject) {
  store("empty.hlb", rig_, testing::render_capture(rig_, {}));
  request_.captured.basis = folder_ / "empty.hlb";
  HullCache cache(request_);
  cache.begin();
  expect_refused(wait_for(cache), "no object");
}

}  // namespace
}  // namespace haarlight::apps
