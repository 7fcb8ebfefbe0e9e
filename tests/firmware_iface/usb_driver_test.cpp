// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <chrono>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_iface/register_light_array.h"
#include "firmware_iface/usb_bus.h"
#include "firmware_iface/usb_link.h"
#include "haarlight/firmware_iface/light_array.h"
#include "sim/controller_server.h"
#include "tests/firmware_iface/controller_fixture.h"
#include "tests/firmware_iface/late_answer.h"
#include "tests/firmware_iface/usb_testbed.h"

/// @file
/// The USB driver over real libusb against the simulated device behind umockdev.

namespace haarlight::firmware_iface {
namespace {

using namespace std::chrono_literals;

sim::ControllerServerOptions server_options(int n) {
  sim::ControllerServerOptions options;
  options.controller = wide_config(n);
  options.has_tcp = false;
  return options;
}

/// A bus with one controller on it.
struct Bench {
  explicit Bench(int n_elements = 64, sim::UsbDeviceConfig config = {})
      : server(server_options(n_elements)), device(std::move(config), server) {
    bus.plug(device);
  }
  sim::ControllerServer server;
  sim::UsbLightDevice device;
  UsbTestbed bus;
};

// A loaded machine answers late: generous where the time itself is not what is tested.
constexpr UsbTiming kTiming = {.turnaround = 1000ms, .open = 3000ms};

std::unique_ptr<RegisterLightArray> make_array(int n = 64, UsbTiming timing = kTiming) {
  return std::make_unique<RegisterLightArray>(make_usb_bus("HL000001", timing),
                                              RegisterLightArrayOptions{.n_elements = n});
}

std::vector<ElementLevel> one_light(int k) { return {{k, 65535}}; }

TEST(UsbDriver, ShowsAndReadsBack) {
  Bench bench(1024);
  ControllerSpec spec;
  spec.kind = ControllerKind::usb;
  spec.address = "HL000001";
  auto array = make_light_array(spec, 1024);
  ASSERT_TRUE(array) << array.error().what;
  const auto identity = (*array)->connect();
  ASSERT_TRUE(identity) << identity.error().what;
  EXPECT_EQ(identity->n_elements, 1024);
  std::uint32_t tag = 0;
  for (const int k : {0, 1, 31, 1023, 512}) {
    const auto receipt = (*array)->show(one_light(k), ++tag);
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tag);
    const LightTransition lit = bench.server.lit();
    EXPECT_EQ(lit.tag, tag);
    ASSERT_EQ(lit.pattern->size(), 1U);
    EXPECT_EQ(lit.level(k), 65535);
    EXPECT_GE(lit.t_ns, receipt->t_command_ns);
    EXPECT_LE(lit.t_ns, receipt->t_ack_ns);
  }
  ASSERT_TRUE((*array)->all_off());
  EXPECT_TRUE(bench.server.lit().pattern->empty());
  (*array)->disconnect();
  EXPECT_EQ(bench.bus.n_claimed(), 0);
}

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

TEST(UsbDriver, FindsItsDeviceBySerialNumberAndNamesTheOthers) {
  Bench bench;
  sim::UsbLightDevice other({.serial = "HL000002"}, bench.server);
  bench.bus.plug(other);
  const auto listing = list_usb_controllers();
  ASSERT_TRUE(listing) << listing.error().what;
  std::vector<std::string> serials;
  for (const UsbController& controller : *listing) {
    serials.push_back(controller.serial);
    EXPECT_EQ(controller.problem, "");
    EXPECT_EQ(controller.vendor_id, 0x1209);
  }
  EXPECT_THAT(serials, ::testing::UnorderedElementsAre("HL000001", "HL000002"));
  auto second = make_usb_bus("HL000002", kTiming);
  EXPECT_TRUE(second->open());
  auto third = make_usb_bus("HL000003", kTiming);
  const auto opened = third->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::device_gone);
  EXPECT_THAT(opened.error().what, ::testing::HasSubstr("HL000003"));
  EXPECT_THAT(opened.error().what, ::testing::HasSubstr("HL000002"));
}

TEST(UsbDriver, ClaimsItsDeviceForItselfAlone) {
  Bench bench;
  auto first = make_usb_bus("HL000001", kTiming);
  ASSERT_TRUE(first->open());
  auto second = make_usb_bus("HL000001", kTiming);
  const auto opened = second->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, Errc::device_busy) << opened.error().what;
  first->close();
  EXPECT_TRUE(second->open());
}

