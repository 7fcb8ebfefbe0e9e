// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <csignal>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/register_light_array.h"
#include "haarlight/core/files.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"
#include "tests/firmware_iface/loopback_listener.h"

/// @file
/// Broken wires: real libmodbus against real sockets and pseudo-terminals that lie.

namespace haarlight::firmware_iface {
namespace {

using namespace std::chrono_literals;

sim::ControllerServerOptions tcp_options() {
  sim::ControllerServerOptions options;
  options.controller = wide_config(64);
  return options;
}

sim::ControllerServerOptions rtu_options() {
  sim::ControllerServerOptions options;
  options.controller = wide_config(64);
  options.has_tcp = false;
  options.has_rtu = true;
  return options;
}

// Short waits make the tests short; the quiet time stays longer than any reply delay used.
constexpr ModbusTiming kTiming = {.turnaround = 200ms, .connect = 500ms, .quiet = 450ms};

// For faults that are seen in what the wire says, not in its silence: these never wait for it.
constexpr ModbusTiming kPatient = {.turnaround = 10s, .connect = 10s, .quiet = 450ms};

std::unique_ptr<RegisterLightArray> array_on(const sim::ControllerServer& server, bool is_rtu,
                                             const ModbusTiming& timing = kTiming) {
  auto bus = is_rtu
                 ? make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1, timing)
                 : make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 1, timing);
  return std::make_unique<RegisterLightArray>(std::move(bus),
                                              RegisterLightArrayOptions{.n_elements = 64});
}

std::vector<ElementLevel> one_light(int k) { return {{k, 65535}}; }

