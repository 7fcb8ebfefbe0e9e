// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/photometric_stereo.h"

#include <atomic>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::degrees_between;
using testing::dome_directions;
using testing::far_capture;
using testing::far_lights;
using testing::kMethods;
using testing::MadeSurface;
using testing::vector_at;
using testing::with;

constexpr int kSize = 12;

/// A bowl whose normals lie within 35 degrees of z.
Vector3d bowl_normal(int y, int x) {
  return Vector3d(0.05 * (x - 5.5), 0.05 * (5.5 - y), 1.0).normalized();
}

MadeSurface bowl() {
  return {[](int, int) { return Vector3d(Vector3d::Zero()); }, bowl_normal,
          [](int c) { return 0.2 + 0.3 * c; }};
}

TEST(PhotometricStereo, AnExactCaptureGivesNormalsAndAlbedoBack) {
  const StereoLights lights = far_lights(20);
  const MemoryStack stack = far_capture(kSize, kSize, 3, lights.directions, bowl());
  for (const LambertMethod method : kMethods) {
    const SurfaceEstimate found = photometric_stereo(stack, lights, {}, {}, with(method));
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        ASSERT_EQ(found.state(y, x), static_cast<int>(PixelState::good));
        // Samples in float: 6e-8 of each.
        EXPECT_LT(degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x)), 2e-5);
        for (int c = 0; c < 3; ++c) {
          EXPECT_NEAR(found.albedo(y, x, c), 0.2 + 0.3 * c, 1e-6);
        }
        EXPECT_LT(found.error(y, x), 1e-6);
      }
    }
  }
}

TEST(PhotometricStereo, TurnedLightsTurnTheNormals) {
  StereoLights lights = far_lights(15);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  // Not Lambertian, so that the fit has residuals to get wrong.
  for (int k = 0; k < 15; ++k) {
    stack.at(0, 4, 4, k) +=
        static_cast<float>(0.1 * uniform_unit(hash_key(3, static_cast<std::uint64_t>(k))));
  }
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(1.1, Vector3d(0.3, -0.5, 0.8).normalized()).toRotationMatrix();
  for (const LambertMethod method : kMethods) {
    const SurfaceEstimate before = photometric_stereo(stack, lights, {}, {}, with(method));
    StereoLights turned = lights;
    for (Vector3d& direction : turned.directions) {
      direction = turn * direction;
    }
    const SurfaceEstimate after = photometric_stereo(stack, turned, {}, {}, with(method));
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        EXPECT_LT(
            (turn * vector_at(before.normal, y, x) - vector_at(after.normal, y, x)).norm(),
            1e-6);
      }
    }
  }
}

TEST(PhotometricStereo, BrighterLightsChangeTheAlbedoOnly) {
  StereoLights lights = far_lights(15);
  const MemoryStack stack = far_capture(kSize, kSize, 3, lights.directions, bowl());
  const SurfaceEstimate one = photometric_stereo(stack, lights, {}, {});
  lights.powers.assign(15, Vector3d(2.0, 4.0, 0.5));
  const SurfaceEstimate other = photometric_stereo(stack, lights, {}, {});
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      EXPECT_LT(degrees_between(vector_at(one.normal, y, x), vector_at(other.normal, y, x)),
                2e-5);
      EXPECT_NEAR(other.albedo(y, x, 0), one.albedo(y, x, 0) / 2.0, 1e-6);
      EXPECT_NEAR(other.albedo(y, x, 1), one.albedo(y, x, 1) / 4.0, 1e-6);
      EXPECT_NEAR(other.albedo(y, x, 2), one.albedo(y, x, 2) / 0.5, 1e-5);
    }
  }
}

