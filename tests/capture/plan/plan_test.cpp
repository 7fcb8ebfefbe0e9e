// SPDX-License-Identifier: Apache-2.0
#include "haarlight/capture/plan/plan.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

const std::string kRigs = HAARLIGHT_SOURCE_DIR "/configs/rigs/";
const std::string kHead = "schema = 1\nname = \"p\"\n";

Plan plan_of(const std::string& text, const std::string& rig = "small8.toml") {
  return expand_plan(parse_plan_file(kHead + text, "p.toml"), read_rig(kRigs + rig));
}

std::string refusal_of(const std::string& text) {
  try {
    (void)plan_of(text);
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty());
    EXPECT_THAT(error.where(), HasSubstr("p.toml"));
    return error.what();
  }
  ADD_FAILURE() << "accepted: " << text;
  return "";
}

std::vector<int> first_lights(const Plan& plan) {
  std::vector<int> out;
  for (const session::Shot& shot : plan.shots) {
    if (shot.kind == session::ShotKind::light) {
      out.push_back(shot.lit.front().light);
    }
  }
  return out;
}

TEST(Plan, OneAtATimeShootsEveryLightOnceInRasterOrder) {
  const Plan plan = plan_of("patterns = \"one_at_a_time\"\n");
  ASSERT_EQ(plan.shots.size(), 64U);
  for (int k = 0; k < 64; ++k) {
    const session::Shot& shot = plan.shots[static_cast<std::size_t>(k)];
    EXPECT_EQ(shot.index, k);
    ASSERT_EQ(shot.lit.size(), 1U);
    EXPECT_EQ(shot.lit[0], (session::LightLevel{.light = k, .level = 65535}));
    EXPECT_EQ(shot.exposure_us, 2000.0) << "the camera's own";
  }
}

TEST(Plan, EveryOrderIsAPermutation) {
  for (const char* order : {"raster", "bit_reversed", "greatest_distance"}) {
    std::vector<int> lights = first_lights(
        plan_of("patterns = \"one_at_a_time\"\norder = \"" + std::string(order) + "\"\n"));
    std::sort(lights.begin(), lights.end());
    for (int k = 0; k < 64; ++k) {
      EXPECT_EQ(lights[static_cast<std::size_t>(k)], k) << order;
    }
  }
}

TEST(Plan, BitReversedStartsAsWritten) {
  const std::vector<int> lights =
      first_lights(plan_of("patterns = \"one_at_a_time\"\norder = \"bit_reversed\"\n"));
  EXPECT_EQ(std::vector<int>(lights.begin(), lights.begin() + 4),
            (std::vector<int>{0, 32, 16, 48}));
}

TEST(Plan, GreatestDistanceGoesToTheOppositeCornerFirst) {
  const std::vector<int> lights =
      first_lights(plan_of("patterns = \"one_at_a_time\"\norder = \"greatest_distance\"\n"));
  EXPECT_EQ(lights[0], 0);
  EXPECT_EQ(lights[1], 63);
}

TEST(Plan, DarksAndSentinelsFrameTheLights) {
  const Plan plan = plan_of(
      "patterns = \"one_at_a_time\"\ndarks_every = 16\nsentinel_every = 32\nsentinel_light = "
      "5\n");
  const auto count = [&](session::ShotKind kind) {
    return std::count_if(plan.shots.begin(), plan.shots.end(),
                         [&](const session::Shot& shot) { return shot.kind == kind; });
  };
  EXPECT_EQ(count(session::ShotKind::dark), 5);      // before 0, 16, 32, 48 and at the end
  EXPECT_EQ(count(session::ShotKind::sentinel), 3);  // before 0, 32 and at the end
  EXPECT_EQ(plan.shots.front().kind, session::ShotKind::dark);
  EXPECT_TRUE(plan.shots.front().lit.empty());
  EXPECT_EQ(plan.shots.back().kind, session::ShotKind::sentinel);
  EXPECT_EQ(plan.shots.back().lit.front().light, 5);
}

