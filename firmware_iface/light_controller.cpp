// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/light_controller.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/random.h"
#include "firmware_iface/register_codec.h"
#include "haarlight/core/error.h"

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;
using registers::Refusal;
using registers::StepSource;
namespace in = registers::input;
namespace hold = registers::holding;

constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kNsPerMs = 1'000'000;
constexpr double kTooHot = 85.0;  // deg C, common rating of LED boards
constexpr double kFullDrive = 65535.0;
constexpr double kDutySlack =
    1e-3;  // an element cut at its limit stays refused until it has cooled

// The control registers, in ascending order; `words` 2 = high word at `address`.
struct ControlRegister {
  std::uint16_t address;
  std::uint16_t words;
};
constexpr ControlRegister kControls[] = {
    {hold::kTag, 2},         {hold::kExpectedSum, 2},   {hold::kLatch, 1},
    {hold::kTableStore, 1},  {hold::kStrobeDivider, 1}, {hold::kTableFirst, 1},
    {hold::kStepSource, 1},  {hold::kTableArm, 1},      {hold::kStep, 1},
    {hold::kTableExtend, 1}, {hold::kTriggerDelay, 2},  {hold::kLeaseMs, 1},
    {hold::kLeaseRenew, 1},  {hold::kAllOff, 1},        {hold::kPowerLimit, 2},
    {hold::kFaultClear, 2},  {hold::kEcho, 2},
};

/// Length of the control register that starts at `address`; 0 when none does.
std::size_t words_at(std::size_t address) {
  for (const ControlRegister& r : kControls) {
    if (r.address == address) {
      return r.words;
    }
  }
  return 0;
}

/// Whether [first, first + n) is made of whole control registers without gaps.
bool is_whole_control_range(std::size_t first, std::size_t n) {
  std::size_t address = first;
  while (address < first + n) {
    const std::size_t words = words_at(address);
    if (words == 0) {
      return false;
    }
    address += words;
  }
  return address == first + n;
}

std::uint64_t to_milliwatts(Watts power) {
  return static_cast<std::uint64_t>(std::llround(std::max(power.value(), 0.0) * 1000.0));
}

void put_long(std::span<std::uint16_t> block, std::size_t offset, std::uint32_t value) {
  block[offset] = high_word(value);
  block[offset + 1] = low_word(value);
}

}  // namespace

ControllerConfig controller_config(const Rig& rig) {
  ControllerConfig config;
  config.default_lease = rig.controller.lease;
  config.max_power = Watts(0.0);
  for (const Face& face : rig.faces) {
    const int first =
        config.groups.empty() ? 0 : config.groups.back().first + config.groups.back().count;
    if (face.string_lights > 0) {
      for (int k = 0; k < face.n_lights(); k += face.string_lights) {
        const int count = std::min(face.string_lights, face.n_lights() - k);
        config.groups.push_back({first + k, count, face.element_power, face.max_string_power});
      }
      config.supplies.push_back({first, face.n_lights(), face.element_power, face.max_power});
    } else {
      config.groups.push_back({first, face.n_lights(), face.element_power, face.max_power});
    }
    if (face.max_duty < config.duty_limit) {
      config.duty_limit = face.max_duty;
      config.heat_tau =
          std::chrono::milliseconds(std::max(1LL, std::llround(face.heat_tau_s * 1e3)));
    }
    config.max_power = config.max_power + face.max_power;
  }
  config.table_depth = std::max(config.table_depth, std::min(rig.n_lights(), 65534));
  return config;
}

