// SPDX-License-Identifier: Apache-2.0
/// A whole capture (sequencer, model rig on a virtual clock, session writer) stopped at every
/// operation that reaches the disk, with three kinds of crash; the restarted capture must end
/// in the undisturbed session, bit by bit: time is virtual, so the same frames come. On a real
/// clock another clean exposure may stand for a shot (capture/daemon/README.md).

#include <cerrno>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "capture/proof/frame_checks.h"
#include "capture/sequencer/model_rig.h"
#include "core/random.h"
#include "haarlight/capture/plan/plan.h"
#include "session/frame_check.h"
#include "session/session_writer.h"
#include "tests/session/faulty_disk.h"
#include "tests/session/small_session.h"

namespace haarlight::capture {
namespace {

namespace fs = std::filesystem;
using test::FaultyDisk;
using test::Survives;

/// Noise by pattern, as the simulator's: the same capture gives the same pixels.
Image<std::uint16_t> pixels_of(const session::SessionInfo& info, int shot) {
  Image<std::uint16_t> words(info.form.stored_height, info.form.width, 1);
  std::uint64_t i = 0;
  for (std::uint16_t& word : words.pixels()) {
    word = static_cast<std::uint16_t>(100 +
                                      hash_key(5, static_cast<std::uint64_t>(shot), ++i) % 900);
  }
  return words;
}

std::shared_ptr<const SequencerPlan> plan_of(const session::SessionInfo& info,
                                             const ModelRigConfig& rig) {
  auto plan = std::make_shared<SequencerPlan>();
  for (const session::Shot& shot : info.shots) {
    plan->shots.push_back({.tag = kFirstTag + static_cast<std::uint32_t>(shot.index),
                           .exposure_us = 2000.0,
                           .pattern_id = shot.index});
  }
  plan->timestamp = rig.timestamp;
  plan->read_us = rig.read_us;
  plan->skew_us = rig.skew_us;
  plan->frame_us = 1e6 / rig.fps;
  plan->settle_ns = static_cast<std::int64_t>((rig.latch_us + rig.rise_us) * 1e3) + 100'000;
  return plan;
}

/// SQLite turns a stop into an error of its own: here the process ends all the same.
void require_running(const FaultyDisk& disk) {
  if (disk.is_stopped()) {
    throw test::Stopped("the disk stopped");
  }
}

Result<session::SessionWriter> open_session(const fs::path& folder,
                                            const session::SessionInfo& info,
                                            FaultyDisk& disk) {
  std::error_code ignored;
  const bool is_made = fs::exists(folder / "start.json", ignored);
  if (!is_made) {
    fs::remove_all(folder, ignored);  // nothing was promised yet
  }
  auto opened =
      is_made ? session::SessionWriter::reopen(folder, disk)
              : session::SessionWriter::create(folder, info, "", test::kSmallPlan, 0, disk);
  require_running(disk);
  return opened;
}

/// Captures what is missing, as the daemon would; Stopped comes out when the disk stops.
/// @param kept  in: shots whose commit was answered before a crash, which must be there; shots
///              whose commit is answered now are added
void capture(const fs::path& folder, int n_lights, FaultyDisk& disk, std::uint64_t seed,
             std::vector<int>& kept) {
  const session::SessionInfo info = test::small_info(n_lights);
  auto opened = open_session(folder, info, disk);
  if (!opened) {
    opened = open_session(folder, info, disk);  // a disk that fails once
  }
  ASSERT_TRUE(opened.has_value()) << opened.error().what;
  session::SessionWriter writer = *std::move(opened);
  for (const int shot : kept) {
    EXPECT_TRUE(writer.committed()[static_cast<std::size_t>(shot)])
        << "the committed frame of shot " << shot << " was lost";
  }
  std::vector<int> next_attempt;
  for (int shot = 0; shot < n_lights; ++shot) {
    next_attempt.push_back(writer.next_attempt(shot));
  }
  ModelRigConfig config;
  config.seed = seed;
  config.fps = 240.0;
  config.commit_us = 500.0;
  ModelRig rig(config, plan_of(info, config));
  rig.set_commit([&](const action::CommitFrame& commit, const ModelFrame&) {
    const Image<std::uint16_t> words = pixels_of(info, commit.shot);
    session::PendingFrame frame{.shot = commit.shot,
                                .attempt = commit.attempt,
                                .evidence = commit.evidence,
                                .pixels = words.view()};
    const ImageView<const std::uint16_t> active(words.view().data(), info.form.height,
                                                info.form.width, 1);
    session::describe_pixels(active, info.form, frame.evidence);
    const auto done = writer.commit(std::span(&frame, 1));
    require_running(disk);
    EXPECT_TRUE(done || done.error().code == Errc::no_space || done.error().code == Errc::io)
        << done.error().what;
    if (done) {
      kept.push_back(commit.shot);
    }
    return done.has_value();
  });
  rig.set_finish([&] {
    const bool is_finished = writer.finish().has_value();
    require_running(disk);
    return is_finished;
  });
  const ModelOutcome outcome = rig.run(writer.committed(), next_attempt);
  EXPECT_TRUE(outcome.is_done && outcome.problem.empty()) << outcome.problem;
}

/// Stops at operation `stop_at`, crashes, restarts until it ends.
/// @return  how many operations an undisturbed session has, when stop_at is never
int stop_and_restart(int n_lights, int stop_at, Survives survives,
                     const std::vector<std::string>& expected) {
  test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  FaultyDisk disk({.stop_at = stop_at});
  std::vector<int> kept;
  try {
    capture(folder, n_lights, disk, 1, kept);
  } catch (const test::Stopped&) {
    disk.crash(temporary.path(), survives, static_cast<std::uint64_t>(stop_at));
    std::error_code ignored;
    if (!fs::exists(folder / "start.json", ignored)) {
      fs::remove_all(folder, ignored);  // nothing was promised yet: the operator starts again
    }
    FaultyDisk again({});
    capture(folder, n_lights, again, 2, kept);
  }
  if (!expected.empty()) {
    EXPECT_EQ(test::committed_set(folder), expected)
        << "stopped at operation " << stop_at << ", survives " << static_cast<int>(survives);
  }
  return disk.n_operations();
}

std::vector<std::string> undisturbed(int n_lights) {
  test::TemporaryFolder temporary;
  FaultyDisk disk({});
  std::vector<int> kept;
  capture(temporary.path() / "session", n_lights, disk, 3, kept);
  return test::committed_set(temporary.path() / "session");
}

void stop_everywhere(int n_lights) {
  const std::vector<std::string> expected = undisturbed(n_lights);
  ASSERT_FALSE(expected.empty());
  const int n_operations =
      stop_and_restart(n_lights, FaultyDisk::kNever, Survives::everything, {});
  for (int stop_at = 0; stop_at < n_operations; ++stop_at) {
    for (const Survives survives : {Survives::everything, Survives::nothing, Survives::some}) {
      stop_and_restart(n_lights, stop_at, survives, expected);
      if (::testing::Test::HasFailure()) {
        return;
      }
    }
  }
  fmt::print("{} lights: {} operations, each stopped at, in three kinds of crash\n", n_lights,
             n_operations);
}

/// 6 lights, or HAARLIGHT_CRASH_LIGHTS of them: 64 in the soak tests.
TEST(CaptureCrash, StoppedAtEveryOperationItEndsInTheUndisturbedSession) {
  const char* lights = std::getenv("HAARLIGHT_CRASH_LIGHTS");
  stop_everywhere(lights == nullptr ? 6 : std::atoi(lights));
}

/// The disk answers ENOSPC or EIO once, at every write, sync, rename and journal operation of a
/// capture in turn: the run waits, goes on by itself, and ends in the undisturbed session.
TEST(CaptureCrash, FailedOnceAtEveryOperationItEndsInTheUndisturbedSession) {
  const char* lights = std::getenv("HAARLIGHT_CRASH_LIGHTS");
  const int n_lights = lights == nullptr ? 6 : std::atoi(lights);
  const std::vector<std::string> expected = undisturbed(n_lights);
  const int n_operations =
      stop_and_restart(n_lights, FaultyDisk::kNever, Survives::everything, {});
  for (const int error : {ENOSPC, EIO}) {
    for (int fail_at = 0; fail_at < n_operations; ++fail_at) {
      test::TemporaryFolder temporary;
      FaultyDisk disk({.fail_at = fail_at, .error = error});
      std::vector<int> kept;
      capture(temporary.path() / "session", n_lights, disk, 1, kept);
      ASSERT_EQ(test::committed_set(temporary.path() / "session"), expected)
          << "errno " << error << " at operation " << fail_at;
      if (::testing::Test::HasFailure()) {
        return;
      }
    }
  }
  fmt::print("{} lights: {} operations, each failed with ENOSPC and with EIO\n", n_lights,
             n_operations);
}

}  // namespace
}  // namespace haarlight::capture
