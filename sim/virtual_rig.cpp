// SPDX-License-Identifier: Apache-2.0
#include "sim/virtual_rig.h"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <stop_token>
#include <system_error>
#include <thread>

#include <fmt/format.h>

#include "core/log.h"
#include "haarlight/core/error.h"

namespace haarlight::sim {

namespace {

using namespace std::chrono_literals;

/// One action of the fault script, in seconds since the first frame.
struct FaultEvent {
  double at_s = 0.0;
  std::function<void(ControllerServer&)> act;
};

std::vector<FaultEvent> timetable(const FaultScript& script) {
  std::vector<FaultEvent> events;
  for (const BusFault& bus : script.bus) {
    if (bus.is_dead) {
      events.push_back({bus.at_s, [](ControllerServer& server) {
                          server.inject({.kind = WireFault::drop_reply, .count = -1});
                        }});
      events.push_back(
          {bus.at_s + bus.for_s, [](ControllerServer& server) { server.clear_faults(); }});
    } else {
      const auto delay =
          std::chrono::microseconds(static_cast<std::int64_t>(bus.delay_ms * 1e3));
      events.push_back(
          {bus.at_s, [delay](ControllerServer& server) { server.set_reply_delay(delay); }});
      events.push_back({bus.at_s + bus.for_s,
                        [](ControllerServer& server) { server.set_reply_delay(0us); }});
    }
  }
  for (const ControllerRestart& restart : script.restarts) {
    const auto off = std::chrono::milliseconds(static_cast<std::int64_t>(restart.off_ms));
    events.push_back({restart.at_s, [off](ControllerServer& server) { server.restart(off); }});
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const FaultEvent& a, const FaultEvent& b) { return a.at_s < b.at_s; });
  return events;
}

constexpr std::int64_t kLookaheadNs = 50'000'000;  // how late this machine may be

/// The number after the last colon of an address.
int number_after_colon(const std::string& address, int fallback) {
  const std::size_t colon = address.rfind(':');
  int value = fallback;
  if (colon != std::string::npos) {
    std::from_chars(address.data() + colon + 1, address.data() + address.size(), value);
  }
  return value;
}

ControllerServerOptions controller_options(const Rig& rig, const VirtualRigOptions& options,
                                           std::function<void(std::int64_t)> trigger) {
  ControllerServerOptions server;
  server.trigger = std::move(trigger);
  server.controller = firmware_iface::controller_config(rig);
  server.unit = rig.controller.unit;
  const bool is_own = !options.own_folder.empty();
  switch (rig.controller.kind) {
    case ControllerKind::modbus_tcp:
      server.tcp_port = is_own ? 0 : number_after_colon(rig.controller.address, 1502);
      break;
    case ControllerKind::modbus_rtu:
      server.has_tcp = false;
      server.has_rtu = true;
      server.baud = number_after_colon(rig.controller.address, 115200);
      break;
    case ControllerKind::usb:
      server.has_tcp = false;
      if (options.usb_redir.empty()) {
        throw Error(
            "a controller on USB is simulated for a virtual machine only", rig.file.string(),
            "give --usb-redir SOCKET, or set kind = \"modbus_tcp\" or \"modbus_rtu\" in "
            "[controller]");
      }
      break;
  }
  return server;
}

}  // namespace

struct VirtualRig::Impl {
  Rig rig;
  std::mutex line_mutex;                ///< of the trigger line
  CameraServer* line_camera = nullptr;  ///< at its end
  ControllerServer controller;
  std::filesystem::path rtu_link;
  std::unique_ptr<UsbLightDevice> usb_device;
  std::unique_ptr<UsbRedirServer> usb_server;
  std::vector<std::unique_ptr<CameraServer>> cameras;  ///< null: not on a socket
  std::unique_ptr<V4l2Output> v4l2_output;
  std::vector<FaultEvent> events;
  std::mutex mutex;
  std::condition_variable_any wake;
  std::jthread fault_thread;

