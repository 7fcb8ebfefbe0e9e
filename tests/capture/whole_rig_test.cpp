// SPDX-License-Identifier: Apache-2.0
/// The daemon with its real drivers against the simulator's real servers, in one process:
/// Modbus over TCP and over a serial line, the camera over its socket, on the real clock.

#include <algorithm>
#include <chrono>
#include <thread>
#include <vector>

#include <Eigen/Core>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon/daemon.h"
#include "haarlight/session/session.h"
#include "session/storage.h"
#include "session/verify.h"
#include "sim/virtual_rig.h"
#include "tests/capture/session_truth.h"
#include "tests/sim/made_transport.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using testing::expect_true_session;

class WholeRig : public ::testing::Test {
 protected:
  WholeRig() : wanted_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    wanted_.http.port = 0;
    wanted_.storage.reserve_mb = 0.0;
    std::vector<float> brightness;
    brightness.reserve(static_cast<std::size_t>(wanted_.n_lights()));
    for (int k = 0; k < wanted_.n_lights(); ++k) {
      brightness.push_back(0.5F + 0.01F * static_cast<float>(k));
    }
    const CameraSpec& camera = wanted_.cameras.front();
    transports_.push_back(
        testing::flat_transport(folder_, camera.frame_width, camera.active_rows, brightness));
  }

  /// Runs one plan to its end.
  void capture(const sim::FaultScript& faults,
               const std::function<void(Daemon&)>& meanwhile = {}) {
    options_.faults = faults;
    options_.own_folder = folder_.path();
    rig_ = std::make_unique<sim::VirtualRig>(wanted_, transports_, options_);
    const Rig& rig = rig_->rig();
    Daemon daemon(DaemonConfig{
        .rig = rig,
        .sessions = folder_.path() / "sessions",
        .make_light =
            [&] { return firmware_iface::make_light_array(rig.controller, rig.n_lights()); },
        .make_camera = [&] { return make_camera(rig.cameras.front()); },
        .storage = storage_.get(),
        .has_http = false});
    const auto deadline = std::chrono::steady_clock::now() + limit_;
    const auto wait_until = [&](auto predicate) {
      while (!predicate(daemon.state())) {
        if (std::chrono::steady_clock::now() > deadline) {
          return false;
        }
        std::this_thread::sleep_for(2ms);
      }
      return true;
    };
    ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::idle; }));
    const RunReceipt receipt = daemon.run(
        "schema = 1\nname = \"whole\"\npatterns = \"one_at_a_time\"\n" + more_plan_, "p");
    session_ = receipt.folder;
    if (meanwhile) {
      ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.n_committed >= 10; }));
      meanwhile(daemon);
    }
    ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::done; }))
        << to_string(daemon.state().phase) << ": " << daemon.state().reason_text;
    counters_ = daemon.state().counters;
    if (tags_are_exact_) {
      expect_true_session(receipt.folder);
    }
    EXPECT_TRUE(rig_->controller().lit().pattern->empty()) << "the lights are left on";
  }

  /// What the read-back costs a light: the median time from acknowledgement to t_shown.
  void tell_read_back(const char* wire) const {
    std::vector<double> ms;
    const session::Session session = session::Session::open(session_);
    for (const session::FrameRecord& frame : session.info().frames) {
      ms.push_back(1e-6 * static_cast<double>(frame.evidence.t_shown_ns.value() -
                                              frame.evidence.t_ack_ns));
    }
    std::nth_element(ms.begin(), ms.begin() + 32, ms.end());
    fmt::print("{}: {:.3f} ms from the acknowledgement to the read-back\n", wire, ms.at(32));
    EXPECT_GT(ms.at(32), 0.0);
  }

  testing::TemporaryFolder folder_;
  Rig wanted_;
  std::vector<sim::Transport> transports_;
  std::unique_ptr<session::Storage> storage_ = std::make_unique<session::DiskStorage>();
  std::unique_ptr<sim::VirtualRig> rig_;
  SequencerCounters counters_;
  std::chrono::seconds limit_{60};  ///< of a run
  std::string more_plan_;           ///< further keys of the plan
  bool tags_are_exact_ = true;      ///< of every committed frame
  std::filesystem::path session_;   ///< the last one
  sim::VirtualRigOptions options_;
};

