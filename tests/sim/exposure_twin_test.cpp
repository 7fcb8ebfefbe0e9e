// SPDX-License-Identifier: Apache-2.0
/// @file
/// Captures of the virtual camera, developed: what each step costs and what error it leaves,
/// against the radiance that the camera was given. The figures of docs/numerics/exposure.md:
///
///     build/release/tests/sim/sim_develop_test --gtest_filter='Exposure*'

#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon/writer_thread.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/session/develop/develop.h"
#include "session/clean_rule.h"
#include "session/frame_check.h"
#include "session/session_writer.h"
#include "sim/virtual_camera.h"
#include "tests/sim/made_transport.h"

namespace haarlight::sim {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::TemporaryFolder;

constexpr std::int64_t kSecond = 1'000'000'000;

/// The 8 x 8 rig, its camera and a made-up scene of 4 decades under each light.
class ExposureTwin : public ::testing::Test {
 protected:
  ExposureTwin() : rig_(read_rig_as_written(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    const CameraSpec& camera = rig_.cameras.front();
    TransportData data;
    data.width = camera.frame_width;
    data.height = camera.active_rows;
    data.n_lights = rig_.n_lights();
    data.key = std::string(32, 'a');
    data.seconds = 1.0;
    for (int k = 0; k < data.n_lights; ++k) {
      for (int y = 0; y < data.height; ++y) {
        for (int x = 0; x < data.width; ++x) {
          // A ramp of 4 decades down the picture, 2.5 times as bright in its right half.
          const double decade = -3.5 + 4.0 * y / data.height;
          const double side = x < data.width / 2 ? 1.0 : 2.5;
          planes_.push_back(static_cast<float>(std::pow(10.0, decade) * side *
                                               (1.0 + 0.3 * std::sin(0.7 * k + 0.11 * x))));
        }
      }
    }
    data.planes = planes_;
    write_transport(folder_ / "transport.bin", data);
    transport_ = std::make_unique<Transport>(Transport::open(folder_ / "transport.bin"));
  }

  /// Captures a plan, one shot every `period_s`, and opens the session.
  session::Session capture(const std::string& name, const std::string& keys,
                           const VirtualCameraOptions& options, const Transport& transport,
                           double period_s = 0.1) {
    const capture::Plan plan = capture::expand_plan(
        capture::parse_plan_file("schema = 1\nname = \"p\"\n" + keys, "plan.toml"), rig_);
    VirtualCamera camera(rig_.cameras.front(), rig_.controller, transport, options);
    session::DiskStorage storage;
    const fs::path folder = folder_.path() / name;
    auto writer =
        session::SessionWriter::create(folder, capture::session_info_of(rig_, plan, name),
                                       rig_.text, capture::plan_to_json(plan), 0, storage);
    EXPECT_TRUE(writer.has_value()) << writer.error().what;
    std::vector<Image<std::uint16_t>> words;
    std::vector<session::PendingFrame> frames;
    words.reserve(plan.shots.size());
    for (const session::Shot& shot : plan.shots) {
      const std::int64_t t = std::llround((shot.index + 1.0) * period_s * kSecond);
      words.emplace_back(rig_.cameras.front().frame_height, rig_.cameras.front().frame_width,
                         1);
      frames.push_back({shot.index, 0, take(camera, shot, t, writer->info(), words.back()),
                        words.back().view()});
    }
    const auto done = writer->commit(frames);
    EXPECT_TRUE(done.has_value()) << done.error().what;
    const auto finished = writer->finish();
    EXPECT_TRUE(finished.has_value()) << finished.error().what;
    return session::Session::open(folder);
  }

  session::Session capture(const std::string& name, const std::string& keys,
                           const VirtualCameraOptions& options, double period_s = 0.1) {
    return capture(name, keys, options, *transport_, period_s);
  }

  session::FrameEvidence take(VirtualCamera& camera, const session::Shot& shot, std::int64_t t,
                              const session::SessionInfo& info, Image<std::uint16_t>& words) {
    std::vector<firmware_iface::ElementLevel> lit;
    for (const session::LightLevel& light : shot.lit) {
      lit.push_back({light.light, light.level});
    }
    const firmware_iface::LightHistory history{
        {{t, static_cast<std::uint32_t>(shot.index) + 1,
          std::make_shared<const std::vector<firmware_iface::ElementLevel>>(lit)}},
        true};
    const CameraSpec& spec = rig_.cameras.front();
    const Exposure exposure{t + 10'000'000, shot.exposure_us, spec.gain_db};
    camera.take(history, exposure, camera.look(history, exposure),
                static_cast<std::uint64_t>(shot.index), words.view());
    session::FrameEvidence e;
    e.pattern_id = shot.index;
    e.tag = static_cast<std::uint32_t>(shot.index) + 1;
    e.tag_echo = e.tag;
    e.t_command_ns = t;
    e.t_ack_ns = t + 1'000'000;
    e.t_stable_ns = t + 2'000'000;
    e.exposure_requested_us = shot.exposure_us;
    e.exposure_read_us = shot.exposure_us;
    e.gain_db = spec.gain_db;
    e.read_us = spec.read_us;
    e.timestamp_ns = camera.timestamp_ns(exposure);
    e.timestamp_meaning = spec.timestamp;
    const session::ExposureWindow window = session::exposure_window(
        {e.timestamp_ns, e.timestamp_meaning, e.exposure_read_us, e.read_us, e.skew_us});
    e.t_exposure_start_ns = window.start_ns;
    e.t_exposure_end_ns = window.end_ns;
    e.t_next_change_ns = window.end_ns + 1'000'000;
    e.margin_us = session::assess_clean(window, e.t_stable_ns, e.t_next_change_ns).margin_us;
    e.sequence = static_cast<std::uint64_t>(shot.index);
    const ImageView<const std::uint16_t> active(words.pixels().data(), spec.active_rows,
                                                spec.frame_width, 1);
    session::describe_pixels(active, info.form, e);
    return e;
  }

  /// Radiance of light k as develop states it: fractions of the range per second.
  [[nodiscard]] double truth(int k, std::size_t pixel) const {
    const CameraSpec& spec = rig_.cameras.front();
    const double range = ((1 << spec.bits) - 1) - spec.noise.black_dn;
    const std::size_t n =
        static_cast<std::size_t>(spec.frame_width) * static_cast<std::size_t>(spec.active_rows);
    return planes_[static_cast<std::size_t>(k) * n + pixel] / transport_->scale() * kLit /
           spec.noise.gain_e_per_dn / range / (spec.exposure_us * 1e-6);
  }

  struct Error2 {
    double relative_rms = 0.0;  ///< over values whose signal to noise ratio exceeds 30
    double bias = 0.0;          ///< mean relative error of these
    double spread = 0.0;        ///< rms about the bias
    double z_rms = 0.0;         ///< error / standard error, over all that are not saturated
    std::uint64_t n_saturated = 0;
    double ms = 0.0;
  };
  Error2 errors(const session::Session& session, const session::RadiometryOptions& steps) {
    session::DevelopOptions options;
    // Of bins: the object itself, so that sharing out is exact and only noise is left.
    options.plate.key = "truth";
    options.plate.read = [this](int y, int x0, int x1, std::span<float> out) {
      for (int x = x0; x < x1; ++x) {
        for (int k = 0; k < 64; ++k) {
          const auto at = static_cast<std::size_t>(x - x0) * 64 + static_cast<std::size_t>(k);
          const auto width = static_cast<std::size_t>(rig_.cameras.front().frame_width);
          out[at] = static_cast<float>(
              truth(k, static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x)));
        }
      }
    };
    options.radiometry = steps;
    options.use_cache = false;
    const auto t0 = std::chrono::steady_clock::now();
    (void)session::develop(session, options);
    const auto t1 = std::chrono::steady_clock::now();
    options.has_standard_error = true;
    const session::Developed developed = session::develop_all(session, options);
    Error2 out;
    out.ms = std::chrono::duration<double, std::milli>(t1 - t0).count();
    double n = 0.0;
    double n_all = 0.0;
    for (int k = 0; k < developed.stack.dims().n_lights; ++k) {
      const Image<float> value = developed.stack.light_images(k, 1).front();
      const Image<float> sigma = developed.standard_error->light_images(k, 1).front();
      for (std::size_t i = 0; i < value.pixels().size(); ++i) {
        if (sigma.pixels()[i] < 0.0F) {
          ++out.n_saturated;
          continue;
        }
        const double error = value.pixels()[i] - truth(k, i);
        const double z = error / sigma.pixels()[i];
        out.z_rms += z * z;
        n_all += 1.0;
        if (truth(k, i) > 30.0 * sigma.pixels()[i]) {
          const double relative = error / truth(k, i);
          out.relative_rms += relative * relative;
          out.bias += relative;
          n += 1.0;
        }
      }
    }
    out.relative_rms = std::sqrt(out.relative_rms / n);
    out.bias /= n;
    out.spread = std::sqrt(out.relative_rms * out.relative_rms - out.bias * out.bias);
    out.z_rms = std::sqrt(out.z_rms / n_all);
    return out;
  }

