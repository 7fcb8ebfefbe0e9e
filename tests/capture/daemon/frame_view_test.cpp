// SPDX-License-Identifier: Apache-2.0
/// @file
/// What viewers see of a frame: crops, histograms, sharpness, the copies made for them, and the
/// devices' past.

#include "capture/daemon/frame_view.h"

#include <cmath>
#include <random>
#include <set>
#include <thread>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "capture/daemon/daemon_view.h"
#include "capture/daemon/device_report.h"
#include "capture/daemon/frame_tap.h"
#include "capture/daemon/preview_png.h"
#include "capture/daemon/rig_watch.h"
#include "core/virtual_clock.h"
#include "haarlight/capture/daemon/daemon_client.h"
#include "tests/capture/daemon_bench.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

constexpr std::int64_t kSecond = 1'000'000'000;

/// Of a formula of row and column.
template <class F>
Image<std::uint16_t> words_from(int height, int width, F value) {
  Image<std::uint16_t> words(height, width, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      words(y, x) = static_cast<std::uint16_t>(std::lround(value(y, x)));
    }
  }
  return words;
}

PixelRectangle whole(const Image<std::uint16_t>& words) {
  return {0, 0, words.width(), words.height()};
}

// ---- the overview ----

TEST(Overview, IsTheMeanOfEachBlockAndNotOneOfItsPixels) {
  // A chequerboard finer than a block: nearest neighbours show one of its two words.
  const auto words =
      words_from(8, 8, [](int y, int x) { return (x + y) % 2 == 0 ? 3000 : 1000; });
  const Image<std::uint8_t> codes = make_preview_codes(words.view(), 0.0, 4095.0, 4);
  const std::uint8_t mean = GreyCurve(0.0, 4095.0)(2000.0);
  for (const std::uint8_t code : codes.pixels()) {
    EXPECT_EQ(code, mean);
  }
}

TEST(Overview, HidesNothingAtTheRightAndLowerEdge) {
  auto words = words_from(7, 10, [](int, int) { return 500; });
  words(6, 9) = 4095;
  const Image<std::uint8_t> codes = make_preview_codes(words.view(), 0.0, 4095.0, 3);
  ASSERT_EQ(codes.height(), 3);
  ASSERT_EQ(codes.width(), 4);
  EXPECT_EQ(codes(2, 3), kCodeSaturated);
}

TEST(Overview, IsAtMost640PixelsLongWhateverTheCamera) {
  for (const auto& [width, height] :
       {std::pair{1, 1}, std::pair{640, 480}, std::pair{641, 3}, std::pair{2448, 2048},
        std::pair{48, 5000}, std::pair{11648, 8742}}) {
    for (const BayerPattern bayer : {BayerPattern::none, BayerPattern::grbg}) {
      const int step = preview_step(width, height, bayer);
      EXPECT_LE((std::max(width, height) + step - 1) / step, 640) << width << " x " << height;
      EXPECT_TRUE(bayer == BayerPattern::none || step == 1 || step % 2 == 0) << step;
    }
  }
}

// ---- a crop ----

TEST(Crop, ShowsEachPixelAtItsPosition) {
  const auto words = words_from(20, 30, [](int y, int x) { return 100 + 40 * y + x; });
  const WordScale scale{.black_dn = 0.0, .clip_dn = 4095.0, .white_dn = 4095.0};
  const Image<std::uint8_t> codes = make_crop_codes(words.view(), scale, {7, 5, 11, 9});
  ASSERT_EQ(codes.height(), 9);
  ASSERT_EQ(codes.width(), 11);
  const GreyCurve curve(0.0, 4095.0);
  EXPECT_EQ(codes(0, 0), curve(words(5, 7)));
  EXPECT_EQ(codes(8, 10), curve(words(13, 17)));
}

