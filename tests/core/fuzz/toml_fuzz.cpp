// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as TOML, on a stack of 256 KiB: read or refused, however deep. And as JSON.

#include <cstdint>
#include <cstdlib>
#include <string_view>

#include <nlohmann/json.hpp>
#include <pthread.h>

#include "core/config_table.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "tests/repeating_mutator.h"

namespace {

void* read_both(void* argument) {
  const std::string_view text = *static_cast<const std::string_view*>(argument);
  try {
    haarlight::ConfigTable root = haarlight::ConfigTable::parse_text(text, "fuzz.toml");
    (void)root.keys();
    root.finish();
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused, as it should be
  }
  try {
    const auto json = haarlight::parse_json<nlohmann::json>(text, "fuzz.json");
    (void)json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch)
  }
  return nullptr;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  pthread_attr_t attributes;
  pthread_t thread{};
  if (pthread_attr_init(&attributes) != 0 ||
      pthread_attr_setstacksize(&attributes, std::size_t{256} << 10U) != 0 ||
      pthread_create(&thread, &attributes, read_both, &text) != 0 ||
      pthread_join(thread, nullptr) != 0) {
    std::abort();
  }
  pthread_attr_destroy(&attributes);
  return 0;
}
