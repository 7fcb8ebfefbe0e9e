// SPDX-License-Identifier: Apache-2.0
/// @file
/// A rig's limits on a plan: power, supply strings, PWM periods, heat.

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "capture/plan/timing.h"
#include "core/count.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kFullLevel = 65535.0;
constexpr double kSlack = 1.0 + 1e-9;  // rounding of the sum over 65536 lights
// Of a period: what is then lost or counted twice is below 1e-3 of one period's light.
constexpr double kPeriodTolerance = 1e-3;

struct Position {
  const Face* face = nullptr;
  std::size_t i_face = 0;
  std::size_t i_string = 0;  ///< over all faces; meaningless without strings
};

std::vector<Position> positions_of(const Rig& rig) {
  std::vector<Position> positions;
  std::size_t string = 0;
  for (std::size_t i = 0; i < rig.faces.size(); ++i) {
    const Face& face = rig.faces[i];
    for (int k = 0; k < face.n_lights(); ++k) {
      if (k > 0 && face.string_lights > 0 && k % face.string_lights == 0) {
        ++string;
      }
      positions.push_back({&face, i, string});
    }
    ++string;
  }
  return positions;
}

void require_rig(const Plan& plan, const Rig& rig, const std::string& where) {
  if (plan.n_lights != rig.n_lights()) {
    throw Error(fmt::format("the plan is for {} lights, rig \"{}\" has {}", plan.n_lights,
                            rig.name, rig.n_lights()),
                where, "make the plan for this rig");
  }
}

void require_pwm(const Plan& plan, const std::vector<Position>& positions,
                 const std::string& where) {
  for (const session::Shot& shot : plan.shots) {
    for (const session::LightLevel& light : shot.lit) {
      const Face& face = *positions[count(light.light)].face;
      if (face.pwm_hz <= 0.0 || light.level >= kFullLevel || light.level == 0) {
        continue;
      }
      const double periods = shot.exposure_us * face.pwm_hz * 1e-6;
      if (periods < 0.5 || std::abs(periods - std::round(periods)) > kPeriodTolerance) {
        throw Error(
            fmt::format("shot {} dims lights of face \"{}\" by PWM of {:g} Hz, but exposes "
                        "{:g} us = {:.3f} periods",
                        shot.index, face.id, face.pwm_hz, shot.exposure_us, periods),
            where,
            fmt::format("expose a whole number of periods of {:g} us: {:g} us",
                        1e6 / face.pwm_hz,
                        std::max(1.0, std::round(periods)) * 1e6 / face.pwm_hz));
      }
    }
  }
}

/// Heat as the controller computes it: h' = (level - h) / tau, each light lit for the whole of
/// its shot's time.
void require_duty(const Plan& plan, const Rig& rig, const std::vector<Position>& positions,
                  const std::string& where) {
  const bool is_limited = std::any_of(rig.faces.begin(), rig.faces.end(),
                                      [](const Face& face) { return face.max_duty < 1.0; });
  if (!is_limited) {
    return;
  }
  std::vector<double> heat(positions.size(), 0.0);
  std::vector<double> since_s(positions.size(), 0.0);
  double now_s = 0.0;
  for (const session::Shot& shot : plan.shots) {
    const double shot_s = seconds_a_shot(rig, shot.exposure_us);
    for (const session::LightLevel& light : shot.lit) {
      const auto k = count(light.light);
      const Face& face = *positions[k].face;
      if (face.max_duty >= 1.0) {
        continue;
      }
      const double drive = light.level / kFullLevel;
      const double cooled = heat[k] * std::exp(-(now_s - since_s[k]) / face.heat_tau_s);
      heat[k] = drive + (cooled - drive) * std::exp(-shot_s / face.heat_tau_s);
      since_s[k] = now_s + shot_s;
      if (heat[k] > face.max_duty) {
        throw Error(
            fmt::format("shot {} heats light {} of face \"{}\" to {:.3f} of full drive, "
                        "allowed are {:.3f} ({:.3f} s at drive {:.3f} after {:.3f}, time "
                        "constant {:g} s)",
                        shot.index, light.light, face.id, heat[k], face.max_duty, shot_s, drive,
                        cooled, face.heat_tau_s),
            where,
            "light fewer elements at once, lower level, or choose order = \"bit_reversed\"");
      }
    }
    now_s += shot_s;
  }
}

}  // namespace

void require_power(const Plan& plan, const Rig& rig, const std::string& where) {
  require_rig(plan, rig, where);
  const std::vector<Position> positions = positions_of(rig);
  std::vector<double> watts(rig.faces.size());
  std::vector<double> string_watts(positions.back().i_string + 1);
  for (const session::Shot& shot : plan.shots) {
    std::fill(watts.begin(), watts.end(), 0.0);
    std::fill(string_watts.begin(), string_watts.end(), 0.0);
    for (const session::LightLevel& light : shot.lit) {
      const Position& position = positions[count(light.light)];
      const double of_light = light.level / kFullLevel * position.face->element_power.value();
      watts[position.i_face] += of_light;
      string_watts[position.i_string] += of_light;
      const double string_limit = position.face->max_string_power.value();
      if (position.face->string_lights > 0 &&
          string_watts[position.i_string] > string_limit * kSlack) {
        throw Error(fmt::format("shot {} draws more than {:.1f} W on the string of light {}, "
                                "face \"{}\" ({:.1f} W so far)",
                                shot.index, string_limit, light.light, position.face->id,
                                string_watts[position.i_string]),
                    where, "light fewer elements of a string at once, or lower level");
      }
    }
    for (std::size_t i = 0; i < watts.size(); ++i) {
      const double limit = rig.faces[i].max_power.value();
      if (watts[i] > limit * kSlack) {
        throw Error(fmt::format("shot {} draws {:.1f} W on face \"{}\", allowed are {:.1f} W",
                                shot.index, watts[i], rig.faces[i].id, limit),
                    where, "light fewer elements at once, or lower level");
      }
    }
  }
}

void require_sync(const Plan& plan, const Rig& rig, const std::string& where) {
  if (rig.sync != SyncMode::camera_leads || rig.cameras.empty()) {
    return;
  }
  double longest_us = 0.0;
  for (const session::Shot& shot : plan.shots) {
    longest_us = std::max(longest_us, shot.exposure_us);
  }
  const std::string problem = find_strobe_problem(rig, longest_us);
  if (problem.empty()) {
    return;
  }
  const CameraSpec& camera = rig.cameras.front();
  const double rest_us = camera.skew_us + 1e-3 * static_cast<double>(settle_ns(rig.controller));
  const double period_us = 1e6 / camera.fps;
  const double room_us = rig.strobe_every * period_us - rest_us;
  std::string hint;
  if (room_us > 0.0) {
    hint = fmt::format("expose at most {:.0f} us, ", std::min(room_us, period_us));
  }
  hint += fmt::format("set fps = {:.4g} or less, or strobe_every = {} in [sync]",
                      std::floor(1e8 * rig.strobe_every / (longest_us + rest_us)) / 100.0,
                      static_cast<int>(std::ceil((longest_us + rest_us) / period_us)));
  throw Error(problem, where, hint);
}

void require_limits(const Plan& plan, const Rig& rig, const std::string& where) {
  require_power(plan, rig, where);
  require_sync(plan, rig, where);
  const std::vector<Position> positions = positions_of(rig);
  require_pwm(plan, positions, where);
  require_duty(plan, rig, positions, where);
}

}  // namespace haarlight::capture
