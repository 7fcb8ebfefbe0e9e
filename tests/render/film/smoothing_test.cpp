// SPDX-License-Identifier: Apache-2.0
/// @file
/// Filters of rendered pictures: what they keep, and what they take away.

#include "render/film/smoothing.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "render/film/no_depth.h"

namespace haarlight::render {
namespace {

constexpr std::array kKinds{SmoothingKind::low_pass, SmoothingKind::median,
                            SmoothingKind::features};

/// A left half of albedo 0.2 and a right one of 0.8, a slanted floor below and nothing above, under even
/// light with noise of a tenth.
struct Rendered {
  Rendered(int height, int width, float unit = 1.0F)
      : truth(height, width, 3),
        noisy(height, width, 3),
        albedo(height, width, 3),
        normal(height, width, 3),
        depth(height, width, 1),
        error(height, width, 3) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const bool is_seen = 3 * y >= height;
        depth(y, x) =
            is_seen ? 1000.0F - 5.0F * static_cast<float>(y) : static_cast<float>(kNoDepth);
        for (int c = 0; c < 3; ++c) {
          const auto key = static_cast<std::uint64_t>(std::int64_t{y * width + x} * 3 + c);
          albedo(y, x, c) = is_seen ? (2 * x < width ? 0.2F : 0.8F) : 0.0F;
          normal(y, x, c) = is_seen && c == 2 ? 1.0F : 0.0F;
          truth(y, x, c) = unit * albedo(y, x, c);
          error(y, x, c) = 0.1F * truth(y, x, c);
          noisy(y, x, c) = truth(y, x, c) +
                           error(y, x, c) * static_cast<float>(standard_normal(hash_key(key)));
        }
      }
    }
  }
  [[nodiscard]] PictureFeatures features() const {
    return {.albedo = albedo.view(),
            .normal = normal.view(),
            .depth = depth.view(),
            .error = error.view()};
  }
  [[nodiscard]] Image<float> smoothed(SmoothingKind kind) const {
    return smooth(noisy.view(), features(), {.kind = kind});
  }

  Image<float> truth;
  Image<float> noisy;
  Image<float> albedo;
  Image<float> normal;
  Image<float> depth;
  Image<float> error;
};

double sum_of(const Image<float>& picture, int channel) {
  double sum = 0.0;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      sum += picture(y, x, channel);
    }
  }
  return sum;
}

double rmse(const Image<float>& a, const Image<float>& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.pixels().size(); ++i) {
    sum += std::pow(double{a.pixels()[i]} - b.pixels()[i], 2);
  }
  return std::sqrt(sum / static_cast<double>(a.pixels().size()));
}

/// To 1e-6, the rounding of floats; of pictures down to one pixel, and of any unit.
TEST(Smoothing, KeepsTheSumOfEachChannel) {
  for (const auto& [height, width] : {std::pair{1, 1}, {1, 7}, {9, 1}, {2, 2}, {31, 23}}) {
    for (const float unit : {1e-20F, 1.0F, 1e20F}) {
      const Rendered rendered(height, width, unit);
      for (const SmoothingKind kind : kKinds) {
        const Image<float> smoothed = rendered.smoothed(kind);
        for (int c = 0; c < 3; ++c) {
          const double sum = sum_of(rendered.noisy, c);
          EXPECT_NEAR(sum_of(smoothed, c), sum, 1e-6 * std::abs(sum))
              << to_string(kind) << ' ' << height << " x " << width << ", unit " << unit;
        }
        for (const float value : smoothed.pixels()) {
          ASSERT_TRUE(std::isfinite(value));
        }
      }
    }
  }
}

TEST(Smoothing, APictureOfOneValueStaysAsItIs) {
  Rendered rendered(13, 17);
  std::ranges::fill(rendered.noisy.pixels(), 0.7F);
  for (const SmoothingKind kind : kKinds) {
    const Image<float> smoothed = rendered.smoothed(kind);
    for (const float value : smoothed.pixels()) {
      EXPECT_NEAR(value, 0.7F, 1e-7F) << to_string(kind);
    }
  }
}

TEST(Smoothing, LowPassIsTheMeanOfNine) {
  const Rendered rendered(9, 8);
  const Image<float> smoothed = rendered.smoothed(SmoothingKind::low_pass);
  for (int y = 2; y < 7; ++y) {
    for (int x = 2; x < 6; ++x) {
      double mean = 0.0;
      for (int v = y - 1; v <= y + 1; ++v) {
        for (int u = x - 1; u <= x + 1; ++u) {
          mean += rendered.noisy(v, u, 1) / 9.0;
        }
      }
      EXPECT_NEAR(smoothed(y, x, 1), mean, 1e-6);
    }
  }
}

/// A median alone would take it away.
TEST(Smoothing, OfOneBrightPixelTheMedianSpreadsAllOverNine) {
  Image<float> picture(9, 9, 1);
  std::ranges::fill(picture.pixels(), 1.0F);
  picture(4, 4) = 91.0F;
  const Image<float> smoothed = smooth(picture.view(), {}, {.kind = SmoothingKind::median});
  for (int y = 0; y < 9; ++y) {
    for (int x = 0; x < 9; ++x) {
      const bool is_near = std::abs(y - 4) <= 1 && std::abs(x - 4) <= 1;
      EXPECT_NEAR(smoothed(y, x), is_near ? 11.0F : 1.0F, 1e-5F) << y << ' ' << x;
    }
  }
}

/// Edges of what is seen are not crossed: 11 x 11 pixels part noise by more than 3, which the mean of 3 x 3
/// does not even reach within one surface. The other two smear the edge, by half of its height.
TEST(Smoothing, FeaturesTakeNoiseAndLeaveEdges) {
  const Rendered rendered(48, 48);
  const double before = rmse(rendered.noisy, rendered.truth);
  for (const SmoothingKind kind : kKinds) {
    const Image<float> smoothed = rendered.smoothed(kind);
    const double after = rmse(smoothed, rendered.truth);
    std::printf("%s: RMSE %.4f, before %.4f\n", std::string(to_string(kind)).c_str(), after,
                before);
    if (kind == SmoothingKind::features) {
      EXPECT_LE(after, before / 3.0);
      for (int y = 0; y < 48;
           ++y) {  // nothing is mixed with what is not seen, or of another albedo
        EXPECT_NEAR(smoothed(y, 24), rendered.truth(y, 24), 0.1);
      }
    } else {
      EXPECT_GE(after, 0.02);
    }
  }
}

TEST(Smoothing, TheSameForAnyNumberOfThreads) {
  const Rendered rendered(40, 31);
  for (const SmoothingKind kind : kKinds) {
    std::vector<std::vector<float>> pictures;
    for (const int threads : {1, 2, 7}) {
      const ThreadLimit limit(threads);
      const Image<float> picture = rendered.smoothed(kind);
      pictures.emplace_back(picture.pixels().begin(), picture.pixels().end());
    }
    EXPECT_EQ(pictures[0], pictures[1]);
    EXPECT_EQ(pictures[0], pictures[2]);
  }
}

}  // namespace
}  // namespace haarlight::render
