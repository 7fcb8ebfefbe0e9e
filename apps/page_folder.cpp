// SPDX-License-Identifier: Apache-2.0
#include "apps/page_folder.h"

namespace haarlight::apps {

std::filesystem::path find_page_folder() {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::path folder = fs::read_symlink("/proc/self/exe", error).parent_path();
  for (const char* position : {"../share/haarlight/web", "../../../../web"}) {
    fs::path page = (folder / position).lexically_normal();
    if (!error && fs::exists(page / "index.html", error)) {
      return page;
    }
  }
  return {};
}

}  // namespace haarlight::apps
