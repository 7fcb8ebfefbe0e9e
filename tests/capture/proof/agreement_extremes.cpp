// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "capture/proof/picture_agreement.h"
#include "tests/extremes.h"

namespace haarlight::capture {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::stated;

EXTREMES_OF(agreement, "capture/proof", "two pictures of the same light: `PictureAgreement`")

/// Every light once, then once more beginning in the middle, so that others precede it.
std::vector<int> order_of(int n) {
  std::vector<int> lights;
  for (int k = 0; k < n; ++k) {
    lights.push_back(k);
  }
  for (int k = 0; k < n; ++k) {
    lights.push_back((n / 2 - 1 - k + n) % n);
  }
  return lights;
}

/// What light k gives at point i, 0.5 .. 1.5.
PointValues picture_of(int k) {
  PointValues values;
  for (int i = 0; i < kProofPoints; ++i) {
    values[i] = 1.0 + 0.5 * std::sin(2.4 * k + 0.11 * i * (1.0 + 0.31 * (k % 7)));
  }
  return values;
}

/// A run without noise in its pictures, whose noise is stated as 2e-3 of them.
struct Outcome {
  int n_agreed = 0;
  int n_doubted = 0;
  double most_hidden = 0.0;  ///< largest other_fraction of those that agree
};
Outcome run(int n_lights, const std::function<void(int shot, PointSamples&)>& change,
            const std::function<PointValues(int)>& picture = picture_of) {
  const std::vector<int> order = order_of(n_lights);
  Plan plan;
  plan.n_lights = n_lights;
  for (const int k : order) {
    plan.shots.push_back(session::Shot{static_cast<int>(plan.shots.size()),
                                       session::ShotKind::light,
                                       {session::LightLevel{.light = k, .level = 65535}},
                                       1000.0});
  }
  PictureAgreement agreement(plan);
  Outcome outcome;
  for (int shot = 0; shot < 2 * n_lights; ++shot) {
    PointSamples samples;
    samples.mean = picture(order[static_cast<std::size_t>(shot)]);
    samples.noise = PointValues::Constant(4e-6);
    samples.is_good.setConstant(true);
    change(shot, samples);
    const AgreementFinding found =
        agreement.take(shot, samples, 1'000'000'000 + std::int64_t{20'000'000} * shot);
    EXPECT_TRUE(found.other_fraction >= 0.0 && found.other_fraction <= 1.0);
    outcome.n_doubted += static_cast<int>(found.doubted.size());
    if (found.agrees_with >= 0) {
      ++outcome.n_agreed;
      outcome.most_hidden = std::max(outcome.most_hidden, found.other_fraction);
    }
  }
  return outcome;
}
const auto kAsItIs = [](int, PointSamples&) {};

EXTREME(agreement, dark) {
  const Outcome black = run(16, [](int, PointSamples& s) { s.mean.setZero(); });
  EXPECT_EQ(black.n_doubted, 0);
  const Outcome all = run(16, [](int shot, PointSamples& s) {
    if (shot == 20) {
      s.mean.setZero();
    }
  });
  EXPECT_GT(all.n_doubted, 0);
  return stated(
      "all pictures black: nothing is doubted; one black among bright ones is taken again");
}
EXTREME(agreement, one) {
  const Outcome found = run(1, kAsItIs);
  EXPECT_EQ(found.n_doubted, 0);
  EXPECT_EQ(found.n_agreed, 0);
  return stated("one light alone: nothing to compare with, nothing is doubted");
}
EXTREME(agreement, largest) {
  const Outcome found = run(256, kAsItIs);
  EXPECT_EQ(found.n_doubted, 0);
  EXPECT_EQ(found.n_agreed, 256);
  return bounded(found.most_hidden, 0.2, "256 lights: hidden light at most",
                 "noise of 2e-3 in each of 64 points");
}
EXTREME(agreement, odd_size) {
  const Outcome found = run(13, kAsItIs);
  EXPECT_EQ(found.n_doubted, 0);
  return bounded(found.most_hidden, 0.2, "13 lights: hidden light at most",
                 "noise of 2e-3 in each of 64 points");
}
EXTREME(agreement, scale) {
  double worst = 0.0;
  for (const double scale : {1e-15, 1e15}) {
    const Outcome found = run(16, [scale](int, PointSamples& s) {
      s.mean *= scale;
      s.noise *= scale * scale;
    });
    EXPECT_EQ(found.n_doubted, 0);
    EXPECT_EQ(found.n_agreed, 16);
    worst = std::max(worst, found.most_hidden);
  }
  return bounded(worst, 0.2, "values of 1e±15: hidden light at most",
                 "noise of 2e-3 in each of 64 points");
}
NO_EXTREME(agreement, subnormal, "counts per microsecond")
NO_EXTREME(agreement, not_finite, "means of whole counts")
EXTREME(agreement, degenerate) {
  // Every light gives the same picture: no frame can tell them apart.
  const Outcome found = run(16, kAsItIs, [](int) { return picture_of(3); });
  EXPECT_EQ(found.n_agreed, 0);
  return stated("all lights give one picture: none is proven by another");
}
NO_EXTREME(agreement, grazing, "it knows no geometry")
NO_EXTREME(agreement, far_near, "it knows no geometry")
EXTREME(agreement, duplicate) {
  const Outcome found = run(16, kAsItIs, [](int k) { return picture_of(k == 9 ? 4 : k); });
  EXPECT_GT(found.n_agreed, 10);
  return stated("two lights of one picture: the others are proven");
}
EXTREME(agreement, clipped) {
  const Outcome found = run(16, [](int, PointSamples& s) { s.is_good.setConstant(false); });
  EXPECT_EQ(found.n_agreed, 0);
  const Outcome half = run(16, [](int, PointSamples& s) {
    for (int i = 0; i < kProofPoints; i += 2) {
      s.is_good[i] = false;
      s.mean[i] = kClippedPoint;
    }
  });
  EXPECT_EQ(half.n_doubted, 0);
  EXPECT_EQ(half.n_agreed, 16);
  return both(stated("every point clipped: no frame proves another"),
              bounded(half.most_hidden, 0.3, "every second point clipped: hidden light at most",
                      "noise of 2e-3 in each of 32 points"));
}

}  // namespace
}  // namespace haarlight::capture
