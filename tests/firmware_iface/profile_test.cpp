// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/controller_profile.h"
#include "haarlight/firmware_iface/light_array.h"
#include "tests/firmware_iface/vendor_device.h"
#include "tests/temporary_folder.h"

/// @file
/// Other vendors' registers by profile, against devices that behave as their tables say.

namespace haarlight::firmware_iface {
namespace {

using ::testing::HasSubstr;

ControllerSpec spec_for(const VendorDevice& device, const std::string& profile) {
  ControllerSpec spec;
  spec.kind = ControllerKind::modbus_tcp;
  spec.address = device.address();
  spec.profile = profile;
  spec.rig_file = "configs/rigs/small8.toml";
  return spec;
}

std::unique_ptr<LightArray> array_for(const VendorDevice& device, const std::string& profile,
                                      int n) {
  auto array = make_light_array(spec_for(device, profile), n);
  if (!array) {
    throw std::runtime_error(array.error().what);
  }
  return std::move(*array);
}

std::uint16_t level_of(double drive) {
  return static_cast<std::uint16_t>(std::lround(drive * 65535.0));
}

TEST(Profile, ThoseThatComeWithUsAreReadAndCiteTheirSource) {
  int n = 0;
  for (const auto& entry : std::filesystem::directory_iterator("configs/profiles")) {
    const ControllerProfile profile = read_controller_profile(entry.path());
    EXPECT_THAT(profile.source, ::testing::StartsWith("https://")) << entry.path();
    EXPECT_GT(profile.channels, 0);
    EXPECT_GE(missing_promises(profile).size(), 5U);
    ++n;
  }
  EXPECT_GE(n, 2);
}

TEST(Profile, EveryProblemIsNamedWithItsLine) {
  const char* const text = R"(schema = 1
name = "x"
source = "y"
channels = 4
[channel]
write = 7
first = 65534
[[before]]
address = 5
value = 0
surplus = 1
)";
  try {
    static_cast<void>(parse_controller_profile(text, "p.toml"));
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("function 7 does not write"));
    EXPECT_THAT(error.what(), HasSubstr("beyond 65535"));
    EXPECT_THAT(error.what(), HasSubstr("[[before]] without [[latch]]"));
    EXPECT_THAT(error.what(), HasSubstr("surplus"));
    EXPECT_THAT(error.what(), HasSubstr("p.toml:6"));
  }
}

TEST(Profile, IsFoundByNameAndByPath) {
  EXPECT_FALSE(find_controller_profile("ledsc4", "configs/rigs/small8.toml").empty());
  EXPECT_FALSE(
      find_controller_profile("../profiles/ledsc4.toml", "configs/rigs/small8.toml").empty());
  EXPECT_TRUE(find_controller_profile("nobody", "configs/rigs/small8.toml").empty());
}

TEST(ProfileLightArray, ShowsLevelsOnALedsc4WholeByItsLatch) {
  Ledsc4 led;
  auto array = array_for(led.device, "ledsc4", 4);
  const auto identity = array->connect();
  ASSERT_TRUE(identity) << identity.error().what;
  EXPECT_EQ(identity->n_elements, 4);
  EXPECT_EQ(led.device.word(4), 0);    // no fading
  EXPECT_EQ(led.device.word(6), 255);  // full drive
  EXPECT_THAT(identity->missing, ::testing::Contains(HasSubstr("no lease")));
  const int faded_before = led.n_faded;
  const int shown_before = led.n_shown;
  const std::vector<ElementLevel> pattern = {{0, 65535}, {2, level_of(0.5)}};
  const auto receipt = array->show(pattern, 7);
  ASSERT_TRUE(receipt) << receipt.error().what;
  EXPECT_EQ(receipt->tag_echo, 7U);
  EXPECT_EQ(receipt->proof, LightProof::read_back);
  EXPECT_EQ(led.shown[0], 1.0);
  EXPECT_EQ(led.shown[1], 0.0);
  EXPECT_NEAR(led.shown[2], 0.5, 0.5 / 255);  // half a step
  EXPECT_EQ(led.n_shown - shown_before, 1);   // never half-written
  EXPECT_EQ(led.n_faded, faded_before);
  EXPECT_EQ(array->status()->tag, 7U);
  ASSERT_TRUE(array->all_off());
  EXPECT_EQ(led.shown[0], 0.0);
  EXPECT_TRUE(array->status()->is_dark);
}

