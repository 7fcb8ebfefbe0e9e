// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/light_file.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/session/export.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

using testing::HasSubstr;

template <class Parse>
std::string refusal(Parse parse) {
  try {
    parse();
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty()) << error.what();
    return error.where() + ": " + error.problem();
  }
  return "accepted";
}

TEST(Lp, ReadsNamesWithSpacesCommentsBlankLinesAndCrlf) {
  const LightList list = parse_lp(
      "\xef\xbb\xbf# a comment\r\n\r\n3\r\nmy picture 1.jpg 0 0 1\r\n"
      "  \"b c.png\"\t0.6 -0.0 +0.8  \r\n\r\n# more\r\nc.png 1e0 0.0 0\r\n",
      "a.lp");
  ASSERT_EQ(list.lights.size(), 3U);
  EXPECT_EQ(list.lights[0].name, "my picture 1.jpg");
  EXPECT_EQ(list.lights[1].name, "b c.png");
  EXPECT_DOUBLE_EQ(list.lights[1].coordinates.z(), 0.8);
  EXPECT_FALSE(list.lights[0].is_position);
}

TEST(Lp, ScalesDirectionsToUnitLengthAndKeepsPositions) {
  EXPECT_DOUBLE_EQ(parse_lp("1\na 0 0 1.05\n", "a.lp").lights[0].coordinates.z(), 1.0);
  const LightList positions = parse_lp("1\na 10 0 500\n", "a.lp", LightCoordinates::positions);
  EXPECT_TRUE(positions.lights[0].is_position);
  EXPECT_DOUBLE_EQ(positions.lights[0].coordinates.z(), 500.0);
  EXPECT_DOUBLE_EQ(parse_lp("1\na 0 0 500\n", "a.lp", LightCoordinates::directions)
                       .lights[0]
                       .coordinates.z(),
                   1.0);
}

std::string list_of(int n, const std::string& most, const std::string& others, int n_others) {
  std::string text = std::to_string(n) + "\n";
  for (int k = 0; k < n; ++k) {
    text += "p" + std::to_string(k) + " " + (k < n - n_others ? most : others) + "\n";
  }
  return text;
}

// A published list has 25 of 54 directions of lengths from 0.8 to 0.9.
TEST(Lp, DirectionsOfAnotherLengthAreTold) {
  const std::string shorter = list_of(20, "0.6 0 0.8", "0.48 0 0.64", 9);
  const LightList list = parse_lp(shorter, "a.lp");
  ASSERT_EQ(list.lights.size(), 20U);
  EXPECT_NEAR(list.lights[19].coordinates.norm(), 1.0, 1e-15);
  EXPECT_THAT(list.disagreements, testing::ElementsAre(testing::AllOf(
                                      HasSubstr("a.lp:13: (0.48, 0, 0.64) has length 0.8"),
                                      HasSubstr("9 of 20"), HasSubstr("mistyped?"))));
  EXPECT_THAT(parse_lp(shorter, "a.lp", LightCoordinates::directions).disagreements,
              testing::IsEmpty());
  EXPECT_TRUE(parse_lp(shorter, "a.lp", LightCoordinates::positions).lights[0].is_position);
  // One in ten of any length is mistyped, more may be a list of positions.
  EXPECT_THAT(parse_lp(list_of(20, "0.6 0 0.8", "6 0 8", 2), "a.lp").disagreements,
              testing::ElementsAre(HasSubstr("a.lp:20: (6, 0, 8) has length 10, as 2 of 20")));
  EXPECT_THAT(refusal([] { (void)parse_lp(list_of(20, "0.6 0 0.8", "6 0 8", 3), "a.lp"); }),
              HasSubstr("a.lp:19: (6, 0, 8) has length 10"));
}

