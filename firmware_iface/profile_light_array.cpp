// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/profile_light_array.h"

#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;

constexpr std::uint32_t kFullLevel = 65535;

tl::unexpected<Fault> table_fault(const std::string& name) {
  return fail(Errc::unsupported, name + ": a controller behind a profile has no pattern table");
}

}  // namespace

ProfileLightArray::ProfileLightArray(std::unique_ptr<RegisterBus> bus,
                                     ControllerProfile profile, int n_elements,
                                     NanosecondClock clock)
    : link_(std::move(bus), std::move(clock)),
      profile_(std::move(profile)),
      n_elements_(static_cast<std::size_t>(n_elements)) {
  HAARLIGHT_EXPECTS(n_elements > 0 && n_elements <= profile_.channels,
                    "as many channels as elements");
}

ProfileLightArray::~ProfileLightArray() { disconnect(); }

std::string ProfileLightArray::name() const {
  return fmt::format("{} ({})", link_.name(), profile_.name);
}

Result<void> ProfileLightArray::make_ready(RetryPolicy retry_policy) {
  return link_.make_ready(retry_policy, [this] { return resynchronise(); });
}

Result<void> ProfileLightArray::resynchronise() {
  for (const ProfileExpectation& e : profile_.identity) {
    const auto got = read(e.read, e.address, 1);
    if (!got) {
      return tl::unexpected<Fault>(got.error());
    }
    if (got->front() != e.value) {
      return link_.lose(
          Fault{Errc::unsupported,
                fmt::format("{}: address {} holds {}, a {} holds {}: another device?", name(),
                            e.address, got->front(), profile_.name, e.value),
                0, __FILE__, __LINE__});
    }
  }
  // Dark first, then its settings: they may change the meaning of a value.
  const Values dark(n_elements_, 0);
  is_certain_ = false;
  if (auto off = set(dark, 0); !off) {
    return tl::unexpected<Fault>(off.error());
  }
  for (const ProfileValue& value : profile_.at_connect) {
    if (auto ok = write(value, "setting it up"); !ok) {
      return ok;
    }
    const auto got = read_back(value);
    if (!got) {
      return tl::unexpected<Fault>(got.error());
    }
    if (*got != value.value) {
      return link_.lose(Fault{Errc::protocol,
                              fmt::format("{}: address {} was set to {} and reads {}", name(),
                                          value.address, value.value, *got),
                              0, __FILE__, __LINE__});
    }
  }
  ++n_resynchronised_;
  link_.on(LinkEvent::resynchronised);
  held_ = dark;
  is_certain_ = true;
  return {};
}

Result<void> ProfileLightArray::demand(Result<Exception> answer, const char* operation) {
  if (!answer) {
    answer.error().what = fmt::format("{}: {}", operation, answer.error().what);
    return link_.lose(answer.error());
  }
  switch (*answer) {
    case Exception::none:
      return {};
    case Exception::busy:
      link_.on(LinkEvent::doubt);
      return fail(Errc::device_busy, fmt::format("{}: {}: busy", name(), operation));
    case Exception::device_failure:
      link_.on(LinkEvent::doubt);
      return fail(Errc::refused, fmt::format("{}: {} refused", name(), operation));
    case Exception::illegal_function:
    case Exception::illegal_address:
    case Exception::illegal_value:
    case Exception::bank_sum:
    case Exception::gateway_target:
      break;
  }
  link_.on(LinkEvent::doubt);
  return fail(Errc::protocol,
              fmt::format("{}: {}: Modbus exception {}: does the profile fit the device?",
                          name(), operation, static_cast<int>(*answer)));
}

// ---- registers ----

Result<void> ProfileLightArray::write(const ProfileValue& value, const char* operation) {
  const std::array<std::uint16_t, 1> word = {value.value};
  const std::array<std::uint8_t, 1> bit = {static_cast<std::uint8_t>(value.value != 0)};
  switch (value.write) {
    case WriteFunction::coil:
      return demand(link_.bus().write_coil(value.address, value.value != 0), operation);
    case WriteFunction::word:
      return demand(link_.bus().write_register(value.address, value.value), operation);
    case WriteFunction::coils:
      return demand(link_.bus().write_coils(value.address, bit), operation);
    case WriteFunction::words:
      return demand(link_.bus().write_holding(value.address, word), operation);
  }
  return {};
}

