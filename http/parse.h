// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// @file
/// The parts of HTTP that we parse ourselves: target, query, cookies, Host, Origin, and our own
/// path patterns. All input here comes from the network. Pure.

namespace haarlight::http {

/// A request target split up. Segments are percent-decoded after the split, so an encoded slash
/// cannot create a new segment.
struct RequestTarget {
  std::vector<std::string> segments;         ///< "/v1/state" = {"v1", "state"}; "/" = {}
  bool ends_with_slash = false;              ///< "/docs/"; also true for "/"
  std::map<std::string, std::string> query;  ///< the last one wins where a name is repeated
};

/// Nothing when the target is not an absolute path, has a broken percent escape, an empty, "."
/// or
/// ".." segment, or a decoded control character, slash or backslash in a segment.
[[nodiscard]] std::optional<RequestTarget> parse_target(std::string_view raw);

/// %XX decoded; nothing for a broken escape.
[[nodiscard]] std::optional<std::string> percent_decode(std::string_view text);

/// The value of one cookie in a Cookie header, without quotes; nothing when it is absent.
[[nodiscard]] std::optional<std::string> find_cookie(std::string_view header,
                                                     std::string_view name);

/// A Host header: name in lower case without port and brackets.
struct Authority {
  std::string host;
  bool is_ip_literal = false;  ///< a numeric address: no DNS involved
  bool is_loopback = false;    ///< 127/8, ::1 or "localhost"
};
[[nodiscard]] std::optional<Authority> parse_authority(std::string_view text);

/// A route's path: literal segments and captures in braces, "/v1/sessions/{id}".
class PathPattern {
 public:
  /// @throws ContractViolation  not absolute, empty segment or capture name, name used twice
  explicit PathPattern(std::string_view pattern);

  /// The captures by name, or nothing when the path does not match.
  [[nodiscard]] std::optional<std::map<std::string, std::string>> match(
      const std::vector<std::string>& segments) const;

  /// True when this one must be tried before `other`: more segments first, then the earlier
  /// literal.
  [[nodiscard]] bool precedes(const PathPattern& other) const;

  [[nodiscard]] const std::string& text() const noexcept { return text_; }

 private:
  struct Segment {
    std::string text;
    bool is_capture = false;
  };
  std::string text_;
  std::vector<Segment> segments_;
};

}  // namespace haarlight::http
