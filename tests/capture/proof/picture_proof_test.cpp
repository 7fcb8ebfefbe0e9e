// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/picture_proof.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr int kSide = 6;  // lights

/// One light after the other, `repeats` times, and a dark frame last.
Plan plan_of(int repeats) {
  Plan plan;
  plan.n_lights = kSide * kSide;
  for (int i = 0; i < repeats * plan.n_lights; ++i) {
    plan.shots.push_back(
        session::Shot{i, session::ShotKind::light, {{i % plan.n_lights, 65535}}, 1000.0});
  }
  return plan;
}

session::FrameForm form() {
  session::FrameForm form;
  form.width = kWidth;
  form.height = form.stored_height = kHeight;
  form.black_level = 64.0;
  form.white_level = 4095.0;
  return form;
}

LightLayout layout() {
  LightLayout layout;
  layout.faces = {{kSide, kSide}};
  layout.noise = {
      .gain_e_per_dn = 4.0, .read_e = 8.0, .full_well_e = 16000.0, .black_dn = 64.0};
  return layout;
}

/// A spot above each light's position, with photon and read noise.
class Scene {
 public:
  Image<std::uint16_t> shoot(const std::vector<std::pair<int, double>>& lights,
                             double shift = 0.0) {
    Image<std::uint16_t> words(kHeight, kWidth, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        double e = 0.0;
        for (const auto& [k, fraction] : lights) {
          const double dx = x - 10.0 * (k % kSide) - 7.0 - shift;
          const int row = k / kSide;
          const double dy = y - 8.0 * row - 4.0;
          e += fraction * 6000.0 / (1.0 + 0.002 * (dx * dx + dy * dy));
        }
        const double noise = std::sqrt(e + 64.0) * standard_normal(hash_key(77, ++n_));
        words(y, x) = static_cast<std::uint16_t>(std::lround(64.0 + (e + noise) / 4.0));
      }
    }
    return words;
  }

 private:
  std::uint64_t n_ = 0;
};

PictureFinding validate(PictureProof& proof, int shot, const Image<std::uint16_t>& words) {
  session::FrameEvidence evidence;
  evidence.exposure_read_us = 1000.0;
  return proof.validate(shot, *proof.sample(shot, words.view(), evidence), evidence);
}

/// All lights once, as they should be.
int shoot_all(PictureProof& proof, Scene& scene) {
  int n_wrong = 0;
  for (int k = 0; k < kSide * kSide; ++k) {
    n_wrong += validate(proof, k, scene.shoot({{k, 1.0}})).problem.empty() ? 0 : 1;
  }
  return n_wrong;
}

TEST(PictureProof, TheFirstFrameHasNoPredictionAndSaysSo) {
  PictureProof proof(plan_of(1), layout(), form());
  Scene scene;
  EXPECT_FALSE(validate(proof, 0, scene.shoot({{0, 1.0}})).is_predicted);
}

TEST(PictureProof, AnHonestRunIsNotDoubted) {
  PictureProof proof(plan_of(2), layout(), form());
  Scene scene;
  EXPECT_EQ(shoot_all(proof, scene), 0);
  for (int k = 0; k < kSide * kSide; ++k) {
    const PictureFinding found = validate(proof, 36 + k, scene.shoot({{k, 1.0}}));
    EXPECT_EQ(found.problem, "") << k;
    EXPECT_TRUE(found.is_predicted);
    EXPECT_GT(found.discrimination_sigma, 10.0);
  }
}

TEST(PictureProof, ThePictureOfTheLightBeforeIsToldOnAFirstPassToo) {
  PictureProof proof(plan_of(1), layout(), form());
  Scene scene;
  for (int k = 0; k < 6; ++k) {
    ASSERT_EQ(validate(proof, k, scene.shoot({{k, 1.0}})).problem, "");
  }
  const PictureFinding found = validate(proof, 6, scene.shoot({{5, 1.0}}));
  EXPECT_THAT(found.problem, HasSubstr("light 5"));
  EXPECT_EQ(validate(proof, 6, scene.shoot({{6, 1.0}})).problem, "");
}

TEST(PictureProof, AMixtureWithTheLightBeforeIsToldWhereItsOwnIsKnown) {
  PictureProof proof(plan_of(2), layout(), form());
  Scene scene;
  ASSERT_EQ(shoot_all(proof, scene), 0);
  for (int k = 0; k < 10; ++k) {
    ASSERT_EQ(validate(proof, 36 + k, scene.shoot({{k, 1.0}})).problem, "");
  }
  const PictureFinding found = validate(proof, 46, scene.shoot({{9, 0.3}, {10, 0.7}}));
  EXPECT_THAT(found.problem, HasSubstr("light 9"));
}

TEST(PictureProof, ALedThatDimsIsNoOtherLight) {
  PictureProof proof(plan_of(2), layout(), form());
  Scene scene;
  ASSERT_EQ(shoot_all(proof, scene), 0);
  for (int k = 0; k < kSide * kSide; ++k) {
    EXPECT_EQ(validate(proof, 36 + k, scene.shoot({{k, 0.8}})).problem, "") << k;
  }
}

TEST(PictureProof, AMovedObjectEndsThePredictionsAndNotTheRun) {
  PictureProof proof(plan_of(2), layout(), form());
  Scene scene;
  ASSERT_EQ(shoot_all(proof, scene), 0);
  int n_wrong = 0;
  std::string note;
  for (int k = 0; k < kSide * kSide; ++k) {
    const PictureFinding found = validate(proof, 36 + k, scene.shoot({{k, 1.0}}, 25.0));
    n_wrong += found.problem.empty() ? 0 : 1;
    note += found.note;
  }
  EXPECT_LE(n_wrong, 4);
  EXPECT_THAT(note, HasSubstr("the scene has changed"));
}

}  // namespace
}  // namespace haarlight::capture
