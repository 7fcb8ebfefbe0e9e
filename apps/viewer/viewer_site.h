// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "apps/viewer/environment_cache.h"
#include "apps/viewer/hull_cache.h"
#include "haarlight/relight/basis/basis_file.h"
#include "http/site.h"

/// @file
/// What `haarlight view` answers: the basis file's numbers for the page's graphics processor,
/// weights of environments, the object's shadow hull, and the page's files. Paths and layouts:
/// docs/reference/http-api.md, "The viewer's server".

namespace haarlight::apps {

struct ViewerConfig {
  std::filesystem::path web_folder;                       ///< empty: no page, the data alone
  std::uint64_t texture_bytes = std::uint64_t{1} << 30U;  ///< what the page may load, at most
};

/// JSON: what the file is; and its tables. What `/v1/basis` and its `tables` answer.
[[nodiscard]] std::string basis_description(const relight::BasisFile& basis,
                                            const ViewerConfig& config);
[[nodiscard]] std::string basis_table_bytes(const relight::BasisFile& basis);

/// What carries the file's hash in its address never changes.
[[nodiscard]] http::HttpResponse immutable_bytes(std::string body);
/// Serves the folder of pages, and leads "/" to one of them; nothing where there is no folder.
void serve_pages(http::HttpSite& site, const ViewerConfig& config, const std::string& first);

/// A picture file of an environment is at most this large.
inline constexpr std::size_t kMostEnvironmentBytes = std::size_t{256} << 20U;

/// The site keeps the file and the caches alive.
[[nodiscard]] http::HttpSite viewer_site(const std::shared_ptr<const relight::BasisFile>& basis,
                                         const std::shared_ptr<EnvironmentCache>& cache,
                                         const std::shared_ptr<HullCache>& hull,
                                         const ViewerConfig& config);

}  // namespace haarlight::apps
