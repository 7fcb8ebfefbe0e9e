// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <vector>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "firmware_iface/light_controller.h"
#include "tests/firmware_iface/controller_fixture.h"

/// @file
/// Random sequences of requests and events against an independent model: plain arrays, power
/// added up in 128-bit integers, the lease as one number.

namespace haarlight::firmware_iface {
namespace {

using registers::Exception;
namespace hold = registers::holding;

constexpr int kElements = 16;

enum class OpKind {
  level,
  on,
  latch,
  latch_with_sum,
  store,
  arm,
  step,
  strobe,
  renew,
  all_off,
  limit,
  interlock,
  reboot,
  wait,
};

struct Op {
  OpKind kind = OpKind::wait;
  int element = 0;
  std::uint16_t value = 0;
  std::int64_t dt_ns = 0;
};

std::ostream& operator<<(std::ostream& out, const Op& op) {
  return out << "{" << static_cast<int>(op.kind) << " e" << op.element << " v" << op.value
             << " +" << op.dt_ns << "}";
}

rc::Gen<Op> any_op() {
  return rc::gen::apply(
      [](int kind, int element, std::uint16_t value, int dt_ms) {
        return Op{static_cast<OpKind>(kind), element, value,
                  static_cast<std::int64_t>(dt_ms) * kMs};
      },
      rc::gen::inRange(0, 14), rc::gen::inRange(0, kElements),
      rc::gen::oneOf(rc::gen::arbitrary<std::uint16_t>(),
                     rc::gen::element<std::uint16_t>(0, 1, 2, 65535)),
      rc::gen::inRange(0, 400));
}

/// What is expected by hand calculation.
struct Model {
  std::array<std::uint16_t, kElements> levels{};
  std::array<bool, kElements> is_on{};
  std::int64_t lease_from_ns = 0;

  [[nodiscard]] std::vector<std::uint16_t> bank() const {
    std::vector<std::uint16_t> shown(kElements);
    for (std::size_t k = 0; k < kElements; ++k) {
      shown[k] = is_on[k] ? levels[k] : std::uint16_t{0};
    }
    return shown;
  }
};

std::vector<std::uint16_t> lit_levels(const LightController& c) {
  std::vector<std::uint16_t> lit(kElements);
  for (int k = 0; k < kElements; ++k) {
    lit[static_cast<std::size_t>(k)] = c.lit().level(k);
  }
  return lit;
}

bool is_dark(const LightController& c) { return c.lit().pattern->empty(); }

/// Level units of 5 W elements: 20 W are 4 full elements, 30 W are 6.
bool is_within_limits(const std::vector<std::uint16_t>& lit, std::uint64_t limit_deciwatt) {
  constexpr unsigned long long kFull = 65535;
  unsigned long long total = 0;
  for (std::size_t g = 0; g < 2; ++g) {
    unsigned long long group = 0;
    for (std::size_t k = 8 * g; k < 8 * g + 8; ++k) {
      group += lit[k];
    }
    if (group > 4 * kFull) {
      return false;
    }
    total += group;
  }
  return total * 50 <= limit_deciwatt * kFull;  // 5 W = 50 x 0.1 W
}

/// A controller and what is expected of it.
struct Play {
  LightController c{small_config(), 1, 0};
  Model model;
  std::vector<std::vector<std::uint16_t>> table = std::vector<std::vector<std::uint16_t>>(8);
  std::vector<bool> is_stored = std::vector<bool>(8);
  std::uint64_t limit_deciwatt = 300;
  std::int64_t now = 0;
  std::uint32_t tag = 0;
  bool is_interlock_open = false;
  std::uint32_t boot = 1;
  std::vector<std::uint16_t> before;  ///< lit before the request

  void run(const Op& op) {
    now += op.dt_ns;
    // No thermal limit here: the only deadline is the lease.
    const std::int64_t deadline = c.next_deadline_ns();
    RC_ASSERT(is_dark(c) || deadline == model.lease_from_ns + 1000 * kMs);
    c.advance(now);
    if (deadline <= now) {
      RC_ASSERT(is_dark(c));
      RC_ASSERT(c.lit().t_ns == deadline);
      model.is_on.fill(false);
    }
    before = lit_levels(c);
    const auto k = static_cast<std::size_t>(op.element);
    switch (op.kind) {
      case OpKind::level:
        RC_ASSERT(set_level(c, op.element, op.value, now) == Exception::none);
        model.levels[k] = op.value;
        RC_ASSERT(lit_levels(c) == before);
        break;
      case OpKind::on:
        RC_ASSERT(set_on(c, op.element, op.value > 1, now) == Exception::none);
        model.is_on[k] = op.value > 1;
        RC_ASSERT(lit_levels(c) == before);
        break;
      case OpKind::latch:
      case OpKind::latch_with_sum:
        latch_bank(op);
        break;
      case OpKind::store:
        store(op);
        break;
      case OpKind::arm:
        arm(op);
        break;
      case OpKind::step:
      case OpKind::strobe:
        step(op);
        break;
      case OpKind::renew:
        RC_ASSERT(write_words(c, hold::kLeaseRenew, {1}, now) == Exception::none);
        model.lease_from_ns = now;
        break;
      case OpKind::all_off:
        RC_ASSERT(write_words(c, hold::kAllOff, {op.value}, now) == Exception::none);
        RC_ASSERT(is_dark(c));
        model.is_on.fill(false);
        break;
      case OpKind::limit:
        set_limit(op);
        break;
      case OpKind::interlock:
        is_interlock_open = op.value % 2 == 1;
        c.set_interlock_open(is_interlock_open, now);
        if (is_interlock_open) {
          RC_ASSERT(is_dark(c));
          model.is_on.fill(false);
        }
        break;
      case OpKind::reboot:
        c.reboot(++boot, now);
        model = Model{};
        model.lease_from_ns = now;
        limit_deciwatt = 300;
        table.assign(8, {});
        is_stored.assign(8, false);
        RC_ASSERT(is_dark(c));
        break;
      case OpKind::wait:
        break;
    }
    RC_ASSERT(is_within_limits(lit_levels(c), limit_deciwatt));
    RC_ASSERT(!is_interlock_open || is_dark(c));
    std::vector<ElementLevel> lit(*c.lit().pattern);
    RC_ASSERT(status_of(c, now).shown_sum == bank_sum(lit));
  }

