// SPDX-License-Identifier: Apache-2.0
#include "sim/virtual_camera.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "tests/sim/made_transport.h"

namespace haarlight::sim {
namespace {

using testing::flat_transport;
using testing::TemporaryFolder;
using testing::test_camera;

firmware_iface::LightTransition state(std::int64_t t_ns, std::uint32_t tag,
                                      std::vector<firmware_iface::ElementLevel> lit) {
  return {t_ns, tag,
          std::make_shared<const std::vector<firmware_iface::ElementLevel>>(std::move(lit))};
}

class VirtualCameraTest : public ::testing::Test {
 protected:
  /// Light 0 shows 1.5, light 1 shows 0.5 of the mean (so the scale is 1 = their mean).
  VirtualCameraTest() : transport_(flat_transport(folder_, 64, 48, {1.5F, 0.5F})) {
    controller_.latch_us = 0.0;
  }

  Image<std::uint16_t> take(const CameraSpec& spec, const firmware_iface::LightHistory& history,
                            const Exposure& exposure, const VirtualCameraOptions& options = {},
                            std::uint64_t key = 0) {
    VirtualCamera camera(spec, controller_, transport_, options);
    Image<std::uint16_t> words(spec.frame_height, spec.frame_width, 1);
    camera.take(history, exposure, camera.look(history, exposure), key, words.view());
    return words;
  }

  static VirtualCameraOptions quiet(double lit = 8000.0) {
    return {.seed = 1, .lit_electrons = lit, .has_noise = false};
  }

