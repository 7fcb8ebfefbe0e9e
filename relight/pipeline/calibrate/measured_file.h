// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>

#include "core/rig/measured_rig.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// The file next to a rig file that holds its measured values.

namespace haarlight::relight {

/// Puts a calibration's results into NAME.measured.toml, leaving the rest untouched.
class MeasuredFile {
 public:
  /// @param written  the rig as its file has it; borrowed
  /// @throws Error  a file that cannot be read
  explicit MeasuredFile(const Rig& written);
  MeasuredRig values;
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return file_; }
  /// Verifies that every program can read it, then writes it. @return  bytes
  /// @throws Error  values that no program could read; unwritable
  std::size_t write();

 private:
  const Rig& written_;
  std::filesystem::path file_;
};

}  // namespace haarlight::relight