/// A disk that takes its time for every frame.
class SlowStorage final : public session::DiskStorage {
 public:
  Result<void> sync_file(const std::filesystem::path& path) override {
    std::this_thread::sleep_for(30ms);
    return session::DiskStorage::sync_file(path);
  }
};

TEST_F(WholeRig, EveryLightIsCommittedOverModbusTcp) {
  capture({});
  tell_read_back("TCP");
}

TEST_F(WholeRig, TheFirstLightWaitsForNoRhythm) {
  capture({});
  EXPECT_GE(counters_.rhythm_unknown, FrameRhythm::kFirst);
  const session::Session session = session::Session::open(session_);
  const auto first =
      std::min_element(session.info().frames.begin(), session.info().frames.end(),
                       [](const session::FrameRecord& a, const session::FrameRecord& b) {
                         return a.evidence.t_exposure_start_ns < b.evidence.t_exposure_start_ns;
                       });
  EXPECT_GE(first->evidence.sequence, FrameRhythm::kFirst);
  // One or two as the others; a busy machine may come late to those that were on their way.
  EXPECT_LT(first->evidence.discarded_before, static_cast<int>(FrameRhythm::kFirst) - 2);
}

TEST_F(WholeRig, EveryLightIsCommittedOverASerialLine) {
  wanted_.controller.kind = ControllerKind::modbus_rtu;
  wanted_.controller.address = "/dev/none:115200";  // the virtual rig puts its own in
  capture({});
  tell_read_back("RTU at 115200 baud");
}

// ---- a controller that acts long after it acknowledges

class LateRig : public WholeRig {
 protected:
  /// The sync mode and the file that says so: verify holds a session to its rig.toml.
  void set_sync(const std::string& mode) {
    std::string text = wanted_.text;
    const std::string written = "mode = \"free-run\"";
    text.replace(text.find(written), written.size(), "mode = \"" + mode + "\"");
    Rig other = parse_rig(text, "small8.toml");
    wanted_.sync = other.sync;
    wanted_.text = std::move(other.text);
    wanted_.hash = std::move(other.hash);
  }
  /// A fifth of the commands acts 5 to 60 ms late.
  void capture_late(firmware_iface::LateActing::Shows shows) {
    sim::FaultScript faults;
    faults.late_light = {.fraction = 0.2, .shows = shows};
    capture(faults);
    // Late is no fault; a busy machine that is later than 100 ms makes one now and then.
    EXPECT_LE(counters_.light_faults, 5U);
    const session::Session session = session::Session::open(session_);
    for (const session::FrameRecord& frame : session.info().frames) {
      EXPECT_TRUE(frame.evidence.t_shown_ns.has_value());
      late_ms_ = std::max(late_ms_, 1e-6 * static_cast<double>(*frame.evidence.t_shown_ns -
                                                               frame.evidence.t_ack_ns));
    }
    EXPECT_GE(late_ms_, 5.0) << "of 64 lights none was late?";
    const session::VerifyReport report = session::verify_session(session_);
    EXPECT_TRUE(report.is_good()) << report.problems.front();
  }
  /// Fraction of a frame's light that another pattern of its session gave, by least squares on
  /// the true planes: of a late write of the same light the metadata rows say the wrong shot,
  /// not the wrong light.
  [[nodiscard]] double other_light(const session::Session& session,
                                   const session::FrameRecord& frame) const {
    const auto light_of = [&](int shot) {
      return session.info().shots.at(static_cast<std::size_t>(shot)).lit.front().light;
    };
    const auto values_of = [](ImageView<const float> view) -> Eigen::ArrayXd {
      return Eigen::Map<const Eigen::ArrayXf>(view.data(),
                                              Eigen::Index{view.height()} * view.width())
          .cast<double>();
    };
    const auto plane = [&](int light) { return values_of(transports_.front().plane(light)); };
    const Image<float> pixels = session.read_rows(frame, 0, session.info().form.height);
    const Eigen::ArrayXd seen =
        values_of(pixels.view()) - wanted_.cameras.front().noise.black_dn;
    const Eigen::ArrayXd own = plane(light_of(frame.shot));
    double fraction = 0.0;
    double most = 0.0;  // how much of the residual goes
    for (const session::Shot& shot : session.info().shots) {
      const int light = shot.lit.front().light;
      if (light == light_of(frame.shot)) {
        continue;
      }
      const Eigen::ArrayXd other = plane(light);
      const double cross = (own * other).sum() / (own * own).sum();
      const Eigen::ArrayXd rest = other - cross * own;
      const double b = (rest * seen).sum() / (rest * rest).sum();
      const double a = (own * seen).sum() / (own * own).sum() - cross * b;
      if (b > 0.0 && b * b * (rest * rest).sum() > most) {
        most = b * b * (rest * rest).sum();
        fraction = b / (std::max(a, 0.0) + b);
      }
    }
    return fraction;
  }
  double late_ms_ = 0.0;  ///< the longest from acknowledgement to read-back
};

