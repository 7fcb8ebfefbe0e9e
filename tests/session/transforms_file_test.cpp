// SPDX-License-Identifier: Apache-2.0
#include "session/transforms_file.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/json_value.h"
#include "haarlight/core/error.h"

namespace haarlight::session {
namespace {

using testing::HasSubstr;

LightList parse(const std::string& text,
                LightCoordinates coordinates = LightCoordinates::automatic) {
  return parse_transforms(JsonValue::parse(text, "t.json"), coordinates);
}

std::string refusal(const std::string& text,
                    LightCoordinates coordinates = LightCoordinates::automatic) {
  try {
    (void)parse(text, coordinates);
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty());
    return error.what();
  }
  return "";
}

constexpr const char* kAbove = "[[1,0,0,0],[0,1,0,0],[0,0,1,500],[0,0,0,1]]";

std::string frames(const std::string& inside, const std::string& head = R"("unit": "mm", )") {
  return "{" + head + "\"frames\": [" + inside + "]}";
}

std::string frame(const std::string& name, const std::string& position,
                  const std::string& matrix = kAbove) {
  return fmt::format(R"({{"file_path": "{}", "pl_pos": {}, "transform_matrix": {}}})", name,
                     position, matrix);
}

// A camera above that looks down, its picture's up along the world's -x: by hand, a light at
// the world's +x stands below the picture, one above it out of the picture.
TEST(Transforms, TurnsPositionsIntoThePicturesFrame) {
  const char* turned = "[[0,-1,0,0],[1,0,0,0],[0,0,1,500],[0,0,0,1]]";
  const LightList list = parse(
      frames(frame("a.png", "[30, 0, 0]", turned) + "," + frame("b.png", "[0, 0, 7]", turned)));
  ASSERT_EQ(list.lights.size(), 2U);
  EXPECT_TRUE(list.lights[0].is_position);
  EXPECT_TRUE(list.lights[0].coordinates.isApprox(Eigen::Vector3d(0, -30, 0)));
  EXPECT_TRUE(list.lights[1].coordinates.isApprox(Eigen::Vector3d(0, 0, 7)));
}

TEST(Transforms, ReadsBackWhatItWrote) {
  CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = 700.0;
  camera.fy = 701.0;
  camera.cx = 320.0;
  camera.cy = 240.0;
  const Eigen::Vector3d origin(5.0, -3.0, 20.0);
  camera.world_from_cam = look_at({300.0, -200.0, 600.0}, origin, {0.0, 0.0, 1.0});
  std::vector<SessionLight> lights(3);
  std::vector<std::string> names;
  for (int k = 0; k < 3; ++k) {
    SessionLight& light = lights[static_cast<std::size_t>(k)];
    light.is_position = true;
    light.coordinates = Eigen::Vector3d(100.0 * k, 40.0, 700.0 - 30.0 * k);
    names.push_back(fmt::format("olat/{}.exr", k));
  }
  const LightList list = parse(format_transforms(camera, origin, lights, names));
  ASSERT_EQ(list.lights.size(), 3U);
  // The picture's axes in the world: right, up, and out of the picture.
  Eigen::Matrix3d axes = camera.world_from_cam.linear();
  axes.col(1) *= -1.0;
  axes.col(2) *= -1.0;
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(list.lights[k].name, names[k]);
    EXPECT_DOUBLE_EQ(list.lights[k].relative_power, 1.0);
    // Lengths of 1000 mm in doubles: 1e-12 of them after two turns.
    EXPECT_LT((axes * list.lights[k].coordinates + origin - lights[k].coordinates).norm(),
              1e-9);
  }
}

TEST(Transforms, AsksForTheUnitWhereTheFileNamesNone) {
  const std::string text = frames(frame("a.png", "[0, 0, 2]"), "");
  EXPECT_THAT(refusal(text), HasSubstr("a unit that the file does not name"));
  EXPECT_DOUBLE_EQ(parse(text, LightCoordinates::positions).lights[0].coordinates.z(), 2.0);
  EXPECT_DOUBLE_EQ(parse(text, LightCoordinates::directions).lights[0].coordinates.z(), 1.0);
  EXPECT_FALSE(parse(text, LightCoordinates::directions).lights[0].is_position);
}

TEST(Transforms, TakesIntensitiesAndNamesWithoutEnding) {
  const LightList list =
      parse(frames(fmt::format(R"({{"file_path": "./train/r_0", "img_path": "train/r_0.png",
                       "pl_pos": [0, 0, 9], "pl_intensity": [1, 2, 3], "transform_matrix": {}}})",
                               kAbove)));
  EXPECT_EQ(list.lights[0].name, "train/r_0.png");
  EXPECT_DOUBLE_EQ(list.lights[0].relative_power, 2.0);
  EXPECT_THAT(list.notes, testing::ElementsAre(HasSubstr("pl_intensity")));
}

TEST(Transforms, NamesTheFieldThatIsWrong) {
  EXPECT_THAT(refusal(frames("")), HasSubstr("no frames"));
  EXPECT_THAT(refusal(R"({"unit": "mm", "frames": 3})"), HasSubstr("frames"));
  EXPECT_THAT(refusal(frames(R"({"file_path": "a.png"})")), HasSubstr("transform_matrix"));
  EXPECT_THAT(refusal(frames(frame("a", "[0, 0]"))), HasSubstr("pl_pos"));
  EXPECT_THAT(refusal(frames(frame("a", "[0, 0, 0]"))), HasSubstr("at the origin"));
  EXPECT_THAT(refusal(frames(frame("a", "[0, 0, 1e300]"))), HasSubstr("pl_pos"));
  EXPECT_THAT(refusal(frames(frame("a", "[0, 0, 1]", "[[1,0,0,0]]"))), HasSubstr("1 rows"));
  EXPECT_THAT(
      refusal(frames(frame("a", "[0, 0, 1]", "[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"))),
      HasSubstr("no rotation"));
  EXPECT_THAT(
      refusal(frames(frame("a", "[0, 0, 1]", "[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"))),
      HasSubstr("no rotation"));
  EXPECT_THAT(
      refusal(frames(frame("a", "[0, 0, 1]") + "," +
                     frame("b", "[0, 0, 2]", "[[1,0,0,9],[0,1,0,0],[0,0,1,500],[0,0,0,1]]"))),
      HasSubstr("frames[1]"));
}

}  // namespace
}  // namespace haarlight::session
