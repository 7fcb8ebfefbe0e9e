// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/sequencer.h"

#include <array>
#include <cstdlib>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/sequencer/model_rig.h"
#include "tests/drawn_seed.h"

namespace haarlight::capture {
namespace {

std::string tail_of(const ModelRig& rig) {
  std::string text;
  for (const std::string& line : rig.log()) {
    text += line + "\n";
  }
  return text;
}

ModelOutcome run_session(std::uint64_t seed, bool is_verbose) {
  const ModelRigConfig config = random_model_rig(seed);
  const auto plan = random_model_plan(config, 12);
  ModelRig rig(config, plan);
  ModelOutcome outcome = rig.run(std::vector<bool>(plan->shots.size(), false),
                                 std::vector<int>(plan->shots.size(), 0));
  if (!outcome.problem.empty() || is_verbose) {
    outcome.problem += fmt::format("\n{}", tail_of(rig));
  }
  return outcome;
}

/// Every committed frame saw its own pattern alone, every shot is done, every buffer is given
/// back, no abort takes longer than 200 ms: under every fault, for every seed. 500 seeds, or
/// HAARLIGHT_SESSIONS of them: 10 000 in the slow tests. Replay one seed with HAARLIGHT_SEED=n.
TEST(SequencerSimulation, EverySessionWithFaultsKeepsEveryPromise) {
  if (const char* one = std::getenv("HAARLIGHT_SEED"); one != nullptr) {
    const ModelOutcome outcome = run_session(std::strtoull(one, nullptr, 10), true);
    EXPECT_TRUE(outcome.is_done) << outcome.problem;
    return;
  }
  const std::uint64_t n_sessions = testing::number_from("HAARLIGHT_SESSIONS", 500);
  ModelOutcome sum;
  std::array<std::uint64_t, 4> n_by_mode{};
  for (std::uint64_t seed = 1; seed <= n_sessions; ++seed) {
    const ModelOutcome outcome = run_session(seed, false);
    ASSERT_TRUE(outcome.is_done && outcome.problem.empty())
        << "HAARLIGHT_SEED=" << seed << " " << outcome.problem;
    sum.n_commits += outcome.n_commits;
    sum.n_events += outcome.n_events;
    sum.seconds += outcome.seconds;
    sum.counters.frames += outcome.counters.frames;
    sum.counters.duplicates += outcome.counters.duplicates;
    sum.counters.sequence_gaps += outcome.counters.sequence_gaps;
    sum.counters.confirms_failed += outcome.counters.confirms_failed;
    sum.counters.suspensions += outcome.counters.suspensions;
    sum.counters.light_faults += outcome.counters.light_faults;
    sum.counters.commit_faults += outcome.counters.commit_faults;
    sum.counters.controller_reboots += outcome.counters.controller_reboots;
    sum.counters.blocks += outcome.counters.blocks;
    sum.counters.blocks_cut += outcome.counters.blocks_cut;
    sum.counters.strobe_unproven += outcome.counters.strobe_unproven;
    sum.counters.table_mismatches += outcome.counters.table_mismatches;
    ++n_by_mode.at(static_cast<std::size_t>(random_model_rig(seed).sync));
  }
  fmt::print(
      "{} sessions, {} commits, {} frames, {} events, {:.0f} virtual s; {} duplicates, {} "
      "gaps, {} "
      "failed confirmations, {} suspensions, {} light faults, {} commit faults, {} reboots\n",
      n_sessions, sum.n_commits, sum.counters.frames, sum.n_events, sum.seconds,
      sum.counters.duplicates, sum.counters.sequence_gaps, sum.counters.confirms_failed,
      sum.counters.suspensions, sum.counters.light_faults, sum.counters.commit_faults,
      sum.counters.controller_reboots);
  fmt::print(
      "free-run {}, light leads {}, camera leads {}, controller leads {}; {} blocks, {} ended "
      "early, {} frames unproven by the strobe, {} table mismatches\n",
      n_by_mode[0], n_by_mode[1], n_by_mode[2], n_by_mode[3], sum.counters.blocks,
      sum.counters.blocks_cut, sum.counters.strobe_unproven, sum.counters.table_mismatches);
  for (const std::uint64_t n : n_by_mode) {
    EXPECT_GT(n, n_sessions / 8);
  }
  EXPECT_GT(sum.counters.blocks_cut, n_sessions / 100);
  EXPECT_GT(sum.counters.strobe_unproven, n_sessions / 10);
  EXPECT_GT(sum.counters.table_mismatches, n_sessions / 100);
  // The faults did happen.
  EXPECT_GT(sum.counters.duplicates, n_sessions / 10);
  EXPECT_GT(sum.counters.confirms_failed, n_sessions / 100);
  EXPECT_GT(sum.counters.controller_reboots, n_sessions / 100);
}

TEST(SequencerSimulation, TheSameSeedGivesTheSameSession) {
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    const ModelOutcome a = run_session(seed, false);
    const ModelOutcome b = run_session(seed, false);
    EXPECT_EQ(a.n_events, b.n_events) << seed;
    EXPECT_EQ(a.seconds, b.seconds) << seed;
    EXPECT_EQ(a.n_commits, b.n_commits) << seed;
  }
}

TEST(SequencerSimulation, WithoutFaultsALightTakesTwoFramesAndNothingIsRetried) {
  ModelRigConfig config;
  config.fps = 120.0;
  auto plan = std::make_shared<SequencerPlan>();
  for (std::uint32_t k = 0; k < 200; ++k) {
    plan->shots.push_back({.tag = kFirstTag + k, .exposure_us = 4000.0});
  }
  plan->read_us = config.read_us = 5000.0;
  plan->frame_us = 1e6 / 120.0;
  plan->settle_ns = 350'000;
  ModelRig rig(config, plan);
  const ModelOutcome outcome = rig.run(std::vector<bool>(200, false), std::vector<int>(200, 0));
  EXPECT_TRUE(outcome.is_done) << outcome.problem << tail_of(rig);
  EXPECT_EQ(outcome.n_commits, 200);
  EXPECT_EQ(outcome.counters.retries, 0U);
  EXPECT_LE(static_cast<double>(outcome.counters.frames), 2.3 * 200);
}

// The devices' threads do one command after the other: a camera that is stopped while it starts
// and started again delivers the second stream. Aborts alone cost no shot its frame.
TEST(SequencerSimulation, AbortsAloneCostNoShotItsFrame) {
  std::uint64_t n_starts = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    ModelRigConfig config;
    config.seed = seed;
    config.faults.abort_rate = 5.0;
    set_sync_mode(config, seed % 2 == 0 ? SyncMode::light_leads : SyncMode::controller_leads);
    const auto plan = random_model_plan(config, 200);
    ModelRig rig(config, plan);
    const ModelOutcome outcome = rig.run(std::vector<bool>(plan->shots.size(), false),
                                         std::vector<int>(plan->shots.size(), 0));
    ASSERT_TRUE(outcome.is_done && outcome.problem.empty()) << seed << outcome.problem;
    EXPECT_EQ(outcome.counters.shot_timeouts, 0U) << seed << "\n" << tail_of(rig);
    n_starts += rig.state().stream;
  }
  EXPECT_GT(n_starts, 400U);
}

