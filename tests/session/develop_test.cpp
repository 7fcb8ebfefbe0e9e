// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/develop/develop.h"

#include <algorithm>
#include <cmath>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/rig/patterns.h"
#include "haarlight/session/develop/demosaic.h"
#include "tests/core/rig/pattern_matrices.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::HasSubstr;

constexpr double kBlack = 64.0;
constexpr double kWhite = 4095.0;
constexpr double kRange = kWhite - kBlack;

SessionInfo make_info(int width, int height, int n_lights) {
  SessionInfo info = test::small_info(n_lights);
  info.form.width = width;
  info.form.height = height;
  info.form.stored_height = height;
  info.shots.clear();
  return info;
}

void add_shot(SessionInfo& info, ShotKind kind, std::vector<LightLevel> lit,
              double exposure_us) {
  Shot shot;
  shot.index = static_cast<int>(info.shots.size());
  shot.kind = kind;
  shot.lit = std::move(lit);
  shot.exposure_us = exposure_us;
  info.shots.push_back(shot);
}

/// The true radiance of a light at a pixel, in fractions of the range per second.
double truth(int k, int y, int x) {
  return 20.0 + 100.0 * uniform_unit(hash_key(7, static_cast<std::uint64_t>(k),
                                              static_cast<std::uint64_t>(y),
                                              static_cast<std::uint64_t>(x)));
}

/// What the sensor says of a sum of lights: rounded, clipped.
std::uint16_t expose(const Shot& shot, double radiance) {
  const double dn = kBlack + kRange * radiance * shot.exposure_us * 1e-6;
  return static_cast<std::uint16_t>(std::lround(std::min(dn, kWhite)));
}

Image<std::uint16_t> sum_lights(const SessionInfo& info, const Shot& shot) {
  Image<std::uint16_t> pixels(info.form.height, info.form.width, 1);
  for (int y = 0; y < info.form.height; ++y) {
    for (int x = 0; x < info.form.width; ++x) {
      double radiance = 0.0;
      for (const LightLevel& lit : shot.lit) {
        radiance += truth(lit.light, y, x) * lit.level / 65535.0 *
                    info.lights[static_cast<std::size_t>(lit.light)].relative_power;
      }
      pixels(y, x) = expose(shot, radiance);
    }
  }
  return pixels;
}

Session make(const fs::path& folder, const SessionInfo& info) {
  test::make_session(folder, info, [&info](int shot) {
    return sum_lights(info, info.shots[static_cast<std::size_t>(shot)]);
  });
  return Session::open(folder);
}

/// Largest error of all lights against the truth.
double worst_error(const LightStack& stack) {
  double worst = 0.0;
  for (int k = 0; k < stack.dims().n_lights; ++k) {
    const Image<float> image = stack.light_images(k, 1).front();
    for (int y = 0; y < image.height(); ++y) {
      for (int x = 0; x < image.width(); ++x) {
        worst = std::max(worst, std::abs(image(y, x) - truth(k, y, x)));
      }
    }
  }
  return worst;
}

// Half a DN of rounding at 4 ms, then float: 0.5 / 4031 / 0.004 = 0.031.
constexpr double kHalfDn = 0.5 / kRange / 0.004;

TEST(Develop, DividesExposureDriveAndPowerOut) {
  TemporaryFolder folder;
  SessionInfo info = make_info(9, 7, 3);
  info.lights[1].relative_power = 0.8;
  add_shot(info, ShotKind::light, {{0, 65535}}, 4000.0);
  add_shot(info, ShotKind::light, {{1, 65535}}, 5000.0);
  add_shot(info, ShotKind::light, {{2, 32768}}, 8000.0);
  const LightStack stack = develop(make(folder.path() / "s", info));
  EXPECT_LE(worst_error(stack), 1.001 * kHalfDn);
}

