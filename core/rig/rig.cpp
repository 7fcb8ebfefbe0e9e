// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/rig.h"

#include <array>
#include <bit>
#include <cmath>
#include <set>

#include <arpa/inet.h>
#include <fmt/format.h>

#include "core/config_table.h"
#include "core/log.h"
#include "core/rig/controller_address.h"
#include "core/rig/measured_rig.h"
#include "core/rig/pixel_format.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight {

namespace {

constexpr std::uintmax_t kMaxRigText = kMaxTomlBytes;
constexpr int kMaxLights = 6 * 64 * 64;
constexpr double kUnitTol = 1e-6;  // a hand-written unit vector carries about six digits
constexpr double kMaxLengthMm = 1e6;
constexpr Range kPosition{.min = -kMaxLengthMm, .max = kMaxLengthMm};
constexpr double kMaxFramePixels =
    0x1p28;  // as for a picture (haarlight/core/picture/image_io.h)
// USB cameras need one or two frames, sensors behind a pipeline up to three.
constexpr int kUsualExposureDelay = 3;

Eigen::Vector3d vector3(ConfigTable& table, std::string_view key) {
  const std::vector<double> x = table.numbers(key, 3, kPosition);
  return {x[0], x[1], x[2]};
}

Eigen::Vector3d unit_vector(ConfigTable& table, std::string_view key) {
  const Eigen::Vector3d x = vector3(table, key);
  if (std::abs(x.norm() - 1.0) > kUnitTol) {
    table.problem(key, fmt::format("{} has length {}, not 1", key, x.norm()),
                  "write a unit vector");
    return Eigen::Vector3d::UnitX();
  }
  return x.normalized();
}

void require_orthogonal(ConfigTable& table, std::string_view key, const Eigen::Vector3d& a,
                        const Eigen::Vector3d& b, std::string_view other) {
  if (std::abs(a.dot(b)) > kUnitTol) {
    table.problem(key, fmt::format("{} is not at right angles to {}", key, other),
                  "u, v and the normal must be orthogonal");
  }
}

Face read_face(ConfigTable& t) {
  Face face;
  face.id = t.text("id");
  face.centre = vector3(t, "centre");
  face.u = unit_vector(t, "u");
  face.v = unit_vector(t, "v");
  face.emits = unit_vector(t, "emits");
  require_orthogonal(t, "v", face.u, face.v, "u");
  require_orthogonal(t, "emits", face.u, face.emits, "u");
  require_orthogonal(t, "emits", face.v, face.emits, "v");
  face.rows = static_cast<int>(t.integer("rows", {.min = 1, .max = 256}));
  face.cols = static_cast<int>(t.integer("cols", {.min = 1, .max = 256}));
  face.pitch_mm = t.number("pitch", {.min = 1e-3, .max = kMaxLengthMm});
  const std::vector<double> emitter = t.numbers("emitter", 2, kPosition);
  face.emitter_w_mm = emitter[0];
  face.emitter_h_mm = emitter[1];
  if (!(emitter[0] > 0.0 && emitter[1] > 0.0) ||
      std::max(emitter[0], emitter[1]) > face.pitch_mm) {
    t.problem("emitter", "an emitter must be larger than 0 and not larger than the pitch",
              "write emitter = [width, height] in mm");
  }
  face.element_power = Watts(t.number("watts", {.min = 0.0, .max = 1e4}));
  face.lobe_mu = t.number_or("lobe_mu", 1.0, {.min = 0.0, .max = 1e3});
  face.max_power = Watts(t.number("max_watts", {.min = 0.0, .max = 1e6}));
  if (face.max_power < face.element_power) {
    t.problem("max_watts", "max_watts is below the power of a single element",
              "one element at full drive must be allowed");
  }
  face.string_lights = static_cast<int>(t.integer_or("string", 0, {.min = 0, .max = 65536}));
  face.max_string_power = Watts(t.number_or("max_string_watts", 0.0, {.min = 0.0, .max = 1e6}));
  if ((face.string_lights > 0) != (face.max_string_power.value() > 0.0)) {
    t.problem("string", "string and max_string_watts stand together",
              "write how many lights share a string and what it can give, or neither");
  } else if (face.string_lights > 0 && face.max_string_power < face.element_power) {
    t.problem("max_string_watts", "less than one element's watts", "correct one of the two");
  }
  face.pwm_hz = t.number_or("pwm_hz", 0.0, {.min = 0.0, .max = 1e9});
  face.max_duty = t.number_or("max_duty", 1.0, {.min = 1e-6, .max = 1.0});
  face.heat_tau_s = t.number_or("heat_tau_s", 10.0, {.min = 1e-3, .max = 1e6});
  return face;
}

ShadowPlane read_plane(ConfigTable& t) {
  ShadowPlane plane;
  plane.id = t.text("id");
  plane.n = unit_vector(t, "n");
  plane.d = t.number("d", {.min = -kMaxLengthMm, .max = kMaxLengthMm});
  plane.origin = vector3(t, "origin");
  plane.u = unit_vector(t, "u");
  plane.v = unit_vector(t, "v");
  require_orthogonal(t, "u", plane.u, plane.n, "n");
  require_orthogonal(t, "v", plane.v, plane.n, "n");
  require_orthogonal(t, "v", plane.u, plane.v, "u");
  if (std::abs(plane.n.dot(plane.origin) + plane.d) > 1e-6 * (1.0 + std::abs(plane.d))) {
    t.problem("origin", "the origin does not lie on the plane n.x + d = 0",
              "correct origin or d");
  }
  const std::vector<double> extent = t.numbers("extent", 2, kPosition);
  plane.extent_u_mm = extent[0];
  plane.extent_v_mm = extent[1];
  plane.texel_mm = t.number("texel", {.min = 1e-3, .max = kMaxLengthMm});
  if (!(extent[0] > 0.0 && extent[1] > 0.0)) {
    t.problem("extent", "an extent must be larger than 0",
              "write extent = [width, height] in mm");
  } else if (extent[0] / plane.texel_mm * (extent[1] / plane.texel_mm) > 1e8) {
    t.problem("texel", "the plane picture would have more than 10^8 texels",
              "make texel larger or extent smaller");
  }
  return plane;
}

std::vector<ControlSetting> read_controls(ConfigTable& t) {
  std::vector<ControlSetting> controls;
  for (const std::string& name : t.keys()) {
    ControlSetting control;
    control.name = name;
    if (t.is_text(name)) {
      control.entry = t.text(name);
    } else if (t.is_flag(name)) {
      control.value = t.flag_or(name, false) ? 1 : 0;
    } else {
      control.value = t.integer(name);
    }
    controls.push_back(std::move(control));
  }
  return controls;
}

/// A region of the sensor: K is the whole sensor's, the model is the frame's.
void read_crop(ConfigTable& t, CameraSpec& camera) {
  const std::vector<double> at = t.numbers("crop", 2);
  const bool is_mosaic = camera.bayer != BayerPattern::none;
  const bool is_whole = at[0] == std::floor(at[0]) && at[1] == std::floor(at[1]);
  if (!is_whole || !(at[0] >= 0 && at[1] >= 0 && at[0] <= 65536 && at[1] <= 65536)) {
    t.problem("crop", "not a pixel of the sensor",
              "write crop = [column, row]: where the frame of `size` begins");
    return;
  }
  if (is_mosaic && (std::fmod(at[0], 2.0) != 0.0 || std::fmod(at[1], 2.0) != 0.0)) {
    t.problem("crop", "an odd number would begin the colour mosaic with another colour",
              "write even numbers");
    return;
  }
  camera.v4l2.crop = {static_cast<int>(at[0]), static_cast<int>(at[1])};
  camera.model.cx -= at[0];
  camera.model.cy -= at[1];
}

V4l2Trigger read_trigger(ConfigTable& t) {
  V4l2Trigger trigger;
  for (auto [key, list] : {std::pair{"off", &trigger.off},
                           {"software", &trigger.software},
                           {"line", &trigger.line}}) {
    if (auto controls = t.table(key)) {
      *list = read_controls(*controls);
    }
  }
  trigger.fire = t.text_or("fire", "");
  if (trigger.off.empty()) {
    t.problem("off", "off is missing: a camera left waiting for a trigger would stay silent",
              "write what lets it run freely: off = { trigger_mode = 0 }");
  }
  if (trigger.software.empty() != trigger.fire.empty()) {
    t.problem(trigger.fire.empty() ? "software" : "fire",
              "software and fire go together: what makes it wait, and what starts an exposure",
              "write both: software = { trigger_mode = 1 }, fire = \"trigger_software\"");
  }
  return trigger;
}

/// A V4L2 camera's format supplies missing keys, and must not contradict others.
void read_v4l2(ConfigTable& t, CameraSpec& camera) {
  V4l2Settings& v4l2 = camera.v4l2;
  v4l2.n_buffers = static_cast<int>(t.integer_or("buffers", 8, {.min = 2, .max = 32}));
  v4l2.serial = t.text_or("serial", "");
  v4l2.exposure_control = t.text_or("exposure_control", "");
  v4l2.exposure_unit_us = t.number_or("exposure_unit_us", 0.0, {.min = 1e-6, .max = 1e6});
  v4l2.gain_unit_db = t.number_or("gain_unit_db", 0.0, {.min = 1e-6, .max = 100.0});
  if (!t.has("exposure_delay_frames")) {
    camera.exposure_delay_frames = kUsualExposureDelay;
  }
  if (auto controls = t.table("controls")) {
    v4l2.controls = read_controls(*controls);
  }
  if (auto trigger = t.table("trigger")) {
    v4l2.trigger = read_trigger(*trigger);
  }
  const PixelFormat* format = find_pixel_format(camera.format);
  if (format == nullptr) {
    std::vector<std::string> known;
    std::string list;
    for (const PixelFormat& each : pixel_formats()) {
      known.emplace_back(each.fourcc);
      list += fmt::format("{}\"{}\"", list.empty() ? "" : ", ", each.fourcc);
    }
    const std::string near = nearest_word(camera.format, known);
    t.problem(
        "format", fmt::format("\"{}\" is no pixel format that haarlight reads", camera.format),
        (near.empty() ? "" : fmt::format("did you mean \"{}\"? ", near)) + "Known: " + list);
    return;
  }
  camera.format = format->fourcc;
  const bool may_be_fewer = format->bits == 16;
  if (!t.has("bits")) {
    camera.bits = format->bits;
  } else if (camera.bits != format->bits && !(may_be_fewer && camera.bits < 16)) {
    t.problem("bits",
              fmt::format("bits = {}, but {} has {}", camera.bits, format->name, format->bits),
              "leave bits out");
  }
  if (!t.has("bayer")) {
    camera.bayer = format->bayer;
  } else if (camera.bayer != format->bayer) {
    t.problem("bayer",
              fmt::format("bayer = \"{}\", but the format is {}", to_string(camera.bayer),
                          format->name),
              "leave bayer out");
  }
  if (t.has("crop")) {
    read_crop(t, camera);
  }
}

/// A V4L2 camera is triggered by controls that have no common names: the rig file names them.
void require_trigger(ConfigTable& sync, SyncMode mode, const CameraSpec& camera) {
  const V4l2Trigger& trigger = camera.v4l2.trigger;
  const bool is_missing = (mode == SyncMode::light_leads && trigger.software.empty()) ||
                          (mode == SyncMode::controller_leads && trigger.line.empty());
  if (camera.kind == CameraKind::v4l2 && is_missing) {
    const char* what = mode == SyncMode::light_leads ? "software" : "line";
    sync.problem(
        "mode",
        fmt::format("camera \"{}\" has no trigger.{} here: it would run freely", camera.id,
                    what),
        fmt::format("write in [[camera]] which of its controls make it wait (haarlight "
                    "cameras lists them): trigger = {{ off = {{ .. }}, {} = {{ .. "
                    "}}{} }}; or mode = \"free-run\"",
                    what, mode == SyncMode::light_leads ? ", fire = \"..\"" : ""));
  }
}

CameraSpec read_camera(ConfigTable& t) {
  CameraSpec camera;
  camera.id = t.text("id");
  camera.kind = t.one_of<CameraKind>("kind");
  camera.device = t.text("device");
  camera.format = t.text_or("format", "Y16 ");
  const std::vector<double> size = t.numbers("size", 2);
  if (!(size[0] >= 1 && size[1] >= 1 && size[0] <= 65536 && size[1] <= 65536) ||
      size[0] != std::floor(size[0]) || size[1] != std::floor(size[1]) ||
      size[0] * size[1] > kMaxFramePixels) {
    t.problem("size", "not a frame size",
              "write size = [width, height] in pixels: up to 65536 each, 2^28 in all");
    camera.frame_width = camera.frame_height = 1;
  } else {
    camera.frame_width = static_cast<int>(size[0]);
    camera.frame_height = static_cast<int>(size[1]);
  }
  camera.active_rows = static_cast<int>(
      t.integer_or("active_area", camera.frame_height,
                   {.min = 1, .max = static_cast<double>(camera.frame_height)}));
  camera.bits = static_cast<int>(t.integer_or("bits", 16, {.min = 8, .max = 16}));
  camera.fps = t.number("fps", {.min = 1e-3, .max = 1e5});
  camera.exposure_us = t.number("exposure_us", {.min = 1.0, .max = 1e9});
  camera.gain_db = t.number_or("gain_db", 0.0, {.min = -100.0, .max = 100.0});
  camera.shutter = t.one_of<Shutter>("shutter");
  camera.skew_us = t.number_or("skew_us", 0.0, {.min = 0.0, .max = 1e9});
  if (camera.shutter == Shutter::global && camera.skew_us != 0.0) {
    t.problem("skew_us", "a global shutter has no skew",
              "write skew_us = 0 or shutter = \"rolling\"");
  }
  camera.read_us = t.number("read_us", {.min = 0.0, .max = 1e9});
  camera.timestamp = t.one_of<TimestampMeaning>("timestamp");
  if (camera.timestamp == TimestampMeaning::end_frame && camera.read_us == 0.0) {
    t.problem(
        "read_us", "read_us is 0, but the timestamp means the end of the frame",
        "a readout is never free: measure it, or divide the frame period by two for a start");
  }
  const std::vector<double> k = t.matrix("K", 3, 3, {.min = -1e9, .max = 1e9});
  camera.model.width = camera.frame_width;
  camera.model.height = camera.active_rows;
  camera.model.fx = k[0];
  camera.model.fy = k[4];
  camera.model.cx = k[2];
  camera.model.cy = k[5];
  if (!(k[0] > 0.0 && k[4] > 0.0) || k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 ||
      k[8] != 1.0) {
    t.problem("K", "K is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx, fy",
              "write the focal lengths and the principal point in pixels");
  }
  const std::vector<double> dist =
      t.numbers_or("dist", {0, 0, 0, 0, 0}, {.min = -1e3, .max = 1e3});
  for (int i = 0; i < 5; ++i) {
    camera.model.distortion[i] = dist[static_cast<std::size_t>(i)];
  }
  const std::vector<double> pose = t.matrix("world_from_cam", 3, 4, kPosition);
  Eigen::Matrix3d rotation;
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 3; ++col) {
      rotation(row, col) =
          pose[4 * static_cast<std::size_t>(row) + static_cast<std::size_t>(col)];
    }
    camera.model.world_from_cam.translation()[row] =
        pose[4 * static_cast<std::size_t>(row) + 3];
  }
  camera.model.world_from_cam.linear() = rotation;
  if (!(rotation * rotation.transpose()).isIdentity(kUnitTol) || rotation.determinant() < 0.0) {
    t.problem("world_from_cam", "its left 3x3 block is not a rotation",
              "write three rows [r r r t]: a rotation and the camera's position in mm");
  }
  camera.bayer = t.one_of_or("bayer", BayerPattern::none);
  if (auto noise = t.table("noise")) {
    camera.noise.gain_e_per_dn = noise->number("gain", {.min = 1e-9, .max = 1e9});
    camera.noise.read_e = noise->number("read", {.min = 0.0, .max = 1e9});
    camera.noise.full_well_e = noise->number("full_well", {.min = 1.0, .max = 1e12});
    camera.noise.black_dn = noise->number("black", {.min = 0.0, .max = 65535.0});
  }
  camera.exposure_delay_frames =
      static_cast<int>(t.integer_or("exposure_delay_frames", 0, {.min = 0, .max = 100}));
  if (camera.kind == CameraKind::v4l2) {
    read_v4l2(t, camera);
  }
  return camera;
}

