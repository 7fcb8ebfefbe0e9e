#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_light_array.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// Broken wires: real libmodbus against real sockets and pseudo-terminals that lie.

namespace haarlight {
namespace {

using namespace std::chrono_literals;

ControllerServerOptions tcp_options() {
  ControllerServerOptions options;
  options.controller = wide_config(64);
  return options;
}

ControllerServerOptions rtu_options() {
  ControllerServerOptions options;
  options.controller = wide_config(64);
  options.has_tcp = false;
  options.has_rtu = true;
  return options;
}

// Short waits make the tests short; the quiet time stays longer than any reply delay used.
constexpr ModbusTiming kTiming = {.turnaround = 200ms, .connect = 500ms, .quiet = 450ms};

std::unique_ptr<RegisterLightArray> array_on(const ControllerServer& server, bool is_rtu) {
  auto bus = is_rtu
                 ? make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1, kTiming)
                 : make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 1, kTiming);
  return std::make_unique<RegisterLightArray>(std::move(bus),
                                              RegisterLightArrayOptions{.n_elements = 64});
}

std::vector<ElementLevel> one_light(int k) { return {{k, 65535}}; }

/// Calls until it succeeds; the number of faults before, or -1 after 5 s.
template <class Call>
int faults_until_done(Call call) {
  const auto deadline = std::chrono::steady_clock::now() + 5s;
  int n = 0;
  while (!call()) {
    ++n;
    if (std::chrono::steady_clock::now() > deadline) {
      return -1;
    }
    std::this_thread::sleep_for(5ms);
  }
  return n;
}

struct FaultCase {
  const char* name;
  bool is_rtu;
  WireFaultRule rule;
  Errc expected;
};

void PrintTo(const FaultCase& c, std::ostream* out) { *out << c.name; }

class WireFaults : public testing::TestWithParam<FaultCase> {};

// Every fault hits the third request of a show: reported, and the next show is right.
TEST_P(WireFaults, AreReportedOnceAndHealed) {
  const FaultCase& c = GetParam();
  ControllerServer server(c.is_rtu ? rtu_options() : tcp_options());
  auto array = array_on(server, c.is_rtu);
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  server.inject(c.rule);
  const auto t0 = std::chrono::steady_clock::now();
  const auto hit = array->show(one_light(2), 2);
  const auto took = std::chrono::steady_clock::now() - t0;
  ASSERT_FALSE(hit);
  EXPECT_EQ(hit.error().code, c.expected) << hit.error().what;
  EXPECT_LT(took, 1s);  // suspended within a second
  const int n_faults =
      faults_until_done([&] { return array->show(one_light(3), 3).has_value(); });
  EXPECT_GE(n_faults, 0);
  EXPECT_LE(n_faults, 40);
  const LightTransition lit = server.lit();
  EXPECT_EQ(lit.tag, 3U);
  ASSERT_EQ(lit.pattern->size(), 1U);
  EXPECT_EQ(lit.level(3), 65535);
}

