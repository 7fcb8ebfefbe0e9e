// SPDX-License-Identifier: Apache-2.0
/// A plan that the host accepts is never refused or cut by the controller: the simulated
/// controller, which sums milliwatts and heat on its own, is the independent checker.

#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "capture/plan/timing.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"
#include "tests/firmware_iface/controller_fixture.h"

namespace haarlight::capture {
namespace {

using firmware_iface::registers::Exception;

/// Levels and on-bits of one shot.
void load(firmware_iface::LightController& c, const session::Shot& shot, int n_lights,
          std::int64_t t_ns) {
  for (int k = 0; k < n_lights; ++k) {
    (void)firmware_iface::set_on(c, k, false, t_ns);
  }
  for (const session::LightLevel& light : shot.lit) {
    RC_ASSERT(firmware_iface::set_level(c, light.light, light.level, t_ns) == Exception::none);
    RC_ASSERT(firmware_iface::set_on(c, light.light, true, t_ns) == Exception::none);
  }
}

RC_GTEST_PROP(PlanLimits, WhatTheHostAcceptsTheControllerShows, ()) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  Face& face = rig.faces[0];
  face.max_power = Watts(*rc::gen::inRange(5, 120));
  if (*rc::gen::arbitrary<bool>()) {
    face.string_lights = *rc::gen::inRange(1, 20);
    face.max_string_power = Watts(*rc::gen::inRange(5, 60));
  }
  if (*rc::gen::arbitrary<bool>()) {
    face.max_duty = *rc::gen::inRange(5, 90) / 100.0;
    face.heat_tau_s = *rc::gen::inRange(2, 50) / 100.0;
  }
  PlanSettings settings;
  settings.name = "p";
  settings.patterns = PlanPatterns::list;
  settings.list.resize(static_cast<std::size_t>(*rc::gen::inRange(1, 8)));
  for (auto& lit : settings.list) {
    for (const int k : *rc::gen::container<std::set<int>>(rc::gen::inRange(0, 64))) {
      lit.push_back({k, *rc::gen::inRange<std::uint16_t>(1, 65535)});
    }
  }
  bool is_accepted = true;
  Plan plan;
  try {
    plan = expand_plan(settings, rig);
  } catch (const Error&) {
    is_accepted = false;
    Rig unlimited = rig;
    unlimited.faces[0].max_power = Watts(1e6);
    unlimited.faces[0].string_lights = 0;
    unlimited.faces[0].max_duty = 1.0;
    plan = expand_plan(settings, unlimited);
  }
  firmware_iface::LightController c(firmware_iface::controller_config(rig), 1, 0);
  std::int64_t now = 0;
  bool is_shown = true;
  std::uint32_t tag = 0;
  for (const session::Shot& shot : plan.shots) {
    load(c, shot, 64, now);
    const bool is_latched = firmware_iface::latch(c, ++tag, now) == Exception::none;
    now += static_cast<std::int64_t>(seconds_a_shot(rig, shot.exposure_us) * 1e9);
    c.advance(now);
    // A light that became too hot has been cut.
    is_shown = is_shown && is_latched && (shot.lit.empty() || !c.lit().pattern->empty());
  }
  if (is_accepted) {
    RC_ASSERT(is_shown);
  } else if (face.max_duty == 1.0) {
    RC_ASSERT(!is_shown);  // power is the same sum on both sides
  }
}

/// What is refused; made first, the second would take 17 GB and the third 5 GB.
TEST(PlanLimits, ABoundlessPlanIsRefusedByArithmeticBeforeItIsMade) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  rig.faces[0].rows = rig.faces[0].cols = 256;
  const auto refusal = [&rig](const PlanSettings& settings) -> std::string {
    try {
      return std::to_string(expand_plan(settings, rig).shots.size()) + " shots were made";
    } catch (const Error& error) {
      return error.what();
    }
  };
  PlanSettings many;
  many.exposures_us = {1000.0, 2000.0};
  many.repeats = 10000;  // 1.3e9 shots
  EXPECT_THAT(refusal(many), ::testing::HasSubstr("1.31e+09 shots"));
  PlanSettings s_matrix;
  s_matrix.patterns = PlanPatterns::s_matrix;
  EXPECT_THAT(refusal(s_matrix), ::testing::HasSubstr("2.15e+09 lit lights"));
  PlanSettings flats;
  flats.lights = {0};
  flats.flats = 10000;
  EXPECT_THAT(refusal(flats), ::testing::HasSubstr("6.55e+08 lit lights"));
}

}  // namespace
}  // namespace haarlight::capture