TEST(Plan, BracketsAndRepeatsMultiply) {
  const Plan plan =
      plan_of("patterns = \"bins\"\nbin = 4\nexposures_us = [500, 2000]\nrepeats = 3\n");
  EXPECT_EQ(plan.shots.size(), 4U * 2U * 3U);
  EXPECT_EQ(plan.shots.front().exposure_us, 500.0);
  EXPECT_EQ(plan.shots.back().exposure_us, 2000.0);
  EXPECT_EQ(plan.shots.front().lit.size(), 16U);
}

TEST(Plan, ListKeepsItsLevels) {
  const Plan plan = plan_of(
      "patterns = \"list\"\n[[pattern]]\nlights = [9, 3]\nlevels = [100, 200]\n"
      "[[pattern]]\nlights = [1]\n");
  ASSERT_EQ(plan.shots.size(), 2U);
  EXPECT_EQ(plan.shots[0].lit, (std::vector<session::LightLevel>{{3, 200}, {9, 100}}));
  EXPECT_EQ(plan.shots[1].lit, (std::vector<session::LightLevel>{{1, 65535}}));
}

TEST(Plan, TheSameFileAlwaysGivesTheSameBytes) {
  const std::string text = "patterns = \"one_at_a_time\"\norder = \"greatest_distance\"\n";
  EXPECT_EQ(plan_to_json(plan_of(text)), plan_to_json(plan_of(text)));
  EXPECT_NE(plan_of(text).hash, plan_of(text + "level = 65534\n").hash);
}

TEST(Plan, JsonComesBackUnchanged) {
  const Plan plan = plan_of("patterns = \"haar\"\nlevel = 60000\ndarks_every = 10\n");
  const Plan again = plan_from_json(plan_to_json(plan), "plan.json");
  EXPECT_EQ(again.shots, plan.shots);
  EXPECT_EQ(again.hash, plan.hash);
  EXPECT_EQ(plan_to_json(again), plan_to_json(plan));
}

TEST(Plan, PowerAboveTheFacesLimitIsRefusedByName) {
  Rig rig = read_rig(kRigs + "small8.toml");
  rig.faces.front().max_power = Watts(100.0);
  const PlanSettings settings =
      parse_plan_file(kHead + "patterns = \"bins\"\nbin = 8\n", "p.toml");
  try {
    (void)expand_plan(settings, rig);
    FAIL() << "320 W accepted on a face of 100 W";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("320.0 W"));
    EXPECT_THAT(error.what(), HasSubstr("\"top\""));
    EXPECT_THAT(error.what(), HasSubstr("100.0 W"));
  }
}

RC_GTEST_PROP(Plan, NoAcceptedPlanExceedsTheLimit, ()) {
  Rig rig = read_rig(kRigs + "small8.toml");
  rig.faces.front().max_power = Watts(*rc::gen::inRange(5, 320));
  PlanSettings settings;
  settings.patterns = PlanPatterns::list;
  settings.list.resize(static_cast<std::size_t>(*rc::gen::inRange(1, 6)));
  for (auto& lit : settings.list) {
    for (const int k : *rc::gen::container<std::set<int>>(rc::gen::inRange(0, 64))) {
      lit.push_back({k, *rc::gen::arbitrary<std::uint16_t>()});
    }
  }
  // An independent check in whole numbers: sum of levels * 5 W <= limit * 65535.
  const bool fits =
      std::all_of(settings.list.begin(), settings.list.end(), [&](const auto& lit) {
        std::int64_t sum = 0;
        for (const session::LightLevel& light : lit) {
          sum += light.level;
        }
        return sum * 5 <=
               static_cast<std::int64_t>(rig.faces.front().max_power.value()) * 65535;
      });
  bool is_accepted = true;
  try {
    (void)expand_plan(settings, rig);
  } catch (const Error&) {
    is_accepted = false;
  }
  RC_ASSERT(is_accepted == fits);
}

TEST(PlanDryRun, CountsBytesWattsAndTime) {
  const Rig rig = read_rig(kRigs + "cube32.toml");
  const Plan plan =
      expand_plan(parse_plan_file(kHead + "patterns = \"one_at_a_time\"\n", "p.toml"), rig);
  const DryRun run = dry_run(plan, rig);
  EXPECT_EQ(run.n_shots, 1024);
  EXPECT_EQ(run.peak_watts, 5.0);
  EXPECT_NEAR(run.mean_watts, 5.0, 1e-9);
  EXPECT_GE(run.bytes, 1024U * 320U * 248U * 2U);
  EXPECT_NEAR(run.dark_seconds, 8 / 120.0, 1e-9);
  EXPECT_NEAR(run.seconds - run.dark_seconds, 1024 * 2 / 120.0, 1e-6)
      << "two frame times per light at 120 fps";
  EXPECT_NEAR(run.highest_duty, 1.0 / 1024.0, 1e-9);
}