constexpr FaultCase kFaultCases[] = {
    {"TcpDropRequest", false, {.kind = WireFault::drop_request, .skip = 2}, Errc::timeout},
    {"TcpDropReply", false, {.kind = WireFault::drop_reply, .skip = 2}, Errc::timeout},
    {"TcpLate",
     false,
     {.kind = WireFault::delay_reply, .skip = 2, .delay = 350ms},
     Errc::timeout},
    {"TcpHalf", false, {.kind = WireFault::half_reply, .skip = 2}, Errc::timeout},
    {"TcpWrongTransaction",
     false,
     {.kind = WireFault::wrong_transaction, .skip = 2},
     Errc::protocol},
    {"TcpGarbage", false, {.kind = WireFault::garbage_reply, .skip = 2}, Errc::protocol},
    {"TcpClose", false, {.kind = WireFault::close, .skip = 2}, Errc::device_gone},
    {"TcpBusy",
     false,
     {.kind = WireFault::exception, .skip = 2, .exception = registers::Exception::busy},
     Errc::device_busy},
    {"TcpIllegalFunction",
     false,
     {.kind = WireFault::exception,
      .skip = 2,
      .exception = registers::Exception::illegal_function},
     Errc::protocol},
    {"RtuDropRequest", true, {.kind = WireFault::drop_request, .skip = 2}, Errc::timeout},
    {"RtuDropReply", true, {.kind = WireFault::drop_reply, .skip = 2}, Errc::timeout},
    {"RtuLate",
     true,
     {.kind = WireFault::delay_reply, .skip = 2, .delay = 450ms},
     Errc::timeout},
    {"RtuHalf", true, {.kind = WireFault::half_reply, .skip = 2}, Errc::timeout},
    {"RtuWrongUnit", true, {.kind = WireFault::wrong_unit, .skip = 2}, Errc::protocol},
    {"RtuGarbage", true, {.kind = WireFault::garbage_reply, .skip = 2}, Errc::protocol},
    {"RtuBusy",
     true,
     {.kind = WireFault::exception, .skip = 2, .exception = registers::Exception::busy},
     Errc::device_busy},
};

INSTANTIATE_TEST_SUITE_P(Each, WireFaults, testing::ValuesIn(kFaultCases),
                         [](const auto& param_info) {
                           return std::string(param_info.param.name);
                         });

// The case that libmodbus gets wrong by itself: the answer to one read arrives after the
// timeout and would be taken for the next one's.
TEST(RtuDriver, LateAnswerIsNeverTakenForTheNextOne) {
  for (const auto delay : {250ms, 400ms, 550ms}) {
    SCOPED_TRACE(delay.count());
    ControllerServer server(rtu_options());
    auto bus = make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1, kTiming);
    ASSERT_TRUE(bus->open());
    const std::vector<std::uint16_t> levels = {111, 222};
    ASSERT_TRUE(bus->write_holding(registers::holding::kLevels, levels));
    server.inject({.kind = WireFault::delay_reply, .delay = delay});
    std::array<std::uint16_t, 1> word{};
    const auto late = bus->read_holding(registers::holding::kLevels, word);
    ASSERT_FALSE(late);
    EXPECT_EQ(late.error().code, Errc::timeout);
    // Until the line has settled no request passes.
    const auto refused = bus->read_holding(registers::holding::kLevels + 1, word);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, Errc::protocol);
    ASSERT_TRUE(bus->settle());
    const auto answer = bus->read_holding(registers::holding::kLevels + 1, word);
    ASSERT_TRUE(answer) << answer.error().what;
    EXPECT_EQ(word[0], 222);
  }
}

TEST(RtuDriver, UnaskedBytesBeforeARequestAreNotTakenForItsAnswer) {
  ControllerServer server(rtu_options());
  auto bus = make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1,
                                 {.turnaround = 50ms, .connect = 500ms, .quiet = 300ms});
  ASSERT_TRUE(bus->open());
  std::array<std::uint16_t, 1> word{};
  server.inject({.kind = WireFault::delay_reply, .delay = 120ms});
  ASSERT_FALSE(bus->read_holding(registers::holding::kLevels, word));
  ASSERT_TRUE(bus->settle());
  ASSERT_TRUE(bus->read_holding(registers::holding::kLevels, word));
}

TEST(RtuDriver, CableOutIsGoneAndBackUnderItsName) {
  ControllerServer server(rtu_options());
  auto array = array_on(server, true);
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  server.unplug_rtu();
  const auto t0 = std::chrono::steady_clock::now();
  const auto gone = array->show(one_light(2), 2);
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().code, Errc::device_gone) << gone.error().what;
  EXPECT_LT(std::chrono::steady_clock::now() - t0, 1s);
  ASSERT_FALSE(array->all_off());
  server.replug_rtu();
  EXPECT_GE(faults_until_done([&] { return array->show(one_light(3), 3).has_value(); }), 0);
  EXPECT_EQ(server.lit().tag, 3U);
}

