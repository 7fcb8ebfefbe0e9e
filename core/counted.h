// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <concepts>
#include <string>
#include <string_view>

namespace haarlight {

/// "1 light", "2 lights": how every text counts things.
/// @param things  the plural where it is not `thing` and an s
[[nodiscard]] std::string counted(std::integral auto n, std::string_view thing,
                                  std::string_view things = {}) {
  std::string words = std::to_string(n);
  words += ' ';
  words += n == 1 || things.empty() ? thing : things;
  if (n != 1 && things.empty()) {
    words += 's';
  }
  return words;
}

}  // namespace haarlight