TEST(UsbDriver, WritesAWholeBankOf1024Levels) {
  for (const std::uint16_t max_packet : {std::uint16_t{64}, std::uint16_t{512}}) {
    Bench bench(1024, {.max_packet = max_packet});
    auto array = make_array(1024);
    ASSERT_TRUE(array->connect());
    std::vector<ElementLevel> pattern;
    pattern.reserve(1024);
    for (int k = 0; k < 1024; ++k) {
      pattern.push_back({k, static_cast<std::uint16_t>(1 + 63 * k)});
    }
    const auto receipt = array->show(pattern, 7);
    ASSERT_TRUE(receipt) << receipt.error().what;
    const LightTransition lit = bench.server.lit();
    ASSERT_EQ(lit.pattern->size(), 1024U);
    for (const ElementLevel& e : pattern) {
      ASSERT_EQ(lit.level(e.element), e.level);
    }
  }
}

TEST(UsbDriver, UploadsAndStepsATable) {
  Bench bench;
  auto array = make_array();
  ASSERT_TRUE(array->connect());
  std::vector<std::vector<ElementLevel>> patterns;
  std::vector<std::uint32_t> tags;
  for (int k = 0; k < 8; ++k) {
    patterns.push_back(one_light(k));
    tags.push_back(static_cast<std::uint32_t>(100 + k));
  }
  const auto uploaded = array->upload_table(patterns, tags);
  ASSERT_TRUE(uploaded) << uploaded.error().what;
  for (int k = 0; k < 4; ++k) {
    const auto receipt = array->step_table();
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tags[static_cast<std::size_t>(k)]);
  }
  ASSERT_TRUE(array->arm_table(registers::StepSource::strobe));
  bench.server.strobe();
  bench.server.strobe();
  EXPECT_EQ(bench.server.lit().tag, 101U);
  EXPECT_EQ(array->status()->step_counter, 2U);
}

TEST(UsbDriver, SilenceOfTheHostTurnsTheLightOffWithinTheLease) {
  Bench bench;
  RegisterLightArray array(make_usb_bus("HL000001", kTiming),
                           {.n_elements = 64, .lease = 150ms});
  ASSERT_TRUE(array.connect());
  double before_s = 0.0;
  // Again where the light is off before the driver has read back that it is on.
  ASSERT_GE(faults_until_done([&] {
              const bool is_dark = array.all_off().has_value();
              before_s = bench.server.total_on_seconds(3);
              return is_dark && array.show(one_light(3), 1).has_value();
            }),
            0);
  ASSERT_GE(faults_until_done([&] { return bench.server.lit().pattern->empty(); }), 0);
  EXPECT_NEAR(bench.server.total_on_seconds(3) - before_s, 0.150, 1e-4);
}

// ---- faults ----

// Every transfer of a show and of a reconnection is hit once by every fault: each is reported
// or healed, no call waits for more than one transfer in vain, and the next light shown is the
// right one.
class UsbTransferFaults : public ::testing::TestWithParam<sim::UsbStatus> {};

TEST_P(UsbTransferFaults, AtEveryTransferAreReportedAndHealed) {
  const sim::UsbStatus kind = GetParam();
  Bench bench;
  auto array = make_array(64, {.turnaround = 120ms, .open = 1500ms});
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  const std::uint64_t before = bench.device.n_transfers();
  ASSERT_TRUE(array->show(one_light(2), 2));
  const auto n_transfers = static_cast<int>(bench.device.n_transfers() - before);
  ASSERT_GE(n_transfers, 8);  // four requests at least, out and in
  std::uint32_t tag = 2;
  for (int i = 0; i < n_transfers; ++i) {
    SCOPED_TRACE(i);
    bench.device.inject({.kind = kind, .skip = i});
    ++tag;
    const int k = static_cast<int>(tag % 64);
    const std::uint64_t begun = bench.device.n_transfers();
    const auto hit = array->show(one_light(k), tag);
    EXPECT_FALSE(hit) << "transfer " << i;
    EXPECT_LE(bench.device.n_transfers() - begun, static_cast<std::uint64_t>(i) + 1);
    if (kind == sim::UsbStatus::gone) {
      EXPECT_EQ(hit.error().code, Errc::device_gone) << hit.error().what;
      bench.bus.unplug(bench.device);
      EXPECT_FALSE(array->all_off());
      bench.bus.plug(bench.device);
    } else {
      EXPECT_EQ(hit.error().code,
                kind == sim::UsbStatus::stall ? Errc::protocol : Errc::timeout)
          << hit.error().what;
    }
    bench.device.clear_faults();
    ++tag;
    ASSERT_GE(faults_until_done([&] { return array->show(one_light(5), tag).has_value(); }), 0);
    const LightTransition lit = bench.server.lit();
    EXPECT_EQ(lit.tag, tag);
    ASSERT_EQ(lit.pattern->size(), 1U);
    EXPECT_EQ(lit.level(5), 65535);
  }
}