LightController::LightController(ControllerConfig config, std::uint32_t boot_id,
                                 std::int64_t now_ns)
    : config_(std::move(config)), log_(config_.history), now_ns_(now_ns) {
  int n = 0;
  for (std::size_t g = 0; g < config_.groups.size(); ++g) {
    const ElementGroup& group = config_.groups[g];
    HAARLIGHT_EXPECTS(group.first == n && group.count > 0, "groups follow each other");
    n += group.count;
    element_mw_.resize(static_cast<std::size_t>(n),
                       static_cast<std::uint32_t>(to_milliwatts(group.element_power)));
    group_of_.resize(static_cast<std::size_t>(n), static_cast<int>(g));
  }
  HAARLIGHT_EXPECTS(n > 0 && n <= registers::kMaxElements, "1 to kMaxElements elements");
  HAARLIGHT_EXPECTS(config_.table_depth >= 0 && config_.table_depth < registers::kStoreNothing,
                    "table depth fits its register");
  const auto size = static_cast<std::size_t>(n);
  levels_.resize(size);
  on_.resize(size);
  on_s_.resize(size);
  heat_.resize(size);
  heat_ns_.resize(size, now_ns);
  reboot(boot_id, now_ns);
}

void LightController::reboot(std::uint32_t boot_id, std::int64_t now_ns) {
  advance(now_ns);
  step_counter_ = 0;
  go_dark();
  boot_id_ = boot_id;
  boot_ns_ = now_ns_;
  std::fill(levels_.begin(), levels_.end(), std::uint16_t{0});
  std::fill(on_.begin(), on_.end(), std::uint8_t{0});
  shadow_sum_ = 0;
  tag_ = 0;
  expected_sum_ = 0;
  has_expected_sum_ = false;
  table_.assign(static_cast<std::size_t>(config_.table_depth), {});
  step_source_ = StepSource::host;
  n_armed_ = 0;
  step_counter_ = 0;
  next_first_ = 0;
  next_divider_ = 1;
  trigger_delay_us_ = 0;
  lease_ns_ = std::clamp<std::int64_t>(config_.default_lease.count(), registers::kMinLeaseMs,
                                       registers::kMaxLeaseMs) *
              kNsPerMs;
  power_limit_mw_ = to_milliwatts(config_.max_power);
  faults_ = is_interlock_open_ ? registers::kFaultInterlock : 0U;
  refusal_ = Refusal::none;
  echo_ = 0;
  latch_counter_ = 0;
  renew_lease();
}

// ---- time ----

bool LightController::is_lit_or_armed() const {
  return n_armed_ > 0 || !waiting_.empty() ||
         (!log_.is_empty() && !log_.latest().pattern->empty());
}

std::int64_t LightController::next_deadline_ns() const {
  const std::int64_t lease = is_lit_or_armed() ? lease_deadline_ns_ : kNever;
  const std::int64_t late = waiting_.empty() ? kNever : waiting_.front().t_ns;
  return std::min({late, lease, heat_deadline_ns_});
}

void LightController::advance(std::int64_t now_ns) {
  while (next_deadline_ns() != kNever && next_deadline_ns() <= now_ns) {
    if (!waiting_.empty() && waiting_.front().t_ns == next_deadline_ns()) {
      const Act act = std::move(waiting_.front());
      waiting_.pop_front();
      now_ns_ = std::max(now_ns_, act.t_ns);
      perform(act);
      continue;
    }
    const bool is_lease = is_lit_or_armed() && lease_deadline_ns_ <= heat_deadline_ns_;
    now_ns_ = std::max(now_ns_, next_deadline_ns());
    faults_ |= is_lease ? registers::kFaultLeaseExpired : registers::kFaultElementDuty;
    all_off();
  }
  now_ns_ = std::max(now_ns_, now_ns);
}

void LightController::renew_lease() { lease_deadline_ns_ = now_ns_ + lease_ns_; }

// First-order heating: dh/dt = (drive - h) / tau, so h(t) = d + (h0 - d) exp(-(t - t0) / tau).
double LightController::heat_at(int element, std::int64_t t_ns) const {
  const auto k = static_cast<std::size_t>(element);
  const double drive = log_.latest().level(element) / kFullDrive;
  const double dt_s = static_cast<double>(t_ns - heat_ns_[k]) * 1e-9;
  const double tau_s = static_cast<double>(config_.heat_tau.count()) * 1e-3;
  return drive + (heat_[k] - drive) * std::exp(-dt_s / tau_s);
}

// ---- light ----

