// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_iface/fake_bus.h"
#include "firmware_iface/register_light_array.h"
#include "haarlight/core/rig/rig.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// The rig file's power becomes the controller's own limit at every connection.

namespace haarlight::firmware_iface {
namespace {

std::uint32_t limit_of(LightController& controller) {
  std::array<std::uint16_t, 2> words{};
  EXPECT_EQ(controller.read_holding(registers::holding::kPowerLimit, words, 0),
            registers::Exception::none);
  return join_words(words[0], words[1]);
}

TEST(PowerLimit, IsWrittenRoundedDownAndHolds) {
  LightController controller(wide_config(64), 1, 0);  // 320 W at most
  std::int64_t now = 0;
  RegisterLightArray array(std::make_unique<FakeBus>(controller, [&now] { return ++now; }),
                           {.n_elements = 64, .power_limit = Watts(12.58)},
                           [&now] { return now; });
  ASSERT_TRUE(array.connect());
  EXPECT_EQ(limit_of(controller), 125U);
  const std::vector<ElementLevel> two = {{0, 65535}, {1, 65535}};
  EXPECT_TRUE(array.show(two, 1));
  const std::vector<ElementLevel> three = {{0, 65535}, {1, 65535}, {2, 65535}};
  const auto refused = array.show(three, 2);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::refused);
  EXPECT_TRUE(controller.lit().pattern->empty());
  controller.reboot(2, ++now);  // forgets it; the next connection writes it again
  static_cast<void>(array.status());
  EXPECT_TRUE(array.show(two, 3));
  EXPECT_EQ(limit_of(controller), 125U);
}

TEST(PowerLimit, IsNeverAboveTheControllersOwn) {
  LightController controller(small_config(), 1, 0);  // 30 W at most
  std::int64_t now = 0;
  RegisterLightArray array(std::make_unique<FakeBus>(controller, [&now] { return ++now; }),
                           {.n_elements = 16, .power_limit = Watts(1000.0)},
                           [&now] { return now; });
  ASSERT_TRUE(array.connect());
  EXPECT_EQ(limit_of(controller), 300U);
}

TEST(PowerLimit, ComesFromTheFacesOfTheRigFile) {
  const Rig rig = read_rig("configs/rigs/small8.toml");
  EXPECT_DOUBLE_EQ(rig.controller.max_watts, 320.0);
  sim::ControllerServerOptions options;
  options.controller = wide_config(64);
  options.controller.max_power = Watts(5000.0);
  options.controller.groups = {{0, 64, Watts(5.0), Watts(5000.0)}};
  sim::ControllerServer server(options);
  ControllerSpec spec = rig.controller;
  spec.address = server.tcp_address();
  auto array = make_light_array(spec, 64);
  ASSERT_TRUE(array);
  ASSERT_TRUE((*array)->connect());
  const std::vector<std::uint8_t> read = {3, 0x00, registers::holding::kPowerLimit, 0, 2};
  const sim::WireExchange reply = server.exchange(read);
  ASSERT_EQ(reply.pdu.size(), 6U);
  EXPECT_EQ(join_words(static_cast<std::uint16_t>((reply.pdu[2] << 8U) | reply.pdu[3]),
                       static_cast<std::uint16_t>((reply.pdu[4] << 8U) | reply.pdu[5])),
            3200U);
}

}  // namespace
}  // namespace haarlight::firmware_iface
