// SPDX-License-Identifier: Apache-2.0
#include "session/session_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"
#include "session/verify.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::HasSubstr;

std::vector<std::string> expected_set(int n_lights) {
  TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", n_lights);
  return test::committed_set(folder.path() / "s");
}

TEST(SessionWriter, WritesASessionThatOpens) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 16);
  const Session session = Session::open(s);
  ASSERT_EQ(session.info().frames.size(), 16U);
  for (int k = 0; k < 16; ++k) {
    const Image<float> rows =
        session.read_rows(session.info().frames[static_cast<std::size_t>(k)], 2, 6);
    const Image<std::uint16_t> truth = test::small_pixels(k);
    for (int y = 2; y < 6; ++y) {
      for (int x = 0; x < test::kSmallWidth; ++x) {
        ASSERT_EQ(rows(y - 2, x), static_cast<float>(truth(y, x)));
      }
    }
  }
  EXPECT_FALSE(fs::exists(s / "journal.sqlite-wal"));
  EXPECT_FALSE(fs::exists(s / "reserve.bin"));
}

TEST(SessionWriter, FinishedJournalOpensReadOnly) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  fs::permissions(s / "journal.sqlite", fs::perms::owner_read);
  fs::permissions(s, fs::perms::owner_read | fs::perms::owner_exec);
  const auto journal = read_journal(s / "journal.sqlite", "small");
  fs::permissions(s, fs::perms::owner_all);
  ASSERT_TRUE(journal.has_value()) << journal.error().what;
  EXPECT_EQ(journal->rows.size(), 4U);
}

TEST(SessionWriter, RefusesASecondWriter) {
  TemporaryFolder folder;
  DiskStorage storage;
  auto first = SessionWriter::create(folder.path() / "s", test::small_info(2), "",
                                     test::kSmallPlan, 0, storage);
  ASSERT_TRUE(first.has_value()) << first.error().what;
  auto second = SessionWriter::reopen(folder.path() / "s", storage);
  ASSERT_FALSE(second.has_value());
  EXPECT_EQ(second.error().code, Errc::device_busy) << second.error().what;
}

TEST(SessionWriter, RefusesPixelsThatWereNotChecked) {
  TemporaryFolder folder;
  DiskStorage storage;
  const SessionInfo info = test::small_info(2);
  auto writer =
      SessionWriter::create(folder.path() / "s", info, "", test::kSmallPlan, 0, storage);
  ASSERT_TRUE(writer.has_value());
  Image<std::uint16_t> pixels = test::small_pixels(0);
  const FrameEvidence evidence = test::small_evidence(info, 0, 0, pixels.view());
  pixels(0, 0) ^= 1U;
  const PendingFrame frame{0, 0, evidence, pixels.view()};
  EXPECT_FALSE(writer->commit(std::span(&frame, 1)).has_value());
  EXPECT_TRUE(fs::is_empty(folder.path() / "s" / "frames"));
}