/// Calls until it succeeds; the number of faults before, or -1 after 20 s.
template <class Call>
int faults_until_done(Call call) {
  const auto deadline = std::chrono::steady_clock::now() + 20s;
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

/// Connects and lights element 1, again where a loaded machine answers later than a short wait.
bool begin(RegisterLightArray& array) {
  return faults_until_done([&array] {
           return array.connect().has_value() && array.show(one_light(1), 1).has_value();
         }) >= 0;
}

struct FaultCase {
  const char* name;
  sim::WireFaultRule rule;
  Errc expected;
  bool is_rtu;
};

std::ostream& operator<<(std::ostream& out, const FaultCase& c) { return out << c.name; }

class WireFaults : public ::testing::TestWithParam<FaultCase> {};

// Every fault hits the third request of a show: reported, and the next show is right.
TEST_P(WireFaults, AreReportedOnceAndHealed) {
  const FaultCase& c = GetParam();
  sim::ControllerServer server(c.is_rtu ? rtu_options() : tcp_options());
  auto array = array_on(server, c.is_rtu, c.expected == Errc::timeout ? kTiming : kPatient);
  ASSERT_TRUE(begin(*array));
  server.inject(c.rule);
  const std::uint64_t before = server.n_requests();
  const auto hit = array->show(one_light(2), 2);
  ASSERT_FALSE(hit);
  EXPECT_EQ(hit.error().code, c.expected) << hit.error().what;
  // It waits for one answer and does not ask again: with a turnaround of 250 ms, a run is
  // suspended within a second.
  EXPECT_LE(server.n_requests() - before, 3U);
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
    {"TcpDropRequest", {.kind = sim::WireFault::drop_request, .skip = 2}, Errc::timeout, false},
    {"TcpDropReply", {.kind = sim::WireFault::drop_reply, .skip = 2}, Errc::timeout, false},
    {"TcpLate",
     {.kind = sim::WireFault::delay_reply, .skip = 2, .delay = 350ms},
     Errc::timeout,
     false},
    {"TcpHalf", {.kind = sim::WireFault::half_reply, .skip = 2}, Errc::timeout, false},
    {"TcpWrongTransaction",
     {.kind = sim::WireFault::wrong_transaction, .skip = 2},
     Errc::protocol,
     false},
    {"TcpGarbage", {.kind = sim::WireFault::garbage_reply, .skip = 2}, Errc::protocol, false},
    {"TcpClose", {.kind = sim::WireFault::close, .skip = 2}, Errc::device_gone, false},
    {"TcpBusy",
     {.kind = sim::WireFault::exception, .skip = 2, .exception = registers::Exception::busy},
     Errc::device_busy,
     false},
    {"TcpIllegalFunction",
     {.kind = sim::WireFault::exception,
      .skip = 2,
      .exception = registers::Exception::illegal_function},
     Errc::protocol,
     false},
    {"RtuDropRequest", {.kind = sim::WireFault::drop_request, .skip = 2}, Errc::timeout, true},
    {"RtuDropReply", {.kind = sim::WireFault::drop_reply, .skip = 2}, Errc::timeout, true},
    {"RtuLate",
     {.kind = sim::WireFault::delay_reply, .skip = 2, .delay = 450ms},
     Errc::timeout,
     true},
    {"RtuHalf", {.kind = sim::WireFault::half_reply, .skip = 2}, Errc::timeout, true},
    {"RtuWrongUnit", {.kind = sim::WireFault::wrong_unit, .skip = 2}, Errc::protocol, true},
    {"RtuGarbage", {.kind = sim::WireFault::garbage_reply, .skip = 2}, Errc::protocol, true},
    {"RtuBusy",
     {.kind = sim::WireFault::exception, .skip = 2, .exception = registers::Exception::busy},
     Errc::device_busy,
     true},
};

INSTANTIATE_TEST_SUITE_P(Each, WireFaults, ::testing::ValuesIn(kFaultCases),
                         [](const auto& param_info) {
                           return std::string(param_info.param.name);
                         });

TEST(RtuDriver, UnaskedBytesBeforeARequestAreNotTakenForItsAnswer) {
  sim::ControllerServer server(rtu_options());
  auto bus = make_modbus_rtu_bus(*parse_serial_address(server.rtu_address()), 1,
                                 {.turnaround = 50ms, .connect = 500ms, .quiet = 300ms});
  ASSERT_TRUE(bus->open());
  std::array<std::uint16_t, 1> word{};
  server.inject({.kind = sim::WireFault::delay_reply, .delay = 120ms});
  ASSERT_FALSE(bus->read_holding(registers::holding::kLevels, word));
  EXPECT_GE(faults_until_done([&] {
              return bus->settle() &&
                     bus->read_holding(registers::holding::kLevels, word).has_value();
            }),
            0);
}

TEST(RtuDriver, CableOutIsGoneAndBackUnderItsName) {
  sim::ControllerServer server(rtu_options());
  auto array = array_on(server, true, kPatient);
  ASSERT_TRUE(begin(*array));
  server.unplug_rtu();
  const auto gone = array->show(one_light(2), 2);
  ASSERT_FALSE(gone);  // not a timeout: it was not waited for
  EXPECT_EQ(gone.error().code, Errc::device_gone) << gone.error().what;
  ASSERT_FALSE(array->all_off());
  server.replug_rtu();
  EXPECT_GE(faults_until_done([&] { return array->show(one_light(3), 3).has_value(); }), 0);
  EXPECT_EQ(server.lit().tag, 3U);
}

TEST(RtuDriver, BabblingLineIsGivenUp) {
  sim::ControllerServer server(rtu_options());
  auto array = array_on(server, true, kPatient);
  ASSERT_TRUE(array->connect());
  server.inject({.kind = sim::WireFault::garbage_reply, .count = -1});
  ASSERT_FALSE(array->show(one_light(1), 1));
  ASSERT_FALSE(array->all_off());
  EXPECT_TRUE(server.lit().pattern->empty());
  server.clear_faults();
  EXPECT_GE(faults_until_done([&] { return array->show(one_light(2), 2).has_value(); }), 0);
}

TEST(TcpDriver, RestartInMidRunIsResumed) {
  sim::ControllerServer server(tcp_options());
  auto array = array_on(server, false);
  ASSERT_TRUE(begin(*array));
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
    sim::ControllerServer server(tcp_options());
    address = server.tcp_address();
  }
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(address), 1, kTiming);
  const auto opened = bus->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::device_gone);
}

