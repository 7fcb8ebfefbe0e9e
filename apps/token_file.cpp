// SPDX-License-Identifier: Apache-2.0
#include "apps/token_file.h"

#include "haarlight/core/files.h"

namespace haarlight::apps {

std::string read_token(const std::filesystem::path& file) {
  std::string token = read_file(file, 4096);
  token.erase(token.find_last_not_of(" \t\r\n") + 1);
  return token;
}

}  // namespace haarlight::apps
