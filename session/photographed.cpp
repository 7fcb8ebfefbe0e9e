// SPDX-License-Identifier: Apache-2.0
#include "session/photographed.h"

#include <algorithm>
#include <optional>

#include <nlohmann/json.hpp>

#include "core/json_value.h"

namespace haarlight::session {

std::string facts_to_json(const PictureFacts& facts) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  const auto add_text = [&json](const char* key, const std::string& text) {
    if (!text.empty()) {
      json[key] = text;
    }
  };
  const auto add_number = [&json](const char* key, const std::optional<double>& number) {
    if (number) {
      json[key] = *number;
    }
  };
  add_text("camera", facts.model);
  add_number("exposure_s", facts.exposure_s);
  add_number("f_number", facts.f_number);
  add_number("iso", facts.iso);
  add_text("taken", facts.taken);
  return json.dump();
}

PictureFacts facts_from_json(const JsonValue& value) {
  PictureFacts facts;
  const auto text = [&value](const char* key) {
    constexpr std::size_t kMostText = 64;
    if (!value.has(key)) {
      return std::string();
    }
    std::string found = value[key].text();
    const bool is_plain =
        std::all_of(found.begin(), found.end(), [](char c) { return c >= ' ' && c <= '~'; });
    if (!is_plain || found.size() > kMostText) {
      value[key].refuse("not a line of at most 64 printable ASCII characters",
                        "write it so, or leave it out");
    }
    return found;
  };
  const auto number = [&value](const char* key) {
    return value.has(key)
               ? std::optional(value[key].number(kLeastCameraNumber, kMostCameraNumber))
               : std::nullopt;
  };
  facts.model = text("camera");
  facts.exposure_s = number("exposure_s");
  facts.f_number = number("f_number");
  facts.iso = number("iso");
  facts.taken = text("taken");
  return facts;
}

}  // namespace haarlight::session
