// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

/// @file
/// JSON text, written without a JSON library.

namespace haarlight::http {

/// `text` as a JSON string with its quotes. Control characters are escaped; bytes that are not
/// UTF-8 become U+FFFD, so the result is always valid JSON. Pure.
[[nodiscard]] std::string json_quote(std::string_view text);

/// {"error": {"what": ..., "where": ..., "cure": ...}}
[[nodiscard]] std::string json_error_body(std::string_view what, std::string_view where,
                                          std::string_view hint);

}  // namespace haarlight::http
