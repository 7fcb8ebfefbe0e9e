// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/register_light_array.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;
namespace in = registers::input;
namespace hold = registers::holding;

// Unchanged neighbours are written too when that is cheaper than another request: one more RTU
// request and its answer cost about 9 + 8 bytes, a register 2 bytes, eight bits 1 byte.
constexpr std::size_t kLevelGap = 8;
constexpr std::size_t kBitGap = 136;

/// Runs [first, end) that cover every index where `is_changed` holds, closer than `gap` joined,
/// no longer than `longest`.
template <class IsChanged, class Write>
Result<void> write_runs(std::size_t n, std::size_t gap, std::size_t longest,
                        IsChanged is_changed, Write write) {
  std::size_t i = 0;
  while (i < n) {
    if (!is_changed(i)) {
      ++i;
      continue;
    }
    const std::size_t first = i;
    std::size_t end = i + 1;
    for (std::size_t k = end; k < n && k < first + longest && k <= end + gap; ++k) {
      if (is_changed(k)) {
        end = k + 1;
      }
    }
    if (auto done = write(first, end); !done) {
      return done;
    }
    i = end;
  }
  return {};
}

}  // namespace

RegisterLightArray::RegisterLightArray(std::unique_ptr<RegisterBus> bus,
                                       RegisterLightArrayOptions options, NanosecondClock clock)
    : link_(std::move(bus), std::move(clock)), options_(options) {
  HAARLIGHT_EXPECTS(options_.n_elements > 0 && options_.n_elements <= registers::kMaxElements,
                    "1 to kMaxElements elements");
  const auto n = static_cast<std::size_t>(options_.n_elements);
  on_.resize(n);
  levels_.resize(n, -1);
  wanted_.resize(n);
}

RegisterLightArray::~RegisterLightArray() { disconnect(); }

// ---- link ----

Result<void> RegisterLightArray::make_ready(RetryPolicy retry_policy) {
  return link_.make_ready(retry_policy, [this] { return resynchronise(); });
}

Result<void> RegisterLightArray::prove_line() {
  // A late answer to an earlier request cannot hold a number that was never used before.
  echo_ = echo_ * 1664525U + 1013904223U + static_cast<std::uint32_t>(link_.now_ns());
  const std::array<std::uint16_t, 2> sent = {high_word(echo_), low_word(echo_)};
  if (auto ok = demand(link_.bus().write_holding(hold::kEcho, sent), "writing the echo"); !ok) {
    return ok;
  }
  std::array<std::uint16_t, 2> got{};
  if (auto ok = demand(link_.bus().read_holding(hold::kEcho, got), "reading the echo"); !ok) {
    return ok;
  }
  if (got != sent) {
    return link_.lose(
        Fault{Errc::protocol,
              fmt::format("{}: echo is {:#010x}, expected {:#010x}: answers out of step",
                          name(), join_words(got[0], got[1]), echo_),
              0, __FILE__, __LINE__});
  }
  return {};
}