TEST(Lp, NamesFileLineAndHintOfWhatIsBroken) {
  const auto lp = [](const char* text) {
    return refusal([text] { (void)parse_lp(text, "a.lp"); });
  };
  EXPECT_THAT(lp(""), HasSubstr("a.lp: an empty list"));
  EXPECT_THAT(lp("# only\n\n"), HasSubstr("a.lp: an empty list"));
  EXPECT_THAT(lp("a.jpg 0 0 1\n"), HasSubstr("a.lp:1: "));
  EXPECT_THAT(parse_lp("2\na.jpg 0 0 1\n", "a.lp").disagreements,
              testing::ElementsAre("a.lp:1: 2 lights announced, 1 lines follow"));
  EXPECT_THAT(parse_lp("1\na.jpg 0 0 1\nb.jpg 0 0 1\n", "a.lp").disagreements,
              testing::ElementsAre(HasSubstr("1 lights announced, 2")));
  EXPECT_THAT(lp("2\n"), HasSubstr("no lights"));
  EXPECT_THAT(lp("1\na.jpg 0 zero 1\n"), HasSubstr("a.lp:2: \"zero\" is not a number"));
  EXPECT_THAT(lp("1\na.jpg 0 nan 1\n"), HasSubstr("a.lp:2: "));
  EXPECT_THAT(lp("1\na.jpg 0 1e999 1\n"), HasSubstr("a.lp:2: "));
  EXPECT_THAT(lp("1\na.jpg 0 0 0\n"), HasSubstr("a.lp:2: a zero direction"));
  EXPECT_THAT(lp("1\n\na.jpg 1 2 3\n"), HasSubstr("a.lp:3: (1, 2, 3) has length 3.74"));
  EXPECT_THAT(lp("2\na 0 0 1\na 0 1 0\n"),
              HasSubstr("a.lp:3: the picture \"a\" is listed twice"));
  EXPECT_THAT(lp("2\na 0 0 1\n0 1 0\n"), HasSubstr("a.lp:3: some lines name a picture"));
  EXPECT_THAT(lp("1.5\na 0 0 1\n"), HasSubstr("is not a number of lights"));
  EXPECT_THAT(lp("-1\na 0 0 1\n"), HasSubstr("is not a number of lights"));
  EXPECT_THAT(lp("1\n0 1\n"), HasSubstr("a.lp:2: "));
}

RC_GTEST_PROP(Lp, ReadsBackWhatItWrote, (std::uint8_t n, std::uint32_t seed)) {
  std::vector<Eigen::Vector3d> directions;
  std::vector<std::string> names;
  for (int i = 0; i <= n; ++i) {
    const double t = 0.1 * i + 1e-9 * seed;
    directions.push_back(
        Eigen::Vector3d(std::sin(t), std::cos(t) * 0.3, 1.0 + 0.5 * std::sin(3 * t))
            .normalized());
    names.push_back("picture " + std::to_string(i) + ".png");
  }
  const LightList list = parse_lp(format_lp(directions, names), "a.lp");
  RC_ASSERT(list.lights.size() == directions.size());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    RC_ASSERT(list.lights[i].name == names[i]);
    RC_ASSERT((list.lights[i].coordinates - directions[i]).norm() <=
              4e-16);  // renormalised: 2 ulp
  }
}

constexpr const char* kDirectional =
    R"({"label": "d", "imageWidth": 100, "domeDiameter": 0, "verticalOffset": 0,
        "lightConfiguration": "directional",
        "directions": [{"x": 0, "y": 0, "z": 2}, {"x": 0.6, "y": 0, "z": 0.8}],
        "positionsSphere": [], "positions3d": [],
        "ledAdjust": [{"r": 2, "g": 2, "b": 2}, {"r": 1, "g": 1, "b": 1.5}]})";

TEST(Dome, ReadsTheThreeConfigurations) {
  const LightList directional = parse_dome(kDirectional, "a.dome");
  ASSERT_EQ(directional.lights.size(), 2U);
  EXPECT_DOUBLE_EQ(directional.lights[0].coordinates.z(), 1.0);
  EXPECT_DOUBLE_EQ(directional.lights[0].relative_power, 0.5);
  EXPECT_THAT(directional.notes, testing::ElementsAre(HasSubstr("ledAdjust")));

  const LightList spherical = parse_dome(
      R"({"lightConfiguration": "spherical", "domeDiameter": 200, "verticalOffset": 10,
          "directions": [{"x": 0, "y": 3, "z": 0}]})",
      "a.dome");
  EXPECT_TRUE(spherical.lights[0].is_position);
  EXPECT_TRUE(spherical.lights[0].coordinates.isApprox(Eigen::Vector3d(0, 100, 10)));

  const LightList near = parse_dome(
      R"({"lightConfiguration": "lights3d", "directions": [{"x": 0, "y": 0, "z": 1}],
          "positions3d": [{"x": 1, "y": 2, "z": 300}]})",
      "a.dome");
  EXPECT_TRUE(near.lights[0].coordinates.isApprox(Eigen::Vector3d(1, 2, 300)));
}

