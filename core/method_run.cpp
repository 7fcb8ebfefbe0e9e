// SPDX-License-Identifier: Apache-2.0
#include "core/method_run.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

/// The errors of `run`'s records, and what they should be.
void assess(const MethodWords& words, MethodRun& run) {
  for (std::size_t i = 1; i < run.records.size(); ++i) {
    const double error = run.records[i].error;
    const double before = run.records[i - 1].error;
    if (!(error <= std::max(before, words.exact_error))) {
      run.grown.push_back(fmt::format("{}, {}: \"{}\" is off by {:.3g}, \"{}\" by {:.3g} ({})",
                                      words.module, words.name, words.settings[i], error,
                                      words.settings[i - 1], before, words.error_norm));
    }
  }
  run.is_exact = run.records.back().error <= words.exact_error;
}

}  // namespace

MethodRun run_method(const Method& method, const MethodRunOptions& options) {
  HAARLIGHT_EXPECTS(options.repeats >= 1, "a timed run of each setting");
  const MethodWords& words = method.words();
  const std::unique_ptr<PreparedMethod> prepared = method.prepare(options.size);
  MethodRun run;
  std::vector<std::function<void()>> works;
  for (std::size_t i = 0; i < words.settings.size(); ++i) {
    works.emplace_back([&prepared, i] { prepared->run(i); });
    works.back()();  // not timed: pages and caches
    TradeoffRecord& record = run.records.emplace_back();
    record.algorithm = "haarlight";
    record.mode = words.name + ", " + words.settings[i];
    record.error_norm = words.error_norm;
    record.error = prepared->error();
    const std::optional<double> bytes = prepared->bytes(i);
    record.bytes = bytes.value_or(0.0);
    TradeoffConditions& at = record.conditions;
    at.threads = options.threads;
    at.lights = prepared->scale().lights;
    at.pixels = prepared->scale().pixels;
    at.repeats = options.repeats;
    at.command = options.command;
    at.more = {{"module", words.module},
               {"size", std::string(to_string(options.size))},
               {"truth", words.truth}};
    if (!bytes) {
      at.more.emplace_back("bytes_are", std::string("not counted"));
    }
  }
  const std::vector<std::vector<double>> seconds = time_in_turn(works, options.repeats);
  for (std::size_t i = 0; i < seconds.size(); ++i) {
    set_times(seconds[i], run.records[i]);
  }
  assess(words, run);
  return run;
}

std::string methods_markdown(std::span<const Method> methods) {
  std::string text =
      "| module | method | settings, fast to exact | error | truth | exact within |\n"
      "|---|---|---|---|---|---|\n";
  for (const Method& method : methods) {
    const MethodWords& words = method.words();
    text += fmt::format("| {} | {} | {} | {} | {} | {:g}: {} |\n", words.module, words.name,
                        fmt::join(words.settings, "; "), words.error_norm, words.truth,
                        words.exact_error, words.exact_error_from);
  }
  return text;
}

std::string records_markdown(std::span<const TradeoffRecord> records) {
  std::string text =
      "| method, setting | lights | pixels | ms (least to most) | GB/s at least | error |\n"
      "|---|---|---|---|---|---|\n";
  for (const TradeoffRecord& record : records) {
    text += fmt::format(
        "| {} | {} | {} | {:.3g} ({:.3g} to {:.3g}) | {} | {:.2g} {} |\n", record.mode,
        record.conditions.lights, record.conditions.pixels, 1e3 * record.seconds,
        1e3 * record.seconds_least, 1e3 * record.seconds_most,
        record.bytes > 0.0 ? fmt::format("{:.2f}", 1e-9 * record.bytes / record.seconds) : "-",
        record.error, record.error_norm);
  }
  return text;
}

}  // namespace haarlight