TEST(PhotometricStereo, ShadowsAndHighlightsDoNotMoveTheRobustFits) {
  const StereoLights lights = far_lights(30);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < 30; ++k) {  // 3 highlights and 5 cast shadows each
        const std::uint64_t dice =
            hash_key(hash_key(7, static_cast<std::uint64_t>(y)), static_cast<std::uint64_t>(x),
                     static_cast<std::uint64_t>(k)) %
            30;
        if (dice < 3) {
          stack.at(0, y, x, k) += 1.0F;
        } else if (dice < 8) {
          stack.at(0, y, x, k) *= 0.3F;  // with some stray light: not black
        }
      }
    }
  }
  const auto mean_error = [&](LambertMethod method) {
    const SurfaceEstimate found = photometric_stereo(stack, lights, {}, {}, with(method));
    double sum = 0.0;
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        sum += degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x));
      }
    }
    return sum / (kSize * kSize);
  };
  const double plain = mean_error(LambertMethod::least_squares);
  const double trimmed = mean_error(LambertMethod::trimmed);
  const double estimated = mean_error(LambertMethod::m_estimator);
  std::printf("outliers: least squares %.2f, trimmed %.3f, M-estimator %.3f degrees\n", plain,
              trimmed, estimated);
  EXPECT_GT(plain, 5.0);
  EXPECT_LT(trimmed, 0.3);
  EXPECT_LT(estimated, 1.0);
}

/// Counts the pixels that are requested.
class CountingStack final : public StackSource {
 public:
  explicit CountingStack(const MemoryStack& stack) : stack_(stack) {}
  [[nodiscard]] StackDims dims() const override { return stack_.dims(); }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    n_read_ += rect.n_pixels();
    stack_.read_tile(rect, out);
  }
  [[nodiscard]] int n_read() const { return n_read_; }

 private:
  const MemoryStack& stack_;
  mutable std::atomic<int> n_read_{0};
};

TEST(LambertFitter, TrimsTheWorstByRankWhateverTheNumberOfLights) {
  for (const int n : {10, 37, 200, 1000}) {
    for (const double keep : {0.6, 0.83}) {
      LambertFitter fitter(n, {.keep = keep});
      const std::vector<Vector3d> lights = dome_directions(n);
      const Vector3d b(0.1, -0.05, 0.7);
      for (int k = 0; k < n; ++k) {
        const double noise = uniform_unit(hash_key(5, static_cast<std::uint64_t>(k))) - 0.5;
        fitter.add(lights[static_cast<std::size_t>(k)],
                   b.dot(lights[static_cast<std::size_t>(k)]) + 0.01 * noise, k);
      }
      const LambertFit fit = fitter.fit();
      ASSERT_EQ(fit.state, PixelState::good);
      EXPECT_EQ(fit.n_used, std::max(6, static_cast<int>(std::ceil(keep * n)))) << n;
      double worst_kept = 0.0;
      double best_left = 1.0;
      for (int i = 0; i < fitter.n_samples(); ++i) {
        const Vector3d s = fitter.direction(i);
        const double noise =
            uniform_unit(hash_key(5, static_cast<std::uint64_t>(fitter.light(i)))) - 0.5;
        const double residual = std::abs((b - fit.b).dot(s) + 0.01 * noise);
        if (fitter.weight(i) > 0.0) {
          worst_kept = std::max(worst_kept, residual);
        } else {
          best_left = std::min(best_left, residual);
        }
      }
      // The last step moved b by at most 1e-4 of itself.
      EXPECT_LT(worst_kept, best_left + 2e-4 * fit.b.norm()) << n;
    }
  }
}

TEST(LambertFitter, EqualSamplesAndBlackOnesAreRankedToo) {
  LambertFitter fitter(400, {.keep = 0.8});  // part of a hundred equal residuals: all of them
  for (int k = 0; k < 400; ++k) {
    // Three directions, each a hundred times, and a hundred samples at or below 0.
    const Vector3d s =
        Vector3d(k % 4 == 0 ? 0.5 : 0.0, k % 4 == 1 ? 0.5 : 0.0, 0.8).normalized();
    fitter.add(s, k % 4 == 3 ? -0.01 * (k % 8) : 0.3 * s.z(), k);
  }
  const LambertFit fit = fitter.fit();
  ASSERT_EQ(fit.state, PixelState::good);
  EXPECT_EQ(fitter.n_samples(), 300);
  EXPECT_LT((fit.b - Vector3d(0.0, 0.0, 0.3)).norm(), 1e-12);
}

