// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/commission/commission.h"
#include "tests/capture/commission/commission_truth.h"
#include "tests/capture/twin_bench.h"

/// @file
/// The whole commissioning against the simulator's sensor and controller on a virtual clock,
/// for every meaning of a timestamp and both shutters: it is told a rig file that is wrong in
/// every value, and must find the truth.

namespace haarlight::capture {
namespace {

using testing::CommissionedCamera;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using testing::kReadUs;
using testing::kSkewUs;
using testing::truth_of;
using testing::TwinBench;
using testing::written_rig;

std::string case_name(const ::testing::TestParamInfo<CommissionedCamera>& info) {
  return fmt::format("{}_{}", to_string(info.param.meaning), to_string(info.param.shutter));
}

/// The acceptance for delays: 0.1 ms or 1 %.
double delay_tolerance(double us) { return std::max(100.0, 0.01 * us); }

void expect_delay(const char* name, const std::optional<Measured>& m, double truth) {
  ASSERT_TRUE(m) << name;
  fmt::print("{:>8} {:9.1f} +- {:5.1f} us, error {:+7.1f}\n", name, m->value, m->sigma,
             m->value - truth);
  EXPECT_NEAR(m->value, truth, delay_tolerance(truth)) << name;
  // Its own figure of uncertainty is no fiction.
  EXPECT_LT(std::abs(m->value - truth), 6.0 * m->sigma + 5.0) << name;
}

void expect_fraction(const char* name, const std::optional<Measured>& m, double truth) {
  ASSERT_TRUE(m) << name;
  fmt::print("{:>8} {:9.3f} +- {:.3f}, error {:+.2f} %\n", name, m->value, m->sigma,
             100.0 * (m->value / truth - 1.0));
  EXPECT_NEAR(m->value, truth, 0.03 * truth) << name;
}

class CommissionCase : public ::testing::TestWithParam<CommissionedCamera> {};

void expect_the_truth(const CommissionedCamera& which, std::uint64_t seed) {
  const Rig rig = written_rig(which.shutter);
  TwinBench bench(rig, truth_of(which), seed);
  const CommissionResult r = commission(rig, bench.camera(), bench.lights(), {}, bench.clock());
  const MeasuredController& light = *r.measured.controller;
  const MeasuredCamera& camera = r.measured.cameras.at(0);
  fmt::print("{}\n", camera.evidence);
  EXPECT_EQ(camera.timestamp, which.meaning) << camera.evidence;
  expect_delay("latch", light.latch_us, 812.0);
  expect_delay("rise", light.rise_us, 140.0);
  expect_delay("fall", light.fall_us, 60.0);
  expect_delay("ready", camera.ready_us,
               which.shutter == Shutter::rolling ? kReadUs - kSkewUs + 200.0 : kReadUs + 200.0);
  if (which.meaning == TimestampMeaning::end_frame) {
    expect_delay("read", camera.read_us, kReadUs);
  } else {
    EXPECT_FALSE(camera.read_us);
  }
  if (which.shutter == Shutter::rolling) {
    expect_delay("skew", camera.skew_us, kSkewUs);
  }
  ASSERT_TRUE(camera.exposure_delay_frames);
  EXPECT_EQ(camera.exposure_delay_frames->value, 2.0);
  expect_fraction("gain", camera.gain_e_per_dn, 0.92);
  expect_fraction("read_e", camera.read_e, 4.1);
  expect_fraction("well", camera.full_well_e, 14500.0);
  expect_fraction("black", camera.black_dn, 200.0);
  ASSERT_TRUE(camera.linearity_percent);
  EXPECT_LT(camera.linearity_percent->value, 0.5);
  ASSERT_TRUE(r.survey);
  EXPECT_THAT(r.survey->dead, ElementsAre(9, 41));
  EXPECT_THAT(r.survey->dim, ElementsAre(12));
  EXPECT_THAT(r.survey->unseen, IsEmpty());
  EXPECT_THAT(r.survey->miswired, ElementsAre(20, 21));
  EXPECT_THAT(r.survey->miswired_to, ElementsAre(21, 20));
  EXPECT_NEAR(r.survey->power[12], 0.6, 0.02);
  EXPECT_NEAR(r.survey->power[50], 1.25, 0.03);
  EXPECT_THAT(r.contradictions, IsEmpty());
  EXPECT_TRUE(bench.controller().lit().pattern->empty());
  // Reading it back gives the rig the truth.
  Rig merged = rig;
  apply_measured(parse_measured(to_toml(r.measured), "m"), "m", merged);
  EXPECT_EQ(merged.cameras[0].timestamp, which.meaning);
  EXPECT_NEAR(merged.controller.latch_us, 812.0, 100.0);
}

TEST_P(CommissionCase, RecoversTheTruth) {
  // HAARLIGHT_SEEDS=20 for the table of docs/numerics/commissioning.md.
  const char* requested = std::getenv("HAARLIGHT_SEEDS");
  const int n = requested == nullptr ? 1 : std::atoi(requested);
  for (int seed = 1; seed <= n; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    expect_the_truth(GetParam(), static_cast<std::uint64_t>(seed));
  }
}

INSTANTIATE_TEST_SUITE_P(
    SixCases, CommissionCase,
    ::testing::Values(CommissionedCamera{TimestampMeaning::start_exposure, Shutter::rolling},
                      CommissionedCamera{TimestampMeaning::start_readout, Shutter::rolling},
                      CommissionedCamera{TimestampMeaning::end_frame, Shutter::rolling},
                      CommissionedCamera{TimestampMeaning::start_exposure, Shutter::global},
                      CommissionedCamera{TimestampMeaning::start_readout, Shutter::global},
                      CommissionedCamera{TimestampMeaning::end_frame, Shutter::global}),
    case_name);

}  // namespace
}  // namespace haarlight::capture