TEST_F(LateRig, AGatewayThatForwardsLatePairsNoFrameWrongly) {
  capture_late(firmware_iface::LateActing::Shows::in_order);
}

TEST_F(LateRig, AControllerThatScansItsRegistersPairsNoFrameWrongly) {
  capture_late(firmware_iface::LateActing::Shows::with_light);
}

TEST_F(LateRig, TheSameOverASerialLine) {
  wanted_.controller.kind = ControllerKind::modbus_rtu;
  wanted_.controller.address = "/dev/none:115200";
  capture_late(firmware_iface::LateActing::Shows::in_order);
}

TEST_F(LateRig, TheSameWhereTheHostTriggers) {
  set_sync("light-leads");
  capture_late(firmware_iface::LateActing::Shows::in_order);
}

TEST_F(LateRig, TheSameWhereTheControllerTriggers) {
  set_sync("controller-leads");
  capture_late(firmware_iface::LateActing::Shows::in_order);
}

TEST_F(LateRig, WhereTheReadBackLiesTwoFramesOfEachLightHaveToAgree) {
  transports_.clear();
  const CameraSpec& camera = wanted_.cameras.front();
  transports_.push_back(testing::waved_transport(folder_, camera.frame_width,
                                                 camera.active_rows, wanted_.n_lights()));
  more_plan_ =
      "lights = [0, 4, 9, 13, 18, 22, 27, 31, 36, 40, 45, 49, 54, 58, 63]\nrepeats = 2\n"
      "retake_wrong_light = true\n";
  limit_ = 200s;  // each suspension takes two
  sim::FaultScript faults;
  faults.late_light = {.fraction = 0.1, .shows = firmware_iface::LateActing::Shows::at_once};
  tags_are_exact_ = false;
  capture(faults);
  EXPECT_GT(counters_.frames_doubted, 0U) << "none was late?";
  fmt::print("{} frames committed, {} of them withdrawn, {} suspensions\n", counters_.commits,
             counters_.frames_doubted, counters_.suspensions);
  const session::VerifyReport report = session::verify_session(session_);
  EXPECT_TRUE(report.is_good()) << report.problems.front();
  const session::Session session = session::Session::open(session_);
  double most = 0.0;
  for (const session::FrameRecord& frame : session.info().frames) {
    const double fraction = other_light(session, frame);
    most = std::max(most, fraction);
    // 0.003: what the noise of 3072 pixels makes of none.
    EXPECT_LE(fraction, frame.evidence.other_light_at_most.value_or(0.03) + 0.003)
        << frame.file;
    EXPECT_LE(fraction, 0.03) << frame.file;
  }
  fmt::print("{:.2f} % of another light at most\n", 100.0 * most);
  // One that was taken again only to show another light in between may have had the same before
  // it.
  EXPECT_GE(report.n_by_picture, 27);
}

TEST_F(WholeRig, LateLostRepeatedStaleAndSwappedFramesChangeNothing) {
  sim::FaultScript faults;
  faults.frames = {.late_fraction = 0.05,
                   .late_ms = 20.0,
                   .drop_fraction = 0.05,
                   .duplicate_fraction = 0.05,
                   .stale_fraction = 0.05,
                   .swap_fraction = 0.05,
                   .jitter_us = 50.0};
  capture(faults);
  EXPECT_GT(counters_.sequence_gaps, 0U);
  EXPECT_GT(counters_.duplicates, 0U);
  EXPECT_GT(counters_.frames_out_of_order, 0U);
}

TEST_F(WholeRig, AControllerThatRestartsIsFoundAgain) {
  capture({}, [this](Daemon&) { rig_->controller().restart(200ms); });
  EXPECT_EQ(counters_.controller_reboots, 1U);
}