// ---- single steps ----

struct Driver {
  SequencerState state;
  std::vector<Action> actions;
  std::int64_t t_ns = 0;

  void send(EventBody body) {
    StepResult result = step(std::move(state), TimedEvent{t_ns, std::move(body)});
    state = std::move(result.state);
    actions = std::move(result.actions);
  }
  template <class T>
  [[nodiscard]] const T* find() const {
    for (const Action& action : actions) {
      if (const T* found = std::get_if<T>(&action)) {
        return found;
      }
    }
    return nullptr;
  }
};

std::shared_ptr<const SequencerPlan> two_shots() {
  auto plan = std::make_shared<SequencerPlan>();
  plan->shots = {{.tag = 1, .exposure_us = 1000.0}, {.tag = 2, .exposure_us = 1000.0}};
  plan->frame_us = 10000.0;
  plan->read_us = 1000.0;
  plan->settle_ns = 100'000;
  return plan;
}

/// Of a camera with a period of 0.1 ms, so that every timestamp of a single step lies on it.
event::FrameArrived frame_at(std::uint64_t frame, std::int64_t timestamp_ns) {
  return {.frame = frame,
          .stream = 1,
          .info = {.sequence = static_cast<std::uint64_t>(100 + timestamp_ns / 100'000),
                   .timestamp_ns = timestamp_ns,
                   .arrival_ns = timestamp_ns + 10'000,
                   .flags = kFrameMonotonic,
                   .exposure_us = 1000.0},
          .pixel_hash = frame * 1000 + 1};
}

/// Light and camera are there, no frame came yet.
Driver devices_there(std::shared_ptr<const SequencerPlan> plan = two_shots()) {
  Driver d;
  d.send(event::Booted{});
  d.send(event::Recovered{});
  d.send(event::Run{std::move(plan), {false, false}, {0, 0}});
  d.send(event::LightConnected{d.state.job, 77, 16});
  d.send(event::CameraStarted{d.state.stream, 1000.0, 8});
  return d;
}

/// `n` frames of a stream, the last one timestamped `last_ns`.
void send_frames(Driver& d, std::size_t n, std::int64_t last_ns) {
  for (std::size_t k = n; k-- > 0;) {
    event::FrameArrived frame =
        frame_at(1000 + k, last_ns - static_cast<std::int64_t>(k) * 100'000);
    frame.stream = d.state.stream;
    d.send(frame);
  }
}

/// Its period is known, shot 0 is being latched.
Driver running() {
  Driver d = devices_there();
  send_frames(d, FrameRhythm::kFirst, 0);
  return d;
}

/// Running, shot 0 latched at 1 ms, light stable from 1.2 ms.
Driver collecting() {
  Driver d = running();
  d.t_ns = 1'200'000;
  d.send(event::LightShown{d.state.job,
                           firmware_iface::LatchReceipt{1'000'000, 1'050'000, 1'100'000, 1}});
  return d;
}

TEST(Sequencer, BootLeadsToIdleAndARunToPreflight) {
  Driver d;
  EXPECT_EQ(d.state.phase, Phase::boot);
  d.send(event::Booted{});
  EXPECT_EQ(d.state.phase, Phase::recover);
  d.send(event::Recovered{});
  EXPECT_EQ(d.state.phase, Phase::idle);
  d.send(event::Run{two_shots(), {false, false}, {0, 0}});
  EXPECT_EQ(d.state.phase, Phase::preflight);
  EXPECT_NE(d.find<action::ConnectLight>(), nullptr);
  EXPECT_EQ(d.find<action::StartCamera>(), nullptr) << "not before the lights are known";
  d.send(event::LightConnected{d.state.job, 77});
  EXPECT_NE(d.find<action::StartCamera>(), nullptr);
  d.send(event::CameraStarted{d.state.stream, 1000.0, 8});
  EXPECT_EQ(d.state.phase, Phase::preflight) << "not before the camera's period is known";
  send_frames(d, FrameRhythm::kFirst, 0);
  EXPECT_EQ(d.state.phase, Phase::running);
}

// ---- the camera's period is learnt in the dark

bool lights_or_arms(const Driver& d) {
  return d.find<action::ShowShot>() != nullptr || d.find<action::UploadTable>() != nullptr ||
         d.find<action::ArmBlock>() != nullptr;
}

/// Sends one frame less than a period takes, then the last one.
void expect_learnt_in_the_dark(Driver& d, std::int64_t last_ns) {
  ASSERT_FALSE(lights_or_arms(d));
  for (std::size_t k = FrameRhythm::kFirst; k-- > 0;) {
    EXPECT_EQ(d.state.phase, Phase::preflight) << k;
    EXPECT_TRUE(d.state.is_dark);
    send_frames(d, 1, last_ns - static_cast<std::int64_t>(k) * 100'000);
    EXPECT_NE(d.find<action::DropFrame>(), nullptr);
    EXPECT_EQ(lights_or_arms(d), k == 0) << k;
  }
  EXPECT_EQ(d.state.phase, Phase::running);
  EXPECT_EQ(d.state.counters.rhythm_unknown % FrameRhythm::kFirst, 0U);
}

std::shared_ptr<const SequencerPlan> two_shots_in(SyncMode sync) {
  auto plan = std::make_shared<SequencerPlan>(*two_shots());
  plan->sync = sync;
  return plan;
}

TEST(Sequencer, AFreeCamerasPeriodIsLearntBeforeTheFirstLight) {
  for (const SyncMode sync : {SyncMode::free_run, SyncMode::camera_leads}) {
    SCOPED_TRACE(to_string(sync));
    Driver d = devices_there(two_shots_in(sync));
    // Distinct pictures are not required: timestamps alone are learnt from.
    expect_learnt_in_the_dark(d, 0);
    EXPECT_EQ(d.state.shot_deadline_ns, kNever);
  }
}

TEST(Sequencer, ACameraThatStartsAgainIsLearntAgainInTheDark) {
  for (const SyncMode sync : {SyncMode::free_run, SyncMode::camera_leads}) {
    SCOPED_TRACE(to_string(sync));
    Driver d = devices_there(two_shots_in(sync));
    send_frames(d, FrameRhythm::kFirst, 0);
    d.send(event::CameraFault{d.state.stream, Errc::device_gone, "unplugged"});
    ASSERT_EQ(d.state.phase, Phase::suspended);
    d.t_ns = d.state.retry_camera_ns;
    d.send(event::Tick{});
    ASSERT_NE(d.find<action::StartCamera>(), nullptr);
    d.send(event::CameraStarted{d.state.stream, 1000.0, 8});
    expect_learnt_in_the_dark(d, d.t_ns);
  }
}

TEST(Sequencer, APeriodThatIsLostOnTheWayIsLearntInTheDark) {
  Driver d = collecting();
  d.state.rhythm = FrameRhythm();  // as after frames that all came in another rhythm
  d.t_ns = d.state.shot_deadline_ns;
  d.send(event::Tick{});
  EXPECT_EQ(d.state.counters.shot_timeouts, 1U);
  EXPECT_NE(d.find<action::LightsOff>(), nullptr) << "the light of the shot that was given up";
  expect_learnt_in_the_dark(d, d.t_ns);
}

TEST(Sequencer, ARunThatGoesOnWithTheSameStreamLearnsNothingAnew) {
  Driver d = collecting();
  d.send(event::Pause{});
  send_frames(d, 3, 2'000'000);
  d.send(event::Resume{});
  EXPECT_EQ(d.state.phase, Phase::running);
  EXPECT_NE(d.find<action::ShowShot>(), nullptr);
}

TEST(Sequencer, WhereTheCameraIsTriggeredTheLightWaitsForNoFrame) {
  for (const SyncMode sync : {SyncMode::light_leads, SyncMode::controller_leads}) {
    const Driver d = devices_there(two_shots_in(sync));
    EXPECT_NE(d.find<action::ShowShot>(), nullptr) << to_string(sync);
  }
  auto preview = std::make_shared<SequencerPlan>(*two_shots());
  preview->is_preview = true;
  EXPECT_NE(devices_there(preview).find<action::ShowShot>(), nullptr) << "preview";
}

/// Controller leads: shot 0 was latched at 1 ms and given up at 2 ms.
Driver given_up(const EventBody& answer) {
  Driver d = devices_there(two_shots_in(SyncMode::controller_leads));
  d.t_ns = 2'000'000;
  d.send(answer);
  return d;
}

/// Dark until `latch_ns`, then latched.
void expect_latched_at(Driver d, std::int64_t latch_ns) {
  EXPECT_EQ(d.find<action::ShowShot>(), nullptr);
  ASSERT_NE(d.find<action::LightsOff>(), nullptr);
  d.t_ns = 3'000'000;
  d.send(event::LightDark{d.state.job});
  ASSERT_EQ(d.state.deadline_ns, latch_ns);
  d.t_ns = latch_ns;
  d.send(event::Tick{});
  EXPECT_NE(d.find<action::ShowShot>(), nullptr);
}

TEST(Sequencer, ThePulseOfALatchGivenUpIsWaitedForInTheDark) {
  const std::uint64_t job = devices_there(two_shots_in(SyncMode::controller_leads)).state.job;
  // It may act 100 ms after its fault and is told apart 20 ms later.
  expect_latched_at(given_up(event::LightFault{job, Errc::timeout, "no answer"}), 122'000'000);
  expect_latched_at(given_up(event::LightShown{job, {1'000'000, 1'050'000, 1'100'000, 9}}),
                    122'000'000);
  // Read back, it has acted: only its pulse is open.
  Driver d = given_up(event::LightShown{job, {1'000'000, 1'050'000, 1'100'000, 1}});
  d.send(event::Pause{});
  ASSERT_NE(d.find<action::LightsOff>(), nullptr);
  d.send(event::LightDark{d.state.job});
  d.send(event::Resume{});
  EXPECT_EQ(d.find<action::ShowShot>(), nullptr);
  EXPECT_EQ(d.state.deadline_ns, 21'100'000);
  // Given up before its answer: it counts from the answer to the next request.
  d = given_up(event::Pause{});
  d.send(event::Resume{});
  EXPECT_EQ(d.find<action::ShowShot>(), nullptr);
  EXPECT_EQ(d.state.deadline_ns, kNever);
  d.t_ns = 5'000'000;
  d.send(event::LightDark{d.state.job});
  EXPECT_EQ(d.state.deadline_ns, 125'000'000);
  d.t_ns = 125'000'000;
  d.send(event::Tick{});
  EXPECT_NE(d.find<action::ShowShot>(), nullptr);
}

TEST(Sequencer, AFrameOfAnOpenTriggerDoesNotBringTheNextOneForward) {
  Driver d = devices_there(two_shots_in(SyncMode::light_leads));
  d.t_ns = 1'200'000;
  d.send(event::LightShown{d.state.job, {1'000'000, 1'050'000, 1'100'000, 1}});
  EXPECT_EQ(d.state.trigger_ns, 1'300'000) << "a guard after the light stands";
  d.t_ns = 1'300'000;
  d.send(event::Tick{});
  ASSERT_NE(d.find<action::TriggerCamera>(), nullptr);
  d.send(event::Pause{});
  d.send(event::LightDark{d.state.job});
  d.send(event::Resume{});
  d.t_ns = 3'200'000;
  d.send(event::LightShown{d.state.job, {3'000'000, 3'050'000, 3'100'000, 1}});
  ASSERT_EQ(d.state.trigger_ns, 21'300'000) << "20 ms after the one that is open";
  d.t_ns = 4'000'000;
  d.send(frame_at(1, 3'500'000));
  EXPECT_EQ(d.state.trigger_ns, 21'300'000);
}

TEST(Sequencer, APeriodThatIsNotLearntInTimeSuspendsDarkAndIsWaitedForAgain) {
  for (const SyncMode sync : {SyncMode::free_run, SyncMode::camera_leads}) {
    SCOPED_TRACE(to_string(sync));
    Driver d = devices_there(two_shots_in(sync));
    send_frames(d, FrameRhythm::kFirst - 1, 0);
    for (int i = 0; i < 3; ++i) {
      ASSERT_EQ(d.state.deadline_ns, d.t_ns + 3'320'000'000) << "3 s and 32 frames";
      d.t_ns = d.state.deadline_ns;
      d.send(event::Tick{});
      EXPECT_EQ(d.state.phase, Phase::suspended);
      EXPECT_EQ(d.state.reasons, kNoEvidence);
      EXPECT_THAT(d.state.reason_text, ::testing::HasSubstr("not known after 3.3 s"));
      d.t_ns = d.state.deadline_ns;
      d.send(event::Tick{});
      ASSERT_EQ(d.state.phase, Phase::preflight);
      EXPECT_FALSE(lights_or_arms(d));
    }
    d.send(event::Abort{});
    EXPECT_EQ(d.state.phase, Phase::idle);
    EXPECT_EQ(d.state.deadline_ns, kNever);
  }
}

/// A camera that is lost twice per second: each light is photographed as soon as it stands, the
/// first ones after a start like all others.
TEST(SequencerSimulation, TheFirstLightAfterAStartIsTakenFromItsFirstCleanFrame) {
  for (const SyncMode sync : {SyncMode::free_run, SyncMode::camera_leads}) {
    ModelRigConfig config;
    config.sync = sync;
    config.bus_us = 500.0;
    config.n_buffers = 10;
    config.faults.camera_gone_rate = 2.0;
    auto plan = std::make_shared<SequencerPlan>();
    for (std::uint32_t k = 0; k < 400; ++k) {
      plan->shots.push_back({.tag = kFirstTag + k, .exposure_us = 2000.0});
    }
    plan->timestamp = config.timestamp;
    plan->read_us = config.read_us;
    plan->frame_us = 1e6 / config.fps;
    plan->settle_ns = 400'000;
    plan->sync = sync;
    ModelRig rig(config, plan);
    int n_later = 0;
    // One frame may begin after the light stood and before the host could know it.
    rig.set_commit([&](const action::CommitFrame& commit, const ModelFrame& frame) {
      EXPECT_LE(frame.n_clean, 1) << to_string(sync) << ", shot " << commit.shot;
      n_later += frame.n_clean > 0 ? 1 : 0;
      return true;
    });
    const ModelOutcome outcome =
        rig.run(std::vector<bool>(400, false), std::vector<int>(400, 0));
    EXPECT_TRUE(outcome.is_done && outcome.problem.empty()) << outcome.problem << tail_of(rig);
    EXPECT_GE(outcome.counters.camera_faults, 5U) << "a test that restarts nothing";
    fmt::print("{}: {} faults of the camera, {} of 400 lights not by the first clean frame\n",
               to_string(sync), outcome.counters.camera_faults, n_later);
  }
}

TEST(Sequencer, AFrameBegunBeforeTheLightStoodIsNotTaken) {
  Driver d = collecting();
  // end of frame = start + E + read: this one began at 1.1 ms, the light is stable from 1.2 ms.
  d.t_ns = 3'200'000;
  d.send(frame_at(1, 3'100'000));
  EXPECT_NE(d.find<action::DropFrame>(), nullptr);
  EXPECT_EQ(d.state.current, 0);
  EXPECT_EQ(d.state.discarded, 1);
}

TEST(Sequencer, AFrameBegunAtTheStableMomentIsTakenAndTheLightQueried) {
  Driver d = collecting();
  d.t_ns = 3'250'000;
  d.send(frame_at(1, 3'200'000));
  const auto* show = d.find<action::ShowShot>();
  ASSERT_NE(show, nullptr);
  EXPECT_EQ(show->shot, 1);
  ASSERT_TRUE(show->confirm.has_value());
  EXPECT_EQ(*show->confirm, (ConfirmRequest{.frame = 1, .tag = 1}));
  EXPECT_EQ(d.find<action::CheckFrame>(), nullptr) << "not before the controller's word";
}

TEST(Sequencer, TheEvidenceHoldsWhatTheRuleNeeds) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(9, 3'700'000));
  d.t_ns = 4'100'000;
  d.send(event::LightConfirmed{.frame = 9, .t_request_ns = 4'050'000, .tag = 1, .boot_id = 77});
  const auto* check = d.find<action::CheckFrame>();
  ASSERT_NE(check, nullptr);
  EXPECT_EQ(check->evidence.t_exposure_start_ns, 1'700'000);
  EXPECT_EQ(check->evidence.t_exposure_end_ns, 2'700'000);
  EXPECT_EQ(check->evidence.t_stable_ns, 1'200'000);
  EXPECT_EQ(check->evidence.t_next_change_ns, 4'050'000);
  EXPECT_DOUBLE_EQ(check->evidence.margin_us, 500.0);
  EXPECT_EQ(check->evidence.sequence, 137U);
  EXPECT_EQ(check->evidence.t_shown_ns, 1'100'000);
}

/// Shot 0 has its frame 9, which the checks have.
Driver checking() {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(9, 3'700'000));
  d.t_ns = 4'100'000;
  d.send(event::LightConfirmed{.frame = 9, .t_request_ns = 4'050'000, .tag = 1, .boot_id = 77});
  return d;
}

TEST(Sequencer, AShotThatIsContradictedForTheSecondTimeSuspendsForTwoSeconds) {
  Driver d = checking();
  d.state.times_doubted[0] = 1;
  d.send(event::FrameChecked{.frame = 9, .shot = 0, .evidence = {}, .doubted = {0}});
  EXPECT_EQ(d.state.phase, Phase::running) << "not committed yet";
  d.send(event::FrameCommitted{.frame = 9, .shot = 0});
  EXPECT_EQ(d.state.phase, Phase::suspended);
  EXPECT_EQ(d.state.reasons, kWrongLight);
  EXPECT_THAT(d.state.reason_text, ::testing::HasSubstr("another frame of its lights"));
  EXPECT_EQ(d.state.shots[0], ShotState::pending);
  d.t_ns += 2'000'000'000;
  d.send(event::Tick{});
  EXPECT_EQ(d.state.reasons, 0U) << "tried again by itself";
}

TEST(Sequencer, WithdrawnShotsAreTakenAmidThoseThatWaitAlready) {
  Driver d = checking();
  d.send(event::FrameChecked{.frame = 9, .shot = 0, .evidence = {}});
  d.send(event::FrameCommitted{.frame = 9, .shot = 0});
  d.state.pending = {1, 2, 3};
  d.state.withdrawn = {2, 3};
  d.send(event::Reshoot{{0}});
  EXPECT_EQ(d.state.pending, (std::deque<int>{1, 2, 0, 3}));
}

TEST(Sequencer, AShotThatALaterPictureContradictsIsWithdrawnOnceItIsCommitted) {
  Driver d = checking();
  d.send(event::FrameChecked{.frame = 9, .shot = 0, .evidence = {}, .doubted = {0}});
  EXPECT_EQ(d.find<action::WithdrawShots>(), nullptr) << "not committed yet";
  d.send(event::FrameCommitted{.frame = 9, .shot = 0});
  const auto* withdrawn = d.find<action::WithdrawShots>();
  ASSERT_NE(withdrawn, nullptr);
  EXPECT_EQ(withdrawn->shots, std::vector<int>{0});
  EXPECT_EQ(d.state.shots[0], ShotState::pending);
  EXPECT_EQ(d.state.n_committed, 0);
}

TEST(Sequencer, AControllerThatShowsAnotherTagAfterwardsVoidsTheFrame) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(9, 3'700'000));
  d.send(event::LightConfirmed{.frame = 9, .t_request_ns = 3'990'000, .tag = 0, .boot_id = 77});
  EXPECT_EQ(d.find<action::CheckFrame>(), nullptr);
  EXPECT_NE(d.find<action::DropFrame>(), nullptr);
  const auto* show = d.find<action::ShowShot>();
  ASSERT_NE(show, nullptr);
  EXPECT_EQ(show->shot, 0) << "the same shot again";
  EXPECT_EQ(d.state.counters.confirms_failed, 1U);
}