Result<void> RegisterLightArray::resynchronise() {
  const std::optional<ControllerIdentity> before = identity_;
  if (auto proven = prove_line(); !proven) {
    return proven;
  }
  auto identity = read_identity();
  if (!identity) {
    return tl::unexpected<Fault>(identity.error());
  }
  auto block = read_status();
  if (!block) {
    return tl::unexpected<Fault>(block.error());
  }
  if (before && before->serial != identity->serial) {
    return link_.lose(Fault{Errc::protocol,
                            fmt::format("{}: controller {} answers, {} was connected", name(),
                                        identity->serial, before->serial),
                            0, __FILE__, __LINE__});
  }
  identity->boot_id = block->status.boot_id;
  identity->uptime_ms = block->status.uptime_ms;
  identity_ = *identity;
  std::uint32_t believed_sum = 0;
  for (std::size_t k = 0; k < on_.size(); ++k) {
    if (on_[k] != 0 && levels_[k] > 0) {
      believed_sum +=
          bank_sum_term(static_cast<int>(k), static_cast<std::uint16_t>(levels_[k]));
    }
  }
  const bool is_same = before && before->boot_id == identity->boot_id && is_bank_certain_ &&
                       block->shadow_sum == believed_sum;
  if (!is_same) {
    if (!before || before->boot_id != identity->boot_id) {
      table_.clear();
    }
    std::fill(levels_.begin(), levels_.end(), -1);
    if (auto dark = all_off_unchecked(); !dark) {
      return dark;
    }
    block = await_shown(0, 0);
    if (!block) {
      return tl::unexpected<Fault>(block.error());
    }
    if (!block->status.is_dark || block->status.tag != 0 || block->shadow_sum != 0) {
      return link_.lose(Fault{Errc::protocol,
                              name() + ": ALL_OFF was accepted, yet it is not dark", 0,
                              __FILE__, __LINE__});
    }
  }
  const std::vector<std::uint16_t> words = {static_cast<std::uint16_t>(options_.lease.count())};
  if (auto ok = demand(link_.bus().write_holding(hold::kLeaseMs, words), "setting the lease");
      !ok) {
    return ok;
  }
  if (auto limited = set_power_limit(); !limited) {
    return limited;
  }
  link_.on(LinkEvent::resynchronised);
  return {};
}

Result<void> RegisterLightArray::set_power_limit() {
  if (!options_.power_limit) {
    return {};
  }
  // Rounded down, and never above the controller's hard limit.
  const double requested_dw = std::floor(options_.power_limit->value() * 10.0 + 1e-6);
  const auto limit = static_cast<std::uint32_t>(
      std::clamp(requested_dw, 0.0, static_cast<double>(hard_limit_dw_)));
  const std::array<std::uint16_t, 2> words = {high_word(limit), low_word(limit)};
  if (auto ok = demand(link_.bus().write_holding(hold::kPowerLimit, words),
                       "setting the power limit");
      !ok) {
    return ok;
  }
  std::array<std::uint16_t, 2> got{};
  if (auto ok =
          demand(link_.bus().read_holding(hold::kPowerLimit, got), "reading the power limit");
      !ok) {
    return ok;
  }
  if (got != words) {
    return link_.lose(
        Fault{Errc::protocol,
              fmt::format("{}: the power limit was set to {} W and reads {} W", name(),
                          limit / 10.0, join_words(got[0], got[1]) / 10.0),
              0, __FILE__, __LINE__});
  }
  return {};
}