TEST(Develop, IsCachedAndTheKeySeesTheMethod) {
  TemporaryFolder folder;
  SessionInfo info = make_info(8, 8, 2);
  info.form.bayer = BayerPattern::rggb;
  add_shot(info, ShotKind::light, {{0, 65535}}, 4000.0);
  add_shot(info, ShotKind::light, {{1, 65535}}, 4000.0);
  const Session session = make(folder.path() / "s", info);
  const auto n_files = [&] {
    std::ptrdiff_t n = 0;  // stacks; beside each stands its record
    for (const auto& entry : fs::directory_iterator(folder.path() / "s/cache")) {
      n += entry.path().extension() == ".hls" ? 1 : 0;
    }
    return n;
  };
  EXPECT_EQ(develop(session).dims().channels, 3);
  EXPECT_EQ(develop(session).dims().channels, 3);
  EXPECT_EQ(n_files(), 1);
  EXPECT_EQ(develop(session, {.keep_bayer = true}).dims().channels, 1);
  EXPECT_EQ(n_files(), 2);
  (void)develop(session, {.demosaic = Demosaic::edge_aware});
  EXPECT_EQ(n_files(), 3);
}

TEST(Develop, BandsAndThreadsDoNotChangeABit) {
  TemporaryFolder folder;
  SessionInfo info = make_info(24, 200, 5);
  info.form.bayer = BayerPattern::gbrg;
  for (int k = 0; k < 5; ++k) {
    add_shot(info, ShotKind::light, {{k, 65535}}, 4000.0);
  }
  const Session session = make(folder.path() / "s", info);
  const LightStack whole = develop(session);
  ASSERT_EQ(whole.bands().n(), 1);
  for (const int n_threads : {1, 2, 7}) {
    for (const std::uint64_t memory : {300'000ULL, 160'000ULL}) {
      const ThreadLimit limit(n_threads);
      const LightStack banded = develop(session, {.memory_bytes = memory, .use_cache = false});
      ASSERT_GT(banded.bands().n(), 2);
      banded.check();
      for (int k = 0; k < 5; ++k) {
        const Image<float> a = whole.light_images(k, 1).front();
        const Image<float> b = banded.light_images(k, 1).front();
        ASSERT_TRUE(std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin()))
            << "light " << k << ", " << n_threads << " threads, " << memory << " bytes";
      }
    }
  }
}

TEST(Develop, RefusesABudgetThatHoldsNoRow) {
  TemporaryFolder folder;
  SessionInfo info = make_info(24, 20, 1);
  add_shot(info, ShotKind::light, {{0, 65535}}, 4000.0);
  const Session session = make(folder.path() / "s", info);
  EXPECT_THROW((void)develop(session, {.memory_bytes = 1000}), Error);
}

TEST(Develop, MergesBracketsAndLeavesSaturationOut) {
  TemporaryFolder folder;
  SessionInfo info = make_info(9, 7, 1);
  add_shot(info, ShotKind::light, {{0, 65535}}, 4000.0);
  add_shot(info, ShotKind::light, {{0, 65535}}, 16000.0);  // above 62.5: saturated
  const LightStack stack = develop(make(folder.path() / "s", info));
  EXPECT_LE(worst_error(stack), 1.001 * kHalfDn);
}

TEST(Develop, DemultiplexesAnSMatrix) {
  TemporaryFolder folder;
  SessionInfo info = make_info(9, 7, 7);
  info.lights[3].relative_power = 1.25;
  const PatternMatrix patterns = test::s_matrix(7);
  for (int shot = 0; shot < 7; ++shot) {
    std::vector<LightLevel> lit;
    for (int k = 0; k < 7; ++k) {
      if (patterns(shot, k) > 0.0) {
        lit.push_back({k, 65535});
      }
    }
    add_shot(info, ShotKind::light, lit, 1000.0);
  }
  // Rounding of seven shots at 1 ms: |pinv(S)|_inf = 2 n / (n + 1) = 7/4, less light 3's power.
  const double bound = 1.75 * 0.5 / kRange / 0.001;
  EXPECT_LE(worst_error(develop(make(folder.path() / "s", info))), 1.001 * bound);
}

/// Light shots of a family of patterns at one exposure, in an order of its own.
SessionInfo pattern_info(const PatternParameters& parameters, double exposure_us) {
  SessionInfo info = make_info(9, 7, parameters.n_lights());
  info.patterns = parameters;
  std::vector<std::vector<int>> shots = lit_lights(parameters);
  std::reverse(shots.begin(), shots.end());
  for (const std::vector<int>& lights : shots) {
    std::vector<LightLevel> lit;
    for (const int light : lights) {
      lit.push_back({light, 32768});
    }
    add_shot(info, ShotKind::light, lit, exposure_us);
  }
  return info;
}