void require_address(ConfigTable& t, const ControllerSpec& controller) {
  std::string fault;
  if (controller.kind == ControllerKind::modbus_tcp) {
    if (const auto address = parse_tcp_address(controller.address); !address) {
      fault = address.error().what;
    }
  } else if (controller.kind == ControllerKind::modbus_rtu) {
    if (const auto address = parse_serial_address(controller.address); !address) {
      fault = address.error().what;
    }
  }
  if (!fault.empty()) {
    t.problem("address", fault, "write it in this form (docs/reference/controllers.md)");
  }
}

ControllerSpec read_controller(ConfigTable& t) {
  ControllerSpec controller;
  controller.kind = t.one_of<ControllerKind>("kind");
  controller.address = t.text("address");
  if (t.has("address")) {
    require_address(t, controller);
  }
  controller.unit = static_cast<int>(t.integer_or("unit", 1, {.min = 1, .max = 247}));
  controller.profile = t.text_or("profile", "haarlight");
  controller.lease =
      std::chrono::milliseconds(t.integer_or("lease_ms", 2000, {.min = 100, .max = 60000}));
  if (auto settle = t.table("settle_us")) {
    controller.rise_us = settle->number("rise", {.min = 0.0, .max = 1e7});
    controller.fall_us = settle->number("fall", {.min = 0.0, .max = 1e7});
    controller.latch_us = settle->number("latch", {.min = 0.0, .max = 1e7});
  } else {
    t.problem("settle_us", "settle_us is missing",
              "add settle_us = { rise = .., fall = .., latch = .. } in microseconds");
  }
  return controller;
}

