// SPDX-License-Identifier: Apache-2.0
/// Each family of patterns through the daemon, the real drivers and the virtual rig on the real
/// clock; then developed and relit against what the rig truly showed.

#include <chrono>
#include <cmath>
#include <thread>

#include <gtest/gtest.h>

#include "capture/daemon/daemon.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/session/develop/develop.h"
#include "session/storage.h"
#include "sim/virtual_rig.h"
#include "tests/capture/session_truth.h"
#include "tests/sim/made_transport.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using testing::expect_true_session;

constexpr int kSide = 8;
constexpr int kLights = kSide * kSide;

/// A ramp over rows and columns.
float ramp_at(int k) {
  const int row = k / kSide;
  const int col = k % kSide;
  return 0.5F + 0.01F * static_cast<float>(row + col);
}

/// The ramp with a shadow: lights 20 to 23 are hidden.
std::vector<float> brightness() {
  std::vector<float> values;
  for (int k = 0; k < kLights; ++k) {
    values.push_back(k >= 20 && k < 24 ? 0.05F : ramp_at(k));
  }
  return values;
}

class PatternRig : public ::testing::Test {
 protected:
  PatternRig() : wanted_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    wanted_.http.port = 0;
    wanted_.storage.reserve_mb = 0.0;
    const CameraSpec& camera = wanted_.cameras.front();
    transports_.push_back(
        testing::flat_transport(folder_, camera.frame_width, camera.active_rows, brightness()));
  }

  /// Captures and develops; the mean picture value of each light, in units of the first's.
  std::vector<double> captured(const std::string& plan) {
    sim::VirtualRig virtual_rig(wanted_, transports_,
                                sim::VirtualRigOptions{.own_folder = folder_.path()});
    const Rig& rig = virtual_rig.rig();
    Daemon daemon(DaemonConfig{
        .rig = rig,
        .sessions = folder_.path() / "sessions",
        .make_light =
            [&] { return firmware_iface::make_light_array(rig.controller, rig.n_lights()); },
        .make_camera = [&] { return make_camera(rig.cameras.front()); },
        .storage = &storage_,
        .has_http = false});
    const auto deadline = std::chrono::steady_clock::now() + 60s;
    const auto wait_for = [&](Phase phase) {
      while (daemon.state().phase != phase && std::chrono::steady_clock::now() < deadline) {
        std::this_thread::sleep_for(2ms);
      }
      return daemon.state().phase == phase;
    };
    EXPECT_TRUE(wait_for(Phase::idle));
    const RunReceipt receipt = daemon.run(plan, "plan");
    EXPECT_TRUE(wait_for(Phase::done)) << daemon.state().reason_text;
    expect_true_session(receipt.folder);
    const session::Session session = session::Session::open(receipt.folder);
    session::DevelopOptions options;
    options.plate.key = "ramp";  // the object without its shadow
    options.plate.read = [](int, int x0, int x1, std::span<float> out) {
      std::size_t i = 0;
      for (int x = x0; x < x1; ++x) {
        for (int k = 0; k < kLights; ++k) {
          out[i++] = ramp_at(k);
        }
      }
    };
    const LightStack stack = session::develop(session, options);
    std::vector<double> lights;
    const CameraSpec& camera = wanted_.cameras.front();
    // Fractions of the range per second, back to the transport's units.
    const double unit = camera.exposure_us * 1e-6 *
                        (std::pow(2.0, camera.bits) - 1.0 - camera.noise.black_dn) *
                        camera.noise.gain_e_per_dn / (0.5 * camera.noise.full_well_e) *
                        transports_.front().scale();
    for (int k = 0; k < kLights; ++k) {
      const Image<float> picture = stack.light_images(k, 1).front();
      double sum = 0.0;
      for (const float value : picture.pixels()) {
        sum += double{value};
      }
      lights.push_back(unit * sum / static_cast<double>(picture.pixels().size()));
    }
    return lights;
  }

  /// Means of 3072 pixels: noise of a light below 4 r per pixel at 1/40 of the exposure, and
  /// the quantised levels; 1 % of a lit light covers both ten times.
  static void expect_equal(const std::vector<double>& lights, const std::vector<float>& truth) {
    for (int k = 0; k < kLights; ++k) {
      EXPECT_NEAR(lights[static_cast<std::size_t>(k)], truth[static_cast<std::size_t>(k)],
                  0.006)
          << "light " << k;
    }
  }

  static std::string plan(const std::string& text) {
    // 64 lights of half a well at 2000 us: 50 us keep all of them below it.
    return "schema = 1\nname = \"p\"\nexposures_us = [50]\ndarks_every = 16\n" + text;
  }

  testing::TemporaryFolder folder_;
  Rig wanted_;
  std::vector<sim::Transport> transports_;
  session::DiskStorage storage_;
};

TEST_F(PatternRig, AnSMatrixGivesEveryLight) {
  expect_equal(captured(plan("patterns = \"s_matrix\"\norder = \"bit_reversed\"\n")),
               brightness());
}

TEST_F(PatternRig, AllHaarWaveletsGiveEveryLight) {
  expect_equal(captured(plan("patterns = \"haar\"\n")), brightness());
}

TEST_F(PatternRig, BinsGiveTheirBlocksDistributedByThePlate) {
  const std::vector<float> truth = brightness();
  std::vector<float> shared(kLights);
  for (int k = 0; k < kLights; ++k) {
    const int row = k / 8 / 2 * 2;
    const int col = k % 8 / 2 * 2;
    float block = 0.0F;
    float ramp = 0.0F;
    for (const int j :
         {row * 8 + col, row * 8 + col + 1, row * 8 + col + 8, row * 8 + col + 9}) {
      block += truth[static_cast<std::size_t>(j)];
      ramp += ramp_at(j);
    }
    shared[static_cast<std::size_t>(k)] = block * ramp_at(k) / ramp;
  }
  expect_equal(captured(plan("patterns = \"bins\"\nbin = 2\n")), shared);
}

TEST_F(PatternRig, LightingPatternsGiveTheirLightingBack) {
  const std::vector<float> truth = brightness();
  Lighting lighting;
  lighting.weights.resize(kLights, 1);
  for (int k = 0; k < kLights; ++k) {
    lighting.weights(k, 0) = k % 8 < 3 ? 1.0 : 0.2;  // edges that wavelets of size 2 to 8 make
  }
  double exact = 0.0;
  for (int k = 0; k < kLights; ++k) {
    exact += lighting.weights(k, 0) * double{truth[static_cast<std::size_t>(k)]};
  }
  for (const char* patterns : {"lighting_target", "lighting_haar"}) {
    const PlanSettings settings = parse_plan_file(
        plan("environment = \"room.hdr\"\nwavelets = 40\npatterns = \"") + patterns + "\"\n",
        "p.toml");
    const Plan expanded = expand_plan(settings, wanted_, &lighting);
    const std::vector<double> lights = captured(plan_to_json(expanded));
    double relit = 0.0;
    for (int k = 0; k < kLights; ++k) {
      relit += lighting.weights(k, 0) * lights[static_cast<std::size_t>(k)];
    }
    // The lighting has 8 x 8 columns of two values: no more than 22 wavelets are not 0.
    EXPECT_NEAR(relit, exact, 0.005 * exact) << patterns;
  }
}

}  // namespace
}  // namespace haarlight::capture
