// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

/// @file
/// The few operations by which a frame reaches the disk, so that tests can inject failures,
/// stops and data loss at each of them. Faults: no_space for ENOSPC/EDQUOT, io for the rest,
/// sys_errno set.

namespace haarlight::session {

class Storage {
 public:
  Storage() = default;
  virtual ~Storage() = default;
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;
  /// Creates or truncates `path` and writes all bytes; not yet durable.
  [[nodiscard]] virtual Result<void> write(const std::filesystem::path& path,
                                           std::span<const std::byte> bytes) = 0;
  [[nodiscard]] virtual Result<void> sync_file(const std::filesystem::path& path) = 0;
  [[nodiscard]] virtual Result<void> rename(const std::filesystem::path& from,
                                            const std::filesystem::path& to) = 0;
  [[nodiscard]] virtual Result<void> sync_folder(const std::filesystem::path& folder) = 0;
  [[nodiscard]] virtual Result<std::uint64_t> free_bytes(
      const std::filesystem::path& folder) = 0;
  /// Removes a temporary file of this session; a missing one is fine.
  [[nodiscard]] virtual Result<void> remove(const std::filesystem::path& path);
  /// Makes `path` a file that holds `bytes` of the disk (fallocate); smaller than before:
  /// releases blocks. Fault unsupported where the file system cannot.
  [[nodiscard]] virtual Result<void> reserve(const std::filesystem::path& path,
                                             std::uint64_t bytes);
  /// The SQLite VFS that the journal opens with; empty: SQLite's own. Tests use a shim that
  /// fails, stops or loses data at every write and sync of the journal's file and WAL.
  [[nodiscard]] virtual std::string journal_vfs() const { return {}; }
  /// Called before each step of the journal (SQLite transaction), so that a test can stop
  /// there.
  [[nodiscard]] virtual Result<void> journal_step() { return {}; }
};

/// The kernel's files. One thread.
class DiskStorage : public Storage {
 public:
  [[nodiscard]] Result<void> write(const std::filesystem::path& path,
                                   std::span<const std::byte> bytes) override;
  [[nodiscard]] Result<void> sync_file(const std::filesystem::path& path) override;
  [[nodiscard]] Result<void> rename(const std::filesystem::path& from,
                                    const std::filesystem::path& to) override;
  [[nodiscard]] Result<void> sync_folder(const std::filesystem::path& folder) override;
  [[nodiscard]] Result<std::uint64_t> free_bytes(const std::filesystem::path& folder) override;

 private:
  // The file written last stays open until it is synced: an error of writeback is then reported
  // by this descriptor's fsync and cannot get lost between a close and an open.
  std::filesystem::path written_path_;
  Fd written_;
};

}  // namespace haarlight::session