Result<ProfileLightArray::Values> ProfileLightArray::read(CheckFunction function,
                                                          std::uint16_t first, std::size_t n) {
  Values values(n);
  const std::size_t longest = function == CheckFunction::coils
                                  ? std::size_t{registers::kMaxCoilsRead}
                                  : std::size_t{registers::kMaxRegistersRead};
  std::vector<std::uint8_t> bits;
  for (std::size_t k = 0; k < n; k += longest) {
    const std::size_t count = std::min(longest, n - k);
    const auto address = static_cast<std::uint16_t>(first + k);
    const std::span<std::uint16_t> part(values.data() + k, count);
    Result<Exception> answer = Exception::none;
    switch (function) {
      case CheckFunction::coils:
        bits.assign(count, 0);
        answer = link_.bus().read_coils(address, bits);
        std::copy(bits.begin(), bits.end(), part.begin());
        break;
      case CheckFunction::holding:
        answer = link_.bus().read_holding(address, part);
        break;
      case CheckFunction::input:
        answer = link_.bus().read_input(address, part);
        break;
    }
    if (auto ok = demand(std::move(answer), "reading back"); !ok) {
      return tl::unexpected<Fault>(ok.error());
    }
  }
  return values;
}

Result<std::uint16_t> ProfileLightArray::read_back(const ProfileValue& value) {
  const bool is_bit = value.write == WriteFunction::coil || value.write == WriteFunction::coils;
  const auto got =
      read(is_bit ? CheckFunction::coils : CheckFunction::holding, value.address, 1);
  if (!got) {
    return tl::unexpected<Fault>(got.error());
  }
  return got->front();
}

Result<void> ProfileLightArray::write_channels(const Values& wanted) {
  const ProfileChannels& c = profile_.channel;
  const auto longest = static_cast<std::size_t>(c.per_request);
  std::vector<std::uint8_t> bits;
  for (std::size_t k = 0; k < wanted.size();) {
    if (is_certain_ && held_[k] == wanted[k]) {
      ++k;
      continue;
    }
    std::size_t end = k + 1;
    while (end < wanted.size() && end - k < longest &&
           (!is_certain_ || held_[end] != wanted[end])) {
      ++end;
    }
    const auto address = static_cast<std::uint16_t>(c.first + k);
    Result<void> done;
    if (c.write == WriteFunction::coils) {
      bits.clear();
      for (std::size_t i = k; i < end; ++i) {
        bits.push_back(wanted[i] != 0 ? 1 : 0);
      }
      done = demand(link_.bus().write_coils(address, bits), "writing channels");
    } else if (c.write == WriteFunction::words) {
      done = demand(link_.bus().write_holding(address, {wanted.data() + k, end - k}),
                    "writing channels");
    } else {
      done = write({.address = address, .value = wanted[k], .write = c.write},
                   "writing a channel");
    }
    if (!done) {
      return done;
    }
    k = end;
  }
  return {};
}

Result<void> ProfileLightArray::confirm(const Values& wanted, std::int64_t deadline_ns) {
  for (;;) {
    const auto got = read(profile_.channel.read, profile_.channel.first, wanted.size());
    if (!got) {
      return tl::unexpected<Fault>(got.error());
    }
    if (*got == wanted) {
      return {};
    }
    bool is_under_way = true;  // each channel holds its old or its new value
    for (std::size_t k = 0; k < wanted.size(); ++k) {
      is_under_way =
          is_under_way && (held_.empty() || (*got)[k] == wanted[k] || (*got)[k] == held_[k]);
    }
    if (is_under_way && link_.now_ns() < deadline_ns) {
      continue;
    }
    const auto wrong = std::mismatch(wanted.begin(), wanted.end(), got->begin());
    link_.on(LinkEvent::doubt);
    return fail(Errc::protocol,
                fmt::format("{}: channel {} reads {}, expected {}", name(),
                            wrong.first - wanted.begin(), *wrong.second, *wrong.first));
  }
}

Result<void> ProfileLightArray::confirm_latch(std::int64_t deadline_ns) {
  for (const ProfileValue& value : profile_.latch) {
    for (bool is_shown = !value.is_kept; !is_shown;) {
      const auto got = read_back(value);
      if (!got) {
        return tl::unexpected<Fault>(got.error());
      }
      is_shown = *got == value.value;
      if (!is_shown && link_.now_ns() >= deadline_ns) {
        link_.on(LinkEvent::doubt);
        return fail(Errc::protocol, fmt::format("{}: the latch reads {}, expected {}", name(),
                                                *got, value.value));
      }
    }
  }
  return {};
}

