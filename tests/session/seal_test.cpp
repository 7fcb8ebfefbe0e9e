// SPDX-License-Identifier: Apache-2.0
/// @file
/// What ties a session together: what each frame says was lit, the root over every byte, the
/// mark of a rebuild. Tampering at large: tamper_test.py.

#include "session/seal.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/sha256.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"
#include "session/session_writer.h"
#include "session/verify.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::Contains;
using testing::HasSubstr;

/// Values of FIPS 180-4's example and of Python's hashlib.
TEST(Sha256, GivesTheKnownDigestsAndTree) {
  EXPECT_EQ(to_hex(Sha256().add("a").add("").add("bc").digest()),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  std::vector<Sha256Digest> leaves;
  for (std::size_t i = 0; i < 7; ++i) {
    leaves.push_back(leaf_hash(std::to_string(i), std::string(i, 'x')));
  }
  EXPECT_EQ(to_hex(leaves[3]),
            "7d2c54b55bb1a97c4be2291bca67c9e149349262a75ecb618c220c48bc3673fd");
  EXPECT_EQ(to_hex(merkle_root(leaves)),
            "1065d54db61b21c299444f76c5accd5dc7d178e614f80b9d8790e334836987b4");
  EXPECT_EQ(merkle_root(std::span(leaves).first(1)), leaves[0]);
  EXPECT_EQ(sha256_from_hex(to_hex(leaves[5])), leaves[5]);
}

/// In both files alike, and with a new root.
template <class Change>
void expect_frames_tell_of_other_lights(Change change) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  for (const char* name : {"start.json", "session.json"}) {
    SessionInfo info = session_info_from_json(test::read_text(s / name), name);
    change(info);
    if (!info.root.empty()) {
      seal_session(s, "", info);
    }
    test::write_text(s / name, session_info_to_json(info));
  }
  EXPECT_THAT(
      verify_session(s).problems,
      Contains(HasSubstr("taken with other lights (names, positions, powers or lobes)")));
}

TEST(Seal, FramesGiveAwayLightsThatWereChangedInEveryJson) {
  expect_frames_tell_of_other_lights([](SessionInfo& info) {
    std::swap(info.lights[1].coordinates, info.lights[2].coordinates);
  });
  expect_frames_tell_of_other_lights([](SessionInfo& info) {
    info.lights[1].lobe = LightLobe{-Eigen::Vector3d::UnitZ(), 1.0};
  });
}

TEST(Seal, FramesGiveAwayLitListsThatWereSwapped) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 4);
  for (const char* name : {"start.json", "session.json"}) {
    SessionInfo info = session_info_from_json(test::read_text(s / name), name);
    std::swap(info.shots[1].lit, info.shots[2].lit);
    test::write_text(s / name, session_info_to_json(info));
  }
  EXPECT_THAT(verify_session(s).problems,
              Contains(HasSubstr("it says light shot, light 1 at level 65535")));
  DiskStorage storage;
  const RebuildReport report = rebuild_session(s, storage);  // nor does recovery adopt them
  EXPECT_EQ(report.n_pending, 2);
}

TEST(Seal, ALinkIsNoFrame) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  const fs::path away = folder.path() / "away.tif";
  fs::rename(s / "frames/000001_a0.tif", away);
  fs::create_symlink(away, s / "frames/000001_a0.tif");
  EXPECT_THAT(verify_session(s).problems, Contains(HasSubstr("a link or no plain file")));
  DiskStorage storage;
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value());
  EXPECT_EQ(writer->recovery().n_returned, 1);
}

TEST(Seal, ARebuiltSessionSaysSoAndHasAnotherRoot) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  const std::string before = verify_session(s).root;
  test::write_text(s / "session.json.sig", "a signature");
  DiskStorage storage;
  ASSERT_EQ(rebuild_session(s, storage).n_pending, 0);
  const VerifyReport report = verify_session(s);
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  EXPECT_THAT(report.notes, Contains(HasSubstr("made by haarlight rebuild")));
  EXPECT_NE(report.root, before);
  EXPECT_FALSE(fs::exists(s / "session.json.sig"));
  EXPECT_EQ(test::read_text(s / "aside/session.json.sig"), "a signature");
}

TEST(Seal, ACaptureThatLostItsJournalSaysSoForEver) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  DiskStorage storage;
  {
    auto writer =
        SessionWriter::create(s, test::small_info(3), "", test::kSmallPlan, 0, storage);
    ASSERT_TRUE(writer.has_value());
  }
  fs::remove(s / "journal.sqlite");
  {
    auto writer = SessionWriter::reopen(s, storage);
    ASSERT_TRUE(writer.has_value());
  }
  auto writer = SessionWriter::reopen(s, storage);  // the mark is in the journal, not in memory
  ASSERT_TRUE(writer.has_value());
  ASSERT_TRUE(test::capture_all(*writer, 2).has_value());
  EXPECT_EQ(Session::open(s).info().made_by, MadeBy::rebuild);
}

/// As older programs wrote it: no program, no root, frames that do not say what was lit.
TEST(Seal, AnOlderSessionStaysReadableAndVerifiableWithANote) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  SessionInfo info = Session::open(s).info();
  info.program.clear();
  info.files.clear();
  info.root.clear();
  for (FrameRecord& frame : info.frames) {
    const Image<std::uint16_t> pixels = test::small_pixels(frame.shot);
    const std::vector<std::byte> bytes =
        encode_frame_tiff(ImageView<const std::uint16_t>(pixels.view()),
                          frame_description_to_json({info.id, info.plan_hash, frame.shot,
                                                     frame.attempt, frame.evidence}));
    write_file_atomically(s / frame.file, std::span<const std::byte>(bytes));
    frame.file_hash = content_hash(bytes);
    frame.sha256.clear();
  }
  test::write_text(s / "session.json", session_info_to_json(info));
  info.frames.clear();
  test::write_text(s / "start.json", session_info_to_json(info));
  fs::remove(s / "journal.sqlite");
  DiskStorage storage;
  ASSERT_EQ(rebuild_session(s, storage).n_pending, 0);  // its rows, as they were
  info = Session::open(s).info();
  info.files.clear();
  info.root.clear();
  for (FrameRecord& frame : info.frames) {
    frame.sha256.clear();
  }
  test::write_text(s / "session.json", session_info_to_json(info));
  const VerifyReport report = verify_session(s);
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  EXPECT_THAT(report.notes, Contains(HasSubstr("an older program's session")));
}

}  // namespace
}  // namespace haarlight::session
