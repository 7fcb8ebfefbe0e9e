// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/rig.h"

#include <algorithm>
#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/absurd_numbers.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;

std::string small_rig_text() {
  return read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
}

std::string with(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string message_of(const std::string& text) {
  try {
    (void)parse_rig(text, "rig.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::bad_input);
    return error.what();
  }
  return "nothing was thrown";
}

TEST(Rig, ReadsThePapersCube) {
  const Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  ASSERT_EQ(rig.n_lights(), 1024);
  const LightElement first = light_element(rig, 0);
  EXPECT_EQ(first.centre, Eigen::Vector3d(-465.0, -465.0, 900.0));
  const LightElement light = light_element(rig, 32 * 3 + 20);  // row 3, column 20
  EXPECT_EQ(light.centre, Eigen::Vector3d((20 - 15.5) * 30.0, (3 - 15.5) * 30.0, 900.0));
  EXPECT_EQ(light.emits, Eigen::Vector3d(0.0, 0.0, -1.0));
  EXPECT_TRUE(rig.faces[0].is_haar_grid());
  EXPECT_EQ(rig.sync, SyncMode::free_run);
  EXPECT_EQ(rig.hash, content_hash(rig.text));
  EXPECT_EQ(light_elements(rig).size(), 1024U);
}

TEST(Rig, AProxysNameIsReadAndNeedsAToken) {
  const std::string hosts = "\nallowed_hosts = [\"rig.example\", \"lab-2.example:8443\"]";
  const std::string token = "\ntoken_file = \"token\"";
  const auto with_http = [](const std::string& more) {
    return with(small_rig_text(), "[http]", "[http]" + more);
  };
  const Rig rig = parse_rig(with_http(hosts + token), "rig.toml");
  EXPECT_THAT(rig.http.allowed_hosts,
              ::testing::ElementsAre("rig.example", "lab-2.example:8443"));
  EXPECT_THAT(message_of(with_http(hosts)), HasSubstr("needs a token"));
  for (const char* bad : {"https://rig.example", "Rig.example", "rig.example/", "",
                          "rig.example:", "rig.example:99999", "rig.example:0", "*"}) {
    EXPECT_THAT(
        message_of(with_http("\nallowed_hosts = [\"" + std::string(bad) + "\"]" + token)),
        HasSubstr("is no name of a host"))
        << bad;
  }
}

TEST(Rig, NumbersSeveralFacesInFileOrder) {
  std::string text = small_rig_text();
  const std::size_t face = text.find("[[face]]");
  const std::size_t plane = text.find("[[plane]]");
  std::string second = with(text.substr(face, plane - face), "\"top\"", "\"side\"");
  second = with(second, "rows = 8", "rows = 2");
  const Rig rig = parse_rig(text.insert(plane, second), "rig.toml");
  EXPECT_EQ(rig.n_lights(), 64 + 16);
  EXPECT_EQ(light_element(rig, 64).face, 1);
  EXPECT_EQ(light_element(rig, 64 + 9).row, 1);
  EXPECT_FALSE(rig.faces[1].is_haar_grid());
  EXPECT_THROW((void)light_element(rig, 80), ContractViolation);
}

struct BrokenRig {
  const char* from;
  const char* to;
  const char* expected;
};

TEST(Rig, NamesWhatIsWrong) {
  const BrokenRig cases[] = {
      {"u = [1.0, 0.0, 0.0]", "u = [2.0, 0.0, 0.0]", "u has length 2, not 1"},
      {"v = [0.0, 1.0, 0.0]", "v = [1.0, 0.0, 0.0]", "v is not at right angles to u"},
      {"emitter = [112.0, 112.0]", "emitter = [130.0, 112.0]", "not larger than the pitch"},
      {"rows = 8", "rows = 0", "rows = 0 is out of range"},
      {"rows = 8", "rows = 8.5", "not a whole number"},
      {"max_watts = 320.0", "max_watts = 1.0", "below the power of a single element"},
      {"d = 0.0", "d = 5.0", "the origin does not lie on the plane"},
      {"texel = 2.0", "texel = 0.001", "more than 10^8 texels"},
      {"shutter = \"global\"", "shutter = \"globl\"", "\"rolling\" | \"global\""},
      {"skew_us = 0.0", "skew_us = 5.0", "a global shutter has no skew"},
      {"size = [64, 56]", "size = [64, 0]", "not a frame size"},
      {"K = [[", "K = [[-", "K is not"},
      {"mode = \"free-run\"", "mode = \"fast\"", "mode = \"fast\" is not known"},
      {"address = \"127.0.0.1\"\nport", "address = \"0.0.0.0\"\nport", "needs a token"},
      {"lease_ms", "lese_ms", "did you mean lease_ms?"},
      {"schema = 1", "schema = 2", "schema = 2 is out of range"},
      {"[controller]", "[controler]", "[controller] is missing"},
      {"pitch = 120.0", "pitch = nan", "pitch = nan is out of range"},
      {"id = \"main\"", "id = 7", "id is not a text"},
      {"127.0.0.1:1503", "127.0.0.1:99999", "expected host:port, port 1 to 65535"},
      {"127.0.0.1:1503", "127.0.0.1:0", "expected host:port"},
      {"127.0.0.1:1503", "127.0.0.1:-5", "expected host:port"},
      {"127.0.0.1:1503", "127.0.0.1:1e3", "expected host:port"},
      {"127.0.0.1:1503", "127.0.0.1", "expected host:port"},
      {"127.0.0.1:1503", "", "expected host:port"},
      {"kind = \"modbus_tcp\"\naddress = \"127.0.0.1:1503\"",
       "kind = \"modbus_rtu\"\naddress = \"/dev/ttyUSB0:99999999\"", "300 to 4000000 baud"},
      {"kind = \"modbus_tcp\"\naddress = \"127.0.0.1:1503\"",
       "kind = \"modbus_rtu\"\naddress = \"/dev/ttyUSB0:115200:9N1\"", "expected /dev/"},
      {"port = 8", "port = 99999 # 8", "port = 99999 is out of range"},
      {"address = \"127.0.0.1\"\nport", "address = \"localhost\"\nport", "no IP address"},
      {"size = [64, 56]", "size = [65536, 65536]", "not a frame size"},
  };
  for (const BrokenRig& broken : cases) {
    const std::string message = message_of(with(small_rig_text(), broken.from, broken.to));
    EXPECT_THAT(message, HasSubstr(broken.expected));
    EXPECT_THAT(message, HasSubstr("rig.toml:"));
    EXPECT_THAT(message, HasSubstr("hint: "));
  }
}

TEST(Rig, RefusesASecondCameraAtItsLine) {
  std::string text = small_rig_text();
  const std::size_t camera = text.find("[[camera]]");
  const std::size_t controller = text.find("[controller]");
  ASSERT_LT(camera, controller);
  const std::string second =
      with(text.substr(camera, controller - camera), "id = \"main\"", "id = \"side\"");
  const std::string message = message_of(text.insert(controller, second));
  EXPECT_THAT(message, HasSubstr("a second camera: haarlight captures with one"));
  EXPECT_THAT(message, HasSubstr("hint: remove this [[camera]]"));
  const auto line =
      2 +
      std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(controller), '\n');
  EXPECT_THAT(message, HasSubstr("rig.toml:" + std::to_string(line) + ": a second"));
}

TEST(Rig, RefusesAbsurdNumbersWhereverTheyStand) {
  const auto parse = [](const std::string& text) { (void)parse_rig(text, "rig.toml"); };
  testing::expect_absurd_numbers_refused(small_rig_text(), parse);
  for (const char* name : {"cube32", "strobe60"}) {
    testing::expect_absurd_numbers_refused(
        read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/" + std::string(name) + ".toml"), parse);
  }
}

TEST(Rig, CountsLightsWithoutOverflow) {
  std::string text = small_rig_text();
  const std::size_t face = text.find("[[face]]");
  const std::string one = text.substr(face, text.find("[[plane]]") - face);
  std::string many;
  for (int i = 0; i < 33000; ++i) {  // 33000 * 65536 is 2^31 and more
    std::string next = one;
    next = with(next, "\"top\"", "\"f" + std::to_string(i) + "\"");
    next = with(with(next, "rows = 8", "rows = 256"), "cols = 8", "cols = 256");
    many += next.substr(0, next.find("\n\n") + 1);
  }
  EXPECT_THAT(message_of(with(text, one, many + "\n")), HasSubstr("lights, more than 24576"));
}

TEST(Rig, RefusesAnEndOfFrameTimestampWithoutAReadout) {
  std::string text = small_rig_text();
  const std::size_t at = text.find("read_us = ");
  text.replace(at, text.find('\n', at) - at, "read_us = 0.0");
  EXPECT_THAT(message_of(text), HasSubstr("a readout is never free"));
}

/// The small rig with a V4L2 camera of 12-bit Bayer samples, and more keys for it.
std::string v4l2_rig_text(const std::string& keys) {
  std::string text = with(small_rig_text(), "kind = \"remote\"", "kind = \"v4l2\"\n" + keys);
  text = with(text, "format = \"Y16 \"\n", "format = \"BG12\"\n");
  text = with(text, "bits = 14\n", "");
  return with(text, "bayer = \"none\"\n", "");
}

TEST(Rig, AV4l2FormatBringsItsBitsAndBayerPhase) {
  const Rig rig = parse_rig(v4l2_rig_text("serial = \"A1\"\nbuffers = 6\ngain_unit_db = 0.1\n"
                                          "controls = { gain = 12, power_line_frequency = "
                                          "\"Disabled\", focus_auto = false }\n"),
                            "rig.toml");
  const CameraSpec& camera = rig.cameras[0];
  EXPECT_EQ(camera.bits, 12);
  EXPECT_EQ(camera.bayer, BayerPattern::bggr);
  EXPECT_EQ(camera.v4l2.serial, "A1");
  EXPECT_EQ(camera.v4l2.n_buffers, 6);
  ASSERT_EQ(camera.v4l2.controls.size(), 3U);
  EXPECT_EQ(camera.v4l2.controls[0].name, "gain");
  EXPECT_EQ(camera.v4l2.controls[0].value, 12);
  EXPECT_EQ(camera.v4l2.controls[1].entry, "Disabled");
  EXPECT_EQ(camera.v4l2.controls[2].value, 0);
}

TEST(Rig, AV4l2FormatContradictedOrUnknownIsNamed) {
  EXPECT_THAT(message_of(v4l2_rig_text("bits = 10\n")), HasSubstr("leave bits out"));
  EXPECT_THAT(message_of(v4l2_rig_text("bayer = \"rggb\"\n")), HasSubstr("leave bayer out"));
  EXPECT_THAT(message_of(with(v4l2_rig_text(""), "\"BG12\"", "\"GRAY\"")),
              HasSubstr("did you mean \"GREY\""));
}

TEST(Rig, ARegionOfTheSensorMovesThePrincipalPoint) {
  const CameraModel whole = parse_rig(v4l2_rig_text(""), "rig.toml").cameras[0].model;
  const Rig rig = parse_rig(v4l2_rig_text("crop = [16, 8]\n"), "rig.toml");
  const CameraSpec& camera = rig.cameras[0];
  EXPECT_EQ(camera.v4l2.crop, (std::array<int, 2>{16, 8}));
  EXPECT_EQ(camera.model.cx, whole.cx - 16.0);
  EXPECT_EQ(camera.model.cy, whole.cy - 8.0);
  EXPECT_EQ(camera.model.fx, whole.fx);
  EXPECT_EQ(camera.model.width, camera.frame_width);
  EXPECT_THAT(message_of(v4l2_rig_text("crop = [15, 8]\n")), HasSubstr("even numbers"));
  EXPECT_THAT(message_of(v4l2_rig_text("crop = [0.5, 8]\n")), HasSubstr("[column, row]"));
  EXPECT_THAT(message_of(v4l2_rig_text("crop = [-2, 8]\n")), HasSubstr("[column, row]"));
  EXPECT_EQ(describe_camera(camera).find("from 16, 8") != std::string::npos, true);
}

TEST(Rig, ATriggerIsWholeOrRefused) {
  const std::string whole =
      "trigger = { off = { trigger_mode = 0 }, software = { trigger_source = \"Software\", "
      "trigger_mode = 1 }, fire = \"trigger_software\" }\n";
  const Rig rig = parse_rig(v4l2_rig_text(whole), "rig.toml");
  const V4l2Trigger& trigger = rig.cameras[0].v4l2.trigger;
  ASSERT_EQ(trigger.software.size(), 2U);
  EXPECT_EQ(trigger.software[0].entry, "Software");
  EXPECT_EQ(trigger.software[1].value, 1);
  EXPECT_EQ(trigger.off.size(), 1U);
  EXPECT_EQ(trigger.fire, "trigger_software");
  EXPECT_TRUE(trigger.line.empty());
  EXPECT_THAT(message_of(v4l2_rig_text("trigger = { fire = \"x\", off = { a = 0 } }\n")),
              HasSubstr("go together"));
  EXPECT_THAT(message_of(v4l2_rig_text("trigger = { line = { trigger_mode = 1 } }\n")),
              HasSubstr("off is missing"));
}

TEST(Rig, ASyncModeThatTriggersAV4l2CameraNeedsItsControls) {
  const auto in_mode = [](const std::string& mode, const std::string& keys) {
    return with(v4l2_rig_text(keys), "mode = \"free-run\"", "mode = \"" + mode + "\"");
  };
  EXPECT_THAT(message_of(in_mode("light-leads", "")), HasSubstr("no trigger.software"));
  EXPECT_THAT(message_of(in_mode("controller-leads", "")), HasSubstr("no trigger.line"));
  EXPECT_EQ(parse_rig(in_mode("controller-leads",
                              "trigger = { off = { a = 0 }, line = { a = 1 } }\n"),
                      "rig.toml")
                .sync,
            SyncMode::controller_leads);
}

TEST(Rig, AControlMayHave64Bits) {
  const Rig rig = parse_rig(
      v4l2_rig_text("controls = { pixel_rate = 9223372036854775807, low = -5000000000 }\n"),
      "rig.toml");
  EXPECT_EQ(rig.cameras[0].v4l2.controls[0].value, 9223372036854775807);
  EXPECT_EQ(rig.cameras[0].v4l2.controls[1].value, -5'000'000'000);
}

TEST(Rig, OnlyA16BitContainerMayHoldFewerBits) {
  const Rig rig =
      parse_rig(with(v4l2_rig_text("bits = 12\n"), "\"BG12\"", "\"Y16\""), "rig.toml");
  EXPECT_EQ(rig.cameras[0].bits, 12);
  EXPECT_EQ(rig.cameras[0].format, "Y16 ");
}

}  // namespace
}  // namespace haarlight