TEST(Crop, OfABayerFrameShowsNoChequerboardAndEveryClippedPixel) {
  // Grey paper under warm light: the three colours differ, the paper does not.
  auto words = words_from(12, 12, [](int y, int x) {
    return y % 2 == 0 ? (x % 2 == 0 ? 3200 : 2000) : (x % 2 == 0 ? 2000 : 800);
  });
  const WordScale scale{.clip_dn = 4095.0, .white_dn = 4095.0, .bayer = BayerPattern::rggb};
  const Image<std::uint8_t> codes = make_crop_codes(words.view(), scale, {0, 0, 12, 12});
  EXPECT_EQ(std::set<std::uint8_t>(codes.pixels().begin(), codes.pixels().end()).size(), 1U);
  words(4, 7) = 4095;
  const Image<std::uint8_t> clipped = make_crop_codes(words.view(), scale, {0, 0, 12, 12});
  EXPECT_EQ(std::count(clipped.pixels().begin(), clipped.pixels().end(), kCodeSaturated), 1);
  EXPECT_EQ(clipped(4, 7), kCodeSaturated);
}

TEST(Crop, OfACameraOfOnePixelIsThatPixel) {
  const auto words = words_from(1, 1, [](int, int) { return 700; });
  for (const BayerPattern bayer : {BayerPattern::none, BayerPattern::bggr}) {
    const WordScale scale{.bayer = bayer};
    EXPECT_EQ(make_crop_codes(words.view(), scale, {0, 0, 1, 1}).pixels().size(), 1U);
    EXPECT_EQ(count_words(words.view(), scale, {0, 0, 1, 1}).back().n, 1U);
    EXPECT_EQ(measure_sharpness(words.view(), scale, {0, 0, 1, 1}).value, 0.0);
  }
}

// ---- counts ----

TEST(Histogram16, CountsEveryWordOfItsColourOnce) {
  const auto words = words_from(40, 60, [](int y, int x) {
    const bool is_red = y % 2 == 1 && x % 2 == 0;  // below left
    const bool is_blue = y % 2 == 0 && x % 2 == 1;
    return is_red ? 65535 : is_blue ? 64 : 30000;
  });
  const WordScale scale{
      .black_dn = 64.0, .clip_dn = 65535.0, .white_dn = 65535.0, .bayer = BayerPattern::gbrg};
  const std::vector<ColourCounts> counts = count_words(words.view(), scale, whole(words));
  ASSERT_EQ(counts.size(), 3U);
  EXPECT_EQ(counts[0].colour, "red");
  EXPECT_EQ(counts[0].n, 600U);
  EXPECT_EQ(counts[0].n_saturated, 600U);
  EXPECT_EQ(counts[0].bins[255], 600U);
  EXPECT_EQ(counts[1].n, 1200U);
  EXPECT_EQ(counts[1].bins[30000 / 256], 1200U);
  EXPECT_DOUBLE_EQ(counts[1].mean_dn, 30000.0);
  EXPECT_EQ(counts[2].n_black, 600U);
}

TEST(Histogram16, AWordBeyondWhiteStaysInTheLastBin) {
  const auto words = words_from(2, 2, [](int, int) { return 60000; });
  const WordScale scale{.clip_dn = 4095.0, .white_dn = 4095.0};
  EXPECT_EQ(count_words(words.view(), scale, whole(words))[0].bins[255], 4U);
}

// ---- sharpness ----

/// A pattern of stripes, blurred as by a lens out of focus, exposed, with shot and read noise.
Image<std::uint16_t> exposed(double blur_pixels, double exposure, double black, unsigned seed,
                             const SensorNoise& noise) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const double contrast = std::exp(-2.0 * std::pow(M_PI * blur_pixels / 12.0, 2));
  return words_from(200, 200, [&](int y, int x) {
    const double light = 1.0 + 0.6 * contrast * std::sin(2.0 * M_PI * x / 12.0) +
                         0.3 * contrast * std::sin(2.0 * M_PI * y / 12.0);
    const double electrons = exposure * light;
    const double sigma = std::sqrt(electrons + noise.read_e * noise.read_e);
    return std::max(0.0, black + (electrons + sigma * normal(random)) / noise.gain_e_per_dn);
  });
}

TEST(Sharpness, DoesNotDependOnTheExposure) {
  const SensorNoise noise{.gain_e_per_dn = 2.0, .read_e = 6.0, .full_well_e = 120000.0};
  const WordScale scale{.black_dn = 200.0, .clip_dn = 65535.0, .noise = noise};
  std::vector<double> values;
  for (const double exposure : {500.0, 2000.0, 8000.0, 32000.0}) {
    const auto words = exposed(1.0, exposure, 200.0, 7, noise);
    values.push_back(measure_sharpness(words.view(), scale, whole(words)).value);
  }
  // Of 80 000 differences: 1 / sqrt(80 000) of the noise's own part, 1.1 of the signal's at
  // the shortest exposure; 3 % is six of these.
  for (const double value : values) {
    EXPECT_NEAR(value / values.back(), 1.0, 0.03);
  }
}

