// SPDX-License-Identifier: Apache-2.0
#include "session/develop/exposure_plan.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "session/develop/demultiplex.h"

namespace haarlight::session {

namespace {

constexpr double kFullLevel = 65535.0;

using LitKey = std::vector<std::pair<int, int>>;

LitKey key_of(const Shot& shot) {
  LitKey key;
  for (const LightLevel& level : shot.lit) {
    if (level.level > 0) {
      key.emplace_back(level.light, level.level);
    }
  }
  std::sort(key.begin(), key.end());
  return key;
}

double exposure_scale(const Shot& shot, const FrameRecord& frame) {
  double exposure_us = frame.evidence.exposure_read_us;
  if (exposure_us <= 0.0) {
    exposure_us = shot.exposure_us;
  }
  constexpr double kUsPerSecond = 1e6;
  const double seconds = exposure_us > 0.0 ? exposure_us / kUsPerSecond : 1.0;
  return seconds * std::pow(10.0, frame.evidence.gain_db / 20.0);
}

[[noreturn]] void refuse(const Session& session, const std::string& what,
                         const std::string& hint) {
  throw Error(what, (session.folder() / "session.json").string(), hint);
}

void make_single(const Session& session, const std::map<LitKey, PatternGroup>& by_pattern,
                 ExposurePlan& plan) {
  const std::vector<SessionLight>& lights = session.info().lights;
  plan.groups.resize(lights.size());
  for (const auto& [key, group] : by_pattern) {
    const auto k = static_cast<std::size_t>(key[0].first);
    const double drive = key[0].second / kFullLevel * lights[k].relative_power;
    plan.groups[k].lit = group.lit;
    for (ScaledFrame frame : group.frames) {
      frame.scale *= drive;
      plan.groups[k].frames.push_back(frame);
    }
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (plan.groups[k].frames.empty()) {
      refuse(session, fmt::format("light {} ({}) has no committed frame", k, lights[k].name),
             "take its shot (haarlight capture, or import with its picture)");
    }
  }
}

void make_multiplexed(const Session& session, const std::map<LitKey, PatternGroup>& by_pattern,
                      ExposurePlan& plan) {
  const std::vector<SessionLight>& lights = session.info().lights;
  plan.is_single = false;
  std::vector<std::vector<LightLevel>> patterns;
  std::vector<const PatternGroup*> groups;
  std::vector<bool> is_lit(lights.size(), false);
  for (const auto& [key, group] : by_pattern) {
    patterns.emplace_back();
    for (const auto& [light, level] : key) {
      patterns.back().push_back({light, static_cast<std::uint16_t>(level)});
      is_lit[static_cast<std::size_t>(light)] = true;
    }
    groups.push_back(&group);
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (!is_lit[k] && session.info().patterns.family != PatternFamily::target) {
      refuse(session, fmt::format("light {} ({}) is in no committed shot", k, lights[k].name),
             "take its shot (haarlight capture)");
    }
  }
  MatchedShots matched = match_shots(session, patterns);
  for (const std::size_t i : matched.order) {
    plan.groups.push_back(*groups[i]);
  }
  plan.inverse = std::make_shared<const PatternInverse>(std::move(matched.inverse));
}

}  // namespace

ExposurePlan plan_exposures(const Session& session) {
  const SessionInfo& info = session.info();
  if (info.lights.empty()) {
    refuse(session, "a session without lights", "capture or import it again");
  }
  ExposurePlan plan;
  for (const FrameRecord& frame : info.frames) {
    const ShotKind kind = info.shots[static_cast<std::size_t>(frame.shot)].kind;
    if (kind == ShotKind::dark) {
      plan.dark.push_back(&frame);
    } else if (kind == ShotKind::flat) {
      plan.flat.push_back(&frame);
    } else if (kind == ShotKind::sentinel) {
      plan.sentinels.push_back(&frame);
    }
  }
  std::map<LitKey, PatternGroup> by_pattern;
  bool is_single = true;
  for (const FrameRecord& frame : info.frames) {
    const Shot& shot = info.shots[static_cast<std::size_t>(frame.shot)];
    if (shot.kind != ShotKind::light) {
      continue;
    }
    const LitKey key = key_of(shot);
    if (key.empty()) {
      refuse(session, fmt::format("light shot {} lights nothing", shot.index),
             "the plan is wrong: a shot without light is of kind dark");
    }
    is_single = is_single && key.size() == 1;
    PatternGroup& group = by_pattern[key];
    group.lit = shot.lit;
    group.frames.push_back({&frame, exposure_scale(shot, frame)});
  }
  // A target shot of one light is still a lighting, and a bin may hold a single light.
  const PatternFamily family = info.patterns.family;
  if (is_single && (family == PatternFamily::list || family == PatternFamily::one_at_a_time)) {
    make_single(session, by_pattern, plan);
  } else {
    make_multiplexed(session, by_pattern, plan);
  }
  return plan;
}

}  // namespace haarlight::session