TEST(RtuDriver, BabblingLineIsGivenUp) {
  ControllerServer server(rtu_options());
  auto array = array_on(server, true);
  ASSERT_TRUE(array->connect());
  server.inject({.kind = WireFault::garbage_reply, .count = -1});
  ASSERT_FALSE(array->show(one_light(1), 1));
  ASSERT_FALSE(array->all_off());
  EXPECT_TRUE(server.lit().pattern->empty());
  server.clear_faults();
  EXPECT_GE(faults_until_done([&] { return array->show(one_light(2), 2).has_value(); }), 0);
}

TEST(TcpDriver, RestartInMidRunIsResumed) {
  ControllerServer server(tcp_options());
  auto array = array_on(server, false);
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  server.restart(200ms);
  EXPECT_TRUE(server.lit().pattern->empty());
  const int n_faults =
      faults_until_done([&] { return array->show(one_light(2), 2).has_value(); });
  EXPECT_GE(n_faults, 1);
  EXPECT_EQ(server.lit().tag, 2U);
  EXPECT_EQ(array->status()->boot_id, 2U);
}

TEST(TcpDriver, NobodyListeningIsGone) {
  std::string address;
  {
    ControllerServer server(tcp_options());
    address = server.tcp_address();
  }
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(address), 1, kTiming);
  const auto opened = bus->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::device_gone);
}

TEST(TcpDriver, WrongUnitIsGone) {
  ControllerServer server(tcp_options());
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 9, kTiming);
  RegisterLightArray array(std::move(bus), {.n_elements = 64});
  const auto identity = array.connect();
  ASSERT_FALSE(identity);
  EXPECT_EQ(identity.error().code, Errc::device_gone);
}

// A server that died without a word: nothing comes back, the connection stays open.
TEST(TcpDriver, HalfOpenConnectionIsGivenUpAndMadeAnew) {
  ControllerServer server(tcp_options());
  auto array = array_on(server, false);
  ASSERT_TRUE(array->connect());
  server.inject({.kind = WireFault::drop_request, .count = 3});
  for (int i = 0; i < 3; ++i) {
    const auto t0 = std::chrono::steady_clock::now();
    const auto off = array->all_off();
    ASSERT_FALSE(off);
    EXPECT_LT(std::chrono::steady_clock::now() - t0, 1s);
  }
  ASSERT_TRUE(array->all_off());
}

TEST(TcpDriver, FiveHundredShowsWithScatteredFaultsAreEachRightOrReported) {
  ControllerServer server(tcp_options());
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 1,
                                 {.turnaround = 40ms, .connect = 500ms, .quiet = 100ms});
  RegisterLightArray array(std::move(bus), {.n_elements = 64});
  ASSERT_TRUE(array.connect());
  constexpr std::array kKinds = {WireFault::drop_request, WireFault::drop_reply,
                                 WireFault::delay_reply,  WireFault::wrong_transaction,
                                 WireFault::close,        WireFault::half_reply};
  for (int i = 0; i < 18; ++i) {
    server.inject({.kind = kKinds[static_cast<std::size_t>(i) % kKinds.size()],
                   .skip = 61 * (i + 1),
                   .delay = 60ms});
  }
  int n_shown = 0;
  int n_faults = 0;
  for (std::uint32_t tag = 1; n_shown < 500; ++tag) {
    const int k = static_cast<int>(tag % 64);
    if (array.show(one_light(k), tag)) {
      ++n_shown;
      const LightTransition lit = server.lit();
      ASSERT_EQ(lit.tag, tag);
      ASSERT_EQ(lit.pattern->size(), 1U);
      ASSERT_EQ(lit.level(k), 65535);
    } else {
      ++n_faults;
      ASSERT_LT(n_faults, 20'000);
    }
  }
  EXPECT_GT(n_faults, 0);
}

}  // namespace
}  // namespace haarlight
