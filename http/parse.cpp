// SPDX-License-Identifier: Apache-2.0
#include "http/parse.h"

#include <algorithm>
#include <cstdint>

#include <arpa/inet.h>
#include <netinet/in.h>

#include "haarlight/core/error.h"

namespace haarlight::http {
namespace {

std::optional<unsigned> hex_digit(char c) {
  if (c >= '0' && c <= '9') {
    return static_cast<unsigned>(c - '0');
  }
  if (c >= 'a' && c <= 'f') {
    return static_cast<unsigned>(c - 'a') + 10U;
  }
  if (c >= 'A' && c <= 'F') {
    return static_cast<unsigned>(c - 'A') + 10U;
  }
  return std::nullopt;
}

bool is_control(char c) {
  const auto u = static_cast<std::uint8_t>(c);
  return u < 0x20 || u == 0x7f;
}

bool is_safe_segment(std::string_view segment) {
  return !segment.empty() && segment != "." && segment != ".." &&
         std::none_of(segment.begin(), segment.end(),
                      [](char c) { return is_control(c) || c == '/' || c == '\\'; });
}

std::string_view trim(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t");
  if (first == std::string_view::npos) {
    return {};
  }
  return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

/// The piece before the next `separator`; `rest` continues after it.
std::string_view next_piece(std::string_view& rest, char separator) {
  const std::size_t end = rest.find(separator);
  const std::string_view piece = rest.substr(0, end);
  rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end + 1);
  return piece;
}

std::optional<std::string> decode_query_part(std::string_view text) {
  std::string spaced(text);
  std::replace(spaced.begin(), spaced.end(), '+', ' ');
  return percent_decode(spaced);
}

}  // namespace

std::optional<std::string> percent_decode(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      out += text[i];
      continue;
    }
    if (i + 2 >= text.size()) {
      return std::nullopt;
    }
    const auto high = hex_digit(text[i + 1]);
    const auto low = hex_digit(text[i + 2]);
    if (!high || !low) {
      return std::nullopt;
    }
    out += static_cast<char>(*high * 16U + *low);
    i += 2;
  }
  return out;
}

std::optional<RequestTarget> parse_target(std::string_view raw) {
  if (raw.empty() || raw[0] != '/') {
    return std::nullopt;
  }
  RequestTarget target;
  const std::size_t question = raw.find('?');
  std::string_view path =
      raw.substr(1, question == std::string_view::npos ? raw.npos : question - 1);
  target.ends_with_slash = path.empty() || path.back() == '/';
  if (!path.empty() && path.back() == '/') {
    path.remove_suffix(1);
    if (path.empty()) {
      return std::nullopt;  // "//"
    }
  }
  while (!path.empty()) {
    const bool is_last = path.find('/') == std::string_view::npos;
    auto segment = percent_decode(next_piece(path, '/'));
    if (!segment || !is_safe_segment(*segment) || (!is_last && path.empty())) {
      return std::nullopt;
    }
    target.segments.push_back(std::move(*segment));
  }
  if (question != std::string_view::npos) {
    std::string_view rest = raw.substr(question + 1);
    while (!rest.empty()) {
      std::string_view value = next_piece(rest, '&');
      if (value.empty()) {
        continue;
      }
      auto name = decode_query_part(next_piece(value, '='));
      auto decoded = decode_query_part(value);
      if (!name || !decoded) {
        return std::nullopt;
      }
      target.query[std::move(*name)] = std::move(*decoded);
    }
  }
  return target;
}

std::optional<std::string> find_cookie(std::string_view header, std::string_view name) {
  while (!header.empty()) {
    std::string_view value = next_piece(header, ';');
    if (value.find('=') == std::string_view::npos) {
      continue;
    }
    const std::string_view key = trim(next_piece(value, '='));
    if (key != name) {
      continue;
    }
    value = trim(value);
    if (value.size() >= 2 && value.front() == '"' && value.back() == '"') {
      value = value.substr(1, value.size() - 2);
    }
    return std::string(value);
  }
  return std::nullopt;
}