TEST(SessionWriter, ReservesTheWholePlansSpaceAndGivesItBackFrameByFrame) {
  TemporaryFolder folder;
  DiskStorage storage;
  const SessionInfo info = test::small_info(2);
  const fs::path s = folder.path() / "s";
  const auto too_much =
      SessionWriter::create(s, info, "", test::kSmallPlan, std::uint64_t{1} << 60U, storage);
  ASSERT_FALSE(too_much.has_value());
  EXPECT_EQ(too_much.error().code, Errc::no_space) << too_much.error().what;
  EXPECT_FALSE(fs::exists(s / "start.json"));
  constexpr std::uint64_t kReserve = 1U << 16U;
  auto writer = SessionWriter::create(s, info, "", test::kSmallPlan, kReserve, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_EQ(fs::file_size(s / "reserve.bin"), kReserve);
  const Image<std::uint16_t> pixels = test::small_pixels(0);
  const PendingFrame frame{0, 0, test::small_evidence(info, 0, 0, pixels.view()),
                           pixels.view()};
  ASSERT_TRUE(writer->commit(std::span(&frame, 1)).has_value());
  EXPECT_EQ(fs::file_size(s / "reserve.bin"),
            kReserve - fs::file_size(s / "frames/000000_a0.tif"));
}

TEST(SessionWriter, RefusesToFinishWithPendingShots) {
  TemporaryFolder folder;
  DiskStorage storage;
  auto writer = SessionWriter::create(folder.path() / "s", test::small_info(2), "",
                                      test::kSmallPlan, 0, storage);
  ASSERT_TRUE(writer.has_value());
  const auto done = writer->finish();
  ASSERT_FALSE(done.has_value());
  EXPECT_THAT(done.error().what, HasSubstr("2 shots"));
  EXPECT_THROW((void)Session::open(folder.path() / "s"), Error);
}

TEST(SessionWriter, TakesAWithdrawnShotAgain) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  const auto before = test::committed_set(s);
  DiskStorage storage;
  {
    auto writer = SessionWriter::reopen(s, storage);
    ASSERT_TRUE(writer.has_value()) << writer.error().what;
    EXPECT_EQ(writer->recovery().n_committed, 4);
    ASSERT_TRUE(writer->withdraw(2, "a hand was in the picture").has_value());
    EXPECT_FALSE(writer->committed()[2]);
    EXPECT_EQ(writer->next_attempt(2), 1);
    ASSERT_TRUE(test::capture_all(*writer, 1).has_value());
  }
  EXPECT_EQ(test::committed_set(s), before);
  EXPECT_EQ(Session::open(s).info().frames[2].attempt, 1);
  EXPECT_TRUE(fs::exists(s / "frames/000002_a0.tif"));
}

TEST(SessionWriter, KeepsARefusedAttemptAsideAndNeverAdoptsIt) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  DiskStorage storage;
  const SessionInfo info = test::small_info(3);
  {
    auto writer = SessionWriter::create(s, info, "", test::kSmallPlan, 0, storage);
    ASSERT_TRUE(writer.has_value()) << writer.error().what;
    const Image<std::uint16_t> pixels = test::small_pixels(1);
    FrameEvidence evidence = test::small_evidence(info, 1, 0, pixels.view());
    evidence.verdict = FrameVerdict::saturated;
    const auto kept = writer->keep_refused({1, 0, evidence, pixels.view()}, "too bright");
    ASSERT_TRUE(kept.has_value()) << kept.error().what;
    EXPECT_FALSE(writer->committed()[1]);
    EXPECT_EQ(writer->next_attempt(1), 1);
  }
  // A restart, then a rebuild: it stays where it is.
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_EQ(writer->recovery().n_adopted, 0);
  EXPECT_EQ(writer->next_attempt(1), 1);
  ASSERT_TRUE(test::capture_all(*writer, 1).has_value());
  (void)rebuild_session(s, storage);
  EXPECT_EQ(test::committed_set(s), expected_set(3));
  const VerifyReport report = verify_session(s);
  EXPECT_TRUE(report.is_good()) << report.problems.front();
  EXPECT_THAT(report.notes,
              testing::Contains("aside/000001_a0.tif: not used: saturated: too bright"));
}

TEST(SessionWriter, KeepsNothingHalfWhenTheDiskFails) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  DiskStorage storage;
  const SessionInfo info = test::small_info(2);
  auto writer = SessionWriter::create(s, info, "", test::kSmallPlan, 0, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  const Image<std::uint16_t> pixels = test::small_pixels(1);
  FrameEvidence evidence = test::small_evidence(info, 1, 0, pixels.view());
  fs::permissions(s / "aside", fs::perms::owner_read | fs::perms::owner_exec);
  const auto kept = writer->keep_refused({1, 0, evidence, pixels.view()}, "too bright");
  fs::permissions(s / "aside", fs::perms::owner_all);
  if (::geteuid() != 0) {  // root may write anywhere
    EXPECT_FALSE(kept.has_value());
    EXPECT_TRUE(fs::is_empty(s / "aside"));
  }
  evidence.pixel_hash = "another";
  EXPECT_FALSE(writer->keep_refused({1, 1, evidence, pixels.view()}, "too bright"));
  ASSERT_TRUE(test::capture_all(*writer, 1).has_value());
}