template <class T>
void require_unique_ids(ConfigTable& root, std::string_view key, const std::vector<T>& items) {
  std::set<std::string_view> ids;
  for (const T& item : items) {
    if (!ids.insert(item.id).second) {
      root.problem(key, fmt::format("two of [[{}]] have the id \"{}\"", key, item.id),
                   "give each its own id");
    }
  }
}

/// "NAME" or "NAME:PORT", as a browser writes a page's address.
std::vector<std::string> read_hosts(ConfigTable& http) {
  std::vector<std::string> hosts = http.texts("allowed_hosts");
  for (const std::string& host : hosts) {
    const std::size_t colon = host.find(':');
    const std::string name = host.substr(0, colon);
    const std::string port = colon == std::string::npos ? "1" : host.substr(colon + 1);
    const bool is_name =
        !name.empty() &&
        name.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789.-_") == std::string::npos;
    const bool is_port = !port.empty() && port.size() <= 5 &&
                         port.find_first_not_of("0123456789") == std::string::npos &&
                         std::stoi(port) >= 1 && std::stoi(port) <= 65535;
    if (!is_name || !is_port) {
      http.problem("allowed_hosts", fmt::format("\"{}\" is no name of a host", host),
                   "write the proxy's name in lower case, with :port unless it is 443, as in "
                   "\"rig.example\" or \"rig.example:8443\"");
      break;
    }
  }
  return hosts;
}