TEST(Dome, NamesTheFieldOfWhatIsBroken) {
  const auto dome = [](const std::string& text) {
    return refusal([&text] { (void)parse_dome(text, "a.dome"); });
  };
  EXPECT_THAT(dome("{"), HasSubstr("a.dome: not JSON"));
  EXPECT_THAT(dome("{}"), HasSubstr("\"directions\" is missing"));
  EXPECT_THAT(dome(R"({"lightConfiguration": "cubic"})"), HasSubstr("lightConfiguration"));
  EXPECT_THAT(dome(R"({"directions": []})"), HasSubstr("no lights"));
  EXPECT_THAT(dome(R"({"directions": [{"x": 0, "y": 0}]})"), HasSubstr("directions[0]: \"z\""));
  EXPECT_THAT(dome(R"({"directions": [{"x": 0, "y": 0, "z": 0}]})"),
              HasSubstr("zero direction"));
  EXPECT_THAT(dome(R"({"directions": [{"x": "0", "y": 0, "z": 1}]})"), HasSubstr("[0].x"));
  EXPECT_THAT(dome(R"({"directions": [{"x": 0, "y": 0, "z": 1}], "ledAdjust": [
                       {"r": 1, "g": 1, "b": 1}, {"r": 1, "g": 1, "b": 1}]})"),
              HasSubstr("2 factors for 1 lights"));
  EXPECT_THAT(dome(R"({"directions": [{"x": 0, "y": 0, "z": 1}], "ledAdjust": [
                       {"r": 0, "g": 1, "b": 1}]})"),
              HasSubstr("ledAdjust[0].r"));
  EXPECT_THAT(dome(R"({"lightConfiguration": "lights3d"})"), HasSubstr("positions3d"));
}

TEST(LightJson, ALobeTravelsWithTheSession) {
  SessionInfo info = test::small_info(2);
  EXPECT_EQ(session_info_to_json(info).find("axis"), std::string::npos);
  info.lights[1].lobe = LightLobe{Eigen::Vector3d(0.1, -0.7, -2.3).normalized(), 1.37};
  const std::string json = session_info_to_json(info);
  const SessionInfo read = session_info_from_json(json, "session.json");
  EXPECT_FALSE(read.lights[0].lobe.has_value());
  EXPECT_EQ(read.lights[1].lobe, info.lights[1].lobe);
  // A session.json is a list of lights too.
  EXPECT_EQ(parse_light_json(json, "session.json").lights[1].lobe, info.lights[1].lobe);
  info.lights[0].is_position = false;
  info.lights[0].coordinates = Eigen::Vector3d::UnitZ();
  info.lights[0].lobe = info.lights[1].lobe;
  EXPECT_THAT(refusal([&info] {
                (void)session_info_from_json(session_info_to_json(info), "session.json");
              }),
              HasSubstr("lights[0].axis: a lobe needs the light's position"));
}

TEST(LightJson, ReadsOurOwnAndNamesWhatIsBroken) {
  const LightList list = parse_light_json(
      R"({"lights": [{"name": "a b.png", "position_mm": [1, 2, 3], "relative_power": 0.9}]})",
      "l.json");
  EXPECT_EQ(list.lights[0].name, "a b.png");
  EXPECT_TRUE(list.lights[0].is_position);
  EXPECT_FALSE(list.lights[0].lobe.has_value());
  const auto json = [](const char* text) {
    return refusal([text] { (void)parse_light_json(text, "l.json"); });
  };
  const LightList lobed = parse_light_json(
      R"({"lights": [{"position_mm": [1, 2, 3], "axis": [0, 0.6, -0.8], "lobe_mu": 2}]})",
      "l.json");
  ASSERT_TRUE(lobed.lights[0].lobe.has_value());
  EXPECT_EQ(lobed.lights[0].lobe->axis, Eigen::Vector3d(0, 0.6, -0.8));
  EXPECT_EQ(lobed.lights[0].lobe->mu, 2.0);
  EXPECT_THAT(json(R"({"lights": [{"position_mm": [1, 2, 3], "axis": [0, 0, -1]}]})"),
              HasSubstr("lobe_mu"));
  EXPECT_THAT(json(R"({"lights": [{"position_mm": [1, 2, 3], "lobe_mu": 1}]})"),
              HasSubstr("axis"));
  EXPECT_THAT(
      json(R"({"lights": [{"position_mm": [1, 2, 3], "axis": [0, 0, -2], "lobe_mu": 1}]})"),
      HasSubstr("length 2"));
  EXPECT_THAT(
      json(R"({"lights": [{"direction": [0, 0, 1], "axis": [0, 0, -1], "lobe_mu": 1}]})"),
      HasSubstr("position"));
  EXPECT_THAT(json(R"({"lights": []})"), HasSubstr("no lights"));
  EXPECT_THAT(json(R"({"lights": {}})"), HasSubstr("expected a list"));
  EXPECT_THAT(json(R"({"lights": [{"name": "a"}]})"), HasSubstr("lights[0]: \"direction\""));
  EXPECT_THAT(json(R"({"lights": [{"direction": [1, 2]}]})"), HasSubstr("2 numbers"));
  EXPECT_THAT(json(R"({"lights": [{"direction": [0, 0, 0]}]})"), HasSubstr("zero direction"));
  EXPECT_THAT(json(R"({"lights": [{"direction": [0, 0, 1]}, {"position_mm": [0, 0, 1]}]})"),
              HasSubstr("lights[1]"));
  EXPECT_THAT(json(R"({"lights": [{"direction": [0, 0, 1], "relative_power": -1}]})"),
              HasSubstr("relative_power"));
}

