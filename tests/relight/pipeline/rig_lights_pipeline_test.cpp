// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/rig_lights_pipeline.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/light/near_light.h"
#include "session/rig_session.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

constexpr int kSide = 4;                   // lights along a side of the face
const Vector3d kMoved(30.0, -20.0, 25.0);  // mm, of the face from where its file has it
constexpr double kBlack = 256.0;
constexpr double kPaper = 0.8;

/// small8 with fewer, smaller lights.
std::string rig_text() {
  std::string text = read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  const auto swap = [&text](const std::string& from, const std::string& to) {
    text.replace(text.find(from), from.size(), to);
  };
  swap("rows = 8", "rows = 4");
  swap("cols = 8", "cols = 4");
  swap("pitch = 120.0", "pitch = 240.0");
  return text;
}

/// Light k where it truly is.
NearLight true_light(const Rig& rig, int k) {
  const LightElement element = light_element(rig, k);
  NearLight light;
  light.position_mm = element.centre + kMoved;
  light.axis = element.emits;
  light.mu = element.lobe_mu;
  light.emitter_mm.col(0) = element.width_mm * element.u;
  light.emitter_mm.col(1) = element.height_mm * element.v;
  return light;
}

/// What the camera's sensor says of bare paper on the plane under one light: DN with the
/// camera's own noise.
Image<std::uint16_t> frame_of(const Rig& rig, const session::SessionInfo& info, int k) {
  constexpr double kBright = 9e9;  // of 14 bits the brightest pixel is about half full
  const PixelPoints points =
      PixelPoints::on_plane(rig.cameras[0].model, rig.planes[0].n, rig.planes[0].d);
  const NearLight light = true_light(rig, k);
  Image<std::uint16_t> frame(info.form.stored_height, info.form.width, 1);
  for (int y = 0; y < info.form.height; ++y) {
    for (int x = 0; x < info.form.width; ++x) {
      const double signal =
          kBright * kPaper *
          light_stencil(light, points.at(x + 0.5, y + 0.5), Vector3d::UnitZ());
      const double noise =
          standard_normal(hash_key(static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(y),
                                   static_cast<std::uint64_t>(x)));
      const double dn = kBlack + signal + noise * std::sqrt(9.0 + signal);
      frame(y, x) = static_cast<std::uint16_t>(std::lround(std::clamp(dn, 0.0, 16383.0)));
    }
  }
  return frame;
}

class RigLightsPipeline : public ::testing::Test {
 protected:
  RigLightsPipeline() {
    write_file_atomically(folder_.path() / "rig.toml", rig_text());
    const Rig rig = read_rig(folder_.path() / "rig.toml");
    session::SessionInfo info = test::small_info(0);
    info.rig_hash = rig.hash;
    session::describe_rig(rig, info);
    for (int k = 0; k < rig.n_lights(); ++k) {
      session::Shot shot;
      shot.index = k;
      shot.lit = {{k, 65535}};
      shot.exposure_us = 2000.0;
      info.shots.push_back(shot);
    }
    test::make_session(
        folder_.path() / "sheet.session", info,
        [&](int shot) { return frame_of(rig, info, shot); }, rig.text);
    options_.rig = folder_.path() / "rig.toml";
    options_.session = folder_.path() / "sheet.session";
    options_.bow_mm = 0.0;
    options_.lobe = Lobe::given;
  }

  test::TemporaryFolder folder_;
  RigLightsOptions options_;
};

TEST_F(RigLightsPipeline, AFaceIsFoundWhereItWasMovedTo) {
  const RigLightsSummary summary = calibrate_rig_lights(options_);
  EXPECT_TRUE(summary.faces.is_good);
  ASSERT_EQ(summary.faces.faces.size(), 1U);
  const FaceCalibration& face = summary.faces.faces[0];
  EXPECT_EQ(face.lights.lights.size(), static_cast<std::size_t>(kSide * kSide));
  const MeasuredFace measured = measured_face(summary.rig.faces[0], face);
  for (int c = 0; c < 3; ++c) {
    const double truth = summary.rig.faces[0].centre[c] + kMoved[c];
    EXPECT_LT(measured.centre_sigma[c], 5.0);  // mm, of 900: pixels of 1 % noise
    EXPECT_NEAR(measured.centre[c], truth, 4.0 * measured.centre_sigma[c]);
  }
  EXPECT_NEAR(face.moved_mm, kMoved.norm(), 4.0 * measured.centre_sigma.norm());
  for (const double power : measured.power) {
    EXPECT_NEAR(power, 1.0, 0.02);  // all lights are alike
  }
}

TEST_F(RigLightsPipeline, WhatIsStoredBesideTheRigFileIsWhatWasFound) {
  const RigLightsSummary summary = calibrate_rig_lights(options_);
  ASSERT_EQ(summary.measured, measured_path(options_.rig));
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(summary.measured));
  EXPECT_TRUE(std::filesystem::exists(summary.page));
  // Read again, the rig's lights stand where they were found.
  const Rig rig = read_rig(options_.rig);
  const FaceCalibration& face = summary.faces.faces[0];
  EXPECT_LT((rig.faces[0].centre - face.world_from_face.translation()).norm(), 1e-5);
}

TEST_F(RigLightsPipeline, AnotherRigsCaptureIsRefused) {
  write_file_atomically(folder_.path() / "other.toml", rig_text() + "\n# changed\n");
  options_.rig = folder_.path() / "other.toml";
  EXPECT_THROW((void)calibrate_rig_lights(options_), Error);
  options_.session.clear();
  EXPECT_THROW((void)calibrate_rig_lights(options_), Error);
}

}  // namespace
}  // namespace haarlight::relight