  void latch_bank(const Op& op) {
    ++tag;
    std::vector<ElementLevel> pattern;
    pattern.reserve(kElements);
    for (int e = 0; e < kElements; ++e) {
      pattern.push_back({e, model.bank()[static_cast<std::size_t>(e)]});
    }
    const std::uint32_t sum = bank_sum(pattern);
    const bool is_plain = op.kind == OpKind::latch;
    const bool is_wrong = !is_plain && op.value % 4 == 0;
    const std::uint32_t named = is_wrong ? sum + 1 : sum;
    const Exception answer =
        is_plain
            ? latch(c, tag, now)
            : write_words(c, hold::kTag,
                          {high_word(tag), low_word(tag), high_word(named), low_word(named), 1},
                          now);
    const bool is_allowed = is_within_limits(model.bank(), limit_deciwatt) &&
                            (!is_interlock_open || sum == 0) && !is_wrong;
    RC_ASSERT((answer == Exception::none) == is_allowed);
    if (is_allowed) {
      RC_ASSERT(lit_levels(c) == model.bank());  // whole, and nothing else
      RC_ASSERT(c.lit().tag == tag);
      RC_ASSERT(c.lit().t_ns == now);
      model.lease_from_ns = now;
    } else {
      RC_ASSERT(is_dark(c));
    }
  }

  void store(const Op& op) {
    const auto entry = static_cast<std::uint16_t>(op.element % 8);
    ++tag;
    RC_ASSERT(write_words(c, hold::kTag, {high_word(tag), low_word(tag)}, now) ==
              Exception::none);
    const Exception answer = write_words(c, hold::kTableStore, {entry}, now);
    if (answer == Exception::none) {
      table[entry] = model.bank();
      is_stored[entry] = true;
      RC_ASSERT(lit_levels(c) == before);
    } else {
      RC_ASSERT(is_dark(c));
    }
  }

  void arm(const Op& op) {
    const auto entry = static_cast<std::uint16_t>(op.element % 8);
    const bool is_whole = std::all_of(is_stored.begin(), is_stored.begin() + entry,
                                      [](bool stored) { return stored; });
    const Exception answer = write_words(
        c, hold::kStepSource, {static_cast<std::uint16_t>(op.value % 2), entry}, now);
    RC_ASSERT((answer == Exception::none) == is_whole);
    RC_ASSERT(is_dark(c));
    if (is_whole) {
      model.lease_from_ns = now;
    }
  }

  void step(const Op& op) {
    const std::uint32_t steps = status_of(c, now).status.step_counter;
    if (op.kind == OpKind::step) {
      static_cast<void>(write_words(c, hold::kStep, {1}, now));
      model.lease_from_ns = now;
    } else {
      c.strobe(now);
    }
    if (lit_levels(c) != before && !is_dark(c)) {
      RC_ASSERT(steps < table.size());
      RC_ASSERT(lit_levels(c) == table[steps]);
      RC_ASSERT(status_of(c, now).status.step_counter == steps + 1);
    }
  }

  void set_limit(const Op& op) {
    const auto requested = static_cast<std::uint16_t>(op.value % 400);
    const Exception answer = write_words(c, hold::kPowerLimit, {0, requested}, now);
    RC_ASSERT((answer == Exception::none) == (requested <= 300));
    if (answer == Exception::none) {
      limit_deciwatt = requested;
      if (is_dark(c) && std::any_of(before.begin(), before.end(),
                                    [](std::uint16_t level) { return level > 0; })) {
        model.is_on.fill(false);  // cut like an all-off
      }
    }
  }

  /// Silence: dark within the lease, and the on-time is what the history says.
  void end() {
    const std::int64_t t_end = now + 2000 * kMs;
    c.advance(t_end);
    RC_ASSERT(is_dark(c));
    const LightHistory history = c.transitions(0, t_end);
    RC_ASSERT(history.is_complete);
    for (int e = 0; e < kElements; ++e) {
      RC_ASSERT(std::abs(on_seconds(history, e, 0, t_end) - c.total_on_seconds(e)) < 1e-9);
    }
  }
};

RC_GTEST_PROP(LightControllerProperty, AnySequenceKeepsItsPromises, ()) {
  const auto ops = *rc::gen::resize(400, rc::gen::container<std::vector<Op>>(any_op()));
  Play play;
  for (const Op& op : ops) {
    play.run(op);
  }
  play.end();
}

RC_GTEST_PROP(BankSum, OneChangedLevelChangesTheSum,
              (std::uint16_t element, std::uint16_t level, std::uint16_t other)) {
  RC_PRE(level != other);
  const int k = element % registers::kMaxElements;
  RC_ASSERT(bank_sum_term(k, level) != bank_sum_term(k, other));
}

}  // namespace
}  // namespace haarlight::firmware_iface
