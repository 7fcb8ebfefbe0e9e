// SPDX-License-Identifier: Apache-2.0
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_light_array.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// The real drivers over libmodbus against the simulated controller on real sockets and
/// pseudo-terminals.

namespace haarlight::firmware_iface {
namespace {

using namespace std::chrono_literals;

enum class Wire { tcp, rtu };

sim::ControllerServerOptions options_for(Wire wire, int n) {
  sim::ControllerServerOptions options;
  options.controller = wide_config(n);
  options.has_tcp = wire == Wire::tcp;
  options.has_rtu = wire == Wire::rtu;
  return options;
}

ControllerSpec spec_for(Wire wire, const sim::ControllerServer& server) {
  ControllerSpec spec;
  spec.kind = wire == Wire::tcp ? ControllerKind::modbus_tcp : ControllerKind::modbus_rtu;
  spec.address = wire == Wire::tcp ? server.tcp_address() : server.rtu_address();
  return spec;
}

/// As make_light_array() makes it, for a machine so loaded that its answers come late.
std::unique_ptr<RegisterLightArray> patient_array(
    Wire wire, const sim::ControllerServer& server, int n,
    std::chrono::milliseconds lease = std::chrono::seconds(60)) {
  constexpr ModbusTiming kTiming = {.turnaround = 10s, .connect = 10s};
  auto bus = wire == Wire::rtu
                 ? make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1, kTiming)
                 : make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 1, kTiming);
  return std::make_unique<RegisterLightArray>(
      std::move(bus), RegisterLightArrayOptions{.n_elements = n, .lease = lease});
}

class DriverOverAWire : public testing::TestWithParam<Wire> {};

TEST_P(DriverOverAWire, ShowsAndReadsBack) {
  sim::ControllerServer server(options_for(GetParam(), 1024));
  auto array = make_light_array(spec_for(GetParam(), server), 1024);
  ASSERT_TRUE(array) << array.error().what;
  const auto identity = (*array)->connect();
  ASSERT_TRUE(identity) << identity.error().what;
  EXPECT_EQ(identity->n_elements, 1024);
  EXPECT_EQ(identity->boot_id, server.boot_id());
  std::uint32_t tag = 0;
  for (const int k : {0, 1, 31, 1023, 512}) {
    const std::vector<ElementLevel> pattern = {{k, 65535}};
    const auto receipt = (*array)->show(pattern, ++tag);
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tag);
    const LightTransition lit = server.lit();
    EXPECT_EQ(lit.tag, tag);
    ASSERT_EQ(lit.pattern->size(), 1U);
    EXPECT_EQ(lit.level(k), 65535);
    // The change lies between command and acknowledgement: what the timestamp rule builds on.
    EXPECT_GE(lit.t_ns, receipt->t_command_ns);
    EXPECT_LE(lit.t_ns, receipt->t_ack_ns);
  }
  const auto off = (*array)->all_off();
  ASSERT_TRUE(off) << off.error().what;
  EXPECT_TRUE(server.lit().pattern->empty());
  const auto status = (*array)->status();
  ASSERT_TRUE(status);
  EXPECT_TRUE(status->is_dark);
}

TEST_P(DriverOverAWire, WritesAWholeBankOf1024Levels) {
  sim::ControllerServer server(options_for(GetParam(), 1024));
  auto array = patient_array(GetParam(), server, 1024);
  ASSERT_TRUE(array->connect());
  std::vector<ElementLevel> pattern;
  pattern.reserve(1024);
  for (int k = 0; k < 1024; ++k) {
    pattern.push_back({k, static_cast<std::uint16_t>(1 + 63 * k)});
  }
  const auto before = server.n_requests();
  const auto t0 = std::chrono::steady_clock::now();
  const auto receipt = array->show(pattern, 7);
  const std::chrono::duration<double, std::milli> ms = std::chrono::steady_clock::now() - t0;
  ASSERT_TRUE(receipt) << receipt.error().what;
  // 9 of levels, 1 of on bits, tag and latch, status.
  EXPECT_EQ(server.n_requests() - before, 12U);
  const LightTransition lit = server.lit();
  ASSERT_EQ(lit.pattern->size(), 1024U);
  for (const ElementLevel& e : pattern) {
    ASSERT_EQ(lit.level(e.element), e.level);
  }
  RecordProperty("milliseconds", std::to_string(ms.count()));
  if (GetParam() == Wire::rtu) {
    // 2 x 1024 bytes of levels alone take 195 ms at 115200 baud, 11 bits per byte.
    EXPECT_GT(ms.count(), 195.0);
  }
}