TEST(ProfileLightArray, TurnsOffWhatBurnedWhenItConnects) {
  Ledsc4 led;
  led.device.set_word(1, 200);
  auto array = array_for(led.device, "ledsc4", 4);
  ASSERT_TRUE(array->connect());
  EXPECT_EQ(led.device.word(1), 0);
}

TEST(ProfileLightArray, WhatIsNotSetAsWrittenIsAFault) {
  Ledsc4 led;
  auto array = array_for(led.device, "ledsc4", 4);
  ASSERT_TRUE(array->connect());
  led.device.break_address(2);
  const std::vector<ElementLevel> pattern = {{2, 65535}};
  const auto shown = array->show(pattern, 1);
  ASSERT_FALSE(shown);
  EXPECT_EQ(shown.error().code, Errc::protocol);
  EXPECT_THAT(shown.error().what, HasSubstr("channel 2 reads 0, expected 255"));
}

TEST(ProfileLightArray, AChannelThatIsSetLateIsWaitedFor) {
  Ledsc4 led;
  auto array = array_for(led.device, "ledsc4", 4);
  ASSERT_TRUE(array->connect());
  led.device.break_address(2);  // acknowledged, and set only later
  const std::jthread gateway([&led] {
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    led.device.set_word(2, 255);
  });
  const std::vector<ElementLevel> pattern = {{2, 65535}};
  const auto shown = array->show(pattern, 1);
  ASSERT_TRUE(shown) << shown.error().what;
  EXPECT_LE(shown->t_command_ns, shown->t_ack_ns);
  EXPECT_LT(shown->t_ack_ns, shown->t_shown_ns);
}

TEST(ProfileLightArray, AnotherHandOrARestartIsNoticedAtTheNextRenewal) {
  Ledsc4 led;
  auto array = array_for(led.device, "ledsc4", 4);
  ASSERT_TRUE(array->connect());
  const std::vector<ElementLevel> pattern = {{1, 65535}};
  ASSERT_TRUE(array->show(pattern, 3));
  ASSERT_TRUE(array->renew_lease());
  const std::uint32_t start = array->status()->boot_id;
  led.device.set_word(1, 0);
  const auto renewed = array->renew_lease();
  ASSERT_FALSE(renewed);
  EXPECT_EQ(renewed.error().code, Errc::protocol);
  const auto status = array->status();
  ASSERT_TRUE(status) << status.error().what;
  EXPECT_NE(status->boot_id, start);
  EXPECT_TRUE(status->is_dark);
  EXPECT_EQ(status->tag, 0U);
}

TEST(ProfileLightArray, LostAnswersAreReportedAndHealed) {
  Ledsc4 led;
  auto array = array_for(led.device, "ledsc4", 4);
  ASSERT_TRUE(array->connect());
  const std::vector<ElementLevel> one = {{0, 65535}};
  const std::vector<ElementLevel> other = {{3, 65535}};
  ASSERT_TRUE(array->show(one, 1));
  for (int round = 0; round < 3; ++round) {
    led.device.drop(1);
    const auto lost = array->show(other, 2);
    ASSERT_FALSE(lost);
    EXPECT_EQ(lost.error().code, Errc::timeout) << lost.error().what;
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    Result<LatchReceipt> shown = array->show(one, 3);
    while (!shown && std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      shown = array->show(one, 3);
    }
    ASSERT_TRUE(shown) << shown.error().what;
    EXPECT_EQ(led.shown[0], 1.0);
    EXPECT_EQ(led.shown[3], 0.0);
  }
}

