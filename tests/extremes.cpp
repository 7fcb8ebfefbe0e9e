// SPDX-License-Identifier: Apache-2.0
#include "tests/extremes.h"

#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::extremes {

namespace {

struct KindWords {
  std::string_view id;  ///< the test's name
  std::string_view word;
  std::string_view meaning;
};
constexpr std::array<KindWords, kKinds> kKindWords = {{
    {"dark", "all zero", "every value, picture or light is 0"},
    {"one", "only one", "one light, one pixel, one sample, side 1"},
    {"largest", "largest", "the largest size that is taken, and one more"},
    {"odd_size", "odd sizes", "sizes that are no power of two, no multiple of a tile"},
    {"scale", "1e±30", "values scaled up and down by many powers of ten"},
    {"subnormal", "subnormal", "values below the smallest normal float"},
    {"not_finite", "NaN or infinity", "in one value of the input"},
    {"degenerate", "degenerate", "coincident points, zero area, a light in the plane"},
    {"grazing", "grazing", "light, view or surface edge-on"},
    {"far_near", "far or near", "a millionth of the usual distance, a million times it"},
    {"duplicate", "duplicates", "the same light or sample twice: fewer ranks than unknowns"},
    {"clipped", "clipped", "saturated samples"},
}};

struct OutcomeWords {
  std::string_view sign;
  std::string_view prefix;
};
constexpr std::array<OutcomeWords, 5> kOutcomeWords = {
    {{"=", ""}, {"≤", ""}, {"i", ""}, {"!", "refused: "}, {"–", ""}}};
const OutcomeWords& words_of(Outcome outcome) {
  return kOutcomeWords.at(static_cast<std::size_t>(outcome));
}

struct Entry {
  Cell (*run)() = nullptr;
  std::optional<Cell> cell;
};
struct Algorithm {
  Row row;
  std::array<Entry, kKinds> entries;
};

/// Built while other files' statics are.
std::vector<Algorithm>& algorithms() {
  static std::vector<Algorithm> all;
  return all;
}

Entry& entry_of(std::string_view id, Kind kind) {
  const auto found = std::find_if(algorithms().begin(), algorithms().end(),
                                  [&](const Algorithm& a) { return a.row.id == id; });
  return found->entries.at(static_cast<std::size_t>(kind));
}

const Cell& run(Entry& entry) {
  if (!entry.cell) {
    entry.cell = entry.run();
  }
  return *entry.cell;
}

class CellTest : public testing::Test {
 public:
  CellTest(std::string_view id, Kind kind) : id_(id), kind_(kind) {}
  void TestBody() override { EXPECT_NE(run(entry_of(id_, kind_)).text, ""); }

 private:
  std::string_view id_;
  Kind kind_;
};

std::string format_bound(double bound) { return fmt::format("{:g}", bound); }

/// In a table's cell.
std::string escaped(std::string text) {
  for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2) {
    text.replace(at, 1, "\\|");
  }
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text;
}

constexpr std::string_view kHead = R"(# Extremes

What every algorithm does where numbers, sizes and geometry are at their limits. This page is written by its tests: each cell is a
test that runs the algorithm at that extreme and asserts what the cell says, an error bound with its source, or the words of the error
(without file and position). `build/dev/tests/extremes_test` compares this page with its cells; with `HAARLIGHT_UPDATE=1` before it, it writes
the page anew, to be read as a change like any other. A cell that is missing fails `./check`. The tests: `tests/*/*_extremes.cpp`.

)";

void append_kinds(std::string& page) {
  page += "| extreme | is |\n|---|---|\n";
  for (const KindWords& words : kKindWords) {
    page += fmt::format("| {} | {} |\n", words.word, words.meaning);
  }
}

void append_overview(std::string& page, const std::vector<Algorithm*>& sorted) {
  page +=
      "\n## All at a glance\n\n= exact, ≤ within a bound, i a result that says what it lacks, "
      "! an error that names the cause, – no such extreme.\n\n| algorithm |";
  for (const KindWords& words : kKindWords) {
    page += fmt::format(" {} |", words.word);
  }
  page += "\n|---|";
  for (int i = 0; i < kKinds; ++i) {
    page += "---|";
  }
  page += '\n';
  for (Algorithm* algorithm : sorted) {
    page += fmt::format("| {} |", algorithm->row.name);
    for (Entry& entry : algorithm->entries) {
      page +=
          fmt::format(" {} |", entry.run == nullptr ? "" : words_of(run(entry).outcome).sign);
    }
    page += '\n';
  }
}

