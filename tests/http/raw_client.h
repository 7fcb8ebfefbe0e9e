// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "haarlight/core/files.h"

/// @file
/// A client that sends exactly the bytes it is told to: what a browser would refuse to send
/// too.

namespace haarlight::http {

struct RawResponse {
  int status = 0;
  std::map<std::string, std::string> headers;  ///< names in lower case
  std::string body;
};

/// One TCP connection to 127.0.0.1.
class RawClient {
 public:
  explicit RawClient(int port);
  void send(std::string_view bytes);
  /// Reads one answer by its Content-Length. Nothing when the server closes first or nothing
  /// comes within `patience`.
  [[nodiscard]] std::optional<RawResponse> read_response(
      std::chrono::milliseconds patience = std::chrono::seconds(5));
  /// Reads until `text` has come; everything read so far and not yet taken.
  [[nodiscard]] std::string read_until(
      std::string_view text, std::chrono::milliseconds patience = std::chrono::seconds(5));
  /// True when the server closes within `patience`.
  [[nodiscard]] bool is_closed_within(std::chrono::milliseconds patience);

 private:
  bool read_some(std::chrono::steady_clock::time_point deadline);

  Fd fd_;
  std::string buffer_;
  bool is_ended_ = false;
};

/// "METHOD path HTTP/1.1" with Host 127.0.0.1 and `headers` (each ends with CRLF) and a body
/// with its length; one connection a call.
[[nodiscard]] RawResponse exchange(int port, std::string_view method, std::string_view path,
                                   std::string_view headers = {}, std::string_view body = {});

}  // namespace haarlight::http
