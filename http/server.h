// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "http/site.h"

/// @file
/// One small HTTP/1.1 server: an epoll thread that parses, checks and answers what is quick,
/// two workers for the rest (Lane), and a timer thread for heartbeats and deadlines. Only the
/// .cpp knows libmicrohttpd.
///
/// Every request is checked in this order: Host (one, 400), Origin (a page of another site, or
/// a name that was made to point here, is refused: 403), path (400), route (404, 405),
/// Sec-Fetch-Site (403), overload (503), token (401), body size (413).

namespace haarlight {

struct HttpServerConfig {
  std::string address = "127.0.0.1";  ///< numeric, IPv4 or IPv6
  int port = 0;                       ///< 0: any free one, see HttpServer::port()
  /// Needed to write when set, and to read when the server can be reached from elsewhere: its
  /// address is not loopback, or it has allowed_hosts. At least 16 characters. Sent as
  /// "Authorization: Bearer TOKEN", or given once to POST /v1/login, which sets an HttpOnly
  /// SameSite=Strict cookie. Never part of a URL.
  std::string token = {};
  /// "NAME" or "NAME:PORT", lower case: names for Host beside numbers and localhost, and
  /// https://NAME:PORT for Origin (stranger.h). They need a token.
  std::vector<std::string> allowed_hosts = {};

  std::size_t max_body_bytes = std::size_t{1} << 20U;
  std::size_t max_header_bytes = std::size_t{16} << 10U;
  std::size_t max_connections =
      256;  ///< beyond it the longest waiting one without a request goes
  /// Of all event streams together. Beyond it the oldest one goes that has no token where
  /// others have one, of the address that has most; none with a token goes for one without.
  std::size_t max_listeners = 64;
  std::size_t max_waiting = 32;                      ///< of each lane, beside the one at work
  std::chrono::milliseconds lane_patience{8000};     ///< waited longer in a lane: 503
  std::chrono::milliseconds idle_timeout{30000};     ///< no complete request header
  std::chrono::milliseconds request_timeout{10000};  ///< header complete, body or answer not
  std::chrono::milliseconds heartbeat{15000};        ///< comment line on event streams
};

struct HttpCounters {
  std::uint64_t requests = 0;  ///< answered, refusals included
  std::uint64_t refused = 0;   ///< answered with 4xx or 5xx
  std::uint64_t evicted = 0;   ///< connections closed to make room
  std::uint64_t timed_out = 0;
  std::size_t open_connections = 0;
};

class HttpServer {
 public:
  /// Listens when it returns.
  /// @throws Error(unavailable)  the address cannot be bound
  /// @throws Error(bad_input)    no numeric address; another than loopback, or allowed hosts,
  ///                             without a token; a token that is too short; a host that is no
  ///                             name; no static folder
  HttpServer(HttpServerConfig config, HttpSite site);
  /// Ends event streams, closes every connection, waits for both threads.
  ~HttpServer();
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  [[nodiscard]] int port() const noexcept;
  [[nodiscard]] HttpCounters counters() const;

  struct Impl;  ///< public for the C callbacks of the .cpp

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight
