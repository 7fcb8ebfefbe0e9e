// SPDX-License-Identifier: Apache-2.0
#include "core/config_table.h"

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight {

namespace {

constexpr std::size_t kMaxProblems = 100;  // more would not help anyone

struct Problem {
  std::string where;
  std::string what;
  std::string hint;
};

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) {
    row[j] = j;
  }
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substituted});
    }
  }
  return row[b.size()];
}

}  // namespace

std::string nearest_word(std::string_view word, const std::vector<std::string>& candidates) {
  std::string best;
  std::size_t best_distance = 4;
  for (const std::string& candidate : candidates) {
    if (std::max(word.size(), candidate.size()) - std::min(word.size(), candidate.size()) >=
        best_distance) {
      continue;  // not worth comparing: a word of megabytes
    }
    const std::size_t distance = edit_distance(word, candidate);
    if (distance < best_distance) {
      best_distance = distance;
      best = candidate;
    }
  }
  return best;
}

struct ConfigTable::Document {
  std::string name;
  toml::table root;
  std::vector<Problem> problems;  ///< the first of them
  std::size_t n_problems = 0;
  std::vector<std::shared_ptr<Node>> opened;
};

struct ConfigTable::Node {
  const toml::table* table = nullptr;
  std::string path;
  std::set<std::string, std::less<>> known;
};

ConfigTable::ConfigTable(std::shared_ptr<Document> document, std::shared_ptr<Node> node)
    : document_(std::move(document)), node_(std::move(node)) {
  document_->opened.push_back(node_);
}

ConfigTable ConfigTable::parse_file(const std::filesystem::path& path) {
  if (path.extension() == ".glb" || path.extension() == ".gltf") {
    throw Error(
        "a glTF scene, where a TOML file is wanted", path.string(),
        "`haarlight render surface` and `haarlight check` read it; so does a [[mesh]] of a "
        "scene file: docs/reference/gltf.md");
  }
  return parse_text(read_file(path, kMaxTomlBytes), path.string());
}

ConfigTable ConfigTable::parse_text(std::string_view text, const std::string& name) {
  require_toml_limits(text, name);
  auto document = std::make_shared<Document>();
  document->name = name;
  try {
    document->root = toml::parse(text);
  } catch (const toml::parse_error& error) {
    throw Error(
        std::string(error.description()),
        fmt::format("{}:{}:{}", name, error.source().begin.line, error.source().begin.column),
        "correct the TOML at this position");
  }
  auto node = std::make_shared<Node>();
  node->table = &document->root;
  return {document, node};
}

bool ConfigTable::has(std::string_view key) const { return node_->table->contains(key); }

std::vector<std::string> ConfigTable::keys() const {
  std::vector<std::pair<toml::source_position, std::string>> found;
  for (const auto& [key, value] : *node_->table) {
    found.emplace_back(key.source().begin, std::string(key.str()));
  }
  std::sort(found.begin(), found.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<std::string> names;
  names.reserve(found.size());
  for (auto& [position, name] : found) {
    names.push_back(std::move(name));
  }
  return names;
}

bool ConfigTable::is_text(std::string_view key) const {
  const toml::node* found = node_->table->get(key);
  return found != nullptr && found->is_string();
}

bool ConfigTable::is_flag(std::string_view key) const {
  const toml::node* found = node_->table->get(key);
  return found != nullptr && found->is_boolean();
}

std::string ConfigTable::where(std::string_view key) const {
  const toml::node* found = key.empty() ? nullptr : node_->table->get(key);
  const auto line =
      found != nullptr ? found->source().begin.line : node_->table->source().begin.line;
  return line == 0 ? document_->name : fmt::format("{}:{}", document_->name, line);
}

void ConfigTable::problem(std::string_view key, std::string what, std::string hint) {
  if (++document_->n_problems <= kMaxProblems) {
    document_->problems.push_back({where(key), std::move(what), std::move(hint)});
  }
}

namespace {

std::string describe(const Range& range) {
  if (range.max == std::numeric_limits<double>::max()) {
    return fmt::format("at least {}", range.min);
  }
  if (range.min == -std::numeric_limits<double>::max()) {
    return fmt::format("at most {}", range.max);
  }
  return fmt::format("from {} to {}", range.min, range.max);
}

std::string list_words(const std::vector<std::string_view>& words) {
  std::string list;
  for (const std::string_view word : words) {
    list += list.empty() ? "" : " | ";
    list += fmt::format("\"{}\"", word);
  }
  return list;
}

}  // namespace

double ConfigTable::number(std::string_view key, Range range) {
  node_->known.emplace(key);
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    problem(key, fmt::format("{}{} is missing", node_->path, key), "add it (a number)");
    return 0.0;
  }
  const auto value = found->value<double>();
  if (!value || found->is_boolean()) {
    problem(key, fmt::format("{}{} is not a number", node_->path, key), "write a number");
    return 0.0;
  }
  if (!std::isfinite(*value) || *value < range.min || *value > range.max) {
    problem(key, fmt::format("{}{} = {} is out of range", node_->path, key, *value),
            "write a number " + describe(range));
    return std::isfinite(range.min) && range.min > -1e300 ? range.min : 0.0;
  }
  return *value;
}

