// SPDX-License-Identifier: Apache-2.0
/// @file
/// Every method that trades speed for accuracy, under each of its settings: times, errors
/// against its truth, and the records. docs/numerics/methods.md has the list.

#include <optional>
#include <string>
#include <thread>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/method_run.h"
#include "core/parallel.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

#include "bench/methods/all_methods.h"

namespace haarlight::bench {
namespace {

struct Arguments {
  std::string module;
  std::string method;
  std::string size = "small";
  std::string json;
  int repeats = 5;
  int threads = 0;
  bool lists_markdown = false;
};

std::vector<Method> chosen(const Arguments& arguments) {
  std::vector<Method> methods;
  for (const Method& method : all_methods()) {
    if (method.words().module.find(arguments.module) != std::string::npos &&
        method.words().name.find(arguments.method) != std::string::npos) {
      methods.push_back(method);
    }
  }
  if (methods.empty()) {
    throw Error(
        "no method has these words in its module and name",
        fmt::format("--module \"{}\" --method \"{}\"", arguments.module, arguments.method),
        "--list-markdown lists all");
  }
  return methods;
}

/// @return  whether every exact setting is exact and no error grows
bool run_all(const Arguments& arguments, const std::string& command) {
  MethodRunOptions options;
  options.size = *value_of<MethodSize>(arguments.size);
  options.repeats = arguments.repeats;
  options.threads = arguments.threads;
  options.command = command;
  std::vector<TradeoffRecord> records;
  std::vector<std::string> complaints;
  for (const Method& method : chosen(arguments)) {
    fmt::print(stderr, "{}: {}\n", method.words().module, method.words().name);
    const MethodRun run = run_method(method, options);
    records.insert(records.end(), run.records.begin(), run.records.end());
    complaints.insert(complaints.end(), run.grown.begin(), run.grown.end());
    if (!run.is_exact) {
      complaints.push_back(fmt::format("{}: off by {:.3g}, more than {:g} ({})",
                                       run.records.back().mode, run.records.back().error,
                                       method.words().exact_error,
                                       method.words().exact_error_from));
    }
  }
  fmt::print("{}", records_markdown(records));
  for (const std::string& complaint : complaints) {
    fmt::print("NO: {}\n", complaint);
  }
  if (!arguments.json.empty()) {
    write_file_atomically(arguments.json, tradeoff_json(records));
  }
  return complaints.empty();
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("haarlight_methods", "Every method's speed and error, by setting",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("--module", &arguments.module, "Only modules whose folder holds this");
  program.option("--method", &arguments.method, "Only methods whose name holds this");
  program.option(
      "--size", &arguments.size, "Of the inputs",
      {.choices = {kMethodSizeWords.begin(), kMethodSizeWords.end()}, .shows_default = true});
  program.option("--repeats", &arguments.repeats, "Timed runs of each setting",
                 {.bounds = apps::Bounds{1, 1000}, .shows_default = true});
  program.option("--threads", &arguments.threads, "Threads; 0: one per core",
                 {.bounds = apps::Bounds{0, 1024}, .shows_default = true});
  program.option("--json", &arguments.json, "Records, docs/reference/tradeoff.schema.json",
                 {.type = "FILE.json"});
  program.flag("--list-markdown", &arguments.lists_markdown,
               "Print the table of docs/numerics/methods.md, run nothing");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  if (arguments.lists_markdown) {
    fmt::print("{}", methods_markdown(chosen(arguments)));
    return 0;
  }
  std::string command = "haarlight_methods";
  for (int i = 1; i < argc; ++i) {
    command += std::string(" ") + argv[i];
  }
  if (arguments.threads == 0) {
    arguments.threads = static_cast<int>(std::thread::hardware_concurrency());
  }
  const ThreadLimit limit(arguments.threads);
  return run_all(arguments, command) ? 0 : 1;
}

}  // namespace
}  // namespace haarlight::bench

int main(int argc, char** argv) {
  return haarlight::apps::run_program("haarlight_methods", haarlight::bench::run, argc, argv);
}
