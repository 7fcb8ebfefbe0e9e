// SPDX-License-Identifier: Apache-2.0
/// @file
/// Broken frames, journals and session.json: each is refused or set aside with its file, its
/// position and a hint, and nothing is lost with it.

#include <cstring>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"
#include "session/session_writer.h"
#include "session/verify.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using testing::HasSubstr;

constexpr int kLights = 4;

std::vector<std::string> good_set() {
  static const std::vector<std::string> set = [] {
    TemporaryFolder folder;
    test::make_small_session(folder.path() / "s", kLights);
    return test::committed_set(folder.path() / "s");
  }();
  return set;
}

std::string flip(std::string bytes, std::size_t at) {
  bytes.at(at) = static_cast<char>(bytes.at(at) ^ 0x10);
  return bytes;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  if (at == std::string::npos) {
    throw std::runtime_error("not found: " + from);
  }
  return text.replace(at, from.size(), to);
}

struct Breakage {
  const char* name;
  std::string bytes;
  const char* reason;  ///< part of the reason given
};

/// Ways to break the frame of shot 1.
std::vector<Breakage> broken_frames(const std::string& good) {
  const std::size_t json = good.find("{\"haarlight_frame\"");
  return {
      {"empty", "", "empty"},
      {"not a TIFF", "JPEG" + good.substr(4), "not a TIFF"},
      {"cut short", good.substr(0, good.size() / 2), ""},
      {"cut in the pixels", good.substr(0, 100), ""},
      {"a pixel changed", flip(good, 20), "hash"},
      {"description not JSON", flip(good, json), ""},
      {"tag changed", replaced(good, "\"tag\":2", "\"tag\":3"), "tag"},
      {"timestamp changed", replaced(good, "\"read_us\":250.5", "\"read_us\":950.5"), "stamp"},
      {"of another session", replaced(good, "\"session\":\"small\"", "\"session\":\"smell\""),
       "session"},
      {"of another shot", replaced(good, "\"shot\":1", "\"shot\":2"), "shot 2"},
      {"statistics changed", replaced(good, "\"max_dn\":", "\"max_dn\":1"), ""},
  };
}

TEST(BrokenFrame, WithoutARowIsSetAsideWithTheReason) {
  TemporaryFolder origin;
  const fs::path whole = origin.path() / "s";
  test::make_small_session(whole, kLights);
  const std::string good = test::read_text(whole / "frames/000001_a0.tif");
  for (const Breakage& breakage : broken_frames(good)) {
    SCOPED_TRACE(breakage.name);
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    fs::copy(whole, s, fs::copy_options::recursive);
    fs::remove(s / "journal.sqlite");
    fs::remove(s / "session.json");
    test::write_text(s / "frames/000001_a0.tif", breakage.bytes);
    DiskStorage storage;
    auto writer = SessionWriter::reopen(s, storage);
    ASSERT_TRUE(writer.has_value()) << writer.error().what;
    EXPECT_EQ(writer->recovery().n_adopted, kLights - 1);
    ASSERT_EQ(writer->recovery().set_aside.size(), 1U);
    EXPECT_THAT(writer->recovery().set_aside[0], HasSubstr(breakage.reason));
    EXPECT_TRUE(test::read_text(s / "aside/000001_a0.tif") == breakage.bytes);
    EXPECT_EQ(writer->next_attempt(1), 1);
    ASSERT_TRUE(test::capture_all(*writer, 2).has_value());
    EXPECT_EQ(test::committed_set(s), good_set());
  }
}

TEST(BrokenFrame, WithARowGoesBackToPendingAndIsKeptAside) {
  TemporaryFolder origin;
  const fs::path whole = origin.path() / "s";
  test::make_small_session(whole, kLights);
  const std::string good = test::read_text(whole / "frames/000001_a0.tif");
  for (const Breakage& breakage : broken_frames(good)) {
    SCOPED_TRACE(breakage.name);
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    fs::copy(whole, s, fs::copy_options::recursive);
    test::write_text(s / "frames/000001_a0.tif", breakage.bytes);

    const VerifyReport report = verify_session(s);
    ASSERT_FALSE(report.is_good());
    EXPECT_THAT(report.problems[0], HasSubstr("frames/000001_a0.tif"));
    EXPECT_EQ(report.n_frames, kLights - 1);

    DiskStorage storage;
    auto writer = SessionWriter::reopen(s, storage);
    ASSERT_TRUE(writer.has_value()) << writer.error().what;
    EXPECT_EQ(writer->recovery().n_returned, 1);
    EXPECT_TRUE(test::read_text(s / "aside/000001_a0.tif") == breakage.bytes);
    ASSERT_TRUE(test::capture_all(*writer, 2).has_value());
    EXPECT_EQ(test::committed_set(s), good_set());
    EXPECT_TRUE(verify_session(s).is_good());
  }
}

