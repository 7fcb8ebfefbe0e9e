// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/session/develop/demosaic.h"
#include "haarlight/session/develop/develop_options.h"
#include "session/develop/merge_exposures.h"
#include "tests/extremes.h"

namespace haarlight::session {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using extremes::stated;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// ---- exposures ----

EXTREMES_OF(merge, "session/develop", "merging exposures")

/// Without noise: each exposure sees what the radiance says.
std::vector<ExposureSample> bracket(double radiance, int n, double ratio, double floor = 9.0,
                                    double clip = std::numeric_limits<double>::infinity()) {
  std::vector<ExposureSample> samples;
  double a = 1.0;
  for (int i = 0; i < n; ++i, a *= ratio) {
    samples.push_back({std::min(radiance * a, clip), a, floor, clip});
  }
  return samples;
}

double error_of(double radiance, const std::vector<ExposureSample>& samples) {
  double worst = 0.0;
  for (const MergedRadiance& merged : {merge_exposures(samples), merge_by_photons(samples)}) {
    EXPECT_TRUE(std::isfinite(merged.variance) && merged.variance >= 0.0);
    EXPECT_TRUE(std::isfinite(merged.chi_square));
    const double off = std::abs(merged.radiance / radiance - 1.0);
    worst = std::isnan(off) ? off : std::max(worst, off);
  }
  return worst;
}
constexpr const char* kOf = "consistent exposures: relative error";
constexpr const char* kWhy = "weighted means, 2^-53 per term";

EXTREME(merge, dark) {
  const MergedRadiance merged = merge_exposures(bracket(0.0, 4, 8.0));
  EXPECT_EQ(merged.radiance, 0.0);
  EXPECT_GT(merged.variance, 0.0);
  EXPECT_EQ(merge_by_photons(bracket(0.0, 4, 8.0)).radiance, 0.0);
  const double below = merge_exposures(bracket(-3.0, 4, 8.0)).radiance;
  return both(bounded(std::abs(below + 3.0), 1e-12, "3 below black: absolute error", kWhy),
              exact("0 of 0, with the variance of the floor"));
}
EXTREME(merge, one) {
  return bounded(error_of(50.0, bracket(50.0, 1, 1.0)), 1e-14,
                 std::string("one exposure: ") + kOf, "2 roundings");
}
EXTREME(merge, largest) {
  return bounded(error_of(50.0, bracket(50.0, 1000, 1.01)), 1e-12,
                 std::string("1000 exposures: ") + kOf, kWhy);
}
NO_EXTREME(merge, odd_size, "pixel by pixel")
EXTREME(merge, scale) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    worst = std::max(worst, error_of(50.0 * scale, bracket(50.0 * scale, 5, 8.0)));
    // Exposures that differ by 1e±30.
    worst = std::max(worst, error_of(50.0, bracket(50.0, 2, scale)));
  }
  return bounded(worst, 1e-12, std::string("radiance 1e±30, exposures 1e±30 apart: ") + kOf,
                 kWhy);
}
EXTREME(merge, subnormal) {
  return bounded(error_of(1e-310, bracket(1e-310, 4, 8.0)), 1e-10,
                 std::string("1e-310: ") + kOf,
                 "1e-310 has 13 digits less than a normal number");
}
EXTREME(merge, not_finite) {
  std::vector<ExposureSample> samples = bracket(50.0, 3, 8.0);
  samples[1].electrons = kNan;
  EXPECT_TRUE(std::isnan(merge_exposures(samples).radiance));
  EXPECT_TRUE(std::isnan(merge_by_photons(samples).radiance));
  return stated("NaN in, NaN out; frames are whole numbers, and light stacks refuse it");
}
NO_GEOMETRY(merge)
EXTREME(merge, duplicate) {
  const std::vector<ExposureSample> same(7, ExposureSample{50.0, 2.0, 9.0});
  const std::vector<ExposureSample> once(1, same[0]);
  EXPECT_NEAR(merge_exposures(same).variance * 7.0 / merge_exposures(once).variance, 1.0,
              1e-12);
  return bounded(
      error_of(25.0, same), 1e-14,
      std::string("the same exposure seven times, a seventh of the variance: ") + kOf, kWhy);
}
EXTREME(merge, clipped) {
  const MergedRadiance all = merge_exposures(bracket(1e6, 4, 8.0, 9.0, 16000.0));
  EXPECT_TRUE(all.is_saturated);
  EXPECT_EQ(all.n_used, 0);
  EXPECT_EQ(all.variance, 0.0);
  EXPECT_EQ(all.radiance, 16000.0);  // of the shortest, a = 1
  const std::vector<ExposureSample> some = bracket(100.0, 5, 8.0, 9.0, 16000.0);
  return both(bounded(error_of(100.0, some), 1e-12,
                      std::string("the longer ones clipped: ") + kOf, kWhy),
              stated("all clipped: the greatest lower bound, marked saturated"));
}

