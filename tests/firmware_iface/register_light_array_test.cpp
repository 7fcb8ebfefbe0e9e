// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/register_light_array.h"

#include <algorithm>
#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "firmware_iface/fake_bus.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// The driver's logic on a bus without a wire and a virtual clock: every request can fail.

namespace haarlight::firmware_iface {
namespace {

/// A controller, a clock that moves 1 ms a look, and an array on a bus that can be scripted.
struct Bench {
  explicit Bench(const ControllerConfig& config) : controller(config, 1, 0) {
    array = make_fake_light_array(
        controller, [this] { return now += kMs; },
        [this]() -> std::optional<FakeBusFault> {
          const auto it = faults.find(n_requests++);
          return it == faults.end() ? std::nullopt : std::optional(it->second);
        });
  }
  std::int64_t now = 0;
  int n_requests = 0;
  std::map<int, FakeBusFault> faults;
  LightController controller;
  std::unique_ptr<RegisterLightArray> array;
};

std::vector<ElementLevel> lit_by(const LightController& controller) {
  return *controller.lit().pattern;
}

bool is_same(const std::vector<ElementLevel>& a, const std::vector<ElementLevel>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const ElementLevel& x, const ElementLevel& y) {
                      return x.element == y.element && x.level == y.level;
                    });
}

TEST(RegisterLightArray, ConnectReadsTheIdentityAndGoesDark) {
  Bench b(wide_config(64));
  ASSERT_EQ(set_level(b.controller, 5, 9, 0), registers::Exception::none);
  ASSERT_EQ(set_on(b.controller, 5, true, 0), registers::Exception::none);
  ASSERT_EQ(latch(b.controller, 77, 0), registers::Exception::none);
  const auto identity = b.array->connect();
  ASSERT_TRUE(identity) << identity.error().what;
  EXPECT_EQ(identity->model, "haarlight-sim");
  EXPECT_EQ(identity->n_elements, 64);
  EXPECT_EQ(identity->boot_id, 1U);
  EXPECT_TRUE(lit_by(b.controller).empty());
  EXPECT_EQ(b.array->link_state(), LinkState::up);
}

TEST(RegisterLightArray, OneLightStepTakesFiveRequestsOrFewer) {
  Bench b(wide_config(1024));
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> first = {{0, 65535}};
  const std::vector<ElementLevel> far = {{1023, 65535}};
  ASSERT_TRUE(b.array->show(first, 1));
  const int before = b.n_requests;
  const auto receipt = b.array->show(far, 2);
  ASSERT_TRUE(receipt) << receipt.error().what;
  EXPECT_LE(b.n_requests - before, 5);
  EXPECT_EQ(receipt->tag_echo, 2U);
  EXPECT_LT(receipt->t_command_ns, receipt->t_ack_ns);
  EXPECT_TRUE(is_same(lit_by(b.controller), far));
  // Back again: the level of element 0 is still in the bank.
  const int again = b.n_requests;
  ASSERT_TRUE(b.array->show(first, 3));
  EXPECT_LE(b.n_requests - again, 4);
  EXPECT_TRUE(is_same(lit_by(b.controller), first));
}

TEST(RegisterLightArray, DarkFrameHasItsTag) {
  Bench b(wide_config(4));
  ASSERT_TRUE(b.array->connect());
  const auto receipt = b.array->show({}, 9);
  ASSERT_TRUE(receipt) << receipt.error().what;
  EXPECT_EQ(b.controller.lit().tag, 9U);
  EXPECT_TRUE(lit_by(b.controller).empty());
}

TEST(RegisterLightArray, BadPatternsAreRefusedBeforeAnyRequest) {
  Bench b(wide_config(4));
  ASSERT_TRUE(b.array->connect());
  const int before = b.n_requests;
  const std::vector<ElementLevel> outside = {{4, 1}};
  const std::vector<ElementLevel> negative = {{-1, 1}};
  const std::vector<ElementLevel> twice = {{1, 1}, {1, 2}};
  const std::vector<ElementLevel> fine = {{1, 1}};
  for (const auto& [pattern, tag] :
       {std::pair{outside, 1U}, {negative, 1U}, {twice, 1U}, {fine, 0U}}) {
    const auto receipt = b.array->show(pattern, tag);
    ASSERT_FALSE(receipt);
    EXPECT_EQ(receipt.error().code, Errc::refused) << receipt.error().what;
  }
  EXPECT_EQ(b.n_requests, before);
}