TEST(Sharpness, FallsAsTheBlurGrows) {
  const SensorNoise noise{.gain_e_per_dn = 2.0, .read_e = 6.0, .full_well_e = 120000.0};
  const WordScale scale{.black_dn = 200.0, .clip_dn = 65535.0, .noise = noise};
  double last = 10.0;
  for (const double blur : {0.0, 1.0, 2.0, 3.0, 4.0}) {
    const auto words = exposed(blur, 8000.0, 200.0, 11, noise);
    const double value = measure_sharpness(words.view(), scale, whole(words)).value;
    EXPECT_LT(value, 0.95 * last) << blur;
    last = value;
  }
}

TEST(Sharpness, IsThatOfTheClosedForm) {
  // One sine along x: mean square of its differences to the right is 2 a^2 sin^2(pi / p), and
  // nothing below; half of the pairs are each. 240 pairs per row: whole periods.
  const auto words = words_from(
      241, 241, [](int, int x) { return 20000.0 + 8000.0 * std::sin(2.0 * M_PI * x / 12.0); });
  const Sharpness sharpness = measure_sharpness(words.view(), WordScale{}, {0, 0, 241, 241});
  const double expected = 0.4 * std::sin(M_PI / 12.0);
  EXPECT_NEAR(sharpness.value, expected, 1e-4 * expected);  // words are rounded
  EXPECT_EQ(sharpness.noise, 0.0);
  EXPECT_EQ(sharpness.fraction_used, 1.0);
}

TEST(Sharpness, OfABayerFrameIsNotTheDifferenceOfItsColours) {
  const auto words = words_from(64, 64, [](int y, int x) {
    return y % 2 == 0 ? (x % 2 == 0 ? 3000 : 2000) : (x % 2 == 0 ? 2000 : 500);
  });
  const WordScale scale{.white_dn = 4095.0, .bayer = BayerPattern::rggb};
  EXPECT_EQ(measure_sharpness(words.view(), scale, whole(words)).value, 0.0);
}

TEST(Sharpness, LeavesSaturatedPairsOutAndSaysSo) {
  const auto words = words_from(
      50, 50, [](int, int x) { return x < 25 ? 65535.0 : 20000.0 + 100.0 * (x % 2); });
  const Sharpness sharpness = measure_sharpness(words.view(), WordScale{}, whole(words));
  EXPECT_NEAR(sharpness.fraction_used, 0.5, 0.02);
  EXPECT_NEAR(sharpness.level_dn, 20050.0, 5.0);
}

TEST(Sharpness, OfDarknessIsNothing) {
  const auto words = words_from(9, 9, [](int, int) { return 64; });
  const WordScale scale{.black_dn = 64.0};
  EXPECT_EQ(measure_sharpness(words.view(), scale, whole(words)).value, 0.0);
}

// ---- the copies for viewers ----

std::shared_ptr<const Frame> frame_of(const Image<std::uint16_t>& words, std::uint64_t sequence,
                                      std::atomic<int>& n_released) {
  return std::make_shared<const Frame>(FrameInfo{.sequence = sequence}, words.view(),
                                       [&n_released] { ++n_released; });
}

class FrameTapTest : public ::testing::Test {
 protected:
  VirtualClock clock_;
  VirtualClock::Member here_{clock_};
  FrameTap tap_{clock_};
};

TEST_F(FrameTapTest, WantsNothingUntilSomebodyLooks) {
  EXPECT_FALSE(tap_.is_wanted(clock_.now_ns()));
  EXPECT_EQ(tap_.newest(), nullptr);
  EXPECT_TRUE(tap_.is_wanted(clock_.now_ns()));
  EXPECT_FALSE(tap_.is_wanted(clock_.now_ns() + 3 * kSecond)) << "a look lasts two seconds";
}

