// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight serve BASIS...`: holds basis files in memory and answers pictures over HTTP.

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <thread>

#include <fmt/format.h>

#include "apps/haarlight/end_signals.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "apps/serve/serve_site.h"
#include "apps/token_file.h"
#include "http/server.h"

namespace haarlight::apps {

namespace {

// Of a sky's picture: 8192 x 4096 texels of three floats, packed.
constexpr std::uint64_t kMostSkyBytes = std::uint64_t{256} << 20U;
constexpr std::size_t kMostThreads = 8;  // pictures at once: each also uses all processors

struct ServeArguments {
  std::vector<std::string> bases;
  std::string skies;
  std::string address = "127.0.0.1";
  int port = 0;
  std::string token_file;
  std::vector<std::string> hosts;
};

ServedBases read_bases(const ServeArguments& arguments, std::uint64_t memory_bytes) {
  ServedBases bases;
  for (const std::string& file : arguments.bases) {
    refuse_not_basis(file, "serve");
    auto basis = std::make_shared<const ServedBasis>(file, memory_bytes);
    memory_bytes -= std::min(memory_bytes, basis->bytes());
    const auto same = std::find_if(bases.begin(), bases.end(), [&](const auto& other) {
      return other->name() == basis->name();
    });
    if (same != bases.end()) {
      throw Error(fmt::format("two basis files are named {}", basis->name()),
                  fmt::format("{} and {}", (*same)->file().name(), file),
                  "rename one: clients ask for them by name", ExitCode::usage);
    }
    bases.push_back(std::move(basis));
  }
  return bases;
}

http::HttpServerConfig http_config(const ServeArguments& arguments,
                                   const CommonOptions& common) {
  http::HttpServerConfig config;
  config.address = arguments.address;
  config.port = arguments.port;
  config.allowed_hosts = arguments.hosts;
  if (!arguments.token_file.empty()) {
    config.token = read_token(arguments.token_file);
  }
  // Half of them may be sent a picture at once, each a copy.
  config.max_connections = 64;
  config.max_listeners = 1;
  config.max_body_bytes = kMostWeightBytes;
  config.max_bodies_bytes = static_cast<std::size_t>(
      std::max(std::uint64_t{kMostWeightBytes}, common.memory_bytes / 8));
  const std::size_t n_threads = common.threads > 0 ? static_cast<std::size_t>(common.threads)
                                                   : std::thread::hardware_concurrency();
  config.look_threads = static_cast<int>(std::clamp<std::size_t>(n_threads, 1, kMostThreads));
  return config;
}

/// The server's words are those of a rig file.
Error in_options(const Error& error) {
  if (!error.where().starts_with("http.")) {
    return error;
  }
  const std::string option = error.where() == "http.address"         ? "--address"
                             : error.where() == "http.allowed_hosts" ? "--allowed-host"
                             : error.where() == "http.port"          ? "--port"
                                                                     : "--token-file";
  return {error.problem(), option,
          option == "--token-file" ? error.hint() : "give --token-file, or listen on 127.0.0.1",
          ExitCode::usage};
}

std::unique_ptr<http::HttpServer> start(http::HttpServerConfig config, http::HttpSite site) {
  try {
    return std::make_unique<http::HttpServer>(std::move(config), std::move(site));
  } catch (const Error& error) {
    throw in_options(error);
  }
}

ExitCode run_serve(const ServeArguments& arguments, const CommonOptions& common,
                   Report& report) {
  for (const std::string& file : arguments.bases) {
    report.add_input(file);
  }
  const EndSignals signals;
  (void)std::signal(SIGPIPE, SIG_IGN);  // a client that goes away
  const auto skies = std::make_shared<SkyShelf>(arguments.skies, common.memory_bytes / 4);
  const ServedBases bases = read_bases(arguments, common.memory_bytes / 8 * 5);
  http::HttpServerConfig config = http_config(arguments, common);
  const std::uint64_t most_sky_bytes =
      std::min(kMostSkyBytes, std::uint64_t{config.max_bodies_bytes});
  const auto server = start(std::move(config), serve_site(bases, skies, most_sky_bytes));
  for (const auto& basis : bases) {
    fmt::print("{}: {} in memory, {} MB\n", basis->name(), basis->relighter().held(),
               (basis->bytes() + (1U << 19U)) >> 20U);
  }
  const bool is_v6 = arguments.address.find(':') != std::string::npos;
  fmt::print("serving on http://{}{}{}:{}/  (Ctrl-C ends it)\n", is_v6 ? "[" : "",
             arguments.address, is_v6 ? "]" : "", server->port());
  std::fflush(stdout);
  signals.wait();
  const http::HttpCounters counters = server->counters();
  report.add_detail("requests", static_cast<std::int64_t>(counters.requests));
  report.add_detail("refused", static_cast<std::int64_t>(counters.refused));
  return ExitCode::done;
}

}  // namespace

void add_serve(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ServeArguments>();
  Command verb =
      root.add_verb("serve", "Hold basis files in memory, answer pictures over HTTP");
  verb.option("BASIS", &arguments->bases, "Basis files; clients name them without .hlb",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("--skies", &arguments->skies, "Folder of environments that clients may name",
              {.type = "DIR"});
  verb.option("--port", &arguments->port, "Port (default: any free one)",
              {.bounds = Bounds{0, 65535}});
  verb.option("--address", &arguments->address,
              "Numeric address; other than this machine's own it needs a token",
              {.type = "IP", .shows_default = true});
  verb.option("--token-file", &arguments->token_file,
              "File with the token that clients must send, 16 characters or more",
              {.type = "FILE"});
  verb.option("--allowed-host", &arguments->hosts,
              "Name of this server besides numbers and localhost; needs a token",
              {.type = "NAME"});
  verb.footer(
      "Prints the address and serves until Ctrl-C. Half of --memory and more holds the files,\n"
      "a quarter skies. docs/reference/serve.md tells what to ask.\n"
      "Example:\n  haarlight serve airplane.hlb --skies configs/environments --port 8482");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_serve(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
