// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <filesystem>
#include <fstream>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <modbus.h>
#include <sys/file.h>

#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_light_array.h"
#include "firmware_iface/serial_ports.h"
#include "haarlight/core/files.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"
#include "tests/firmware_iface/late_answer.h"
#include "tests/temporary_folder.h"

/// @file
/// Serial lines: names that stay, one owner, slow adapters, and late answers on a wire without
/// transaction numbers.

namespace haarlight::firmware_iface {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;
using ::testing::HasSubstr;

sim::ControllerServerOptions rtu_options() {
  sim::ControllerServerOptions options;
  options.controller = wide_config(64);
  options.has_tcp = false;
  options.has_rtu = true;
  return options;
}

/// A machine with an FTDI and a CP210x adapter.
void make_machine(const fs::path& root, int latency_ms) {
  fs::create_directories(root / "dev/serial/by-id");
  std::ofstream(root / "dev/ttyUSB0").put('\n');
  std::ofstream(root / "dev/ttyUSB1").put('\n');
  fs::create_symlink("../../ttyUSB0", root / "dev/serial/by-id/usb-FTDI_A1-if00-port0");
  fs::create_directories(root / "sys/bus/usb-serial/devices/ttyUSB0");
  std::ofstream(root / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer")
      << latency_ms << "\n";
  for (const auto& [tty, driver] :
       {std::pair("ttyUSB0", "ftdi_sio"), std::pair("ttyUSB1", "cp210x")}) {
    const fs::path device = root / "sys/class/tty" / tty / "device";
    fs::create_directories(device);
    fs::create_directories(root / "sys/bus/usb-serial/drivers" / driver);
    fs::create_symlink(root / "sys/bus/usb-serial/drivers" / driver, device / "driver");
  }
}

TEST(SerialPorts, AreListedByTheNameThatStays) {
  const testing::TemporaryFolder folder;
  make_machine(folder.path(), 16);
  const auto ports = list_serial_ports(folder.path());
  ASSERT_EQ(ports.size(), 2U);
  EXPECT_EQ(ports[0].by_id, "");
  EXPECT_EQ(ports[0].device, "/dev/ttyUSB1");
  EXPECT_EQ(ports[0].driver, "cp210x");
  EXPECT_FALSE(ports[0].latency_ms);
  EXPECT_EQ(ports[1].by_id, "/dev/serial/by-id/usb-FTDI_A1-if00-port0");
  EXPECT_EQ(ports[1].device, "/dev/ttyUSB0");
  EXPECT_EQ(ports[1].driver, "ftdi_sio");
  EXPECT_EQ(ports[1].latency_ms, 16);
}

TEST(SerialPorts, AdviceNamesTheLastingNameAndTheLatencyTimer) {
  const testing::TemporaryFolder folder;
  make_machine(folder.path(), 16);
  const auto bare = serial_advice("/dev/ttyUSB0", folder.path());
  ASSERT_EQ(bare.size(), 2U);
  EXPECT_THAT(bare[0], HasSubstr("/dev/serial/by-id/usb-FTDI_A1-if00-port0"));
  EXPECT_THAT(bare[1], HasSubstr("echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"));
  const auto lasting = serial_advice("/dev/serial/by-id/usb-FTDI_A1-if00-port0", folder.path());
  ASSERT_EQ(lasting.size(), 1U);
  EXPECT_THAT(lasting[0], HasSubstr("16 ms"));
}

TEST(SerialPorts, NothingIsAdvisedWhereNothingIsWrong) {
  const testing::TemporaryFolder folder;
  make_machine(folder.path(), 1);
  EXPECT_TRUE(serial_advice("/dev/serial/by-id/usb-FTDI_A1-if00-port0", folder.path()).empty());
  EXPECT_TRUE(serial_advice("/dev/ttyS0", folder.path()).empty());
  EXPECT_TRUE(serial_advice("/dev/pts/7", folder.path()).empty());
  EXPECT_TRUE(list_serial_ports(folder.path() / "empty").empty());
}

TEST(RtuLine, HasOneOwner) {
  sim::ControllerServer server(rtu_options());
  const auto address = *parse_serial_address(server.rtu_address());
  auto first = make_modbus_rtu_bus(address, 1);
  ASSERT_TRUE(first->open());
  // TIOCEXCL does not stop root, so the lock has to.
  const auto opened = make_modbus_rtu_bus(address, 1)->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::device_busy) << opened.error().what;
  first->close();
  EXPECT_TRUE(make_modbus_rtu_bus(address, 1)->open());
}

// ---- late answers ----

// Half the times of the study that found it: a time-out of 100 ms, answers 1.25 to 3.5 of
// them late.
constexpr ModbusTiming kTiming = {.turnaround = 100ms, .connect = 500ms, .quiet = 400ms};

class LateRtuAnswer : public ::testing::TestWithParam<int> {};

TEST_P(LateRtuAnswer, IsNeverTakenForTheNextOnes) {
  sim::ControllerServer server(rtu_options());
  auto bus = make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1, kTiming);
  testing::expect_late_answer_is_not_the_next(*bus, server,
                                              std::chrono::milliseconds(GetParam()));
}

INSTANTIATE_TEST_SUITE_P(ByMs, LateRtuAnswer,
                         ::testing::Values(125, 150, 195, 225, 250, 275, 350),
                         ::testing::PrintToStringParamName());

// The same device and the same delay with libmodbus's own recovery: the next read returns the
// last one's value, without an error. This is what the rule above is for; should libmodbus mend
// it, this test says so.
TEST(LateRtuAnswerControl, OfLibmodbusOwnRecoveryIsTakenForTheNextOnes) {
  sim::ControllerServer server(rtu_options());
  std::array<std::uint16_t, 1> word{};
  bool is_fooled = false;
  for (int attempt = 0; attempt < 3 && !is_fooled; ++attempt) {
    modbus_t* const m = modbus_new_rtu(server.rtu_path().c_str(), 115200, 'E', 8, 1);
    ASSERT_NE(m, nullptr);
    modbus_set_slave(m, 1);
    modbus_set_error_recovery(m, MODBUS_ERROR_RECOVERY_LINK);
    modbus_set_response_timeout(m, 0, 200'000);
    ASSERT_EQ(modbus_connect(m), 0);
    const std::array<std::uint16_t, 2> levels = {111, 222};
    ASSERT_EQ(modbus_write_registers(m, registers::holding::kLevels, 2, levels.data()), 2);
    server.inject({.kind = sim::WireFault::delay_reply, .delay = 500ms});
    EXPECT_EQ(modbus_read_registers(m, registers::holding::kLevels, 1, word.data()), -1);
    is_fooled =
        modbus_read_registers(m, registers::holding::kLevels + 1, 1, word.data()) == 1 &&
        word[0] == 111;
    modbus_close(m);
    modbus_free(m);
    std::this_thread::sleep_for(300ms);
  }
  EXPECT_TRUE(is_fooled);
}

}  // namespace
}  // namespace haarlight::firmware_iface