  static void print(const char* what, const Error2& e) {
    fmt::print(
        "{:<44} spread {:7.4f} %  bias {:8.4f} %  z {:6.3f}  saturated {:6}  {:6.1f} ms\n",
        what, 100.0 * e.spread, 100.0 * e.bias, e.z_rms, e.n_saturated, e.ms);
  }

  static constexpr double kLit = 600.0;
  TemporaryFolder folder_;
  Rig rig_;
  std::vector<float> planes_;
  std::unique_ptr<Transport> transport_;
};

VirtualCameraOptions with(RigFlaws flaws) {
  VirtualCameraOptions options;
  options.seed = 5;
  options.lit_electrons = 600.0;
  options.flaws = flaws;
  return options;
}

const std::string kOne = "patterns = \"one_at_a_time\"\n";
const std::string kBracket = kOne + "exposures_us = [250, 2000, 16000]\n";

TEST_F(ExposureTwin, BracketsReachTheStatedErrorOverFourDecades) {
  const Error2 single = errors(capture("single", kOne, with({})), {});
  const Error2 merged = errors(capture("bracket", kBracket, with({})), {});
  print("one exposure, 2 ms", single);
  print("three exposures, 0.25 : 2 : 16 ms", merged);
  // 64 x 3072 values: the standard error of z is 0.0016.
  EXPECT_NEAR(single.z_rms, 1.0, 0.02);
  EXPECT_NEAR(merged.z_rms, 1.0, 0.02);
  EXPECT_EQ(merged.n_saturated, 0U);
  EXPECT_LT(std::abs(merged.bias), 1e-3);
}

TEST_F(ExposureTwin, MultiplexedLightsReachTheStatedError) {
  // The brightest pixel of 32 lights together keeps below the well at 6 us.
  const std::string at_6 = "exposures_us = [6]\npatterns = ";
  struct Case {
    const char* name;
    std::string keys;
    double least_z;
  };
  const RigFlaws dark{.dark_e_per_s = 2e5};
  // Noise of all lights of a pixel is one draw of 63 shots: 64 x 3072 values stand for at least
  // 3072 x 63 draws, 0.0016 of z. 8 dark frames are common to all: 8 x 3072 draws besides. A
  // sample's photon noise is taken from the sample, not below 0: without light that adds 0.4
  // sigmas, 1.2 to 9 electrons^2 at most, so that z is 0.94 where all is dark.
  for (const Case& c :
       {Case{"S-matrix of 64", at_6 + "\"s_matrix\"\n", 0.97},
        Case{"all Haar wavelets", "exposures_us = [3]\npatterns = \"haar\"\n", 0.94},
        Case{"bins of 2 x 2", at_6 + "\"bins\"\nbin = 2\n", 0.97},
        Case{"S-matrix in a bracket", "exposures_us = [2, 6]\npatterns = \"s_matrix\"\n", 0.97},
        Case{"S-matrix, 8 darks", at_6 + "\"s_matrix\"\ndarks_every = 9\n", 0.97},
        Case{"bins, 2 darks", at_6 + "\"bins\"\nbin = 2\ndarks_every = 16\n", 0.97}}) {
    const bool has_darks = c.keys.find("darks") != std::string::npos;
    const Error2 found =
        errors(capture(c.name, c.keys, with(has_darks ? dark : RigFlaws{})), {});
    print(c.name, found);
    EXPECT_EQ(found.n_saturated, 0U) << c.name;
    EXPECT_GT(found.z_rms, c.least_z) << c.name;
    EXPECT_LT(found.z_rms, 1.02) << c.name;
  }
}

TEST_F(ExposureTwin, RepeatsOfAnSMatrixScatterAsStated) {
  // Without the truth: 12 captures of other noise, the variance of each pixel of each light.
  constexpr int kRepeats = 12;
  std::vector<double> sum(std::size_t{64} * 3072, 0.0);
  std::vector<double> square(std::size_t{64} * 3072, 0.0);
  std::vector<double> stated(std::size_t{64} * 3072, 0.0);
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    VirtualCameraOptions options = with({});
    options.seed = 100 + static_cast<std::uint64_t>(repeat);
    const session::Session session =
        capture(fmt::format("repeat{}", repeat),
                "exposures_us = [6]\npatterns = \"s_matrix\"\n", options);
    const session::Developed developed =
        session::develop_all(session, {.use_cache = false, .has_standard_error = true});
    for (int k = 0; k < 64; ++k) {
      const Image<float> value = developed.stack.light_images(k, 1).front();
      const Image<float> sigma = developed.standard_error->light_images(k, 1).front();
      for (std::size_t i = 0; i < value.pixels().size(); ++i) {
        const std::size_t at = static_cast<std::size_t>(k) * 3072 + i;
        sum[at] += value.pixels()[i];
        square[at] += double{value.pixels()[i]} * value.pixels()[i];
        ASSERT_GT(sigma.pixels()[i], 0.0F);
        stated[at] += double{sigma.pixels()[i]} * sigma.pixels()[i] / kRepeats;
      }
    }
  }
  double ratio = 0.0;
  for (std::size_t at = 0; at < sum.size(); ++at) {
    const double variance = (square[at] - sum[at] * sum[at] / kRepeats) / (kRepeats - 1);
    ratio += variance / stated[at] / static_cast<double>(sum.size());
  }
  fmt::print("variance of {} repeats over the stated one: {:.4f}\n", kRepeats, ratio);
  // Each pixel's 64 lights share 63 shots' noise: at least 3072 x 11 degrees of freedom.
  EXPECT_NEAR(ratio, 1.0, 4.0 * std::sqrt(2.0 / (3072.0 * 11.0)));
}

