// SPDX-License-Identifier: Apache-2.0
/// The planner's predictions against the twin: every family of patterns is shot by the virtual
/// camera with its noise, developed, relit, and compared with the noise-free truth. Prints the
/// table of docs/numerics/patterns.md.

#include <cmath>
#include <cstdio>
#include <numbers>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "capture/daemon/writer_thread.h"
#include "capture/plan/advice.h"
#include "capture/plan/advice_pilot.h"
#include "core/random.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/plate/plate.h"
#include "sim/transport.h"
#include "sim/virtual_camera.h"
#include "tests/capture/small_camera.h"
#include "tests/session/small_session.h"

namespace haarlight::capture {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 48;

/// Lights of the top face: smooth = a bright side, 10:1; high-frequency = log-normal, sigma 2.
AdviceLighting smooth_lighting() {
  AdviceLighting lighting{"smooth", Eigen::MatrixXd(1024, 1)};
  for (int k = 0; k < 1024; ++k) {
    const double u = (k % 32 + 0.5) / 32.0;
    const int row = k / 32;
    const double v = (row + 0.5) / 32.0;
    lighting.weights(k, 0) =
        1.0 + 0.9 * std::sin(std::numbers::pi * (u + 0.5 * v)) * std::cos(2.0 * v);
  }
  return lighting;
}

AdviceLighting rough_lighting() {
  AdviceLighting lighting{"high-frequency", Eigen::MatrixXd(1024, 1)};
  for (int k = 0; k < 1024; ++k) {
    lighting.weights(k, 0) =
        std::exp(2.0 * standard_normal(hash_key(77, static_cast<std::uint64_t>(k))));
  }
  return lighting;
}

class Twin : public ::testing::Test {
 protected:
  Twin() : rig_(rig_with_camera("cube32", kWidth, kHeight)) {
    plate_.key = "computed";
    plate_.read = [](int y, int x0, int x1, std::span<float> out) {
      const std::size_t first = 1024 * static_cast<std::size_t>(y * kWidth + x0);
      std::copy_n(shared_plate.begin() + static_cast<std::ptrdiff_t>(first),
                  static_cast<std::size_t>(x1 - x0) * 1024, out.begin());
    };
  }

  /// The transport matrix and the plate, once for all tests.
  static void SetUpTestSuite() {
    const Rig rig = rig_with_camera("cube32", kWidth, kHeight);
    shared_folder = std::make_unique<test::TemporaryFolder>();
    sim::TransportOptions options;
    options.cache_folder = shared_folder->path();
    shared_transport = std::make_unique<sim::Transport>(sim::make_transport(
        rig, 0, render::read_scene(HAARLIGHT_SOURCE_DIR "/configs/scenes/airplane.toml").scene,
        options));
    shared_plate.resize(std::size_t{1024} * kWidth * kHeight);
    relight::ComputedPlate(rig).read_tile({0, 0, kWidth, kHeight}, shared_plate);
  }

  static void TearDownTestSuite() {
    shared_transport.reset();
    shared_folder.reset();
    shared_plate.clear();
  }

  /// Shoots the plan's shots in order and develops them. @param flicker  see AdviceOptions
  LightStack capture(const Plan& plan, double lit_electrons, std::uint64_t seed,
                     double flicker = 0.0) {
    const CameraSpec& camera_spec = rig_.cameras.front();
    sim::VirtualCamera camera(
        camera_spec, {}, *shared_transport,
        {.seed = seed, .lit_electrons = lit_electrons, .has_noise = true});
    session::SessionInfo info =
        session_info_of(rig_, plan, fmt::format("{}-{}", plan.name, seed));
    info.rig_hash.clear();
    const auto folder = folder_.path() / fmt::format("s{}", ++n_sessions_);
    test::make_session(folder, info, [&](int i) {
      const session::Shot& shot = plan.shots[static_cast<std::size_t>(i)];
      auto pattern = std::make_shared<std::vector<firmware_iface::ElementLevel>>();
      for (const session::LightLevel& light : shot.lit) {
        pattern->push_back({light.light, light.level});
      }
      const firmware_iface::LightHistory history{
          {{-1000000000, static_cast<std::uint32_t>(i + 1), pattern}}, true};
      const double light =
          1.0 + flicker * standard_normal(hash_key(seed, 99, static_cast<std::uint64_t>(i)));
      const sim::Exposure exposure{0, shot.exposure_us * light, camera_spec.gain_db};
      Image<std::uint16_t> words(camera_spec.frame_height, kWidth, 1);
      camera.take(history, exposure, camera.look(history, exposure),
                  static_cast<std::uint64_t>(i), words.view());
      return words;
    });
    session_ = std::make_unique<session::Session>(session::Session::open(folder));
    session::DevelopOptions options;
    options.plate = plate_;
    return session::develop(*session_, options);
  }