TEST(Develop, UndoesPatternsInWhateverOrderTheyWereShot) {
  PatternParameters haar{PatternFamily::haar, {{4, 4}}, 0, {}};
  for (int i = 0; i < 16; ++i) {
    haar.wavelets.push_back(i);
  }
  for (const PatternParameters& parameters :
       {PatternParameters{PatternFamily::s_matrix, {{4, 4}}, 0, {}},
        PatternParameters{PatternFamily::s_matrix, {{3, 3}, {2, 2}}, 0, {}}, haar,
        PatternParameters{PatternFamily::bins, {{4, 4}}, 1, {}}}) {
    TemporaryFolder folder;
    SessionInfo info = pattern_info(parameters, 1000.0);
    info.lights[3].relative_power = 1.25;
    // Rows of the inverses have absolute sums of at most 2 (S-matrix) or 2 + 3 levels of Haar
    // pairs (3.75); the drive doubles what half a DN of rounding costs at 1 ms.
    const double bound = 3.75 * 2.0 * 0.5 / kRange / 0.001;
    EXPECT_LE(worst_error(develop(make(folder.path() / "s", info))), bound)
        << to_string(parameters.family);
  }
}

TEST(Develop, DistributesABlocksLightByThePlate) {
  TemporaryFolder folder;
  const SessionInfo info =
      pattern_info(PatternParameters{PatternFamily::bins, {{4, 4}}, 2, {}}, 2000.0);
  const Session session = make(folder.path() / "s", info);
  DevelopOptions options;
  EXPECT_THROW((void)develop(session, options), Error) << "no clean plate";
  // A clean plate that is half of the truth, everywhere: the blocks come apart exactly.
  options.plate.key = "half";
  options.plate.read = [](int y, int x0, int x1, std::span<float> out) {
    std::size_t i = 0;
    for (int x = x0; x < x1; ++x) {
      for (int k = 0; k < 16; ++k) {
        out[i++] = static_cast<float>(0.5 * truth(k, y, x));
      }
    }
  };
  // One block's rounding, at half drive and 2 ms, goes to four lights by their fractions.
  EXPECT_LE(worst_error(develop(session, options)), 2.0 * 0.5 / kRange / 0.002);
  // Shared out alike the blocks' sums are still right.
  const LightStack even = develop(session, {.distribute_evenly = true});
  EXPECT_EQ(even.light_images(0, 1).front()(3, 3), even.light_images(5, 1).front()(3, 3));
  EXPECT_NEAR(4.0 * even.light_images(0, 1).front()(3, 3),
              truth(0, 3, 3) + truth(1, 3, 3) + truth(4, 3, 3) + truth(5, 3, 3), 0.3);
}

TEST(Develop, NamesAMissingPatternOfAFamily) {
  TemporaryFolder folder;
  SessionInfo info =
      pattern_info(PatternParameters{PatternFamily::s_matrix, {{4, 4}}, 0, {}}, 1000.0);
  info.shots.pop_back();
  const Session session = make(folder.path() / "s", info);
  try {
    (void)develop(session);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("pattern 1 of 16 of the s_matrix set"));
  }
}

TEST(Develop, RefusesPatternsThatCannotTellLightsApart) {
  TemporaryFolder folder;
  SessionInfo info = make_info(4, 4, 3);
  add_shot(info, ShotKind::light, {{0, 65535}, {1, 65535}}, 1000.0);
  add_shot(info, ShotKind::light, {{2, 65535}}, 1000.0);
  const Session session = make(folder.path() / "s", info);
  try {
    (void)develop(session);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("cannot tell 3 lights apart"));
  }
}

TEST(Develop, NamesALightWithoutAFrame) {
  TemporaryFolder folder;
  SessionInfo info = make_info(4, 4, 2);
  add_shot(info, ShotKind::light, {{0, 65535}}, 1000.0);
  const Session session = make(folder.path() / "s", info);
  try {
    (void)develop(session);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("light 1 (top/0/1) has no committed frame"));
  }
}