void LightController::show(Pattern pattern, std::uint32_t tag, std::int64_t t_ns) {
  const bool is_limited = config_.duty_limit < 1.0;
  if (!log_.is_empty()) {
    const LightTransition& old = log_.latest();
    for (const ElementLevel& e : *old.pattern) {
      const auto k = static_cast<std::size_t>(e.element);
      on_s_[k] += static_cast<double>(t_ns - old.t_ns) * 1e-9 * (e.level / kFullDrive);
    }
    if (is_limited) {
      for (int k = 0; k < n_elements(); ++k) {
        const double heat = heat_at(k, t_ns);
        heat_[static_cast<std::size_t>(k)] = heat;
        heat_ns_[static_cast<std::size_t>(k)] = t_ns;
      }
    }
  }
  ++latch_counter_;
  heat_deadline_ns_ = kNever;
  if (is_limited) {
    // h reaches the limit L after tau ln((d - h0) / (d - L)), if d > L.
    const double limit = config_.duty_limit;
    const double tau_s = static_cast<double>(config_.heat_tau.count()) * 1e-3;
    for (const ElementLevel& e : *pattern) {
      const double drive = e.level / kFullDrive;
      if (drive > limit) {
        const double h0 = std::min(heat_[static_cast<std::size_t>(e.element)], limit);
        const double dt_s = tau_s * std::log((drive - h0) / (drive - limit));
        heat_deadline_ns_ =
            std::min(heat_deadline_ns_, t_ns + static_cast<std::int64_t>(dt_s * 1e9));
      }
    }
  }
  log_.add({t_ns, tag, std::move(pattern)});
}

void LightController::go_dark() {
  waiting_.clear();
  const Act dark{now_ns_, std::make_shared<const std::vector<ElementLevel>>(), 0, step_counter_,
                 false};
  show(dark.pattern, dark.tag, dark.t_ns);
  set_shown(dark);
}

void LightController::forget_bank() {
  n_armed_ = 0;
  std::fill(on_.begin(), on_.end(), std::uint8_t{0});
  shadow_sum_ = 0;
  tag_ = 0;
  has_expected_sum_ = false;
}

void LightController::all_off() {
  forget_bank();
  go_dark();
}

// ---- acting, immediately or late ----

std::int64_t LightController::draw_delay_ns() {
  const std::uint64_t number = ++n_commands_;
  if (uniform_unit(hash_key(late_.seed, number, 1)) >= late_.fraction) {
    return 0;
  }
  const auto least = static_cast<double>(late_.least.count());
  const auto range = static_cast<double>(late_.most.count()) - least;
  return static_cast<std::int64_t>(
      1e3 * (least + std::max(range, 0.0) * uniform_unit(hash_key(late_.seed, number, 2))));
}

void LightController::command(Pattern pattern, std::uint32_t tag, bool has_trigger) {
  Act act{now_ns_ + draw_delay_ns(), std::move(pattern), tag, step_counter_, has_trigger};
  if (!waiting_.empty()) {
    act.t_ns = std::max(act.t_ns, waiting_.back().t_ns);  // in order
  }
  const bool is_late = act.t_ns > now_ns_ || !waiting_.empty();
  if (!is_late) {
    perform(act);
    return;
  }
  if (late_.shows == LateActing::Shows::at_once) {
    set_shown(act);
    if (act.has_trigger) {
      send_trigger(now_ns_);
      act.has_trigger = false;
    }
  }
  waiting_.push_back(std::move(act));
}

void LightController::perform(const Act& act) {
  show(act.pattern, act.tag, act.t_ns);
  if (late_.shows != LateActing::Shows::at_once || waiting_.empty()) {
    set_shown(act);
  }
  if (act.has_trigger) {
    send_trigger(act.t_ns);
  }
}

void LightController::send_trigger(std::int64_t t_ns) {
  if (trigger_delay_us_ > 0) {
    last_trigger_ns_ = t_ns + std::int64_t{trigger_delay_us_} * 1000;
    ++n_triggers_;
  }
}

void LightController::set_shown(const Act& act) {
  shown_ = {{act.t_ns, act.tag, act.pattern}, bank_sum(*act.pattern), act.step_counter};
}