TEST_F(FrameTapTest, CopiesTheActiveRowsAndGivesTheBufferBack) {
  const auto words = words_from(12, 10, [](int y, int x) { return 100 * y + x; });
  std::atomic<int> n_released = 0;
  (void)tap_.newest();
  tap_.offer(frame_of(words, 41, n_released), 8, clock_.now_ns());
  clock_.sleep_for(1ms);  // the copy takes no virtual time
  const std::shared_ptr<const TappedFrame> copy = tap_.newest();
  ASSERT_NE(copy, nullptr);
  EXPECT_EQ(copy->sequence, 41U);
  EXPECT_EQ(copy->number, 1U);
  EXPECT_EQ(copy->words.height(), 8);
  EXPECT_EQ(copy->words(7, 9), 709);
  EXPECT_EQ(n_released, 1);
  EXPECT_FALSE(tap_.is_wanted(clock_.now_ns())) << "five per second";
  tap_.forget();
  EXPECT_EQ(tap_.newest(), nullptr);
}

TEST_F(FrameTapTest, TenViewersCostFiveCopiesPerSecond) {
  const auto words = words_from(12, 10, [](int, int) { return 7; });
  std::atomic<int> n_released = 0;
  (void)tap_.newest();                                   // the first look waits for a frame
  for (std::uint64_t frame = 0; frame < 200; ++frame) {  // 100 per second
    for (int viewer = 0; viewer < 10; ++viewer) {
      (void)tap_.newest();
    }
    if (tap_.is_wanted(clock_.now_ns())) {
      tap_.offer(frame_of(words, frame, n_released), 8, clock_.now_ns());
    }
    clock_.sleep_for(10ms);
  }
  EXPECT_EQ(tap_.n_copied(), 10U);
  EXPECT_EQ(n_released, 10);
}

class ViewTest : public testing::DaemonBench {
 protected:
  DaemonClient client() {
    return DaemonClient({.url = "http://127.0.0.1:" + std::to_string(daemon_->http_port())});
  }
  void light(DaemonClient& client) {
    EXPECT_EQ(client.post("/v1/preview", "{\"lights\": [5]}").status, 202);
    ASSERT_TRUE(wait_until([](const DaemonState& s) {
      return s.is_preview && s.step == ShotStep::collect && s.counters.frames > 0;
    }));
  }
};

TEST_F(ViewTest, ARunThatNobodyLooksAtCopiesNoFrame) {
  start();
  (void)daemon_->run("schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\n", "");
  ASSERT_TRUE(wait_for(Phase::done));
  EXPECT_EQ(daemon_->n_frames_shown(), 0U);
}

TEST_F(ViewTest, TenViewersShareTheCopies) {
  start(true);
  DaemonClient first = client();
  light(first);
  std::vector<std::jthread> viewers;
  std::atomic<int> n_pictures = 0;
  const auto begun = std::chrono::steady_clock::now();
  for (int i = 0; i < 10; ++i) {
    viewers.emplace_back([this, &n_pictures] {
      DaemonClient one = client();
      while (n_pictures <= 20 || daemon_->n_frames_shown() < 2) {
        n_pictures += one.get("/v1/preview.png?x=0&y=0&width=8&height=8").status == 200 ? 1 : 0;
      }
    });
  }
  viewers.clear();
  const std::chrono::duration<double> length = std::chrono::steady_clock::now() - begun;
  EXPECT_LE(static_cast<double>(daemon_->n_frames_shown()), 5.0 * length.count() + 2.0);
}

TEST_F(ViewTest, CropsAreCheckedAgainstTheFrame) {
  start(true);
  DaemonClient client = this->client();
  light(client);
  const int width = rig_.cameras.front().frame_width;
  const int height = rig_.cameras.front().active_rows;
  const auto ask = [&](const std::string& query) {
    return client.get("/v1/preview.png?" + query).status;
  };
  EXPECT_EQ(ask("x=0&y=0&width=16&height=16"), 200);
  EXPECT_EQ(ask(fmt::format("x={}&y={}&width=1&height=1", width - 1, height - 1)), 200);
  for (const std::string& query :
       {fmt::format("x={}&y=0&width=1&height=1", width),
        fmt::format("x=0&y={}&width=1&height=1", height),
        std::string("x=-1&y=0&width=4&height=4"), std::string("x=0&y=0&width=0&height=4"),
        std::string("x=0&y=0&width=4"), std::string("x=1e3&y=0&width=4&height=4"),
        std::string("x=2147483647&y=0&width=2147483647&height=4"),
        std::string("x=99999999999&y=0&width=4&height=4")}) {
    EXPECT_EQ(ask(query), 400) << query;
    EXPECT_EQ(client.get("/v1/preview/facts?" + query).status, 400) << query;
  }
  const auto facts = nlohmann::json::parse(client.get("/v1/preview/facts").body);
  EXPECT_EQ(facts["frame"]["width"], width);
  EXPECT_EQ(facts["histogram"][0]["pixels"], width * height);
}