TEST(Sequencer, AnotherBootOfTheControllerVoidsTheFrameAndConnectsAgain) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(9, 3'700'000));
  d.send(event::LightConfirmed{.frame = 9, .t_request_ns = 3'990'000, .tag = 1, .boot_id = 78});
  EXPECT_EQ(d.state.phase, Phase::suspended);
  d.send(event::Tick{});
  ASSERT_NE(d.find<action::ConnectLight>(), nullptr);
  d.send(event::LightConnected{d.state.job, 78});
  EXPECT_EQ(d.state.phase, Phase::running);
  const auto* show = d.find<action::ShowShot>();
  ASSERT_NE(show, nullptr);
  EXPECT_EQ(show->shot, 0);
}

TEST(Sequencer, AGapInTheSequenceIsCountedAndTheTimestampDecides) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(1, 2'000'000));
  const std::uint64_t before = d.state.counters.sequence_gaps;
  d.send(frame_at(3, 3'700'000));
  EXPECT_EQ(d.state.counters.sequence_gaps, before + 1);
  EXPECT_EQ(d.state.current, 1) << "taken";
}

TEST(Sequencer, AFrameOutOfSequenceIsNotTaken) {
  Driver d = collecting();
  d.t_ns = 6'000'000;
  d.send(frame_at(5, 3'100'000));
  event::FrameArrived late = frame_at(4, 3'700'000);
  late.info.sequence = frame_at(5, 3'100'000).info.sequence - 1;
  d.send(late);
  EXPECT_EQ(d.state.counters.frames_out_of_order, 1U);
  EXPECT_EQ(d.state.current, 0);
}

