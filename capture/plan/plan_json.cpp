// SPDX-License-Identifier: Apache-2.0
/// @file
/// plan.json: the immutable shot list as canonical text, and back.

#include <algorithm>
#include <array>
#include <string_view>
#include <type_traits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/text_limits.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::capture {

namespace {

using Json = nlohmann::ordered_json;

constexpr int kMaxLights = 1 << 20;
constexpr std::size_t kMaxShots = 1000000;

/// Everything the hash covers.
Json body_of(const Plan& plan) {
  Json shots = Json::array();
  for (const session::Shot& shot : plan.shots) {
    Json lit = Json::array();
    for (const session::LightLevel& light : shot.lit) {
      lit.push_back(Json::array({light.light, light.level}));
    }
    shots.push_back(Json{{"index", shot.index},
                         {"kind", to_string(shot.kind)},
                         {"exposure_us", shot.exposure_us},
                         {"lit", std::move(lit)}});
  }
  Json json{{"schema", 1},
            {"name", plan.name},
            {"n_lights", plan.n_lights},
            {"reserve_mb", plan.reserve_mb}};
  if (plan.limits != FrameLimits{}) {  // plans of version 0.1 keep their hash
    json["limits"] = Json{{"max_saturated_share", plan.limits.max_saturated_fraction},
                          {"min_signal_share", plan.limits.min_signal_fraction},
                          {"level_tolerance", plan.limits.level_tolerance},
                          {"attempts", plan.limits.attempts}};
    if (plan.limits.retake_wrong_light) {
      json["limits"]["retake_wrong_light"] = true;
    }
  }
  if (plan.darks_every_c > 0.0) {
    json["darks_every_c"] = plan.darks_every_c;
  }
  if (plan.patterns.family != PatternFamily::list) {
    Json faces = Json::array();
    for (const FaceGrid& face : plan.patterns.faces) {
      faces.push_back(Json::array({face.rows, face.cols}));
    }
    json["patterns"] = Json{{"family", std::string(to_string(plan.patterns.family))},
                            {"faces", std::move(faces)},
                            {"bin", plan.patterns.bin},
                            {"wavelets", plan.patterns.wavelets}};
  }
  json["shots"] = std::move(shots);
  return json;
}

[[noreturn]] void refuse(const std::string& what, const std::string& where) {
  throw Error(what, where, "make the plan again with `haarlight plan RIG PLAN -o plan.json`");
}

template <class T>
T field(const Json& json, const char* key, const std::string& where, const std::string& owner) {
  const auto it = json.find(key);
  if (it == json.end()) {
    refuse(fmt::format("{} has no \"{}\"", owner, key), where);
  }
  bool is_right = false;
  if constexpr (std::is_same_v<T, std::string>) {
    is_right = it->is_string();
  } else if constexpr (std::is_same_v<T, double>) {
    is_right = it->is_number();
  } else if constexpr (std::is_same_v<T, bool>) {
    is_right = it->is_boolean();
  } else {
    is_right = it->is_number_integer();
  }
  if (!is_right) {
    refuse(fmt::format("\"{}\" of {} has the wrong type", key, owner), where);
  }
  return it->get<T>();
}

session::ShotKind read_kind(const std::string& word, const std::string& where,
                            const std::string& owner) {
  if (const std::optional<session::ShotKind> kind = value_of<session::ShotKind>(word)) {
    return *kind;
  }
  refuse(fmt::format("{} is of the unknown kind \"{}\"", owner, word), where);
}

std::vector<session::LightLevel> read_lit(const Json& json, int n_lights,
                                          const std::string& where, const std::string& owner) {
  const auto it = json.find("lit");
  if (it == json.end() || !it->is_array()) {
    refuse(fmt::format("{} has no list \"lit\"", owner), where);
  }
  std::vector<session::LightLevel> lit;
  for (const Json& pair : *it) {
    if (!pair.is_array() || pair.size() != 2 || !pair[0].is_number_integer() ||
        !pair[1].is_number_integer()) {
      refuse(fmt::format("{}: \"lit\" holds something else than [light, level]", owner), where);
    }
    const auto light = pair[0].get<std::int64_t>();
    const auto level = pair[1].get<std::int64_t>();
    const bool is_rising = lit.empty() || light > lit.back().light;
    if (light < 0 || light >= n_lights || level < 0 || level > 65535 || !is_rising) {
      refuse(fmt::format("{}: light {} at level {} is out of range or out of order", owner,
                         light, level),
             where);
    }
    lit.push_back(session::LightLevel{.light = static_cast<int>(light),
                                      .level = static_cast<std::uint16_t>(level)});
  }
  return lit;
}

FrameLimits read_limits(const Json& json, const std::string& where) {
  FrameLimits limits;
  const auto it = json.find("limits");
  if (it == json.end()) {
    return limits;
  }
  if (!it->is_object()) {
    refuse("\"limits\" of the plan is not an object", where);
  }
  const auto number = [&](const char* key, double max) {
    const auto value = field<double>(*it, key, where, "\"limits\"");
    if (!(value >= 0.0 && value <= max)) {
      refuse(fmt::format("\"{}\" of the limits is {}", key, value), where);
    }
    return value;
  };
  limits.max_saturated_fraction = number("max_saturated_share", 1.0);
  limits.min_signal_fraction = number("min_signal_share", 1.0);
  limits.level_tolerance = number("level_tolerance", 10.0);
  const auto attempts = field<std::int64_t>(*it, "attempts", where, "\"limits\"");
  if (attempts < 1 || attempts > 100) {
    refuse(fmt::format("\"attempts\" of the limits is {}", attempts), where);
  }
  limits.attempts = static_cast<int>(attempts);
  if (it->contains("retake_wrong_light")) {
    limits.retake_wrong_light = field<bool>(*it, "retake_wrong_light", where, "\"limits\"");
  }
  return limits;
}

PatternParameters read_parameters(const Json& json, int n_lights, const std::string& where) {
  const std::string owner = "\"patterns\"";
  if (!json.is_object()) {
    refuse("\"patterns\" is not an object", where);
  }
  PatternParameters parameters;
  const auto family = field<std::string>(json, "family", where, owner);
  bool is_known = false;
  for (const PatternFamily known : {PatternFamily::bins, PatternFamily::s_matrix,
                                    PatternFamily::haar, PatternFamily::target}) {
    if (family == to_string(known)) {
      parameters.family = known;
      is_known = true;
    }
  }
  if (!is_known) {
    refuse(fmt::format("patterns of the unknown family \"{}\"", family), where);
  }
  parameters.bin = static_cast<int>(field<std::int64_t>(json, "bin", where, owner));
  const auto is_list = [&](const char* key) {
    return json.contains(key) && json[key].is_array() &&
           json[key].size() <= static_cast<std::size_t>(n_lights);
  };
  if (!is_list("faces") || !is_list("wavelets")) {
    refuse("\"patterns\" without its lists \"faces\" and \"wavelets\"", where);
  }
  for (const Json& face : json["faces"]) {
    if (!face.is_array() || face.size() != 2 || !face[0].is_number_integer() ||
        !face[1].is_number_integer()) {
      refuse("a face in \"patterns\" is not [rows, cols]", where);
    }
    const auto rows = face[0].get<std::int64_t>();
    const auto cols = face[1].get<std::int64_t>();
    constexpr int kMaxSide = 4096;
    if (rows < 1 || cols < 1 || rows > kMaxSide || cols > kMaxSide) {
      refuse(fmt::format("a face of {} x {} lights", rows, cols), where);
    }
    parameters.faces.push_back({static_cast<int>(rows), static_cast<int>(cols)});
  }
  for (const Json& index : json["wavelets"]) {
    if (!index.is_number_integer() || index.get<std::int64_t>() < 0 ||
        index.get<std::int64_t>() >= n_lights) {
      refuse("a wavelet that the lights don't have", where);
    }
    parameters.wavelets.push_back(static_cast<int>(index.get<std::int64_t>()));
  }
  const bool is_right = parameters.family == PatternFamily::target ||
                        (fits(parameters) && parameters.n_lights() == n_lights);
  if (!is_right) {
    refuse(fmt::format("patterns \"{}\" that do not fit {} lights", family, n_lights), where);
  }
  return parameters;
}

Plan read_body(const Json& json, const std::string& where) {
  if (!json.is_object()) {
    refuse("not a JSON object", where);
  }
  if (field<std::int64_t>(json, "schema", where, "the plan") != 1) {
    refuse("the plan has another schema than 1", where);
  }
  Plan plan;
  plan.name = field<std::string>(json, "name", where, "the plan");
  const auto n_lights = field<std::int64_t>(json, "n_lights", where, "the plan");
  if (n_lights < 1 || n_lights > kMaxLights) {
    refuse(fmt::format("a plan for {} lights", n_lights), where);
  }
  plan.n_lights = static_cast<int>(n_lights);
  plan.reserve_mb = field<double>(json, "reserve_mb", where, "the plan");
  plan.limits = read_limits(json, where);
  if (json.contains("darks_every_c")) {
    plan.darks_every_c = field<double>(json, "darks_every_c", where, "the plan");
    if (!(plan.darks_every_c > 0.0 && plan.darks_every_c <= 100.0)) {
      refuse(fmt::format("\"darks_every_c\" is {}", plan.darks_every_c), where);
    }
  }
  if (json.contains("patterns")) {
    plan.patterns = read_parameters(json["patterns"], plan.n_lights, where);
  }
  const auto shots = json.find("shots");
  if (shots == json.end() || !shots->is_array() || shots->empty() ||
      shots->size() > kMaxShots) {
    refuse("the plan has no list \"shots\" with 1 to 1000000 entries", where);
  }
  for (const Json& entry : *shots) {
    const std::string owner = fmt::format("shot {}", plan.shots.size());
    if (!entry.is_object() || field<std::int64_t>(entry, "index", where, owner) !=
                                  static_cast<std::int64_t>(plan.shots.size())) {
      refuse(fmt::format("{} does not stand at its index", owner), where);
    }
    session::Shot shot;
    shot.index = static_cast<int>(plan.shots.size());
    shot.kind = read_kind(field<std::string>(entry, "kind", where, owner), where, owner);
    shot.exposure_us = field<double>(entry, "exposure_us", where, owner);
    if (!(shot.exposure_us >= 1.0 && shot.exposure_us <= 1e9)) {
      refuse(fmt::format("{} has an exposure of {} us", owner, shot.exposure_us), where);
    }
    shot.lit = read_lit(entry, plan.n_lights, where, owner);
    plan.shots.push_back(std::move(shot));
  }
  return plan;
}

}  // namespace

std::string plan_to_json(const Plan& plan) {
  Json json = body_of(plan);
  json["hash"] = content_hash(json.dump());
  return json.dump() + "\n";
}

Plan plan_from_json(const std::string& json, const std::string& where) {
  const Json parsed = parse_json<Json>(json, where);
  Plan plan = read_body(parsed, where);
  plan.hash = content_hash(body_of(plan).dump());
  if (field<std::string>(parsed, "hash", where, "the plan") != plan.hash) {
    refuse("the plan's hash does not match its shots: it was changed after it was made", where);
  }
  return plan;
}

}  // namespace haarlight::capture
