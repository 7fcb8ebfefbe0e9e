// SPDX-License-Identifier: Apache-2.0
/// What a basis file and a relit picture say of values that were clipped, against captures of
/// the same scene by a bracket in which nothing is.

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/session/develop/develop.h"
#include "sim/transport.h"
#include "tests/relight/ball_on_ground.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 40;
constexpr int kHeight = 30;
constexpr int kLights = 64;
constexpr double kBlack = 256.0;
constexpr double kWhite = 65535.0;

/// Radiance of a glossy ball on a plane under 8 x 8 lights, (lights, pixels), at most 1.
std::vector<Image<float>> render_twin() {
  const Rig rig = test::rig_of_64_lights(kWidth, kHeight);
  const render::Scene scene = test::glossy_ball_on_ground();
  const test::TemporaryFolder cache;
  sim::TransportOptions options;
  options.cache_folder = cache.path();
  const sim::Transport transport = sim::make_transport(rig, 0, scene, options);
  std::vector<Image<float>> pictures;
  float peak = 0.0F;
  for (int k = 0; k < kLights; ++k) {
    Image<float> picture(kHeight, kWidth, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        picture(y, x) = static_cast<float>(transport.plane(k)(y, x));
        peak = std::max(peak, picture(y, x));
      }
    }
    pictures.push_back(std::move(picture));
  }
  for (Image<float>& picture : pictures) {
    for (float& value : picture.pixels()) {
      value /= peak;
    }
  }
  return pictures;
}

const std::vector<Image<float>>& twin() {
  static const std::vector<Image<float>> kTwin = render_twin();
  return kTwin;
}

/// The largest exposure, in units of the one that just keeps the peak, at which this fraction
/// of the twin's values or less is clipped.
double exposure_that_clips(double fraction) {
  std::vector<float> values;
  for (const Image<float>& picture : twin()) {
    values.insert(values.end(), picture.pixels().begin(), picture.pixels().end());
  }
  std::sort(values.begin(), values.end());
  const auto n = static_cast<double>(values.size());
  return 1.0 / double{values[static_cast<std::size_t>((1.0 - fraction) * n)]};
}

/// A capture of the twin, every light under each exposure; words as a camera without noise
/// rounds them.
session::Session make_capture(const std::filesystem::path& folder,
                              const std::vector<double>& exposures,
                              std::int64_t* n_clipped = nullptr) {
  constexpr double kUnitUs = 1000.0;
  session::SessionInfo info = test::small_info(kLights);
  info.grid_rows = info.grid_cols = 8;
  info.form.width = kWidth;
  info.form.height = info.form.stored_height = kHeight;
  info.form.black_level = kBlack;
  info.form.white_level = kWhite;
  info.shots.clear();
  for (int k = 0; k < kLights; ++k) {
    for (const double exposure : exposures) {
      session::Shot shot;
      shot.index = static_cast<int>(info.shots.size());
      shot.lit = {{k, 65535}};
      shot.exposure_us = kUnitUs * exposure;
      info.shots.push_back(shot);
    }
  }
  test::make_session(folder, info, [&](int index) {
    const session::Shot& shot = info.shots[static_cast<std::size_t>(index)];
    const Image<float>& picture = twin()[static_cast<std::size_t>(shot.lit.front().light)];
    Image<std::uint16_t> words(kHeight, kWidth, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double dn = std::round(kBlack + (kWhite - kBlack) * double{picture(y, x)} *
                                                  shot.exposure_us / kUnitUs);
        words(y, x) = static_cast<std::uint16_t>(std::min(dn, kWhite));
        if (n_clipped != nullptr) {
          *n_clipped += dn >= kWhite ? 1 : 0;
        }
      }
    }
    return words;
  });
  return session::Session::open(folder);
}

/// One light, nine, all, and a sky of random weights.
std::vector<LightWeights> some_lights() {
  std::vector<LightWeights> all(4, LightWeights::Zero(kLights, 1));
  all[0](27, 0) = 1.0;
  for (const int k : {9, 12, 14, 33, 36, 38, 49, 52, 54}) {
    all[1](k, 0) = 1.0;
  }
  all[2].setOnes();
  for (int k = 0; k < kLights; ++k) {
    all[3](k, 0) = uniform_unit(hash_key(7, static_cast<std::uint64_t>(k)));
  }
  return all;
}

/// The picture's distance from the truth in the pixels where no light in use is clipped, and in
/// all of them.
struct Distances {
  double unclipped = 0.0;
  double all = 0.0;
};

struct TrueCapture {
  LightStack stack;                   ///< of a bracket in which nothing is clipped
  LightStack seen;                    ///< of the capture that clips
  std::vector<std::uint8_t> clipped;  ///< (pixels, lights)
  double excess = 0.0;  ///< the truth is at most (1 + excess) times what was seen, if clipped
};

Distances distances(const RelitPicture& relit, const TrueCapture& capture,
                    const LightWeights& w) {
  const Image<float> truth = relight_stack(capture.stack, w);
  Distances found;
  for (std::size_t p = 0; p < truth.pixels().size(); ++p) {
    const double off = double{relit.picture.pixels()[p]} - double{truth.pixels()[p]};
    bool is_clipped = false;
    for (std::size_t k = 0; k < kLights; ++k) {
      is_clipped = is_clipped || (w(static_cast<Eigen::Index>(k), 0) != 0.0 &&
                                  capture.clipped[p * kLights + k] != 0);
    }
    found.all += off * off;
    found.unclipped += is_clipped ? 0.0 : off * off;
  }
  return {std::sqrt(found.unclipped), std::sqrt(found.all)};
}