TEST(BrokenFrame, ReadingItNamesTheFile) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, kLights);
  const std::string good = test::read_text(s / "frames/000001_a0.tif");
  const Session session = Session::open(s);
  int n_refused = 0;
  for (const Breakage& breakage : broken_frames(good)) {
    test::write_text(s / "frames/000001_a0.tif", breakage.bytes);
    try {
      (void)session.read_rows(session.info().frames[1], 0, test::kSmallHeight);
    } catch (const Error& error) {
      ++n_refused;
      EXPECT_THAT(error.where(), HasSubstr("000001_a0.tif"));
      EXPECT_FALSE(error.hint().empty());
    }
  }
  EXPECT_GE(n_refused, 3);  // reading rows sees the file's form, verify sees the rest
}

TEST(BrokenJournal, IsSetAsideAndRebuiltFromTheFrames) {
  TemporaryFolder origin;
  const fs::path whole = origin.path() / "s";
  test::make_small_session(whole, kLights);
  const std::string good = test::read_text(whole / "journal.sqlite");
  const std::vector<Breakage> breakages = {
      {"not SQLite", "this is no journal", ""},
      {"header changed", "X" + good.substr(1), ""},
      {"cut to a page and a half", good.substr(0, 6144), ""},
      {"a page of zeros", good.substr(0, 4096) + std::string(4096, '\0') + good.substr(8192),
       ""},
      {"tables renamed", replaced(good, "CREATE TABLE frames", "CREATE TABLE gramef"), ""},
      {"of another session", replaced(good, "\x17small", "\x17smell"), ""},
      {"random bytes",
       [&] {
         std::string bytes = good;
         for (std::size_t i = 100; i < bytes.size(); i += 7) {
           bytes[i] = static_cast<char>(i * 31);
         }
         return bytes;
       }(),
       ""},
  };
  for (const Breakage& breakage : breakages) {
    SCOPED_TRACE(breakage.name);
    TemporaryFolder folder;
    const fs::path s = folder.path() / "s";
    fs::copy(whole, s, fs::copy_options::recursive);
    test::write_text(s / "journal.sqlite", breakage.bytes);
    const VerifyReport report = verify_session(s);
    ASSERT_FALSE(report.is_good());
    EXPECT_THAT(report.problems[0], HasSubstr("journal.sqlite"));
    {
      DiskStorage storage;
      auto writer = SessionWriter::reopen(s, storage);
      ASSERT_TRUE(writer.has_value()) << writer.error().what;
      EXPECT_EQ(writer->recovery().n_adopted, kLights);
      EXPECT_TRUE(test::read_text(s / "aside/journal.sqlite") == breakage.bytes);
      EXPECT_TRUE(fs::exists(s / "aside/journal.sqlite.why.txt"));
      ASSERT_TRUE(writer->finish().has_value());
    }
    EXPECT_EQ(test::committed_set(s), good_set());
    const VerifyReport after = verify_session(s);
    EXPECT_TRUE(after.is_good()) << after.problems[0];
  }
}

TEST(BrokenJournal, AnEmptyFileIsANewJournal) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, kLights);
  test::write_text(s / "journal.sqlite", "");
  DiskStorage storage;
  auto writer = SessionWriter::reopen(s, storage);
  ASSERT_TRUE(writer.has_value()) << writer.error().what;
  EXPECT_EQ(writer->recovery().n_adopted, kLights);
}

TEST(BrokenSessionJson, NamesThePositionAndTheHint) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, kLights);
  const std::string good = test::read_text(s / "session.json");
  const std::vector<Breakage> breakages = {
      {"empty", "", "byte"},
      {"cut short", good.substr(0, good.size() / 2), "byte"},
      {"newer schema", replaced(good, "\"schema\": 1", "\"schema\": 2"), "schema 2"},
      {"no form", replaced(good, "\"form\"", "\"farm\""), "\"form\" is missing"},
      {"width 0", replaced(good, "\"width\":12", "\"width\":0"), "form.width"},
      {"white below black", replaced(good, "4095.0", "12.0"), "white"},
      {"shot out of order", replaced(good, "{\"index\":1", "{\"index\":7"), "shots[1].index"},
      {"a light that is none", replaced(good, "[[3,65535]]", "[[9,65535]]"),
       "shots[3].lit[0][0]"},
      {"a frame outside", replaced(good, "frames/000002_a0.tif", "../../../etc/passwd"),
       "frames[2].file"},
      {"a frame twice", replaced(good, "{\"shot\":2", "{\"shot\":1"), "frames[2].shot"},
      {"evidence broken", replaced(good, "\"tag\":3", "\"tag\":null"), "frames[2].evidence"},
      {"power 0", replaced(good, "\"relative_power\":1.0", "\"relative_power\":0"),
       "lights[0].relative_power"},
      {"grid that does not fit", replaced(good, "\"grid_rows\": 0", "\"grid_rows\": 3"),
       "grid_rows"},
  };
  for (const Breakage& breakage : breakages) {
    SCOPED_TRACE(breakage.name);
    test::write_text(s / "session.json", breakage.bytes);
    try {
      (void)Session::open(s);
      ADD_FAILURE() << "accepted";
    } catch (const Error& error) {
      EXPECT_THAT(error.where(), HasSubstr("session.json"));
      EXPECT_THAT(std::string(error.what()), HasSubstr(breakage.reason));
      EXPECT_FALSE(error.hint().empty());
    }
  }
  fs::remove(s / "session.json");
  try {
    (void)Session::open(s);
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.hint(), HasSubstr("haarlight rebuild"));
  }
  DiskStorage storage;
  EXPECT_EQ(rebuild_session(s, storage).n_pending, 0);
  EXPECT_EQ(test::committed_set(s), good_set());
}