TEST(RegisterLightArray, PowerLimitIsToldWithItsReason) {
  Bench b(small_config());
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> pattern = {
      {0, 65535}, {1, 65535}, {2, 65535}, {3, 65535}, {4, 65535}};
  const auto receipt = b.array->show(pattern, 1);
  ASSERT_FALSE(receipt);
  EXPECT_EQ(receipt.error().code, Errc::refused);
  EXPECT_THAT(receipt.error().what, testing::HasSubstr("one string's limit"));
  EXPECT_TRUE(lit_by(b.controller).empty());
  // The link is fine and the next pattern right.
  const std::vector<ElementLevel> less = {{0, 65535}, {9, 100}};
  ASSERT_TRUE(b.array->show(less, 2));
  EXPECT_TRUE(is_same(lit_by(b.controller), less));
}

TEST(RegisterLightArray, BankClearedBehindItsBackIsWrittenAnew) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> pattern = {{3, 500}, {40, 65535}};
  ASSERT_TRUE(b.array->show(pattern, 1));
  ASSERT_EQ(all_off(b.controller, b.now), registers::Exception::none);  // another host
  ASSERT_TRUE(b.array->show(pattern, 2));
  EXPECT_TRUE(is_same(lit_by(b.controller), pattern));
  b.now += 3'600'000 * kMs;  // the lease ran out an hour ago
  ASSERT_TRUE(b.array->show(pattern, 3));
  EXPECT_TRUE(is_same(lit_by(b.controller), pattern));
  b.controller.reboot(99, b.now);
  ASSERT_TRUE(b.array->show(pattern, 4));
  EXPECT_TRUE(is_same(lit_by(b.controller), pattern));
  EXPECT_EQ(b.controller.lit().tag, 4U);
}

TEST(RegisterLightArray, StatusTellsARestart) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  b.controller.reboot(99, b.now);
  const auto status = b.array->status();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->boot_id, 99U);
  EXPECT_EQ(b.array->link_state(), LinkState::unknown);
  ASSERT_TRUE(b.array->renew_lease());
  EXPECT_EQ(b.array->link_state(), LinkState::up);
}

TEST(RegisterLightArray, TimeoutOfARenewalKeepsTheLightWhenReadBackAgrees) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> pattern = {{7, 1234}};
  ASSERT_TRUE(b.array->show(pattern, 5));
  b.faults[b.n_requests] = {Errc::timeout, true};
  ASSERT_FALSE(b.array->renew_lease());
  ASSERT_TRUE(b.array->renew_lease());
  EXPECT_TRUE(is_same(lit_by(b.controller), pattern));
  EXPECT_EQ(b.controller.lit().tag, 5U);
}

TEST(RegisterLightArray, UnconfirmedBankWriteEndsDark) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> pattern = {{7, 1234}};
  ASSERT_TRUE(b.array->show(pattern, 5));
  const std::vector<ElementLevel> other = {{8, 1}};
  b.faults[b.n_requests] = {Errc::timeout, true};
  ASSERT_FALSE(b.array->show(other, 6));
  ASSERT_TRUE(b.array->status());
  EXPECT_TRUE(lit_by(b.controller).empty());
  ASSERT_TRUE(b.array->show(other, 7));
  EXPECT_TRUE(is_same(lit_by(b.controller), other));
}

TEST(RegisterLightArray, LostLinkWaitsForItsPauseButAllOffDoesNot) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  for (int i = 0; i < 4; ++i) {
    b.faults[b.n_requests + i] = {Errc::device_gone, false};
  }
  ASSERT_FALSE(b.array->renew_lease());
  EXPECT_EQ(b.array->link_state(), LinkState::lost);
  EXPECT_FALSE(b.array->all_off());  // tries at once, and is refused by the script
  EXPECT_FALSE(b.array->all_off());
  EXPECT_FALSE(b.array->all_off());
  EXPECT_TRUE(b.array->all_off());
}