TEST(Recovery, AdoptsAGoodFrameWithoutARow) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  fs::remove(s / "journal.sqlite");
  fs::remove(s / "session.json");
  DiskStorage storage;
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_EQ(writer->recovery().n_adopted, 4);
  ASSERT_TRUE(writer->finish().has_value());
  EXPECT_EQ(test::committed_set(s), expected_set(4));
}

TEST(Recovery, ReturnsARowWithoutItsFrame) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  fs::remove(s / "frames/000001_a0.tif");
  DiskStorage storage;
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_EQ(writer->recovery().n_returned, 1);
  EXPECT_FALSE(writer->committed()[1]);
  ASSERT_TRUE(test::capture_all(*writer, 1).has_value());
  EXPECT_EQ(test::committed_set(s), expected_set(4));
}

TEST(Recovery, SetsAsideWhatAKilledWriterLeft) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  test::write_text(s / "frames/000001_a7.tif.new3", "half");
  DiskStorage storage;
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  ASSERT_EQ(writer->recovery().set_aside.size(), 1U);
  EXPECT_EQ(test::read_text(s / "aside/000001_a7.tif.new3"), "half");
  EXPECT_TRUE(fs::exists(s / "aside/000001_a7.tif.new3.why.txt"));
  const auto events = writer->events_after(0, 100);
  ASSERT_TRUE(events.has_value());
  EXPECT_EQ(events->back().kind, EventKind::set_aside);
}

/// The words are the file's format (docs/reference/session-format.md) and the event stream's
/// (docs/reference/http-api.md).
TEST(Journal, WritesTheWordsOfEveryKind) {
  TemporaryFolder folder;
  DiskStorage storage;
  auto journal = Journal::open(folder.path() / "j.sqlite", "words", storage);
  ASSERT_TRUE(journal.has_value()) << journal.error().what;
  for (const EventKind kind : all_values<EventKind>()) {
    ASSERT_TRUE(journal->log(kind, "{}").has_value());
  }
  const auto text = journal->text();
  ASSERT_TRUE(text.has_value());
  std::string lines;  // every value as its length and its bytes: id, kind, json
  int id = 1;
  for (const std::string word :
       {"adopted", "returned", "set_aside", "refused", "withdrawn", "rebuilt", "not_reserved",
        "finished", "state", "fault", "retry", "light", "controller", "camera", "dark",
        "committed"}) {
    const std::string number = std::to_string(id++);
    lines.append(std::to_string(number.size())).append(":").append(number);
    lines.append(std::to_string(word.size())).append(":").append(word).append("2:{}\n");
  }
  EXPECT_THAT(*text, testing::EndsWith("\n\n" + lines + "\n"));
}

/// A later program's events say nothing to this one, and stay in the file as they are.
TEST(Journal, KeepsAnEventOfAnUnknownKind) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  DiskStorage storage;
  {
    auto writer =
        SessionWriter::create(s, test::small_info(4), "", test::kSmallPlan, 0, storage);
    ASSERT_TRUE(writer.has_value()) << writer.error().what;
    ASSERT_TRUE(writer->log_event(EventKind::dark, R"({"text": "cold"})").has_value());
  }
  std::string bytes = test::read_text(s / "journal.sqlite");
  const std::size_t at = bytes.find(R"(dark{"text")");
  ASSERT_NE(at, std::string::npos);
  bytes.replace(at, 4, "dusk");  // the column's value, of the same length
  test::write_text(s / "journal.sqlite", bytes);

  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_TRUE(writer->recovery().set_aside.empty());
  const auto events = writer->events_after(0, 100);
  ASSERT_TRUE(events.has_value());
  ASSERT_EQ(events->size(), 1U);
  EXPECT_EQ(events->front().kind, std::nullopt);
  EXPECT_EQ(events->front().json, R"({"text": "cold"})");
  ASSERT_TRUE(test::capture_all(*writer, 4).has_value());
  EXPECT_TRUE(verify_session(s).problems.empty());
  const auto journal = read_journal(s / "journal.sqlite", "small");
  ASSERT_TRUE(journal.has_value()) << journal.error().what;
  EXPECT_THAT(journal->text, HasSubstr("4:dusk"));
  EXPECT_EQ(journal->events.back().kind, EventKind::finished);
}

}  // namespace
}  // namespace haarlight::session
