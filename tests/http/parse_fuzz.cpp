// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: everything that http/parse.h reads from the network, with its promises checked.

#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "http/json_text.h"
#include "http/parse.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  static const haarlight::http::PathPattern kPattern("/v1/sessions/{id}/shots/{n}");
  if (const auto target = haarlight::http::parse_target(text)) {
    for (const std::string& segment : target->segments) {
      if (segment.empty() || segment == ".." || segment.find('/') != std::string::npos) {
        std::abort();
      }
    }
    (void)kPattern.match(target->segments);
  }
  (void)haarlight::http::find_cookie(text, "haarlight");
  if (const auto authority = haarlight::http::parse_authority(text);
      authority && authority->host.empty()) {
    std::abort();
  }
  (void)haarlight::http::json_quote(text);
  return 0;
}
