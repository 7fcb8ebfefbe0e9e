// SPDX-License-Identifier: Apache-2.0
#include "http/site.h"

#include <algorithm>
#include <charconv>
#include <utility>

#include "http/json_text.h"

namespace haarlight::http {

std::string HttpRequest::query_or(const std::string& name, std::string_view fallback) const {
  const auto it = query.find(name);
  return it == query.end() ? std::string(fallback) : it->second;
}

PageOfList page_of(const HttpRequest& request, std::size_t n) {
  const auto number = [&request](const char* name, std::size_t fallback) {
    const auto it = request.query.find(name);
    if (it == request.query.end()) {
      return fallback;
    }
    std::size_t value = 0;
    const std::string& text = it->second;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size()) {
      throw Error(std::string(name) + " is no whole number from 0: \"" + text + "\"",
                  request.path, "write for example ?from=0&count=1000");
    }
    return value;
  };
  const std::size_t first = std::min(number("from", 0), n);
  return {first, first + std::min(number("count", n), n - first)};
}

HttpResponse error_response(int status, std::string_view what, std::string_view where,
                            std::string_view hint) {
  return {status, "application/json", json_error_body(what, where, hint), {}};
}

HttpResponse error_response(const Error& error) {
  const auto status_of = [](ExitCode code) {
    switch (code) {
      case ExitCode::usage:
      case ExitCode::bad_input:
        return 400;
      case ExitCode::unavailable:
        return 503;
      case ExitCode::interrupted:
        return 409;
      case ExitCode::done:
      case ExitCode::target_missed:
      case ExitCode::internal:
      case ExitCode::io:
        break;
    }
    return 500;
  };
  return error_response(status_of(error.code()), error.problem(), error.where(), error.hint());
}

void HttpSite::add(HttpRoute route) {
  HAARLIGHT_EXPECTS(static_cast<bool>(route.handler), "a route has a handler");
  PathPattern pattern(route.pattern);
  insert({std::move(pattern), std::move(route), nullptr});
}

void HttpSite::get(std::string pattern, HttpHandler handler, Lane lane) {
  add({"GET", std::move(pattern), std::move(handler), Access::read, false, lane});
}

void HttpSite::post(std::string pattern, HttpHandler handler, Lane lane) {
  add({"POST", std::move(pattern), std::move(handler), Access::write, false, lane});
}

void HttpSite::add_events(std::string pattern, std::shared_ptr<EventStream> stream) {
  HAARLIGHT_EXPECTS(stream != nullptr, "an event stream");
  PathPattern compiled(pattern);
  insert({std::move(compiled),
          {"GET", std::move(pattern), {}, Access::read, false, Lane::here},
          std::move(stream)});
}

void HttpSite::set_static_files(const std::string& prefix, std::filesystem::path folder) {
  const auto target = parse_target(prefix);
  HAARLIGHT_EXPECTS(target.has_value(), "a prefix is an absolute path");
  prefix_ = target->segments;
  folder_ = std::move(folder);
}

void HttpSite::insert(Entry entry) {
  for (const Entry& other : entries_) {
    HAARLIGHT_EXPECTS(other.route.method != entry.route.method ||
                          other.pattern.text() != entry.pattern.text(),
                      "a route is given once");
  }
  const auto position = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& other) {
    return entry.pattern.precedes(other.pattern);
  });
  entries_.insert(position, std::move(entry));
}

}  // namespace haarlight::http