/// int, like everything that counts lights.
void require_few_lights(ConfigTable& root, const std::vector<Face>& faces) {
  std::int64_t n_lights = 0;
  for (const Face& face : faces) {
    n_lights += face.n_lights();
  }
  if (n_lights > kMaxLights) {
    root.problem("face", fmt::format("{} lights, more than {}", n_lights, kMaxLights),
                 "split the rig");
  }
}

Rig read_tables(ConfigTable& root) {
  Rig rig;
  rig.schema = static_cast<int>(root.integer("schema", {.min = 1, .max = 1}));
  rig.name = root.text("name");
  rig.object_centre = vector3(root, "object_centre");
  for (ConfigTable& table : root.tables("face")) {
    rig.faces.push_back(read_face(table));
  }
  for (ConfigTable& table : root.tables("plane")) {
    rig.planes.push_back(read_plane(table));
  }
  for (ConfigTable& table : root.tables("camera")) {
    if (rig.cameras.size() == 1) {
      table.problem("id", "a second camera: haarlight captures with one",
                    "remove this [[camera]]; capture with it by a rig file of its own");
    }
    rig.cameras.push_back(read_camera(table));
  }
  require_unique_ids(root, "face", rig.faces);
  require_unique_ids(root, "plane", rig.planes);
  require_unique_ids(root, "camera", rig.cameras);
  if (rig.faces.empty()) {
    root.problem("face", "a rig needs at least one face", "add [[face]]");
  }
  if (rig.cameras.empty()) {
    root.problem("camera", "a rig needs at least one camera", "add [[camera]]");
  }
  require_few_lights(root, rig.faces);
  if (auto controller = root.table("controller")) {
    rig.controller = read_controller(*controller);
  } else {
    root.problem("controller", "[controller] is missing", "add [controller]");
  }
  if (auto sync = root.table("sync")) {
    rig.sync = sync->one_of<SyncMode>("mode");
    rig.strobe_every =
        static_cast<int>(sync->integer_or("strobe_every", 1, {.min = 1, .max = 8}));
    for (const CameraSpec& camera : rig.cameras) {
      require_trigger(*sync, rig.sync, camera);
    }
  }
  if (auto storage = root.table("storage")) {
    rig.storage.folder = storage->text_or("folder", rig.storage.folder);
    rig.storage.reserve_mb =
        storage->number_or("reserve_mb", rig.storage.reserve_mb, {.min = 0.0, .max = 1e9});
  }
  if (auto http = root.table("http")) {
    rig.http.address = http->text_or("address", rig.http.address);
    rig.http.port =
        static_cast<int>(http->integer_or("port", rig.http.port, {.min = 0, .max = 65535}));
    rig.http.token_file = http->text_or("token_file", "");
    if (http->has("allowed_hosts")) {
      rig.http.allowed_hosts = read_hosts(*http);
    }
    in6_addr parsed{};
    if (::inet_pton(AF_INET, rig.http.address.c_str(), &parsed) != 1 &&
        ::inet_pton(AF_INET6, rig.http.address.c_str(), &parsed) != 1) {
      http->problem("address", fmt::format("\"{}\" is no IP address", rig.http.address),
                    "write one in numbers, for example 127.0.0.1 or ::1");
    }
    const bool is_loopback = rig.http.address.starts_with("127.") || rig.http.address == "::1";
    if (!is_loopback && rig.http.token_file.empty()) {
      http->problem("address", "an address other than loopback needs a token",
                    "add token_file, or use 127.0.0.1");
    }
    if (!rig.http.allowed_hosts.empty() && rig.http.token_file.empty()) {
      http->problem("allowed_hosts", "what a proxy lets in needs a token", "add token_file");
    }
  }
  root.finish();
  return rig;
}

