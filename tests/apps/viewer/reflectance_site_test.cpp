// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/reflectance_site.h"

#include <cmath>
#include <memory>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "haarlight/relight/reflectance/formats/quantise.h"
#include "http/server.h"
#include "tests/http/raw_client.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight::apps {
namespace {

using Json = nlohmann::json;

std::shared_ptr<const relight::ReflectanceModel> small_model(
    relight::ReflectanceColour colour) {
  auto model = std::make_shared<relight::ReflectanceModel>(
      testing::empty_model(relight::ReflectanceBasis::ptm, colour, 6));
  relight::quantise(*model,
                    testing::smooth_coefficients(5, 7, relight::n_planes_of(colour, 6)).view());
  return model;
}

class ReflectanceSite : public ::testing::TestWithParam<relight::ReflectanceColour> {
 protected:
  http::RawResponse get(const std::string& path) {
    return http::exchange(server_.port(), "GET", path);
  }

  std::shared_ptr<const relight::ReflectanceModel> model_ = small_model(GetParam());
  http::HttpServer server_{{}, reflectance_site(model_, "small.ptm", {.texture_bytes = 12345})};
};

/// A client that sums bytes times factors has relit()'s picture.
TEST_P(ReflectanceSite, ItsNumbersMakeThePicture) {
  const Json about = Json::parse(get("/v1/reflectance").body);
  EXPECT_EQ(about.at("file"), "small.ptm");
  EXPECT_EQ(about.at("picture"), Json({{"width", 7}, {"height", 5}}));
  const int n = about.at("planes");
  ASSERT_EQ(n, model_->n_planes());
  const Eigen::Vector3d light = Eigen::Vector3d(0.3, -0.4, 0.8).normalized();
  const Json map = Json::parse(get("/v1/reflectance/light?x=0.3&y=-0.4&z=0.8").body);
  const auto apply = [&](const Json& to, int c, int pixel, const std::string& bytes) {
    double value = to.at("added")[static_cast<std::size_t>(c)];
    for (int p = 0; p < n; ++p) {
      const int index = p / 4 * 140 + 4 * pixel + p % 4;
      const auto at = static_cast<std::size_t>(index);
      value += double(static_cast<unsigned char>(bytes[at])) *
               to.at("factors")[static_cast<std::size_t>(c)][static_cast<std::size_t>(p)]
                   .get<double>();
    }
    return value;
  };
  std::string bytes;
  for (int layer = 0; 4 * layer < n; ++layer) {
    const http::RawResponse planes = get(fmt::format(
        "/v1/reflectance/{}/planes/{}/1", about.at("hash").get<std::string>(), layer));
    ASSERT_EQ(planes.body.size(), 140U);
    bytes += planes.body;
  }
  const Image<float> truth = relight::relit(*model_, light);
  for (int pixel = 0; pixel < 35; ++pixel) {
    for (int c = 0; c < 3; ++c) {
      double value = apply(map, c, pixel, bytes);
      if (!about.at("tint").is_null()) {
        value *= apply(about.at("tint"), c, pixel, bytes);
      }
      EXPECT_NEAR(value, truth(pixel / 7, pixel % 7, c), 1e-5);
    }
  }
}

TEST_P(ReflectanceSite, RefusesOthers) {
  const std::string hash = Json::parse(get("/v1/reflectance").body).at("hash");
  for (const std::string& path :
       {std::string("/v1/reflectance/light"), std::string("/v1/reflectance/light?x=1&y=2"),
        std::string("/v1/reflectance/light?x=0&y=0&z=0"),
        std::string("/v1/reflectance/light?x=nan&y=0&z=1"),
        std::string("/v1/reflectance/light?x=inf&y=0&z=1"),
        std::string("/v1/reflectance/light?x=1e300&y=0&z=1"),
        std::string("/v1/reflectance/none/planes/0/1"),
        "/v1/reflectance/" + hash + "/planes/-1/1", "/v1/reflectance/" + hash + "/planes/99/1",
        "/v1/reflectance/" + hash + "/planes/0/0", "/v1/reflectance/" + hash + "/planes/0/65",
        "/v1/reflectance/" + hash + "/planes/1073741824/1",
        "/v1/reflectance/" + hash + "/planes/0x/1"}) {
    SCOPED_TRACE(path);
    const http::RawResponse response = get(path);
    EXPECT_EQ(response.status, 400) << response.body;
    EXPECT_FALSE(Json::parse(response.body).at("error").at("cure").get<std::string>().empty());
  }
}

INSTANTIATE_TEST_SUITE_P(Colours, ReflectanceSite,
                         ::testing::Values(relight::ReflectanceColour::rgb,
                                           relight::ReflectanceColour::lrgb));

TEST(FourPlanes, ShrunkAreMeansAndTheLastLayerEndsInZeros) {
  relight::ReflectanceModel model = *small_model(relight::ReflectanceColour::lrgb);  // 9 planes
  const std::string two = four_planes(model, 0, 2);
  ASSERT_EQ(two.size(), 4U * 4U * 3U);
  int sum = 0;
  for (const auto& [y, x] : {std::pair{0, 0}, {0, 1}, {1, 0}, {1, 1}}) {
    sum += model.planes(y, x, 2);
  }
  EXPECT_EQ(static_cast<unsigned char>(two[2]), (sum + 2) / 4);
  // The corner's means are of what there is.
  EXPECT_EQ(static_cast<unsigned char>(two[4 * 11 + 1]), model.planes(4, 6, 1));
  const std::string last = four_planes(model, 2, 1);
  EXPECT_EQ(static_cast<unsigned char>(last[0]), model.planes(0, 0, 8));
  EXPECT_EQ(last[1], 0);
}

}  // namespace
}  // namespace haarlight::apps
