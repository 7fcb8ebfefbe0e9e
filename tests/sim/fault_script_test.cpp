// SPDX-License-Identifier: Apache-2.0
#include "sim/fault_script.h"

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::sim {
namespace {

TEST(FaultScript, ReadsEveryKey) {
  const FaultScript script = parse_fault_script(R"(
[frames]
late_share = 0.01
late_ms = 40.0
drop_share = 0.02
duplicate_share = 0.03
stale_share = 0.04
swap_share = 0.05
jitter_us = 60.0
[[bus]]
at_s = 1.0
for_s = 2.0
kind = "dead"
[[bus]]
at_s = 5.0
for_s = 1.5
kind = "slow"
delay_ms = 80.0
[[restart]]
at_s = 9.0
off_ms = 250.0
[late_light]
share = 0.2
least_ms = 4.0
most_ms = 50.0
shows = "at_once"
)",
                                                "f.toml");
  EXPECT_DOUBLE_EQ(script.late_light.fraction, 0.2);
  EXPECT_EQ(script.late_light.least, std::chrono::milliseconds(4));
  EXPECT_EQ(script.late_light.most, std::chrono::milliseconds(50));
  EXPECT_EQ(script.late_light.shows, firmware_iface::LateActing::Shows::at_once);
  EXPECT_DOUBLE_EQ(script.frames.late_fraction, 0.01);
  EXPECT_DOUBLE_EQ(script.frames.late_ms, 40.0);
  EXPECT_DOUBLE_EQ(script.frames.drop_fraction, 0.02);
  EXPECT_DOUBLE_EQ(script.frames.duplicate_fraction, 0.03);
  EXPECT_DOUBLE_EQ(script.frames.stale_fraction, 0.04);
  EXPECT_DOUBLE_EQ(script.frames.swap_fraction, 0.05);
  EXPECT_DOUBLE_EQ(script.frames.jitter_us, 60.0);
  ASSERT_EQ(script.bus.size(), 2U);
  EXPECT_TRUE(script.bus[0].is_dead);
  EXPECT_DOUBLE_EQ(script.bus[1].delay_ms, 80.0);
  ASSERT_EQ(script.restarts.size(), 1U);
  EXPECT_DOUBLE_EQ(script.restarts[0].off_ms, 250.0);
}

TEST(FaultScript, NamesLineAndHintOfBrokenOnes) {
  const char* broken[] = {
      "[frames]\ndrop_shar = 0.1\n",
      "[frames]\ndrop_share = 1.5\n",
      "[frames]\nlate_share = 0.6\ndrop_share = 0.6\n",
      "[[bus]]\nat_s = 1.0\nfor_s = 1.0\nkind = \"lazy\"\n",
      "[[bus]]\nat_s = 1.0\nfor_s = 1.0\nkind = \"slow\"\n",
      "[[restart]]\noff_ms = 3.0\n",
      "[late_light]\nleast_ms = 3.0\n",
      "[late_light]\nshare = 0.1\nleast_ms = 30.0\nmost_ms = 20.0\n",
      "[late_light]\nshare = 0.1\nshows = \"never\"\n",
      "[frames\n",
  };
  for (const char* text : broken) {
    try {
      static_cast<void>(parse_fault_script(text, "f.toml"));
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_TRUE(error.where().starts_with("f.toml:")) << error.where();
      EXPECT_FALSE(error.hint().empty());
    }
  }
}

TEST(FaultScript, ReadsTheShippedOnes) {
  const std::string folder = HAARLIGHT_SOURCE_DIR "/configs/faults/";
  EXPECT_DOUBLE_EQ(read_fault_script(folder + "one_percent.toml").frames.stale_fraction, 0.01);
  EXPECT_EQ(read_fault_script(folder + "bad_day.toml").restarts.size(), 1U);
}

TEST(FaultScript, AnEmptyOneBreaksNothing) {
  const FaultScript script = parse_fault_script("", "f.toml");
  EXPECT_EQ(script.frames.drop_fraction, 0.0);
  EXPECT_TRUE(script.bus.empty());
}

}  // namespace
}  // namespace haarlight::sim