std::uint64_t LightController::milliwatts(const std::vector<ElementLevel>& pattern) const {
  std::uint64_t sum = 0;  // mW * 65535
  for (const ElementLevel& e : pattern) {
    sum += std::uint64_t{element_mw_[static_cast<std::size_t>(e.element)]} * e.level;
  }
  return (sum + registers::kMaxLevel - 1) / registers::kMaxLevel;
}

Refusal LightController::validate(const std::vector<ElementLevel>& pattern,
                                  std::uint32_t tag) const {
  if (pattern.empty()) {
    return Refusal::none;
  }
  if (tag == 0) {
    return Refusal::tag_zero;
  }
  if (is_interlock_open_) {
    return Refusal::interlock;
  }
  if (temperature_c_ >= kTooHot) {
    return Refusal::over_temperature;
  }
  if (milliwatts(pattern) > power_limit_mw_) {
    return Refusal::total_power;
  }
  std::vector<std::uint64_t> group_sum(config_.groups.size());  // mW * 65535, exact
  for (const ElementLevel& e : pattern) {
    const auto k = static_cast<std::size_t>(e.element);
    group_sum[static_cast<std::size_t>(group_of_[k])] +=
        std::uint64_t{element_mw_[k]} * e.level;
  }
  for (std::size_t g = 0; g < group_sum.size(); ++g) {
    if (group_sum[g] > to_milliwatts(config_.groups[g].max_power) * registers::kMaxLevel) {
      return Refusal::group_power;
    }
  }
  for (const ElementGroup& supply : config_.supplies) {
    std::uint64_t sum = 0;
    for (const ElementLevel& e : pattern) {
      if (e.element >= supply.first && e.element < supply.first + supply.count) {
        sum += std::uint64_t{element_mw_[static_cast<std::size_t>(e.element)]} * e.level;
      }
    }
    if (sum > to_milliwatts(supply.max_power) * registers::kMaxLevel) {
      return Refusal::group_power;
    }
  }
  if (config_.duty_limit < 1.0) {
    for (const ElementLevel& e : pattern) {
      if (e.level / kFullDrive > config_.duty_limit &&
          heat_at(e.element, now_ns_) >= config_.duty_limit * (1.0 - kDutySlack)) {
        return Refusal::element_duty;
      }
    }
  }
  return Refusal::none;
}

// A refused command leaves the rig dark: nothing that was not requested may stay lit.
Exception LightController::refuse(Refusal refusal) {
  refusal_ = refusal;
  switch (refusal) {
    case Refusal::total_power:
    case Refusal::group_power:
      faults_ |= registers::kFaultOverPower;
      break;
    case Refusal::element_duty:
      faults_ |= registers::kFaultElementDuty;
      break;
    case Refusal::over_temperature:
      faults_ |= registers::kFaultOverTemperature;
      break;
    case Refusal::interlock:
      faults_ |= registers::kFaultInterlock;
      break;
    case Refusal::bank_sum:
      faults_ |= registers::kFaultBankSum;
      break;
    case Refusal::none:
    case Refusal::tag_zero:
    case Refusal::table_range:
    case Refusal::table_not_armed:
      break;
  }
  n_armed_ = 0;
  go_dark();
  return refusal == Refusal::bank_sum ? Exception::bank_sum : Exception::device_failure;
}

LightController::Pattern LightController::shadow_pattern() const {
  auto pattern = std::make_shared<std::vector<ElementLevel>>();
  for (int k = 0; k < n_elements(); ++k) {
    const auto i = static_cast<std::size_t>(k);
    if (on_[i] != 0 && levels_[i] > 0) {
      pattern->push_back({k, levels_[i]});
    }
  }
  return pattern;
}

// ---- commands ----

Exception LightController::check_expected_sum() {
  const bool is_wrong = has_expected_sum_ && expected_sum_ != shadow_sum_;
  has_expected_sum_ = false;
  return is_wrong ? refuse(Refusal::bank_sum) : Exception::none;
}

