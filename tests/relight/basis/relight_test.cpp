// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/relight.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress.h"
#include "relight/basis/weight_list.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

constexpr int kLights = 256;

/// A stack and its files, each made when it is first requested.
class Relight : public testing::Test {
 protected:
  static void SetUpTestSuite() { shared_folder = std::make_unique<test::TemporaryFolder>(); }
  static void TearDownTestSuite() { shared_folder.reset(); }

  static BasisFile open(const std::string& name) {
    const auto file = shared_folder->path() / name;
    if (!std::filesystem::exists(file)) {
      make(name, file);
    }
    return BasisFile::open(file);
  }
  static const MemoryStack& stack() { return make_stack({}); }
  static const std::vector<std::string>& names() {
    static const std::vector<std::string> kNames = {"percent.hlb", "plate.hlb", "fine.hlb",
                                                    "exact.hlb", "direct.hlb"};
    return kNames;
  }

 private:
  static void make(const std::string& name, const std::filesystem::path& file) {
    const MemoryStack& plate = make_stack({.has_sphere = false});
    if (name == "percent.hlb") {
      (void)compress_stack(made_source(stack(), 16), file, {});
    } else if (name == "plate.hlb") {
      (void)compress_stack(made_source(stack(), 16, &plate), file, {});
    } else if (name == "fine.hlb") {
      (void)compress_stack(made_source(stack(), 16, &plate), file, {.relative_l2 = 1e-4});
    } else if (name == "exact.hlb") {
      (void)compress_stack(made_source(stack(), 16), file, {.relative_l2 = 0.0});
    } else if (name == "direct.hlb") {
      (void)compress_stack(made_source(stack(), 0), file, {.basis = BasisKind::direct});
    } else {
      FAIL() << "no file is named " << name;
    }
  }

  static inline std::unique_ptr<test::TemporaryFolder> shared_folder;
};

LightWeights one_light(int k) {
  LightWeights w = LightWeights::Zero(kLights, 1);
  w(k, 0) = 1.0;
  return w;
}

LightWeights nine_lights() {
  LightWeights w = LightWeights::Zero(kLights, 1);
  for (const int k : {18, 24, 29, 130, 136, 141, 226, 232, 237}) {
    w(k, 0) = 1.0;
  }
  return w;
}

/// A sky with one sun: high frequency, 10^4 to 1.
LightWeights random_weights(std::uint64_t seed, int colours = 1) {
  LightWeights w(kLights, colours);
  for (int k = 0; k < kLights; ++k) {
    for (int c = 0; c < colours; ++c) {
      w(k, c) = std::pow(uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k),
                                               static_cast<std::uint64_t>(c))),
                         8.0);
    }
  }
  return w;
}

double peak_of(const Image<float>& image) {
  double peak = 0.0;
  for (const float v : image.pixels()) {
    peak = std::max(peak, std::abs(double{v}));
  }
  return peak;
}

TEST_F(Relight, ExactModeIsLinearTo1e6OfThePeak) {
  for (const std::string& name : names()) {
    const BasisFile basis = open(name);
    const LightWeights a = random_weights(1);
    const LightWeights b = nine_lights();
    const Image<float> of_a = relight(basis, a).picture;
    const Image<float> of_b = relight(basis, b).picture;
    const Image<float> of_sum = relight(basis, LightWeights(a + b)).picture;
    const double peak = peak_of(of_sum);
    for (std::size_t i = 0; i < of_sum.pixels().size(); ++i) {
      ASSERT_LE(std::abs(double{of_sum.pixels()[i]} -
                         (double{of_a.pixels()[i]} + double{of_b.pixels()[i]})),
                1e-6 * peak)
          << name;
    }
  }
}

TEST_F(Relight, OneLightGivesItsPictureWithinTheStatedError) {
  for (const std::string& name : names()) {
    const BasisFile basis = open(name);
    for (const int k : {0, 100, 255}) {
      const RelitPicture relit = relight(basis, one_light(k));
      const Image<float> truth = relight_stack(stack(), one_light(k));
      const Achieved found = compare(relit.picture.pixels(), truth.pixels());
      EXPECT_LE(found.relative_l2, relit.bound.relative_l2 + 1e-7) << name;
      const auto light = static_cast<std::size_t>(k);
      const double stated = double{basis.tables().light_errors[light]} /
                            double{basis.tables().light_norms[light]};
      EXPECT_LE(found.relative_l2, stated + 1e-7) << name;
      EXPECT_LE(compare(relight_stack(BasisSource(basis), one_light(k)).pixels(),
                        relit.picture.pixels())
                    .relative_l2,
                1e-6);
    }
  }
}