TEST_P(DriverOverAWire, UploadsAndStepsATable) {
  sim::ControllerServer server(options_for(GetParam(), 64));
  auto array = patient_array(GetParam(), server, 64);
  ASSERT_TRUE(array->connect());
  std::vector<std::vector<ElementLevel>> patterns;
  std::vector<std::uint32_t> tags;
  patterns.reserve(16);
  tags.reserve(16);
  for (int k = 0; k < 16; ++k) {
    patterns.push_back({{k, 65535}});
    tags.push_back(static_cast<std::uint32_t>(100 + k));
  }
  const auto uploaded = array->upload_table(patterns, tags);
  ASSERT_TRUE(uploaded) << uploaded.error().what;
  for (int k = 0; k < 8; ++k) {
    const auto receipt = array->step_table();
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tags[static_cast<std::size_t>(k)]);
  }
  ASSERT_TRUE(array->arm_table(registers::StepSource::strobe));
  server.strobe();
  server.strobe();
  EXPECT_EQ(server.lit().tag, 101U);
  EXPECT_EQ(array->status()->step_counter, 2U);
}

// The acting moment is the lease's, not the observer's: exact however late this machine is.
TEST_P(DriverOverAWire, SilenceOfTheHostTurnsTheLightOffWithinTheLease) {
  sim::ControllerServer server(options_for(GetParam(), 16));
  auto array = patient_array(GetParam(), server, 16, 150ms);
  ASSERT_TRUE(array->connect());
  double before_s = 0.0;
  // Again where the light is off before the driver has read back that it is on.
  bool is_shown = false;
  for (int i = 0; i < 100 && !is_shown; ++i) {
    ASSERT_TRUE(array->all_off());
    before_s = server.total_on_seconds(3);
    is_shown = array->show(std::vector<ElementLevel>{{3, 65535}}, 1).has_value();
  }
  ASSERT_TRUE(is_shown);
  while (!server.lit().pattern->empty()) {
    std::this_thread::sleep_for(5ms);
  }
  EXPECT_NEAR(server.total_on_seconds(3) - before_s, 0.150, 1e-4);
}

INSTANTIATE_TEST_SUITE_P(Wires, DriverOverAWire, testing::Values(Wire::tcp, Wire::rtu),
                         [](const auto& param_info) {
                           return param_info.param == Wire::tcp ? "Tcp" : "Rtu";
                         });

TEST(ControllerServer, OneControllerAnswersOnBothWires) {
  sim::ControllerServerOptions options = options_for(Wire::tcp, 16);
  options.has_rtu = true;
  sim::ControllerServer server(options);
  auto by_tcp = make_light_array(spec_for(Wire::tcp, server), 16);
  auto by_rtu = make_light_array(spec_for(Wire::rtu, server), 16);
  ASSERT_TRUE(by_tcp);
  ASSERT_TRUE(by_rtu);
  ASSERT_TRUE((*by_tcp)->connect());
  const std::vector<ElementLevel> pattern = {{3, 65535}};
  ASSERT_TRUE((*by_tcp)->show(pattern, 1));
  // The second path to darkness.
  ASSERT_TRUE((*by_rtu)->connect());
  ASSERT_TRUE((*by_rtu)->all_off());
  EXPECT_TRUE(server.lit().pattern->empty());
  ASSERT_TRUE((*by_tcp)->show(pattern, 2));
  EXPECT_EQ(server.lit().tag, 2U);
}

TEST(ControllerServer, TakenPortIsSaid) {
  sim::ControllerServer first(options_for(Wire::tcp, 16));
  sim::ControllerServerOptions options = options_for(Wire::tcp, 16);
  const std::string address = first.tcp_address();
  options.tcp_port = std::stoi(address.substr(address.rfind(':') + 1));
  EXPECT_THROW(sim::ControllerServer second(options), Error);
}