std::int64_t ConfigTable::integer(std::string_view key, Range range) {
  const toml::node* found = node_->table->get(key);
  if (found != nullptr && found->is_integer()) {
    const std::int64_t value = found->ref<std::int64_t>();
    const auto near = static_cast<double>(value);
    if (near >= range.min && near <= range.max) {
      node_->known.emplace(key);
      return value;  // all 64 bits, of which a double holds 53
    }
  }
  const double value = number(key, range);
  if (value != std::floor(value) || std::abs(value) > 0x1p53) {
    problem(key, fmt::format("{}{} = {} is not a whole number", node_->path, key, value),
            "write a whole number");
    return 0;
  }
  return static_cast<std::int64_t>(value);
}

std::string ConfigTable::text(std::string_view key) {
  node_->known.emplace(key);
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    problem(key, fmt::format("{}{} is missing", node_->path, key), "add it (a text in quotes)");
    return {};
  }
  if (!found->is_string()) {
    problem(key, fmt::format("{}{} is not a text", node_->path, key), "write it in quotes");
    return {};
  }
  return found->ref<std::string>();
}

std::vector<double> ConfigTable::numbers(std::string_view key, std::size_t count, Range range) {
  node_->known.emplace(key);
  std::vector<double> values;
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    problem(key, fmt::format("{}{} is missing", node_->path, key), "add it, [number, ...]");
    values.resize(count);
    return values;
  }
  bool is_good = found->is_array();
  if (is_good) {
    for (const toml::node& element : *found->as_array()) {
      const auto value = element.value<double>();
      is_good = is_good && value && !element.is_boolean() && std::isfinite(*value);
      values.push_back(value.value_or(0.0));
    }
  }
  if (!is_good || values.empty() || (count != 0 && values.size() != count)) {
    problem(key,
            fmt::format("{}{} is not a list of {} numbers", node_->path, key,
                        count == 0 ? std::string("finite") : std::to_string(count)),
            "write [number, ...]");
    values.assign(std::max<std::size_t>(count, 1), 0.0);
  }
  require_range(key, values, range);
  return values;
}

void ConfigTable::require_range(std::string_view key, const std::vector<double>& values,
                                Range range) {
  const auto outside = std::find_if(values.begin(), values.end(),
                                    [&](double x) { return x < range.min || x > range.max; });
  if (outside != values.end()) {
    problem(key, fmt::format("{}{} holds {}, out of range", node_->path, key, *outside),
            "write numbers " + describe(range));
  }
}

std::vector<std::string> ConfigTable::texts(std::string_view key) {
  node_->known.emplace(key);
  std::vector<std::string> values;
  const toml::node* found = node_->table->get(key);
  if (found == nullptr || !found->is_array()) {
    problem(key, fmt::format("{}{} is not a list of texts", node_->path, key),
            "write [\"text\", ...]");
    return values;
  }
  for (const toml::node& element : *found->as_array()) {
    if (!element.is_string()) {
      problem(key, fmt::format("{}{} holds something that is not a text", node_->path, key),
              "write [\"text\", ...]");
      return {};
    }
    values.push_back(element.ref<std::string>());
  }
  return values;
}

std::vector<double> ConfigTable::matrix(std::string_view key, std::size_t rows,
                                        std::size_t cols, Range range) {
  node_->known.emplace(key);
  std::vector<double> values;
  const toml::node* found = node_->table->get(key);
  bool is_good =
      found != nullptr && found->is_array() && (rows == 0 || found->as_array()->size() == rows);
  if (is_good) {
    for (const toml::node& row : *found->as_array()) {
      is_good = is_good && row.is_array() && row.as_array()->size() == cols;
      if (!is_good) {
        break;
      }
      for (const toml::node& element : *row.as_array()) {
        const auto value = element.value<double>();
        is_good = is_good && value && std::isfinite(*value);
        values.push_back(value.value_or(0.0));
      }
    }
  }
  if (!is_good) {
    problem(key,
            fmt::format("{}{} is {}", node_->path, key,
                        found == nullptr ? "missing" : "not a matrix of finite numbers"),
            rows == 0 ? fmt::format("write rows of {} numbers, [[...], ...]", cols)
                      : fmt::format("write {} rows of {} numbers, [[...], ...]", rows, cols));
    values.assign(rows * cols, 0.0);
  }
  require_range(key, values, range);
  return values;
}

