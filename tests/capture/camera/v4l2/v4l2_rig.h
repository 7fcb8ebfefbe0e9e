// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include "capture/camera/v4l2_camera.h"
#include "tests/capture/camera/v4l2/v4l2_shim.h"
#include "tests/temporary_folder.h"

/// @file
/// A machine with V4L2 cameras, for tests: folders instead of /dev and /sys, the shim's
/// cameras in them, and a rig file's camera to go with them.

namespace haarlight::testing {

constexpr int kTestWidth = 10;
constexpr int kTestHeight = 6;

/// The controls of a usual USB camera, everything automatic.
inline std::vector<shim::Control> usual_controls() {
  using C = shim::Control;
  return {
      C{.id = V4L2_CID_AUTO_WHITE_BALANCE,
        .name = "White Balance, Automatic",
        .type = V4L2_CTRL_TYPE_BOOLEAN,
        .max = 1,
        .value = 1},
      C{.id = V4L2_CID_GAIN, .name = "Gain", .min = 0, .max = 255, .value = 64},
      C{.id = V4L2_CID_POWER_LINE_FREQUENCY,
        .name = "Power Line Frequency",
        .type = V4L2_CTRL_TYPE_MENU,
        .max = 2,
        .value = 1,
        .entries = {"Disabled", "50 Hz", "60 Hz"}},
      C{.id = V4L2_CID_EXPOSURE_AUTO,
        .name = "Auto Exposure",
        .type = V4L2_CTRL_TYPE_MENU,
        .max = 3,
        .value = 3,
        .entries = {"", "Manual Mode", "", "Aperture Priority Mode"}},
      C{.id = V4L2_CID_EXPOSURE_ABSOLUTE,
        .name = "Exposure Time, Absolute",
        .min = 1,
        .max = 10000,
        .value = 157},
      C{.id = V4L2_CID_EXPOSURE_AUTO_PRIORITY,
        .name = "Exposure, Dynamic Framerate",
        .type = V4L2_CTRL_TYPE_BOOLEAN,
        .max = 1,
        .value = 1},
      C{.id = V4L2_CID_FOCUS_ABSOLUTE, .name = "Focus, Absolute", .max = 250, .step = 5},
      C{.id = V4L2_CID_FOCUS_AUTO,
        .name = "Focus, Automatic Continuous",
        .type = V4L2_CTRL_TYPE_BOOLEAN,
        .max = 1,
        .value = 1},
  };
}

inline shim::Camera usual_camera() {
  shim::Camera camera;
  camera.offers = {{"Y16 ", {{kTestWidth, kTestHeight}, {640, 480}}, {30, 60}},
                   {"GREY", {{kTestWidth, kTestHeight}}, {30}}};
  camera.controls = usual_controls();
  return camera;
}

inline constexpr std::uint32_t kTriggerMode = V4L2_CID_CAMERA_CLASS_BASE + 47;
inline constexpr std::uint32_t kTriggerSource = V4L2_CID_CAMERA_CLASS_BASE + 49;
inline constexpr std::uint32_t kTriggerSoftware = V4L2_CID_CAMERA_CLASS_BASE + 50;

/// The trigger controls of Allied Vision's driver.
inline void add_trigger(shim::Camera& camera) {
  using C = shim::Control;
  camera.controls.push_back(
      C{.id = kTriggerMode, .name = "Trigger Mode", .type = V4L2_CTRL_TYPE_BOOLEAN, .max = 1});
  camera.controls.push_back(C{.id = kTriggerSource,
                              .name = "Trigger Source",
                              .type = V4L2_CTRL_TYPE_MENU,
                              .max = 4,
                              .entries = {"Line 0", "Line 1", "Line 2", "Line 3", "Software"}});
  camera.controls.push_back(
      C{.id = kTriggerSoftware,
        .name = "Trigger Software",
        .type = V4L2_CTRL_TYPE_BUTTON,
        .max = 0,
        .flags = V4L2_CTRL_FLAG_WRITE_ONLY | V4L2_CTRL_FLAG_EXECUTE_ON_WRITE});
  camera.trigger_mode = kTriggerMode;
  camera.trigger_button = kTriggerSoftware;
}

inline V4l2Trigger usual_trigger() {
  return {.off = {{"trigger_mode", 0, ""}},
          .software = {{"trigger_source", 0, "Software"}, {"trigger_mode", 1, ""}},
          .line = {{"trigger_source", 0, "Line 0"}, {"trigger_mode", 1, ""}},
          .fire = "trigger_software"};
}

class V4l2Machine {
 public:
  V4l2Machine() {
    std::filesystem::create_directories(folder_ / "dev/v4l/by-id");
    std::filesystem::create_directories(folder_ / "sys/class/video4linux");
    shim::reset_calls();
  }
  ~V4l2Machine() { shim::unplug_all(); }
  V4l2Machine(const V4l2Machine&) = delete;
  V4l2Machine& operator=(const V4l2Machine&) = delete;