Exception LightController::latch() {
  if (const Exception wrong = check_expected_sum(); wrong != Exception::none) {
    return wrong;
  }
  const Pattern pattern = shadow_pattern();
  if (const Refusal why = validate(*pattern, tag_); why != Refusal::none) {
    return refuse(why);
  }
  refusal_ = Refusal::none;
  n_armed_ = 0;  // a manual latch ends a table run
  renew_lease();
  command(pattern, tag_, true);
  return Exception::none;
}

Exception LightController::store(std::uint16_t index) {
  if (const Exception wrong = check_expected_sum(); wrong != Exception::none) {
    return wrong;
  }
  if (index >= table_.size()) {
    return refuse(Refusal::table_range);
  }
  const Pattern pattern = shadow_pattern();
  if (const Refusal why = validate(*pattern, tag_); why != Refusal::none) {
    return refuse(why);
  }
  refusal_ = Refusal::none;
  table_[index] = {pattern, tag_};
  return Exception::none;
}

bool LightController::is_stored(std::size_t first, std::size_t n) const {
  return first + n <= table_.size() &&
         std::all_of(table_.begin() + static_cast<std::ptrdiff_t>(first),
                     table_.begin() + static_cast<std::ptrdiff_t>(first + n),
                     [](const TableEntry& entry) { return entry.pattern != nullptr; });
}

Exception LightController::extend(std::uint16_t n_entries) {
  // Past its end the table stays dark: a late host must not skip entries.
  const bool is_running = n_armed_ > 0 && step_counter_ <= static_cast<std::uint32_t>(n_armed_);
  if (!is_running || n_entries <= n_armed_) {
    return Exception::none;
  }
  if (!is_stored(first_armed_, n_entries)) {
    return refuse(Refusal::table_range);
  }
  n_armed_ = n_entries;
  renew_lease();
  return Exception::none;
}

Exception LightController::arm(std::uint16_t n_entries) {
  const std::size_t first = std::exchange(next_first_, 0);
  const std::uint32_t divider = std::exchange(next_divider_, 1);
  if (!is_stored(first, n_entries)) {
    return refuse(Refusal::table_range);
  }
  refusal_ = Refusal::none;
  step_counter_ = 0;
  go_dark();
  first_armed_ = first;
  strobe_divider_ = divider;
  n_strobes_ = 0;
  n_armed_ = n_entries;
  renew_lease();
  return Exception::none;
}

Exception LightController::step() {
  if (n_armed_ == 0) {
    return refuse(Refusal::table_not_armed);
  }
  const std::uint32_t index = step_counter_;
  if (step_counter_ < std::numeric_limits<std::uint32_t>::max()) {
    ++step_counter_;
  }
  if (index >= static_cast<std::uint32_t>(n_armed_)) {
    if (waiting_.empty() && log_.latest().pattern->empty() && log_.latest().tag == 0) {
      shown_.step_counter = step_counter_;
    } else {
      command(std::make_shared<const std::vector<ElementLevel>>(), 0, false);
    }
    return Exception::none;
  }
  const TableEntry& entry = table_[first_armed_ + index];
  if (const Refusal why = validate(*entry.pattern, entry.tag); why != Refusal::none) {
    return refuse(why);
  }
  refusal_ = Refusal::none;
  command(entry.pattern, entry.tag, false);
  return Exception::none;
}

void LightController::strobe(std::int64_t now_ns) {
  advance(now_ns);
  // The camera is not a host: its strobe does not renew the lease, and cannot be refused.
  if (n_armed_ > 0 && step_source_ == StepSource::strobe &&
      n_strobes_++ % strobe_divider_ == 0) {
    [[maybe_unused]] const Exception shown = step();
  }
}

void LightController::set_temperature(double temperature_c, std::int64_t now_ns) {
  advance(now_ns);
  temperature_c_ = temperature_c;
  if (temperature_c_ >= kTooHot) {
    faults_ |= registers::kFaultOverTemperature;
    all_off();
  }
}

void LightController::set_interlock_open(bool is_open, std::int64_t now_ns) {
  advance(now_ns);
  is_interlock_open_ = is_open;
  if (is_open) {
    faults_ |= registers::kFaultInterlock;
    all_off();
  }
}

// ---- registers ----