TEST(TcpDriver, WrongUnitIsGone) {
  sim::ControllerServer server(tcp_options());
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 9, kTiming);
  RegisterLightArray array(std::move(bus), {.n_elements = 64});
  const auto identity = array.connect();
  ASSERT_FALSE(identity);
  EXPECT_EQ(identity.error().code, Errc::device_gone);
}

// A server that died without a word: nothing comes back, the connection stays open.
TEST(TcpDriver, HalfOpenConnectionIsGivenUpAndMadeAnew) {
  sim::ControllerServer server(tcp_options());
  auto array = array_on(server, false);
  ASSERT_TRUE(begin(*array));
  server.inject({.kind = sim::WireFault::drop_request, .count = -1});
  for (int i = 0; i < 3; ++i) {
    const std::uint64_t before = server.n_requests();
    const auto off = array->all_off();
    ASSERT_FALSE(off);
    EXPECT_LE(server.n_requests() - before, 1U) << "each waits for one answer alone";
  }
  server.clear_faults();
  EXPECT_GE(faults_until_done([&] { return array->all_off().has_value(); }), 0);
}

TEST(TcpDriver, FiveHundredShowsWithScatteredFaultsAreEachRightOrReported) {
  sim::ControllerServer server(tcp_options());
  auto bus = make_modbus_tcp_bus(*parse_tcp_address(server.tcp_address()), 1,
                                 {.turnaround = 40ms, .connect = 500ms, .quiet = 100ms});
  RegisterLightArray array(std::move(bus), {.n_elements = 64});
  ASSERT_TRUE(array.connect());
  constexpr std::array kKinds = {
      sim::WireFault::drop_request, sim::WireFault::drop_reply,
      sim::WireFault::delay_reply,  sim::WireFault::wrong_transaction,
      sim::WireFault::close,        sim::WireFault::half_reply};
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

// A peer that speaks Modbus TCP and nothing else of ours: right framing, any content.
class NoisyPeer {
 public:
  explicit NoisyPeer(std::uint32_t seed) : random_(seed) {
    thread_ = std::jthread([this](const std::stop_token& stop) { serve(stop); });
  }
  [[nodiscard]] TcpAddress address() const { return {"127.0.0.1", listener_.port()}; }

 private:
  std::uint32_t next(std::uint32_t n) {
    random_ = random_ * 1664525U + 1013904223U;
    return (random_ >> 8U) % n;
  }

  void serve(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      if (!listener_.is_called()) {
        continue;
      }
      const Fd fd = listener_.accept();
      while (!stop.stop_requested() && answer(fd.get(), stop)) {
      }
    }
  }

  bool answer(int fd, const std::stop_token& stop) {
    while (!testing::is_readable(fd)) {
      if (stop.stop_requested()) {
        return false;
      }
    }
    std::array<std::uint8_t, 300> request{};
    if (::recv(fd, request.data(), request.size(), 0) < 8) {
      return false;
    }
    // Mostly the right transaction and function, so that the noise reaches the decoders.
    const std::size_t n_data = next(4) == 0 ? next(250) : std::size_t{request[11]} * 2 + 1;
    std::vector<std::uint8_t> reply(8 + n_data);
    std::copy_n(request.begin(), 8, reply.begin());
    for (std::size_t i = 8; i < reply.size(); ++i) {
      reply[i] = static_cast<std::uint8_t>(next(256));
    }
    if (n_data > 0 && next(8) != 0) {
      reply[8] = static_cast<std::uint8_t>(n_data - 1);
    }
    if (request[7] == 16 && next(4) != 0) {
      reply.resize(12);
      std::copy_n(request.begin(), 12, reply.begin());  // acknowledged, though nothing was done
    }
    if (next(16) == 0) {
      reply[7] = static_cast<std::uint8_t>(reply[7] | 0x80U);
    }
    reply[4] = static_cast<std::uint8_t>((reply.size() - 6) >> 8U);
    reply[5] = static_cast<std::uint8_t>((reply.size() - 6) & 0xFFU);
    if (next(16) == 0) {
      reply[next(static_cast<std::uint32_t>(reply.size()))] ^= 0x41U;
    }
    return next(30) != 0 && ::send(fd, reply.data(), reply.size(), MSG_NOSIGNAL) > 0;
  }

  std::uint32_t random_;
  testing::LoopbackListener listener_;
  std::jthread thread_;
};

