// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/fit_page.h"

#include <fmt/format.h>

#include "apps/page_folder.h"
#include "apps/viewer/publish_object.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"

namespace haarlight::apps {

void add_page_to_fit(const std::filesystem::path& out, const CommonOptions& common) {
  const std::filesystem::path web = find_page_folder();
  if (web.empty() || !relight::is_web_folder(out)) {
    return;
  }
  const bool has_page = add_page_to_web_folder(out, web);
  if (!common.quiet) {
    fmt::print("{}\n",
               has_page
                   ? fmt::format("{}/index.html shows it from any web server",
                                 out.lexically_normal().string())
                   : fmt::format("too large for a page without tiles: haarlight publish {} "
                                 "-o DIR makes one with",
                                 out.string()));
  }
}

}  // namespace haarlight::apps