TEST_F(Relight, LosslessFileGivesTheStacksOwnPicture) {
  const BasisFile basis = open("exact.hlb");
  for (const LightWeights& w : {one_light(77), nine_lights(), random_weights(5)}) {
    const RelitPicture relit = relight(basis, w);
    EXPECT_EQ(relit.bound.relative_l2, 0.0);
    EXPECT_LE(compare(relit.picture.pixels(), relight_stack(stack(), w).pixels()).worst_pixel,
              1e-7);
  }
}

TEST_F(Relight, OneLightIsAtMostThirteenTermsOf16x16) {
  // 1 + 3 log2(n): the mean, then three details per level.
  EXPECT_LE(relight(open("fine.hlb"), one_light(100)).terms, 13);
  EXPECT_LE(relight(open("exact.hlb"), one_light(100)).terms_all, 13);
}

TEST_F(Relight, BoundHoldsForEveryNumberOfTerms) {
  for (const std::string& name : names()) {
    const BasisFile basis = open(name);
    for (const LightWeights& w : {nine_lights(), random_weights(3)}) {
      const Image<float> truth = relight_stack(stack(), w);
      double energy = 0.0;
      for (const float v : truth.pixels()) {
        energy += double{v} * double{v};
      }
      for (const int terms : {0, 1, 4, 16, 64, 256, 1024}) {
        const RelitPicture relit = relight(basis, w, {.terms = terms});
        EXPECT_LE(relit.terms, terms);
        const double error =
            compare(relit.picture.pixels(), truth.pixels()).relative_l2 * std::sqrt(energy);
        EXPECT_LE(error, (relit.bound.dropped + relit.bound.coded) * (1.0 + 1e-6) +
                             1e-6 * std::sqrt(energy))
            << name << ' ' << terms;
      }
    }
  }
}

TEST_F(Relight, MaxErrorIsAPromise) {
  for (const std::string& name : {std::string("fine.hlb"), std::string("exact.hlb")}) {
    const BasisFile basis = open(name);
    for (std::uint64_t seed = 0; seed < 25; ++seed) {
      const LightWeights w = seed == 0 ? nine_lights() : random_weights(seed);
      const Image<float> truth = relight_stack(stack(), w);
      for (const double requested : {0.05, 0.01}) {
        const RelitPicture relit = relight(basis, w, {.max_error = requested});
        EXPECT_LE(relit.bound.relative_l2, requested);
        EXPECT_LE(compare(relit.picture.pixels(), truth.pixels()).relative_l2, requested);
      }
    }
  }
}

TEST_F(Relight, MaxErrorTakesFewerTermsThanAll) {
  const RelitPicture relit = relight(open("fine.hlb"), random_weights(4), {.max_error = 0.05});
  EXPECT_LT(relit.terms, relit.terms_all / 2);
}

TEST_F(Relight, MaxErrorZeroTakesEveryTermOfAnExactFile) {
  const RelitPicture relit = relight(open("exact.hlb"), nine_lights(), {.max_error = 0.0});
  EXPECT_EQ(relit.bound.relative_l2, 0.0);
  EXPECT_EQ(relit.terms, relit.terms_all);
  // Of a file with an error of its own it cannot be promised, and that is said.
  EXPECT_GT(relight(open("fine.hlb"), nine_lights(), {.max_error = 0.0}).bound.relative_l2,
            0.0);
}

TEST_F(Relight, NoTermIsTheUnshadowedPictureAndMoreThanAllIsAll) {
  const BasisFile with_plate = open("plate.hlb");
  const RelitPicture none = relight(with_plate, nine_lights(), {.terms = 0});
  EXPECT_EQ(none.terms, 0);
  // The plate part alone: the ball's shadows are missing, the rest is the ground's own light.
  const Image<float> ground = relight_stack(make_stack({.has_sphere = false}), nine_lights());
  EXPECT_NEAR(double{none.picture(35, 39)} / double{ground(35, 39)}, 1.0, 0.02);
  // Without a clean plate nothing is left.
  EXPECT_THAT(relight(open("percent.hlb"), nine_lights(), {.terms = 0}).picture.pixels(),
              testing::Each(0.0F));
  const RelitPicture all = relight(with_plate, nine_lights());
  const RelitPicture more = relight(with_plate, nine_lights(), {.terms = 1024});
  EXPECT_EQ(more.terms, all.terms_all);
  EXPECT_TRUE(std::equal(all.picture.pixels().begin(), all.picture.pixels().end(),
                         more.picture.pixels().begin()));
}

