// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>

/// @file
/// The output folder of an import, which appears whole or not at all.

namespace haarlight::session {

/// A folder next to `target` that is removed unless it is renamed to it.
class PendingFolder {
 public:
  /// Creates it, with a folder frames/ in it. @throws Error(io)
  explicit PendingFolder(std::filesystem::path target);
  ~PendingFolder();
  PendingFolder(const PendingFolder&) = delete;
  PendingFolder& operator=(const PendingFolder&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

  /// Makes everything durable, then renames. An older session is exchanged in one step.
  /// @throws Error(io)
  void commit(bool replace);

 private:
  [[noreturn]] void fail_io(const char* step) const;

  std::filesystem::path target_;
  std::filesystem::path path_;
};

/// @return  whether an older import will be replaced
/// @throws Error  it exists and is not an import, or `force` is not given
[[nodiscard]] bool check_import_target(const std::filesystem::path& target, bool force);

/// @throws Error(io)
void write_plain(const std::filesystem::path& path, std::span<const std::byte> bytes);
void write_plain(const std::filesystem::path& path, const std::string& text);

}  // namespace haarlight::session
