// SPDX-License-Identifier: Apache-2.0
/// @file
/// Calls into the controller's driver that never return, while a light is on: the real drivers
/// against the simulated controller, by Modbus TCP and by USB (libusb under umockdev). A
/// operator's abort is answered all the same, the lease turns the light off, the last
/// resort does it at once, and when the call comes back so does the daemon.

#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <thread>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/firmware_iface/light_array.h"
#include "sim/controller_server.h"
#include "sim/usb_device.h"
#include "tests/capture/daemon_bench.h"
#include "tests/firmware_iface/usb_testbed.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;

const std::string kLongPlan =
    "schema = 1\nname = \"long\"\npatterns = \"one_at_a_time\"\nrepeats = 100\n";

/// Where every call stands while it is shut.
class Gate {
 public:
  void pass() {
    ++n_waiting_;
    while (is_shut_) {
      std::this_thread::sleep_for(1ms);
    }
    --n_waiting_;
  }
  void shut(bool is_shut) { is_shut_ = is_shut; }
  [[nodiscard]] bool is_shut() const { return is_shut_; }
  [[nodiscard]] int n_waiting() const { return n_waiting_; }

 private:
  std::atomic<bool> is_shut_{false};
  std::atomic<int> n_waiting_{0};
};

/// A driver whose calls do not come back while the gate is shut.
class StuckLights final : public firmware_iface::LightArray {
 public:
  StuckLights(std::unique_ptr<firmware_iface::LightArray> lights, Gate& gate)
      : lights_(std::move(lights)), gate_(gate) {}
  Result<firmware_iface::ControllerIdentity> connect() override { return passed().connect(); }
  void disconnect() noexcept override { passed().disconnect(); }
  Result<firmware_iface::LatchReceipt> show(
      std::span<const firmware_iface::ElementLevel> pattern, std::uint32_t tag) override {
    return passed().show(pattern, tag);
  }
  Result<firmware_iface::LatchReceipt> all_off() override { return passed().all_off(); }
  Result<void> renew_lease() override { return passed().renew_lease(); }
  Result<firmware_iface::ControllerStatus> status() override { return passed().status(); }
  Result<void> upload_table(std::span<const std::vector<firmware_iface::ElementLevel>> patterns,
                            std::span<const std::uint32_t> tags) override {
    return passed().upload_table(patterns, tags);
  }
  Result<firmware_iface::LatchReceipt> step_table() override { return passed().step_table(); }
  Result<void> set_trigger_delay(std::chrono::microseconds delay) override {
    return passed().set_trigger_delay(delay);
  }

 private:
  firmware_iface::LightArray& passed() {
    gate_.pass();
    return *lights_;
  }
  std::unique_ptr<firmware_iface::LightArray> lights_;
  Gate& gate_;
};

enum class Hang {
  call,  ///< the driver's call itself
  wire,  ///< below the driver: no answer comes on the wire, no completion from the system
};

struct Case {
  ControllerKind kind;
  Hang hang;
};

