// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/clock.h"
#include "http/site.h"

/// @file
/// One small HTTP/1.1 server: an epoll thread that parses, checks and answers what is quick,
/// two workers for the rest (Lane), and a timer thread for heartbeats and deadlines. Only the
/// .cpp includes libmicrohttpd.
///
/// Every request is checked in this order: Host (one, 400), Origin (a page of another site, or
/// a name rebound to this address, is refused: 403), path (400), route (404, 405),
/// Sec-Fetch-Site (403), overload (503), token (401), body size (413).

namespace haarlight::http {

struct HttpServerConfig {
  std::string address = "127.0.0.1";  ///< numeric, IPv4 or IPv6
  int port = 0;                       ///< 0: any free one, see HttpServer::port()
  /// Required for writing when set, and for reading when the server can be reached from
  /// elsewhere: its address is not loopback, or it has allowed_hosts. At least 16 characters.
  /// Sent as "Authorization: Bearer TOKEN", or given once to POST /v1/login, which sets an
  /// HttpOnly SameSite=Strict cookie. Never part of a URL.
  std::string token = {};
  /// "NAME" or "NAME:PORT", lower case: names for Host besides numbers and localhost, and
  /// https://NAME:PORT for Origin (stranger.h). They need a token.
  std::vector<std::string> allowed_hosts = {};

  std::size_t max_body_bytes = std::size_t{1}
                               << 20U;  ///< of a route that has no limit of its own
  std::size_t max_bodies_bytes = std::size_t{512} << 20U;  ///< of all requests together: 503
  std::size_t max_header_bytes = std::size_t{16} << 10U;
  std::size_t max_connections =
      256;  ///< beyond it the longest idle one without a request is closed
  /// Of all event streams together. Beyond it the oldest stream without a token is closed if
  /// others have one, from the address with most; a stream with a token is never closed for one
  /// without.
  std::size_t max_listeners = 64;
  int look_threads = 1;                              ///< handlers of Lane::look at once
  std::size_t max_waiting = 32;                      ///< per lane, besides those in progress
  std::chrono::milliseconds lane_patience{8000};     ///< waited longer in a lane: 503
  std::chrono::milliseconds idle_timeout{30000};     ///< no complete request header
  std::chrono::milliseconds request_timeout{10000};  ///< header complete, the rest not
  std::chrono::milliseconds heartbeat{15000};        ///< comment line on event streams
  /// Of these deadlines and the heartbeat; outlives the server. The sockets have their own.
  Clock* clock = &real_clock();
};

struct HttpCounters {
  std::uint64_t requests = 0;  ///< answered, including refusals
  std::uint64_t refused = 0;   ///< answered with 4xx or 5xx
  std::uint64_t evicted = 0;   ///< connections closed to make room
  std::uint64_t timed_out = 0;
  std::size_t open_connections = 0;
};

class HttpServer {
 public:
  /// Listens on return.
  /// @throws Error(unavailable)  the address cannot be bound
  /// @throws Error(bad_input)    not a numeric address; an address other than loopback, or
  ///                             allowed hosts, without a token; a token that is too short; an
  ///                             invalid host name; no static folder
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

}  // namespace haarlight::http