TEST(Develop, SubtractsDarkDividesFlatAndMendsHotPixels) {
  TemporaryFolder folder;
  SessionInfo info = make_info(16, 12, 2);
  add_shot(info, ShotKind::dark, {}, 4000.0);
  add_shot(info, ShotKind::flat, {{0, 65535}}, 4000.0);
  add_shot(info, ShotKind::light, {{0, 65535}}, 4000.0);
  add_shot(info, ShotKind::light, {{1, 65535}}, 4000.0);
  constexpr double kRadiance = 60.0;  // of both lights, everywhere
  const auto sensitivity = [](int x) { return 1.0 + 0.02 * (x - 7.5); };
  test::make_session(folder.path() / "s", info, [&](int shot) {
    Image<std::uint16_t> pixels(12, 16, 1);
    for (int y = 0; y < 12; ++y) {
      for (int x = 0; x < 16; ++x) {
        const double offset = 10.0 + y % 3;  // dark current, DN
        const double light = shot == 0 ? 0.0 : kRange * kRadiance * sensitivity(x) * 0.004;
        pixels(y, x) = static_cast<std::uint16_t>(std::lround(kBlack + offset + light));
      }
    }
    pixels(5, 6) = 3000;  // hot in every frame
    return pixels;
  });
  const LightStack stack = develop(Session::open(folder.path() / "s"));
  const Image<float> image = stack.light_images(1, 1).front();
  for (int y = 0; y < 12; ++y) {
    for (int x = 0; x < 16; ++x) {
      // The flat's own mean holds the hot pixel too: 1/192 of it, tripled, is 0.9 %.
      EXPECT_NEAR(image(y, x), kRadiance, 0.012 * kRadiance) << x << " " << y;
    }
  }
}

TEST(Develop, CorrectsTheDriftThatTheSentinelSees) {
  TemporaryFolder folder;
  SessionInfo info = make_info(6, 6, 3);
  add_shot(info, ShotKind::sentinel, {{0, 65535}}, 4000.0);
  for (int k = 0; k < 3; ++k) {
    add_shot(info, ShotKind::light, {{k, 65535}}, 4000.0);
  }
  add_shot(info, ShotKind::sentinel, {{0, 65535}}, 4000.0);
  // All lights fade linearly by 20 % over the session's four steps.
  test::make_session(folder.path() / "s", info, [&](int shot) {
    Image<std::uint16_t> pixels(6, 6, 1);
    for (std::uint16_t& value : pixels.pixels()) {
      value = static_cast<std::uint16_t>(
          std::lround(kBlack + kRange * 100.0 * 0.004 * (1.0 - 0.05 * shot)));
    }
    return pixels;
  });
  const LightStack stack = develop(Session::open(folder.path() / "s"));
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(stack.light_images(k, 1).front()(3, 3), 100.0, 0.1);
  }
}

TEST(LightStack, NamesLightAndPixelOfANumberThatIsNone) {
  TemporaryFolder folder;
  LightStackWriter writer(folder.path() / "a.hls",
                          {.width = 3, .height = 4, .channels = 1, .n_lights = 2}, 2);
  std::vector<float> values(12, 1.0F);
  writer.append_band(values);
  values[2 * (3 + 1) + 1] = NAN;  // row 1 of the band, x 1, light 1
  try {
    writer.append_band(values);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("light 1, pixel (x 1, y 3)"));
  }
}

TEST(LightStack, RefusesDamage) {
  TemporaryFolder folder;
  const fs::path file = folder.path() / "a.hls";
  {
    LightStackWriter writer(file, {.width = 3, .height = 4, .channels = 1, .n_lights = 2}, 4);
    writer.append_band(std::vector<float>(24, 1.0F));
    EXPECT_FALSE(fs::exists(file));
    writer.finish();
  }
  const std::string good = test::read_text(file);
  const auto opens = [&](const std::string& bytes) {
    test::write_text(file, bytes);
    try {
      LightStack::open(file).check();
      return true;
    } catch (const Error&) {
      return false;
    }
  };
  EXPECT_TRUE(opens(good));
  EXPECT_FALSE(opens(""));
  EXPECT_FALSE(opens(good.substr(0, good.size() - 1)));
  EXPECT_FALSE(opens(good + "x"));
  for (const std::size_t at : {0U, 9U, 13U, 24U, 40U, 70U, 4096U}) {
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 1);
    EXPECT_FALSE(opens(bad)) << at;
  }
}

/// Colours that are linear in x and y.
float ramp(int y, int x, int c) {
  return static_cast<float>(10 + 3 * c + (c + 1) * x + (3 - c) * y);
}

