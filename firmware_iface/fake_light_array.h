// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "core/clock.h"
#include "haarlight/firmware_iface/light_array.h"

/// @file
/// A light array without a device, for testing the layers above it: remembers every light
/// change with its time, and can be told to fail. Its FakeLight outlives it, as a controller
/// outlives a connection.

namespace haarlight::firmware_iface {

/// The ground truth of the light. Thread-safe.
class FakeLight {
 public:
  struct Change {
    std::int64_t t_ns = 0;
    std::uint32_t tag = 0;
    std::vector<ElementLevel> pattern;
  };

  explicit FakeLight(Clock& clock = real_clock()) : clock_(clock) {}
  [[nodiscard]] Clock& clock() const { return clock_; }

  // The operator's actions.
  void restart();               ///< dark, new boot id, connections lost
  void set_gone(bool is_gone);  ///< no answers at all
  /// This many calls time out, or end with `code`.
  void fail_next(int count, Errc code = Errc::timeout);
  void hang_next(std::chrono::milliseconds length);  ///< how long one call fails to return

  [[nodiscard]] std::vector<Change> changes() const;
  /// The tag lit over [t0, t1]; nothing when it changed in between.
  [[nodiscard]] std::optional<std::uint32_t> tag_between(std::int64_t t0_ns,
                                                         std::int64_t t1_ns) const;
  [[nodiscard]] std::uint32_t shown_tag() const;
  [[nodiscard]] bool is_dark() const;

 private:
  friend class FakeLightArray;
  void change(std::uint32_t tag, std::vector<ElementLevel> pattern);

  Clock& clock_;
  mutable std::mutex mutex_;
  std::vector<Change> changes_;
  std::uint32_t boot_id_ = 1;
  bool is_gone_ = false;
  int n_to_fail_ = 0;
  Errc failure_ = Errc::timeout;
  std::chrono::milliseconds hang_{0};
};

/// One thread, like every LightArray.
class FakeLightArray final : public LightArray {
 public:
  explicit FakeLightArray(std::shared_ptr<FakeLight> light) : light_(std::move(light)) {}

  [[nodiscard]] Result<ControllerIdentity> connect() override;
  void disconnect() noexcept override { boot_id_ = 0; }
  [[nodiscard]] Result<LatchReceipt> show(std::span<const ElementLevel> pattern,
                                          std::uint32_t tag) override;
  [[nodiscard]] Result<LatchReceipt> all_off() override;
  [[nodiscard]] Result<void> renew_lease() override;
  [[nodiscard]] Result<ControllerStatus> status() override;
  [[nodiscard]] Result<void> upload_table(std::span<const std::vector<ElementLevel>> patterns,
                                          std::span<const std::uint32_t> tags) override;
  [[nodiscard]] Result<LatchReceipt> step_table() override;

 private:
  /// Every call begins with this: the faults that were requested.
  [[nodiscard]] Result<void> reach();

  std::shared_ptr<FakeLight> light_;
  std::uint32_t boot_id_ = 0;  ///< of the connection; 0 = none
};

}  // namespace haarlight::firmware_iface