// The recovery itself is hit: clearing, resynchronising, identity, reading back.
TEST_P(UsbTransferFaults, DuringTheRecoveryAreHealedToo) {
  const sim::UsbStatus kind = GetParam();
  for (int i = 0; i < 8; ++i) {
    SCOPED_TRACE(i);
    Bench bench;
    auto array = make_array(64, {.turnaround = 120ms, .open = 1500ms});
    ASSERT_TRUE(array->connect());
    bench.device.inject({.kind = sim::UsbStatus::stall, .only = sim::UsbTransfer::bulk_in});
    bench.device.inject({.kind = kind, .skip = i});
    EXPECT_FALSE(array->show(one_light(1), 1));
    const auto deadline = std::chrono::steady_clock::now() + 20s;
    bool is_shown = false;
    while (!is_shown && std::chrono::steady_clock::now() < deadline) {
      is_shown = array->show(one_light(2), 2).has_value();
      if (!is_shown && kind == sim::UsbStatus::gone && bench.bus.is_off(bench.device)) {
        bench.bus.unplug(bench.device);
        bench.bus.plug(bench.device);
      }
    }
    ASSERT_TRUE(is_shown);
    EXPECT_EQ(bench.server.lit().level(2), 65535);
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, UsbTransferFaults,
                         ::testing::Values(sim::UsbStatus::stall, sim::UsbStatus::hang,
                                           sim::UsbStatus::gone),
                         [](const auto& param_info) {
                           return param_info.param == sim::UsbStatus::stall  ? "Stall"
                                  : param_info.param == sim::UsbStatus::hang ? "Timeout"
                                                                             : "Gone";
                         });

struct ReplyCase {
  const char* name;
  sim::WireFault kind;
  Errc expected;
};

class UsbReplyFaults : public ::testing::TestWithParam<ReplyCase> {};

TEST_P(UsbReplyFaults, AreReportedAndHealed) {
  const ReplyCase& c = GetParam();
  Bench bench;
  auto array = make_array(64, {.turnaround = 150ms, .open = 1500ms});
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  bench.server.inject(
      {.kind = c.kind, .skip = 2, .delay = 300ms, .exception = registers::Exception::busy});
  const auto hit = array->show(one_light(2), 2);
  ASSERT_FALSE(hit);
  EXPECT_EQ(hit.error().code, c.expected) << hit.error().what;
  if (c.kind == sim::WireFault::close) {
    bench.bus.unplug(bench.device);
    bench.bus.plug(bench.device);
  }
  ASSERT_GE(faults_until_done([&] { return array->show(one_light(3), 3).has_value(); }), 0);
  EXPECT_EQ(bench.server.lit().tag, 3U);
  EXPECT_EQ(bench.server.lit().level(3), 65535);
}

constexpr ReplyCase kReplyCases[] = {
    {"LostRequest", sim::WireFault::drop_request, Errc::timeout},
    {"LostReply", sim::WireFault::drop_reply, Errc::timeout},
    {"Late", sim::WireFault::delay_reply, Errc::timeout},
    {"Half", sim::WireFault::half_reply, Errc::protocol},
    {"Garbage", sim::WireFault::garbage_reply, Errc::protocol},
    {"RequestAsReply", sim::WireFault::wrong_unit, Errc::protocol},
    {"NumberAhead", sim::WireFault::wrong_transaction, Errc::protocol},
    {"Busy", sim::WireFault::exception, Errc::device_busy},
    {"Gone", sim::WireFault::close, Errc::device_gone},
};

INSTANTIATE_TEST_SUITE_P(Each, UsbReplyFaults, ::testing::ValuesIn(kReplyCases),
                         [](const auto& param_info) {
                           return std::string(param_info.param.name);
                         });

// What RTU cannot tell apart, the sequence number does, even without settling first.
TEST(UsbDriver, LateAnswerIsNeverTakenForTheNextOne) {
  for (const auto delay : {130ms, 160ms, 200ms, 250ms}) {
    SCOPED_TRACE(delay.count());
    Bench bench;
    auto bus = make_usb_bus("HL000001", {.turnaround = 100ms, .open = 1500ms});
    testing::expect_late_answer_is_not_the_next(*bus, bench.server, delay);
  }
}

TEST(UsbDriver, UnpluggedWhileIdleIsSeenAndReplugHealsUnderAnotherAddress) {
  Bench bench;
  auto array = make_array();
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  bench.bus.unplug(bench.device);
  const auto gone = array->renew_lease();
  ASSERT_FALSE(gone);  // not a timeout: it was not waited for
  EXPECT_EQ(gone.error().code, Errc::device_gone) << gone.error().what;
  ASSERT_FALSE(array->all_off());
  bench.bus.plug(bench.device);  // another address on the bus
  ASSERT_GE(faults_until_done([&] { return array->show(one_light(3), 3).has_value(); }), 0);
  EXPECT_EQ(bench.server.lit().tag, 3U);
}

TEST(UsbDriver, RestartOfTheControllerIsNoticed) {
  Bench bench;
  auto array = make_array(64, {.turnaround = 150ms, .open = 1500ms});
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  bench.server.restart(100ms);
  EXPECT_TRUE(bench.server.lit().pattern->empty());
  EXPECT_GE(faults_until_done([&] { return array->show(one_light(2), 2).has_value(); }), 1);
  EXPECT_EQ(bench.server.lit().tag, 2U);
  EXPECT_EQ(array->status()->boot_id, 2U);
}

TEST(UsbDriver, AnotherControllersSerialNumberBehindTheSameNameIsRefused) {
  Bench bench;
  auto array = make_array();
  ASSERT_TRUE(array->connect());
  sim::ControllerServerOptions options = server_options(64);
  options.controller.serial = 77;
  sim::ControllerServer stranger(options);
  sim::UsbLightDevice device({}, stranger);  // claims to be HL000001 too
  bench.bus.unplug(bench.device);
  bench.bus.plug(device);
  EXPECT_FALSE(array->show(one_light(1), 1));
  std::this_thread::sleep_for(60ms);
  const auto shown = array->show(one_light(1), 1);
  ASSERT_FALSE(shown);
  EXPECT_THAT(shown.error().what, ::testing::HasSubstr("77"));
  bench.bus.unplug(device);
}

// A kernel call that never returns: the caller has its answer at the deadline, ALL_OFF passes
// by the control endpoint on a second way, and nothing waits for the lost thread at the end.
TEST(UsbDriver, HangingSystemCallDoesNotHoldTheCaller) {
  Bench bench;
  auto array = make_array(64, {.turnaround = 100ms, .open = 1500ms});
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  bench.bus.hold_completions(1);
  const auto hung = array->show(one_light(2), 2);
  ASSERT_FALSE(hung);
  EXPECT_EQ(hung.error().code, Errc::timeout) << hung.error().what;
  EXPECT_EQ(bench.bus.n_holding(), 1) << "the system call hangs still";
  EXPECT_FALSE(bench.server.lit().pattern->empty());
  ControllerSpec spec;
  spec.kind = ControllerKind::usb;
  spec.address = "HL000001";
  const auto dark = all_off_beside(spec);
  ASSERT_TRUE(dark) << dark.error().what;
  EXPECT_TRUE(bench.server.lit().pattern->empty());
  array.reset();
  EXPECT_EQ(bench.bus.n_holding(), 1) << "nor was it waited for at the end";
  bench.bus.release_completions();
  // The system comes back: the lost thread puts its things away before the bench goes.
  EXPECT_GE(faults_until_done([&] { return bench.bus.n_claimed() == 0; }), 0);
}

TEST(UsbDriver, AllOffPassesBesideAJammedEndpoint) {
  Bench bench;
  auto array = make_array(64, {.turnaround = 100ms, .open = 1500ms});
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(1), 1));
  bench.device.inject(
      {.kind = sim::UsbStatus::hang, .count = -1, .only = sim::UsbTransfer::bulk_out});
  EXPECT_FALSE(array->show(one_light(2), 2));
  EXPECT_FALSE(bench.server.lit().pattern->empty());
  ASSERT_TRUE(usb_all_off("HL000001"));
  EXPECT_TRUE(bench.server.lit().pattern->empty());
}

// Opening, closing, plugging and unplugging in any order from two threads ends.
TEST(UsbDriver, ShutdownNeverDeadlocks) {
  Bench bench;
  for (int round = 0; round < 20; ++round) {
    auto array = make_array(64, {.turnaround = 60ms, .open = 1500ms});
    static_cast<void>(array->connect());
    if (round % 4 == 1) {
      bench.device.inject({.kind = sim::UsbStatus::hang});
    }
    std::jthread puller([&] {
      if (round % 2 == 1) {
        bench.bus.unplug(bench.device);
      }
    });
    static_cast<void>(array->show(one_light(round), static_cast<std::uint32_t>(round + 1)));
    array.reset();
    puller.join();
    bench.device.clear_faults();
    if (round % 2 == 1) {
      bench.bus.plug(bench.device);
    }
  }
  auto array = make_array();
  ASSERT_TRUE(array->connect());
  ASSERT_TRUE(array->show(one_light(9), 99));
}

}  // namespace
}  // namespace haarlight::firmware_iface

int main(int argc, char** argv) {
  haarlight::firmware_iface::require_mock_environment(argv);
  testing::InitGoogleMock(&argc, argv);
  return RUN_ALL_TESTS();
}