TEST_F(ExposureTwin, NoiseOfTheStackIsItsDistanceFromTheLight) {
  const session::Session session = capture("noise", kOne, with({}));
  const std::optional<double> stated =
      relight::measure_noise(session, relight::PlateChoice::parse("none"), {});
  ASSERT_TRUE(stated.has_value());
  const session::Developed developed =
      session::develop_all(session, {.has_standard_error = true});
  double error = 0.0;
  double energy = 0.0;
  for (int k = 0; k < 64; ++k) {
    const Image<float> value = developed.stack.light_images(k, 1).front();
    const Image<float> sigma = developed.standard_error->light_images(k, 1).front();
    for (std::size_t i = 0; i < value.pixels().size(); ++i) {
      if (sigma.pixels()[i] >= 0.0F) {  // a clipped value's error is no noise
        error += std::pow(value.pixels()[i] - truth(k, i), 2);
      }
      energy += double{value.pixels()[i]} * value.pixels()[i];
    }
  }
  const double found = std::sqrt(error / energy);
  fmt::print("noise stated {:.4f}, found {:.4f}\n", *stated, found);
  // 16 of 48 rows are looked at; each stands for its neighbours.
  EXPECT_NEAR(*stated / found, 1.0, 0.05);
}

TEST_F(ExposureTwin, NoiseOfAStackThatClipsIsThatOfItsRepeats) {
  // A clipped value is the same number each time: it has no noise, and its energy counts.
  VirtualCameraOptions options = with({});
  options.lit_electrons = 6000.0;
  const session::Session first = capture("clips1", kOne, options);
  options.seed += 1;
  const session::Session second = capture("clips2", kOne, options);
  const std::optional<double> stated =
      relight::measure_noise(first, relight::PlateChoice::parse("none"), {});
  ASSERT_TRUE(stated.has_value());
  const session::Developed a = session::develop_all(first, {.has_standard_error = true});
  const session::Developed b = session::develop_all(second, {});
  double apart = 0.0;
  double energy = 0.0;
  double clipped_energy = 0.0;
  for (int k = 0; k < 64; ++k) {
    const Image<float> value = a.stack.light_images(k, 1).front();
    const Image<float> again = b.stack.light_images(k, 1).front();
    const Image<float> sigma = a.standard_error->light_images(k, 1).front();
    for (std::size_t i = 0; i < value.pixels().size(); ++i) {
      const double v = value.pixels()[i];
      apart += 0.5 * std::pow(v - double{again.pixels()[i]}, 2);
      energy += v * v;
      clipped_energy += sigma.pixels()[i] < 0.0F ? v * v : 0.0;
    }
  }
  const double found = std::sqrt(apart / energy);
  fmt::print("noise stated {:.5f}, of two captures {:.5f}; clipped: {:.2f} of the energy\n",
             *stated, found, clipped_energy / energy);
  EXPECT_GT(clipped_energy, 0.3 * energy);
  // 16 of 48 rows are looked at; each stands for its neighbours.
  EXPECT_NEAR(*stated / found, 1.0, 0.05);
}

