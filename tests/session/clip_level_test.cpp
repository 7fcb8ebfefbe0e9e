// SPDX-License-Identifier: Apache-2.0
#include "session/clip_level.h"

#include <gtest/gtest.h>

#include "haarlight/core/rig/rig.h"
#include "haarlight/session/session.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

TEST(ClipLevel, AFullWellBelowWhiteClipsFirst) {
  const SensorNoise noise{.gain_e_per_dn = 1.0, .full_well_e = 16000.0, .black_dn = 256.0};
  EXPECT_DOUBLE_EQ(clip_level(noise, 256.0, 16383.0), 256.0 + 0.97 * 16000.0);
  EXPECT_DOUBLE_EQ(clip_level(noise, 256.0, 4095.0), 4095.0);
}

TEST(ClipLevel, AWellThatStandsForWhiteClipsAtWhite) {
  // As commissioning writes it, gain times range, where the converter ends first; and rounded.
  SensorNoise noise{.gain_e_per_dn = 0.5, .full_well_e = 0.5 * (4095.0 - 64.0)};
  EXPECT_DOUBLE_EQ(clip_level(noise, 64.0, 4095.0), 4095.0);
  noise.full_well_e -= 0.2;
  EXPECT_DOUBLE_EQ(clip_level(noise, 64.0, 4095.0), 4095.0);
}

TEST(ClipLevel, WithoutAFullWellIsWhite) {
  EXPECT_DOUBLE_EQ(clip_level(SensorNoise{}, 0.0, 16383.0), 16383.0);
  EXPECT_DOUBLE_EQ(clip_level({.gain_e_per_dn = 0.0, .full_well_e = 1.0}, 0.0, 255.0), 255.0);
}

TEST(ClipLevel, OfTheShippedRigsLiesBelowWhite) {
  const auto level = [](const std::string& name) {
    return clip_level(
        read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/" + name + ".toml").cameras.front());
  };
  EXPECT_DOUBLE_EQ(level("small8"), 15776.0);
  EXPECT_DOUBLE_EQ(level("cube32"), 15776.0);
  EXPECT_DOUBLE_EQ(level("strobe60"), 1024.0 + 0.97 * 64000.0);
}

TEST(ClipLevel, TravelsWithTheSessionAndOldSessionsClipAtWhite) {
  SessionInfo info = test::small_info(1);
  EXPECT_EQ(session_info_to_json(info).find("clip_level"), std::string::npos);
  SessionInfo read = session_info_from_json(session_info_to_json(info), "session.json");
  EXPECT_DOUBLE_EQ(read.form.saturation_dn(), info.form.white_level);
  info.form.clip_level = 4000.5;
  read = session_info_from_json(session_info_to_json(info), "session.json");
  EXPECT_EQ(read.form, info.form);
  EXPECT_DOUBLE_EQ(read.form.saturation_dn(), 4000.5);
}

}  // namespace
}  // namespace haarlight::session
