// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// @file
/// Files that appear complete or not at all, and the handles and hashes they need.

namespace haarlight {

/// An open file descriptor; closes once. Move-only.
class Fd {
 public:
  Fd() = default;
  explicit Fd(int fd) noexcept : fd_(fd) {}
  ~Fd() { reset(); }
  Fd(Fd&& other) noexcept : fd_(other.release()) {}
  Fd& operator=(Fd&& other) noexcept {
    if (this != &other) {
      reset(other.release());
    }
    return *this;
  }
  Fd(const Fd&) = delete;
  Fd& operator=(const Fd&) = delete;

  [[nodiscard]] int get() const noexcept { return fd_; }
  [[nodiscard]] bool is_open() const noexcept { return fd_ >= 0; }
  [[nodiscard]] int release() noexcept {
    const int fd = fd_;
    fd_ = -1;
    return fd;
  }
  void reset(int fd = -1) noexcept;

 private:
  int fd_ = -1;
};

/// A file mapped read-only. Move-only.
class MappedFile {
 public:
  MappedFile() = default;
  /// @throws Error  not readable
  explicit MappedFile(const std::filesystem::path& path);
  ~MappedFile();
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  [[nodiscard]] std::span<const std::byte> bytes() const noexcept { return {data_, size_}; }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
};

/// Drops mapped bytes that will not be read again soon from the resident set; they can still be
/// read later. Whole pages only; costs a system call.
void drop_pages(std::span<const std::byte> mapped) noexcept;

/// Reads a whole file.
/// @param max_bytes  larger files are refused
/// @throws Error  missing, unreadable, too large
[[nodiscard]] std::string read_file(const std::filesystem::path& path,
                                    std::uintmax_t max_bytes = std::uintmax_t{1} << 31U);

/// The first bytes of a file: `n_bytes`, or all of a shorter one.
/// @throws Error  missing, unreadable
[[nodiscard]] std::string read_head(const std::filesystem::path& path, std::size_t n_bytes);

/// Writes to a temporary name next to `path`, syncs, renames, syncs the folder.
/// @throws Error(io)  naming the step that failed; the temporary file is removed
void write_file_atomically(const std::filesystem::path& path, std::span<const std::byte> bytes);
void write_file_atomically(const std::filesystem::path& path, std::string_view text);

/// A file written piece by piece that gets its name only in `commit()`; an uncommitted one is
/// removed by the destructor. Move-only.
class PendingFile {
 public:
  /// @throws Error(io)
  explicit PendingFile(std::filesystem::path path);
  ~PendingFile();
  PendingFile(PendingFile&& other) noexcept;
  PendingFile& operator=(PendingFile&&) = delete;
  PendingFile(const PendingFile&) = delete;
  PendingFile& operator=(const PendingFile&) = delete;

  /// @throws Error(io)
  void append(std::span<const std::byte> bytes);
  /// Overwrites bytes already written. @throws Error(io)
  void rewrite(std::uint64_t offset, std::span<const std::byte> bytes);
  /// Appends zeros, to be rewritten. Takes their room on the disk now, so that a disk too small
  /// is known before the work is done. @throws Error(io)
  void append_zeros(std::uint64_t n_bytes);
  /// Where the bytes are until `commit()`.
  [[nodiscard]] const std::filesystem::path& temporary() const noexcept { return temporary_; }
  /// Bytes appended so far.
  [[nodiscard]] std::uint64_t size() const noexcept { return size_; }
  /// Sync, rename, sync the folder. @throws Error(io)
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path temporary_;
  Fd fd_;
  std::uint64_t size_ = 0;
};

/// Renames a file whose bytes are on the disk already, and syncs the folder.
/// @throws Error(io)  `from` is removed
void rename_durably(const std::filesystem::path& from, const std::filesystem::path& to);

/// Refuses to overwrite. @throws Error(usage)  naming --force as the hint
void require_absent(const std::filesystem::path& path, bool force);

/// XXH3-128 of some bytes, as 32 lower-case hexadecimal digits.
[[nodiscard]] std::string content_hash(std::span<const std::byte> bytes);
[[nodiscard]] std::string content_hash(std::string_view text);

/// content_hash of bytes that come in pieces. Move-only.
class ContentHash {
 public:
  ContentHash();
  ~ContentHash();
  ContentHash(ContentHash&&) noexcept;
  ContentHash& operator=(ContentHash&&) noexcept;
  ContentHash(const ContentHash&) = delete;
  ContentHash& operator=(const ContentHash&) = delete;

  void add(std::span<const std::byte> bytes);
  /// Of all bytes so far.
  [[nodiscard]] std::string text() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace haarlight
