// SPDX-License-Identifier: Apache-2.0
/// Two pictures of the same lights must be the same: on pictures that are sums of smooth ones,
/// with photon noise. The twin's own transport: light_proof_campaign_test.

#include "capture/proof/picture_agreement.h"

#include <cmath>
#include <optional>
#include <random>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/proof/frame_checks.h"

namespace haarlight::capture {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int kLights = 16;

/// Each light once forwards and once backwards from the middle, as plan_rounds.h arranges them.
std::vector<int> order() {
  std::vector<int> lights;
  for (int k = 0; k < kLights; ++k) {
    lights.push_back(k);
  }
  for (int i = 0; i < kLights; ++i) {
    lights.push_back((kLights / 2 - 1 - i + kLights) % kLights);
  }
  return lights;
}

Plan plan_of(const std::vector<int>& lights) {
  Plan plan;
  plan.n_lights = kLights;
  for (const int k : lights) {
    plan.shots.push_back(session::Shot{static_cast<int>(plan.shots.size()),
                                       session::ShotKind::light,
                                       {session::LightLevel{.light = k, .level = 65535}},
                                       1000.0});
  }
  return plan;
}

class Lab {
 public:
  explicit Lab(std::vector<int> lights = order())
      : lights_(std::move(lights)), agreement_(plan_of(lights_)) {}

  /// What light k gives at point i, 0.5 .. 1.5.
  static PointValues picture(int k) {
    PointValues values;
    for (int i = 0; i < kProofPoints; ++i) {
      values[i] = 1.0 + 0.5 * std::sin(2.4 * k + 0.11 * i * (1.0 + 0.31 * (k % 7)));
    }
    return values;
  }
  /// A frame of the shot: its own light, with `fraction` of another one.
  AgreementFinding shoot(int shot, double fraction = 0.0, int other = -1, double gain = 1.0) {
    const int own = lights_[static_cast<std::size_t>(shot)];
    PointValues mean = (1.0 - fraction) * picture(own);
    if (other >= 0) {
      mean += fraction * picture(other);
    }
    return show(shot, gain * mean);
  }
  AgreementFinding show(int shot, const PointValues& mean) {
    PointSamples samples;
    constexpr double kSigma = 2e-3;
    for (int i = 0; i < kProofPoints; ++i) {
      samples.mean[i] = mean[i] + noise_factor * kSigma * normal_(random_);
    }
    samples.noise = PointValues::Constant(kSigma * kSigma);
    samples.is_good.setConstant(true);
    if (clipped.count(shot) > 0) {
      samples.is_good[7] = false;
      samples.mean[7] = kClippedPoint;  // as a resumed run has it
    }
    t_ns_ += 20'000'000;
    return agreement_.take(shot, samples, t_ns_);
  }
  [[nodiscard]] int light(int shot) const { return lights_[static_cast<std::size_t>(shot)]; }

  double noise_factor = 1.0;  ///< of the true noise over what is told
  std::set<int> clipped;      ///< shots that have a clipped point