TEST(Sequencer, ATimestampLaterThanItsArrivalIsNotTakenAndToldOfOnceAStream) {
  Driver d = collecting();
  d.t_ns = 9'000'000;  // that the sequencer came to it later does not make it true
  event::FrameArrived early = frame_at(1, 3'700'000);
  early.info.arrival_ns = early.info.timestamp_ns - 3'000'000;
  d.send(early);
  EXPECT_EQ(d.state.counters.timestamps_ahead, 1U);
  EXPECT_EQ(d.state.current, 0);
  const auto* line = d.find<action::LogEvent>();
  ASSERT_NE(line, nullptr);
  EXPECT_THAT(line->text,
              ::testing::HasSubstr("frame 137 is timestamped 3.000 ms after it came"));
  early = frame_at(2, 3'800'000);
  early.info.arrival_ns = early.info.timestamp_ns - 1;
  d.send(early);
  EXPECT_EQ(d.find<action::LogEvent>(), nullptr);
  EXPECT_EQ(d.state.counters.timestamps_ahead, 2U);
  d.send(frame_at(3, 3'900'000));
  EXPECT_EQ(d.state.current, 1) << "taken";
}

TEST(Sequencer, TheLightCountsFromTheReadBackAndNotFromTheAcknowledgement) {
  Driver d = collecting();
  d.send(event::Pause{});
  d.send(event::Resume{});
  d.t_ns = 61'200'000;  // acknowledged at 2 ms, shown 60 ms later
  d.send(event::LightShown{d.state.job,
                           firmware_iface::LatchReceipt{1'000'000, 2'000'000, 62'000'000, 1}});
  d.t_ns = 70'000'000;
  d.send(frame_at(1, 63'000'000));  // begun at 61 ms
  EXPECT_EQ(d.state.current, 0);
  d.send(frame_at(2, 64'100'000));
  EXPECT_EQ(d.state.current, 1);
}

