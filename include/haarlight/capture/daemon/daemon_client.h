// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

/// @file
/// The client side of the daemon's HTTP interface, for the command line and for scripts in C++.
/// Only the .cpp includes libcurl.

namespace haarlight::capture {

struct DaemonReply {
  int status = 0;
  std::string body;
};

struct DaemonClientConfig {
  std::string url = "http://127.0.0.1:8480";
  std::string token;  ///< empty: none is sent
  std::chrono::milliseconds timeout{10000};
};

/// One thread.
class DaemonClient {
 public:
  explicit DaemonClient(DaemonClientConfig config);
  ~DaemonClient();
  DaemonClient(const DaemonClient&) = delete;
  DaemonClient& operator=(const DaemonClient&) = delete;

  /// @param path  "/v1/state"
  /// @throws Error(unavailable)  no answer
  [[nodiscard]] DaemonReply get(const std::string& path);
  [[nodiscard]] DaemonReply post(const std::string& path, const std::string& body = {});

  /// Text for a query value, percent-encoded.
  [[nodiscard]] static std::string escape(const std::string& text);

  /// @throws Error  what the daemon's error body says, when the status is 400 or above
  static void require_good(const DaemonReply& reply);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// GET of a whole local address, for DoctorOptions::fetch and the like.
/// @return  the body, or "HTTP 404" where it is empty; empty: no answer within 1.5 s
[[nodiscard]] std::string fetch_local(const std::string& url);

}  // namespace haarlight::capture
