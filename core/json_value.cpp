// SPDX-License-Identifier: Apache-2.0
#include "core/json_value.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "core/text_limits.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

using Json = nlohmann::json;

const Json& node_of(const void* node) { return *static_cast<const Json*>(node); }

}  // namespace

struct JsonValue::Document {
  Document(Json value, std::string cure) : root(std::move(value)), hint(std::move(cure)) {}
  Json root;
  std::string hint;
};

JsonValue::JsonValue(std::shared_ptr<const Document> document, const void* node,
                     std::string location)
    : document_(std::move(document)), node_(node), location_(std::move(location)) {}

JsonValue JsonValue::parse(std::string_view text, const std::string& where,
                           const std::string& hint) {
  auto document = std::make_shared<const Document>(parse_json<Json>(text, where), hint);
  const void* root = &document->root;
  return {std::move(document), root, where};
}

void JsonValue::refuse(const std::string& what, const std::string& hint) const {
  throw Error(what, location_, hint);
}

bool JsonValue::has(std::string_view key) const {
  const Json& node = node_of(node_);
  return node.is_object() && node.contains(key);
}

JsonValue JsonValue::operator[](std::string_view key) const {
  const Json& node = node_of(node_);
  if (!node.is_object()) {
    refuse(fmt::format("expected an object, got {}", node.type_name()), document_->hint);
  }
  const auto found = node.find(key);
  if (found == node.end()) {
    refuse(fmt::format("\"{}\" is missing", key), document_->hint);
  }
  const bool is_root = node_ == &document_->root;
  return {document_, &*found, fmt::format("{}{}{}", location_, is_root ? ": " : ".", key)};
}

std::vector<JsonValue> JsonValue::elements() const {
  const Json& node = node_of(node_);
  if (!node.is_array()) {
    refuse(fmt::format("expected a list, got {}", node.type_name()), document_->hint);
  }
  std::vector<JsonValue> values;
  values.reserve(node.size());
  for (std::size_t i = 0; i < node.size(); ++i) {
    values.push_back(JsonValue(document_, &node[i], fmt::format("{}[{}]", location_, i)));
  }
  return values;
}

double JsonValue::number(double min, double max) const {
  const Json& node = node_of(node_);
  if (!node.is_number()) {
    refuse(fmt::format("expected a number, got {}", node.type_name()), "write a number here");
  }
  const auto value = node.get<double>();
  if (!std::isfinite(value) || value < min || value > max) {
    refuse(fmt::format("{} is outside {} .. {}", value, min, max),
           "write a number in this range");
  }
  return value;
}

std::int64_t JsonValue::integer(std::int64_t min, std::int64_t max) const {
  const Json& node = node_of(node_);
  const bool is_too_large = node.is_number_unsigned() &&
                            node.get<std::uint64_t>() > static_cast<std::uint64_t>(INT64_MAX);
  if (!node.is_number_integer() || is_too_large) {
    refuse(fmt::format("expected a whole number, got {}", node.dump().substr(0, 40)),
           "write a whole number here");
  }
  const auto value = node.get<std::int64_t>();
  if (value < min || value > max) {
    refuse(fmt::format("{} is outside {} .. {}", value, min, max),
           "write a number in this range");
  }
  return value;
}

std::uint64_t JsonValue::unsigned_integer() const {
  const Json& node = node_of(node_);
  if (!node.is_number_unsigned()) {
    refuse(fmt::format("expected a whole number from 0 up, got {}", node.dump().substr(0, 40)),
           "write a whole number here");
  }
  return node.get<std::uint64_t>();
}

bool JsonValue::truth() const {
  const Json& node = node_of(node_);
  if (!node.is_boolean()) {
    refuse(fmt::format("expected true or false, got {}", node.type_name()),
           "write true or false here");
  }
  return node.get<bool>();
}

std::string JsonValue::text() const {
  const Json& node = node_of(node_);
  if (!node.is_string()) {
    refuse(fmt::format("expected a text, got {}", node.type_name()),
           "write a text in quotes here");
  }
  return node.get<std::string>();
}

std::size_t JsonValue::choice(const std::vector<std::string_view>& words) const {
  const std::string word = text();
  const auto found = std::find(words.begin(), words.end(), word);
  if (found == words.end()) {
    refuse(fmt::format("\"{}\" is none of {}", word.substr(0, 40), fmt::join(words, ", ")),
           "write one of these words");
  }
  return static_cast<std::size_t>(found - words.begin());
}

bool JsonValue::is_object() const { return node_of(node_).is_object(); }
bool JsonValue::is_array() const { return node_of(node_).is_array(); }
bool JsonValue::is_number() const { return node_of(node_).is_number(); }

std::string JsonValue::dump() const { return node_of(node_).dump(); }

}  // namespace haarlight