TEST(PlanRefused, UnknownKeyWithTheNearestName) {
  EXPECT_THAT(refusal_of("patterns = \"one_at_a_time\"\nrepeat = 2\n"), HasSubstr("repeats"));
}
TEST(PlanRefused, UnknownFamily) {
  EXPECT_THAT(refusal_of("patterns = \"all_at_once\"\n"), HasSubstr("all_at_once"));
}
TEST(PlanRefused, MissingPatterns) { EXPECT_THAT(refusal_of(""), HasSubstr("patterns")); }
TEST(PlanRefused, ALightTheRigDoesNotHave) {
  EXPECT_THAT(refusal_of("patterns = \"list\"\n[[pattern]]\nlights = [64]\n"),
              HasSubstr("light 64"));
}
TEST(PlanRefused, ALightTwice) {
  EXPECT_THAT(refusal_of("patterns = \"list\"\n[[pattern]]\nlights = [4, 4]\n"),
              HasSubstr("twice"));
}
TEST(PlanRefused, LevelsThatDoNotMatch) {
  EXPECT_THAT(refusal_of("patterns = \"list\"\n[[pattern]]\nlights = [4, 5]\nlevels = [1]\n"),
              HasSubstr("1 levels for 2 lights"));
}
TEST(PlanRefused, ABinThatDoesNotDivide) {
  EXPECT_THAT(refusal_of("patterns = \"bins\"\nbin = 3\n"), HasSubstr("8 x 8"));
}
TEST(PlanRefused, AnExposureOfZero) {
  EXPECT_THAT(refusal_of("patterns = \"one_at_a_time\"\nexposures_us = [0]\n"),
              HasSubstr("exposure"));
}
TEST(PlanRefused, NotToml) { EXPECT_THAT(refusal_of("patterns = = 3\n"), HasSubstr("p.toml")); }
TEST(Plan, SMatrixOf64LightsIs63ShotsAndOneLightAlone) {
  const Plan plan = plan_of("patterns = \"s_matrix\"\n");
  ASSERT_EQ(plan.shots.size(), 64U);
  for (int i = 0; i < 63; ++i) {
    EXPECT_EQ(plan.shots[static_cast<std::size_t>(i)].lit.size(), 32U);
  }
  EXPECT_EQ(plan.shots[63].lit, (std::vector<session::LightLevel>{{63, 65535}}));
  EXPECT_EQ(plan.patterns.family, PatternFamily::s_matrix);
}

/// A lighting of the small rig: light k at (k % 7) / 6.
Lighting some_lighting(int n_colours) {
  Lighting lighting;
  lighting.weights.resize(64, n_colours);
  for (int k = 0; k < 64; ++k) {
    for (int c = 0; c < n_colours; ++c) {
      lighting.weights(k, c) = (k + 3 * c) % 7 / 6.0;
    }
  }
  return lighting;
}

Plan lit_plan(const std::string& patterns, const Lighting& lighting) {
  const std::string text =
      kHead + "environment = \"room.hdr\"\nwavelets = 20\npatterns = \"" + patterns + "\"\n";
  return expand_plan(parse_plan_file(text, "p.toml"), read_rig(kRigs + "small8.toml"),
                     &lighting);
}

TEST(Plan, ATargetShotHasTheLightingsLevels) {
  const Plan plan = lit_plan("lighting_target", some_lighting(1));
  ASSERT_EQ(plan.shots.size(), 1U);
  EXPECT_EQ(plan.patterns.family, PatternFamily::target);
  for (const session::LightLevel& lit : plan.shots[0].lit) {
    EXPECT_EQ(lit.level, std::lround(lit.light % 7 / 6.0 * 65535.0));
  }
  EXPECT_EQ(lit_plan("lighting_target", some_lighting(3)).shots.size(), 3U);
}