TEST_F(Relight, MaxErrorBelowTheFilesOwnErrorIsSaidNotHidden) {
  const RelitPicture relit = relight(open("percent.hlb"), nine_lights(), {.max_error = 1e-6});
  EXPECT_GT(relit.bound.relative_l2, 1e-6);
  EXPECT_EQ(relit.terms, relit.terms_all);
}

TEST_F(Relight, FewLightsNeedTheTransportOrder) {
  // Five lights of 16 x 16, as nine of 32 x 32: by |l| alone the 15 finest details (1/2 each),
  // which carry little, come before the mean (5/16).
  LightWeights w = LightWeights::Zero(kLights, 1);
  for (const int k : {18, 29, 130, 226, 237}) {
    w(k, 0) = 1.0;
  }
  const BasisFile basis = open("exact.hlb");
  const Image<float> truth = relight_stack(stack(), w);
  const auto error = [&](TermOrder order) {
    return compare(relight(basis, w, {.terms = 15, .order = order}).picture.pixels(),
                   truth.pixels())
        .relative_l2;
  };
  EXPECT_GT(error(TermOrder::light), 0.7);
  EXPECT_LT(error(TermOrder::transport), 0.1);
}

TEST_F(Relight, OneLightOfAMillionScales) {
  const BasisFile basis = open("fine.hlb");
  const Image<float> one = relight(basis, one_light(9)).picture;
  const Image<float> million = relight(basis, LightWeights(1e6 * one_light(9))).picture;
  for (std::size_t i = 0; i < one.pixels().size(); ++i) {
    EXPECT_NEAR(double{million.pixels()[i]}, 1e6 * double{one.pixels()[i]},
                1e6 * 1.2e-7 * std::abs(double{one.pixels()[i]}) + 1e-30);
  }
}

TEST_F(Relight, SameBitsWithOneTwoSevenThreads) {
  for (const std::string& name : names()) {
    const BasisFile basis = open(name);
    std::vector<float> first;
    for (const int threads : {1, 2, 7}) {
      const ThreadLimit limit(threads);
      const Image<float> picture = relight(basis, random_weights(8, 3)).picture;
      if (first.empty()) {
        first.assign(picture.pixels().begin(), picture.pixels().end());
      }
      EXPECT_TRUE(std::equal(first.begin(), first.end(), picture.pixels().begin())) << name;
    }
  }
}

TEST_F(Relight, BatchGivesTheSamePicturesInOnePass) {
  const BasisFile basis = open("plate.hlb");
  const std::vector<LightWeights> weights = {nine_lights(), random_weights(2, 3), one_light(4)};
  const std::vector<RelitPicture> batch = relight(basis, std::span(weights));
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const RelitPicture alone = relight(basis, weights[i]);
    EXPECT_TRUE(std::equal(alone.picture.pixels().begin(), alone.picture.pixels().end(),
                           batch[i].picture.pixels().begin()));
    EXPECT_EQ(alone.terms, batch[i].terms);
  }
}

TEST_F(Relight, WrongWeightsAreRefused) {
  const BasisFile basis = open("plate.hlb");
  EXPECT_THROW((void)relight(basis, LightWeights::Zero(100, 1)), Error);
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    EXPECT_THROW((void)relight(basis, LightWeights(bad * one_light(3))), ContractViolation);
  }
}

TEST(WeightList, WordsNameLightsAndWeights) {
  const auto w = weights_from_words({"3", "5=0.5,7=-2", "3=1e-1"}, 8);
  EXPECT_EQ(w(3, 0), 1.1);
  EXPECT_EQ(w(5, 0), 0.5);
  EXPECT_EQ(w(7, 0), -2.0);
  for (const char* bad :
       {"", "x", "3=", "3=y", "8", "-1", "3,", "1e1", "3=inf", "3=nan", "3=1e21"}) {
    EXPECT_THROW((void)weights_from_words({bad}, 8), Error) << bad;
  }
}

TEST(WeightList, JsonHoldsOneNumberOrThreeALight) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "weights.json";
  const auto write = [&](const std::string& text) { std::ofstream(file) << text; };
  write("[[1, 2], [3, 4]]");
  EXPECT_EQ(weights_from_json(file, 4)(2, 0), 3.0);
  write("[[1, 2, 3], [4, 5, 6]]");
  EXPECT_EQ(weights_from_json(file, 2)(1, 2), 6.0);
  for (const char* bad : {"", "{}", "[1, 2]", "[1, 2, \"3\"]", "[1e999, 0, 0, 0]",
                          "[1e21, 0, 0, 0]", "[null,1,1,1]"}) {
    write(bad);
    EXPECT_THROW((void)weights_from_json(file, 4), Error) << bad;
  }
}

}  // namespace
}  // namespace haarlight::relight
