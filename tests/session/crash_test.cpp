// SPDX-License-Identifier: Apache-2.0
/// @file
/// The first promise: no committed frame is lost or altered, whatever moment the process, the
/// machine or the disk picks to fail. Each test runs a session once for every operation on the
/// disk, SQLite's own writes and syncs included.

#include <cerrno>
#include <filesystem>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "session/session_writer.h"
#include "session/verify.h"
#include "tests/session/faulty_disk.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::FaultyDisk;
using test::Survives;
using test::TemporaryFolder;

// 64 in session_crash_test (label soak), 5 in session_test.
constexpr int kShots = HAARLIGHT_CRASH_SHOTS;
constexpr int kVerifyEvery =
    kShots > 8 ? 16 : 1;  // verify reads all frames again: a sample will do
constexpr int kGroup = 4;
constexpr std::uint64_t kReserve = 1U << 17U;

/// Frames whose commit was answered with success: "shot attempt".
using Acknowledged = std::vector<std::pair<int, int>>;

Result<SessionWriter> open_or_create(const fs::path& folder, Storage& storage) {
  auto writer = SessionWriter::reopen(folder, storage);
  if (!writer && writer.error().code == Errc::refused) {
    writer = SessionWriter::create(folder, test::small_info(kShots), "", test::kSmallPlan,
                                   kReserve, storage);
  }
  return writer;
}

/// Captures what is pending; an acknowledged commit is noted. Stops at the first fault.
Result<void> capture(SessionWriter& writer, Acknowledged& acknowledged, bool finish = true) {
  const SessionInfo info = writer.info();
  const std::vector<bool> committed = writer.committed();
  for (int shot = 0; shot < kShots;) {
    std::vector<Image<std::uint16_t>> pixels;
    std::vector<PendingFrame> frames;
    pixels.reserve(kGroup);
    for (; shot < kShots && frames.size() < kGroup; ++shot) {
      if (committed[static_cast<std::size_t>(shot)]) {
        continue;
      }
      const int attempt = writer.next_attempt(shot);
      pixels.push_back(test::small_pixels(shot));
      frames.push_back({shot, attempt,
                        test::small_evidence(info, shot, attempt, pixels.back().view()),
                        pixels.back().view()});
    }
    if (auto done = writer.commit(frames); !done) {
      return done;
    }
    for (const PendingFrame& frame : frames) {
      acknowledged.emplace_back(frame.shot, frame.attempt);
    }
  }
  return finish ? writer.finish() : Result<void>();
}

/// Runs until the disk stops (or to the end); what was acknowledged.
Acknowledged run_until_stopped(const fs::path& folder, FaultyDisk& disk) {
  Acknowledged acknowledged;
  try {
    auto writer = open_or_create(folder, disk);
    if (writer) {
      (void)capture(*writer, acknowledged);
    }
  } catch (const test::Stopped&) {
  }
  disk.stop();
  return acknowledged;
}

const std::vector<std::string>& undisturbed() {
  static const std::vector<std::string> set = [] {
    TemporaryFolder folder;
    test::make_small_session(folder.path() / "s", kShots);
    return test::committed_set(folder.path() / "s");
  }();
  return set;
}

/// Restarts on a good disk: nothing acknowledged is missing, and the finished session equals
/// the undisturbed one.
void expect_recovers(const fs::path& folder, const Acknowledged& acknowledged,
                     const std::string& moment) {
  static int n_calls = 0;
  DiskStorage disk;
  {
    auto writer = open_or_create(folder, disk);
    ASSERT_TRUE(writer.has_value()) << moment << ": " << writer.error().what;
    for (const auto& [shot, attempt] : acknowledged) {
      ASSERT_TRUE(writer->committed()[static_cast<std::size_t>(shot)])
          << moment << ": shot " << shot << " attempt " << attempt << " was lost";
    }
    Acknowledged later;
    const auto done = capture(*writer, later);
    ASSERT_TRUE(done.has_value()) << moment << ": " << done.error().what;
  }
  ASSERT_EQ(test::committed_set(folder), undisturbed()) << moment;
  if (n_calls++ % kVerifyEvery != 0) {
    return;
  }
  const VerifyReport report = verify_session(folder);
  ASSERT_TRUE(report.is_good()) << moment << ": " << report.problems[0];
}

int count_operations() {
  TemporaryFolder folder;
  FaultyDisk disk({});
  (void)run_until_stopped(folder.path() / "s", disk);
  return disk.n_operations();
}

void stop_everywhere(Survives survives) {
  const int n = count_operations();
  ASSERT_GT(n, kShots * 3);
  ::testing::Test::RecordProperty("operations", n);
  for (int i = 0; i < n; ++i) {
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    FaultyDisk disk({.stop_at = i});
    const Acknowledged acknowledged = run_until_stopped(s, disk);
    disk.crash(s, survives, static_cast<std::uint64_t>(i));
    expect_recovers(s, acknowledged, fmt::format("stopped at operation {} of {}", i, n));
    if (::testing::Test::HasFatalFailure()) {
      return;
    }
  }
}