void LightController::set_shadow(int element, std::uint16_t level, bool is_on) {
  const auto k = static_cast<std::size_t>(element);
  if (on_[k] != 0) {
    shadow_sum_ -= bank_sum_term(element, levels_[k]);
  }
  levels_[k] = level;
  on_[k] = is_on ? 1 : 0;
  if (is_on) {
    shadow_sum_ += bank_sum_term(element, level);
  }
}

Exception LightController::read_coils(std::uint16_t first, std::span<bool> bits,
                                      std::int64_t now_ns) {
  advance(now_ns);
  if (first + bits.size() > on_.size()) {
    return Exception::illegal_address;
  }
  for (std::size_t i = 0; i < bits.size(); ++i) {
    bits[i] = on_[first + i] != 0;
  }
  return Exception::none;
}

Exception LightController::read_discrete(std::uint16_t first, std::span<bool> bits,
                                         std::int64_t now_ns) {
  advance(now_ns);
  if (first + bits.size() > on_.size()) {
    return Exception::illegal_address;
  }
  for (std::size_t i = 0; i < bits.size(); ++i) {
    bits[i] = shown_.light.level(static_cast<int>(first + i)) > 0;
  }
  return Exception::none;
}

Exception LightController::write_coils(std::uint16_t first, std::span<const bool> bits,
                                       std::int64_t now_ns) {
  advance(now_ns);
  if (first + bits.size() > on_.size()) {
    return Exception::illegal_address;
  }
  for (std::size_t i = 0; i < bits.size(); ++i) {
    set_shadow(static_cast<int>(first + i), levels_[first + i], bits[i]);
  }
  return Exception::none;
}

Exception LightController::read_input(std::uint16_t first, std::span<std::uint16_t> words,
                                      std::int64_t now_ns) {
  advance(now_ns);
  std::vector<std::uint16_t> block(in::kStatusFirst + in::kStatusCount);
  const std::span<std::uint16_t> all(block);
  const std::size_t end = first + words.size();
  const bool is_identity = end <= in::kIdentityCount;
  const bool is_status = first >= in::kStatusFirst && end <= block.size();
  if (!is_identity && !is_status) {
    return Exception::illegal_address;
  }
  block[in::kMagic] = registers::kMagic;
  block[in::kMapVersion] = registers::kMapVersion;
  put_long(all, in::kSerial, config_.serial);
  put_long(all, in::kFirmware, config_.firmware);
  block[in::kElements] = static_cast<std::uint16_t>(n_elements());
  block[in::kMaxLevel] = registers::kMaxLevel;
  block[in::kTableDepth] = static_cast<std::uint16_t>(table_.size());
  block[in::kMaxLeaseMs] = registers::kMaxLeaseMs;
  put_long(all, in::kHardPowerLimit,
           static_cast<std::uint32_t>(to_milliwatts(config_.max_power) / 100));
  for (std::size_t i = 0; i < 16; ++i) {
    const unsigned byte =
        i < config_.model.size() ? static_cast<unsigned char>(config_.model[i]) : 0U;
    block[in::kModel + i / 2] |= static_cast<std::uint16_t>(i % 2 == 0 ? byte << 8U : byte);
  }
  fill_status(all.subspan(in::kStatusFirst));
  std::copy_n(block.begin() + first, words.size(), words.begin());
  return Exception::none;
}

