// SPDX-License-Identifier: Apache-2.0
#include "core/file_lock.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "haarlight/core/error.h"

namespace haarlight {

FileLock::FileLock(std::filesystem::path path, Fd fd)
    : path_(std::move(path)), fd_(std::move(fd)) {}

FileLock::~FileLock() {
  if (fd_.is_open()) {
    ::unlink(path_.c_str());  // while it is held: nobody else's
  }
}

std::optional<FileLock> FileLock::try_lock(const std::filesystem::path& file) {
  std::filesystem::path path = file;
  path += ".lock";
  for (;;) {
    Fd fd(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
    if (!fd.is_open()) {
      throw Error(std::string("cannot make the file: ") + std::strerror(errno), path.string(),
                  "write to a folder that exists and that you may write to", ExitCode::io);
    }
    if (::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
      if (errno == EWOULDBLOCK) {
        return std::nullopt;
      }
      if (errno == EINTR) {
        continue;
      }
      throw Error(std::string("cannot lock the file: ") + std::strerror(errno), path.string(),
                  "write to a file system with locks", ExitCode::io);
    }
    // Who had it may have deleted it between the two calls: then it guards nothing.
    struct stat held {};
    struct stat named {};
    if (::fstat(fd.get(), &held) == 0 && ::stat(path.c_str(), &named) == 0 &&
        held.st_dev == named.st_dev && held.st_ino == named.st_ino) {
      return FileLock(std::move(path), std::move(fd));
    }
  }
}

}  // namespace haarlight