TEST_F(ViewTest, WhoHasTheNewestFrameIsToldSo) {
  start(true);
  DaemonClient client = this->client();
  light(client);
  ASSERT_EQ(client.get("/v1/preview.png").status, 200);
  hands_->is_silent = true;  // no more frames
  std::this_thread::sleep_for(300ms);
  const auto frame = daemon_->newest_frame();
  ASSERT_NE(frame, nullptr);
  EXPECT_EQ(client.get(fmt::format("/v1/preview.png?after={}", frame->number)).status, 204);
  EXPECT_EQ(client.get(fmt::format("/v1/preview.png?after={}", frame->number - 1)).status, 200);
}

TEST(PngResponse, RefusesACropBeyondItsLimit) {
  const auto words = words_from(4, kMaxCrop + 1, [](int, int) { return 9; });
  EXPECT_THROW((void)png_response(words.view(), {}, PixelRectangle{0, 0, kMaxCrop + 1, 4}),
               Error);
  EXPECT_EQ(png_response(words.view(), {}, PixelRectangle{1, 0, kMaxCrop, 4}).status, 200);
}

// ---- the devices' past ----

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

RigWatch::Patterns patterns_of_one(std::uint16_t level) {
  return std::make_shared<const std::vector<std::vector<firmware_iface::ElementLevel>>>(
      std::vector<std::vector<firmware_iface::ElementLevel>>{{{.element = 3, .level = level}}});
}

TEST(RigWatch, PowerIsThatOfThePatternsShown) {
  const Rig rig = small_rig();
  RigWatch watch(rig, 0);
  watch.begin(patterns_of_one(65535));
  watch.see(kSecond, Action(action::ShowShot{.job = 4, .shot = 0}));
  watch.see(kSecond, EventBody(event::LightShown{.job = 4}));
  watch.see(3 * kSecond / 2, EventBody(event::LightDark{}));
  const RigHistory history = watch.history(4 * kSecond, HistorySpan::minutes);
  const double watts = rig.faces.front().element_power.value();
  ASSERT_EQ(history.watts.size(), 4U);
  EXPECT_EQ(history.watts[0], 0.0);
  EXPECT_NEAR(history.watts[1], 0.5 * watts, 1e-9);
  EXPECT_EQ(history.watts[2], 0.0);
}

TEST(RigWatch, DutyFollowsTheDriveWithTheFacesTimeConstant) {
  const Rig rig = small_rig();
  const double tau = rig.faces.front().heat_tau_s;
  RigWatch watch(rig, 0);
  watch.begin(patterns_of_one(32768));
  watch.see(0, Action(action::ShowShot{.job = 4, .shot = 0}));
  watch.see(0, EventBody(event::LightShown{.job = 4}));
  watch.see(5 * kSecond, EventBody(event::LightDark{}));
  const RigHistory history = watch.history(8 * kSecond, HistorySpan::minutes);
  const double drive = 32768.0 / 65535.0;
  ASSERT_EQ(history.duty.size(), 8U);
  EXPECT_NEAR(history.duty[4], drive * (1.0 - std::exp(-5.0 / tau)), 1e-9);
  EXPECT_NEAR(history.duty[7], history.duty[4] * std::exp(-3.0 / tau), 1e-9);
}

TEST(RigWatch, TemperatureIsTheMeanOfWhatTheControllerSaid) {
  RigWatch watch(small_rig(), 0);
  watch.see(kSecond / 2, EventBody(event::LightConfirmed{.temperature_c = 30.0}));
  watch.see(3 * kSecond / 4, EventBody(event::LightConfirmed{.temperature_c = 31.0}));
  const RigHistory history = watch.history(2 * kSecond, HistorySpan::minutes);
  ASSERT_EQ(history.temperature_c.size(), 2U);
  EXPECT_EQ(history.temperature_c[0], 30.5);
  EXPECT_EQ(history.temperature_c[1], std::nullopt) << "nobody polled in that second";
}

