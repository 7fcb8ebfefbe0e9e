#include "apps/haarlight/daemon_address.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/error.h"
#include "core/files.h"

namespace haarlight {

using Json = nlohmann::json;

void add_daemon_options(Command verb, DaemonAddress& address) {
  verb.option("--daemon", &address.url, "Address of haarlightd",
              {.type = "URL", .environment = "HAARLIGHT_DAEMON", .shows_default = true});
  verb.option("--token-file", &address.token_file, "File with the daemon's token",
              {.type = "FILE"});
}

DaemonClientConfig client_config(const DaemonAddress& address) {
  DaemonClientConfig config{.url = address.url};
  if (!address.token_file.empty()) {
    config.token = read_file(address.token_file, 4096);
    config.token.erase(config.token.find_last_not_of(" \t\r\n") + 1);
  }
  return config;
}

Json parse_reply(const DaemonReply& reply) {
  DaemonClient::require_good(reply);
  Json json = Json::parse(reply.body, nullptr, false);
  if (!json.is_object()) {
    throw Error("the daemon's answer is not JSON", "haarlightd",
                "is another program listening at this address?", ExitCode::unavailable);
  }
  return json;
}

void print_state(const Json& state) {
  fmt::print("{}", state.value("phase", ""));
  if (state.contains("session") && state["session"].is_string()) {
    fmt::print("  session {}  {} of {} shots committed", state["session"].get<std::string>(),
               state.value("committed", 0), state.value("shots", 0));
  }
  if (state.contains("seconds_left") && state["seconds_left"].is_number() &&
      state.value("phase", "") == "running") {
    fmt::print("  {:.0f} s left", state["seconds_left"].get<double>());
  }
  if (const std::string reason = state.value("reason", ""); !reason.empty()) {
    fmt::print("  ({})", reason);
  }
  fmt::print("\n");
}

}  // namespace haarlight
