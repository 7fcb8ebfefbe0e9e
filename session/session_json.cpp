// SPDX-License-Identifier: Apache-2.0
/// @file
/// session.json: SessionInfo as JSON and back. Every field is described in
/// docs/reference/session-format.md; a test compares that page with what is written here.

#include <array>
#include <cmath>
#include <limits>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/session/light_file.h"
#include "haarlight/session/session.h"
#include "session/photographed.h"

namespace haarlight::session {

namespace {

using Json = nlohmann::ordered_json;

constexpr int kMaxInt = std::numeric_limits<int>::max();
constexpr std::size_t kMaxCount = std::size_t{1} << 24U;

Json form_to_json(const FrameForm& form) {
  Json json;
  json["width"] = form.width;
  json["height"] = form.height;
  json["stored_height"] = form.stored_height;
  json["channels"] = form.channels;
  json["sample"] = to_string(form.sample);
  json["transfer"] = to_string(form.transfer);
  json["bayer"] = to_string(form.bayer);
  json["black_level"] = form.black_level;
  json["white_level"] = form.white_level;
  if (form.clip_level) {
    json["clip_level"] = *form.clip_level;
  }
  if (!form.gains.empty()) {
    json["gains"] = form.gains;
  }
  if (form.crop) {
    json["crop"] = {form.crop->x, form.crop->y, form.crop->whole_width,
                    form.crop->whole_height};
  }
  return json;
}

constexpr int kMaxPixels = 1 << 20;  // a side

std::vector<double> gains_from_json(const JsonValue& value, const FrameForm& form) {
  constexpr double kMostGain = 1e6;
  std::vector<double> gains;
  for (const JsonValue& gain : value.elements()) {
    gains.push_back(gain.number(1.0 / kMostGain, kMostGain));
  }
  if (gains.size() != static_cast<std::size_t>(form.channels) ||
      form.bayer != BayerPattern::none) {
    value.refuse(fmt::format("{} gains of {} channels", gains.size(), form.channels),
                 "one per channel; a mosaic has none");
  }
  return gains;
}

FrameCrop crop_from_json(const JsonValue& value, const FrameForm& form) {
  const std::vector<JsonValue> numbers = value.elements();
  if (numbers.size() != 4) {
    value.refuse(fmt::format("{} numbers", numbers.size()),
                 "write [x, y, the whole picture's width, its height]");
  }
  FrameCrop crop;
  crop.whole_width = static_cast<int>(numbers[2].integer(form.width, kMaxPixels));
  crop.whole_height = static_cast<int>(numbers[3].integer(form.height, kMaxPixels));
  crop.x = static_cast<int>(numbers[0].integer(0, crop.whole_width - form.width));
  crop.y = static_cast<int>(numbers[1].integer(0, crop.whole_height - form.height));
  return crop;
}

FrameForm form_from_json(const JsonValue& value) {
  FrameForm form;
  form.width = static_cast<int>(value["width"].integer(1, kMaxPixels));
  form.height = static_cast<int>(value["height"].integer(1, kMaxPixels));
  form.stored_height =
      static_cast<int>(value["stored_height"].integer(form.height, kMaxPixels));
  form.channels = static_cast<int>(value["channels"].integer(1, 3));
  if (form.channels == 2) {
    value["channels"].refuse("2 channels", "a frame has 1 (grey or Bayer) or 3");
  }
  form.sample = value["sample"].one_of<SampleType>();
  form.transfer = value["transfer"].one_of<Transfer>();
  form.bayer = value["bayer"].one_of<BayerPattern>();
  if (form.bayer != BayerPattern::none && form.channels != 1) {
    value["bayer"].refuse("a Bayer mosaic of three channels", "a mosaic has one channel");
  }
  form.black_level = value["black_level"].number();
  form.white_level = value["white_level"].number();
  if (!(form.white_level > form.black_level)) {
    value["white_level"].refuse("the white level is not above the black level",
                                "write the sensor's levels");
  }
  if (value.has("clip_level")) {
    // Floating-point values may have no upper limit.
    form.clip_level = value["clip_level"].number(
        form.black_level, form.sample == SampleType::f32
                              ? static_cast<double>(std::numeric_limits<float>::max())
                              : form.white_level);
  }
  if (value.has("gains")) {
    form.gains = gains_from_json(value["gains"], form);
  }
  if (value.has("crop")) {
    form.crop = crop_from_json(value["crop"], form);
  }
  return form;
}

Json light_to_json(const SessionLight& light) {
  Json json;
  json["name"] = light.name;
  json[light.is_position ? "position_mm" : "direction"] = {
      light.coordinates.x(), light.coordinates.y(), light.coordinates.z()};
  json["relative_power"] = light.relative_power;
  if (light.lobe) {
    json["axis"] = {light.lobe->axis.x(), light.lobe->axis.y(), light.lobe->axis.z()};
    json["lobe_mu"] = light.lobe->mu;
  }
  return json;
}

SessionLight light_from_json(const JsonValue& value) {
  SessionLight light;
  light.name = value["name"].text();
  light.is_position = value.has("position_mm");
  const JsonValue position = value[light.is_position ? "position_mm" : "direction"];
  const std::vector<JsonValue> numbers = position.elements();
  if (numbers.size() != 3) {
    position.refuse(fmt::format("{} numbers", numbers.size()), "write x, y, z");
  }
  for (int i = 0; i < 3; ++i) {
    light.coordinates[i] = numbers[static_cast<std::size_t>(i)].number();
  }
  constexpr double kUnitTolerance =
      1e-6;  // written with 17 digits, read from .lp files renormalised
  if (!light.is_position && std::abs(light.coordinates.norm() - 1.0) > kUnitTolerance) {
    position.refuse(fmt::format("a direction of length {}", light.coordinates.norm()),
                    "write a unit vector to the light");
  }
  light.relative_power = value["relative_power"].number(1e-9, 1e9);
  light.lobe = lobe_of_json(value);
  return light;
}

Json shot_to_json(const Shot& shot) {
  Json json;
  json["index"] = shot.index;
  json["kind"] = to_string(shot.kind);
  Json lit = Json::array();
  for (const LightLevel& level : shot.lit) {
    lit.push_back({level.light, level.level});
  }
  json["lit"] = std::move(lit);
  json["exposure_us"] = shot.exposure_us;
  return json;
}

Shot shot_from_json(const JsonValue& value, std::size_t index, std::size_t n_lights) {
  Shot shot;
  shot.index = static_cast<int>(value["index"].integer(0, kMaxInt));
  if (static_cast<std::size_t>(shot.index) != index) {
    value["index"].refuse(fmt::format("shot {} at index {}", shot.index, index),
                          "shots are listed in order, from 0");
  }
  shot.kind = value["kind"].one_of<ShotKind>();
  for (const JsonValue& pair : value["lit"].elements()) {
    const std::vector<JsonValue> numbers = pair.elements();
    if (numbers.size() != 2) {
      pair.refuse(fmt::format("{} numbers", numbers.size()), "write [light, level]");
    }
    const auto last_light = static_cast<std::int64_t>(n_lights) - 1;
    shot.lit.push_back({static_cast<int>(numbers[0].integer(0, last_light)),
                        static_cast<std::uint16_t>(numbers[1].integer(0, 65535))});
  }
  shot.exposure_us = value["exposure_us"].number(0.0);
  return shot;
}

Json patterns_to_json(const PatternParameters& patterns) {
  Json json;
  json["family"] = to_string(patterns.family);
  Json faces = Json::array();
  for (const FaceGrid& face : patterns.faces) {
    faces.push_back({face.rows, face.cols});
  }
  json["faces"] = std::move(faces);
  json["bin"] = patterns.bin;
  json["wavelets"] = patterns.wavelets;
  return json;
}

PatternParameters patterns_from_json(const JsonValue& value, std::size_t n_lights) {
  constexpr int kMaxSide = 1 << 12;
  PatternParameters patterns;
  patterns.family = value["family"].one_of<PatternFamily>();
  patterns.bin = static_cast<int>(value["bin"].integer(0, kMaxSide));
  for (const JsonValue& face : value["faces"].elements()) {
    const std::vector<JsonValue> sides = face.elements();
    if (sides.size() != 2) {
      face.refuse(fmt::format("{} numbers", sides.size()), "write [rows, cols]");
    }
    patterns.faces.push_back({static_cast<int>(sides[0].integer(1, kMaxSide)),
                              static_cast<int>(sides[1].integer(1, kMaxSide))});
  }
  for (const JsonValue& index : value["wavelets"].elements()) {
    patterns.wavelets.push_back(
        static_cast<int>(index.integer(0, static_cast<std::int64_t>(n_lights) - 1)));
  }
  return patterns;
}

Json frame_to_json(const FrameRecord& frame) {
  Json json;
  json["shot"] = frame.shot;
  json["attempt"] = frame.attempt;
  json["file"] = frame.file;
  json["file_hash"] = frame.file_hash;
  if (!frame.sha256.empty()) {
    json["sha256"] = frame.sha256;
  }
  json["evidence"] = Json::parse(evidence_to_json(frame.evidence));
  return json;
}

FrameRecord frame_from_json(const JsonValue& value, std::size_t n_shots) {
  FrameRecord frame;
  frame.shot =
      static_cast<int>(value["shot"].integer(0, static_cast<std::int64_t>(n_shots) - 1));
  frame.attempt = static_cast<int>(value["attempt"].integer(0, kMaxInt));
  frame.file = value["file"].text();
  // A session never refers to anything outside its own folder.
  const std::filesystem::path file(frame.file);
  bool is_inside = !frame.file.empty() && file.is_relative();
  for (const std::filesystem::path& part : file) {
    is_inside = is_inside && part != "..";
  }
  if (!is_inside || frame.file.find('\0') != std::string::npos) {
    value["file"].refuse("a frame outside of the session's folder", "name a file inside of it");
  }
  frame.file_hash = value["file_hash"].text();
  if (value.has("sha256")) {
    frame.sha256 = value["sha256"].text();
  }
  frame.evidence = evidence_from_json(value["evidence"].dump(), value["evidence"].location());
  return frame;
}

void check_finite(const SessionInfo& info) {
  bool is_finite = std::isfinite(info.form.black_level) && std::isfinite(info.form.white_level);
  for (const double gain : info.form.gains) {
    is_finite = is_finite && std::isfinite(gain);
  }
  for (const SessionLight& light : info.lights) {
    is_finite =
        is_finite && light.coordinates.allFinite() && std::isfinite(light.relative_power);
  }
  for (const Shot& shot : info.shots) {
    is_finite = is_finite && std::isfinite(shot.exposure_us);
  }
  HAARLIGHT_EXPECTS(is_finite, "a session in finite numbers");
}

}  // namespace

std::string session_info_to_json(const SessionInfo& info) {
  check_finite(info);
  Json json;
  json["schema"] = info.schema;
  json["id"] = info.id;
  json["created"] = info.created;
  if (!info.program.empty()) {
    json["program"] = info.program;
  }
  json["plan_hash"] = info.plan_hash;
  json["plan_file_hash"] = info.plan_file_hash;
  json["rig_hash"] = info.rig_hash;
  json["evidence"] = to_string(info.evidence);
  json["form"] = form_to_json(info.form);
  if (has_facts(info.photographed)) {
    json["photographed"] = parse_json<Json>(facts_to_json(info.photographed), "photographed");
  }
  json["grid_rows"] = info.grid_rows;
  json["grid_cols"] = info.grid_cols;
  const auto list = [](const auto& items, auto to_json) {
    Json array = Json::array();
    for (const auto& item : items) {
      array.push_back(to_json(item));
    }
    return array;
  };
  json["lights"] = list(info.lights, light_to_json);
  if (info.patterns.family != PatternFamily::list) {
    json["patterns"] = patterns_to_json(info.patterns);
  }
  json["shots"] = list(info.shots, shot_to_json);
  json["frames"] = list(info.frames, frame_to_json);
  if (!info.files.empty()) {
    json["made_by"] = to_string(info.made_by);
    json["files"] = list(info.files, [](const SealedFile& file) {
      return Json{{"name", file.name}, {"sha256", file.sha256}};
    });
  }
  if (!info.root.empty()) {
    json["root"] = info.root;  // the last: it covers every byte before its line
  }
  // One line per entry: readable, diff works, and 1024 frames stay under a megabyte.
  std::string text = "{\n";
  bool is_first = true;
  for (const auto& [key, value] : json.items()) {
    text += is_first ? "" : ",\n";
    is_first = false;
    text += fmt::format("\"{}\": ", key);
    const bool is_list = value.is_array();
    if (!is_list || value.empty()) {
      text += value.dump(-1, ' ', false, Json::error_handler_t::replace);
      continue;
    }
    text += "[\n";
    for (std::size_t i = 0; i < value.size(); ++i) {
      text += value[i].dump(-1, ' ', false, Json::error_handler_t::replace);
      text += i + 1 < value.size() ? ",\n" : "\n";
    }
    text += "]";
  }
  return text + "\n}\n";
}

SessionInfo session_info_from_json(const std::string& json, const std::string& where) {
  const JsonValue value = JsonValue::parse(json, where);
  SessionInfo info;
  info.schema = static_cast<int>(value["schema"].integer(0, kMaxInt));
  if (info.schema != 1) {
    value["schema"].refuse(fmt::format("schema {}, this program reads 1", info.schema),
                           "use the haarlight that wrote it, or a newer one");
  }
  info.id = value["id"].text();
  info.created = value["created"].text();
  if (value.has("program")) {
    info.program = value["program"].text();
  }
  info.plan_hash = value["plan_hash"].text();
  info.plan_file_hash = value["plan_file_hash"].text();
  info.rig_hash = value["rig_hash"].text();
  info.evidence = value["evidence"].one_of<EvidenceKind>();
  info.form = form_from_json(value["form"]);
  if (value.has("photographed")) {
    info.photographed = facts_from_json(value["photographed"]);
  }
  info.grid_rows = static_cast<int>(value["grid_rows"].integer(0, 1 << 16));
  info.grid_cols = static_cast<int>(value["grid_cols"].integer(0, 1 << 16));
  const auto list = [&value](std::string_view key) {
    std::vector<JsonValue> elements = value[key].elements();
    if (elements.size() > kMaxCount) {
      value[key].refuse(fmt::format("{} entries", elements.size()),
                        "a session has at most 2^24");
    }
    return elements;
  };
  for (const JsonValue& light : list("lights")) {
    info.lights.push_back(light_from_json(light));
  }
  const auto grid = static_cast<std::int64_t>(info.grid_rows) * info.grid_cols;
  if ((info.grid_rows > 0) != (info.grid_cols > 0) ||
      (grid > 0 &&
       (info.lights.empty() || static_cast<std::int64_t>(info.lights.size()) % grid != 0))) {
    value["grid_rows"].refuse(fmt::format("{} lights in grids of {} x {}", info.lights.size(),
                                          info.grid_rows, info.grid_cols),
                              "write 0 and 0 for lights that form no grid");
  }
  if (value.has("patterns")) {
    info.patterns = patterns_from_json(value["patterns"], info.lights.size());
  }
  std::size_t index = 0;
  for (const JsonValue& shot : list("shots")) {
    info.shots.push_back(shot_from_json(shot, index++, info.lights.size()));
  }
  int last_shot = -1;
  for (const JsonValue& frame : list("frames")) {
    info.frames.push_back(frame_from_json(frame, info.shots.size()));
    if (info.frames.back().shot <= last_shot) {
      frame["shot"].refuse("listed twice or out of order",
                           "frames are listed by shot, one each");
    }
    last_shot = info.frames.back().shot;
  }
  if (value.has("files")) {
    info.made_by = value["made_by"].one_of<MadeBy>();
    for (const JsonValue& file : list("files")) {
      info.files.push_back({file["name"].text(), file["sha256"].text()});
    }
  }
  if (value.has("root")) {
    info.root = value["root"].text();
  }
  return info;
}

}  // namespace haarlight::session