TEST(Dome, ReadsBackWhatItWrote) {
  const SessionInfo info = test::small_info(3);
  std::vector<SessionLight> lights = info.lights;
  lights[1].relative_power = 0.8;
  const LightList list = parse_dome(format_dome(lights, {"l", "n", 12.0}), "a.dome");
  ASSERT_EQ(list.lights.size(), 3U);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_TRUE(list.lights[k].coordinates.isApprox(lights[k].coordinates, 1e-15));
    EXPECT_NEAR(list.lights[k].relative_power, lights[k].relative_power, 1e-15);
  }
}

TEST(Export, NamesEachLightsPictureFromTheListsFolder) {
  test::TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", 3);
  const Session session = Session::open(folder.path() / "s");
  EXPECT_EQ(picture_of_each_light(session, folder.path() / "lists")[2],
            "../s/frames/000002_a0.tif");
  const std::string lp = export_lp(session, picture_of_each_light(session, folder.path()));
  const LightList list = parse_lp(lp, "x.lp");
  EXPECT_EQ(list.lights[1].name, "s/frames/000001_a0.tif");
  EXPECT_TRUE(
      list.lights[1].coordinates.isApprox(session.info().lights[1].coordinates.normalized()));
}

TEST(Export, RefusesOneOfSeveralRawFramesOfALight) {
  test::TemporaryFolder folder;
  SessionInfo info = test::small_info(2);
  info.shots.push_back(Shot{2, ShotKind::light, {{1, 65535}}, 16000.0});
  test::make_session(folder.path() / "s", info,
                     [](int shot) { return test::small_pixels(shot); });
  const Session session = Session::open(folder.path() / "s");
  const std::string told =
      refusal([&] { (void)picture_of_each_light(session, folder.path()); });
  EXPECT_THAT(told, HasSubstr("light 1 (top/0/1) has several frames"));
}

TEST(Export, DevelopedPicturesNeedNoLedAdjust) {
  test::TemporaryFolder folder;
  SessionInfo info = test::small_info(2);
  info.lights[1].relative_power = 0.5;
  test::make_session(folder.path() / "s", info,
                     [](int shot) { return test::small_pixels(shot); });
  const Session session = Session::open(folder.path() / "s");
  const auto power = [&](ExportedPictures pictures) {
    return parse_dome(export_dome(session, pictures), "x.dome").lights[1].relative_power;
  };
  EXPECT_DOUBLE_EQ(power(ExportedPictures::raw), 0.5);
  EXPECT_DOUBLE_EQ(power(ExportedPictures::developed), 1.0);
}

TEST(Export, SaysWhatOtherReadersOfLpDoNotTake) {
  EXPECT_EQ(find_lp_problem({"a.png", "b.png"}), "");
  EXPECT_THAT(find_lp_problem({"a.png", "my b.png"}), HasSubstr("a blank in its name"));
  EXPECT_THAT(find_lp_problem(std::vector<std::string>(1024, "a.png")),
              HasSubstr("Relight reads at most 1000"));
}

}  // namespace
}  // namespace haarlight::session