/// @param measured_name  names the measured part in errors
Rig parse_parts(const RigText& parts, const std::string& name,
                const std::string& measured_name) {
  ConfigTable root = ConfigTable::parse_text(parts.written, name);
  Rig rig = read_tables(root);
  rig.file = name;
  rig.controller.rig_file = name;
  for (const Face& face : rig.faces) {
    rig.controller.max_watts += face.max_power.value();
  }
  rig.text = parts.written + parts.measured;
  rig.hash = content_hash(rig.text);
  if (!parts.measured.empty()) {
    apply_measured(parse_measured(parts.measured, measured_name), measured_name, rig);
  }
  return rig;
}

}  // namespace

bool Face::is_haar_grid() const {
  return rows == cols && std::has_single_bit(static_cast<unsigned>(rows));
}

int Rig::n_lights() const {
  int n = 0;
  for (const Face& face : faces) {
    n += face.n_lights();
  }
  return n;
}

LightElement light_element(const Rig& rig, int k) {
  HAARLIGHT_EXPECTS(k >= 0, "a light of the rig");
  int offset = 0;
  for (std::size_t i = 0; i < rig.faces.size(); ++i) {
    const Face& face = rig.faces[i];
    if (k < offset + face.n_lights()) {
      LightElement light;
      light.index = k;
      light.face = static_cast<int>(i);
      light.row = (k - offset) / face.cols;
      light.col = (k - offset) % face.cols;
      light.centre = face.centre +
                     face.u * ((light.col - 0.5 * (face.cols - 1)) * face.pitch_mm) +
                     face.v * ((light.row - 0.5 * (face.rows - 1)) * face.pitch_mm);
      light.u = face.u;
      light.v = face.v;
      light.emits = face.emits;
      light.width_mm = face.emitter_w_mm;
      light.height_mm = face.emitter_h_mm;
      light.lobe_mu = face.lobe_mu;
      return light;
    }
    offset += face.n_lights();
  }
  throw_contract_violation("k < n_lights", "a light of the rig", __FILE__, __LINE__);
}