  /// PSNR of the relit pictures as capture/plan/advice.h defines it.
  [[nodiscard]] double measured_psnr(const LightStack& stack, const AdviceLighting& lighting,
                                     double lit_electrons) const {
    const CameraSpec& camera = rig_.cameras.front();
    const double unit = camera.exposure_us * 1e-6 *
                        (std::pow(2.0, camera.bits) - 1.0 - camera.noise.black_dn) *
                        camera.noise.gain_e_per_dn;
    std::vector<double> truths;
    double error2 = 0.0;
    for (Eigen::Index c = 0; c < lighting.weights.cols(); ++c) {
      Image<double> truth(kHeight, kWidth, 1);
      for (int k = 0; k < 1024; ++k) {
        const double w = lighting.weights(k, c) * lit_electrons / shared_transport->scale();
        if (w == 0.0) {
          continue;
        }
        const ImageView<const float> plane = shared_transport->plane(k);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            truth(y, x) += w * double{plane(y, x)};
          }
        }
      }
      const StackBands& bands = stack.bands();
      for (int i_band = 0; i_band < bands.n(); ++i_band) {
        const std::span<const float> band = stack.band(i_band);
        const int y0 = bands.first_row(i_band);
        const int rows = bands.n_rows(i_band);
        for (int p = 0; p < rows * kWidth; ++p) {
          double relit = 0.0;
          for (int k = 0; k < 1024; ++k) {
            relit +=
                lighting.weights(k, c) * unit *
                double{band[1024 * static_cast<std::size_t>(p) + static_cast<std::size_t>(k)]};
          }
          const double exact = truth(y0 + p / kWidth, p % kWidth);
          truths.push_back(exact);
          error2 += (relit - exact) * (relit - exact);
        }
      }
    }
    const auto n = static_cast<double>(truths.size());
    const auto at = static_cast<std::ptrdiff_t>(0.999 * n);
    std::nth_element(truths.begin(), truths.begin() + at, truths.end());
    const double peak = truths[static_cast<std::size_t>(at)];
    return 10.0 * std::log10(peak * peak / (error2 / n));
  }

  /// Pilot, advice, captures, comparison; prints rows and holds each to 1 dB.
  void expect_predicted(const std::string& level, double lit_electrons, double read_e,
                        double flicker, const std::vector<std::string>& only,
                        std::vector<PlanSettings> families = {}) {
    rig_.cameras.front().noise.read_e = read_e;
    const std::vector<AdviceLighting> lightings{single_lights(1024, 16), smooth_lighting(),
                                                rough_lighting()};
    const Lighting own{rough_lighting().weights, {}};
    // The pilot: every light once, another noise than the captures to come.
    PlanSettings pilot;
    pilot.name = "pilot";
    pilot.where = "pilot";
    pilot.darks_every = 64;
    // At least 500 electrons per light: a pilot in the dark takes its time.
    pilot.exposures_us = {rig_.cameras.front().exposure_us *
                          std::max(1.0, 500.0 / lit_electrons)};
    const LightStack pilot_stack = capture(expand_plan(pilot, rig_), lit_electrons, 1);
    const AdviceScene scene =
        pilot_scene(*session_, pilot_stack, rig_.cameras.front(), plate_, 1536);
    if (families.empty()) {
      families = default_families(rig_, true);
    }
    const Advice advice = advise(rig_, scene, lightings, families, &own, {.flicker = flicker});
    for (const FamilyAdvice& family : advice.families) {
      const bool is_requested =
          only.empty() || std::find(only.begin(), only.end(), family.name) != only.end();
      if (!is_requested) {
        continue;
      }
      ASSERT_FALSE(family.predictions.empty()) << family.name << ": " << family.refusals[0];
      const LightStack stack = capture(family.plan, lit_electrons, 2, flicker);
      for (std::size_t i = 0; i < lightings.size(); ++i) {
        const Prediction& p = family.predictions[i];
        const double psnr = measured_psnr(stack, lightings[i], lit_electrons);
        fmt::print("| {} | {} | {} | {:.4g} | {} | {:.1f} | {} | {:.1f} | {:.1f} | {:+.2f} |\n",
                   level, family.name, family.cost.n_light_shots, family.exposure_us,
                   p.lighting, p.noise_psnr_db,
                   p.bias_e > 0.0
                       ? fmt::format("{:.1f}", 20.0 * std::log10(p.peak_e / p.bias_e))
                       : "-",
                   p.psnr_db, psnr, p.psnr_db - psnr);
        std::fflush(stdout);
        EXPECT_NEAR(p.psnr_db, psnr, 1.0) << level << ", " << family.name << ", " << p.lighting;
      }
    }
  }

  test::TemporaryFolder folder_;
  Rig rig_;
  static inline std::unique_ptr<test::TemporaryFolder> shared_folder;
  static inline std::unique_ptr<sim::Transport> shared_transport;
  static inline std::vector<float> shared_plate;
  session::PlatePixels plate_;
  std::unique_ptr<session::Session> session_;
  int n_sessions_ = 0;
};

