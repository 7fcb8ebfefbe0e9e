// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/files.h"

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "core/config_table.h"
#include "core/mapped_files.h"
#include "haarlight/core/error.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::TemporaryFolder;

std::vector<std::string> names_in(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    names.push_back(entry.path().filename().string());
  }
  return names;
}

TEST(WriteFileAtomically, ReplacesTheWholeFile) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "a.txt", "a longer first text");
  write_file_atomically(folder / "a.txt", "second");
  EXPECT_EQ(read_file(folder / "a.txt"), "second");
  EXPECT_EQ(names_in(folder.path()).size(), 1U);
}

TEST(WriteFileAtomically, NamesTheFolderThatIsMissing) {
  try {
    write_file_atomically("/nowhere/at/all.txt", "x");
    FAIL() << "it was written";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::io);
    EXPECT_THAT(error.where(), ::testing::HasSubstr("/nowhere/at/all.txt"));
  }
}

TEST(PendingFile, LeavesNothingWithoutACommit) {
  const TemporaryFolder folder;
  {
    PendingFile file(folder / "a.bin");
    file.append(std::as_bytes(std::span<const char>("half", 4)));
  }
  EXPECT_THAT(names_in(folder.path()), IsEmpty());
}

TEST(PendingFile, RewritesItsHead) {
  const TemporaryFolder folder;
  PendingFile file(folder / "a.bin");
  file.append(std::as_bytes(std::span<const char>("????body", 8)));
  file.rewrite(0, std::as_bytes(std::span<const char>("head", 4)));
  file.commit();
  EXPECT_EQ(read_file(folder / "a.bin"), "headbody");
}

TEST(ReadFile, RefusesAFileThatIsTooLarge) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "a.txt", "123456");
  EXPECT_THROW((void)read_file(folder / "a.txt", 5), Error);
  EXPECT_THROW((void)read_file(folder.path()), Error);
}

TEST(ReadFile, DoesNotWaitForAPipeAndNamesWhatItIs) {
  const TemporaryFolder folder;
  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string name = (folder / "socket").string();
  ASSERT_LT(name.size(), sizeof address.sun_path);
  std::copy(name.begin(), name.end(), address.sun_path);
  const Fd socket(::socket(AF_UNIX, SOCK_STREAM, 0));
  ASSERT_EQ(::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address),
            0);
  struct Case {
    std::filesystem::path path;
    const char* what;
  };
  ::alarm(60);  // ends a test that waits
  for (const Case& c : {Case{folder / "pipe", "a pipe (FIFO)"}, Case{name, "a socket"},
                        Case{"/dev/zero", "a device"}, Case{folder.path(), "a folder"}}) {
    const std::function<void()> readers[] = {
        [&] { (void)read_file(c.path, 100); }, [&] { (void)read_head(c.path, 4); },
        [&] { const MappedFile file(c.path); }, [&] { (void)ConfigTable::parse_file(c.path); }};
    for (const auto& reader : readers) {
      try {
        reader();
        ADD_FAILURE() << c.path << " was read";
      } catch (const Error& error) {
        EXPECT_THAT(error.problem(), HasSubstr(c.what));
        EXPECT_THAT(error.where(), HasSubstr(c.path.string()));
        EXPECT_THAT(error.hint(), HasSubstr("file"));
      }
    }
  }
  ::alarm(0);
}

TEST(ReadHead, GivesTheFirstBytesOrTheWholeOfAShorterFile) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "a.txt", "123456");
  EXPECT_EQ(read_head(folder / "a.txt", 4), "1234");
  EXPECT_EQ(read_head(folder / "a.txt", 100), "123456");
  EXPECT_EQ(read_head(folder / "a.txt", 0), "");
}

TEST(ReadHead, NamesTheFileThatItCannotRead) {
  const TemporaryFolder folder;
  for (const std::filesystem::path& path : {folder / "absent.txt", folder.path()}) {
    try {
      (void)read_head(path, 4);
      FAIL() << path << " was read";
    } catch (const Error& error) {
      EXPECT_EQ(error.where(), path.string());
    }
  }
}

TEST(RequireAbsent, NamesForceAsTheHint) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "a.txt", "x");
  EXPECT_NO_THROW(require_absent(folder / "b.txt", false));
  EXPECT_NO_THROW(require_absent(folder / "a.txt", true));
  EXPECT_THROW(require_absent(folder / "a.txt", false), Error);
}

TEST(ContentHash, IsXxh3WithItsPublishedValueOfNothing) {
  // XXH3-128 of no bytes, seed 0, as the xxHash specification's test vectors give it.
  EXPECT_EQ(content_hash(std::string_view()), "99aa06d3014798d86001c324468d497f");
}

TEST(MappedFile, ShowsTheBytesAndAnEmptyFile) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "a", "xyz");
  write_file_atomically(folder / "empty", "");
  const MappedFile mapped(folder / "a");
  ASSERT_EQ(mapped.bytes().size(), 3U);
  EXPECT_EQ(std::to_integer<char>(mapped.bytes()[2]), 'z');
  EXPECT_TRUE(MappedFile(folder / "empty").bytes().empty());
  EXPECT_THROW(MappedFile(folder / "none"), Error);
}

/// As another program may while it is read.
TEST(MappedFileDeathTest, OneThatIsCutShortEndsTheProgramWithItsName) {
  ::testing::FLAGS_gtest_death_test_style = "threadsafe";
  const TemporaryFolder folder;
  const std::filesystem::path path = folder / "cut.bin";
  constexpr std::size_t kBytes = 1 << 16;
  write_file_atomically(path, std::string(kBytes, 'a'));
  EXPECT_EXIT(
      {
        end_where_mapped_files_fail("haarlight");
        const MappedFile whole(path);
        MappedFile moved;
        {
          MappedFile file(path);
          moved = std::move(file);
        }
        std::filesystem::resize_file(path, 10);
        const volatile std::byte last = moved.bytes()[kBytes - 1];
        std::_Exit(static_cast<int>(last));
      },
      ::testing::ExitedWithCode(static_cast<int>(ExitCode::io)),
      "haarlight: .*cut.bin: it cannot be read any more.*\n  hint: run the command again");
}

/// Of an address that is of no file.
TEST(MappedFileDeathTest, OtherBusErrorsEndItAsBefore) {
  ::testing::FLAGS_gtest_death_test_style = "threadsafe";
  EXPECT_EXIT(
      {
        end_where_mapped_files_fail("haarlight");
        std::raise(SIGBUS);
        std::raise(SIGBUS);
        std::_Exit(0);
      },
      ::testing::KilledBySignal(SIGBUS), "");
}

}  // namespace
}  // namespace haarlight
