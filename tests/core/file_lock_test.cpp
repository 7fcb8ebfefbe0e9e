// SPDX-License-Identifier: Apache-2.0
#include "core/file_lock.h"

#include <csignal>
#include <optional>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/temporary_folder.h"
#include "haarlight/core/error.h"

namespace haarlight {
namespace {

TEST(FileLock, IsOnesAtATimeAndLeavesNothing) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "a.film";
  {
    std::optional<FileLock> first = FileLock::try_lock(file);
    ASSERT_TRUE(first);
    EXPECT_FALSE(FileLock::try_lock(file));
    EXPECT_TRUE(FileLock::try_lock(folder.path() / "b.film"));
    write_file_atomically(file, "replaced");
    EXPECT_FALSE(FileLock::try_lock(file)) << "a file that is replaced is still held";
    const FileLock moved = std::move(*first);
    first.reset();
    EXPECT_FALSE(FileLock::try_lock(file)) << "it went with the move";
  }
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "a.film.lock"));
  EXPECT_TRUE(FileLock::try_lock(file));
}

TEST(FileLock, OfAKilledProcessHoldsNobodyUp) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "a.film";
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    const std::optional<FileLock> held = FileLock::try_lock(file);
    if (held) {
      ::raise(SIGKILL);
    }
    ::_exit(1);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
  EXPECT_TRUE(std::filesystem::exists(folder.path() / "a.film.lock"));
  EXPECT_TRUE(FileLock::try_lock(file));
}

TEST(FileLock, NamesAFolderThatIsNotThere) {
  const TemporaryFolder folder;
  try {
    static_cast<void>(FileLock::try_lock(folder.path() / "absent" / "a.film"));
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::io);
    EXPECT_NE(error.where().find("absent"), std::string::npos) << error.where();
  }
}

}  // namespace
}  // namespace haarlight