TrueCapture true_capture(const session::Session& session, const session::Session& bracket) {
  session::Developed developed = session::develop_all(bracket);
  EXPECT_EQ(developed.n_saturated, 0U);
  TrueCapture capture{std::move(developed.stack), session::develop(session), {}, 0.0};
  session::DevelopOptions options;
  options.marks_clipped = true;
  capture.clipped = session::Developer(session, options).rows(0, kHeight).clipped;
  std::vector<float> truth(capture.clipped.size());
  std::vector<float> seen(capture.clipped.size());
  const TileRect whole{0, 0, kWidth, kHeight};
  capture.stack.read_tile(whole, truth);
  capture.seen.read_tile(whole, seen);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (capture.clipped[i] != 0) {
      capture.excess = std::max(capture.excess, double{truth[i]} / double{seen[i]} - 1.0);
    }
  }
  return capture;
}

TEST(Clipped, StatedBoundAndItsClauseContainTheError) {
  int n_beyond_the_bound_alone = 0;
  for (const double fraction : {0.0005, 0.004, 0.05, 0.2, 0.5}) {
    SCOPED_TRACE(testing::Message() << "clipped: " << fraction);
    const test::TemporaryFolder folder;
    const double exposure = exposure_that_clips(fraction);
    std::int64_t n_clipped = 0;
    const session::Session session =
        make_capture(folder.path() / "clips", {exposure}, &n_clipped);
    const session::Session bracket =
        make_capture(folder.path() / "bracket", {0.9, std::max(1.0, exposure)});
    const TrueCapture capture = true_capture(session, bracket);
    const auto file = folder.path() / "a.hlb";
    const CompressSummary summary =
        compress_session(session, PlateChoice::parse("none"), file, {.relative_l2 = 0.01});
    const BasisFile basis = BasisFile::open(file);
    const BasisHeader& header = basis.header();
    // The count is the frames' own; the least energy that of the stack as it was seen.
    ASSERT_TRUE(header.clipped.has_value());
    EXPECT_EQ(header.clipped->n_values, static_cast<double>(n_clipped));
    EXPECT_EQ(summary.header.clipped->n_values, header.clipped->n_values);
    EXPECT_NEAR(header.clipped->fraction(header.dims), fraction, 0.2 * fraction);
    EXPECT_GT(header.clipped->least_norm, std::sqrt(fraction));  // the brightest ones
    EXPECT_LE(header.clipped->least_norm, 1.0);
    // Words are rounded to whole steps: half a step per value, of either capture.
    const double step = 0.5 / ((kWhite - kBlack) * 1e-3) * (1.0 / exposure + 1.0 / 0.9);
    for (const LightWeights& w : some_lights()) {
      const RelitPicture relit = relight(basis, w);
      const RelightBound& bound = relit.bound;
      const Distances found = distances(relit, capture, w);
      const double rounding = step * std::sqrt(double(kWidth) * kHeight) * w.cwiseAbs().sum() +
                              1e-6 * bound.picture_norm;
      const double stated = bound.dropped + bound.coded + bound.rounding;
      EXPECT_LE(found.unclipped, stated + rounding);
      EXPECT_LE(found.all, stated + rounding + capture.excess * bound.clipped);
      ASSERT_TRUE(bound.clipped_fraction.has_value());
      EXPECT_EQ(*bound.clipped_fraction > 0.0, bound.clipped > 0.0);
      n_beyond_the_bound_alone += found.all > stated + rounding ? 1 : 0;
    }
  }
  EXPECT_GE(n_beyond_the_bound_alone, 8);  // without the clause the promise is broken
}

TEST(Clipped, CaptureWithoutClippingSaysThatNothingIs) {
  const test::TemporaryFolder folder;
  const session::Session session = make_capture(folder.path() / "s", {0.9});
  const auto file = folder.path() / "a.hlb";
  (void)compress_session(session, PlateChoice::parse("none"), file, {.relative_l2 = 0.01});
  const BasisFile basis = BasisFile::open(file);
  ASSERT_TRUE(basis.header().clipped.has_value());
  EXPECT_EQ(basis.header().clipped->n_values, 0.0);
  const RelitPicture relit = relight(basis, LightWeights::Ones(kLights, 1));
  EXPECT_EQ(relit.bound.clipped_fraction, 0.0);
  EXPECT_EQ(relit.bound.clipped, 0.0);
}

/// Bands, and every value marked that a clipped neighbour's colour went into.
TEST(Clipped, MosaicsNeighboursAreMarkedAsTheStandardErrorIs) {
  const test::TemporaryFolder folder;
  session::SessionInfo info = test::small_info(4);
  info.form.bayer = BayerPattern::rggb;
  test::make_session(folder.path() / "s", info, [&](int shot) {
    Image<std::uint16_t> words = test::small_pixels(shot);
    words(3, 5) = shot == 2 ? 4095 : words(3, 5);
    return words;
  });
  const session::Session session = session::Session::open(folder.path() / "s");
  session::DevelopOptions options;
  options.marks_clipped = true;
  session::Developer developer(session, options);
  const session::Developer::Rows rows = developer.rows(0, info.form.height);
  ASSERT_EQ(rows.clipped.size(), rows.values.size());
  const auto n = std::count(rows.clipped.begin(), rows.clipped.end(), 1);
  EXPECT_GE(n, 3);   // the pixel's own three colours
  EXPECT_LE(n, 27);  // and neighbours' at most
  for (std::size_t i = 0; i < rows.clipped.size(); ++i) {
    EXPECT_TRUE(rows.clipped[i] == 0 || i % 4 == 2) << i;  // of light 2 alone
  }
}

}  // namespace
}  // namespace haarlight::relight