TEST_F(ExposureTwin, MarksWhatIsSaturatedInAllAndNothingElse) {
  VirtualCameraOptions bright = with({});
  bright.lit_electrons = 6000.0;
  bright.has_noise = false;
  const session::Session session = capture("bright", kOne, bright);
  session::DevelopOptions options;
  options.has_standard_error = true;
  const session::Developed developed = session::develop_all(session, options);
  const CameraSpec& spec = rig_.cameras.front();
  std::uint64_t n_true = 0;
  for (int k = 0; k < 64; ++k) {
    const Image<float> value = developed.stack.light_images(k, 1).front();
    const Image<float> sigma = developed.standard_error->light_images(k, 1).front();
    for (std::size_t i = 0; i < value.pixels().size(); ++i) {
      const double electrons = 10.0 * truth(k, i) * spec.exposure_us * 1e-6 *
                               (((1 << spec.bits) - 1) - spec.noise.black_dn);
      // 0.97 of the full well: docs/reference/session-format.md.
      const bool is_clipped = std::round(electrons) >= 0.97 * spec.noise.full_well_e;
      n_true += is_clipped ? 1U : 0U;
      ASSERT_EQ(sigma.pixels()[i] < 0.0F, is_clipped) << electrons;
      // A lower bound, never more than the light.
      const double step = 1.0 / (16383.0 - 256.0) / 2e-3;
      ASSERT_LE(value.pixels()[i], 10.0 * truth(k, i) + 0.51 * step);
    }
  }
  EXPECT_GT(n_true, 1000U);
  EXPECT_EQ(developed.n_saturated, n_true);
}

