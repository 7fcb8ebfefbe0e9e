#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>

#include "core/error.h"

/// @file
/// The few operations by which a frame reaches the disk, so that tests can fail, stop or forget at
/// every one of them. Faults: no_space for ENOSPC/EDQUOT, io for the rest, sys_errno set.

namespace haarlight {

class Storage {
 public:
  virtual ~Storage() = default;
  /// Creates or truncates `path` and writes all bytes; not yet durable.
  [[nodiscard]] virtual Result<void> write(const std::filesystem::path& path,
                                           std::span<const std::byte> bytes) = 0;
  [[nodiscard]] virtual Result<void> sync_file(const std::filesystem::path& path) = 0;
  [[nodiscard]] virtual Result<void> rename(const std::filesystem::path& from,
                                            const std::filesystem::path& to) = 0;
  [[nodiscard]] virtual Result<void> sync_folder(const std::filesystem::path& folder) = 0;
  [[nodiscard]] virtual Result<std::uint64_t> free_bytes(const std::filesystem::path& folder) = 0;
  /// Called before each step of the journal (SQLite transaction), so that a test can stop there.
  [[nodiscard]] virtual Result<void> journal_step() { return {}; }
};

/// The kernel's files.
class DiskStorage final : public Storage {
 public:
  [[nodiscard]] Result<void> write(const std::filesystem::path& path,
                                   std::span<const std::byte> bytes) override;
  [[nodiscard]] Result<void> sync_file(const std::filesystem::path& path) override;
  [[nodiscard]] Result<void> rename(const std::filesystem::path& from,
                                    const std::filesystem::path& to) override;
  [[nodiscard]] Result<void> sync_folder(const std::filesystem::path& folder) override;
  [[nodiscard]] Result<std::uint64_t> free_bytes(const std::filesystem::path& folder) override;
};

}  // namespace haarlight