 private:
  std::vector<int> lights_;
  PictureAgreement agreement_;
  std::int64_t t_ns_ = 1'000'000'000;
  std::mt19937_64 random_{7};
  std::normal_distribution<double> normal_;
};

TEST(PictureAgreement, AnHonestRunAgreesAndSaysHowMuchOfAnotherLightCouldHide) {
  Lab lab;
  for (int shot = 0; shot < kLights; ++shot) {
    const AgreementFinding found = lab.shoot(shot);
    EXPECT_EQ(found.agrees_with, -1);
    EXPECT_THAT(found.doubted, IsEmpty());
  }
  for (int shot = kLights; shot < 2 * kLights; ++shot) {
    const AgreementFinding found = lab.shoot(shot);
    EXPECT_EQ(found.agrees_with, lab.light(shot)) << found.note;
    // Pictures 0.35 apart at each of 64 points, 0.005 of noise in a pair: 5 sigma is a
    // hundredth, times what the two directions have in common.
    EXPECT_LT(found.other_fraction, 0.1);
    EXPECT_GT(found.other_fraction, 0.003);
    EXPECT_THAT(found.doubted, IsEmpty()) << found.note;
  }
}

TEST(PictureAgreement, AClippedPointOfThePictureBeforeDoesNotCount) {
  const auto fraction_of_light_5 = [](const std::set<int>& clipped) {
    Lab lab;
    lab.clipped = clipped;
    double fraction = 0.0;
    for (int shot = 0; shot < 2 * kLights; ++shot) {
      const AgreementFinding found = lab.shoot(shot);
      fraction = lab.light(shot) == 5 ? found.other_fraction : fraction;
    }
    return fraction;
  };
  // Before light 5 are 4, and in the second pass 6.
  EXPECT_NEAR(fraction_of_light_5({4, kLights + 1}) / fraction_of_light_5({}), 1.0, 0.2);
}

TEST(PictureAgreement, AMixtureOfAFewPercentIsFoundAndSettledByTheNextFrame) {
  Lab lab;
  for (int shot = 0; shot < kLights; ++shot) {
    (void)lab.shoot(shot, shot == 5 ? 0.06 : 0.0, 4);
  }
  std::vector<int> doubted;
  for (int shot = kLights; shot < 2 * kLights; ++shot) {
    const AgreementFinding found = lab.shoot(shot);
    doubted.insert(doubted.end(), found.doubted.begin(), found.doubted.end());
    if (lab.light(shot) == 5) {
      EXPECT_EQ(found.agrees_with, -1);
      EXPECT_THAT(found.note, HasSubstr("the same lights and other pictures"));
    }
  }
  EXPECT_EQ(doubted, std::vector<int>{5});
  const AgreementFinding again = lab.shoot(5);
  EXPECT_EQ(lab.light(again.agrees_with), 5);
  EXPECT_THAT(again.doubted, IsEmpty());
}

TEST(PictureAgreement, AWrongFrameInTheSecondPassDoesNotBringDownOneThatAgreed) {
  std::vector<int> lights = order();
  const std::vector<int> third(lights.begin(), lights.begin() + kLights);
  lights.insert(lights.end(), third.begin(), third.end());
  Lab lab(lights);
  for (int shot = 0; shot < 2 * kLights; ++shot) {
    (void)lab.shoot(shot);
  }
  const AgreementFinding found = lab.shoot(2 * kLights + 3, 1.0, 2);
  EXPECT_EQ(found.doubted, std::vector<int>{2 * kLights + 3});
}

TEST(PictureAgreement, TheSameMixtureInBothPassesIsFound) {
  // A controller that is always 8 % of the exposure late: each frame has as much of the one
  // before.
  Lab lab;
  int n_doubted = 0;
  int n_agreed = 0;
  for (int shot = 0; shot < 2 * kLights; ++shot) {
    const AgreementFinding found =
        lab.shoot(shot, shot > 0 ? 0.08 : 0.0, shot > 0 ? lab.light(shot - 1) : -1);
    n_doubted += static_cast<int>(found.doubted.size());
    n_agreed += found.agrees_with >= 0 && found.other_fraction < 0.08 ? 1 : 0;
  }
  EXPECT_GE(n_doubted, kLights - 1);
  EXPECT_EQ(n_agreed, 0);
}

TEST(PictureAgreement, FramesWithTheSameLightBeforeProveNothing) {
  std::vector<int> lights;
  for (int i = 0; i < 2 * kLights; ++i) {
    lights.push_back(i % kLights);
  }
  Lab lab(lights);
  for (int shot = 0; shot < 2 * kLights; ++shot) {
    const AgreementFinding found = lab.shoot(shot);
    if (shot > kLights) {
      EXPECT_EQ(found.agrees_with, -1) << shot;
    }
    EXPECT_THAT(found.doubted, IsEmpty()) << shot;
  }
}

TEST(PictureAgreement, TwoLightsThatShowOnePictureAreBothTakenAgainOnce) {
  // As two frames would that both came when the other's light was on.
  Lab lab;
  const auto seen = [](int k) { return Lab::picture(k == 3 ? 5 : k); };
  int n_doubted = 0;
  for (int shot = 0; shot < 2 * kLights; ++shot) {
    const AgreementFinding found = lab.show(shot, seen(lab.light(shot)));
    n_doubted += static_cast<int>(found.doubted.size());
    if (!found.doubted.empty()) {
      EXPECT_THAT(found.note, HasSubstr("different lights and the same picture"));
      EXPECT_EQ(found.agrees_with, -1);
    }
  }
  EXPECT_GE(n_doubted, 3);
  EXPECT_LE(n_doubted, 4);
  // Now they are believed, with other lights between them: two LEDs may look alike.
  for (const int shot : {3, 10, kLights + 4, 12, 5, 11, kLights + 2}) {
    EXPECT_THAT(lab.show(shot, seen(lab.light(shot))).doubted, IsEmpty()) << shot;
  }
}

TEST(PictureAgreement, MoreNoiseThanTheRigFileSaysWidensWhatIsStatedAndStopsNothing) {
  std::vector<int> lights = order();
  const std::vector<int> twice = lights;
  lights.insert(lights.end(), twice.begin(), twice.end());
  const auto least_fraction = [&lights](double noise_factor, int& n_doubted_late) {
    Lab lab(lights);
    lab.noise_factor = noise_factor;
    double least = 1.0;
    for (int shot = 0; shot < 4 * kLights; ++shot) {
      const AgreementFinding found = lab.shoot(shot);
      // 24 pairs tell of it.
      n_doubted_late += shot > 3 * kLights ? static_cast<int>(found.doubted.size()) : 0;
      least = shot > 3 * kLights && found.agrees_with >= 0
                  ? std::min(least, found.other_fraction)
                  : least;
    }
    return least;
  };
  int n_doubted = 0;
  const double as_stated = least_fraction(1.0, n_doubted);
  const double noisy = least_fraction(4.0, n_doubted);
  EXPECT_LE(n_doubted, 1) << "the best of 24 pairs says a little less than there is";
  // 4 x 0.002 instead of the 0.0036 that are told, with what no noise explains.
  EXPECT_NEAR(noisy / as_stated, 2.2, 0.8);
}

TEST(PictureAgreement, LampsThatDimTogetherAreNoContradiction) {
  Lab lab;
  for (int shot = 0; shot < 2 * kLights; ++shot) {
    EXPECT_THAT(lab.shoot(shot, 0.0, -1, 1.0 - 0.004 * shot).doubted, IsEmpty()) << shot;
  }
}

TEST(PictureAgreement, ALightThatDoesNotComeIsTakenAgainOnceAndADeadOneIsSaid) {
  Lab lab;
  for (int shot = 0; shot < 9; ++shot) {
    (void)lab.shoot(shot);
  }
  EXPECT_EQ(lab.show(9, PointValues::Zero()).doubted, std::vector<int>{9});
  (void)lab.shoot(10);
  const AgreementFinding second = lab.show(9, PointValues::Zero());
  EXPECT_TRUE(second.is_given_up);
  EXPECT_THAT(second.doubted, IsEmpty());
  EXPECT_THAT(second.note, HasSubstr("as dark as without its light"));
}

TEST(PictureAgreement, AMovedObjectHasTheOlderFramesTakenAgain) {
  Lab lab;
  for (int shot = 0; shot < kLights; ++shot) {
    (void)lab.shoot(shot);
  }
  std::vector<int> doubted;
  const auto moved = [&lab](int shot) {
    return PointValues(Lab::picture(lab.light(shot)).reverse());
  };
  for (int shot = kLights; shot < 2 * kLights; ++shot) {
    const AgreementFinding found = lab.show(shot, moved(shot));
    doubted.insert(doubted.end(), found.doubted.begin(), found.doubted.end());
  }
  EXPECT_EQ(doubted.size(), static_cast<std::size_t>(kLights));
  EXPECT_THAT(doubted, Contains(0));
  // In an order that is not the second pass's.
  for (const int shot : {0, 2, 4, 6, 8, 10, 12, 14, 1, 3, 5, 7, 9, 11, 13, 15}) {
    const AgreementFinding found = lab.show(shot, moved(shot));
    EXPECT_GE(found.agrees_with, 0) << shot << ": " << found.note;
    EXPECT_THAT(found.doubted, IsEmpty());
  }
}

TEST(PictureAgreement, ADisputeThatNeverEndsIsGivenUpAndSaid) {
  Lab lab;
  std::mt19937_64 random(3);
  bool is_given_up = false;
  for (int i = 0; i < 40 && !is_given_up; ++i) {
    for (const int shot : {3, 7, kLights + 4, 8}) {
      const PointValues chaos = Lab::picture(100 + static_cast<int>(random() % 1000));
      is_given_up =
          (lab.light(shot) == 3 ? lab.show(shot, chaos) : lab.shoot(shot)).is_given_up ||
          is_given_up;
    }
  }
  EXPECT_TRUE(is_given_up);
}

// ---- through the frame checker, and after a restart

class CheckedLab {
 public:
  CheckedLab() : plan_(plan_of(order())) {
    plan_.limits.retake_wrong_light = true;
    form_.width = form_.height = form_.stored_height = 64;
    form_.black_level = 100.0;
    form_.white_level = 4095.0;
    layout_.faces = {{4, 4}};
    layout_.noise = {
        .gain_e_per_dn = 1.0, .read_e = 3.0, .full_well_e = 16000.0, .black_dn = 100.0};
    restart();
  }
  void restart() { checker_.emplace(plan_, form_, layout_); }
  FrameFinding shoot(int shot, int light, session::FrameEvidence& evidence) {
    Image<std::uint16_t> words(64, 64, 1);
    const PointValues picture = Lab::picture(light);
    for (int y = 0; y < 64; ++y) {
      for (int x = 0; x < 64; ++x) {
        const double electrons = 1000.0 * picture[y / 8 * 8 + x / 8];
        words(y, x) = static_cast<std::uint16_t>(
            std::lround(100.0 + electrons + std::sqrt(electrons) * normal_(random_)));
      }
    }
    t_ns_ += 20'000'000;
    evidence.exposure_read_us = 1000.0;
    evidence.t_exposure_start_ns = t_ns_;
    return checker_->check(shot, words.view(), evidence);
  }
  FrameChecker& checker() { return *checker_; }

