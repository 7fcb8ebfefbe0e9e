// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "session/rig_session.h"
#include "session/verify_checks.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxText = std::uintmax_t{1} << 30U;

/// Reads a text, or notes a problem.
std::string read_or_note(const fs::path& file, VerifyReport& report) {
  try {
    return read_file(file, kMaxText);
  } catch (const Error& error) {
    report.problems.push_back(fmt::format("{}: {}", file.filename().string(), error.problem()));
    return {};
  }
}

void note_error(const std::string& name, const Error& error, VerifyReport& report) {
  report.problems.push_back(
      fmt::format("{}: {}", error.where().empty() ? name : error.where(), error.problem()));
}

/// Readers differ in which of two members of one name they take: neither can be trusted.
void check_doubled_keys(const std::string& json, const std::string& name,
                        VerifyReport& report) {
  std::vector<std::set<std::string>> keys;
  std::string doubled;
  const auto look = [&](int /*depth*/, nlohmann::json::parse_event_t event,
                        nlohmann::json& parsed) {
    if (event == nlohmann::json::parse_event_t::object_start) {
      keys.emplace_back();
    } else if (event == nlohmann::json::parse_event_t::object_end) {
      keys.pop_back();
    } else if (event == nlohmann::json::parse_event_t::key &&
               !keys.back().insert(parsed.get<std::string>()).second) {
      doubled = parsed.get<std::string>();
    }
    return true;
  };
  try {
    (void)parse_json<nlohmann::json>(json, name, look);
  } catch (const Error&) {
    return;  // reported by the reader of its values
  }
  if (!doubled.empty()) {
    report.problems.push_back(
        fmt::format("{}: \"{}\" stands twice in one object", name, doubled.substr(0, 40)));
  }
}

std::vector<LightLevel> read_lit(const JsonValue& value) {
  std::vector<LightLevel> lit;
  for (const JsonValue& pair : value.elements()) {
    const std::vector<JsonValue> numbers = pair.elements();
    if (numbers.size() != 2) {
      pair.refuse(fmt::format("{} numbers", numbers.size()), "a light and its level");
    }
    lit.push_back({static_cast<int>(numbers[0].integer(0, 1 << 30)),
                   static_cast<std::uint16_t>(numbers[1].integer(0, 65535))});
  }
  return lit;
}

/// A capture's plan: shot by shot.
std::string compare_shots(const JsonValue& plan, const SessionInfo& info) {
  const std::vector<JsonValue> shots = plan["shots"].elements();
  if (shots.size() != info.shots.size()) {
    return fmt::format("{} shots, session.json has {}", shots.size(), info.shots.size());
  }
  if (plan["n_lights"].integer(0, 1 << 30) != static_cast<std::int64_t>(info.lights.size())) {
    return "another number of lights than session.json";
  }
  if (plan["hash"].text() != info.plan_hash) {
    return "its hash is not the plan_hash of session.json";
  }
  for (std::size_t i = 0; i < shots.size(); ++i) {
    const Shot& shot = info.shots[i];
    if (shots[i]["index"].integer(0, 1 << 30) != shot.index ||
        shots[i]["kind"].text() != to_string(shot.kind) ||
        shots[i]["exposure_us"].number() != shot.exposure_us ||
        read_lit(shots[i]["lit"]) != shot.lit) {
      return fmt::format("shot {} is another one in session.json", i);
    }
  }
  return {};
}

/// An import's plan: one picture per light, then the dark ones.
std::string compare_pictures(const JsonValue& plan, const SessionInfo& info) {
  const std::vector<JsonValue> pictures = plan["pictures"].elements();
  if (pictures.size() != info.shots.size()) {
    return fmt::format("{} pictures, session.json has {} shots", pictures.size(),
                       info.shots.size());
  }
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const Shot& shot = info.shots[i];
    const bool is_light = i < info.lights.size();
    const std::vector<LightLevel> lit =
        is_light ? std::vector<LightLevel>{{shot.index, 65535}} : std::vector<LightLevel>{};
    if (shot.kind != (is_light ? ShotKind::light : ShotKind::dark) || shot.lit != lit) {
      return fmt::format("picture {} is of another light in session.json", i);
    }
    if (is_light && !info.lights[i].name.empty() &&
        pictures[i]["name"].text() != info.lights[i].name) {
      return fmt::format("picture {} has another name in session.json", i);
    }
  }
  return {};
}

void check_plan(const std::string& plan, const SessionInfo& info, VerifyReport& report) {
  if (content_hash(plan) != info.plan_file_hash) {
    report.problems.emplace_back("plan.json: not the plan that was shot: its hash differs");
  }
  std::string problem;
  try {
    const JsonValue value = JsonValue::parse(plan, "plan.json");
    if (value.has("shots")) {
      problem = compare_shots(value, info);
    } else if (value.has("pictures")) {
      problem = compare_pictures(value, info);
    } else {
      report.notes.emplace_back("plan.json: lists no shots: not compared with session.json");
    }
  } catch (const Error& error) {
    note_error("plan.json", error, report);
  }
  if (!problem.empty()) {
    report.problems.push_back("plan.json: " + problem);
  }
}

