// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/viewer_site.h"

#include <cstring>
#include <memory>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "http/server.h"
#include "relight/view/gpu_pages.h"
#include "tests/apps/viewer/small_basis.h"
#include "tests/http/raw_client.h"

namespace haarlight::apps {
namespace {

using Json = nlohmann::json;

std::shared_ptr<HullCache> hull_of(const std::filesystem::path& file) {
  HullRequest request;
  request.captured.basis = file;
  return std::make_shared<HullCache>(std::move(request));
}

class ViewerSite : public ::testing::Test {
 protected:
  http::RawResponse get(const std::string& path) {
    return http::exchange(server_.port(), "GET", path);
  }
  std::string data(const std::string& rest) {
    return fmt::format("/v1/basis/{}/{}", basis_->content_key(), rest);
  }
  void expect_refused(const http::RawResponse& response, int status) {
    EXPECT_EQ(response.status, status) << response.body;
    const Json error = Json::parse(response.body).at("error");
    for (const char* part : {"what", "where", "cure"}) {
      EXPECT_FALSE(error.at(part).get<std::string>().empty());
    }
  }

  testing::TemporaryFolder folder_;
  std::shared_ptr<const relight::BasisFile> basis_ =
      std::make_shared<const relight::BasisFile>(test::small_rig_basis(folder_.path()));
  http::HttpServer server_{{.max_body_bytes = 100'000},
                           viewer_site(basis_, std::make_shared<EnvironmentCache>(*basis_),
                                       hull_of(folder_.path() / "small.hlb"),
                                       {.web_folder = "web", .texture_bytes = 12345})};
};

TEST_F(ViewerSite, DescribesTheFile) {
  const http::RawResponse response = get("/v1/basis");
  ASSERT_EQ(response.status, 200);
  EXPECT_EQ(response.headers.at("cache-control"), "no-store");
  const Json about = Json::parse(response.body);
  const relight::BasisHeader& header = basis_->header();
  EXPECT_EQ(about.at("file"), "small.hlb");
  EXPECT_EQ(about.at("hash"), basis_->content_key());
  EXPECT_EQ(about.at("picture").at("width"), header.dims.width);
  EXPECT_EQ(about.at("step"), header.step) << "the very number";
  EXPECT_EQ(about.at("order"), basis_->order());
  EXPECT_EQ(about.at("texture_bytes"), 12345);
  EXPECT_EQ(about.at("faces"),
            Json::parse(R"([{"id": "top", "first": 0, "rows": 8, "cols": 8}])"));
  EXPECT_FALSE(about.contains("places"));
}

TEST_F(ViewerSite, GivesTheTablesBitForBit) {
  const std::string bytes = get(data("tables")).body;
  const relight::BasisTables& tables = basis_->tables();
  std::vector<float> expected = tables.plate_vectors;
  for (const auto* part :
       {&tables.coefficient_norms, &tables.coefficient_errors, &tables.light_norms,
        &tables.light_errors, &tables.coded_bound.fractions, &tables.coded_bound.rests,
        &tables.coded_bound.vectors, &tables.term_bound.fractions, &tables.term_bound.rests,
        &tables.term_bound.vectors}) {
    expected.insert(expected.end(), part->begin(), part->end());
  }
  EXPECT_FALSE(tables.coded_bound.is_empty());
  ASSERT_EQ(bytes.size(), expected.size() * sizeof(float));
  EXPECT_EQ(std::memcmp(bytes.data(), expected.data(), bytes.size()), 0);
}

TEST_F(ViewerSite, GivesPagesThatABrowserMayKeep) {
  const int last = basis_->n_tiles() - 1;
  const http::RawResponse response = get(data(fmt::format("pages/0/0/0-{}", last)));
  EXPECT_EQ(response.status, 200);
  EXPECT_EQ(response.headers.at("cache-control"), "private, max-age=31536000, immutable");
  EXPECT_EQ(response.body, relight::coefficient_pages(*basis_, 0, 0, {0, last}));
  EXPECT_EQ(get(data(fmt::format("gains/0/0-{}", last))).body,
            relight::gain_pages(*basis_, 0, {0, last}));
  EXPECT_EQ(get(data(fmt::format("polynomials/0/0-{}", last))).body,
            relight::plate_polynomials(*basis_, 0, {0, last}));
  EXPECT_EQ(get(data("shifts/0/1-1")).body, relight::shift_pages(*basis_, 0, {1, 1}));
}

TEST_F(ViewerSite, RefusesWhatIsNoPage) {
  for (const char* path :
       {"pages/1/0/0-0", "pages/-1/0/0-0", "pages/0/99/0-0", "pages/0/0/0", "pages/0/0/0-",
        "pages/0/0/-", "pages/0/0/1-0", "pages/0/0/0-99", "pages/0/0/0-4294967296",
        "pages/0/0/0-1x", "pages/0x/0/0-1", "pages/0/+0/0-1", "gains/3/0-0", "gains/0/9-9",
        "polynomials/-1/0-0", "polynomials/0/9-9", "shifts/0/a-b", "shifts/0/-1-0"}) {
    SCOPED_TRACE(path);
    expect_refused(get(data(path)), 400);
  }
  expect_refused(get("/v1/basis/0123456789abcdef/tables"), 400);
  expect_refused(get(data("nothing")), 404);
  expect_refused(http::exchange(server_.port(), "POST", data("tables")), 405);
}

TEST_F(ViewerSite, RefusesBrokenQuestionsForWeights) {
  const http::RawResponse sent =
      http::exchange(server_.port(), "POST", "/v1/environments?name=x.hdr", {}, "no picture");
  ASSERT_EQ(sent.status, 202);
  const std::string path =
      "/v1/environments/" + Json::parse(sent.body).at("id").get<std::string>() + "/weights";
  for (const char* query : {"?rotate=", "?rotate=north", "?rotate=nan", "?rotate=inf",
                            "?rotate=1e999", "?rotate=0x", "?quality=best"}) {
    SCOPED_TRACE(query);
    expect_refused(get(path + query), 400);
  }
  expect_refused(get("/v1/environments/99/weights"), 400);
  expect_refused(
      http::exchange(server_.port(), "POST", "/v1/environments", {}, std::string(100'001, 'x')),
      413);
}

TEST_F(ViewerSite, LeadsToThePageAndServesItsFiles) {
  const http::RawResponse root = get("/");
  EXPECT_EQ(root.status, 303);
  EXPECT_EQ(root.headers.at("location"), "/viewer/index.html");
  EXPECT_NE(get("/viewer/index.html").body.find("viewer.css"), std::string::npos);
  EXPECT_EQ(get("/viewer/main.js").headers.at("content-type"),
            "text/javascript; charset=utf-8");
  expect_refused(get("/viewer/../../README.md"), 400);
}

TEST(ViewerSiteOfAnImport, PutsTheLightsOnTheHemispheresMap) {
  testing::TemporaryFolder folder;
  const auto basis =
      std::make_shared<const relight::BasisFile>(test::small_import_basis(folder.path()));
  const http::HttpServer server({},
                                viewer_site(basis, std::make_shared<EnvironmentCache>(*basis),
                                            hull_of(folder.path() / "import.hlb"), {}));
  const Json about = Json::parse(http::exchange(server.port(), "GET", "/v1/basis").body);
  EXPECT_FALSE(about.contains("faces"));
  ASSERT_EQ(about.at("places").size(), 16U);
  for (std::size_t k = 0; k < 16; ++k) {
    const Eigen::Vector3d d = basis->header().lights[k].coordinates;
    const double x = about.at("places")[k][0];
    const double y = about.at("places")[k][1];
    EXPECT_NEAR(std::hypot(x, y), std::acos(d.z()) / std::acos(0.0), 1e-12);
    EXPECT_NEAR(x * d.y(), y * d.x(), 1e-12);
    EXPECT_EQ(about.at("names")[k], basis->header().lights[k].name);
  }
  EXPECT_EQ(http::exchange(server.port(), "GET", "/").status, 404) << "no page was given";
}

}  // namespace
}  // namespace haarlight::apps