TEST_F(ExposureTwin, DarkFramesTakeDarkCurrentAndHotPixelsAway) {
  // 20000 e/s: 5, 40 and 320 electrons; hot pixels a hundred times that.
  const RigFlaws flaws{.dark_e_per_s = 2e4, .hot_fraction = 0.002, .hot_e_per_s = 2e6};
  const session::Session session =
      capture("dark", kBracket + "darks_every = 16\n", with(flaws));
  const Error2 before = errors(session, {.has_dark = false, .max_level_error = 10.0});
  const Error2 kept = errors(session, {.bad_pixels = session::BadPixels::keep});
  const Error2 after = errors(session, {});
  print("dark current, darks left out", before);
  print("dark current, subtracted, hot pixels kept", kept);
  print("dark current, subtracted, hot pixels inpainted", after);
  EXPECT_GT(before.z_rms, 5.0 * after.z_rms);
  EXPECT_NEAR(kept.z_rms, 1.0, 0.1);
  EXPECT_NEAR(after.z_rms, 1.0, 0.1);
  const session::Developed developed = session::develop_all(session);
  EXPECT_THAT(developed.record, HasSubstr("\"hot\":"));
}

TEST_F(ExposureTwin, DarksOfOtherExposuresAreInterpolated) {
  const RigFlaws flaws{.dark_e_per_s = 2e4};
  // Darks only at 250 and 16000 us would be a plan of its own; here one exposure's darks serve.
  const session::Session session = capture("other", kOne + "darks_every = 8\n", with(flaws));
  const Error2 after = errors(session, {});
  print("dark current, 2 ms alone", after);
  EXPECT_NEAR(after.z_rms, 1.0, 0.05);
}