TEST_F(WholeRig, ADarkFrameComesWhenTheControllerHasWarmedUp) {
  more_plan_ = "darks_every = 1000\ndarks_every_c = 2\nspare_darks = 2\n";
  capture({}, [this](Daemon&) { rig_->controller().set_temperature(31.0); });
  const session::SessionInfo info = session::Session::open(session_).info();
  ASSERT_EQ(info.frames.size(), 68U);  // dark, 64 lights, dark, 2 spare
  const session::FrameEvidence& called = info.frames[66].evidence;
  EXPECT_EQ(called.temperature_c, 31.0);
  int n_before = 0;
  for (const session::FrameRecord& frame : info.frames) {
    n_before += frame.evidence.t_exposure_start_ns < called.t_exposure_start_ns ? 1 : 0;
  }
  EXPECT_GE(n_before, 10);
  EXPECT_LT(n_before, 60) << "before the last lights, though it stands behind them";
}

TEST_F(WholeRig, AnOpenInterlockSuspendsTheRunUntilItCloses) {
  capture({}, [this](Daemon& daemon) {
    rig_->controller().set_interlock_open(true);
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    while (daemon.state().phase != Phase::suspended &&
           std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_EQ(daemon.state().reasons, kHeldBack) << daemon.state().reason_text;
    rig_->controller().set_interlock_open(false);
  });
  EXPECT_GE(counters_.suspensions, 1U);
}

TEST_F(WholeRig, ACameraThatIsCutOffIsFoundAgain) {
  capture({}, [this](Daemon&) { rig_->camera(0).disconnect_client(); });
  EXPECT_GE(counters_.camera_faults, 1U);
}

// ---- saturation: the shipped rig's full well ends below its converter

class OverexposedRig : public WholeRig {
 protected:
  static constexpr int kLight = 5;

  /// Light 5 gives `electrons` a pixel, the others 0.75 of that.
  void capture_at(double electrons) {
    std::vector<float> brightness(static_cast<std::size_t>(wanted_.n_lights()), 0.75F);
    brightness[kLight] = 1.0F;
    transports_.clear();
    const CameraSpec& camera = wanted_.cameras.front();
    transports_.push_back(
        testing::flat_transport(folder_, camera.frame_width, camera.active_rows, brightness));
    options_.lit_electrons = electrons * transports_.front().scale();
    more_plan_ = "max_saturated_share = 0.01\nattempts = 2\n";
    capture({});
    const session::Session session = session::Session::open(session_);
    for (const session::FrameRecord& frame : session.info().frames) {
      const session::Shot& shot = session.info().shots[static_cast<std::size_t>(frame.shot)];
      if (shot.kind == session::ShotKind::light && shot.lit.front().light == kLight) {
        frame_ = frame;
      }
    }
    const session::VerifyReport report = session::verify_session(session_);
    EXPECT_TRUE(report.is_good()) << report.problems.front();
  }

  session::FrameRecord frame_;
};

// The well holds 16000 electrons and counts as full from 15520 on, photon noise there is 125.

TEST_F(OverexposedRig, AnOverexposedLightIsTakenAgain) {
  capture_at(15520.0 + 1000.0);
  EXPECT_EQ(counters_.checks_failed, 1U);
  EXPECT_EQ(frame_.attempt, 1);
  EXPECT_EQ(frame_.evidence.verdict, session::FrameVerdict::saturated);
  EXPECT_EQ(frame_.evidence.saturated_fraction, 1.0);
  EXPECT_EQ(frame_.evidence.max_dn, 16256) << "white, 16383, is never reached";
}

TEST_F(OverexposedRig, AFarOverexposedLightIsSaturatedAndNotWithoutAPicture) {
  capture_at(18000.0);  // every pixel holds the same word
  EXPECT_EQ(counters_.checks_failed, 1U);
  EXPECT_EQ(frame_.evidence.verdict, session::FrameVerdict::saturated);
  EXPECT_EQ(frame_.evidence.min_dn, frame_.evidence.max_dn);
}

TEST_F(OverexposedRig, ALightJustBelowIsNot) {
  capture_at(15520.0 - 4.0 * 125.0);  // 3e-5 of the pixels
  EXPECT_EQ(counters_.checks_failed, 0U);
  EXPECT_EQ(frame_.attempt, 0);
  EXPECT_EQ(frame_.evidence.verdict, session::FrameVerdict::good);
  EXPECT_LT(frame_.evidence.saturated_fraction, 0.002);
}

// ---- sync modes

TEST_F(WholeRig, TheCamerasStrobeStepsTheTable) {
  wanted_.sync = SyncMode::camera_leads;
  capture({});
  EXPECT_GE(counters_.blocks, 1U);
  EXPECT_EQ(counters_.table_mismatches, 0U);
}

TEST_F(WholeRig, ALightThatDoesNotFitOneFrameStepsAtEverySecondStrobe) {
  wanted_.sync = SyncMode::camera_leads;
  wanted_.strobe_every = 2;
  wanted_.cameras.front().exposure_us = 4000.0;  // of 4166.7, and 320 to settle
  capture({});
}

TEST_F(WholeRig, LostAndFalseStrobesAndLostFramesCostFramesAndPairNoneWrongly) {
  wanted_.sync = SyncMode::camera_leads;
  options_.strobe_lost_probability = 0.1;
  options_.strobe_false_probability = 0.1;
  sim::FaultScript faults;
  faults.frames = {.drop_fraction = 0.02, .duplicate_fraction = 0.02, .jitter_us = 20.0};
  capture(faults);
  EXPECT_GT(counters_.strobe_unproven, 0U);
}

TEST_F(WholeRig, ASlowDiskEndsABlockEarlyAndLosesNothing) {
  wanted_.sync = SyncMode::camera_leads;
  storage_ = std::make_unique<SlowStorage>();
  capture({});
  EXPECT_GT(counters_.blocks_cut, 0U);
  // A commit takes 30 ms and a frame 4: held back by nothing, six frames of seven would find no
  // buffer. A busy machine alone may cost a few.
  const sim::CameraServerCounts counts = rig_->camera(0).counts();
  EXPECT_LT(counts.n_no_buffer, counts.n_delivered / 4);
}

TEST_F(WholeRig, AnInterlockThatOpensWithinABlockIsNamedAndWaitedFor) {
  wanted_.sync = SyncMode::camera_leads;
  capture({}, [this](Daemon& daemon) {
    rig_->controller().set_interlock_open(true);
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    while (daemon.state().phase != Phase::suspended &&
           std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_EQ(daemon.state().reasons, kHeldBack);
    EXPECT_THAT(daemon.state().reason_text, ::testing::HasSubstr("the interlock is open"));
    rig_->controller().set_interlock_open(false);
  });
}

TEST_F(WholeRig, AControllerThatRestartsWithinABlockIsFoundAgain) {
  wanted_.sync = SyncMode::camera_leads;
  capture({}, [this](Daemon&) { rig_->controller().restart(200ms); });
  EXPECT_EQ(counters_.controller_reboots, 1U);
}

TEST_F(WholeRig, TheHostTriggersTheCameraWhenTheLightStands) {
  wanted_.sync = SyncMode::light_leads;
  capture({});
}

TEST_F(WholeRig, TheControllerTriggersTheCameraAfterEachLatch) {
  wanted_.sync = SyncMode::controller_leads;
  capture({});
}

TEST_F(WholeRig, ATriggeredFrameThatIsLostIsRequestedAgain) {
  wanted_.sync = SyncMode::light_leads;
  sim::FaultScript faults;
  faults.frames = {.drop_fraction = 0.05};
  capture(faults);
  EXPECT_GT(counters_.shot_timeouts, 0U);
}

TEST_F(WholeRig, ALightThatDoesNotFitIsRefusedWithTheArithmetic) {
  wanted_.sync = SyncMode::camera_leads;
  wanted_.cameras.front().shutter = Shutter::rolling;
  wanted_.cameras.front().skew_us = 3000.0;
  try {
    (void)expand_plan(
        parse_plan_file("schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\n", "p.toml"),
        wanted_);
    FAIL() << "it was not refused";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr(
                                  "exposure 2000.0 + skew 3000.0 + settle 220.0 + guard 100.0 "
                                  "= 5320.0 us, and 1 x 4166.7 = 4166.7 us per step"));
    EXPECT_THAT(error.what(), ::testing::HasSubstr("strobe_every = 2"));
  }
}

}  // namespace
}  // namespace haarlight::capture
