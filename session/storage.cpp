// SPDX-License-Identifier: Apache-2.0
#include "session/storage.h"

#include <cerrno>
#include <cstdio>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "haarlight/core/files.h"

namespace haarlight::session {

namespace {

tl::unexpected<Fault> fault(const char* operation, const std::filesystem::path& path,
                            int error) {
  const bool is_full = error == ENOSPC || error == EDQUOT;
  const bool is_unsupported = error == EOPNOTSUPP || error == ENOSYS;
  const Errc code = is_full ? Errc::no_space : (is_unsupported ? Errc::unsupported : Errc::io);
  return fail(code, fmt::format("{} {}: {}", operation, path.string(), std::strerror(error)),
              error);
}

}  // namespace

Result<void> Storage::remove(const std::filesystem::path& path) {
  if (::unlink(path.c_str()) != 0 && errno != ENOENT) {
    return fault("unlink", path, errno);
  }
  return {};
}

Result<void> Storage::reserve(const std::filesystem::path& path, std::uint64_t bytes) {
  const Fd fd(::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0644));
  if (!fd.is_open()) {
    return fault("open", path, errno);
  }
  const auto size = static_cast<off_t>(bytes);
  const off_t old_size = ::lseek(fd.get(), 0, SEEK_END);
  if (old_size < size && ::fallocate(fd.get(), 0, 0, size) != 0) {
    return fault("fallocate", path, errno);
  }
  if (old_size > size && ::ftruncate(fd.get(), size) != 0) {
    return fault("ftruncate", path, errno);
  }
  return {};
}

Result<void> DiskStorage::write(const std::filesystem::path& path,
                                std::span<const std::byte> bytes) {
  written_.reset();
  Fd fd(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!fd.is_open()) {
    return fault("create", path, errno);
  }
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd.get(), bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      return fault("write", path, n < 0 ? errno : EIO);
    }
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
  written_ = std::move(fd);
  written_path_ = path;
  return {};
}

Result<void> DiskStorage::sync_file(const std::filesystem::path& path) {
  if (!written_.is_open() || written_path_ != path) {
    written_.reset(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
    written_path_ = path;
  }
  const bool is_synced = written_.is_open() && ::fsync(written_.get()) == 0;
  const int error = errno;
  written_.reset();
  if (!is_synced) {
    return fault("fsync", path, error);
  }
  return {};
}

Result<void> DiskStorage::rename(const std::filesystem::path& from,
                                 const std::filesystem::path& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) {
    return fault("rename", to, errno);
  }
  return {};
}

Result<void> DiskStorage::sync_folder(const std::filesystem::path& folder) {
  const Fd fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.is_open() || ::fsync(fd.get()) != 0) {
    return fault("fsync folder", folder, errno);
  }
  return {};
}

Result<std::uint64_t> DiskStorage::free_bytes(const std::filesystem::path& folder) {
  struct statvfs info {};
  if (::statvfs(folder.c_str(), &info) != 0) {
    return fault("statvfs", folder, errno);
  }
  return std::uint64_t{info.f_bavail} * info.f_frsize;
}

}  // namespace haarlight::session
