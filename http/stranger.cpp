// SPDX-License-Identifier: Apache-2.0
#include "http/stranger.h"

#include <algorithm>

#include <fmt/format.h>

namespace haarlight::http {
namespace {

HttpResponse other_site(std::string_view where) {
  return error_response(403, "a page of another site may not talk to this server", where,
                        "open the page from this server's own address; behind a proxy put its "
                        "name into allowed_hosts of [http] in the rig file");
}

bool is_own_origin(std::string_view origin, std::string_view host,
                   const std::vector<std::string>& allowed_hosts) {
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (origin.substr(0, scheme.size()) == scheme && origin.substr(scheme.size()) == host) {
      return true;
    }
  }
  // The proxy may forward under a Host other than its own.
  return std::any_of(
      allowed_hosts.begin(), allowed_hosts.end(),
      [origin](const std::string& allowed) { return origin == "https://" + allowed; });
}

}  // namespace

std::optional<HttpResponse> refuse_stranger(const Caller& caller, bool is_loopback,
                                            const std::vector<std::string>& allowed_hosts) {
  if (caller.hosts.size() > 1) {
    return error_response(400, fmt::format("{} Host headers", caller.hosts.size()), "Host",
                          "send one");
  }
  const std::string_view said = caller.hosts.empty() ? std::string_view{} : caller.hosts[0];
  const auto host = parse_authority(said);
  if (!host) {
    return error_response(400, "no usable Host header", "Host", "name the server's address");
  }
  // A name can be rebound to any address (DNS rebinding), a number cannot.
  const bool is_number = host->is_loopback || (host->is_ip_literal && !is_loopback);
  const auto is_allowed = [&](const std::string& allowed) {
    const auto name = parse_authority(allowed);
    return name && name->host == host->host;
  };
  if (!is_number && std::none_of(allowed_hosts.begin(), allowed_hosts.end(), is_allowed)) {
    return error_response(403, fmt::format("this server is not \"{}\"", host->host), "Host",
                          "use the numeric address, or add the name to allowed_hosts of [http] "
                          "in the rig file");
  }
  if (!caller.origin.empty() && !is_own_origin(caller.origin, said, allowed_hosts)) {
    return other_site("Origin");
  }
  return std::nullopt;
}

std::optional<HttpResponse> refuse_cross_site(const Caller& caller, bool is_page) {
  // With a validated Origin; "none" is the user's own doing, an address typed in.
  const bool is_ours = !caller.origin.empty() || caller.fetch_site.empty() ||
                       caller.fetch_site == "same-origin" || caller.fetch_site == "none";
  const bool is_link =
      is_page && caller.fetch_mode == "navigate" && caller.fetch_dest == "document";
  return is_ours || is_link ? std::nullopt : std::optional(other_site("Sec-Fetch-Site"));
}

}  // namespace haarlight::http