Result<LatchReceipt> ProfileLightArray::set(const Values& wanted, std::uint32_t tag) {
  LatchReceipt receipt;
  const auto run = [this](const std::vector<ProfileValue>& values,
                          const char* operation) -> Result<void> {
    for (const ProfileValue& value : values) {
      if (auto ok = write(value, operation); !ok) {
        return ok;
      }
    }
    return {};
  };
  if (auto ok = run(profile_.before, "before a pattern"); !ok) {
    return tl::unexpected<Fault>(ok.error());
  }
  // Without a latch the light changes while the channels are written.
  receipt.t_command_ns = link_.now_ns();
  auto written = write_channels(wanted);
  if (written && !profile_.latch.empty()) {
    receipt.t_command_ns = link_.now_ns();
    written = run(profile_.latch, "latching");
  }
  receipt.t_ack_ns = link_.now_ns();
  if (!written) {
    is_certain_ = false;
    return tl::unexpected<Fault>(written.error());
  }
  if (!is_certain_) {
    held_.clear();  // the previous state is unknown: anything may be read for a while
  }
  is_certain_ = false;
  const std::int64_t deadline_ns = receipt.t_ack_ns + kShownWithinNs;
  auto shown = confirm(wanted, deadline_ns);
  shown = shown ? confirm_latch(deadline_ns) : shown;
  receipt.t_shown_ns = link_.now_ns();
  if (!shown) {
    return tl::unexpected<Fault>(shown.error());
  }
  held_ = wanted;
  is_certain_ = true;
  tag_ = tag;
  receipt.tag_echo = tag;
  receipt.proof = LightProof::read_back;
  return receipt;
}

// ---- LightArray ----

Result<ControllerIdentity> ProfileLightArray::connect() {
  link_.close();
  if (auto ready = make_ready(RetryPolicy::at_once); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  connected_ns_ = link_.now_ns();
  ControllerIdentity identity;
  identity.model = profile_.name;
  identity.n_elements = profile_.channels;
  identity.missing = missing_promises(profile_);
  return identity;
}

void ProfileLightArray::disconnect() noexcept {
  try {
    if (link_.state() == LinkState::up || link_.state() == LinkState::unknown) {
      // There is no lease behind this controller: try twice.
      if (!all_off()) {
        [[maybe_unused]] const auto dark = all_off();
      }
    }
  } catch (...) {  // out of memory while formatting a message: nothing more can be done
  }
  link_.close();
}

Result<LatchReceipt> ProfileLightArray::show(std::span<const ElementLevel> pattern,
                                             std::uint32_t tag) {
  if (tag == 0) {
    return fail(Errc::refused, name() + ": tag 0 stands for dark; a pattern needs another one");
  }
  Values wanted(n_elements_, 0);
  std::vector<bool> is_seen(n_elements_);
  for (const ElementLevel& e : pattern) {
    if (e.element < 0 || static_cast<std::size_t>(e.element) >= n_elements_ ||
        is_seen[static_cast<std::size_t>(e.element)]) {
      return fail(Errc::refused,
                  fmt::format("{}: element {} twice, or not of this rig", name(), e.element));
    }
    const auto k = static_cast<std::size_t>(e.element);
    is_seen[k] = true;
    if (!profile_.has_levels() && e.level != 0 && e.level != kFullLevel) {
      return fail(
          Errc::refused,
          fmt::format("{}: element {} at level {}: this controller knows on and off only",
                      name(), e.element, e.level));
    }
    wanted[k] = static_cast<std::uint16_t>(
        (std::uint32_t{e.level} * profile_.channel.full + kFullLevel / 2) / kFullLevel);
    if (e.level != 0 && wanted[k] == 0) {
      return fail(Errc::refused,
                  fmt::format("{}: element {} at level {} is below the first of its {} steps",
                              name(), e.element, e.level, profile_.channel.full));
    }
  }
  if (auto ready = make_ready(RetryPolicy::patient); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  return set(wanted, tag);
}

Result<LatchReceipt> ProfileLightArray::all_off() {
  if (auto ready = make_ready(RetryPolicy::at_once); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  is_certain_ = false;  // every channel is written, whatever its assumed value
  return set(Values(n_elements_, 0), 0);
}

Result<void> ProfileLightArray::renew_lease() {
  if (auto ready = make_ready(RetryPolicy::patient); !ready) {
    return ready;
  }
  return confirm(held_);
}

Result<ControllerStatus> ProfileLightArray::status() {
  if (auto ready = make_ready(RetryPolicy::patient); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  if (auto same = confirm(held_); !same) {
    return tl::unexpected<Fault>(same.error());
  }
  ControllerStatus status;
  // It has no known boot number: every resynchronisation counts as a boot.
  status.boot_id = n_resynchronised_;
  status.uptime_ms = static_cast<std::uint32_t>((link_.now_ns() - connected_ns_) / 1'000'000);
  status.tag = tag_;
  status.is_dark = std::all_of(held_.begin(), held_.end(), [](auto v) { return v == 0; });
  return status;
}

Result<void> ProfileLightArray::upload_table(
    std::span<const std::vector<ElementLevel>> /*patterns*/,
    std::span<const std::uint32_t> /*tags*/) {
  return table_fault(name());
}

Result<LatchReceipt> ProfileLightArray::step_table() { return table_fault(name()); }

}  // namespace haarlight::firmware_iface
