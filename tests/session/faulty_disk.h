// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "session/storage.h"

/// @file
/// A disk with a page cache that can be pulled: every write, sync, rename and removal of the
/// frames *and* of SQLite's files (through a VFS of its own) is one numbered operation. At a
/// chosen number it stops for good (the process is killed, a write half done) or fails once
/// (ENOSPC, EIO); `crash` then leaves on the disk only what was synced, plus whatever part of
/// the rest the adversary picks. A failed sync drops what it should have written, as Linux
/// does.

namespace haarlight::test {

/// Thrown by every operation from the stop on.
struct Stopped : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// What survives a crash beyond what was synced.
enum class Survives {
  everything,  ///< kill -9: the kernel still has the page cache
  nothing,     ///< power loss: unsynced bytes and names vanish
  some,        ///< power loss: any subset of unsynced writes and of unsynced folders' names
};

class FaultyDisk final : public session::Storage {
 public:
  static constexpr int kNever = -1;
  struct Script {
    int stop_at = kNever;  ///< operation that is not, or only half, done
    int fail_at = kNever;  ///< operation that answers `error` once
    int error = 0;         ///< ENOSPC or EIO
  };

  explicit FaultyDisk(Script script);
  ~FaultyDisk() override;
  FaultyDisk(const FaultyDisk&) = delete;
  FaultyDisk& operator=(const FaultyDisk&) = delete;

  [[nodiscard]] Result<void> write(const std::filesystem::path& path,
                                   std::span<const std::byte> bytes) override;
  [[nodiscard]] Result<void> sync_file(const std::filesystem::path& path) override;
  [[nodiscard]] Result<void> rename(const std::filesystem::path& from,
                                    const std::filesystem::path& to) override;
  [[nodiscard]] Result<void> sync_folder(const std::filesystem::path& folder) override;
  [[nodiscard]] Result<std::uint64_t> free_bytes(const std::filesystem::path& folder) override;
  [[nodiscard]] Result<void> remove(const std::filesystem::path& path) override;
  [[nodiscard]] Result<void> reserve(const std::filesystem::path& path,
                                     std::uint64_t bytes) override;
  [[nodiscard]] std::string journal_vfs() const override;
  [[nodiscard]] Result<void> journal_step() override;

  [[nodiscard]] int n_operations() const { return n_operations_; }
  [[nodiscard]] bool is_stopped() const { return is_stopped_; }
  /// From now on nothing reaches the disk.
  void stop() { is_stopped_ = true; }

  /// Leaves under `folder` what survives. The disk must be stopped, no writer may be alive.
  void crash(const std::filesystem::path& folder, Survives survives, std::uint64_t seed);

  // For the VFS.
  enum class Verdict { go, half, fail, stopped };
  [[nodiscard]] Verdict next_operation();
  [[nodiscard]] int error() const { return script_.error; }
  void note_opened(const std::string& path);
  void note_write(const std::string& path, std::uint64_t offset, std::string bytes);
  void note_truncate(const std::string& path, std::uint64_t size);
  void note_sync(const std::string& path, bool is_good);
  void note_name_synced(const std::string& path);
  void note_removed(const std::string& path, bool is_folder_synced);

 private:
  struct Vfs;
  /// A write that the disk does not have yet; no bytes: truncated to `offset`.
  struct Pending {
    std::uint64_t offset = 0;
    std::optional<std::string> bytes;
  };
  struct File {
    std::string durable;
    std::vector<Pending> pending;
  };
  static void apply(std::string& image, const Pending& pending);
  int id_of(const std::string& path);
  [[nodiscard]] Result<void> before(const char* operation, const std::filesystem::path& path);

  Script script_;
  session::DiskStorage disk_;
  int n_operations_ = 0;
  bool is_stopped_ = false;
  std::map<std::string, int> names_;          ///< as the kernel sees them
  std::map<std::string, int> durable_names_;  ///< as the disk has them
  std::vector<File> files_;
  std::unique_ptr<Vfs> vfs_;
};

}  // namespace haarlight::test