TEST(RigWatch, ThePastIsBoundedAlsoAfterADayOfSilence) {
  RigWatch watch(small_rig(), 0);
  for (int i = 0; i < 700; ++i) {
    watch.see(i * kSecond, EventBody(event::FrameArrived{}));
  }
  EXPECT_EQ(watch.history(700 * kSecond, HistorySpan::minutes).watts.size(), 600U);
  EXPECT_EQ(watch.history(700 * kSecond, HistorySpan::hours).watts.size(), 11U);
  EXPECT_NEAR(watch.history(700 * kSecond, HistorySpan::hours).frames[3], 1.0, 1e-13);
  const RigHistory later = watch.history(100'000 * kSecond, HistorySpan::hours);
  EXPECT_EQ(later.watts.size(), 720U);
  EXPECT_EQ(later.frames.back(), 0.0);
}

TEST(RigWatch, SaysHowTheDevicesStand) {
  RigWatch watch(small_rig(), 0);
  EXPECT_EQ(watch.controller().link, DeviceState::Link::unused);
  watch.see(1, EventBody(event::LightConnected{}));
  EXPECT_EQ(watch.controller().link, DeviceState::Link::good);
  watch.see(2, EventBody(event::LightFault{1, Errc::device_busy, "overtaken by off"}));
  EXPECT_EQ(watch.controller().problem, "");
  watch.see(3, EventBody(event::LightFault{1, Errc::refused, "interlock open"}));
  EXPECT_EQ(watch.controller().link, DeviceState::Link::good);
  EXPECT_EQ(watch.controller().problem, "interlock open");
  watch.see(4, EventBody(event::LightFault{1, Errc::timeout, "no answer"}));
  EXPECT_EQ(watch.controller().link, DeviceState::Link::lost);
  watch.see(5, EventBody(event::CameraFault{1, Errc::device_gone, "unplugged"}));
  EXPECT_EQ(watch.camera().link, DeviceState::Link::lost);
  watch.see(6, EventBody(event::CameraStarted{}));
  watch.see(7, Action(action::StopCamera{}));
  EXPECT_EQ(watch.camera().link, DeviceState::Link::unused);
}

TEST(DeviceReport, NamesWhatIsWrongAndTheHint) {
  const testing::TemporaryFolder folder;
  Rig rig = small_rig();
  rig.cameras.front().device = (folder.path() / "none.sock").string();
  const DeviceState lost{.link = DeviceState::Link::lost,
                         .since_ns = 0,
                         .problem = "no answer in 300 ms",
                         .code = Errc::timeout};
  const std::vector<DoctorLine> lines =
      report_devices(rig, folder.path(), lost, DeviceState{}, 9 * kSecond);
  EXPECT_EQ(lines.at(0).subject, "controller");
  EXPECT_EQ(lines.at(0).finding, Finding::wrong);
  EXPECT_THAT(lines.at(0).found, HasSubstr("lost for 9 s: no answer in 300 ms"));
  EXPECT_THAT(lines.at(0).hint.text(), HasSubstr("switched on"));
  EXPECT_EQ(lines.at(1).finding, Finding::wrong);
  EXPECT_THAT(lines.at(1).hint.text(), HasSubstr("start the camera's program"));
  EXPECT_EQ(lines.at(2).subject, "disk");
  EXPECT_EQ(lines.at(2).finding, Finding::good);
  const DeviceState good{.link = DeviceState::Link::good};
  const std::vector<DoctorLine> well =
      report_devices(rig, folder.path(), good, good, 9 * kSecond);
  EXPECT_EQ(well.at(1).finding, Finding::good) << "in use: not looked at from outside";
  const std::vector<DoctorLine> no_disk =
      report_devices(rig, folder.path() / "gone", good, good, 9 * kSecond);
  EXPECT_EQ(no_disk.at(2).finding, Finding::wrong);
}

}  // namespace
}  // namespace haarlight::capture
