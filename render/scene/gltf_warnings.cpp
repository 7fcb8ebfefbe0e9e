// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_warnings.h"

#include <algorithm>
#include <span>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "core/log.h"

namespace haarlight::render {

void GltfWarnings::log(const std::string& name) const {
  constexpr std::size_t kShown = 4;
  for (const auto& [what, places] : places_) {
    const std::size_t n = std::min(places.size(), kShown);
    const std::string more =
        places.size() > n ? fmt::format(" and {} more", places.size() - n) : "";
    log_warning(fmt::format("{}: {} ({}{})", name, what,
                            fmt::join(std::span(places).first(n), ", "), more));
  }
}

}  // namespace haarlight::render