void LightController::fill_status(std::span<std::uint16_t> block) const {
  const auto at = [](std::uint16_t address) {
    return static_cast<std::size_t>(address - in::kStatusFirst);
  };
  const std::uint64_t power_mw = milliwatts(*shown_.light.pattern);
  put_long(block, at(in::kBootId), boot_id_);
  put_long(block, at(in::kUptimeMs),
           static_cast<std::uint32_t>((now_ns_ - boot_ns_) / kNsPerMs));
  unsigned bits = shown_.light.pattern->empty() ? unsigned{registers::kStatusDark} : 0U;
  if (n_armed_ > 0) {
    bits |= registers::kStatusArmed;
    if (shown_.step_counter > static_cast<std::uint32_t>(n_armed_)) {
      bits |= registers::kStatusTableDone;
    }
  }
  block[at(in::kStatusBits)] = static_cast<std::uint16_t>(bits);
  put_long(block, at(in::kFaults), faults_);
  const double tenths = std::clamp(std::round(temperature_c_ * 10.0), -32768.0, 32767.0);
  block[at(in::kTemperature)] = static_cast<std::uint16_t>(static_cast<std::int16_t>(tenths));
  const double supply = static_cast<double>(power_mw) * 1e-3 / config_.supply_v;
  block[at(in::kSupplyCurrent)] =
      static_cast<std::uint16_t>(std::min(std::round(supply * 100.0), kFullDrive));
  put_long(block, at(in::kTag), shown_.light.tag);
  put_long(block, at(in::kShownSum), shown_.sum);
  put_long(block, at(in::kStepCounter), shown_.step_counter);
  put_long(block, at(in::kLatchCounter), latch_counter_);
  put_long(block, at(in::kPower), static_cast<std::uint32_t>((power_mw + 99) / 100));
  const std::int64_t left =
      is_lit_or_armed() ? (lease_deadline_ns_ - now_ns_ + kNsPerMs - 1) / kNsPerMs : 0;
  block[at(in::kLeaseLeftMs)] = static_cast<std::uint16_t>(left);
  block[at(in::kRefusal)] = static_cast<std::uint16_t>(refusal_);
  put_long(block, at(in::kShadowSum), shadow_sum_);
}

std::uint32_t LightController::read_control(std::uint16_t address) const {
  switch (address) {
    case hold::kTag:
      return tag_;
    case hold::kExpectedSum:
      return expected_sum_;
    case hold::kTableStore:
      return registers::kStoreNothing;
    case hold::kStepSource:
      return static_cast<std::uint32_t>(step_source_);
    case hold::kTableArm:
    case hold::kTableExtend:
      return static_cast<std::uint32_t>(n_armed_);
    case hold::kStrobeDivider:
      return next_divider_;
    case hold::kTableFirst:
      return static_cast<std::uint32_t>(next_first_);
    case hold::kTriggerDelay:
      return trigger_delay_us_;
    case hold::kLeaseMs:
      return static_cast<std::uint32_t>(lease_ns_ / kNsPerMs);
    case hold::kPowerLimit:
      return static_cast<std::uint32_t>(power_limit_mw_ / 100);
    case hold::kEcho:
      return echo_;
    default:  // commands read as 0
      return 0;
  }
}

Exception LightController::read_holding(std::uint16_t first, std::span<std::uint16_t> words,
                                        std::int64_t now_ns) {
  advance(now_ns);
  if (first >= hold::kLevels) {
    const std::size_t k = static_cast<std::size_t>(first) - hold::kLevels;
    if (k + words.size() > levels_.size()) {
      return Exception::illegal_address;
    }
    std::copy_n(levels_.begin() + static_cast<std::ptrdiff_t>(k), words.size(), words.begin());
    return Exception::none;
  }
  if (!is_whole_control_range(first, words.size())) {
    return Exception::illegal_address;
  }
  for (std::size_t i = 0; i < words.size();) {
    const auto address = static_cast<std::uint16_t>(first + i);
    const std::uint32_t value = read_control(address);
    if (words_at(address) == 2) {
      words[i] = high_word(value);
      words[i + 1] = low_word(value);
      i += 2;
    } else {
      words[i] = low_word(value);
      ++i;
    }
  }
  return Exception::none;
}

Exception LightController::write_holding(std::uint16_t first,
                                         std::span<const std::uint16_t> words,
                                         std::int64_t now_ns) {
  advance(now_ns);
  if (first >= hold::kLevels) {
    const std::size_t k = static_cast<std::size_t>(first) - hold::kLevels;
    if (k + words.size() > levels_.size()) {
      return Exception::illegal_address;
    }
    for (std::size_t i = 0; i < words.size(); ++i) {
      set_shadow(static_cast<int>(k + i), words[i], on_[k + i] != 0);
    }
    return Exception::none;
  }
  if (!is_whole_control_range(first, words.size())) {
    return Exception::illegal_address;
  }
  for (std::size_t i = 0; i < words.size();) {
    const auto address = static_cast<std::uint16_t>(first + i);
    const bool is_long = words_at(address) == 2;
    const std::uint32_t value = is_long ? join_words(words[i], words[i + 1]) : words[i];
    if (const Exception no = write_control(address, value); no != Exception::none) {
      return no;
    }
    i += is_long ? 2 : 1;
  }
  return Exception::none;
}