TEST(ControllerServer, TransitionsFromManyThreadsAgree) {
  sim::ControllerServer server(options_for(Wire::tcp, 64));
  auto array = make_light_array(spec_for(Wire::tcp, server), 64);
  ASSERT_TRUE(array);
  ASSERT_TRUE((*array)->connect());
  const std::int64_t t0 = monotonic_now_ns();
  std::atomic<int> n_bad{0};
  {
    std::vector<std::jthread> readers;
    readers.reserve(3);
    for (int i = 0; i < 3; ++i) {
      readers.emplace_back([&](const std::stop_token& stop) {
        while (!stop.stop_requested()) {
          const LightHistory h = server.transitions(t0, monotonic_now_ns());
          for (std::size_t s = 1; s < h.states.size(); ++s) {
            // Tag n lights element n and nothing else.
            const LightTransition& state = h.states[s];
            if (state.tag != 0 &&
                (state.pattern->size() != 1 || state.level(static_cast<int>(state.tag)) == 0)) {
              ++n_bad;
            }
          }
          std::this_thread::sleep_for(1ms);
        }
      });
    }
    for (int k = 1; k < 64; ++k) {
      const std::vector<ElementLevel> pattern = {{k, 65535}};
      ASSERT_TRUE((*array)->show(pattern, static_cast<std::uint32_t>(k)));
    }
  }
  EXPECT_EQ(n_bad.load(), 0);
  const LightHistory h = server.transitions(t0, monotonic_now_ns());
  EXPECT_GE(h.states.size(), 64U);
}

TEST(Addresses, AreUnderstood) {
  EXPECT_EQ(parse_tcp_address("127.0.0.1:1502")->service, "1502");
  EXPECT_EQ(parse_tcp_address("[::1]:502")->host, "::1");
  for (const char* bad : {"", ":502", "host", "host:", "host:0", "host:65536", "host:12x"}) {
    EXPECT_FALSE(parse_tcp_address(bad)) << bad;
  }
  const auto by_path = parse_serial_address("/dev/serial/by-path/pci-0:1.0-port0:19200");
  ASSERT_TRUE(by_path);
  EXPECT_EQ(by_path->device, "/dev/serial/by-path/pci-0:1.0-port0");
  EXPECT_EQ(by_path->baud, 19200);
  EXPECT_EQ(by_path->parity, Parity::even);
  const auto mode = parse_serial_address("/dev/ttyUSB0:115200:8N2");
  ASSERT_TRUE(mode);
  EXPECT_EQ(mode->baud, 115200);
  EXPECT_EQ(mode->parity, Parity::none);
  EXPECT_EQ(mode->stop_bits, 2);
  for (const char* bad :
       {"", "/dev/ttyS0", ":9600", "/dev/ttyS0:x", "/dev/ttyS0:8N1", "/dev/ttyS0:99999999"}) {
    EXPECT_FALSE(parse_serial_address(bad)) << bad;
  }
}

TEST(Registry, UsbControllerThatIsNotThereIsGoneOrWithoutUsb) {
  ControllerSpec spec;
  spec.kind = ControllerKind::usb;
  spec.address = "nobody has this serial number";
  const auto array = make_light_array(spec, 16);
  ASSERT_TRUE(array) << array.error().what;
  const auto identity = (*array)->connect();
  ASSERT_FALSE(identity);
  EXPECT_THAT(identity.error().code,
              testing::AnyOf(Errc::device_gone, Errc::device_busy, Errc::unsupported));
}

TEST(Registry, BadSpecsAreRefused) {
  ControllerSpec spec;
  spec.address = "127.0.0.1:1502";
  EXPECT_TRUE(make_light_array(spec, 16));
  EXPECT_FALSE(make_light_array(spec, 0));
  EXPECT_FALSE(make_light_array(spec, 30000));
  spec.lease = 1ms;
  EXPECT_FALSE(make_light_array(spec, 16));
  spec.lease = 2000ms;
  spec.profile = "other";
  EXPECT_FALSE(make_light_array(spec, 16));
  spec.profile = "haarlight";
  spec.address = "nowhere";
  EXPECT_FALSE(make_light_array(spec, 16));
}

}  // namespace
}  // namespace haarlight::firmware_iface