TEST_F(ExposureTwin, SentinelsTakeTheWarmUpOfTheLedsAway) {
  // 64 shots and 9 sentinels, each a second apart; 10 % brighter at the start, time constant 20
  // s.
  const RigFlaws flaws{.warm_up = 0.10, .warm_up_s = 20.0};
  const session::Session session =
      capture("drift", kOne + "sentinel_every = 8\nsentinel_light = 27\n", with(flaws), 1.0);
  const Error2 before = errors(session, {.has_drift = false});
  const Error2 after = errors(session, {});
  print("warm-up of 10 %, drift left out", before);
  print("warm-up of 10 %, sentinel every 8 shots", after);
  VirtualCameraOptions quiet = with(flaws);
  quiet.has_noise = false;
  const std::string keys = kOne + "sentinel_light = 27\nsentinel_every = ";
  const session::Session still = capture("still", keys + "8\n", quiet, 1.0);
  const Error2 pure = errors(still, {});
  const Error2 dense = errors(capture("dense", keys + "4\n", quiet, 1.0), {});
  print("the same without noise, drift left out", errors(still, {.has_drift = false}));
  print("the same without noise, every 8 shots", pure);
  print("the same without noise, every 4 shots", dense);
  // Linear interpolation of 0.1 exp(-t / 20 s) over 9 s errs by 0.1 (9 / 20)^2 / 8 = 0.25 % at
  // most, a quarter of that every 5 s; rounding to words adds to it.
  EXPECT_LT(pure.spread, 0.0025);
  EXPECT_LT(dense.spread, pure.spread);
  EXPECT_GT(before.spread, 1.4 * after.spread);
  try {
    (void)session::develop(session, {.use_cache = false, .radiometry = {.max_drift = 0.05}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("the sentinel light drifts by"));
    EXPECT_THAT(error.hint(), HasSubstr("--max-drift"));
  }
}

TEST_F(ExposureTwin, AFlatFieldTakesPixelsAndVignettingAway) {
  const RigFlaws flaws{.prnu = 0.01, .vignetting = 0.3};
  const TemporaryFolder flat_folder;
  const Transport even = testing::flat_transport(
      flat_folder, 64, 48, std::vector<float>(static_cast<std::size_t>(rig_.n_lights()), 1.0F));
  VirtualCameraOptions options = with(flaws);
  options.lit_electrons = 9000.0;
  const session::Session flat = capture("flat", kOne, options, even);
  const session::Session session = capture("scene", kBracket, with(flaws));
  const Error2 before = errors(session, {});
  const Error2 after = errors(session, {.flat_session = flat.folder()});
  print("vignetting 30 %, pixels 1 %, no flat field", before);
  print("vignetting 30 %, pixels 1 %, flat of 64 frames", after);
  // The flat's mean is 1, the lens's is 0.9: one factor for all.
  EXPECT_GT(before.spread, 3.0 * after.spread);
  EXPECT_LT(after.spread, 0.02);
}

TEST_F(ExposureTwin, ExposuresThatContradictEachOtherAreRefused) {
  session::Session session = capture("black", kBracket, with({}));
  // Another black level than the sensor's: 100 steps too low.
  const fs::path file = session.folder() / "session.json";
  std::string text = read_file(file, 1U << 30U);
  const std::size_t at = text.find("\"black_level\":256.0");
  ASSERT_NE(at, std::string::npos) << text.substr(0, 600);
  text.replace(at, 19, "\"black_level\":156.0");
  write_file_atomically(file, text);
  session = session::Session::open(session.folder());
  try {
    (void)session::develop(session, {.use_cache = false});
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("times as bright as the shorter one predicts"));
    EXPECT_THAT(error.hint(), HasSubstr("black level"));
  }
}

}  // namespace
}  // namespace haarlight::sim
