#include "core/measured_rig.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "core/config_table.h"
#include "core/error.h"

namespace haarlight {

namespace {

constexpr std::string_view kMark = "# haarlight measured values, format 1\n";
constexpr Range kTime{.min = 0.0, .max = 1e9};
constexpr Range kPositive{.min = 0.0, .max = 1e12};
constexpr int kMaxLight = 1 << 20;

std::string toml_text(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20U || c == 0x7f) {
      out += ' ';
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string number(double value) { return fmt::format("{:.9g}", value); }

void put(std::string& out, std::string_view key, const std::optional<Measured>& m) {
  if (m) {
    out += fmt::format("{} = {{ value = {}, sigma = {}, n = {} }}\n", key, number(m->value),
                       number(m->sigma), m->n);
  }
}

void put(std::string& out, std::string_view key, const std::string& text) {
  out += fmt::format("{} = {}\n", key, toml_text(text));
}

void put(std::string& out, std::string_view key, const std::vector<int>& list) {
  if (!list.empty()) {
    out += fmt::format("{} = [{}]\n", key, fmt::join(list, ", "));
  }
}

std::optional<Measured> read_measured(ConfigTable& t, std::string_view key, Range range) {
  std::optional<ConfigTable> table = t.table(key);
  if (!table) {
    return std::nullopt;
  }
  Measured m;
  m.value = table->number("value", range);
  m.sigma = table->number("sigma", kPositive);
  m.n = table->integer("n", {.min = 0, .max = 1e12});
  return m;
}

std::vector<int> read_lights(ConfigTable& t, std::string_view key) {
  std::vector<int> lights;
  if (!t.has(key)) {
    return lights;
  }
  for (const double x : t.numbers(key, 0)) {
    if (!(x >= 0.0 && x < kMaxLight) || x != std::floor(x)) {
      t.problem(key, fmt::format("{} is not the number of a light", x), "measure again");
      return {};
    }
    lights.push_back(static_cast<int>(x));
  }
  return lights;
}

MeasuredController read_controller(ConfigTable& t) {
  MeasuredController c;
  c.with = t.text("with");
  c.identity = t.text_or("identity", "");
  c.latch_us = read_measured(t, "latch_us", kTime);
  c.rise_us = read_measured(t, "rise_us", kTime);
  c.fall_us = read_measured(t, "fall_us", kTime);
  c.ack_us = read_measured(t, "ack_us", kTime);
  return c;
}

MeasuredLights read_light_table(ConfigTable& t) {
  MeasuredLights l;
  l.with = t.text("with");
  l.dead = read_lights(t, "dead");
  l.unseen = read_lights(t, "unseen");
  l.miswired = read_lights(t, "miswired");
  l.miswired_to = read_lights(t, "miswired_to");
  if (l.miswired.size() != l.miswired_to.size()) {
    t.problem("miswired_to", "miswired and miswired_to are of different length",
              "measure again");
  }
  l.power = t.numbers_or("power", {});
  for (const double p : l.power) {
    if (!(p >= 0.0 && p <= 1e6)) {
      t.problem("power", fmt::format("a relative power of {}", p), "measure again");
      break;
    }
  }
  l.power_sigma = t.number_or("power_sigma", 0.0, kPositive);
  l.n = t.integer_or("n", 0, {.min = 0, .max = 1e12});
  return l;
}

MeasuredCamera read_camera(ConfigTable& t) {
  MeasuredCamera c;
  c.id = t.text("id");
  c.with = t.text("with");
  c.identity = t.text_or("identity", "");
  if (t.has("timestamp")) {
    c.timestamp = static_cast<TimestampMeaning>(t.choice(
        "timestamp",
        {to_string(TimestampMeaning::start_exposure),
         to_string(TimestampMeaning::start_readout), to_string(TimestampMeaning::end_frame)}));
  }
  c.evidence = t.text_or("evidence", "");
  c.read_us = read_measured(t, "read_us", kTime);
  c.skew_us = read_measured(t, "skew_us", kTime);
  c.ready_us = read_measured(t, "ready_us", {.min = -1e9, .max = 1e9});
  c.exposure_delay_frames =
      read_measured(t, "exposure_delay_frames", {.min = 0.0, .max = 1000.0});
  c.gain_e_per_dn = read_measured(t, "gain", {.min = 1e-9, .max = 1e9});
  c.read_e = read_measured(t, "read", kPositive);
  c.full_well_e = read_measured(t, "full_well", {.min = 1.0, .max = 1e12});
  c.black_dn = read_measured(t, "black", {.min = 0.0, .max = 65535.0});
  c.linearity_percent = read_measured(t, "linearity_percent", kPositive);
  if (c.timestamp == TimestampMeaning::end_frame && !c.read_us) {
    t.problem("read_us", "a stamp at the end of the frame without read_us", "measure again");
  }
  return c;
}

[[noreturn]] void throw_stale(const std::string& what, const std::string& then,
                              const std::string& now, const std::string& name) {
  throw Error(
      fmt::format("stale: {} was measured with \"{}\", the rig file now says \"{}\"", what,
                  then, now),
      name,
      "measure again (haarlight rig commission), or move this file away to work with the "
      "rig file's own values");
}

void take(const std::optional<Measured>& from, double& to) {
  if (from) {
    to = from->value;
  }
}

void change(std::vector<std::string>& list, std::string_view name, double before, double after,
            std::string_view unit) {
  if (before != after) {
    list.push_back(
        fmt::format("{} {:.4g}{} (the rig file says {:.4g})", name, after, unit, before));
  }
}

}  // namespace

std::filesystem::path measured_path(const std::filesystem::path& rig_file) {
  std::filesystem::path path = rig_file;
  path.replace_extension(".measured.toml");
  return path;
}

std::string to_toml(const MeasuredRig& m) {
  std::string out(kMark);
  out +=
      "# Written by a command; measure again rather than edit. These values win over those of\n"
      "# the rig file beside it. sigma: standard uncertainty; n: samples.\n"
      "[measured]\n";
  put(out, "date", m.date);
  put(out, "tool", m.tool);
  put(out, "rig_hash", m.rig_hash);
  if (m.controller) {
    out += "\n[measured.controller]\n";
    put(out, "with", m.controller->with);
    put(out, "identity", m.controller->identity);
    put(out, "latch_us", m.controller->latch_us);
    put(out, "rise_us", m.controller->rise_us);
    put(out, "fall_us", m.controller->fall_us);
    put(out, "ack_us", m.controller->ack_us);
  }
  if (m.lights) {
    out += "\n[measured.lights]\n";
    put(out, "with", m.lights->with);
    put(out, "dead", m.lights->dead);
    put(out, "unseen", m.lights->unseen);
    put(out, "miswired", m.lights->miswired);
    put(out, "miswired_to", m.lights->miswired_to);
    if (!m.lights->power.empty()) {
      out += "power = [";
      for (std::size_t i = 0; i < m.lights->power.size(); ++i) {
        out += fmt::format("{}{:.5g},", i % 12 == 0 ? "\n  " : " ", m.lights->power[i]);
      }
      out += "\n]\n";
    }
    out +=
        fmt::format("power_sigma = {}\nn = {}\n", number(m.lights->power_sigma), m.lights->n);
  }
  for (const MeasuredCamera& c : m.cameras) {
    out += "\n[[measured.camera]]\n";
    put(out, "id", c.id);
    put(out, "with", c.with);
    put(out, "identity", c.identity);
    if (c.timestamp) {
      put(out, "timestamp", std::string(to_string(*c.timestamp)));
    }
    put(out, "evidence", c.evidence);
    put(out, "read_us", c.read_us);
    put(out, "skew_us", c.skew_us);
    put(out, "ready_us", c.ready_us);
    put(out, "exposure_delay_frames", c.exposure_delay_frames);
    put(out, "gain", c.gain_e_per_dn);
    put(out, "read", c.read_e);
    put(out, "full_well", c.full_well_e);
    put(out, "black", c.black_dn);
    put(out, "linearity_percent", c.linearity_percent);
  }
  return out;
}

MeasuredRig parse_measured(const std::string& text, const std::string& name) {
  ConfigTable root = ConfigTable::parse_text(text, name);
  MeasuredRig m;
  std::optional<ConfigTable> top = root.table("measured");
  if (!top) {
    root.problem("measured", "[measured] is missing: not a file of measured values",
                 "measure again (haarlight rig commission), or move the file away");
    root.finish();
    return m;
  }
  m.date = top->text("date");
  m.tool = top->text("tool");
  m.rig_hash = top->text_or("rig_hash", "");
  if (auto controller = top->table("controller")) {
    m.controller = read_controller(*controller);
  }
  if (auto lights = top->table("lights")) {
    m.lights = read_light_table(*lights);
  }
  for (ConfigTable& camera : top->tables("camera")) {
    m.cameras.push_back(read_camera(camera));
  }
  root.finish();
  return m;
}

RigText split_rig_text(const std::string& text) {
  if (text.starts_with(kMark)) {
    return {"", text};
  }
  const std::string line = "\n" + std::string(kMark);
  const std::size_t at = text.find(line);
  if (at == std::string::npos) {
    return {text, ""};
  }
  return {text.substr(0, at + 1), text.substr(at + 1)};
}

std::string join_rig_text(const RigText& text, const std::string& measured_name) {
  if (!text.measured.starts_with(kMark)) {
    throw Error("its first line is not \"" + std::string(kMark.substr(0, kMark.size() - 1)) +
                    "\": not a file of measured values",
                measured_name,
                "measure again (haarlight rig commission), or move the file away");
  }
  std::string joined = text.written;
  if (!joined.empty() && joined.back() != '\n') {
    joined += '\n';
  }
  return joined + text.measured;
}

std::string describe_camera(const CameraSpec& c) {
  const char* kind = c.kind == CameraKind::v4l2     ? "v4l2"
                     : c.kind == CameraKind::remote ? "remote"
                                                    : "replay";
  return fmt::format("{} {} {} x {}, {} rows of picture, {} bits, {:g} fps, {:g} dB, bayer {}",
                     kind, c.format, c.frame_width, c.frame_height, c.active_rows, c.bits,
                     c.fps, c.gain_db, to_string(c.bayer));
}

std::string describe_controller(const ControllerSpec& c) {
  const char* kind = c.kind == ControllerKind::modbus_tcp   ? "modbus_tcp"
                     : c.kind == ControllerKind::modbus_rtu ? "modbus_rtu"
                                                            : "usb";
  return fmt::format("{} unit {} profile {}", kind, c.unit, c.profile);
}

std::string describe_lights(const Rig& rig) {
  std::vector<std::string> faces;
  faces.reserve(rig.faces.size());
  for (const Face& face : rig.faces) {
    faces.push_back(fmt::format("{} {} x {}", face.id, face.rows, face.cols));
  }
  return fmt::format("{}", fmt::join(faces, ", "));
}

void apply_measured(MeasuredRig measured, const std::string& name, Rig& rig) {
  if (measured.controller) {
    const MeasuredController& m = *measured.controller;
    if (const std::string now = describe_controller(rig.controller); now != m.with) {
      throw_stale("the controller", m.with, now, name);
    }
    take(m.latch_us, rig.controller.latch_us);
    take(m.rise_us, rig.controller.rise_us);
    take(m.fall_us, rig.controller.fall_us);
  }
  if (measured.lights) {
    const MeasuredLights& m = *measured.lights;
    if (const std::string now = describe_lights(rig); now != m.with) {
      throw_stale("the array of lights", m.with, now, name);
    }
    const auto n = static_cast<std::size_t>(rig.n_lights());
    for (const std::vector<int>* list : {&m.dead, &m.unseen, &m.miswired, &m.miswired_to}) {
      if (std::any_of(list->begin(), list->end(), [&](int k) { return k >= rig.n_lights(); })) {
        throw Error(fmt::format("it names a light that the rig's {} lights don't have", n),
                    name, "measure again (haarlight rig commission)");
      }
    }
    if (!m.power.empty() && m.power.size() != n) {
      throw Error(fmt::format("{} relative powers for {} lights", m.power.size(), n), name,
                  "measure again (haarlight rig commission)");
    }
  }
  for (const MeasuredCamera& m : measured.cameras) {
    const auto camera = std::find_if(rig.cameras.begin(), rig.cameras.end(),
                                     [&](const CameraSpec& c) { return c.id == m.id; });
    if (camera == rig.cameras.end()) {
      throw Error("stale: it was measured with a camera \"" + m.id + "\", the rig has none",
                  name,
                  "measure again (haarlight rig commission), or move this file away to work "
                  "with the rig file's own values");
    }
    if (const std::string now = describe_camera(*camera); now != m.with) {
      throw_stale("camera " + m.id, m.with, now, name);
    }
    if (m.timestamp) {
      camera->timestamp = *m.timestamp;
    }
    take(m.read_us, camera->read_us);
    if (m.skew_us && camera->shutter == Shutter::rolling) {
      camera->skew_us = m.skew_us->value;
    }
    if (m.exposure_delay_frames) {
      camera->exposure_delay_frames =
          static_cast<int>(std::lround(m.exposure_delay_frames->value));
    }
    take(m.gain_e_per_dn, camera->noise.gain_e_per_dn);
    take(m.read_e, camera->noise.read_e);
    take(m.full_well_e, camera->noise.full_well_e);
    take(m.black_dn, camera->noise.black_dn);
  }
  rig.measured = std::make_shared<const MeasuredRig>(std::move(measured));
}

std::string describe_changes(const Rig& written, const Rig& merged) {
  std::vector<std::string> list;
  const ControllerSpec& a = written.controller;
  const ControllerSpec& b = merged.controller;
  change(list, "latch", a.latch_us, b.latch_us, " us");
  change(list, "rise", a.rise_us, b.rise_us, " us");
  change(list, "fall", a.fall_us, b.fall_us, " us");
  for (std::size_t i = 0; i < std::min(written.cameras.size(), merged.cameras.size()); ++i) {
    const CameraSpec& c = written.cameras[i];
    const CameraSpec& d = merged.cameras[i];
    if (c.timestamp != d.timestamp) {
      list.push_back(fmt::format("camera {} stamps {} (the rig file says {})", d.id,
                                 to_string(d.timestamp), to_string(c.timestamp)));
    }
    change(list, "read_us", c.read_us, d.read_us, " us");
    change(list, "skew_us", c.skew_us, d.skew_us, " us");
    change(list, "exposure_delay_frames", c.exposure_delay_frames, d.exposure_delay_frames, "");
    change(list, "gain", c.noise.gain_e_per_dn, d.noise.gain_e_per_dn, " e/DN");
    change(list, "read noise", c.noise.read_e, d.noise.read_e, " e");
    change(list, "full well", c.noise.full_well_e, d.noise.full_well_e, " e");
    change(list, "black", c.noise.black_dn, d.noise.black_dn, " DN");
  }
  if (merged.measured != nullptr && merged.measured->lights &&
      !merged.measured->lights->dead.empty()) {
    list.push_back(
        fmt::format("dead lights {}", fmt::join(merged.measured->lights->dead, ", ")));
  }
  return fmt::format("{}", fmt::join(list, "; "));
}

void require_measured_camera(const Rig& rig, std::string_view camera_id,
                             const std::string& identity) {
  if (rig.measured == nullptr) {
    return;
  }
  for (const MeasuredCamera& m : rig.measured->cameras) {
    if (m.id == camera_id && !m.identity.empty() && !identity.empty() &&
        m.identity != identity) {
      throw Error(fmt::format("stale: camera {} was measured as \"{}\", but \"{}\" answers",
                              m.id, m.identity, identity),
                  measured_path(rig.file).string(),
                  "connect the camera that was measured, measure again (haarlight rig "
                  "commission), or move the file away",
                  ExitCode::unavailable);
    }
  }
}

}  // namespace haarlight