/// Sums of vectors have ends that are not full, and pixels may have hardly a sample.
TEST(LambertFitter, EverySampleCountsWhateverTheirNumber) {
  const Vector3d b(0.1, -0.05, 0.7);
  for (int n = 0; n <= 35; ++n) {
    const std::vector<Vector3d> lights = dome_directions(std::max(n, 1));
    LambertFitter fitter(n, {.method = LambertMethod::least_squares, .dark_fraction = 0.0});
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Vector3d right = Vector3d::Zero();
    std::vector<double> values;
    for (int k = 0; k < n; ++k) {
      const Vector3d& s = lights[static_cast<std::size_t>(k)];
      values.push_back(b.dot(s) +
                       0.1 * uniform_unit(hash_key(7, static_cast<std::uint64_t>(k))));
      fitter.add(s, values.back(), k);
      matrix += s * s.transpose();
      right += values.back() * s;
    }
    const LambertFit fit = fitter.fit();
    if (n < 3) {
      EXPECT_EQ(fit.state, PixelState::too_dark);
      continue;
    }
    ASSERT_EQ(fit.state, PixelState::good) << n;
    EXPECT_EQ(fit.n_used, n);
    const Vector3d truth = matrix.inverse() * right;
    EXPECT_LT((fit.b - truth).norm(), 1e-11) << n;
    double square = 0.0;
    for (int k = 0; k < n; ++k) {
      square += std::pow(
          values[static_cast<std::size_t>(k)] - truth.dot(lights[static_cast<std::size_t>(k)]),
          2);
    }
    EXPECT_NEAR(fit.error, std::sqrt(square / n) / truth.norm(), 1e-9) << n;
  }
}

/// Samples that are left out, wherever they stand, are as if they had never been.
TEST(PhotometricStereo, ClippedSamplesAreAsIfTheirLightsHadNotBeen) {
  constexpr float kClipped = 5.0F;
  for (const int n : {6, 13, 24, 37}) {
    const StereoLights lights = far_lights(n);
    MemoryStack stack = far_capture(kSize, kSize, 3, lights.directions, bowl());
    std::vector<int> left;
    for (int k = 0; k < n; ++k) {
      if (k == 0 || k == n - 1 || k % 5 == 2) {
        for (int y = 0; y < kSize; ++y) {
          for (int x = 0; x < kSize; ++x) {
            stack.at(1, y, x, k) = kClipped;
          }
        }
      } else {
        left.push_back(k);
      }
    }
    for (const LambertMethod method : kMethods) {
      StereoOptions options = with(method);
      options.saturation.assign(static_cast<std::size_t>(n), kClipped);
      const SurfaceEstimate found = photometric_stereo(stack, lights, {}, {}, options);
      options.saturation.clear();
      options.use = left;
      const SurfaceEstimate without = photometric_stereo(stack, lights, {}, {}, options);
      EXPECT_EQ(found.n_in(PixelState::good), kSize * kSize) << n;
      EXPECT_THAT(found.normal.pixels(), ::testing::ElementsAreArray(without.normal.pixels()));
      EXPECT_THAT(found.albedo.pixels(), ::testing::ElementsAreArray(without.albedo.pixels()));
      EXPECT_THAT(found.error.pixels(), ::testing::ElementsAreArray(without.error.pixels()));
    }
  }
  // Every sample of every pixel: no normal, and it is said why.
  const StereoLights lights = far_lights(11);
  const MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  StereoOptions options;
  options.saturation.assign(11, 0.0F);
  const SurfaceEstimate none = photometric_stereo(stack, lights, {}, {}, options);
  EXPECT_EQ(none.n_in(PixelState::saturated), kSize * kSize);
}