bool is_near(double a, double b) {
  constexpr double kSlack = 1e-9;  // another compiler's order of additions
  return std::abs(a - b) <= kSlack * std::max({1.0, std::abs(a), std::abs(b)});
}

std::string compare_lights(const SessionInfo& expected, const SessionInfo& info) {
  if (expected.lights.size() != info.lights.size() || expected.grid_rows != info.grid_rows ||
      expected.grid_cols != info.grid_cols) {
    return fmt::format("{} lights in grids of {} x {}, session.json has {} in {} x {}",
                       expected.lights.size(), expected.grid_rows, expected.grid_cols,
                       info.lights.size(), info.grid_rows, info.grid_cols);
  }
  for (std::size_t k = 0; k < info.lights.size(); ++k) {
    const SessionLight& a = expected.lights[k];
    const SessionLight& b = info.lights[k];
    // A rig's lobes are in rig.toml: a light of its session has none of its own.
    if (a.name != b.name || a.is_position != b.is_position || a.lobe != b.lobe ||
        !is_near(a.relative_power, b.relative_power) ||
        !is_near(a.coordinates.x(), b.coordinates.x()) ||
        !is_near(a.coordinates.y(), b.coordinates.y()) ||
        !is_near(a.coordinates.z(), b.coordinates.z())) {
      return fmt::format(
          "light {} ({}) has another name, position, lobe or power in session.json ({} at {}, "
          "{}, "
          "{})",
          k, a.name, b.name, b.coordinates.x(), b.coordinates.y(), b.coordinates.z());
    }
  }
  return {};
}

std::string compare_form(const FrameForm& expected, const FrameForm& form) {
  const bool is_same =
      expected.width == form.width && expected.height == form.height &&
      expected.stored_height == form.stored_height && expected.channels == form.channels &&
      expected.sample == form.sample && expected.transfer == form.transfer &&
      expected.bayer == form.bayer && is_near(expected.black_level, form.black_level) &&
      is_near(expected.white_level, form.white_level) && expected.gains == form.gains &&
      expected.crop == form.crop &&
      // Sessions of older programs have no clip level.
      (!form.clip_level || is_near(expected.saturation_dn(), form.saturation_dn()));
  return is_same ? std::string()
                 : "its camera's frames (size, sample, levels, colours) are others than those "
                   "of session.json";
}

std::string compare_timing(const Rig& rig, const SessionInfo& info) {
  const CameraSpec& camera = rig.cameras.front();
  for (const FrameRecord& frame : info.frames) {
    const FrameEvidence& e = frame.evidence;
    if (e.kind == EvidenceKind::measured &&
        (e.sync != rig.sync || e.timestamp_meaning != camera.timestamp ||
         !is_near(e.read_us, camera.read_us) || !is_near(e.skew_us, camera.skew_us))) {
      return fmt::format("{} was validated with another sync mode, timestamp, readout or skew",
                         frame.file);
    }
  }
  return {};
}

void check_rig(const std::string& text, const SessionInfo& info, VerifyReport& report) {
  if (content_hash(text) != info.rig_hash) {
    report.problems.emplace_back("rig.toml: not the rig that was used: its hash differs");
  }
  try {
    const Rig rig = parse_rig(text, "rig.toml");
    SessionInfo expected;
    describe_rig(rig, expected);
    for (const std::string& problem :
         {compare_lights(expected, info), compare_form(expected.form, info.form),
          compare_timing(rig, info)}) {
      if (!problem.empty()) {
        report.problems.push_back("rig.toml: " + problem);
      }
    }
  } catch (const Error& error) {
    note_error("rig.toml", error, report);
  }
}

void check_start(const std::string& start, const SessionInfo& info, VerifyReport& report) {
  check_doubled_keys(start, "start.json", report);
  try {
    SessionInfo expected = info;
    expected.frames.clear();
    expected.files.clear();
    expected.root.clear();
    if (session_info_to_json(session_info_from_json(start, "start.json")) !=
        session_info_to_json(expected)) {
      report.problems.emplace_back("session.json: differs from start.json beyond its frames");
    }
  } catch (const Error& error) {
    note_error("start.json", error, report);
  }
}

}  // namespace

void check_texts(const fs::path& folder, const std::string& json, const SessionInfo& info,
                 VerifyReport& report) {
  check_doubled_keys(json, "session.json", report);
  if (const std::string plan = read_or_note(folder / "plan.json", report); !plan.empty()) {
    check_plan(plan, info, report);
  }
  if (!info.rig_hash.empty()) {
    if (const std::string rig = read_or_note(folder / "rig.toml", report); !rig.empty()) {
      check_rig(rig, info, report);
    }
  }
  if (const std::string start = read_or_note(folder / "start.json", report); !start.empty()) {
    check_start(start, info, report);
  }
}

}  // namespace haarlight::session