TEST(TcpDriver, NoiseIsNeverTakenForAController) {
  for (std::uint32_t seed = 0; seed < 4; ++seed) {
    NoisyPeer peer(seed);
    RegisterLightArray array(
        make_modbus_tcp_bus(peer.address(), 1,
                            {.turnaround = 5ms, .connect = 500ms, .quiet = 10ms}),
        {.n_elements = 64});
    for (int i = 0; i < 50; ++i) {
      EXPECT_FALSE(array.connect());
      EXPECT_FALSE(array.all_off());
      EXPECT_FALSE(array.show(one_light(1), 1));
    }
  }
}

// The promise of the lease: whatever stops the host, the light is off one lease later.
TEST(Lease, EndsTheLightOfAStoppedAndOfAKilledHost) {
  for (const int signal_number : {SIGSTOP, SIGKILL}) {
    SCOPED_TRACE(signal_number);
    std::array<int, 2> ends{};
    ASSERT_EQ(::pipe(ends.data()), 0);
    // Forked before any thread exists. The child is a host that renews its lease for ever.
    const pid_t host = ::fork();
    ASSERT_GE(host, 0);
    if (host == 0) {
      std::array<char, 64> address{};
      [[maybe_unused]] const ssize_t n = ::read(ends[0], address.data(), address.size() - 1);
      auto bus = make_modbus_tcp_bus(*parse_tcp_address(address.data()), 1, kTiming);
      RegisterLightArray array(std::move(bus), {.n_elements = 64, .lease = 200ms});
      if (!array.connect() || !array.show(one_light(5), 1)) {
        ::_exit(1);
      }
      while (array.renew_lease()) {
        std::this_thread::sleep_for(20ms);
      }
      ::_exit(1);
    }
    double on_after_s = -1.0;
    {
      sim::ControllerServer server(tcp_options());
      const std::string address = server.tcp_address();
      ASSERT_EQ(::write(ends[1], address.data(), address.size()),
                static_cast<ssize_t>(address.size()));
      EXPECT_GE(faults_until_done([&] { return server.lit().tag == 1; }), 0);
      std::this_thread::sleep_for(500ms);  // longer than the lease: the renewals hold it
      EXPECT_EQ(server.lit().tag, 1U);
      ::kill(host, signal_number);
      int status = 0;
      ASSERT_EQ(::waitpid(host, &status, WUNTRACED), host);
      // A renewal that it had sent may still be carried out: the lease counts from the last one.
      std::uint64_t n_requests = server.n_requests();
      double before_s = server.total_on_seconds(5);
      EXPECT_GE(faults_until_done([&] {
                  const bool is_dark = server.lit().pattern->empty();
                  if (!is_dark && server.n_requests() != n_requests) {
                    n_requests = server.n_requests();
                    before_s = server.total_on_seconds(5);
                  }
                  return is_dark;
                }),
                0);
      on_after_s = server.total_on_seconds(5) - before_s;
    }
    if (signal_number != SIGKILL) {
      ::kill(host, SIGKILL);
      ::waitpid(host, nullptr, 0);
    }
    ::close(ends[0]);
    ::close(ends[1]);
    EXPECT_GE(on_after_s, 0.0);
    EXPECT_LE(on_after_s, 0.200 + 1e-6);  // by the controller's clock; the sum's rounding
  }
}

}  // namespace
}  // namespace haarlight::firmware_iface