// ---- demosaicing ----

EXTREMES_OF(demosaic, "session/develop", "demosaicing, every method")

constexpr Demosaic kMethods[] = {Demosaic::bilinear, Demosaic::edge_aware};

Image<float> mosaic(int width, int height, double value, double tint = 0.0) {
  Image<float> image(height, width, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image(y, x) =
          static_cast<float>(value * (1.0 + tint * bayer_colour(BayerPattern::rggb, y, x)));
    }
  }
  return image;
}

/// A grey picture comes back grey; largest relative error.
double grey_error(int width, int height, double value) {
  double worst = 0.0;
  for (const Demosaic method : kMethods) {
    const Image<float> found =
        demosaic(mosaic(width, height, value).view(), BayerPattern::rggb, method);
    for (const float v : found.pixels()) {
      const double off = std::abs(double{v} / double{static_cast<float>(value)} - 1.0);
      worst = std::isnan(off) ? off : std::max(worst, off);
    }
  }
  return worst;
}
constexpr const char* kGrey = "a grey mosaic: relative error";
constexpr const char* kGreyWhy = "13 terms in float, 2^-24 each";

EXTREME(demosaic, dark) {
  for (const Demosaic method : kMethods) {
    const Image<float> found = demosaic(mosaic(8, 6, 0.0).view(), BayerPattern::rggb, method);
    EXPECT_TRUE(std::all_of(found.pixels().begin(), found.pixels().end(),
                            [](float v) { return v == 0.0F; }));
  }
  return exact("black: black");
}
EXTREME(demosaic, one) {
  return both(bounded(grey_error(2, 2, 0.5), 2e-6, std::string("2 × 2: ") + kGrey, kGreyWhy),
              refused("at least 2 x 2", [] {
                (void)demosaic(mosaic(1, 1, 0.5).view(), BayerPattern::rggb,
                               Demosaic::bilinear);
              }));
}
NO_EXTREME(demosaic, largest, "rows in bands, no limit")
EXTREME(demosaic, odd_size) {
  return bounded(
      std::max({grey_error(3, 2, 0.5), grey_error(2, 3, 0.5), grey_error(17, 31, 0.5)}), 2e-6,
      std::string("3 × 2, 2 × 3, 17 × 31: ") + kGrey, kGreyWhy);
}
EXTREME(demosaic, scale) {
  return bounded(std::max(grey_error(9, 7, 1e-30), grey_error(9, 7, 1e30)), 2e-6,
                 std::string("values of 1e±30: ") + kGrey, kGreyWhy);
}
EXTREME(demosaic, subnormal) {
  return bounded(grey_error(9, 7, 1e-40), 2e-4, std::string("values of 1e-40: ") + kGrey,
                 "13 terms rounded to 1.4e-45 each");
}
EXTREME(demosaic, not_finite) {
  for (const Demosaic method : kMethods) {
    Image<float> image = mosaic(17, 17, 0.5);
    image(8, 8) = std::numeric_limits<float>::quiet_NaN();
    const Image<float> found = demosaic(image.view(), BayerPattern::rggb, method);
    for (int y = 0; y < 17; ++y) {
      for (int x = 0; x < 17; ++x) {
        // Edge-aware: 2 pixels for green, 1 more for the colour differences.
        if (std::abs(y - 8) > 3 || std::abs(x - 8) > 3) {
          for (int c = 0; c < 3; ++c) {
            EXPECT_FALSE(std::isnan(found(y, x, c)));
          }
        }
      }
    }
  }
  return stated("NaN stays within three pixels; light stacks refuse it");
}
NO_GEOMETRY(demosaic)
EXTREME(demosaic, duplicate) {
  for (const Demosaic method : kMethods) {
    const Image<float> found =
        demosaic(mosaic(9, 8, 0.25, 1.0).view(), BayerPattern::rggb, method);
    for (int y = 0; y < 8; ++y) {
      for (int x = 0; x < 9; ++x) {
        const int own = bayer_colour(BayerPattern::rggb, y, x);
        EXPECT_EQ(found(y, x, own), 0.25F * static_cast<float>(1 + own));
      }
    }
  }
  return exact("measured samples are kept to the bit");
}
NO_EXTREME(demosaic, clipped, "merging marks the clipped before")

}  // namespace
}  // namespace haarlight::session