class HangingController : public testing::DaemonBench,
                          public ::testing::WithParamInterface<Case> {
 protected:
  void begin(std::chrono::milliseconds lease) {
    rig_.controller.kind = GetParam().kind;
    rig_.controller.lease = lease;
    sim::ControllerServerOptions options;
    options.controller = firmware_iface::controller_config(rig_);
    options.has_tcp = GetParam().kind == ControllerKind::modbus_tcp;
    server_ = std::make_unique<sim::ControllerServer>(std::move(options));
    if (GetParam().kind == ControllerKind::usb) {
      device_ = std::make_unique<sim::UsbLightDevice>(sim::UsbDeviceConfig{}, *server_);
      bus_ = std::make_unique<firmware_iface::UsbTestbed>();
      bus_->plug(*device_);
      rig_.controller.address = "HL000001";
    } else {
      rig_.controller.address = server_->tcp_address();
    }
    start();
    run_until_lit();
  }
  void run_until_lit() {
    (void)daemon_->run(kLongPlan, "long.toml");
    ASSERT_TRUE(wait_until([this](const DaemonState& s) {
      return s.phase == Phase::running && !server_->lit().pattern->empty();
    })) << daemon_->state().reason_text;
  }
  void TearDown() override {
    release();
    DaemonBench::TearDown();
  }

  /// Only the daemon's own light thread meets the hanging call; its last resort is another
  /// user.
  Result<std::unique_ptr<firmware_iface::LightArray>> make_light() override {
    auto lights = firmware_iface::make_light_array(rig_.controller, rig_.n_lights());
    if (!lights || gate_.is_shut()) {
      return lights;
    }
    return std::make_unique<StuckLights>(*std::move(lights), gate_);
  }

  void hang() {
    if (GetParam().hang == Hang::call) {
      gate_.shut(true);
      ASSERT_TRUE(wait_until([this](const DaemonState&) { return gate_.n_waiting() == 1; }));
    } else if (bus_ != nullptr) {
      bus_->hold_completions(1);
      // Before the last resort asks: it is the light thread that shall hang.
      ASSERT_TRUE(wait_until([this](const DaemonState&) { return bus_->n_holding() == 1; }));
    } else {
      // The next request is either lost or the last one that is not: the only host sends one at
      // a time.
      server_->inject({.kind = sim::WireFault::drop_request, .count = -1});
      const std::uint64_t n_requests = server_->n_requests();
      ASSERT_TRUE(
          wait_until([&](const DaemonState&) { return server_->n_requests() > n_requests; }));
    }
  }
  void release() {
    gate_.shut(false);
    if (bus_ != nullptr) {
      bus_->release_completions();
    }
    if (server_ != nullptr) {
      server_->clear_faults();
    }
  }
  double on_seconds() {
    double sum = 0.0;
    for (int k = 0; k < rig_.n_lights(); ++k) {
      sum += server_->total_on_seconds(k);
    }
    return sum;
  }
  bool is_dark() { return server_->lit().pattern->empty(); }

  Gate gate_;
  std::unique_ptr<sim::ControllerServer> server_;
  std::unique_ptr<sim::UsbLightDevice> device_;
  std::unique_ptr<firmware_iface::UsbTestbed> bus_;
};

// That it is answered within 200 ms is held under virtual time (daemon_test.cpp).
TEST_P(HangingController, AnAbortDoesNotWaitForTheCallAndTheLeasePutsTheLightOut) {
  constexpr auto kLease = 1000ms;
  begin(kLease);
  hang();
  const double on_before = on_seconds();
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle)) << "the call hangs still";
  ASSERT_TRUE(wait_until([this](const DaemonState&) { return is_dark(); }));
  const double spent_s = on_seconds() - on_before;
  fmt::print("{:.3f} s on after the hang, the lease is {:.3f} s\n", spent_s,
             1e-3 * static_cast<double>(kLease.count()));
  // By the controller's clock, and one light is on all the while; the sum's rounding.
  EXPECT_LE(spent_s, 1e-3 * static_cast<double>(kLease.count()) + 1e-6);
  release();
  run_until_lit();
}

TEST_P(HangingController, TheLastResortPutsTheLightOutWithoutTheLease) {
  if (GetParam().hang == Hang::wire && GetParam().kind == ControllerKind::modbus_tcp) {
    GTEST_SKIP() << "a controller that answers nobody has its lease alone";
  }
  begin(30s);
  hang();
  ASSERT_FALSE(is_dark());
  daemon_->put_lights_out();
  EXPECT_TRUE(is_dark());
}

INSTANTIATE_TEST_SUITE_P(Wires, HangingController,
                         ::testing::Values(Case{ControllerKind::modbus_tcp, Hang::call},
                                           Case{ControllerKind::modbus_tcp, Hang::wire},
                                           Case{ControllerKind::usb, Hang::call},
                                           Case{ControllerKind::usb, Hang::wire}),
                         [](const auto& one) {
                           return std::string(one.param.kind == ControllerKind::usb
                                                  ? "Usb"
                                                  : "Modbus") +
                                  (one.param.hang == Hang::call ? "Call" : "Wire");
                         });

}  // namespace
}  // namespace haarlight::capture

int main(int argc, char** argv) {
  haarlight::firmware_iface::require_mock_environment(argv);
  testing::InitGoogleMock(&argc, argv);
  return RUN_ALL_TESTS();
}