void append_algorithm(std::string& page, Algorithm& algorithm) {
  page += fmt::format("\n### {}\n\n| extreme | result |\n|---|---|\n", algorithm.row.name);
  std::vector<std::pair<std::string, std::string>> rest;  // reason, kinds
  for (std::size_t i = 0; i < kKinds; ++i) {
    Entry& entry = algorithm.entries.at(i);
    if (entry.run == nullptr) {
      continue;
    }
    const Cell& cell = run(entry);
    const std::string_view word = kKindWords.at(i).word;
    if (cell.outcome == Outcome::does_not_apply) {
      const auto same = std::find_if(rest.begin(), rest.end(),
                                     [&](const auto& r) { return r.first == cell.text; });
      if (same == rest.end()) {
        rest.emplace_back(cell.text, word);
      } else {
        same->second += ", " + std::string(word);
      }
    } else {
      page += fmt::format("| {} | {}{} |\n", word, words_of(cell.outcome).prefix,
                          escaped(cell.text));
    }
  }
  std::string line;
  for (const auto& [why, kinds] : rest) {
    line += fmt::format("{}{} ({})", line.empty() ? "\nDo not apply: " : "; ", kinds, why);
  }
  page += line.empty() ? "" : line + ".\n";
}

}  // namespace

Cell exact(std::string text) { return {Outcome::exact, std::move(text)}; }

Cell stated(std::string text) { return {Outcome::stated, std::move(text)}; }

Cell bounded(double error, double bound, std::string_view of, std::string_view why) {
  EXPECT_LE(error, bound) << of;
  return {Outcome::bounded, fmt::format("{} ≤ {} ({})", of, format_bound(bound), why)};
}

Cell refused(std::string_view fragment, const std::function<void()>& call) {
  std::string text;
  try {
    call();
    ADD_FAILURE() << "nothing was refused";
  } catch (const Error& error) {
    text = error.problem();
    if (!error.hint().empty()) {
      text += "; hint: " + error.hint();
    }
  } catch (const ContractViolation& error) {
    // "file:line: expected condition (message)": the message alone is the same everywhere.
    const std::string what = error.what();
    const std::size_t begin = what.rfind(" (");
    text = "precondition: " + what.substr(begin + 2, what.size() - begin - 3);
  }
  EXPECT_NE(text.find(fragment), std::string::npos) << text;
  return {Outcome::refused, text};
}

Cell both(const Cell& first, const Cell& second) {
  return {first.outcome,
          first.text + "; " + std::string(words_of(second.outcome).prefix) + second.text};
}

int add_cell(const Row& row, Kind kind, Cell (*cell)()) {
  std::vector<Algorithm>& all = algorithms();
  if (std::none_of(all.begin(), all.end(),
                   [&](const Algorithm& a) { return a.row.id == row.id; })) {
    all.push_back({row, {}});
  }
  entry_of(row.id, kind).run = cell;
  testing::RegisterTest(
      ("Extremes_" + std::string(row.id)).c_str(),
      std::string(kKindWords.at(static_cast<std::size_t>(kind)).id).c_str(), nullptr, nullptr,
      __FILE__, __LINE__, [id = row.id, kind]() -> testing::Test* {
        return new CellTest(id, kind);  // NOLINT(cppcoreguidelines-owning-memory): GoogleTest's
      });
  return 0;
}

Page make_page() {
  // Rows of a module stand in one file, in its order; files come in the linker's.
  std::vector<Algorithm*> sorted;
  for (Algorithm& algorithm : algorithms()) {
    sorted.push_back(&algorithm);
  }
  std::stable_sort(sorted.begin(), sorted.end(), [](const Algorithm* a, const Algorithm* b) {
    return a->row.module < b->row.module;
  });
  Page page{std::string(kHead), {}};
  append_kinds(page.text);
  append_overview(page.text, sorted);
  std::string_view module;
  for (Algorithm* algorithm : sorted) {
    if (algorithm->row.module != module) {
      module = algorithm->row.module;
      page.text += fmt::format("\n## {}\n", module);
    }
    append_algorithm(page.text, *algorithm);
    for (std::size_t i = 0; i < kKinds; ++i) {
      Entry& entry = algorithm->entries.at(i);
      if (entry.run == nullptr || run(entry).text.empty()) {
        page.missing +=
            fmt::format("{}: no cell for \"{}\"\n", algorithm->row.name, kKindWords.at(i).word);
      }
    }
  }
  return page;
}

}  // namespace haarlight::extremes
