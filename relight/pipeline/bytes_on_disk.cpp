// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/bytes_on_disk.h"

namespace haarlight::relight {

std::uintmax_t bytes_on_disk(const std::filesystem::path& path) {
  if (!std::filesystem::is_directory(path)) {
    return std::filesystem::file_size(path);
  }
  std::uintmax_t sum = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(path)) {
    sum += entry.is_regular_file() ? entry.file_size() : 0;
  }
  return sum;
}

}  // namespace haarlight::relight