TEST(BrokenPlan, IsNoticed) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, kLights);
  test::write_text(s / "plan.json", "{}");
  EXPECT_THAT(verify_session(s).problems[0], HasSubstr("plan.json"));
  DiskStorage storage;
  const auto writer = SessionWriter::reopen(s, storage);
  ASSERT_FALSE(writer.has_value());
  EXPECT_THAT(writer.error().what, HasSubstr("plan.json"));
}

TEST(Verify, FindsAFrameSavedTwice) {
  TemporaryFolder folder;
  SessionInfo info = test::small_info(2);
  info.form.stored_height = info.form.height;
  test::make_session(folder.path() / "s", info, [&](int) {
    Image<std::uint16_t> pixels(info.form.height, info.form.width, 1);
    for (std::size_t i = 0; i < pixels.pixels().size(); ++i) {
      pixels.pixels()[i] = static_cast<std::uint16_t>(100 + i);
    }
    return pixels;
  });
  const VerifyReport report = verify_session(folder.path() / "s");
  ASSERT_EQ(report.problems.size(), 1U);
  EXPECT_THAT(report.problems[0], HasSubstr("same pixels"));
}

TEST(Verify, AcceptsEqualBlackFrames) {
  TemporaryFolder folder;
  SessionInfo info = test::small_info(2);
  test::make_session(folder.path() / "s", info, [&](int) {
    return Image<std::uint16_t>(info.form.stored_height, info.form.width, 1);
  });
  EXPECT_TRUE(verify_session(folder.path() / "s").is_good());
}

TEST(Verify, FindsStrayFilesAndAMissingJournal) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  test::write_text(s / "frames/note.txt", "x");
  fs::remove(s / "journal.sqlite");
  const VerifyReport report = verify_session(s);
  EXPECT_THAT(report.problems, testing::ElementsAre(HasSubstr("journal.sqlite: missing"),
                                                    HasSubstr("frames/note.txt")));
}

TEST(Rebuild, DoesNotBringAWithdrawnFrameBack) {
  TemporaryFolder folder;
  const fs::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  DiskStorage storage;
  {
    auto writer = SessionWriter::reopen(s, storage);
    ASSERT_TRUE(writer.has_value());
    ASSERT_TRUE(writer->withdraw(1, "a hand was in the picture").has_value());
  }
  const RebuildReport report = rebuild_session(s, storage);
  EXPECT_EQ(report.n_pending, 1);
  EXPECT_THAT(report.recovery.set_aside[0], HasSubstr("withdrawn"));
}

TEST(FrameTiff, KeepsEverySampleTypeAndAnyRange) {
  Image<float> pixels(150, 5, 3);  // three strips, the last one short
  for (std::size_t i = 0; i < pixels.pixels().size(); ++i) {
    pixels.pixels()[i] = static_cast<float>(i) * 0.25F - 7.0F;
  }
  const std::vector<std::byte> file =
      encode_frame_tiff(ImageView<const float>(pixels.view()), "text");
  const FrameTiffHeader header = read_frame_tiff_header(file, "f");
  EXPECT_EQ(header.height, 150);
  EXPECT_EQ(header.channels, 3);
  EXPECT_EQ(header.sample, SampleType::f32);
  EXPECT_EQ(header.description, "text");
  for (const auto& [y0, y1] : {std::pair(0, 150), {63, 65}, {128, 150}, {10, 10}, {149, 150}}) {
    const std::vector<std::byte> rows = read_frame_tiff_rows(file, header, y0, y1, "f");
    ASSERT_EQ(rows.size(), static_cast<std::size_t>(y1 - y0) * 60U);
    EXPECT_EQ(0, rows.empty() ? 0 : std::memcmp(rows.data(), &pixels(y0, 0, 0), rows.size()));
  }
  EXPECT_EQ(encode_frame_tiff(ImageView<const float>(pixels.view()), "text"), file);
}

TEST(FrameTiff, AFrameOfOneStripIsReadAsOneStrip) {
  for (const int height : {1, 9, 63, 64, 65}) {
    const Image<float> pixels(height, 2000, 1);
    const std::vector<std::byte> file = encode_frame_tiff(pixels.view(), "text");
    const FrameTiffHeader header = read_frame_tiff_header(file, "f");
    EXPECT_EQ(read_frame_tiff_rows(file, header, 0, height, "f").size(),
              static_cast<unsigned>(height) * 8000U);
  }
}

}  // namespace
}  // namespace haarlight::session
