// SPDX-License-Identifier: Apache-2.0
#include "apps/program_version.h"

#include <fmt/format.h>

#include "core/report.h"

namespace haarlight::apps {

std::string program_version() {
  const std::string_view commit = built_commit();
  return commit.empty() ? std::string(kVersion) : fmt::format("{} ({})", kVersion, commit);
}

}  // namespace haarlight::apps
