// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "http/site.h"

/// @file
/// Whether a request comes from a page of ours: Host against names rebound to this address (DNS
/// rebinding), Origin and Sec-Fetch-Site against pages of other sites. Pure.

namespace haarlight::http {

/// What a browser says about the origin of a request; empty where it says nothing.
struct Caller {
  std::vector<std::string_view> hosts;  ///< every Host header
  std::string_view origin;
  std::string_view fetch_site;  ///< Sec-Fetch-Site
  std::string_view fetch_mode;
  std::string_view fetch_dest;
};

/// @param is_loopback    the server listens there: then a numeric Host is the loopback's
/// @param allowed_hosts  names in lower case that denote this server besides numbers and
/// localhost, with ":port" where it is not the scheme's default: a proxy's. A page of
/// https://NAME is ours, whatever Host the proxy forwards
/// @return 400 or 403, or nothing
[[nodiscard]] std::optional<HttpResponse> refuse_stranger(
    const Caller& caller, bool is_loopback, const std::vector<std::string>& allowed_hosts);

/// A request by a page of another site that Origin does not reveal (an image, a form, a link).
/// Only following a link to the page itself is allowed: `is_page` and a navigation of the whole
/// window.
/// @return 403, or nothing
[[nodiscard]] std::optional<HttpResponse> refuse_cross_site(const Caller& caller, bool is_page);

}  // namespace haarlight::http