TEST(RegisterLightArray, AnotherControllerOnTheSameAddressIsNotUsed) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  ControllerConfig other = wide_config(64);
  other.serial = 2;
  b.controller = LightController(other, 1, b.now);
  b.faults[b.n_requests] = {Errc::device_gone, false};
  ASSERT_FALSE(b.array->renew_lease());
  const auto again = b.array->renew_lease();
  ASSERT_FALSE(again);
  EXPECT_THAT(again.error().what, testing::HasSubstr("controller 2 answers, 1 was connected"));
  EXPECT_TRUE(b.array->connect());  // unless the operator requests it
}

TEST(RegisterLightArray, SmallerControllerThanTheRigIsRefused) {
  LightController controller(wide_config(16), 1, 0);
  std::int64_t now = 0;
  const NanosecondClock clock = [&now] { return ++now; };
  RegisterLightArray array(std::make_unique<FakeBus>(controller, clock), {.n_elements = 17},
                           clock);
  const auto identity = array.connect();
  ASSERT_FALSE(identity);
  EXPECT_EQ(identity.error().code, Errc::unsupported);
}

TEST(RegisterLightArray, TableIsSteppedWithProof) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<std::vector<ElementLevel>> patterns = {
      {{0, 65535}}, {{1, 65535}, {63, 3}}, {}};
  const std::vector<std::uint32_t> tags = {11, 12, 13};
  const auto uploaded = b.array->upload_table(patterns, tags);
  ASSERT_TRUE(uploaded) << uploaded.error().what;
  EXPECT_TRUE(lit_by(b.controller).empty());
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const auto receipt = b.array->step_table();
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tags[i]);
    EXPECT_TRUE(is_same(lit_by(b.controller), patterns[i]));
  }
  const auto past = b.array->step_table();
  ASSERT_TRUE(past);
  EXPECT_EQ(past->tag_echo, 0U);
  // By the strobe.
  ASSERT_TRUE(b.array->arm_table(registers::StepSource::strobe));
  b.controller.strobe(b.now);
  b.controller.strobe(b.now);
  EXPECT_TRUE(is_same(lit_by(b.controller), patterns[1]));
  const auto status = b.array->status();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->step_counter, 2U);
  EXPECT_EQ(status->tag, 12U);
}

// ---- a controller that acts later than it acknowledges

TEST(RegisterLightArray, ALateLightCountsFromTheStatusThatShowsIt) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  b.controller.set_late_acting({.fraction = 1.0});  // 5 to 60 ms
  const std::vector<std::vector<ElementLevel>> patterns = {{{0, 65535}}, {{1, 65535}}};
  for (std::uint32_t tag = 1; tag < 20; ++tag) {
    const auto receipt = b.array->show(patterns[tag % 2], tag);
    ASSERT_TRUE(receipt) << receipt.error().what;
    EXPECT_EQ(receipt->tag_echo, tag);
    EXPECT_LE(receipt->t_command_ns, receipt->t_ack_ns);
    EXPECT_LT(receipt->t_ack_ns, b.controller.lit().t_ns) << "acknowledged before it acted";
    EXPECT_LE(b.controller.lit().t_ns, receipt->t_shown_ns);
    EXPECT_EQ(b.controller.lit().tag, tag);
  }
  const auto off = b.array->all_off();
  ASSERT_TRUE(off) << off.error().what;
  EXPECT_TRUE(lit_by(b.controller).empty());
  EXPECT_LE(b.controller.lit().t_ns, off->t_shown_ns);
  const std::vector<std::uint32_t> tags = {31, 32};
  ASSERT_TRUE(b.array->upload_table(patterns, tags));
  for (const std::uint32_t tag : tags) {
    const auto step = b.array->step_table();
    ASSERT_TRUE(step) << step.error().what;
    EXPECT_EQ(b.controller.lit().tag, tag);
    EXPECT_LE(b.controller.lit().t_ns, step->t_shown_ns);
  }
}