TEST(Plan, LightingHaarShootsTheWaveletsThatMatter) {
  // Only two halves of the face differ: mean and one wavelet suffice.
  Lighting lighting;
  lighting.weights = Eigen::MatrixXd::Ones(64, 1);
  lighting.weights.topRows(32) *= 3.0;
  const std::vector<int> kept = choose_wavelets(lighting, 8, 2);
  EXPECT_EQ(kept, (std::vector<int>{0, 8})) << "the mean, and top against bottom";
  const Plan plan = lit_plan("lighting_haar", some_lighting(1));
  EXPECT_EQ(plan.patterns.wavelets.size(), 20U);
  EXPECT_EQ(plan.shots.size(), 39U);
  EXPECT_EQ(plan_from_json(plan_to_json(plan), "p").patterns, plan.patterns);
}

TEST(Plan, NormsOfAnEarlierCaptureDecideWhichWavelets) {
  Lighting lighting = some_lighting(1);
  lighting.norms = Eigen::VectorXd::Zero(64);
  lighting.norms[63] = 1.0;
  EXPECT_THAT(choose_wavelets(lighting, 8, 2), ::testing::ElementsAre(0, 63));
}

TEST(PlanRefused, ALightingWithoutItsWeights) {
  EXPECT_THAT(refusal_of("patterns = \"lighting_target\"\nenvironment = \"room.hdr\"\n"),
              HasSubstr("room.hdr"));
  EXPECT_THAT(refusal_of("patterns = \"lighting_haar\"\n"), HasSubstr("environment"));
  EXPECT_THAT(refusal_of("patterns = \"bins\"\nenvironment = \"room.hdr\"\n"),
              HasSubstr("environment"));
}

TEST(PlanJsonRefused, EveryChangedByteOfAShot) {
  const std::string good = plan_to_json(plan_of("patterns = \"bins\"\nbin = 8\n"));
  EXPECT_NO_THROW((void)plan_from_json(good, "plan.json"));
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string bad = good;
    bad.replace(bad.find(from), from.size(), to);
    return bad;
  };
  for (const std::string& bad :
       {std::string("{"), std::string("[]"), std::string("{}"), with("65535", "65534"),
        with("\"light\"", "\"lamp\""), with("2000.0", "2001.0"),
        with("\"index\":0", "\"index\":1"), with("[[0,", "[[900,"), with("\"lit\"", "\"lid\""),
        with("\"schema\":1", "\"schema\":2"), good.substr(0, good.size() / 2)}) {
    EXPECT_THROW((void)plan_from_json(bad, "plan.json"), Error) << bad.substr(0, 80);
  }
}

int count_kind(const Plan& plan, session::ShotKind kind) {
  return static_cast<int>(
      std::count_if(plan.shots.begin(), plan.shots.end(),
                    [kind](const session::Shot& s) { return s.kind == kind; }));
}

TEST(Plan, DarksAndSentinelsComeByThePredictedTime) {
  const Plan plan =
      plan_of("patterns = \"one_at_a_time\"\ndarks_every_s = 0.2\nsentinel_every_s = 0.1\n");
  const double seconds = dry_run(plan, read_rig(kRigs + "small8.toml")).seconds;
  // One at each end and one every so often between.
  EXPECT_NEAR(count_kind(plan, session::ShotKind::dark), seconds / 0.2 + 1.0, 2.0);
  EXPECT_NEAR(count_kind(plan, session::ShotKind::sentinel), seconds / 0.1 + 1.0, 3.0);
  EXPECT_EQ(plan.shots.front().kind, session::ShotKind::dark);
  EXPECT_EQ(plan.shots.back().kind, session::ShotKind::sentinel);
  const Plan longer = plan_of("patterns = \"one_at_a_time\"\ndarks_every_s = 1000\n");
  EXPECT_EQ(count_kind(longer, session::ShotKind::dark), 2);
}