  TemporaryFolder folder_;
  Transport transport_;
  ControllerSpec controller_;
};

TEST_F(VirtualCameraTest, SteadyLightGivesTheStatedElectrons) {
  EXPECT_DOUBLE_EQ(transport_.scale(), 1.0);
  const firmware_iface::LightHistory history{{state(0, 5, {{0, 65535}})}, true};
  const auto words = take(test_camera(), history, {1'000'000'000, 2000.0, 0.0}, quiet());
  EXPECT_EQ(words(0, 0), 256 + 12000);
  EXPECT_EQ(words(47, 63), 256 + 12000);
  const firmware_iface::LightHistory half{{state(0, 5, {{1, 32768}})}, true};
  // 8000 * 0.5 * 32768/65535 = 2000.03 electrons; twice the time, twice the light.
  EXPECT_EQ(take(test_camera(), half, {1'000'000'000, 4000.0, 0.0}, quiet())(3, 3), 256 + 4000);
}

TEST_F(VirtualCameraTest, LightsAddUp) {
  const firmware_iface::LightHistory history{{state(0, 5, {{0, 65535}, {1, 65535}})}, true};
  EXPECT_EQ(take(test_camera(), history, {1'000'000'000, 1000.0, 0.0}, quiet())(9, 9),
            256 + 4000 * 2);
}

TEST_F(VirtualCameraTest, RollingShutterRowsSeeTheirOwnFractionOfASwitch) {
  CameraSpec spec = test_camera();
  spec.shutter = Shutter::rolling;
  spec.skew_us = 4700.0;  // 100 us per row
  controller_.latch_us = 50.0;
  // Light 0 goes on 2550 us after the first row's start: 2500 us by command, 50 us by latch.
  const std::int64_t start = 1'000'000'000;
  const firmware_iface::LightHistory history{
      {state(0, 1, {}), state(start + 2'500'000, 2, {{0, 65535}})}, true};
  const auto words = take(spec, history, {start, 2000.0, 0.0}, quiet());
  for (int row = 0; row < 48; ++row) {
    // Row r exposes [100 r, 100 r + 2000] us; lit from 2550 us on.
    const double lit_us = std::clamp(100.0 * row + 2000.0 - 2550.0, 0.0, 2000.0);
    const double expected = 256.0 + 12000.0 * lit_us / 2000.0;
    // Rounding to words, and float sums of 12000 (1e-7 relative).
    EXPECT_NEAR(words(row, 7), expected, 0.51) << "row " << row;
  }
}

TEST_F(VirtualCameraTest, RampsIntegrateToTheirClosedForm) {
  controller_.rise_us = 400.0;
  controller_.fall_us = 800.0;
  const std::int64_t start = 1'000'000'000;
  // On at 500 us, off at 1500 us of an exposure of 2000 us. Rise: 400/2 us lost. Fall: 500 us
  // of the 800 us ramp lie inside, from 1 down to 3/8: mean 11/16.
  const firmware_iface::LightHistory history{
      {state(0, 1, {}), state(start + 500'000, 2, {{0, 65535}}),
       state(start + 1'500'000, 3, {})},
      true};
  const double lit_us = 200.0 + 600.0 + 500.0 * 11.0 / 16.0;
  EXPECT_NEAR(take(test_camera(), history, {start, 2000.0, 0.0}, quiet())(0, 0),
              256.0 + 12000.0 * lit_us / 2000.0, 0.51);
  // The next exposure begins right away and catches the rest of the fall: 300 us from 3/8 to 0.
  const firmware_iface::LightHistory later{
      {state(start + 500'000, 2, {{0, 65535}}), state(start + 1'500'000, 3, {})}, true};
  EXPECT_NEAR(take(test_camera(), later, {start + 2'000'000, 2000.0, 0.0}, quiet())(0, 0),
              256.0 + 12000.0 * 300.0 * 3.0 / 16.0 / 2000.0, 0.51);
}

TEST_F(VirtualCameraTest, AChangeDuringARampStartsWhereTheLightIs) {
  controller_.rise_us = 1000.0;
  controller_.fall_us = 500.0;
  const std::int64_t start = 1'000'000'000;
  // Rises from 0 us, is at one half when the fall (500 us for any amount) begins: two
  // triangles.
  const firmware_iface::LightHistory history{
      {state(0, 1, {}), state(start, 2, {{0, 65535}}), state(start + 500'000, 3, {})}, true};
  const double lit_us = 0.5 * 500.0 * 0.5 + 0.5 * 500.0 * 0.5;
  EXPECT_NEAR(take(test_camera(), history, {start, 2000.0, 0.0}, quiet())(0, 0),
              256.0 + 12000.0 * lit_us / 2000.0, 0.51);
}

TEST_F(VirtualCameraTest, TimestampsMeanWhatTheRigFileSays) {
  CameraSpec spec = test_camera();
  const Exposure exposure{1'000'000'000, 2000.0, 0.0};
  spec.timestamp = TimestampMeaning::start_exposure;
  EXPECT_EQ(VirtualCamera(spec, controller_, transport_).timestamp_ns(exposure), 1'000'000'000);
  spec.timestamp = TimestampMeaning::start_readout;
  EXPECT_EQ(VirtualCamera(spec, controller_, transport_).timestamp_ns(exposure), 1'002'000'000);
  spec.timestamp = TimestampMeaning::end_frame;
  EXPECT_EQ(VirtualCamera(spec, controller_, transport_).timestamp_ns(exposure), 1'004'500'000);
}

TEST_F(VirtualCameraTest, TheTagTellsWhatWasLitAndWhetherItChanged) {
  controller_.latch_us = 200.0;
  controller_.rise_us = 20.0;
  controller_.fall_us = 30.0;
  const VirtualCamera camera(test_camera(), controller_, transport_);
  const std::int64_t start = 1'000'000'000;
  const Exposure exposure{start, 2000.0, 0.0};
  const auto seen = [&](std::int64_t change_ns) {
    return camera
        .look({{state(0, 7, {{0, 65535}}), state(change_ns, 8, {{1, 65535}})}, true}, exposure)
        .tag;
  };
  // Settled exactly at the start: latch 200 and the longer ramp 30 us before it.
  EXPECT_EQ(seen(start - 230'000), (capture::FrameTag{8, false}));
  EXPECT_EQ(seen(start - 229'999), (capture::FrameTag{8, true}));
  EXPECT_EQ(seen(start + 1'000'000), (capture::FrameTag{8, true}));
  // Commanded within the exposure, but the light follows only after it.
  EXPECT_EQ(seen(start + 1'799'999), (capture::FrameTag{8, true}));
  EXPECT_EQ(seen(start + 1'800'000), (capture::FrameTag{7, false}));
}

TEST_F(VirtualCameraTest, MetadataRowsAreReadable) {
  const firmware_iface::LightHistory history{{state(0, 0xdeadbeef, {{0, 65535}})}, true};
  const auto words = take(test_camera(), history, {1'000'000'000, 2000.0, 0.0});
  const auto tag = capture::decode_metadata_rows({&words(48, 0), 8, 64, 1});
  ASSERT_TRUE(tag);
  EXPECT_EQ(*tag, (capture::FrameTag{0xdeadbeef, false}));
}

TEST_F(VirtualCameraTest, NoiseHasThePhotonsMeanAndVariance) {
  // Means of 2, 20, 200 and 8000 electrons: inversion below 30, normal above.
  for (const double electrons : {2.0, 20.0, 200.0, 8000.0}) {
    CameraSpec spec = test_camera();
    VirtualCamera camera(spec, controller_, transport_,
                         {.seed = 9, .lit_electrons = electrons});
    const firmware_iface::LightHistory history{{state(0, 1, {{0, 65535}, {1, 65535}})}, true};
    const Exposure exposure{1'000'000'000, 1000.0, 0.0};  // half the time of twice the light
    Image<std::uint16_t> words(56, 64, 1);
    double sum = 0.0;
    double sum2 = 0.0;
    double n = 0.0;
    for (std::uint64_t frame = 0; frame < 60; ++frame) {
      camera.take(history, exposure, camera.look(history, exposure), frame, words.view());
      for (int i = 0; i < 48 * 64; ++i) {
        const double e = words.pixels()[static_cast<std::size_t>(i)] - 256.0;
        sum += e;
        sum2 += e * e;
        n += 1.0;
      }
    }
    const double mean = sum / n;
    const double variance = sum2 / n - mean * mean;
    // Photons, read noise and rounding to whole words.
    const double expected = electrons + 9.0 + 1.0 / 12.0;
    // 4.5 sigma: a false alarm in 150 000 for each of the 8 checks. The table of normals ends
    // at 4.3 sigma, which lowers its variance by 4e-4.
    EXPECT_NEAR(mean, electrons, 4.5 * std::sqrt(expected / n)) << electrons;
    EXPECT_NEAR(variance, expected, 4.5 * expected * std::sqrt(2.0 / n) + 5e-4 * expected)
        << electrons;
  }
}

TEST_F(VirtualCameraTest, DarkFramesHoldReadNoiseRoundTheBlackLevel) {
  const firmware_iface::LightHistory history{{state(0, 1, {})}, true};
  const auto words = take(test_camera(), history, {1'000'000'000, 2000.0, 0.0}, {.seed = 3});
  double sum = 0.0;
  double sum2 = 0.0;
  constexpr double kN = 48.0 * 64.0;
  for (int i = 0; i < 48 * 64; ++i) {
    const double e = words.pixels()[static_cast<std::size_t>(i)] - 256.0;
    sum += e;
    sum2 += e * e;
  }
  EXPECT_NEAR(sum / kN, 0.0, 4.5 * 3.02 / std::sqrt(kN));
  EXPECT_NEAR(sum2 / kN, 9.083, 4.5 * 9.083 * std::sqrt(2.0 / kN));
}

TEST_F(VirtualCameraTest, ClipsAtTheFullWellAndAtWhite) {
  CameraSpec spec = test_camera();
  const firmware_iface::LightHistory history{{state(0, 1, {{0, 65535}})}, true};
  const Exposure exposure{1'000'000'000, 2000.0, 0.0};
  EXPECT_EQ(take(spec, history, exposure, quiet(1e6))(0, 0), 256 + 16000);
  spec.noise.gain_e_per_dn = 0.5;
  EXPECT_EQ(take(spec, history, exposure, quiet(1e6))(0, 0), 16383);
  // 20 dB more gain: ten times the words.
  spec.noise.gain_e_per_dn = 1.0;
  EXPECT_EQ(take(spec, history, {1'000'000'000, 2000.0, 20.0}, quiet(100.0))(0, 0), 256 + 1500);
}

TEST_F(VirtualCameraTest, TheSameKeyGivesTheSamePixelsAnotherKeyOthers) {
  const firmware_iface::LightHistory history{{state(0, 1, {{0, 65535}})}, true};
  const Exposure exposure{1'000'000'000, 2000.0, 0.0};
  const auto a = take(test_camera(), history, exposure, {.seed = 4}, 17);
  const auto b = take(test_camera(), history, {9'000'000'000, 2000.0, 0.0}, {.seed = 4}, 17);
  const auto c = take(test_camera(), history, exposure, {.seed = 4}, 18);
  const auto d = take(test_camera(), history, exposure, {.seed = 5}, 17);
  EXPECT_TRUE(std::ranges::equal(a.pixels(), b.pixels()));
  const auto n_same = [&](const Image<std::uint16_t>& other) {
    int n = 0;
    for (int i = 0; i < 48 * 64; ++i) {
      n += a.pixels()[static_cast<std::size_t>(i)] ==
           other.pixels()[static_cast<std::size_t>(i)];
    }
    return n;
  };
  // Two draws of sigma 110 words agree in 1 of 390 pixels: 8 of 3072; 40 is beyond 10 sigma.
  EXPECT_LT(n_same(c), 40);
  EXPECT_LT(n_same(d), 40);
}

TEST_F(VirtualCameraTest, RefusesWhatDoesNotFit) {
  CameraSpec spec = test_camera();
  spec.active_rows = 47;
  EXPECT_THROW(VirtualCamera(spec, controller_, transport_), Error);
  spec = test_camera();
  spec.noise.full_well_e = 0.0;
  EXPECT_THROW(VirtualCamera(spec, controller_, transport_), Error);
  spec = test_camera();
  spec.frame_height = 50;  // two rows hold no 96 blocks of 2 x 2
  EXPECT_THROW(VirtualCamera(spec, controller_, transport_), Error);
}

TEST(TransportFile, RefusesEveryKindOfDamage) {
  const TemporaryFolder folder;
  flat_transport(folder, 8, 4, {1.0F, 2.0F, 3.0F});
  const std::string good = read_file(folder / "transport.bin");
  const auto opens = [&](const std::string& bytes) {
    write_file_atomically(folder / "broken.bin", std::string_view(bytes));
    try {
      static_cast<void>(Transport::open(folder / "broken.bin"));
      return true;
    } catch (const Error& error) {
      EXPECT_FALSE(error.hint().empty());
      return false;
    }
  };
  EXPECT_TRUE(opens(good));
  EXPECT_FALSE(opens(good.substr(0, 100)));
  EXPECT_FALSE(opens(good.substr(0, good.size() - 1)));
  std::string bad = good;
  bad[0] = 'X';
  EXPECT_FALSE(opens(bad));
  bad = good;
  bad[4100] = static_cast<char>(bad[4100] ^ 1);
  EXPECT_FALSE(opens(bad));
  bad = good;
  bad[8] = 9;  // width
  EXPECT_FALSE(opens(bad));
  bad = good;
  bad[16] = 0;  // no lights
  EXPECT_FALSE(opens(bad));
  bad = good;
  for (int i = 24; i < 32; ++i) {
    bad[static_cast<std::size_t>(i)] = '\xff';  // the scale is NaN
  }
  EXPECT_FALSE(opens(bad));
}

}  // namespace
}  // namespace haarlight::sim
