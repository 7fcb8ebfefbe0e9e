// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/core/units.h"

/// @file
/// The rig as its file describes it: faces of LEDs, shadow planes, cameras, controller. Every
/// key is documented in docs/reference/rig-file.md. Lengths in mm, world frame (right-handed, z
/// up).

namespace haarlight {

struct MeasuredRig;

/// A rows x cols array of square LEDs. Light k of the rig = face offset + row * cols + col, col
/// along +u, row along +v, faces in file order.
struct Face {
  std::string id;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();
  Eigen::Vector3d emits = -Eigen::Vector3d::UnitZ();  ///< unit, orthogonal to u and v
  int rows = 0;
  int cols = 0;
  double pitch_mm = 0.0;
  double emitter_w_mm = 0.0;    ///< along u
  double emitter_h_mm = 0.0;    ///< along v
  Watts element_power{5.0};     ///< of one element at full drive
  double lobe_mu = 1.0;         ///< radiance ~ cos^(mu - 1); 1 = Lambertian
  Watts max_power{5.0};         ///< of the face at any time
  int string_lights = 0;        ///< lights k, k+1, ... on one supply string; 0: no strings
  Watts max_string_power{0.0};  ///< of a string at any time
  double pwm_hz = 0.0;          ///< dimmed by pulse width at this rate; 0: by current
  /// An element's heat follows its drive with time constant heat_tau_s and must stay below
  /// this; 1 = continuous full drive is allowed.
  double max_duty = 1.0;
  double heat_tau_s = 10.0;

