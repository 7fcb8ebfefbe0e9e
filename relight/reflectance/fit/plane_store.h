// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "haarlight/core/files.h"

/// @file 16-bit values written once in order and read once in order: in memory, or, where that
/// is too much, in an unnamed temporary file that vanishes with the process.

namespace haarlight::relight {

/// A file for reading and writing that vanishes with the process. @throws Error(io)
[[nodiscard]] Fd nameless_file(const std::filesystem::path& folder);

class PlaneStore {
 public:
  /// @throws Error(io)  no file can be created in `folder`
  PlaneStore(std::uint64_t n_values, std::uint64_t memory_bytes,
             const std::filesystem::path& folder);
  /// Where the next values go. Written once, all of them, before keep().
  [[nodiscard]] std::span<std::uint16_t> room(std::size_t n_values);
  /// The span from room() has been filled. @throws Error(io)  the disk is full
  void keep();
  /// The next values, valid until the next call. @throws Error(io)
  [[nodiscard]] std::span<const std::uint16_t> next(std::size_t n_values);
  [[nodiscard]] bool is_on_disk() const noexcept { return file_.is_open(); }

 private:
  std::filesystem::path folder_;
  Fd file_;
  std::unique_ptr<std::uint16_t[]> values_;
  std::vector<std::uint16_t> buffer_;  ///< for a file: values in transit
  std::uint64_t n_values_;
  std::uint64_t written_ = 0;
  std::uint64_t given_ = 0;  ///< by room(), not yet kept
  std::uint64_t read_ = 0;
};

}  // namespace haarlight::relight
