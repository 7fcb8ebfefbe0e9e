// SPDX-License-Identifier: Apache-2.0
#include "http/stranger.h"

#include <gtest/gtest.h>

namespace haarlight::http {
namespace {

int status_of(const Caller& caller, const std::vector<std::string>& allowed = {},
              bool is_loopback = true) {
  const auto response = refuse_stranger(caller, is_loopback, allowed);
  return response ? response->status : 200;
}

TEST(Stranger, OneUsableHost) {
  EXPECT_EQ(status_of({.hosts = {"127.0.0.1:8480"}}), 200);
  EXPECT_EQ(status_of({.hosts = {}}), 400);
  EXPECT_EQ(status_of({.hosts = {"127.0.0.1:8480", "127.0.0.1:8480"}}), 400);
  EXPECT_EQ(status_of({.hosts = {"127.0.0.1:8480", "evil.example"}}), 400);
  EXPECT_EQ(status_of({.hosts = {"evil.example", "127.0.0.1:8480"}}), 400);
}

// What nginx (its default Host is the upstream's address), nginx with `Host $host` or
// `$http_host`, and a proxy that passes the bytes on unread (stunnel, hitch) make of a page's
// request.
TEST(Stranger, APageBehindAProxyWithTls) {
  const std::vector<std::string> allowed = {"rig.example", "lab.example:8443"};
  for (const char* host :
       {"127.0.0.1:8480", "localhost:8480", "rig.example", "RIG.example", "rig.example:443"}) {
    const Caller page{.hosts = {host}, .origin = "https://rig.example"};
    EXPECT_EQ(status_of(page, allowed), 200) << host;
    EXPECT_EQ(status_of(page, {}), 403) << host;
  }
  EXPECT_EQ(
      status_of({.hosts = {"lab.example:8443"}, .origin = "https://lab.example:8443"}, allowed),
      200);
  EXPECT_EQ(status_of({.hosts = {"127.0.0.1"}, .origin = "https://lab.example:8443"}, allowed),
            200);
  for (const char* origin :
       {"https://rig.example:8443",  // another server of that machine
        "http://rig.example",        // without TLS anyone on the way wrote the page
        "https://lab.example", "https://rig.example.evil.example", "https://evil.example",
        "null", "https://", "https://rig.example/"}) {
    EXPECT_EQ(status_of({.hosts = {"127.0.0.1:8480"}, .origin = origin}, allowed), 403)
        << origin;
  }
  EXPECT_EQ(status_of({.hosts = {"evil.example"}}, allowed), 403);
}

TEST(Stranger, APageOfAnotherSiteThatSendsNoOrigin) {
  const auto status = [](const Caller& caller, bool is_page) {
    const auto response = refuse_cross_site(caller, is_page);
    return response ? response->status : 200;
  };
  const Caller image{
      .fetch_site = "cross-site", .fetch_mode = "no-cors", .fetch_dest = "image"};
  const Caller link{
      .fetch_site = "cross-site", .fetch_mode = "navigate", .fetch_dest = "document"};
  EXPECT_EQ(status({.fetch_site = "cross-site"}, false), 403);
  EXPECT_EQ(status({.fetch_site = "cross-site"}, true), 403);
  EXPECT_EQ(status({.fetch_site = "same-site"}, false), 403);  // another port of this machine
  EXPECT_EQ(status({.fetch_site = "anything"}, false), 403);
  EXPECT_EQ(status(image, true), 403);
  EXPECT_EQ(status(link, false), 403);
  EXPECT_EQ(status(link, true), 200);
  EXPECT_EQ(status({}, false), 200);
  EXPECT_EQ(status({.fetch_site = "none"}, false), 200);
  EXPECT_EQ(status({.fetch_site = "same-origin"}, false), 200);
  // Classified by its Origin: a proxy's page may well be same-site only.
  EXPECT_EQ(status({.origin = "https://rig.example", .fetch_site = "same-site"}, false), 200);
}

}  // namespace
}  // namespace haarlight::http