TEST_F(Twin, BrightCapturesComeOutAsPredicted) {
  expect_predicted("bright", 3000.0, 3.0, 0.0, {});
}

TEST_F(Twin, DarkCapturesComeOutAsPredicted) { expect_predicted("dark", 8.0, 8.0, 0.0, {}); }

TEST_F(Twin, FewAndManyDarksCostWhatIsPredicted) {
  // One at a time under smooth light adds the dark frames' own noise up a thousandfold: from 2
  // dark frames to 129 the picture gains 17 dB, which only holds if develop averages them as
  // the planner assumes.
  std::vector<PlanSettings> families;
  for (const int every : {1024, 128, 8}) {
    PlanSettings settings;
    settings.name = fmt::format("darks_every_{}", every);
    settings.where = settings.name;
    settings.darks_every = every;
    families.push_back(settings);
  }
  expect_predicted("darks", 8.0, 8.0, 0.0, {}, families);
}

TEST_F(Twin, FlickeringLightsCostWhatIsPredicted) {
  expect_predicted("flicker", 3000.0, 3.0, 0.003, {"s_matrix"});
}

TEST_F(Twin, WithoutAPilotThePlatePredictsTheCompleteFamilies) {
  rig_.cameras.front().noise.read_e = 8.0;
  const AdviceScene scene = plate_scene(shared_plate, 1024, 8.0);
  std::vector<PlanSettings> families = default_families(rig_, false);
  const std::vector<AdviceLighting> lightings{single_lights(1024, 16), smooth_lighting()};
  const Advice advice = advise(rig_, scene, lightings, families, nullptr);
  for (const FamilyAdvice& family : advice.families) {
    if (family.name != "one_at_a_time" && family.name != "s_matrix") {
      continue;
    }
    const LightStack stack = capture(family.plan, 8.0, 2);
    for (std::size_t i = 0; i < lightings.size(); ++i) {
      const double psnr = measured_psnr(stack, lightings[i], 8.0);
      fmt::print("| no pilot | {} | {} | {:.1f} | {:.1f} |\n", family.name, lightings[i].name,
                 family.predictions[i].psnr_db, psnr);
      // An object is darker or brighter than the plane: 2 dB.
      EXPECT_NEAR(family.predictions[i].psnr_db, psnr, 2.0) << family.name;
    }
  }
}

}  // namespace
}  // namespace haarlight::capture