  [[nodiscard]] capture::V4l2Paths paths() const { return {folder_ / "dev", folder_ / "sys"}; }
  [[nodiscard]] std::string node(int n) const {
    return (folder_ / ("dev/video" + std::to_string(n))).string();
  }

  /// A camera as videoN; with an empty serial number it has none.
  void plug(int n, shim::Camera camera, const std::string& serial = "", int index = 0) {
    namespace fs = std::filesystem;
    std::ofstream(node(n)).put('\n');
    const std::string name = "video" + std::to_string(n);
    const fs::path device = folder_ / ("sys/devices/usb1/1-" + name);
    fs::create_directories(device / "1-1:1.0");
    write(folder_ / "sys/devices/usb1/serial", "of the hub");
    write(device / "idVendor", "1234");
    if (!serial.empty()) {
      write(device / "serial", serial);
    }
    const fs::path entry = folder_ / ("sys/class/video4linux/" + name);
    fs::create_directories(entry);
    write(entry / "index", std::to_string(index));
    fs::create_directory_symlink(device / "1-1:1.0", entry / "device");
    shim::plug(node(n), std::move(camera));
  }
  void link(int n, const std::string& id) const {
    const auto name = folder_ / ("dev/v4l/by-id/" + id);
    std::filesystem::remove(name);
    std::filesystem::create_symlink("../../video" + std::to_string(n), name);
  }
  [[nodiscard]] std::string link_path(const std::string& id) const {
    return (folder_ / ("dev/v4l/by-id/" + id)).string();
  }
  void unplug(int n) const {
    shim::unplug(node(n));
    std::filesystem::remove(node(n));
    const std::string name = "video" + std::to_string(n);
    std::filesystem::remove_all(folder_ / ("sys/class/video4linux/" + name));
    std::filesystem::remove_all(folder_ / ("sys/devices/usb1/1-" + name));
  }

  [[nodiscard]] CameraSpec spec(int n) const {
    CameraSpec spec;
    spec.id = "main";
    spec.kind = CameraKind::v4l2;
    spec.device = node(n);
    spec.format = "Y16 ";
    spec.frame_width = kTestWidth;
    spec.frame_height = kTestHeight;
    spec.active_rows = kTestHeight;
    spec.fps = 60.0;
    spec.exposure_us = 2000.0;
    spec.v4l2.n_buffers = 4;
    return spec;
  }

 private:
  static void write(const std::filesystem::path& file, const std::string& text) {
    std::ofstream(file) << text << '\n';
  }
  TemporaryFolder folder_;
};

inline std::chrono::steady_clock::time_point in(std::chrono::milliseconds time) {
  return std::chrono::steady_clock::now() + time;
}

/// Descriptors that this process has open.
inline std::size_t count_descriptors() {
  std::size_t n = 0;
  for ([[maybe_unused]] const auto& entry :
       std::filesystem::directory_iterator("/proc/self/fd")) {
    ++n;
  }
  return n;
}

}  // namespace haarlight::testing