TEST(Sequencer, ATimestampOffTheCamerasPeriodIsNotTaken) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  event::FrameArrived frame = frame_at(1, 3'700'000);
  frame.info.timestamp_ns += 1'540'000;
  frame.info.arrival_ns += 1'540'000;
  d.send(frame);
  EXPECT_EQ(d.state.counters.off_rhythm, 1U);
  EXPECT_EQ(d.state.current, 0);
}

TEST(Sequencer, APictureSeenBeforeIsNotTakenUnderANewNumber) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(1, 2'000'000));
  event::FrameArrived stale = frame_at(2, 3'700'000);
  stale.pixel_hash = frame_at(1, 0).pixel_hash;
  d.send(stale);
  EXPECT_EQ(d.state.counters.duplicates, 1U);
  EXPECT_EQ(d.state.current, 0);
  d.t_ns = d.state.shot_deadline_ns;
  d.send(event::Tick{});
  ASSERT_NE(d.find<action::LogEvent>(), nullptr);
  EXPECT_THAT(d.find<action::LogEvent>()->text,
              ::testing::HasSubstr("2 discarded (1 with the pixels of an earlier one)"));
}

TEST(Sequencer, DamagedOrWrongClockOrWrongExposureIsNotTaken) {
  Driver d = collecting();
  d.t_ns = 9'000'000;
  event::FrameArrived frame = frame_at(1, 3'700'000);
  frame.info.flags |= kFrameError;
  d.send(frame);
  frame = frame_at(2, 4'700'000);
  frame.info.flags = 0;
  d.send(frame);
  EXPECT_EQ(d.state.counters.frames_damaged, 2U);
  for (std::uint64_t k = 0; k < 4; ++k) {
    frame = frame_at(3 + k, 5'700'000 + static_cast<std::int64_t>(k) * 100'000);
    frame.info.exposure_us = 2000.0;
    d.send(frame);
  }
  EXPECT_EQ(d.state.counters.rhythm_unknown, FrameRhythm::kFirst + 1)
      << "another exposure may move the timestamps";
  EXPECT_EQ(d.state.counters.wrong_exposure, 3U);
  EXPECT_EQ(d.state.current, 0);
}

TEST(Sequencer, AWrongEchoIsAFaultAndTheShotIsShownAgain) {
  Driver d = running();
  d.send(event::LightShown{d.state.job, firmware_iface::LatchReceipt{0, 0, 0, 2}});
  EXPECT_EQ(d.state.counters.light_faults, 1U);
  const auto* show = d.find<action::ShowShot>();
  ASSERT_NE(show, nullptr);
  EXPECT_EQ(show->tag, 1U);
}

TEST(Sequencer, ARefusedPatternIsRequestedAgainAndEndsTheRunAtTheFourthTime) {
  Driver d = collecting();
  d.t_ns = 4'000'000;
  d.send(frame_at(9, 3'700'000));
  d.send(event::LightConfirmed{.frame = 9, .t_request_ns = 3'990'000, .tag = 1, .boot_id = 77});
  for (int i = 1; i < 4; ++i) {
    d.send(event::LightFault{d.state.job, Errc::refused, "power limit"});
    ASSERT_EQ(d.state.phase, Phase::suspended) << i;
    EXPECT_EQ(d.state.reasons, kHeldBack);
    EXPECT_NE(d.find<action::LightsOff>(), nullptr) << "what was lit may be lit still";
    d.send(event::LightDark{d.state.job});
    d.t_ns += 1'100'000'000;
    d.send(event::Tick{});
    ASSERT_EQ(d.state.phase, Phase::running) << i;
  }
  d.send(event::LightFault{d.state.job, Errc::refused, "power limit"});
  EXPECT_EQ(d.state.phase, Phase::aborting);
  EXPECT_THAT(d.state.reason_text, ::testing::HasSubstr("power limit"));
  EXPECT_THAT(d.state.reason_text, ::testing::HasSubstr("4 times"));
}

TEST(Sequencer, AControllerThatSaysNotNowIsTriedAgainAfterASecond) {
  Driver d = running();
  d.send(event::LightFault{d.state.job, Errc::device_busy, "interlock"});
  EXPECT_EQ(d.state.phase, Phase::suspended);
  EXPECT_EQ(d.state.reasons, kHeldBack);
  EXPECT_NE(d.find<action::LightsOff>(), nullptr);
  d.send(event::LightDark{d.state.job});
  EXPECT_EQ(d.state.deadline_ns, d.t_ns + 1'000'000'000);
  d.t_ns += 1'000'000'000;
  d.send(event::Tick{});
  EXPECT_EQ(d.state.phase, Phase::running);
  EXPECT_NE(d.find<action::ShowShot>(), nullptr);
}

TEST(Sequencer, AFaultOfTheControllerNamesTheShotThatWasShown) {
  Driver d = collecting();
  d.send(event::LightFault{0, Errc::device_gone, "renewing the lease: no such device"});
  ASSERT_EQ(d.state.reasons, kControllerLost);
  for (const Action& action : d.actions) {
    if (const auto* line = std::get_if<action::LogEvent>(&action);
        line && line->kind == session::EventKind::fault) {
      EXPECT_EQ(line->shot, 0);
    }
  }
  EXPECT_THAT(d.actions,
              ::testing::Contains(::testing::VariantWith<action::LogEvent>(
                  ::testing::Field(&action::LogEvent::kind, session::EventKind::fault))));
}

// Lost and, when it is looked for again, in another program's hands for a while.
TEST(Sequencer, ALostControllerThatIsBusyIsLookedForUntilItIsFree) {
  Driver d = collecting();
  d.send(event::LightFault{0, Errc::device_gone, "unplugged"});
  for (int i = 0; i < 30; ++i) {
    ASSERT_NE(d.state.deadline_ns, kNever) << "given up after " << i << " tries";
    d.t_ns = d.state.deadline_ns;
    d.send(event::Tick{});
    if (d.find<action::ConnectLight>() != nullptr) {
      d.send(event::LightFault{d.state.job, Errc::device_busy, "claimed by another program"});
    }
  }
  EXPECT_EQ(d.state.phase, Phase::suspended);
  while (d.find<action::ConnectLight>() == nullptr) {
    ASSERT_NE(d.state.deadline_ns, kNever);
    d.t_ns = d.state.deadline_ns;
    d.send(event::Tick{});
  }
  d.send(event::LightConnected{d.state.job, 77});
  EXPECT_EQ(d.state.phase, Phase::running);
}

TEST(Sequencer, AllOffIsAcceptedInEveryPhase) {
  Driver idle;
  idle.send(event::Booted{});
  idle.send(event::Recovered{});
  idle.send(event::SafeOff{});
  EXPECT_EQ(idle.state.phase, Phase::safe_off);
  EXPECT_NE(idle.find<action::LightsOff>(), nullptr);
  Driver running = collecting();
  running.send(event::SafeOff{});
  EXPECT_EQ(running.state.phase, Phase::safe_off);
  EXPECT_NE(running.find<action::LightsOff>(), nullptr);
  running.send(event::Pause{});
  running.send(event::SafeOff{});
  EXPECT_NE(running.find<action::LightsOff>(), nullptr) << "never optimised away";
}

TEST(Sequencer, AnAbortEndsWithoutAnswersWithin200Ms) {
  Driver d = collecting();
  d.send(event::Abort{});
  EXPECT_EQ(d.state.phase, Phase::aborting);
  EXPECT_EQ(d.state.deadline_ns, d.t_ns + 150'000'000);
  d.t_ns += 150'000'000;
  d.send(event::Tick{});
  EXPECT_EQ(d.state.phase, Phase::idle);
}

// The camera's thread may be at it still when the run is aborted and started again.
TEST(Sequencer, AnExposureSetForARunThatWasAbortedDoesNotEndTheNextOne) {
  auto plan = std::make_shared<SequencerPlan>(*two_shots());
  plan->shots[1].exposure_us = 2000.0;
  Driver d = devices_there(plan);
  send_frames(d, FrameRhythm::kFirst, 0);
  d.t_ns = 1'200'000;
  d.send(event::LightShown{d.state.job,
                           firmware_iface::LatchReceipt{1'000'000, 1'050'000, 1'100'000, 1}});
  d.t_ns = 4'000'000;
  d.send(frame_at(1, 3'900'000));
  const auto* set = d.find<action::SetExposure>();
  ASSERT_NE(set, nullptr);
  const std::uint64_t request = set->request;
  d.send(event::Abort{});
  d.t_ns += 150'000'000;
  d.send(event::Tick{});
  ASSERT_NE(d.find<action::StopCamera>(), nullptr);
  d.send(event::Run{plan, {false, false}, {0, 0}});
  d.send(event::LightConnected{d.state.job, 77, 16});
  ASSERT_NE(d.find<action::StartCamera>(), nullptr);
  EXPECT_EQ(d.find<action::StartCamera>()->exposure_us, 1000.0);
  d.send(event::ExposureSet{request, 2000.0});
  EXPECT_EQ(d.state.phase, Phase::preflight) << d.state.reason_text;
}

TEST(Sequencer, ACameraThatCannotSetTheExposureEndsTheRun) {
  Driver d;
  d.send(event::Booted{});
  d.send(event::Recovered{});
  d.send(event::Run{two_shots(), {false, false}, {0, 0}});
  d.send(event::LightConnected{d.state.job, 77});
  d.send(event::CameraStarted{d.state.stream, 1500.0, 8});
  EXPECT_NE(d.state.phase, Phase::running);
  EXPECT_THAT(d.state.reason_text, ::testing::HasSubstr("1500"));
}

// ---- dark frames by temperature

/// Two darks at the edges, `n` lights between them, and spare darks; 1 degree per second.
ModelOutcome warm_up(SyncMode sync, int n, int n_spare,
                     std::vector<std::pair<int, double>>& commits) {
  ModelRigConfig config;
  config.sync = sync;
  config.warming_c_per_s = 1.0;
  config.trigger_us = 1200.0;  // controller leads: settled and read back
  auto plan = std::make_shared<SequencerPlan>();
  const int n_shots = n + 2 + n_spare;
  for (int k = 0; k < n_shots; ++k) {
    plan->shots.push_back({.tag = kFirstTag + static_cast<std::uint32_t>(k),
                           .exposure_us = 2000.0,
                           .pattern_id = k,
                           .is_dark = k == 0 || k > n});
  }
  plan->timestamp = config.timestamp;
  plan->read_us = config.read_us;
  plan->frame_us = 1e6 / config.fps;
  plan->settle_ns = 400'000;
  plan->sync = sync;
  plan->darks_every_c = 0.5;
  ModelRig rig(config, plan);
  rig.set_commit([&](const action::CommitFrame& commit, const ModelFrame&) {
    commits.emplace_back(commit.shot, commit.evidence.temperature_c.value_or(-1.0));
    return true;
  });
  return rig.run(std::vector<bool>(plan->shots.size(), false),
                 std::vector<int>(plan->shots.size(), 0));
}

class DarksByTemperature : public ::testing::TestWithParam<SyncMode> {};

TEST_P(DarksByTemperature, NoFrameIsFartherFromADarkThanRequestedWhileSparesLast) {
  std::vector<std::pair<int, double>> commits;
  constexpr int kLights = 400;
  constexpr int kSpare = 40;
  const ModelOutcome outcome = warm_up(GetParam(), kLights, kSpare, commits);
  ASSERT_TRUE(outcome.is_done && outcome.problem.empty()) << outcome.problem;
  double dark_c = -100.0;
  int n_early = 0;
  bool is_light_left = true;
  for (const auto& [shot, temperature_c] : commits) {
    const bool is_dark = shot == 0 || shot > kLights;
    if (is_dark) {
      n_early += is_light_left && shot > kLights + 1 ? 1 : 0;
      dark_c = temperature_c;
    }
    is_light_left = is_light_left && shot != kLights;
    // Half a degree, and what it warms in the frames already on their way or armed.
    EXPECT_LT(std::abs(temperature_c - dark_c), 0.5 + 0.15) << "shot " << shot;
  }
  EXPECT_GE(n_early, static_cast<int>(outcome.seconds / 0.7) - 2) << outcome.seconds << " s";
  EXPECT_LT(n_early, kSpare) << "a spare one for the end is kept";
}

TEST_P(DarksByTemperature, WithoutSparesThePlanIsDoneAllTheSame) {
  std::vector<std::pair<int, double>> commits;
  const ModelOutcome outcome = warm_up(GetParam(), 200, 2, commits);
  ASSERT_TRUE(outcome.is_done && outcome.problem.empty()) << outcome.problem;
  ASSERT_EQ(commits.size(), 204U);
  EXPECT_GT(commits.back().first, 200) << "one is kept for the end";
}

INSTANTIATE_TEST_SUITE_P(Modes, DarksByTemperature,
                         ::testing::Values(SyncMode::free_run, SyncMode::light_leads,
                                           SyncMode::camera_leads, SyncMode::controller_leads),
                         [](const auto& param) {
                           return std::string("Mode") +
                                  std::to_string(static_cast<int>(param.param));
                         });

}  // namespace
}  // namespace haarlight::capture