 private:
  Plan plan_;
  session::FrameForm form_;
  LightLayout layout_;
  std::optional<FrameChecker> checker_;
  std::int64_t t_ns_ = 0;
  std::mt19937_64 random_{11};
  std::normal_distribution<double> normal_;
};

TEST(PictureAgreement, AResumedRunKnowsThePicturesOfTheFramesThatItHas) {
  CheckedLab lab;
  const std::vector<int> lights = order();
  std::vector<session::FrameEvidence> known;
  for (int shot = 0; shot < kLights; ++shot) {
    session::FrameEvidence evidence;
    const int shown = shot == 6 ? 5 : shot;  // light 6's frame came too early
    EXPECT_TRUE(lab.shoot(shot, shown, evidence).is_taken());
    EXPECT_EQ(evidence.picture_points.size(), 64U);
    known.push_back(session::evidence_from_json(session::evidence_to_json(evidence), "x"));
  }
  lab.restart();
  for (int shot = 0; shot < kLights; ++shot) {
    EXPECT_THAT(lab.checker().remember(shot, known[static_cast<std::size_t>(shot)]), IsEmpty());
  }
  for (int shot = kLights; shot < 2 * kLights; ++shot) {
    session::FrameEvidence evidence;
    const int light = lights[static_cast<std::size_t>(shot)];
    const FrameFinding found = lab.shoot(shot, light, evidence);
    EXPECT_EQ(evidence.agrees_with, light == 6 ? -1 : light) << found.note;
    EXPECT_EQ(found.doubted, light == 6 ? std::vector<int>{6} : std::vector<int>{});
    EXPECT_EQ(evidence.is_picture_proved, light != 6);
  }
}

}  // namespace
}  // namespace haarlight::capture
