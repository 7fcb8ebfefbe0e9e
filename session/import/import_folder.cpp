// SPDX-License-Identifier: Apache-2.0
#include "session/import/import_folder.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/session.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxSessionJson = std::uintmax_t{64} << 20U;  // 60 000 pictures

bool is_replaceable(const fs::path& target) {
  const fs::path file = target / "session.json";
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    return false;
  }
  const SessionInfo info =
      session_info_from_json(read_file(file, kMaxSessionJson), file.string());
  return info.evidence == EvidenceKind::asserted;
}

}  // namespace

PendingFolder::PendingFolder(fs::path target) : target_(std::move(target)) {
  const fs::path name = target_.filename();
  path_ = target_.parent_path() / fmt::format(".{}.import{}", name.string(), ::getpid());
  std::error_code error;
  fs::create_directories(target_.parent_path().empty() ? "." : target_.parent_path(), error);
  if (!error) {
    fs::remove_all(path_, error);  // left by a killed import with the same process id
    fs::create_directories(path_ / "frames", error);
  }
  if (error) {
    throw Error("cannot make a folder: " + error.message(), path_.string(),
                "check the folder's rights and free space", ExitCode::io);
  }
}

PendingFolder::~PendingFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

void PendingFolder::commit(bool replace) {
  const Fd fd(::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.is_open() || ::syncfs(fd.get()) != 0) {
    fail_io("sync");
  }
  const unsigned flags = replace ? RENAME_EXCHANGE : RENAME_NOREPLACE;
  int result = ::renameat2(AT_FDCWD, path_.c_str(), AT_FDCWD, target_.c_str(), flags);
  if (result != 0 && errno == EINVAL && !replace) {  // file systems without these flags
    result = ::rename(path_.c_str(), target_.c_str());
  }
  if (result != 0) {
    fail_io("rename");
  }
  const fs::path parent = target_.has_parent_path() ? target_.parent_path() : fs::path(".");
  const Fd folder(::open(parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!folder.is_open() || ::fsync(folder.get()) != 0) {
    fail_io("sync the folder of");
  }
}

void PendingFolder::fail_io(const char* step) const {
  throw Error(fmt::format("{}: {}", step, std::strerror(errno)), target_.string(),
              "check the folder's rights and free space", ExitCode::io);
}

bool check_import_target(const fs::path& target, bool force) {
  std::error_code ignored;
  if (!fs::exists(target, ignored)) {
    return false;
  }
  require_absent(target, force);
  if (!is_replaceable(target)) {
    throw Error("exists and is not an imported session", target.string(),
                "choose another name; --force replaces imports only, never a capture",
                ExitCode::usage);
  }
  return true;
}

void write_plain(const fs::path& path, std::span<const std::byte> bytes) {
  std::FILE* file = std::fopen(path.c_str(), "wb");
  const bool is_written =
      file != nullptr && std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size();
  const int error = errno;
  const bool is_closed = file != nullptr && std::fclose(file) == 0;
  if (!is_written || !is_closed) {
    throw Error(fmt::format("write: {}", std::strerror(is_written ? errno : error)),
                path.string(), "check the disk's free space", ExitCode::io);
  }
}

void write_plain(const fs::path& path, const std::string& text) {
  write_plain(path, std::as_bytes(std::span(text)));
}

}  // namespace haarlight::session
