// SPDX-License-Identifier: Apache-2.0
/// @file
/// Exposures of one light that belong together are never refused, however dim; exposures that
/// contradict each other are, wherever the light suffices to tell. Random sessions, seed
/// printed; HAARLIGHT_SEED replays one.

#include <cmath>
#include <cstdlib>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/develop/develop.h"
#include "tests/drawn_seed.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

using test::TemporaryFolder;
using ::testing::HasSubstr;

constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr double kBlack = 256.0;  // of small8's camera: 14 bits, gain 1, read 3 e
constexpr double kRead = 3.0;

constexpr double kToldBelow = 9000.0;  // electrons, of a full well of 16 000

/// What is true of one session.
struct Bracket {
  double snr = 5.0;      ///< of the middle pixel in the shortest exposure
  double ratio = 4.0;    ///< from one exposure to the next
  double lie = 1.0;      ///< the longest exposure lasts so many times what it says
  double decades = 0.5;  ///< from the picture's darkest to its brightest column
  double far = 0.0;      ///< black level off by so many steps
};

/// Electrons whose signal to noise ratio is `snr`: s / sqrt(s + read^2) = snr.
double electrons_of(double snr) {
  return 0.5 * snr * (snr + std::sqrt(snr * snr + 4.0 * kRead * kRead));
}

std::string problem_of(const Bracket& b, std::uint64_t seed) {
  const TemporaryFolder folder;
  SessionInfo info = test::small_info(1);
  const std::string rig =
      read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml", 1U << 20U);
  info.rig_hash = content_hash(rig);
  info.form.width = kWidth;
  info.form.height = info.form.stored_height = kHeight;
  info.form.black_level = kBlack + b.far;
  info.form.white_level = 16383.0;
  info.shots.clear();
  for (int i = 0; i < 3; ++i) {
    Shot shot;
    shot.index = i;
    shot.lit = {{0, 65535}};
    shot.exposure_us = 500.0 * std::pow(b.ratio, i);
    info.shots.push_back(shot);
  }
  const double middle = electrons_of(b.snr) / 500.0;  // electrons a microsecond
  test::make_session(
      folder.path() / "s", info,
      [&](int index) {
        Image<std::uint16_t> pixels(kHeight, kWidth, 1);
        const double us = info.shots[static_cast<std::size_t>(index)].exposure_us *
                          (index == 2 ? b.lie : 1.0);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            const auto key = hash_key(
                seed, static_cast<std::uint64_t>(index),
                static_cast<std::uint64_t>(y) * kWidth + static_cast<std::uint64_t>(x));
            const double mean =
                us * middle * std::pow(10.0, b.decades * (x / (kWidth - 1.0) - 0.5));
            const double electrons =
                mean + std::sqrt(mean + kRead * kRead) * standard_normal(key);
            pixels(y, x) = static_cast<std::uint16_t>(
                std::lround(std::clamp(kBlack + std::min(electrons, 16000.0), 0.0, 16383.0)));
          }
        }
        return pixels;
      },
      rig);
  try {
    (void)develop(Session::open(folder.path() / "s"), {.use_cache = false});
  } catch (const Error& error) {
    return error.problem();
  }
  return {};
}

TEST(LevelCheck, NeverRefusesAGoodSessionHoweverDim) {
  const std::uint64_t seed = testing::drawn_seed();
  for (std::uint64_t i = 0; i < 200; ++i) {
    const auto u = [&](std::uint64_t what) { return uniform_unit(hash_key(seed, i, what)); };
    const Bracket b{0.5 + 14.0 * u(1), 1.5 + 7.0 * u(2), 1.0, u(3)};
    EXPECT_EQ(problem_of(b, hash_key(seed, i)), "") << fmt::format(
        "session {}: snr {:.2f}, ratio {:.2f}, {:.2f} decades", i, b.snr, b.ratio, b.decades);
  }
}

TEST(LevelCheck, RefusesExposuresThatContradictEachOther) {
  const std::uint64_t seed = testing::drawn_seed();
  for (std::uint64_t i = 0; i < 60; ++i) {
    const auto u = [&](std::uint64_t what) { return uniform_unit(hash_key(seed, i, what)); };
    Bracket b{12.0 + 20.0 * u(1), 1.5 + 2.0 * u(2), 1.0, u(3)};
    if (i % 3 == 0) {
      b.lie = 1.25 + u(4);
    } else if (i % 3 == 1) {
      b.lie = 0.8 - 0.5 * u(4);
    } else {
      // The signal s looks brighter by 0.8 to 1.2 s: 2.2 times longer looks 0.76 times as
      // bright as it should, or less.
      b.snr = 10.0 + 3.0 * u(1);
      b.ratio = 2.2 + u(2);
      b.decades = 0.0;
      b.far = -std::floor((0.8 + 0.4 * u(4)) * electrons_of(b.snr));
    }
    // The longest exposure tells nothing where it nears the full well.
    const double brightest =
        electrons_of(b.snr) * std::max(b.lie, 1.0) * std::pow(10.0, 0.5 * b.decades);
    b.ratio = std::min(b.ratio, std::sqrt(kToldBelow / brightest));
    EXPECT_THAT(problem_of(b, hash_key(seed, i)), HasSubstr("shorter one predicts"))
        << fmt::format("session {}: snr {:.2f}, ratio {:.2f}, lasts {:.2f}, black {:+.0f}", i,
                       b.snr, b.ratio, b.lie, b.far);
  }
}

}  // namespace
}  // namespace haarlight::session