std::optional<Authority> parse_authority(std::string_view text) {
  Authority authority;
  std::string_view port;
  bool has_port = false;
  const bool is_bracketed = !text.empty() && text.front() == '[';
  if (is_bracketed) {
    const std::size_t close = text.find(']');
    if (close == std::string_view::npos) {
      return std::nullopt;
    }
    authority.host = text.substr(1, close - 1);
    const std::string_view rest = text.substr(close + 1);
    if (!rest.empty()) {
      if (rest.front() != ':') {
        return std::nullopt;
      }
      has_port = true;
      port = rest.substr(1);
    }
  } else {
    const std::size_t colon = text.find(':');
    authority.host = text.substr(0, colon);
    if (colon != std::string_view::npos) {
      has_port = true;
      port = text.substr(colon + 1);
    }
  }
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  if (has_port &&
      (port.empty() || port.size() > 5 || !std::all_of(port.begin(), port.end(), is_digit))) {
    return std::nullopt;
  }
  for (char& c : authority.host) {
    c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  }
  in_addr v4{};
  in6_addr v6{};
  if (is_bracketed) {
    if (inet_pton(AF_INET6, authority.host.c_str(), &v6) != 1) {
      return std::nullopt;
    }
    authority.is_ip_literal = true;
    authority.is_loopback = IN6_IS_ADDR_LOOPBACK(&v6) != 0;
    return authority;
  }
  if (inet_pton(AF_INET, authority.host.c_str(), &v4) == 1) {
    authority.is_ip_literal = true;
    authority.is_loopback = (ntohl(v4.s_addr) >> 24U) == 127U;
    return authority;
  }
  const auto is_name_char = [&](char c) {
    return is_digit(c) || (c >= 'a' && c <= 'z') || c == '-' || c == '.' || c == '_';
  };
  if (authority.host.empty() ||
      !std::all_of(authority.host.begin(), authority.host.end(), is_name_char)) {
    return std::nullopt;
  }
  authority.is_loopback = authority.host == "localhost";
  return authority;
}

PathPattern::PathPattern(std::string_view pattern) : text_(pattern) {
  HAARLIGHT_EXPECTS(!pattern.empty() && pattern[0] == '/', "a route starts with /");
  std::string_view rest = pattern.substr(1);
  while (!rest.empty()) {
    const std::string_view piece = next_piece(rest, '/');
    HAARLIGHT_EXPECTS(!piece.empty(), "a route has no empty segment");
    Segment segment{std::string(piece), false};
    if (piece.front() == '{') {
      HAARLIGHT_EXPECTS(piece.size() > 2 && piece.back() == '}', "a capture is {name}");
      segment = {std::string(piece.substr(1, piece.size() - 2)), true};
      for (const Segment& earlier : segments_) {
        HAARLIGHT_EXPECTS(!earlier.is_capture || earlier.text != segment.text,
                          "a capture's name is used once");
      }
    }
    segments_.push_back(std::move(segment));
  }
}

std::optional<std::map<std::string, std::string>> PathPattern::match(
    const std::vector<std::string>& segments) const {
  if (segments.size() != segments_.size()) {
    return std::nullopt;
  }
  std::map<std::string, std::string> captures;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    if (segments_[i].is_capture) {
      captures[segments_[i].text] = segments[i];
    } else if (segments_[i].text != segments[i]) {
      return std::nullopt;
    }
  }
  return captures;
}

bool PathPattern::precedes(const PathPattern& other) const {
  if (segments_.size() != other.segments_.size()) {
    return segments_.size() > other.segments_.size();
  }
  for (std::size_t i = 0; i < segments_.size(); ++i) {
    if (segments_[i].is_capture != other.segments_[i].is_capture) {
      return other.segments_[i].is_capture;
    }
  }
  return false;
}

}  // namespace haarlight::http
