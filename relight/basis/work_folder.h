// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/files.h"

/// @file
/// The finished pieces of a long job, so that a killed one resumes where it stopped and several
/// processes can share one. A piece is a file that is complete or absent; it carries the key of
/// everything it depends on and a checksum. Pieces with another key count as absent.

namespace haarlight::relight {

class WorkFolder {
 public:
  /// Creates the folder if missing.
  /// @param key  of the job: its input and its settings; empty: no other run's pieces fit
  /// @throws Error(io)
  WorkFolder(std::filesystem::path folder, std::string key);

  /// Holds the folder for this process alone for the lifetime of the object; pieces of a job
  /// with another key are deleted. @throws Error(interrupted)  another process has it
  void own();

  /// A piece's bytes; nothing when it is missing, damaged or another job's.
  /// @param key  in addition to the job's: what this piece depends on
  [[nodiscard]] std::optional<std::vector<std::byte>> read(const std::string& name,
                                                           const std::string& key = {}) const;
  /// @throws Error(io)  the disk is full, ...: pieces already written stay
  void write(const std::string& name, std::span<const std::byte> bytes,
             const std::string& key = {}) const;

  /// Numbers as a piece.
  [[nodiscard]] std::optional<std::vector<double>> read_numbers(
      const std::string& name, const std::string& key = {}) const;
  void write_numbers(const std::string& name, std::span<const double> numbers,
                     const std::string& key = {}) const;

  [[nodiscard]] std::filesystem::path path(const std::string& name) const;
  [[nodiscard]] bool is_own() const noexcept { return lock_.is_open(); }
  /// Deletes the folder and everything in it.
  void remove() noexcept;

 private:
  std::filesystem::path folder_;
  std::string key_;
  Fd lock_;
};

}  // namespace haarlight::relight
