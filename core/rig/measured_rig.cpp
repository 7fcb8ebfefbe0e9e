// SPDX-License-Identifier: Apache-2.0
#include "core/rig/measured_rig.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"

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

void put(std::string& out, std::string_view key, const Eigen::VectorXd& x) {
  out += fmt::format("{} = [", key);
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    out += fmt::format("{}{:.12g}", i > 0 ? ", " : "", x[i]);
  }
  out += "]\n";
}

void put(std::string& out, std::string_view key, const std::vector<double>& list) {
  if (list.empty()) {
    return;
  }
  out += fmt::format("{} = [", key);
  for (std::size_t i = 0; i < list.size(); ++i) {
    out += fmt::format("{}{:.5g},", i % 12 == 0 ? "\n  " : " ", list[i]);
  }
  out += "\n]\n";
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
  c.latch_most_us = read_measured(t, "latch_most_us", kTime);
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

Eigen::Vector3d read_vector(ConfigTable& t, std::string_view key) {
  const std::vector<double> x = t.numbers(key, 3, {.min = -1e6, .max = 1e6});
  return {x[0], x[1], x[2]};
}

void require_amounts(ConfigTable& t, std::string_view key, const std::vector<double>& list) {
  for (const double x : list) {
    if (!(x >= 0.0 && x <= 1e6)) {
      t.problem(key, fmt::format("{} is out of range", x), "calibrate again");
      return;
    }
  }
}

MeasuredFace read_face(ConfigTable& t) {
  MeasuredFace f;
  f.id = t.text("id");
  f.with = t.text("with");
  f.centre = read_vector(t, "centre");
  f.centre_sigma = read_vector(t, "centre_sigma");
  f.u = read_vector(t, "u");
  f.v = read_vector(t, "v");
  f.emits = read_vector(t, "emits");
  Eigen::Matrix3d frame;
  frame << f.u, f.v, f.emits;
  if (!(frame.transpose() * frame).isIdentity(1e-6)) {
    t.problem("u", "u, v and emits are not unit vectors at right angles", "calibrate again");
  }
  f.turn_sigma_deg = read_vector(t, "turn_sigma_deg");
  f.lobe_mu = read_measured(t, "lobe_mu", {.min = 0.0, .max = 1e3});
  f.power = t.numbers_or("power", {});
  require_amounts(t, "power", f.power);
  f.power_sigma = t.numbers_or("power_sigma", {});
  require_amounts(t, "power_sigma", f.power_sigma);
  if (f.power.size() != f.power_sigma.size()) {
    t.problem("power_sigma", "power and power_sigma are of different length",
              "calibrate again");
  }
  f.reduced_chi2 = t.number_or("reduced_chi2", 0.0, kPositive);
  return f;
}

MeasuredPlane read_plane(ConfigTable& t) {
  MeasuredPlane plane;
  plane.id = t.text("id");
  plane.with = t.text("with");
  plane.camera = t.text("camera");
  plane.n = read_vector(t, "n");
  if (std::abs(plane.n.norm() - 1.0) > 1e-6) {
    t.problem("n", "n is not of length 1", "calibrate again");
  }
  plane.d = t.number("d", {.min = -1e6, .max = 1e6});
  plane.distance_sigma = t.number("distance_sigma", kPositive);
  plane.tilt_sigma_deg = t.number("tilt_sigma_deg", kPositive);
  plane.rms_px = t.number_or("rms_px", 0.0, kPositive);
  return plane;
}

MeasuredLens read_lens(ConfigTable& t) {
  MeasuredLens lens;
  const auto take_into = [&t](std::string_view key, auto& out) {
    const std::vector<double> x = t.numbers(key, static_cast<std::size_t>(out.size()));
    for (Eigen::Index i = 0; i < out.size(); ++i) {
      out[i] = x[static_cast<std::size_t>(i)];
    }
  };
  take_into("lens_k", lens.k);
  take_into("lens_k_sigma", lens.k_sigma);
  take_into("lens_dist", lens.distortion);
  take_into("lens_dist_sigma", lens.distortion_sigma);
  lens.rms_px = t.number("lens_rms_px", kPositive);
  lens.n_views = static_cast<int>(t.integer("lens_views", {.min = 0, .max = 1e6}));
  if (!(lens.k[0] > 0.0 && lens.k[1] > 0.0)) {
    t.problem("lens_k", "a focal length that is not positive", "calibrate again");
  }
  return lens;
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
  if (t.has("lens_k")) {
    c.lens = read_lens(t);
  }
  if (c.timestamp == TimestampMeaning::end_frame && !c.read_us) {
    t.problem("read_us", "a timestamp at the end of the frame without read_us",
              "measure again");
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
    put(out, "latch_most_us", m.controller->latch_most_us);
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
    put(out, "power", m.lights->power);
    out +=
        fmt::format("power_sigma = {}\nn = {}\n", number(m.lights->power_sigma), m.lights->n);
  }
  for (const MeasuredFace& f : m.faces) {
    out += "\n[[measured.face]]\n";
    put(out, "id", f.id);
    put(out, "with", f.with);
    put(out, "centre", Eigen::VectorXd(f.centre));
    put(out, "centre_sigma", Eigen::VectorXd(f.centre_sigma));
    put(out, "u", Eigen::VectorXd(f.u));
    put(out, "v", Eigen::VectorXd(f.v));
    put(out, "emits", Eigen::VectorXd(f.emits));
    put(out, "turn_sigma_deg", Eigen::VectorXd(f.turn_sigma_deg));
    put(out, "lobe_mu", f.lobe_mu);
    put(out, "power", f.power);
    put(out, "power_sigma", f.power_sigma);
    out += fmt::format("reduced_chi2 = {}\n", number(f.reduced_chi2));
  }
  for (const MeasuredPlane& plane : m.planes) {
    out += "\n[[measured.plane]]\n";
    put(out, "id", plane.id);
    put(out, "with", plane.with);
    put(out, "camera", plane.camera);
    put(out, "n", Eigen::VectorXd(plane.n));
    out += fmt::format("d = {:.12g}\n", plane.d);
    out += fmt::format("distance_sigma = {}\ntilt_sigma_deg = {}\nrms_px = {}\n",
                       number(plane.distance_sigma), number(plane.tilt_sigma_deg),
                       number(plane.rms_px));
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
    if (c.lens) {
      put(out, "lens_k", Eigen::VectorXd(c.lens->k));
      put(out, "lens_k_sigma", Eigen::VectorXd(c.lens->k_sigma));
      put(out, "lens_dist", Eigen::VectorXd(c.lens->distortion));
      put(out, "lens_dist_sigma", Eigen::VectorXd(c.lens->distortion_sigma));
      out += fmt::format("lens_rms_px = {}\nlens_views = {}\n", number(c.lens->rms_px),
                         c.lens->n_views);
    }
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
  for (ConfigTable& face : top->tables("face")) {
    m.faces.push_back(read_face(face));
  }
  for (ConfigTable& plane : top->tables("plane")) {
    m.planes.push_back(read_plane(plane));
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
  return fmt::format(
      "{} {} {} x {}{}, {} rows of picture, {} bits, {:g} fps, {:g} dB, bayer {}", kind,
      c.format, c.frame_width, c.frame_height,
      c.v4l2.crop ? fmt::format(" from {}, {}", (*c.v4l2.crop)[0], (*c.v4l2.crop)[1]) : "",
      c.active_rows, c.bits, c.fps, c.gain_db, to_string(c.bayer));
}

std::string describe_controller(const ControllerSpec& c) {
  return fmt::format("{} unit {} profile {}", to_string(c.kind), c.unit, c.profile);
}

std::string describe_lights(const Rig& rig) {
  std::vector<std::string> faces;
  faces.reserve(rig.faces.size());
  for (const Face& face : rig.faces) {
    faces.push_back(fmt::format("{} {} x {}", face.id, face.rows, face.cols));
  }
  return fmt::format("{}", fmt::join(faces, ", "));
}

std::string describe_face(const Face& face) {
  return fmt::format("{} x {}, pitch {:g} mm", face.rows, face.cols, face.pitch_mm);
}

namespace {

void apply_face(const MeasuredFace& m, const std::string& name, Rig& rig) {
  const auto face = std::find_if(rig.faces.begin(), rig.faces.end(),
                                 [&](const Face& f) { return f.id == m.id; });
  if (face == rig.faces.end()) {
    throw Error("stale: face \"" + m.id + "\" was calibrated, the rig has none", name,
                "calibrate again (haarlight rig calibrate lights), or move this file away");
  }
  if (const std::string now = describe_face(*face); now != m.with) {
    throw_stale("face " + m.id, m.with, now, name);
  }
  if (!m.power.empty() && m.power.size() != static_cast<std::size_t>(face->n_lights())) {
    throw Error(fmt::format("{} powers for the {} lights of face {}", m.power.size(),
                            face->n_lights(), m.id),
                name, "calibrate again (haarlight rig calibrate lights)");
  }
  face->centre = m.centre;
  face->u = m.u.normalized();
  face->v = m.v.normalized();
  face->emits = m.emits.normalized();
  take(m.lobe_mu, face->lobe_mu);
}

void apply_plane(const MeasuredPlane& m, const std::string& name, Rig& rig) {
  const auto plane = std::find_if(rig.planes.begin(), rig.planes.end(),
                                  [&](const ShadowPlane& p) { return p.id == m.id; });
  const auto camera = std::find_if(rig.cameras.begin(), rig.cameras.end(),
                                   [&](const CameraSpec& c) { return c.id == m.camera; });
  if (plane == rig.planes.end() || camera == rig.cameras.end()) {
    throw Error("stale: plane \"" + m.id + "\" was calibrated with camera \"" + m.camera +
                    "\"; the rig lacks one of them",
                name,
                "calibrate again (haarlight rig calibrate plane), or move this file away");
  }
  if (const std::string now = describe_view(*camera); now != m.with) {
    throw_stale("plane " + m.id, m.with, now, name);
  }
  const double hand = plane->u.cross(plane->v).dot(plane->n) < 0.0 ? -1.0 : 1.0;
  plane->n = m.n.normalized();
  plane->d = m.d;
  plane->origin -= (plane->n.dot(plane->origin) + plane->d) * plane->n;
  plane->u = (plane->u - plane->n.dot(plane->u) * plane->n).normalized();
  plane->v = hand * plane->n.cross(plane->u);
}

}  // namespace

std::string describe_view(const CameraSpec& camera) {
  std::string out = "world_from_cam";
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 4; ++col) {
      out += fmt::format(" {:.6g}", camera.model.world_from_cam.matrix()(row, col) + 0.0);
    }
  }
  return out;
}

MeasuredGap find_gap(const MeasuredRig& measured) {
  if (!measured.controller || !measured.controller->latch_us ||
      measured.controller->latch_most_us) {
    return {};
  }
  return {
      "it has no latch_most_us: captures wait for the mean latch, and a change of light that "
      "comes later may spoil a frame",
      "measure again (haarlight rig commission)"};
}

void apply_measured(MeasuredRig measured, const std::string& name, Rig& rig) {
  if (measured.controller) {
    const MeasuredController& m = *measured.controller;
    if (const std::string now = describe_controller(rig.controller); now != m.with) {
      throw_stale("the controller", m.with, now, name);
    }
    take(m.latch_most_us ? m.latch_most_us : m.latch_us, rig.controller.latch_us);
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
  for (const MeasuredFace& m : measured.faces) {
    apply_face(m, name, rig);
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
    if (m.lens) {
      camera->model.fx = m.lens->k[0];
      camera->model.fy = m.lens->k[1];
      camera->model.cx = m.lens->k[2];
      camera->model.cy = m.lens->k[3];
      camera->model.distortion = m.lens->distortion;
    }
  }
  for (const MeasuredPlane& m : measured.planes) {
    apply_plane(m, name, rig);
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
      list.push_back(fmt::format("camera {} timestamps {} (the rig file says {})", d.id,
                                 to_string(d.timestamp), to_string(c.timestamp)));
    }
    change(list, "read_us", c.read_us, d.read_us, " us");
    change(list, "skew_us", c.skew_us, d.skew_us, " us");
    change(list, "exposure_delay_frames", c.exposure_delay_frames, d.exposure_delay_frames, "");
    change(list, "gain", c.noise.gain_e_per_dn, d.noise.gain_e_per_dn, " e/DN");
    change(list, "read noise", c.noise.read_e, d.noise.read_e, " e");
    change(list, "full well", c.noise.full_well_e, d.noise.full_well_e, " e");
    change(list, "black", c.noise.black_dn, d.noise.black_dn, " DN");
    change(list, "fx", c.model.fx, d.model.fx, " px");
    change(list, "fy", c.model.fy, d.model.fy, " px");
    change(list, "cx", c.model.cx, d.model.cx, " px");
    change(list, "cy", c.model.cy, d.model.cy, " px");
  }
  for (std::size_t i = 0; i < std::min(written.planes.size(), merged.planes.size()); ++i) {
    const ShadowPlane& before = written.planes[i];
    const ShadowPlane& after = merged.planes[i];
    if (before.n != after.n || before.d != after.d) {
      const double tilted = std::acos(std::clamp(before.n.dot(after.n), -1.0, 1.0));
      list.push_back(
          fmt::format("plane {} is {:.2f} mm and {:.2f} degrees from where the rig "
                      "file has it",
                      after.id, std::abs(after.n.dot(before.origin) + after.d),
                      tilted * 180.0 / std::numbers::pi));
    }
  }
  for (std::size_t i = 0; i < std::min(written.faces.size(), merged.faces.size()); ++i) {
    const Face& f = written.faces[i];
    const Face& g = merged.faces[i];
    if (f.centre != g.centre || f.emits != g.emits) {
      const double turned = std::acos(std::clamp(f.emits.dot(g.emits), -1.0, 1.0));
      list.push_back(
          fmt::format("face {} is {:.2f} mm and {:.2f} degrees from where the rig "
                      "file has it",
                      g.id, (f.centre - g.centre).norm(), turned * 180.0 / std::numbers::pi));
    }
    change(list, "lobe_mu of face " + g.id, f.lobe_mu, g.lobe_mu, "");
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
