// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "apps/serve/served_basis.h"
#include "apps/serve/sky_shelf.h"
#include "http/site.h"

/// @file
/// What `haarlight serve` answers: pictures of basis files under lights, weights and skies. Paths
/// and bodies: docs/reference/serve.md.

namespace haarlight::apps {

/// A client's list of weights: 24576 lights of three numbers with all their digits.
inline constexpr std::size_t kMostWeightBytes = std::size_t{4} << 20U;

/// Bases by name.
using ServedBases = std::vector<std::shared_ptr<const ServedBasis>>;

/// The site keeps both alive. Every route but health needs the server's token.
/// @param most_sky_bytes  of a picture that a client sends
[[nodiscard]] http::HttpSite serve_site(const ServedBases& bases,
                                        const std::shared_ptr<SkyShelf>& skies,
                                        std::uint64_t most_sky_bytes);

}  // namespace haarlight::apps
