#include "session/exposure_plan.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "core/error.h"
#include "session/demultiplex.h"

namespace haarlight {

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

std::int64_t time_of(const FrameRecord& frame) {
  return frame.evidence.kind == EvidenceKind::asserted ? frame.shot
                                                       : frame.evidence.t_exposure_start_ns;
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

/// The sentinel's brightness over time, relative to its first frame, linear in between.
class Drift {
 public:
  Drift(const SessionInfo& info, const std::vector<const FrameRecord*>& sentinels,
        double dark_dn) {
    if (sentinels.empty()) {
      return;
    }
    const auto brightness = [&](const FrameRecord& frame) {
      const Shot& shot = info.shots[static_cast<std::size_t>(frame.shot)];
      return (frame.evidence.mean_dn - dark_dn) / exposure_scale(shot, frame);
    };
    const LitKey pattern = key_of(info.shots[static_cast<std::size_t>(sentinels[0]->shot)]);
    const double first = brightness(*sentinels[0]);
    for (const FrameRecord* frame : sentinels) {
      const double value = brightness(*frame);
      const bool is_same = key_of(info.shots[static_cast<std::size_t>(frame->shot)]) == pattern;
      if (is_same && first > 0.0 && value > 0.0) {
        points_[time_of(*frame)] = value / first;
      }
    }
  }

  [[nodiscard]] double at(std::int64_t time) const {
    if (points_.empty()) {
      return 1.0;
    }
    const auto after = points_.lower_bound(time);
    if (after == points_.begin()) {
      return after->second;
    }
    const auto before = std::prev(after);
    if (after == points_.end()) {
      return before->second;
    }
    const double t = static_cast<double>(time - before->first) /
                     static_cast<double>(after->first - before->first);
    return before->second + t * (after->second - before->second);
  }

 private:
  std::map<std::int64_t, double> points_;
};

[[noreturn]] void refuse(const Session& session, const std::string& what,
                         const std::string& cure) {
  throw Error(what, (session.folder() / "session.json").string(), cure);
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
  std::vector<const FrameRecord*> sentinels;
  for (const FrameRecord& frame : info.frames) {
    const ShotKind kind = info.shots[static_cast<std::size_t>(frame.shot)].kind;
    if (kind == ShotKind::dark) {
      plan.dark.push_back(&frame);
    } else if (kind == ShotKind::flat) {
      plan.flat.push_back(&frame);
    } else if (kind == ShotKind::sentinel) {
      sentinels.push_back(&frame);
    }
  }
  double dark_dn = info.form.black_level;
  if (!plan.dark.empty()) {
    dark_dn = 0.0;
    for (const FrameRecord* frame : plan.dark) {
      dark_dn += frame->evidence.mean_dn / static_cast<double>(plan.dark.size());
    }
  }
  const Drift drift(info, sentinels, dark_dn);
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
    group.frames.push_back({&frame, exposure_scale(shot, frame) * drift.at(time_of(frame))});
  }
  // A target shot of one light is still a lighting, and one bin may hold one light.
  const PatternFamily family = info.patterns.family;
  if (is_single && (family == PatternFamily::list || family == PatternFamily::one_at_a_time)) {
    make_single(session, by_pattern, plan);
  } else {
    make_multiplexed(session, by_pattern, plan);
  }
  return plan;
}

}  // namespace haarlight
