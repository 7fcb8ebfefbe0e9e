// SPDX-License-Identifier: Apache-2.0
#include "http/json_text.h"

#include <cstddef>
#include <cstdint>

namespace haarlight::http {
namespace {

/// Bytes of the UTF-8 sequence that starts at `text[0]`, or 0 when it is not one: overlong
/// forms, surrogates and values beyond U+10FFFF are refused.
std::size_t utf8_length(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(text[i]); };
  const std::uint8_t lead = byte(0);
  if (lead < 0x80) {
    return 1;
  }
  std::size_t length = 0;
  std::uint32_t code = 0;
  std::uint32_t lowest = 0;
  if ((lead & 0xe0U) == 0xc0U) {
    length = 2;
    code = lead & 0x1fU;
    lowest = 0x80;
  } else if ((lead & 0xf0U) == 0xe0U) {
    length = 3;
    code = lead & 0x0fU;
    lowest = 0x800;
  } else if ((lead & 0xf8U) == 0xf0U) {
    length = 4;
    code = lead & 0x07U;
    lowest = 0x10000;
  } else {
    return 0;
  }
  if (text.size() < length) {
    return 0;
  }
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0U) != 0x80U) {
      return 0;
    }
    code = (code << 6U) | (byte(i) & 0x3fU);
  }
  const bool is_surrogate = code >= 0xd800 && code <= 0xdfff;
  return code < lowest || code > 0x10ffff || is_surrogate ? 0 : length;
}

void append_escaped_ascii(std::string& out, char c) {
  constexpr char kHex[] = "0123456789abcdef";
  switch (c) {
    case '"':
      out += "\\\"";
      break;
    case '\\':
      out += "\\\\";
      break;
    case '\n':
      out += "\\n";
      break;
    case '\r':
      out += "\\r";
      break;
    case '\t':
      out += "\\t";
      break;
    default:
      if (const auto u = static_cast<std::uint8_t>(c); u < 0x20 || u == 0x7f) {
        out += "\\u00";
        out += kHex[u >> 4U];
        out += kHex[u & 15U];
      } else {
        out += c;
      }
  }
}

}  // namespace

std::string json_quote(std::string_view text) {
  std::string out = "\"";
  out.reserve(text.size() + 2);
  while (!text.empty()) {
    const std::size_t length = utf8_length(text);
    if (length == 0) {
      out += "\\ufffd";
      text.remove_prefix(1);
    } else if (length == 1) {
      append_escaped_ascii(out, text[0]);
      text.remove_prefix(1);
    } else {
      out += text.substr(0, length);
      text.remove_prefix(length);
    }
  }
  out += '"';
  return out;
}

std::string json_error_body(std::string_view what, std::string_view where,
                            std::string_view hint) {
  return R"({"error": {"what": )" + json_quote(what) + R"(, "where": )" + json_quote(where) +
         R"(, "cure": )" + json_quote(hint) + "}}\n";
}

}  // namespace haarlight::http