TEST(Demosaic, IsExactOnALinearPictureAwayFromTheBorder) {
  for (const BayerPattern pattern :
       {BayerPattern::rggb, BayerPattern::bggr, BayerPattern::grbg, BayerPattern::gbrg}) {
    Image<float> mosaic(12, 14, 1);
    for (int y = 0; y < 12; ++y) {
      for (int x = 0; x < 14; ++x) {
        mosaic(y, x) = ramp(y, x, bayer_colour(pattern, y, x));
      }
    }
    for (const Demosaic method : {Demosaic::bilinear, Demosaic::edge_aware}) {
      const Image<float> result = demosaic(mosaic.view(), pattern, method);
      for (int y = 3; y < 9; ++y) {
        for (int x = 3; x < 11; ++x) {
          for (int c = 0; c < 3; ++c) {
            ASSERT_EQ(result(y, x, c), ramp(y, x, c))
                << to_string(method) << " " << y << " " << x;
          }
        }
      }
    }
  }
}

TEST(Demosaic, NamesTheFourPhases) {
  // The first row's two colours are the pattern's first two letters.
  EXPECT_EQ(bayer_colour(BayerPattern::rggb, 0, 0), 0);
  EXPECT_EQ(bayer_colour(BayerPattern::rggb, 1, 1), 2);
  EXPECT_EQ(bayer_colour(BayerPattern::bggr, 0, 0), 2);
  EXPECT_EQ(bayer_colour(BayerPattern::grbg, 0, 0), 1);
  EXPECT_EQ(bayer_colour(BayerPattern::grbg, 0, 1), 0);
  EXPECT_EQ(bayer_colour(BayerPattern::gbrg, 0, 1), 2);
  EXPECT_EQ(bayer_colour(BayerPattern::gbrg, 1, 0), 0);
}

/// Root mean square error on a disc with a hard edge and coloured stripes, values 0..1.
double demosaic_error(Demosaic method) {
  constexpr int kSide = 96;
  const auto colour = [](int y, int x, int c) {
    const double r = std::hypot(x - 47.3, y - 48.1);
    const double stripe = 0.5 + 0.4 * std::sin(0.35 * x + 0.2 * y);
    return static_cast<float>(r < 30.0 ? stripe * (0.9 - 0.2 * c) : 0.1 + 0.05 * c);
  };
  Image<float> mosaic(kSide, kSide, 1);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      mosaic(y, x) = colour(y, x, bayer_colour(BayerPattern::rggb, y, x));
    }
  }
  const Image<float> result = demosaic(mosaic.view(), BayerPattern::rggb, method);
  double sum = 0.0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      for (int c = 0; c < 3; ++c) {
        sum += std::pow(result(y, x, c) - colour(y, x, c), 2);
      }
    }
  }
  return std::sqrt(sum / (kSide * kSide * 3.0));
}

TEST(Demosaic, EdgeAwareBeatsBilinearAtEdgesAsDocumented) {
  const double bilinear = demosaic_error(Demosaic::bilinear);
  const double edge_aware = demosaic_error(Demosaic::edge_aware);
  RecordProperty("bilinear", std::to_string(bilinear));
  RecordProperty("edge_aware", std::to_string(edge_aware));
  EXPECT_LT(edge_aware, 0.7 * bilinear) << bilinear << " " << edge_aware;
  EXPECT_LT(bilinear, 0.03) << bilinear << " " << edge_aware;
}

TEST(Develop, ACurveThatNobodyKnowsIsRefusedUnlessItIsNamed) {
  const TemporaryFolder folder;
  SessionInfo info = make_info(4, 3, 1);
  add_shot(info, ShotKind::light, {{0, 65535}}, 1000.0);
  info.form.transfer = Transfer::unknown;
  const Session session = make(folder.path() / "s", info);
  try {
    (void)develop(session);
    FAIL() << "developed";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("not linear"));
    EXPECT_THAT(error.hint(), HasSubstr("--transfer"));
  }
  const LightStack linear = develop(session, {.unknown_as = Transfer::linear});
  const LightStack srgb = develop(session, {.unknown_as = Transfer::srgb});
  const float fraction = linear.light_images(0, 1).front()(1, 1) * 1e-3F;
  EXPECT_NEAR(srgb.light_images(0, 1).front()(1, 1) * 1e-3F, linear_from_srgb(fraction), 1e-6);
  EXPECT_THROW((void)develop(session), Error);  // a cached one does not count as a name
}

}  // namespace
}  // namespace haarlight::session