  Impl(const Rig& wanted, std::span<const Transport> transports,
       const VirtualRigOptions& options)
      : rig(wanted), controller(controller_options(wanted, options, [this](std::int64_t t_ns) {
          const std::lock_guard lock(line_mutex);
          if (line_camera != nullptr) {
            line_camera->trigger_line(t_ns);
          }
        })) {
    if (options.has_cameras && transports.size() != rig.cameras.size()) {
      throw Error(fmt::format("{} transport matrices for {} cameras", transports.size(),
                              rig.cameras.size()),
                  rig.file.string(), "make one for each camera");
    }
    if (rig.controller.kind == ControllerKind::modbus_tcp) {
      rig.controller.address = controller.tcp_address();
    } else if (rig.controller.kind == ControllerKind::modbus_rtu) {
      serve_rtu_link(options);
    } else {
      UsbDeviceConfig device;
      device.serial = rig.controller.address;
      usb_device = std::make_unique<UsbLightDevice>(std::move(device), controller);
      usb_server = std::make_unique<UsbRedirServer>(*usb_device, options.usb_redir);
    }
    const Rig true_rig = apply_truth(options.truth, rig);
    for (std::size_t i = 0; options.has_cameras && i < rig.cameras.size(); ++i) {
      CameraSpec& spec = rig.cameras[i];
      LightSource light;
      light.history = [this](std::int64_t t0, std::int64_t t1) {
        return controller.transitions(t0, t1);
      };
      if (rig.sync == SyncMode::camera_leads && i == 0) {
        light.strobe = [this](std::int64_t t_ns) { controller.strobe_at(t_ns); };
      }
      if (i == 0 && !options.v4l2_output.empty()) {
        V4l2OutputOptions output;
        output.camera.seed = options.seed;
        output.camera.lit_electrons = options.lit_electrons;
        output.record = options.record;
        spec.device = options.v4l2_output.string();
        v4l2_output = std::make_unique<V4l2Output>(
            spec, rig.controller, transports[i], std::move(light), options.v4l2_output, output);
        cameras.push_back(nullptr);
        continue;
      }
      if (spec.kind != CameraKind::remote) {
        throw Error(fmt::format("camera {} is not remote", spec.id), rig.file.string(),
                    "set kind = \"remote\" and device = a socket's path");
      }
      if (!options.own_folder.empty()) {
        spec.device = (options.own_folder / (spec.id + ".sock")).string();
      }
      CameraServerOptions server;
      server.camera.seed = options.seed + i;
      server.camera.lit_electrons = options.lit_electrons;
      server.camera.light_power = true_light_power(options.truth, rig.n_lights());
      server.camera.wiring = true_wiring(options.truth, rig.n_lights());
      server.camera.flaws = true_flaws(options.truth, spec.id);
      server.exposure_delay_frames = true_rig.cameras[i].exposure_delay_frames;
      server.n_buffers = options.n_buffers;
      server.faults = options.faults.frames;
      server.fault_seed = options.seed + 1000 + i;
      server.doubtful_us = options.doubtful_us;
      server.is_prepared = options.is_prepared;
      if (rig.sync == SyncMode::camera_leads) {
        server.doubtful_us = 0.0;  // the strobe, not the host, times the light
        server.lookahead_ns = kLookaheadNs;
        server.strobe_lost_probability = options.strobe_lost_probability;
        server.strobe_false_probability = options.strobe_false_probability;
      } else if (rig.sync != SyncMode::free_run) {
        server.doubtful_us = 0.0;  // each trigger exposes one frame: it must not be lost
      }
      cameras.push_back(std::make_unique<CameraServer>(true_rig.cameras[i], true_rig.controller,
                                                       transports[i], std::move(light),
                                                       spec.device, server));
    }
    {
      const std::lock_guard lock(line_mutex);
      line_camera = cameras.empty() ? nullptr : cameras.front().get();
    }
    firmware_iface::LateActing late = options.faults.late_light;
    late.seed = options.seed + 2000;
    controller.set_late_acting(late);
    events = timetable(options.faults);
    if (!events.empty()) {
      fault_thread = std::jthread([this](const std::stop_token& stop) { run_faults(stop); });
    }
  }

  ~Impl() {
    fault_thread = std::jthread();  // stops and joins before what it uses is destroyed
    v4l2_output.reset();
    {
      const std::lock_guard lock(line_mutex);
      line_camera = nullptr;
    }
    cameras.clear();
    if (!rtu_link.empty()) {
      std::error_code ignored;
      std::filesystem::remove(rtu_link, ignored);
    }
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  /// Links the rig file's serial path to the pseudo-terminal while the rig lives.
  void serve_rtu_link(const VirtualRigOptions& options) {
    if (!options.own_folder.empty()) {
      rig.controller.address = controller.rtu_address();
      return;
    }
    const std::string& address = rig.controller.address;
    const std::filesystem::path link = address.substr(0, address.rfind(':'));
    std::error_code failed;
    if (std::filesystem::is_symlink(link, failed) && !std::filesystem::exists(link, failed)) {
      std::filesystem::remove(link, failed);  // left over from a killed process
    }
    std::filesystem::create_directories(link.parent_path(), failed);
    std::filesystem::create_symlink(controller.rtu_path(), link, failed);
    if (failed) {
      throw Error("the serial line's path cannot be made: " + failed.message(), link.string(),
                  "give an unused path in a folder that can be written", ExitCode::unavailable);
    }
    rtu_link = link;
  }

  /// False when stopping.
  bool sleep_until(const std::stop_token& stop, std::chrono::steady_clock::time_point until) {
    std::unique_lock lock(mutex);
    wake.wait_until(lock, stop, until, [] { return false; });
    return !stop.stop_requested();
  }

  void run_faults(const std::stop_token& stop) {
    try {
      std::optional<std::int64_t> first;
      if (cameras.empty() || cameras.front() == nullptr) {
        first = std::chrono::steady_clock::now().time_since_epoch() / 1ns;
      }
      while (!first && !(first = cameras.front()->first_frame_ns())) {
        if (!sleep_until(stop, std::chrono::steady_clock::now() + 5ms)) {
          return;
        }
      }
      const std::chrono::steady_clock::time_point start{std::chrono::nanoseconds(*first)};
      for (const FaultEvent& event : events) {
        const auto at = std::chrono::nanoseconds(static_cast<std::int64_t>(event.at_s * 1e9));
        if (!sleep_until(stop, start + at)) {
          return;
        }
        event.act(controller);
      }
    } catch (const std::exception& error) {
      log_error(fmt::format("fault script: {}", error.what()));
    }
  }
};

VirtualRig::VirtualRig(const Rig& rig, std::span<const Transport> transports,
                       const VirtualRigOptions& options)
    : impl_(std::make_unique<Impl>(rig, transports, options)) {}
VirtualRig::~VirtualRig() = default;
const Rig& VirtualRig::rig() const { return impl_->rig; }
ControllerServer& VirtualRig::controller() { return impl_->controller; }
UsbLightDevice* VirtualRig::usb_device() { return impl_->usb_device.get(); }
UsbRedirServer* VirtualRig::usb_server() { return impl_->usb_server.get(); }
CameraServer& VirtualRig::camera(int i) {
  HAARLIGHT_EXPECTS(impl_->cameras.at(static_cast<std::size_t>(i)) != nullptr,
                    "a camera that is served on a socket");
  return *impl_->cameras[static_cast<std::size_t>(i)];
}
V4l2Output* VirtualRig::v4l2_output() { return impl_->v4l2_output.get(); }

}  // namespace haarlight::sim