Result<ControllerIdentity> RegisterLightArray::read_identity() {
  std::array<std::uint16_t, in::kIdentityCount> words{};
  if (auto ok = demand(link_.bus().read_input(in::kMagic, words), "reading the identity");
      !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  auto identity = decode_identity(words);
  if (!identity) {
    return link_.lose(identity.error());
  }
  hard_limit_dw_ = join_words(words[in::kHardPowerLimit - in::kMagic],
                              words[in::kHardPowerLimit + 1 - in::kMagic]);
  if (identity->n_elements < options_.n_elements) {
    return link_.lose(Fault{Errc::unsupported,
                            fmt::format("{}: the controller has {} elements, the rig {}",
                                        name(), identity->n_elements, options_.n_elements),
                            0, __FILE__, __LINE__});
  }
  return identity;
}

Result<StatusBlock> RegisterLightArray::read_status() {
  std::array<std::uint16_t, in::kStatusCount> words{};
  if (auto ok = demand(link_.bus().read_input(in::kStatusFirst, words), "reading the status");
      !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  auto block = decode_status(words);
  if (!block) {
    return link_.lose(block.error());
  }
  shown_ = {block->status.tag, block->shown_sum};
  return block;
}

Fault RegisterLightArray::refusal_fault(Exception exception, const char* operation) {
  const auto number = static_cast<int>(exception);
  switch (exception) {
    case Exception::device_failure: {
      const auto block = read_status();
      const bool is_for_now =
          block && (block->refusal == registers::Refusal::element_duty ||
                    block->refusal == registers::Refusal::over_temperature ||
                    block->refusal == registers::Refusal::interlock);
      return {is_for_now ? Errc::device_busy : Errc::refused,
              fmt::format("{}: {} refused: {}", name(), operation,
                          block ? reason_of(block->refusal) : "reason not readable"),
              0, __FILE__, __LINE__};
    }
    case Exception::bank_sum:
      is_bank_certain_ = false;
      link_.on(LinkEvent::doubt);
      return {Errc::protocol,
              fmt::format("{}: {} refused: {}", name(), operation,
                          reason_of(registers::Refusal::bank_sum)),
              0, __FILE__, __LINE__};
    case Exception::busy:
      link_.on(LinkEvent::doubt);
      return {Errc::device_busy, fmt::format("{}: {}: busy", name(), operation), 0, __FILE__,
              __LINE__};
    case Exception::gateway_target:
      link_.on(LinkEvent::fault_gone);
      return {Errc::device_gone,
              fmt::format("{}: {}: the gateway does not reach the unit", name(), operation), 0,
              __FILE__, __LINE__};
    case Exception::illegal_value:
      return {Errc::refused, fmt::format("{}: {}: value out of range", name(), operation), 0,
              __FILE__, __LINE__};
    case Exception::none:
    case Exception::illegal_function:
    case Exception::illegal_address:
      break;
  }
  // The controller lacks a register of the map, or invents exceptions.
  is_bank_certain_ = false;
  link_.on(LinkEvent::doubt);
  return {Errc::protocol, fmt::format("{}: {}: Modbus exception {}", name(), operation, number),
          0, __FILE__, __LINE__};
}

Result<void> RegisterLightArray::demand(Result<Exception> answer, const char* operation) {
  if (!answer) {
    answer.error().what = fmt::format("{}: {}", operation, answer.error().what);
    return link_.lose(answer.error());
  }
  if (*answer != Exception::none) {
    return tl::unexpected<Fault>(refusal_fault(*answer, operation));
  }
  return {};
}

Result<ControllerIdentity> RegisterLightArray::connect() {
  link_.close();
  identity_.reset();
  is_bank_certain_ = false;
  if (auto ready = make_ready(RetryPolicy::at_once); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  return *identity_;
}

void RegisterLightArray::disconnect() noexcept {
  try {
    if (link_.state() == LinkState::up || link_.state() == LinkState::unknown) {
      // One attempt; the lease takes over where it fails.
      [[maybe_unused]] const auto dark = all_off();
    }
  } catch (...) {  // out of memory while formatting a message: the lease turns the lights off
  }
  link_.close();
}

// ---- light ----

Result<void> RegisterLightArray::check_pattern(std::span<const ElementLevel> pattern,
                                               std::uint32_t tag) const {
  if (tag == 0) {
    return fail(Errc::refused, name() + ": tag 0 stands for dark; a pattern needs another one");
  }
  std::vector<bool> is_seen(wanted_.size());
  for (const ElementLevel& e : pattern) {
    if (e.element < 0 || e.element >= options_.n_elements) {
      return fail(Errc::refused, fmt::format("{}: element {} of a rig of {}", name(), e.element,
                                             options_.n_elements));
    }
    const auto k = static_cast<std::size_t>(e.element);
    if (is_seen[k]) {
      return fail(Errc::refused,
                  fmt::format("{}: element {} twice in a pattern", name(), e.element));
    }
    is_seen[k] = true;
  }
  return {};
}

Result<void> RegisterLightArray::write_levels() {
  const auto is_changed = [this](std::size_t k) {
    return wanted_[k] > 0 && levels_[k] != wanted_[k];
  };
  std::vector<std::uint16_t> words;
  return write_runs(
      wanted_.size(), kLevelGap, registers::kMaxRegistersWritten, is_changed,
      [&](std::size_t first, std::size_t end) -> Result<void> {
        words.clear();
        for (std::size_t k = first; k < end; ++k) {
          const auto held = static_cast<std::uint16_t>(std::max(levels_[k], 0));
          words.push_back(wanted_[k] > 0 ? wanted_[k] : held);
        }
        auto ok = demand(
            link_.bus().write_holding(static_cast<std::uint16_t>(hold::kLevels + first), words),
            "writing levels");
        if (ok) {
          std::copy(words.begin(), words.end(),
                    levels_.begin() + static_cast<std::ptrdiff_t>(first));
        }
        return ok;
      });
}

Result<void> RegisterLightArray::write_on_bits() {
  const auto is_wanted = [this](std::size_t k) { return wanted_[k] > 0 ? 1 : 0; };
  std::vector<std::uint8_t> bits;
  return write_runs(
      wanted_.size(), kBitGap, registers::kMaxCoilsWritten,
      [&](std::size_t k) { return on_[k] != is_wanted(k); },
      [&](std::size_t first, std::size_t end) -> Result<void> {
        bits.clear();
        for (std::size_t k = first; k < end; ++k) {
          bits.push_back(static_cast<std::uint8_t>(is_wanted(k)));
        }
        auto ok = demand(link_.bus().write_coils(static_cast<std::uint16_t>(first), bits),
                         "writing on bits");
        if (ok) {
          std::copy(bits.begin(), bits.end(), on_.begin() + static_cast<std::ptrdiff_t>(first));
        }
        return ok;
      });
}

Result<void> RegisterLightArray::write_bank(std::span<const ElementLevel> pattern) {
  std::fill(wanted_.begin(), wanted_.end(), std::uint16_t{0});
  for (const ElementLevel& e : pattern) {
    wanted_[static_cast<std::size_t>(e.element)] = e.level;
  }
  is_bank_certain_ = false;  // until every write is confirmed
  if (auto ok = write_levels(); !ok) {
    return ok;
  }
  if (auto ok = write_on_bits(); !ok) {
    return ok;
  }
  is_bank_certain_ = true;
  return {};
}

Result<StatusBlock> RegisterLightArray::await_shown(std::uint32_t tag, std::uint32_t sum) {
  const TableProof before = shown_;
  const std::int64_t deadline_ns = link_.now_ns() + kShownWithinNs;
  for (;;) {
    auto block = read_status();
    const bool is_as_before = block && shown_ == before && shown_ != TableProof{tag, sum} &&
                              block->status.boot_id == identity_->boot_id;
    if (!is_as_before || link_.now_ns() >= deadline_ns) {
      return block;
    }
  }
}

Result<void> RegisterLightArray::confirm_shown(std::uint32_t tag, std::uint32_t sum,
                                               LatchReceipt& receipt) {
  const TableProof before = shown_;
  const auto block = await_shown(tag, sum);
  if (!block) {
    return tl::unexpected<Fault>(block.error());
  }
  receipt.t_shown_ns = link_.now_ns();
  receipt.tag_echo = block->status.tag;
  if (shown_ != TableProof{tag, sum} || block->status.boot_id != identity_->boot_id) {
    is_bank_certain_ = false;
    link_.on(LinkEvent::doubt);
    const bool is_late = shown_ == before;
    return fail(
        Errc::protocol,
        fmt::format("{}: shows tag {} with sum {:#010x} (start {:#x}), expected tag {} "
                    "with sum {:#010x} (start {:#x}){}",
                    name(), block->status.tag, block->shown_sum, block->status.boot_id, tag,
                    sum, identity_->boot_id,
                    is_late ? fmt::format(": as before, {} ms after it acknowledged the change",
                                          (receipt.t_shown_ns - receipt.t_ack_ns) / 1'000'000)
                            : ""));
  }
  return {};
}

Result<LatchReceipt> RegisterLightArray::show(std::span<const ElementLevel> pattern,
                                              std::uint32_t tag) {
  if (auto ok = check_pattern(pattern, tag); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  auto receipt = latch_pattern(pattern, tag);
  if (!receipt && link_.state() == LinkState::unknown && is_bank_stale_) {
    // The controller refused and is dark: its bank was cleared without our doing (lease,
    // all-off by another host, restart). Every request was answered, so writing again is no
    // replay.
    if (auto ok = resynchronise(); !ok) {
      return tl::unexpected<Fault>(ok.error());
    }
    receipt = latch_pattern(pattern, tag);
  }
  return receipt;
}

Result<LatchReceipt> RegisterLightArray::latch_pattern(std::span<const ElementLevel> pattern,
                                                       std::uint32_t tag) {
  is_bank_stale_ = false;
  if (auto ok = write_bank(pattern); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  const std::uint32_t sum = bank_sum(pattern);
  const std::array<std::uint16_t, 5> words = {high_word(tag), low_word(tag), high_word(sum),
                                              low_word(sum), registers::kAct};
  LatchReceipt receipt;
  receipt.t_command_ns = link_.now_ns();
  auto answer = link_.bus().write_holding(hold::kTag, words);
  receipt.t_ack_ns = link_.now_ns();
  is_bank_stale_ = answer && *answer == Exception::bank_sum;
  if (auto ok = demand(std::move(answer), "latching"); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  if (auto shown = confirm_shown(tag, sum, receipt); !shown) {
    return tl::unexpected<Fault>(shown.error());
  }
  return receipt;
}

Result<void> RegisterLightArray::all_off_unchecked() {
  const std::array<std::uint16_t, 1> word = {registers::kAct};
  is_bank_certain_ = false;
  auto ok = demand(link_.bus().write_holding(hold::kAllOff, word), "ALL_OFF");
  if (ok) {
    std::fill(on_.begin(), on_.end(), std::uint8_t{0});
    is_bank_certain_ = true;
  }
  return ok;
}

Result<LatchReceipt> RegisterLightArray::all_off() {
  if (auto ok = make_ready(RetryPolicy::at_once); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  LatchReceipt receipt;
  receipt.t_command_ns = link_.now_ns();
  auto ok = all_off_unchecked();
  receipt.t_ack_ns = link_.now_ns();
  if (!ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  if (auto shown = confirm_shown(0, 0, receipt); !shown) {
    return tl::unexpected<Fault>(shown.error());
  }
  return receipt;
}

Result<void> RegisterLightArray::renew_lease() {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return ok;
  }
  // The length is sent too: a controller that restarted would otherwise use its default.
  const std::array<std::uint16_t, 2> words = {
      static_cast<std::uint16_t>(options_.lease.count()), registers::kAct};
  return demand(link_.bus().write_holding(hold::kLeaseMs, words), "renewing the lease");
}

Result<ControllerStatus> RegisterLightArray::status() {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  const auto block = read_status();
  if (!block) {
    return tl::unexpected<Fault>(block.error());
  }
  if (block->status.boot_id != identity_->boot_id) {
    is_bank_certain_ = false;
    link_.on(LinkEvent::doubt);  // it restarted: dark, bank and table lost
  }
  return block->status;
}

// ---- table ----

Result<void> RegisterLightArray::upload_table(
    std::span<const std::vector<ElementLevel>> patterns, std::span<const std::uint32_t> tags) {
  HAARLIGHT_EXPECTS(patterns.size() == tags.size(), "one tag per pattern");
  for (std::size_t i = 0; i < patterns.size(); ++i) {
    if (auto ok = check_pattern(patterns[i], tags[i]); !ok) {
      return ok;
    }
  }
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return ok;
  }
  if (patterns.size() > static_cast<std::size_t>(identity_->table_depth)) {
    return fail(Errc::refused, fmt::format("{}: {} patterns, the table holds {}", name(),
                                           patterns.size(), identity_->table_depth));
  }
  table_.clear();
  for (std::size_t i = 0; i < patterns.size(); ++i) {
    if (auto ok = write_bank(patterns[i]); !ok) {
      return ok;
    }
    const std::uint32_t sum = bank_sum(patterns[i]);
    const std::array<std::uint16_t, 6> words = {
        high_word(tags[i]),           low_word(tags[i]), high_word(sum), low_word(sum), 0,
        static_cast<std::uint16_t>(i)};
    if (auto ok = demand(link_.bus().write_holding(hold::kTag, words), "storing a table entry");
        !ok) {
      return ok;
    }
    table_.push_back({tags[i], sum});
  }
  return arm_table(registers::StepSource::host);
}

Result<void> RegisterLightArray::arm_table(registers::StepSource source) {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return ok;
  }
  const std::array<std::uint16_t, 2> words = {static_cast<std::uint16_t>(source),
                                              static_cast<std::uint16_t>(table_.size())};
  steps_taken_ = 0;
  auto ok = demand(link_.bus().write_holding(hold::kStepSource, words), "arming the table");
  shown_ = ok ? TableProof{} : shown_;
  return ok;
}

Result<LatchReceipt> RegisterLightArray::arm_strobe(const StrobeRun& run) {
  const bool is_sane =
      run.first >= 0 && run.count > 0 && run.divider >= 1 &&
      run.divider <= registers::kMaxStrobeDivider &&
      static_cast<std::size_t>(run.first) + static_cast<std::size_t>(run.count) <=
          table_.size();
  if (!is_sane) {
    return fail(Errc::refused,
                fmt::format("{}: entries {} .. {} of a table of {}, every {} strobes", name(),
                            run.first, run.first + run.count - 1, table_.size(), run.divider));
  }
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  const std::array<std::uint16_t, 4> words = {
      static_cast<std::uint16_t>(run.divider), static_cast<std::uint16_t>(run.first),
      static_cast<std::uint16_t>(registers::StepSource::strobe),
      static_cast<std::uint16_t>(run.count)};
  LatchReceipt receipt;
  receipt.t_command_ns = link_.now_ns();
  auto ok = demand(link_.bus().write_holding(hold::kStrobeDivider, words), "arming the table");
  receipt.t_ack_ns = link_.now_ns();
  if (!ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  shown_ = {};
  return receipt;
}

Result<void> RegisterLightArray::extend_strobe(int count) {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return ok;
  }
  const std::array<std::uint16_t, 1> word = {
      static_cast<std::uint16_t>(std::clamp(count, 0, 65535))};
  return demand(link_.bus().write_holding(hold::kTableExtend, word), "extending the table");
}

Result<void> RegisterLightArray::set_trigger_delay(std::chrono::microseconds delay) {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return ok;
  }
  const auto us = static_cast<std::uint32_t>(std::clamp<std::int64_t>(
      delay.count(), 0, std::int64_t{registers::kMaxTriggerDelayUs} + 1));
  const std::array<std::uint16_t, 2> words = {high_word(us), low_word(us)};
  const auto answer = link_.bus().write_holding(hold::kTriggerDelay, words);
  // A controller without the register has no trigger line: it sends no pulse, as requested.
  if (us == 0 && answer && *answer == Exception::illegal_address) {
    return {};
  }
  if (answer && *answer == Exception::illegal_address) {
    return fail(Errc::unsupported,
                fmt::format("{}: the controller has no register for a trigger delay, so no "
                            "trigger line: use another sync mode than controller-leads",
                            name()));
  }
  return demand(answer, "setting the trigger delay");
}

Result<LatchReceipt> RegisterLightArray::step_table() {
  if (auto ok = make_ready(RetryPolicy::patient); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  const std::array<std::uint16_t, 1> word = {registers::kAct};
  LatchReceipt receipt;
  receipt.t_command_ns = link_.now_ns();
  auto ok = demand(link_.bus().write_holding(hold::kStep, word), "stepping the table");
  receipt.t_ack_ns = link_.now_ns();
  if (!ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  const TableProof expected =
      steps_taken_ < table_.size() ? table_[steps_taken_] : TableProof{};
  ++steps_taken_;
  if (auto shown = confirm_shown(expected.tag, expected.sum, receipt); !shown) {
    return tl::unexpected<Fault>(shown.error());
  }
  return receipt;
}

}  // namespace haarlight::firmware_iface
