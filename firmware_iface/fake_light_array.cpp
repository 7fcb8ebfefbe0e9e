// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/fake_light_array.h"

#include <algorithm>

namespace haarlight::firmware_iface {

void FakeLight::change(std::uint32_t tag, std::vector<ElementLevel> pattern) {
  changes_.push_back(Change{clock_.now_ns(), tag, std::move(pattern)});
}

void FakeLight::restart() {
  const std::lock_guard lock(mutex_);
  ++boot_id_;
  change(0, {});
}
void FakeLight::set_gone(bool is_gone) {
  const std::lock_guard lock(mutex_);
  is_gone_ = is_gone;
}
void FakeLight::fail_next(int count, Errc code) {
  const std::lock_guard lock(mutex_);
  n_to_fail_ = count;
  failure_ = code;
}
void FakeLight::hang_next(std::chrono::milliseconds length) {
  const std::lock_guard lock(mutex_);
  hang_ = length;
}

std::vector<FakeLight::Change> FakeLight::changes() const {
  const std::lock_guard lock(mutex_);
  return changes_;
}

std::optional<std::uint32_t> FakeLight::tag_between(std::int64_t t0_ns,
                                                    std::int64_t t1_ns) const {
  const std::lock_guard lock(mutex_);
  const auto last =
      std::find_if(changes_.rbegin(), changes_.rend(),
                   [t1_ns](const Change& change) { return change.t_ns <= t1_ns; });
  if (last == changes_.rend()) {
    return 0;
  }
  return last->t_ns > t0_ns ? std::nullopt : std::optional(last->tag);
}

std::uint32_t FakeLight::shown_tag() const {
  const std::lock_guard lock(mutex_);
  return changes_.empty() ? 0 : changes_.back().tag;
}

bool FakeLight::is_dark() const {
  const std::lock_guard lock(mutex_);
  return changes_.empty() || changes_.back().pattern.empty();
}

Result<void> FakeLightArray::reach() {
  std::chrono::milliseconds hang{0};
  {
    const std::lock_guard lock(light_->mutex_);
    std::swap(hang, light_->hang_);
  }
  light_->clock().sleep_for(hang);
  const std::lock_guard lock(light_->mutex_);
  if (light_->is_gone_) {
    return fail(Errc::device_gone, "fake controller: unplugged");
  }
  if (light_->n_to_fail_ > 0) {
    --light_->n_to_fail_;
    return fail(light_->failure_, light_->failure_ == Errc::timeout
                                      ? "fake controller: no answer"
                                      : "fake controller: refused");
  }
  if (boot_id_ != 0 && boot_id_ != light_->boot_id_) {
    return fail(Errc::device_gone, "fake controller: connection reset");
  }
  return {};
}

Result<ControllerIdentity> FakeLightArray::connect() {
  boot_id_ = 0;
  if (auto connected = reach(); !connected) {
    return tl::unexpected<Fault>(connected.error());
  }
  const std::lock_guard lock(light_->mutex_);
  boot_id_ = light_->boot_id_;
  ControllerIdentity identity;
  identity.model = "fake";
  identity.boot_id = boot_id_;
  identity.n_elements = 1 << 16;
  return identity;
}

Result<LatchReceipt> FakeLightArray::show(std::span<const ElementLevel> pattern,
                                          std::uint32_t tag) {
  if (auto connected = reach(); !connected) {
    return tl::unexpected<Fault>(connected.error());
  }
  LatchReceipt receipt;
  receipt.t_command_ns = light_->clock().now_ns();
  const std::lock_guard lock(light_->mutex_);
  light_->change(tag, {pattern.begin(), pattern.end()});
  receipt.t_ack_ns = receipt.t_shown_ns = light_->clock().now_ns();
  receipt.tag_echo = tag;
  return receipt;
}

Result<LatchReceipt> FakeLightArray::all_off() {
  if (auto connected = reach(); !connected) {
    return tl::unexpected<Fault>(connected.error());
  }
  LatchReceipt receipt;
  receipt.t_command_ns = light_->clock().now_ns();
  const std::lock_guard lock(light_->mutex_);
  light_->change(0, {});
  receipt.t_ack_ns = receipt.t_shown_ns = light_->clock().now_ns();
  return receipt;
}

Result<void> FakeLightArray::renew_lease() { return reach(); }

Result<ControllerStatus> FakeLightArray::status() {
  if (auto connected = reach(); !connected) {
    return tl::unexpected<Fault>(connected.error());
  }
  const std::lock_guard lock(light_->mutex_);
  ControllerStatus status;
  status.boot_id = light_->boot_id_;
  status.tag = light_->changes_.empty() ? 0 : light_->changes_.back().tag;
  status.is_dark = light_->changes_.empty() || light_->changes_.back().pattern.empty();
  return status;
}

Result<void> FakeLightArray::upload_table(
    std::span<const std::vector<ElementLevel>> /*patterns*/,
    std::span<const std::uint32_t> /*tags*/) {
  return fail(Errc::unsupported, "fake controller: it has no table");
}
Result<LatchReceipt> FakeLightArray::step_table() {
  return fail(Errc::unsupported, "fake controller: it has no table");
}

}  // namespace haarlight::firmware_iface