TEST(ProfileLightArray, SwitchesRelaysAndRefusesLevels) {
  VendorDevice relays({}, relay_coils());
  auto array = array_for(relays, "waveshare_relay_32", 32);
  ASSERT_TRUE(array->connect());
  const std::vector<ElementLevel> pattern = {{0, 65535}, {31, 65535}};
  const int before = relays.n_requests();
  ASSERT_TRUE(array->show(pattern, 1));
  EXPECT_EQ(relays.n_requests() - before, 3);  // two runs of coils, one read-back
  EXPECT_TRUE(relays.coil(0));
  EXPECT_TRUE(relays.coil(31));
  EXPECT_FALSE(relays.coil(15));
  const std::vector<ElementLevel> half = {{4, level_of(0.5)}};
  const auto refused = array->show(half, 2);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::refused);
  EXPECT_TRUE(relays.coil(0));  // nothing was sent
  array->disconnect();
  EXPECT_FALSE(relays.coil(0));
}

TEST(ProfileLightArray, HasNoTable) {
  VendorDevice relays({}, relay_coils());
  auto array = array_for(relays, "waveshare_relay_32", 32);
  ASSERT_TRUE(array->connect());
  EXPECT_EQ(array->step_table().error().code, Errc::unsupported);
  EXPECT_EQ(array->upload_table({}, {}).error().code, Errc::unsupported);
}

TEST(ProfileLightArray, AnotherDeviceBehindTheAddressIsRefused) {
  const testing::TemporaryFolder folder;
  {
    std::ofstream file(folder.path() / "mine.toml");
    file << "schema = 1\nname = \"mine\"\nsource = \"https://example.org\"\nchannels = 4\n"
            "[channel]\nwrite = 6\nfirst = 0\nfull = 255\n"
            "[[identity]]\naddress = 6\nvalue = 4711\n";
  }
  Ledsc4 led;
  ControllerSpec spec = spec_for(led.device, "mine.toml");
  spec.rig_file = folder.path() / "rig.toml";
  auto array = make_light_array(spec, 4);
  ASSERT_TRUE(array) << array.error().what;
  const auto identity = (*array)->connect();
  ASSERT_FALSE(identity);
  EXPECT_EQ(identity.error().code, Errc::unsupported);
  EXPECT_THAT(identity.error().what, HasSubstr("another device?"));
  led.device.set_word(6, 4711);
  EXPECT_TRUE((*array)->connect());  // and function 6, one register per request
  const std::vector<ElementLevel> pattern = {{0, 65535}, {1, 65535}};
  EXPECT_TRUE((*array)->show(pattern, 1));
  EXPECT_EQ(led.device.word(1), 255);
}

TEST(ProfileLightArray, UnknownNamesAndTooManyLightsAreRefusedBeforeAnythingOpens) {
  VendorDevice relays({}, relay_coils());
  EXPECT_EQ(make_light_array(spec_for(relays, "nobody"), 4).error().code, Errc::unsupported);
  const auto large = make_light_array(spec_for(relays, "waveshare_relay_32"), 64);
  ASSERT_FALSE(large);
  EXPECT_THAT(large.error().what, HasSubstr("32 channels"));
  ControllerSpec usb = spec_for(relays, "ledsc4");
  usb.kind = ControllerKind::usb;
  EXPECT_EQ(make_light_array(usb, 4).error().code, Errc::unsupported);
  EXPECT_EQ(relays.n_requests(), 0);
}

// Our own registers as a profile of levels and coils: two ways to one device agree.
TEST(ProfileLightArray, OurOwnMapFitsPartlyIntoAProfile) {
  const ControllerProfile profile = parse_controller_profile(
      "schema = 1\nname = \"own\"\nsource = \"https://example.org\"\nchannels = 1024\n"
      "[channel]\nwrite = 15\nfirst = 0\n[[latch]]\naddress = 4\nvalue = 1\nkept = false\n",
      "own.toml");
  EXPECT_FALSE(profile.has_levels());
  EXPECT_EQ(profile.channel.per_request, registers::kMaxCoilsWritten);
  EXPECT_FALSE(profile.latch.front().is_kept);
}

TEST(Profile, IsRequiredOfARigThatNamesOne) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  require_profile(rig);  // our own controller needs none
  rig.controller.profile = "no-such-profile";
  EXPECT_THROW(require_profile(rig), Error);
}

}  // namespace
}  // namespace haarlight::firmware_iface