TEST(PhotometricStereo, MaskedPixelsAreNotReadAndTheOthersKeepTheirBits) {
  const StereoLights lights = far_lights(9);
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, bowl());
  Image<std::uint8_t> mask(kSize, kSize, 1);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      mask(y, x) = y >= 3 && y < 8 && x >= 2 && x < 6 ? 1 : 0;
      if (mask(y, x) == 0) {
        stack.at(0, y, x, 0) = std::numeric_limits<float>::quiet_NaN();
      }
    }
  }
  const MemoryStack clean = far_capture(kSize, kSize, 1, lights.directions, bowl());
  const SurfaceEstimate whole = photometric_stereo(clean, lights, {}, {});
  const CountingStack counted(stack);
  const SurfaceEstimate part = photometric_stereo(counted, lights, {}, mask.view());
  EXPECT_EQ(counted.n_read(), 20);
  EXPECT_EQ(part.n_in(PixelState::good), 20);
  EXPECT_EQ(part.n_in(PixelState::masked), kSize * kSize - 20);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(part.normal(y, x, c), mask(y, x) != 0 ? whole.normal(y, x, c) : 0.0F);
      }
      EXPECT_EQ(part.albedo(y, x), mask(y, x) != 0 ? whole.albedo(y, x) : 0.0F);
    }
  }
}

/// Channels with gains of their own end at values of their own.
TEST(PhotometricStereo, EveryChannelMayHaveItsOwnClipLevel) {
  const StereoLights lights = far_lights(8);
  MemoryStack stack({1, 1, 3, 8});
  for (int c = 0; c < 3; ++c) {
    MemoryStack grey = far_capture(1, 1, 1, lights.directions, bowl());
    for (int k = 0; k < 8; ++k) {
      stack.at(c, 0, 0, k) = static_cast<float>(c + 1) * grey.at(0, 0, 0, k);
    }
  }
  const float top = 1.01F * stack.at(0, 0, 0, 0);
  StereoOptions options = with(LambertMethod::least_squares);
  options.saturation.assign(24, 100.0F);
  const SurfaceEstimate all = photometric_stereo(stack, lights, {}, {}, options);
  for (int c = 0; c < 3; ++c) {  // of light 0 each channel just below its end: nothing changes
    options.saturation[8 * static_cast<std::size_t>(c)] = static_cast<float>(c + 1) * top;
  }
  const SurfaceEstimate below = photometric_stereo(stack, lights, {}, {}, options);
  EXPECT_EQ(below.n_used(0, 0), all.n_used(0, 0));
  options.saturation[8] = top;  // green's end is red's
  const SurfaceEstimate clipped = photometric_stereo(stack, lights, {}, {}, options);
  EXPECT_EQ(clipped.n_used(0, 0) + 1, all.n_used(0, 0));
}

TEST(PhotometricStereo, NearLightsWithTheirLobesAreExactAtTheirPoints) {
  StereoLights lights;
  lights.are_near = true;
  lights.near = testing::light_array(5, 120.0, 400.0, 1.7);
  const auto point = [](int y, int x) {
    return Vector3d(20.0 * x - 110, 110 - 20.0 * y, 3.0 * x);
  };
  const MemoryStack stack =
      testing::near_capture(kSize, kSize, lights.near, {point, bowl_normal});
  Image<float> points(kSize, kSize, 3);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int c = 0; c < 3; ++c) {
        points(y, x, c) = static_cast<float>(point(y, x)[c]);
      }
    }
  }
  const SurfaceEstimate found = photometric_stereo(stack, lights, points.view(), {});
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      EXPECT_LT(degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x)), 1e-4);
      EXPECT_NEAR(found.albedo(y, x), 1e6, 2.0);
    }
  }
}

TEST(PhotometricStereo, IsTheSameOnOneTwoAndSevenThreads) {
  const StereoLights lights = far_lights(11);
  MemoryStack stack = far_capture(40, 40, 1, lights.directions, bowl());
  std::vector<std::vector<float>> found;
  for (const int n : {1, 2, 7}) {
    const ThreadLimit limit(n);
    const SurfaceEstimate surface = photometric_stereo(stack, lights, {}, {});
    found.emplace_back(surface.normal.pixels().begin(), surface.normal.pixels().end());
  }
  EXPECT_EQ(found[0], found[1]);
  EXPECT_EQ(found[0], found[2]);
}

}  // namespace
}  // namespace haarlight::relight
