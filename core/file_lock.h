// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>

#include "haarlight/core/files.h"

/// @file
/// A file for one process at a time, also where it is replaced while it is held.

namespace haarlight {

/// Holds FILE.lock, an empty file beside FILE, by an advisory lock of the system (flock) for the
/// lifetime of the object; then deletes it. The system drops the lock of a process that ends or is
/// killed: what that leaves behind holds nobody up. Move-only.
class FileLock {
 public:
  /// @return nothing where another process, or another object of this one, has it
  /// @throws Error(io)  the folder cannot be written
  [[nodiscard]] static std::optional<FileLock> try_lock(const std::filesystem::path& file);
  ~FileLock();
  FileLock(FileLock&& other) noexcept = default;
  FileLock& operator=(FileLock&&) = delete;
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  FileLock(std::filesystem::path path, Fd fd);

  std::filesystem::path path_;
  Fd fd_;
};

}  // namespace haarlight