TEST(Plan, DarksForTheTemperatureStandAtTheEndOfTheirExposure) {
  const Plan plan = plan_of(
      "patterns = \"one_at_a_time\"\nexposures_us = [500, 2000]\ndarks_every = 1000\n"
      "darks_every_c = 1.5\nspare_darks = 3\n");
  EXPECT_EQ(plan.darks_every_c, 1.5);
  ASSERT_EQ(plan.shots.size(), 2U * (1 + 64 + 1 + 3));
  for (std::size_t i = 65; i < 69; ++i) {
    EXPECT_EQ(plan.shots[i].kind, session::ShotKind::dark);
    EXPECT_EQ(plan.shots[i].exposure_us, 500.0);
  }
  const Plan again = plan_from_json(plan_to_json(plan), "plan.json");
  EXPECT_EQ(again.darks_every_c, 1.5);
  EXPECT_EQ(again.hash, plan.hash);
  for (const char* half : {"darks_every = 8\ndarks_every_c = 1\n", "spare_darks = 2\n",
                           "darks_every_c = 1\nspare_darks = 2\n"}) {
    EXPECT_THROW((void)plan_of(std::string("patterns = \"one_at_a_time\"\n") + half), Error)
        << half;
  }
}

TEST(Plan, ALightTwiceInOnePatternIsRefusedFromCodeToo) {
  PlanSettings settings;  // as the daemon makes them for a preview
  settings.name = "preview";
  settings.patterns = PlanPatterns::list;
  settings.list = {{{7, 65535}, {7, 65535}}};
  EXPECT_THROW((void)expand_plan(settings, read_rig(kRigs + "small8.toml")), Error);
}

TEST(Plan, FlatFramesComeFirstInTheirOwnExposure) {
  const Plan plan = plan_of(
      "patterns = \"list\"\nflats = 3\nflat_level = 4000\nflat_exposure_us = 500\n"
      "darks_every = 8\n");
  ASSERT_EQ(plan.shots.size(), 4U);
  for (int i = 0; i < 3; ++i) {
    const session::Shot& shot = plan.shots[static_cast<std::size_t>(i)];
    EXPECT_EQ(shot.kind, session::ShotKind::flat);
    EXPECT_EQ(shot.lit.size(), 64U);
    EXPECT_EQ(shot.lit[9].level, 4000);
    EXPECT_EQ(shot.exposure_us, 500.0);
  }
  EXPECT_EQ(plan.shots[3].kind, session::ShotKind::dark);
  EXPECT_EQ(plan.shots[3].exposure_us, 500.0);
  EXPECT_EQ(plan_from_json(plan_to_json(plan), "plan.json").shots, plan.shots);
}

TEST(Plan, LimitsOfFramesAreReadAndOutOfRangeRefused) {
  const Plan plan = plan_of(
      "patterns = \"one_at_a_time\"\nmax_saturated_share = 0.02\nmin_signal_share = 0.1\n"
      "level_tolerance = 0.3\nattempts = 4\nrepeats = 2\nretake_wrong_light = true\n");
  const FrameLimits expected{0.02, 0.1, 0.3, 4, true};
  EXPECT_EQ(plan.limits, expected);
  EXPECT_EQ(plan_from_json(plan_to_json(plan), "plan.json").limits, expected);
  EXPECT_THAT(refusal_of("patterns = \"one_at_a_time\"\nmax_saturated_share = 2\n"),
              HasSubstr("max_saturated_share"));
  EXPECT_THAT(refusal_of("patterns = \"one_at_a_time\"\nattempts = 0\n"),
              HasSubstr("attempts"));
  EXPECT_THAT(refusal_of("patterns = \"one_at_a_time\"\nretake_wrong_light = true\n"),
              HasSubstr("add repeats = 2"));
}

TEST(Plan, WhereFramesHaveToAgreeEveryOtherRepeatRunsBackwards) {
  const auto lights = [](const std::string& more) {
    std::vector<int> found;
    for (const session::Shot& shot :
         plan_of("patterns = \"one_at_a_time\"\nlights = [1, 4, 9, 16]\nrepeats = 3\n" + more)
             .shots) {
      found.push_back(shot.lit[0].light);
    }
    return found;
  };
  EXPECT_EQ(lights(""), (std::vector<int>{1, 4, 9, 16, 1, 4, 9, 16, 1, 4, 9, 16}));
  // From the middle: no light follows the same one, and none itself, in passes one after
  // another.
  EXPECT_EQ(lights("retake_wrong_light = true\n"),
            (std::vector<int>{1, 4, 9, 16, 4, 1, 16, 9, 1, 4, 9, 16}));
}

}  // namespace
}  // namespace haarlight::capture
