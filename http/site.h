// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/error.h"
#include "http/event_stream.h"
#include "http/parse.h"

/// @file
/// The contents of a server: routes, event streams and folders of static files.

namespace haarlight::http {

struct HttpRequest {
  std::string method;                           ///< "GET", "POST", ...; HEAD arrives as GET
  std::string path;                             ///< as sent, without the query
  std::map<std::string, std::string> captures;  ///< of the route's pattern, decoded
  std::map<std::string, std::string> query;     ///< decoded
  std::map<std::string, std::string> headers;   ///< Accept, Content-Type, If-None-Match, Range:
                                                ///< names in lower case
  std::string body;

  /// A query value, or `fallback`.
  [[nodiscard]] std::string query_or(const std::string& name, std::string_view fallback) const;
};

/// A part of a long list: [first, end).
struct PageOfList {
  std::size_t first = 0;
  std::size_t end = 0;
};
/// ?from=N&count=N; without them the whole list; empty beyond its end.
/// @throws Error(bad_input)  not non-negative integers
[[nodiscard]] PageOfList page_of(const HttpRequest& request, std::size_t n);

struct HttpResponse {
  int status = 200;
  std::string content_type = "application/json";
  std::string body = {};
  /// Any others. "Cache-Control" replaces the server's own "no-store".
  std::map<std::string, std::string> headers = {};
};

/// The project's uniform error format: {"error": {"what", "where", "cure"}}.
[[nodiscard]] HttpResponse error_response(int status, std::string_view what,
                                          std::string_view where, std::string_view hint);
/// bad_input, usage: 400; unavailable: 503; interrupted: 409; the rest: 500.
[[nodiscard]] HttpResponse error_response(const Error& error);

/// Who may use a route.
enum class Access {
  open,   ///< anyone who can connect: health, metrics, login, the page's files
  read,   ///< the token is required when the server is not on loopback
  write,  ///< the token is required when there is one (there must be one off loopback)
};

/// Which thread runs a handler.
enum class Lane {
  /// The one HTTP thread, which also serves all-off: only what takes microseconds whatever the
  /// plan, the session or the number of clients, and never waits.
  here,
  /// Whatever reads a session, the disk or a picture: one thread for all of these unless
  /// HttpServerConfig::look_threads says otherwise, with a bounded queue (503 with Retry-After
  /// beyond it).
  look,
  /// Seconds of computation, such as a plan's: a thread and queue of its own, so that looks
  /// need not wait. With ?client=NAME a newer request of that client for the same path replaces
  /// one that still waits (409).
  work,
};

/// A haarlight::Error becomes error_response(error); any other exception becomes 500 and a line
/// in the log. Handlers of one lane never run concurrently, unless look_threads is above 1.
using HttpHandler = std::function<HttpResponse(const HttpRequest& request)>;

struct HttpRoute {
  std::string method;   ///< "GET", "POST", "PUT", "DELETE"
  std::string pattern;  ///< "/v1/sessions/{id}"
  HttpHandler handler;
  Access access = Access::read;
  bool is_always = false;  ///< served even when the server is overloaded and refuses the others
  Lane lane = Lane::look;
  std::size_t max_body_bytes = 0;  ///< 0: the server's
};

/// Filled before the server starts; the server takes it by value.
class HttpSite {
 public:
  /// @throws ContractViolation  a pattern that PathPattern refuses, or a route added twice
  void add(HttpRoute route);
  /// Access::read and Access::write.
  void get(std::string pattern, HttpHandler handler, Lane lane = Lane::look);
  void post(std::string pattern, HttpHandler handler, Lane lane = Lane::look);

  /// GET `pattern` is an event stream. Last-Event-ID resumes it.
  void add_events(std::string pattern, std::shared_ptr<EventStream> stream);

  /// GET of anything below `prefix` that matches no route is a file of `folder`; "/" is
  /// index.html. Nothing outside the folder is ever served; symbolic links and names that start
  /// with a dot are not followed. One folder per site.
  void set_static_files(const std::string& prefix, std::filesystem::path folder);

  struct Entry {
    PathPattern pattern;
    HttpRoute route;                      ///< handler empty for an event stream
    std::shared_ptr<EventStream> stream;  ///< or none
  };
  /// Most specific first.
  [[nodiscard]] const std::vector<Entry>& entries() const noexcept { return entries_; }
  [[nodiscard]] const std::filesystem::path& static_folder() const noexcept { return folder_; }
  [[nodiscard]] const std::vector<std::string>& static_prefix() const noexcept {
    return prefix_;
  }

 private:
  void insert(Entry entry);

  std::vector<Entry> entries_;
  std::vector<std::string> prefix_;
  std::filesystem::path folder_;
};

}  // namespace haarlight::http