std::size_t ConfigTable::choice(std::string_view key,
                                const std::vector<std::string_view>& words) {
  const std::size_t n_problems = document_->n_problems;
  const std::string word = text(key);
  const auto found = std::find(words.begin(), words.end(), word);
  if (found != words.end()) {
    return static_cast<std::size_t>(found - words.begin());
  }
  if (document_->n_problems == n_problems) {
    problem(key, fmt::format("{}{} = \"{}\" is not known", node_->path, key, word),
            "write one of " + list_words(words));
  } else if (n_problems < kMaxProblems) {
    document_->problems.back().hint = "write one of " + list_words(words);
  }
  return 0;
}

double ConfigTable::number_or(std::string_view key, double fallback, Range range) {
  node_->known.emplace(key);
  return has(key) ? number(key, range) : fallback;
}

std::int64_t ConfigTable::integer_or(std::string_view key, std::int64_t fallback, Range range) {
  node_->known.emplace(key);
  return has(key) ? integer(key, range) : fallback;
}

std::string ConfigTable::text_or(std::string_view key, std::string_view fallback) {
  node_->known.emplace(key);
  return has(key) ? text(key) : std::string(fallback);
}

bool ConfigTable::flag_or(std::string_view key, bool fallback) {
  node_->known.emplace(key);
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    return fallback;
  }
  if (!found->is_boolean()) {
    problem(key, fmt::format("{}{} is neither true nor false", node_->path, key),
            "write true or false");
    return fallback;
  }
  return found->value_or(fallback);
}

std::vector<double> ConfigTable::numbers_or(std::string_view key,
                                            const std::vector<double>& fallback, Range range) {
  node_->known.emplace(key);
  return has(key) ? numbers(key, fallback.size(), range) : fallback;
}

std::size_t ConfigTable::choice_or(std::string_view key,
                                   const std::vector<std::string_view>& words,
                                   std::size_t fallback) {
  node_->known.emplace(key);
  return has(key) ? choice(key, words) : fallback;
}

std::optional<ConfigTable> ConfigTable::table(std::string_view key) {
  node_->known.emplace(key);
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    return std::nullopt;
  }
  if (!found->is_table()) {
    problem(key, fmt::format("{}{} is not a table", node_->path, key),
            fmt::format("write [{}]", key));
    return std::nullopt;
  }
  auto node = std::make_shared<Node>();
  node->table = found->as_table();
  node->path = fmt::format("{}{}.", node_->path, key);
  return ConfigTable(document_, node);
}

std::vector<ConfigTable> ConfigTable::tables(std::string_view key) {
  node_->known.emplace(key);
  std::vector<ConfigTable> all;
  const toml::node* found = node_->table->get(key);
  if (found == nullptr) {
    return all;
  }
  if (!found->is_array_of_tables()) {
    problem(key, fmt::format("{}{} is not a list of tables", node_->path, key),
            fmt::format("write [[{}]] for each one", key));
    return all;
  }
  for (const toml::node& element : *found->as_array()) {
    auto node = std::make_shared<Node>();
    node->table = element.as_table();
    node->path = fmt::format("{}{}[{}].", node_->path, key, all.size());
    all.push_back(ConfigTable(document_, node));
  }
  return all;
}

bool ConfigTable::has_problems() const { return document_->n_problems > 0; }

void ConfigTable::finish() {
  for (const std::shared_ptr<Node>& node : document_->opened) {
    const std::vector<std::string> known(node->known.begin(), node->known.end());
    for (const auto& [key, value] : *node->table) {
      if (node->known.find(key.str()) != node->known.end()) {
        continue;
      }
      if (++document_->n_problems > kMaxProblems) {
        continue;
      }
      const std::string near = nearest_word(key.str(), known);
      document_->problems.push_back(
          {fmt::format("{}:{}", document_->name, key.source().begin.line),
           fmt::format("unknown key {}{}", node->path, key.str()),
           near.empty() ? "remove it" : fmt::format("did you mean {}?", near)});
    }
    node->known.clear();
    for (const auto& [key, value] : *node->table) {
      node->known.emplace(key.str());  // report each unknown key once
    }
  }
  if (document_->problems.empty()) {
    return;
  }
  const std::vector<Problem> problems = std::move(document_->problems);
  const std::size_t n_problems = document_->n_problems;
  document_->problems.clear();
  document_->n_problems = 0;
  std::string what = problems.front().what;
  std::string hint = problems.front().hint;
  for (std::size_t i = 1; i < problems.size(); ++i) {
    hint += fmt::format("\n{}: {}\n  hint: {}", problems[i].where, problems[i].what,
                        problems[i].hint);
  }
  if (n_problems > problems.size()) {
    hint += fmt::format("\nand {} more", n_problems - problems.size());
  }
  throw Error(std::move(what), problems.front().where, std::move(hint));
}

}  // namespace haarlight
