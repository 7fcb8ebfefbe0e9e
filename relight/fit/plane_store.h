#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "core/files.h"

/// @file
/// 16-bit values written once in order and read once in order: in memory, or, where that is
/// too much, in a file that has no name and vanishes with the process.

namespace haarlight {

class PlaneStore {
 public:
  /// @throws Error(io)  no file can be made in `folder`
  PlaneStore(std::uint64_t n_values, std::uint64_t memory_bytes,
             const std::filesystem::path& folder);
  /// @throws Error(io)  the disk is full
  void append(std::span<const std::uint16_t> values);
  /// The next values. @throws Error(io)
  void read(std::span<std::uint16_t> values);
  [[nodiscard]] bool is_on_disk() const noexcept { return file_.is_open(); }

 private:
  std::filesystem::path folder_;
  Fd file_;
  std::vector<std::uint16_t> values_;
  std::uint64_t written_ = 0;
  std::uint64_t read_ = 0;
};

}  // namespace haarlight