Exception LightController::write_control(std::uint16_t address, std::uint32_t value) {
  switch (address) {
    case hold::kTag:
      tag_ = value;
      return Exception::none;
    case hold::kExpectedSum:
      expected_sum_ = value;
      has_expected_sum_ = true;
      return Exception::none;
    case hold::kLatch:
      if (value > registers::kAct) {
        return Exception::illegal_value;
      }
      return value == registers::kAct ? latch() : Exception::none;
    case hold::kTableStore:
      return value == registers::kStoreNothing ? Exception::none
                                               : store(static_cast<std::uint16_t>(value));
    case hold::kStrobeDivider:
      if (value < 1 || value > registers::kMaxStrobeDivider) {
        return Exception::illegal_value;
      }
      next_divider_ = value;
      return Exception::none;
    case hold::kTableFirst:
      next_first_ = value;
      return Exception::none;
    case hold::kTableExtend:
      return extend(static_cast<std::uint16_t>(value));
    case hold::kTriggerDelay:
      if (value > registers::kMaxTriggerDelayUs) {
        return Exception::illegal_value;
      }
      trigger_delay_us_ = value;
      return Exception::none;
    case hold::kStepSource:
      if (value > static_cast<std::uint32_t>(StepSource::strobe)) {
        return Exception::illegal_value;
      }
      step_source_ = static_cast<StepSource>(value);
      return Exception::none;
    case hold::kTableArm:
      return arm(static_cast<std::uint16_t>(value));
    case hold::kStep:
      if (value > registers::kAct) {
        return Exception::illegal_value;
      }
      if (value == registers::kAct) {
        renew_lease();
        return step();
      }
      return Exception::none;
    case hold::kLeaseMs:
      if (value < registers::kMinLeaseMs || value > registers::kMaxLeaseMs) {
        return Exception::illegal_value;
      }
      lease_ns_ = std::int64_t{value} * kNsPerMs;
      renew_lease();
      return Exception::none;
    case hold::kLeaseRenew:
      renew_lease();
      return Exception::none;
    case hold::kAllOff:
      forget_bank();
      command(std::make_shared<const std::vector<ElementLevel>>(), 0, false);
      return Exception::none;
    case hold::kPowerLimit: {
      const std::uint64_t limit_mw = std::uint64_t{value} * 100;
      if (limit_mw > to_milliwatts(config_.max_power)) {
        return Exception::illegal_value;
      }
      power_limit_mw_ = limit_mw;
      if (milliwatts(*log_.latest().pattern) > power_limit_mw_) {
        faults_ |= registers::kFaultOverPower;
        all_off();
      }
      return Exception::none;
    }
    case hold::kFaultClear:
      faults_ &= ~value;
      if (is_interlock_open_) {
        faults_ |= registers::kFaultInterlock;
      }
      if (temperature_c_ >= kTooHot) {
        faults_ |= registers::kFaultOverTemperature;
      }
      return Exception::none;
    case hold::kEcho:
      echo_ = value;
      return Exception::none;
    default:
      return Exception::illegal_address;
  }
}

// ---- as seen from outside ----

double LightController::total_on_seconds(int element) const {
  const LightTransition& shown = log_.latest();
  return on_s_[static_cast<std::size_t>(element)] +
         static_cast<double>(now_ns_ - shown.t_ns) * 1e-9 * (shown.level(element) / kFullDrive);
}

Watts LightController::power() const {
  std::uint64_t sum = 0;
  for (const ElementLevel& e : *log_.latest().pattern) {
    sum += std::uint64_t{element_mw_[static_cast<std::size_t>(e.element)]} * e.level;
  }
  return Watts(static_cast<double>(sum) / kFullDrive * 1e-3);
}

}  // namespace haarlight::firmware_iface