TEST(RegisterLightArray, ALightThatDoesNotComeInTimeIsAFaultThatSaysSo) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  b.controller.set_late_acting({.fraction = 1.0,
                                .least = std::chrono::milliseconds(300),
                                .most = std::chrono::milliseconds(300)});
  const std::vector<ElementLevel> pattern = {{7, 1234}};
  const auto receipt = b.array->show(pattern, 5);
  ASSERT_FALSE(receipt);
  EXPECT_EQ(receipt.error().code, Errc::protocol);
  EXPECT_THAT(receipt.error().what, testing::HasSubstr("as before, 10"));
  EXPECT_THAT(receipt.error().what, testing::HasSubstr(" ms after it acknowledged"));
  // Connecting to it goes dark first: what waits must not light up behind our back.
  b.controller.set_late_acting({});
  b.now += 400 * kMs;
  ASSERT_TRUE(b.array->show(pattern, 6));
  EXPECT_EQ(b.controller.lit().tag, 6U);
}

TEST(RegisterLightArray, APartOfTheTableRunsByTheStrobeAndIsExtended) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<std::vector<ElementLevel>> patterns = {
      {{0, 65535}}, {{1, 65535}}, {{2, 65535}}, {{3, 65535}}};
  const std::vector<std::uint32_t> tags = {11, 12, 13, 14};
  ASSERT_TRUE(b.array->upload_table(patterns, tags));
  ASSERT_TRUE(b.array->arm_strobe({.first = 1, .count = 1}));
  b.controller.strobe(b.now);
  EXPECT_EQ(b.array->status()->tag, 12U);
  ASSERT_TRUE(b.array->extend_strobe(3));
  b.controller.strobe(b.now);
  b.controller.strobe(b.now);
  EXPECT_EQ(b.array->status()->tag, 14U);
  EXPECT_FALSE(b.array->status()->is_table_done);
  b.controller.strobe(b.now);
  const auto done = b.array->status();
  EXPECT_TRUE(done->is_table_done);
  EXPECT_EQ(done->step_counter, 4U);
  const auto outside = b.array->arm_strobe({.first = 2, .count = 3});
  ASSERT_FALSE(outside);
  EXPECT_EQ(outside.error().code, Errc::refused);
}

TEST(RegisterLightArray, ATriggerDelayReachesTheController) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  ASSERT_TRUE(b.array->set_trigger_delay(std::chrono::microseconds(70000)));
  const std::vector<ElementLevel> pattern = {{7, 1234}};
  ASSERT_TRUE(b.array->show(pattern, 5));
  EXPECT_EQ(b.controller.n_triggers(), 1U);
  EXPECT_FALSE(b.array->set_trigger_delay(std::chrono::seconds(2)));
}

// What other vendors' firmware, or an older one of ours, has not.
TEST(RegisterLightArray, NoTriggerIsRequestedOfAControllerWithoutATriggerLine) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const FakeBusFault unknown{.answer = registers::Exception::illegal_address};
  b.faults[b.n_requests] = unknown;
  const auto none = b.array->set_trigger_delay(std::chrono::microseconds(0));
  EXPECT_TRUE(none) << none.error().what;
  EXPECT_EQ(b.array->link_state(), LinkState::up);
  b.faults[b.n_requests] = unknown;
  const auto some = b.array->set_trigger_delay(std::chrono::microseconds(500));
  ASSERT_FALSE(some);
  EXPECT_EQ(some.error().code, Errc::unsupported);
  EXPECT_THAT(some.error().what, testing::HasSubstr("no trigger line"));
}

TEST(RegisterLightArray, StepAfterARestartIsRefused) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<std::vector<ElementLevel>> patterns = {{{0, 65535}}};
  const std::vector<std::uint32_t> tags = {11};
  ASSERT_TRUE(b.array->upload_table(patterns, tags));
  b.controller.reboot(5, b.now);
  const auto receipt = b.array->step_table();
  ASSERT_FALSE(receipt);
  EXPECT_EQ(receipt.error().code, Errc::refused);
  EXPECT_TRUE(lit_by(b.controller).empty());
}

TEST(RegisterLightArray, DisconnectGoesDark) {
  Bench b(wide_config(64));
  ASSERT_TRUE(b.array->connect());
  const std::vector<ElementLevel> pattern = {{7, 1234}};
  ASSERT_TRUE(b.array->show(pattern, 5));
  b.array->disconnect();
  EXPECT_TRUE(lit_by(b.controller).empty());
  const auto status = b.array->status();
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().code, Errc::device_gone);
}