  [[nodiscard]] int n_lights() const { return rows * cols; }
  /// Equal rows and cols, a power of two: required by plans of Haar patterns.
  [[nodiscard]] bool is_haar_grid() const;
};

/// A shadow sampling plane n.x + d = 0 with its picture's frame.
struct ShadowPlane {
  std::string id;
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  double d = 0.0;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< a point of the plane
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();      ///< unit, in the plane: picture's right
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();      ///< unit, in the plane: picture's up
  double extent_u_mm = 0.0;                          ///< full width, centred on the origin
  double extent_v_mm = 0.0;
  double texel_mm = 1.0;
};

enum class CameraKind { v4l2, remote, replay };
inline constexpr auto kCameraKindWords =
    std::to_array<std::string_view>({"v4l2", "remote", "replay"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(CameraKind) noexcept {
  return kCameraKindWords;
}
enum class Shutter { rolling, global };
inline constexpr auto kShutterWords = std::to_array<std::string_view>({"rolling", "global"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(Shutter) noexcept {
  return kShutterWords;
}
/// What a frame's timestamp means.
enum class TimestampMeaning { start_exposure, start_readout, end_frame };
inline constexpr auto kTimestampMeaningWords =
    std::to_array<std::string_view>({"start_exposure", "start_readout", "end_frame"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(TimestampMeaning) noexcept {
  return kTimestampMeaningWords;
}
enum class BayerPattern { none, rggb, bggr, grbg, gbrg };
inline constexpr auto kBayerPatternWords =
    std::to_array<std::string_view>({"none", "rggb", "bggr", "grbg", "gbrg"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(BayerPattern) noexcept {
  return kBayerPatternWords;
}

struct SensorNoise {
  double gain_e_per_dn = 1.0;
  double read_e = 0.0;       ///< rms, electrons
  double full_well_e = 0.0;  ///< electrons
  double black_dn = 0.0;
};

/// A control of a V4L2 camera and the value to set.
struct ControlSetting {
  std::string name;        ///< as `v4l2-ctl -L` spells it: "gain", "power_line_frequency"
  std::int64_t value = 0;  ///< in the control's own units; true is 1
  std::string entry;       ///< of a menu, by its name; empty: by value
};

/// Controls of a V4L2 camera that select what triggers an exposure, each list in file order.
struct V4l2Trigger {
  std::vector<ControlSetting> off;       ///< free-running
  std::vector<ControlSetting> software;  ///< `fire`; empty: it cannot
  std::vector<ControlSetting> line;      ///< its trigger input; empty: it cannot
  std::string fire;                      ///< a button, or a control that is set to 1
};

/// Settings that only V4L2 cameras have.
struct V4l2Settings {
  int n_buffers = 8;              ///< requested; the driver may give another number
  std::string serial;             ///< the device's own; empty: the first one found
  std::string exposure_control;   ///< empty: exposure_time_absolute or exposure; "none": fixed
  double exposure_unit_us = 0.0;  ///< step of that control; 0: 100 for exposure_time_absolute
  double gain_unit_db = 0.0;      ///< per step of the gain control; 0: gain_db is only recorded
  std::vector<ControlSetting> controls;  ///< in file order
  /// Sensor column and row where the frame begins; without it, the driver's default region.
  std::optional<std::array<int, 2>> crop;
  V4l2Trigger trigger;
};

struct CameraSpec {
  std::string id;
  CameraKind kind = CameraKind::remote;
  std::string device;    ///< node, socket path or session folder
  std::string format;    ///< fourcc as V4L2 names it: "Y16 ", "RG12", ...
  int frame_width = 0;   ///< as transmitted
  int frame_height = 0;  ///< as transmitted, embedded metadata rows included
  int active_rows = 0;   ///< image rows, from the top
  int bits = 16;         ///< significant bits per sample; white = 2^bits - 1
  double fps = 30.0;
  double exposure_us = 0.0;
  double gain_db = 0.0;
  Shutter shutter = Shutter::global;
  double skew_us = 0.0;  ///< start of the last row's exposure minus start of the first row's
  double read_us = 0.0;  ///< from the end of the first row's exposure to the timestamp's event
  TimestampMeaning timestamp = TimestampMeaning::end_frame;
  CameraModel model;  ///< of the active area
  BayerPattern bayer = BayerPattern::none;
  SensorNoise noise;
  /// Frames that begin after an exposure was set but still have the old one.
  int exposure_delay_frames = 0;
  V4l2Settings v4l2;
};

enum class ControllerKind { modbus_tcp, modbus_rtu, usb };
inline constexpr auto kControllerKindWords =
    std::to_array<std::string_view>({"modbus_tcp", "modbus_rtu", "usb"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(ControllerKind) noexcept {
  return kControllerKindWords;
}

struct ControllerSpec {
  ControllerKind kind = ControllerKind::modbus_tcp;
  std::string
      address;  ///< "127.0.0.1:1502", "/dev/serial/by-id/...:115200" or a USB serial number
  int unit = 1;
  std::string profile =
      "haarlight";  ///< or another vendor's registers: docs/reference/controllers.md
  std::chrono::milliseconds lease{2000};
  double rise_us = 0.0;   ///< light rise after the latch
  double fall_us = 0.0;   ///< light fall after the latch
  double latch_us = 0.0;  ///< from the acknowledged latch to the change of light
  // Not written in [controller]:
  double max_watts = 0.0;          ///< of all faces together; 0 = not known
  std::filesystem::path rig_file;  ///< whose folder is searched for a profile
};

enum class SyncMode { free_run, light_leads, camera_leads, controller_leads };
inline constexpr auto kSyncModeWords = std::to_array<std::string_view>(
    {"free-run", "light-leads", "camera-leads", "controller-leads"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(SyncMode) noexcept {
  return kSyncModeWords;
}

struct StorageSpec {
  std::string folder = "sessions";  ///< relative to the rig file
  double reserve_mb = 64.0;         ///< kept free in addition to the plan's own need
};

struct HttpSpec {
  std::string address = "127.0.0.1";
  int port = 8480;
  std::string token_file;  ///< required when the address is not loopback, or with allowed_hosts
  /// "NAME" or "NAME:PORT" in lower case: the public name of a TLS proxy in front of the
  /// daemon.
  std::vector<std::string> allowed_hosts;
};

struct Rig {
  int schema = 1;
  std::string name;
  Eigen::Vector3d object_centre = Eigen::Vector3d::Zero();
  std::vector<Face> faces;
  std::vector<ShadowPlane> planes;
  std::vector<CameraSpec> cameras;
  ControllerSpec controller;
  SyncMode sync = SyncMode::free_run;
  int strobe_every = 1;  ///< camera leads: the table steps at every n-th strobe
  StorageSpec storage;
  HttpSpec http;
  std::filesystem::path file;  ///< where it was read from
  std::string text;            ///< written and measured file, as stored with a session
  std::string hash;            ///< content_hash(text)
  std::shared_ptr<const MeasuredRig> measured;  ///< what was merged in; null: nothing

  [[nodiscard]] int n_lights() const;
};

/// One LED of the rig in the world.
struct LightElement {
  int index = 0;
  int face = 0;
  int row = 0;
  int col = 0;
  Eigen::Vector3d centre;
  Eigen::Vector3d u;  ///< unit, along the emitter's width
  Eigen::Vector3d v;  ///< unit, along its height
  Eigen::Vector3d emits;
  double width_mm = 0.0;
  double height_mm = 0.0;
  double lobe_mu = 1.0;
};

/// @param k  0 .. n_lights - 1
[[nodiscard]] LightElement light_element(const Rig& rig, int k);
[[nodiscard]] std::vector<LightElement> light_elements(const Rig& rig);

/// Reads and checks a rig file, and overrides it with the values of NAME.measured.toml next to
/// it (core/rig/measured_rig.h), as logged.
/// @throws Error  every problem with file:line and a hint; a stale measured file
[[nodiscard]] Rig read_rig(const std::filesystem::path& path);
/// The same without the measured file: for measuring commands and for a simulator.
[[nodiscard]] Rig read_rig_as_written(const std::filesystem::path& path);
/// The same from text, as a session stores it; `name` is used as the file's name in errors.
[[nodiscard]] Rig parse_rig(const std::string& text, const std::string& name);

}  // namespace haarlight