std::vector<LightElement> light_elements(const Rig& rig) {
  std::vector<LightElement> lights;
  const int n = rig.n_lights();
  lights.reserve(static_cast<std::size_t>(n));
  for (int k = 0; k < n; ++k) {
    lights.push_back(light_element(rig, k));
  }
  return lights;
}

Rig parse_rig(const std::string& text, const std::string& name) {
  return parse_parts(split_rig_text(text), name, name + " (its measured part)");
}

Rig read_rig_as_written(const std::filesystem::path& path) {
  return parse_rig(split_rig_text(read_file(path, kMaxRigText)).written, path.string());
}

Rig read_rig(const std::filesystem::path& path) {
  RigText text = split_rig_text(read_file(path, kMaxRigText));
  const std::filesystem::path measured = measured_path(path);
  std::error_code ignored;
  if (!std::filesystem::exists(measured, ignored)) {
    // A session's rig.toml includes its measured part.
    return parse_rig(text.written + text.measured, path.string());
  }
  if (!text.measured.empty()) {
    throw Error("the rig file carries measured values, and there is a measured file beside it",
                path.string(), "keep one of the two: move " + measured.string() + " away");
  }
  text.measured = read_file(measured, kMaxRigText);
  const std::string joined = join_rig_text(text, measured.string());
  Rig rig = parse_parts(split_rig_text(joined), path.string(), measured.string());
  log_info(fmt::format("{} of {} wins over the rig file (rig doctor shows where)",
                       measured.string(), rig.measured->date));
  if (const MeasuredGap gap = find_gap(*rig.measured); !gap.problem.empty()) {
    log_warning(fmt::format("{}: {}. Hint: {}", measured.string(), gap.problem, gap.hint));
  }
  return rig;
}

}  // namespace haarlight
