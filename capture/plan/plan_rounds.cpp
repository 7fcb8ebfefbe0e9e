// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/plan_rounds.h"

#include <algorithm>

#include "capture/plan/timing.h"

namespace haarlight::capture {

namespace {

constexpr double kFramesOfAChange = 2.0;  // until a new exposure takes effect

/// Collects the shots and tracks the predicted time.
class Rounds {
 public:
  Rounds(const PlanSettings& settings, const Rig& rig) : settings_(settings), rig_(rig) {}

  void append(session::ShotKind kind, std::vector<session::LightLevel> lit,
              double exposure_us) {
    const double last = shots_.empty() ? exposure_us : shots_.back().exposure_us;
    seconds_ += shot_seconds(rig_, exposure_us, last);
    if (kind == session::ShotKind::dark) {
      dark_s_ = seconds_;
    } else if (kind == session::ShotKind::sentinel) {
      sentinel_s_ = seconds_;
    }
    shots_.push_back(session::Shot{.index = static_cast<int>(shots_.size()),
                                   .kind = kind,
                                   .lit = std::move(lit),
                                   .exposure_us = exposure_us});
  }

  void append_flats(double exposure_us) {
    std::vector<session::LightLevel> all;
    all.reserve(static_cast<std::size_t>(rig_.n_lights()));
    for (int k = 0; k < rig_.n_lights(); ++k) {
      all.push_back({.light = k, .level = settings_.flat_level});
    }
    const double flat_us =
        settings_.flat_exposure_us > 0.0 ? settings_.flat_exposure_us : exposure_us;
    for (int i = 0; i < settings_.flats; ++i) {
      append(session::ShotKind::flat, all, flat_us);
    }
    // The flat frames' own dark, where their exposure is a different one.
    if (settings_.flats > 0 && (settings_.darks_every > 0 || settings_.darks_every_s > 0.0)) {
      append(session::ShotKind::dark, {}, flat_us);
    }
  }

  void append_round(const std::vector<std::vector<session::LightLevel>>& patterns,
                    double exposure_us) {
    for (std::size_t i = 0; i <= patterns.size(); ++i) {
      const bool is_edge = i == 0 || i == patterns.size();
      if (is_due(settings_.darks_every, settings_.darks_every_s, i, is_edge, dark_s_)) {
        append(session::ShotKind::dark, {}, exposure_us);
      }
      if (is_due(settings_.sentinel_every, settings_.sentinel_every_s, i, is_edge,
                 sentinel_s_)) {
        append(
            session::ShotKind::sentinel,
            {session::LightLevel{.light = settings_.sentinel_light, .level = settings_.level}},
            exposure_us);
      }
      if (i < patterns.size()) {
        append(patterns[i].empty() ? session::ShotKind::dark : session::ShotKind::light,
               patterns[i], exposure_us);
      }
    }
  }

  void append_spare_darks(double exposure_us) {
    for (int i = 0; i < settings_.spare_darks; ++i) {
      append(session::ShotKind::dark, {}, exposure_us);
    }
  }

  [[nodiscard]] std::vector<session::Shot> take() { return std::move(shots_); }

 private:
  [[nodiscard]] bool is_due(int every, double every_s, std::size_t done, bool is_edge,
                            double last_s) const {
    if (every <= 0 && every_s <= 0.0) {
      return false;
    }
    return is_edge || (every > 0 && done % static_cast<std::size_t>(every) == 0) ||
           (every_s > 0.0 && seconds_ - last_s >= every_s);
  }

  const PlanSettings& settings_;
  const Rig& rig_;
  std::vector<session::Shot> shots_;
  double seconds_ = 0.0;
  double dark_s_ = 0.0;
  double sentinel_s_ = 0.0;
};

}  // namespace

double shot_seconds(const Rig& rig, double exposure_us, double last_exposure_us) {
  const double period_s = std::max(1.0 / rig.cameras.front().fps, exposure_us * 1e-6);
  const double frames = expected_frames_a_shot(rig, exposure_us) +
                        (exposure_us == last_exposure_us ? 0.0 : kFramesOfAChange);
  return frames * period_s;
}

std::vector<session::Shot> arrange_shots(
    const PlanSettings& settings, const Rig& rig,
    const std::vector<std::vector<session::LightLevel>>& patterns,
    const std::vector<double>& exposures) {
  Rounds rounds(settings, rig);
  rounds.append_flats(exposures.front());
  // Every other repeat backwards from the middle, where frames of the same lights must agree:
  // then no light follows the same lights as before.
  std::vector<std::vector<session::LightLevel>> backwards;
  if (settings.limits.retake_wrong_light) {
    backwards.assign(patterns.rbegin(), patterns.rend());
    std::rotate(backwards.begin(),
                backwards.begin() + static_cast<std::ptrdiff_t>(patterns.size() / 2),
                backwards.end());
  }
  for (const double exposure_us : exposures) {
    for (int i = 0; i < settings.repeats && !patterns.empty(); ++i) {
      rounds.append_round(i % 2 == 1 && !backwards.empty() ? backwards : patterns, exposure_us);
    }
    rounds.append_spare_darks(exposure_us);
  }
  return rounds.take();
}

}  // namespace haarlight::capture