TEST(Crash, KilledAtEveryOperationLosesNothing) { stop_everywhere(Survives::everything); }

TEST(Crash, PowerLostAtEveryOperationLosesNothing) { stop_everywhere(Survives::nothing); }

TEST(Crash, PowerLostWithAnySubsetOfUnsyncedWritesLosesNothing) {
  stop_everywhere(Survives::some);
}

/// One operation fails; the caller repeats as the sequencer does, reopening when the writer
/// says so. Then the power goes before the end, or the session is finished.
void fail_everywhere(int error, bool is_power_lost_later) {
  const int n = count_operations();
  for (int i = 0; i < n; ++i) {
    const std::string moment = fmt::format("errno {} at operation {} of {}", error, i, n);
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    FaultyDisk disk({.fail_at = i, .error = error});
    Acknowledged acknowledged;
    int n_faults = 0;
    for (bool is_done = false; !is_done;) {
      auto writer = open_or_create(s, disk);
      for (int repeat = 0; writer && repeat < 3 && !is_done; ++repeat) {
        const auto done = capture(*writer, acknowledged, !is_power_lost_later);
        is_done = done.has_value();
        n_faults += is_done ? 0 : 1;
      }
      n_faults += writer ? 0 : 1;
      ASSERT_LE(n_faults, 3) << moment;
    }
    disk.stop();
    if (is_power_lost_later) {
      disk.crash(s, Survives::nothing, 0);
    }
    expect_recovers(s, acknowledged, moment);
    if (::testing::Test::HasFatalFailure()) {
      return;
    }
  }
}

TEST(Crash, DiskFullAtEveryOperationPausesAndNeverCorrupts) { fail_everywhere(ENOSPC, false); }

TEST(Crash, InputOutputErrorAtEveryOperationNeverCorrupts) { fail_everywhere(EIO, false); }

TEST(Crash, ErrorAtEveryOperationThenPowerLossLosesNothing) { fail_everywhere(EIO, true); }

/// A second stop during recovery itself.
TEST(Crash, StoppedDuringRecoveryLosesNothing) {
  TemporaryFolder seed;
  const fs::path broken = seed.path() / "s";
  const int n = count_operations();
  Acknowledged acknowledged;
  {
    FaultyDisk disk({.stop_at = n * 2 / 3});
    acknowledged = run_until_stopped(broken, disk);
    disk.crash(broken, Survives::everything, 0);
  }
  fs::remove(broken /
             "journal.sqlite-wal");  // all rows since the checkpoint: frames are adopted
  for (int i = 0;; ++i) {
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    fs::copy(broken, s, fs::copy_options::recursive);
    FaultyDisk disk({.stop_at = i});
    bool is_recovered = false;
    try {
      is_recovered = SessionWriter::reopen(s, disk).has_value();
    } catch (const test::Stopped&) {
    }
    const bool is_end = is_recovered && !disk.is_stopped();
    disk.stop();
    // The copy's files were durable before: only kill -9 is modelled here.
    disk.crash(s, Survives::everything, 0);
    expect_recovers(s, acknowledged, fmt::format("stopped at operation {} of recovery", i));
    if (is_end || HasFatalFailure()) {
      return;
    }
  }
}

/// A shot of a finished session is taken again: either nothing has happened yet, or the session
/// is unfinished and goes on; never one that says it is finished and has lost the request.
TEST(Crash, StoppedWhileAShotIsTakenAgainKeepsTheRequest) {
  constexpr int kShot = 2;
  TemporaryFolder seed;
  test::make_small_session(seed.path() / "s", kShots);
  for (int i = 0;; ++i) {
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    fs::copy(seed.path() / "s", s, fs::copy_options::recursive);
    FaultyDisk disk({.stop_at = i});
    bool is_withdrawn = false;
    bool is_finished = false;
    Acknowledged acknowledged;
    try {
      auto writer = SessionWriter::reopen(s, disk);
      is_withdrawn = writer && writer->withdraw(kShot, "a hand was in it").has_value();
      is_finished = is_withdrawn && capture(*writer, acknowledged).has_value();
    } catch (const test::Stopped&) {
    }
    disk.stop();
    disk.crash(s, Survives::everything, 0);
    const std::string moment = fmt::format("stopped at operation {}", i);
    const bool says_finished = fs::exists(s / "session.json");
    expect_recovers(s, acknowledged, moment);
    ASSERT_FALSE(HasFatalFailure());
    const FrameRecord frame = Session::open(s).info().frames.at(kShot);
    if (is_withdrawn) {
      EXPECT_EQ(frame.attempt, 1) << moment;
      EXPECT_EQ(says_finished && acknowledged.empty(), false) << moment;
    }
    if (is_finished) {
      return;
    }
  }
}

}  // namespace
}  // namespace haarlight::session