// Whatever request fails, in whatever way: a call that reports success has done its work, and
// calling again brings the array back.
TEST(RegisterLightArray, FaultAtEveryRequestIsSurvived) {
  const std::vector<std::vector<ElementLevel>> patterns = {
      {{0, 65535}}, {{1, 500}, {50, 65535}}, {{1, 65535}}};
  int n_total = 0;
  {
    Bench b(wide_config(64));
    ASSERT_TRUE(b.array->connect());
    for (std::size_t i = 0; i < patterns.size(); ++i) {
      ASSERT_TRUE(b.array->show(patterns[i], static_cast<std::uint32_t>(i + 1)));
    }
    ASSERT_TRUE(b.array->all_off());
    n_total = b.n_requests;
  }
  ASSERT_GT(n_total, 20);
  for (const Errc code : {Errc::timeout, Errc::device_gone, Errc::protocol, Errc::io}) {
    for (const bool acts : {false, true}) {
      for (int at = 0; at < n_total; ++at) {
        SCOPED_TRACE(testing::Message()
                     << to_string(code) << (acts ? " acted" : "") << " at " << at);
        Bench b(wide_config(64));
        b.faults[at] = {code, acts};
        int n_faults = 0;
        const auto until_done = [&](const auto& call) {
          for (int attempt = 0; attempt < 200; ++attempt) {
            if (call()) {
              return true;
            }
            ++n_faults;
          }
          return false;
        };
        ASSERT_TRUE(until_done([&] { return b.array->connect().has_value(); }));
        for (std::size_t i = 0; i < patterns.size(); ++i) {
          const auto tag = static_cast<std::uint32_t>(i + 1);
          ASSERT_TRUE(until_done([&] { return b.array->show(patterns[i], tag).has_value(); }));
          ASSERT_TRUE(is_same(lit_by(b.controller), patterns[i]));
          ASSERT_EQ(b.controller.lit().tag, tag);
        }
        ASSERT_TRUE(until_done([&] { return b.array->all_off().has_value(); }));
        ASSERT_TRUE(lit_by(b.controller).empty());
        // A fault is reported unless the controller's state was proven right afterwards.
        EXPECT_GE(n_faults, 1);
      }
    }
  }
}

RC_GTEST_PROP(RegisterLightArrayProperty, SuccessMeansExactlyThatPatternIsLit, ()) {
  Bench b(wide_config(200));
  const auto fault_every = *rc::gen::inRange(3, 60);
  const auto seed = *rc::gen::arbitrary<std::uint32_t>();
  std::uint32_t random = seed;
  const auto next = [&random](std::uint32_t n) {
    random = random * 1664525U + 1013904223U;
    return (random >> 8U) % n;
  };
  for (int i = 0; i < 2000; ++i) {
    if (next(static_cast<std::uint32_t>(fault_every)) == 0) {
      constexpr std::array kCodes = {Errc::timeout, Errc::device_gone, Errc::protocol};
      b.faults[i] = {kCodes[next(3)], next(2) == 0};
    }
  }
  [[maybe_unused]] const auto connected = b.array->connect();
  for (std::uint32_t tag = 1; tag < 40; ++tag) {
    std::vector<ElementLevel> pattern;
    const std::uint32_t density = next(4) == 0 ? 2 : 60;
    for (int k = 0; k < 200; ++k) {
      if (next(density) == 0) {
        const std::uint16_t level =
            next(3) == 0 ? static_cast<std::uint16_t>(next(65536)) : std::uint16_t{65535};
        pattern.push_back({k, level});
      }
    }
    b.now += next(3000) * kMs;  // sometimes beyond the lease
    if (next(20) == 0) {
      b.controller.reboot(100 + tag, b.now);
    }
    const auto receipt = b.array->show(pattern, tag);
    if (receipt) {
      std::erase_if(pattern, [](const ElementLevel& e) { return e.level == 0; });
      RC_ASSERT(is_same(lit_by(b.controller), pattern));
      RC_ASSERT(b.controller.lit().tag == tag);
      RC_ASSERT(receipt->tag_echo == tag);
      RC_ASSERT(b.controller.lit().t_ns >= receipt->t_command_ns);
      RC_ASSERT(b.controller.lit().t_ns <= receipt->t_ack_ns);
    }
  }
}

}  // namespace
}  // namespace haarlight::firmware_iface
