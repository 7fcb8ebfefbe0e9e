/// @file
/// `haarlight capture|status|pause|resume|abort|all-off|reshoot`: the daemon's client.

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <thread>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/haarlight/verb.h"
#include "capture/daemon_client.h"
#include "core/files.h"
#include "core/progress.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{200};
constexpr milliseconds kDaemonAway{30000};  // a restarted daemon goes on by itself: wait for it

struct ClientArguments {
  std::string url = "http://127.0.0.1:8480";
  std::string token_file;
  std::string plan;
  std::string session;
  std::string output;
  std::vector<int> shots;
};

void add_daemon_options(CLI::App& verb, ClientArguments& arguments) {
  verb.add_option("--daemon", arguments.url, "Address of haarlightd")
      ->type_name("URL")
      ->envname("HAARLIGHT_DAEMON")
      ->capture_default_str();
  verb.add_option("--token-file", arguments.token_file, "File with the daemon's token")
      ->type_name("FILE");
}

DaemonClientConfig client_config(const ClientArguments& arguments) {
  DaemonClientConfig config{.url = arguments.url};
  if (!arguments.token_file.empty()) {
    config.token = read_file(arguments.token_file, 4096);
    config.token.erase(config.token.find_last_not_of(" \t\r\n") + 1);
  }
  return config;
}

/// @throws Error(internal)  an answer that is not what this version expects
Json parse(const DaemonReply& reply) {
  DaemonClient::require_good(reply);
  Json json = Json::parse(reply.body, nullptr, false);
  if (!json.is_object()) {
    throw Error("the daemon's answer is not JSON", "haarlightd",
                "is another program listening at this address?", ExitCode::unavailable);
  }
  return json;
}

std::string text_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_string() ? json[key].get<std::string>()
                                                     : std::string();
}
int number_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_number() ? json[key].get<int>() : 0;
}

void print_state(const Json& state) {
  fmt::print("{}", text_of(state, "phase"));
  if (const std::string session = text_of(state, "session"); !session.empty()) {
    fmt::print("  session {}  {} of {} shots committed", session, number_of(state, "committed"),
               number_of(state, "shots"));
  }
  if (state.contains("seconds_left") && state["seconds_left"].is_number() &&
      text_of(state, "phase") == "running") {
    fmt::print("  {:.0f} s left", state["seconds_left"].get<double>());
  }
  if (const std::string reason = text_of(state, "reason"); !reason.empty()) {
    fmt::print("  ({})", reason);
  }
  fmt::print("\n");
}

/// The state, or nothing while the daemon is away for less than half a minute.
class PatientClient {
 public:
  explicit PatientClient(DaemonClient& client) : client_(client) {}

  std::optional<Json> state() {
    try {
      Json json = parse(client_.get("/v1/state"));
      last_answer_ = Clock::now();
      return json;
    } catch (const Error& error) {
      if (error.code() != ExitCode::unavailable || Clock::now() - last_answer_ > kDaemonAway) {
        throw;
      }
      return std::nullopt;
    }
  }

 private:
  using Clock = std::chrono::steady_clock;
  DaemonClient& client_;
  Clock::time_point last_answer_ = Clock::now();
};

/// Waits until the session is done. @throws Error(interrupted)  it was aborted or taken over
Json follow(DaemonClient& client, const std::string& session, ProgressStyle style) {
  PatientClient patient(client);
  std::optional<Progress> progress;
  std::string told;
  for (;;) {
    const std::optional<Json> state = patient.state();
    if (state) {
      const std::string phase = text_of(*state, "phase");
      const bool is_ours = text_of(*state, "session") == session;
      const bool is_opening = state->value("is_opening", false);
      const int n_shots = number_of(*state, "shots");
      if (is_ours && n_shots > 0 && !progress) {
        progress.emplace("capture", static_cast<std::size_t>(n_shots), style);
      }
      if (is_ours && progress) {
        progress->set_done(static_cast<std::size_t>(number_of(*state, "committed")));
      }
      const std::string reason = text_of(*state, "reason");
      if (phase == "suspended" && reason != told && style != ProgressStyle::none) {
        fmt::print(stderr, "suspended, goes on by itself: {}\n", reason);
        told = reason;
      }
      if (is_ours && phase == "done") {
        return *state;
      }
      if (!is_opening &&
          (phase == "idle" || (!is_ours && phase != "boot" && phase != "recover"))) {
        throw Error(fmt::format("the capture ended early: {}", reason.empty() ? phase : reason),
                    "session " + session,
                    fmt::format("`haarlight capture --session {}` goes on with it", session),
                    ExitCode::interrupted);
      }
    }
    std::this_thread::sleep_for(kPoll);
  }
}

/// Moves a finished session to where it was asked for.
void move_session(const fs::path& from, const fs::path& to) {
  std::error_code error;
  if (to.has_parent_path()) {
    fs::create_directories(to.parent_path(), error);
  }
  fs::rename(from, to, error);
  if (!error) {
    return;
  }
  // Another file system: copy under a temporary name, so that the result appears whole.
  fs::path temporary = to;
  temporary += ".part";
  fs::remove_all(temporary, error);
  fs::copy(from, temporary, fs::copy_options::recursive, error);
  if (!error) {
    fs::rename(temporary, to, error);
  }
  if (error) {
    throw Error("cannot move the session: " + error.message(), to.string(),
                "it is complete in " + from.string(), ExitCode::io);
  }
  fs::remove_all(from, error);
}

ExitCode run_capture(const ClientArguments& arguments, const CommonOptions& common,
                     Report& report) {
  if (arguments.plan.empty() == arguments.session.empty()) {
    throw Error("give a plan, or --session to go on with one", "haarlight capture",
                "haarlight capture PLAN.toml", ExitCode::usage);
  }
  if (!arguments.output.empty()) {
    if (fs::exists(arguments.output)) {
      throw Error("there is something already", arguments.output,
                  "give a new folder; a session is never overwritten", ExitCode::usage);
    }
  }
  DaemonClient client(client_config(arguments));
  std::string query;
  std::string body;
  if (arguments.session.empty()) {
    report.add_input(arguments.plan);
    body = read_file(arguments.plan, 64U << 20U);
    query = "?name=" + DaemonClient::escape(arguments.plan);
  } else {
    query = "?session=" + DaemonClient::escape(arguments.session);
  }
  const Json begun = parse(client.post("/v1/run" + query, body));
  const std::string session = text_of(begun, "session");
  const Json state = follow(client, session, common.progress());
  fs::path folder = text_of(state, "folder");
  if (!arguments.output.empty()) {
    move_session(folder, arguments.output);
    folder = arguments.output;
  }
  report.add_reached("shots", std::int64_t{number_of(state, "committed")});
  report.add_reached("frames", std::int64_t{number_of(state, "frames")});
  report.add_reached("retries", std::int64_t{number_of(state, "retries")});
  report.add_detail("session", folder.string());
  fmt::print("{}\n", folder.string());
  return ExitCode::done;
}

/// A verb that posts to one path and prints the state.
void add_request(CLI::App& root, Invocation& invocation, const std::string& name,
                 const std::string& help) {
  auto arguments = std::make_shared<ClientArguments>();
  CLI::App* verb = root.add_subcommand(name, help);
  add_daemon_options(*verb, *arguments);
  verb->footer("Example:\n  haarlight " + name);
  add_common_options(*verb, invocation);
  verb->callback([arguments, name, &invocation] {
    invocation.command = name;
    invocation.run = [arguments, name](Report&) {
      DaemonClient client(client_config(*arguments));
      print_state(parse(client.post("/v1/" + name)));
      return ExitCode::done;
    };
  });
}

}  // namespace

void add_capture(CLI::App& root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  CLI::App* verb =
      root.add_subcommand("capture", "Have the daemon capture a plan; wait for it");
  verb->add_option("PLAN", arguments->plan, "Plan file, or a plan.json")
      ->type_name("PLAN.toml");
  verb->add_option("--session", arguments->session, "Go on with this session of the daemon's")
      ->type_name("ID");
  verb->add_option("-o", arguments->output, "Move the finished session here")
      ->type_name("SESSION");
  add_daemon_options(*verb, *arguments);
  verb->footer(
      "Prints the session's folder. Ending this command does not end the capture.\n"
      "Example:\n  haarlight capture configs/plans/one_at_a_time.toml -o vase");
  add_common_options(*verb, invocation);
  verb->callback([arguments, &invocation] {
    invocation.command = "capture";
    invocation.run = [arguments, &invocation](Report& report) {
      return run_capture(*arguments, invocation.common, report);
    };
  });
}

void add_status(CLI::App& root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  CLI::App* verb = root.add_subcommand("status", "Say what the daemon is doing");
  add_daemon_options(*verb, *arguments);
  verb->footer("Example:\n  haarlight status");
  add_common_options(*verb, invocation);
  verb->callback([arguments, &invocation] {
    invocation.command = "status";
    invocation.run = [arguments](Report& report) {
      DaemonClient client(client_config(*arguments));
      const Json state = parse(client.get("/v1/state"));
      print_state(state);
      report.add_detail("phase", text_of(state, "phase"));
      report.add_reached("committed", std::int64_t{number_of(state, "committed")});
      return ExitCode::done;
    };
  });
}

void add_pause(CLI::App& root, Invocation& invocation) {
  add_request(root, invocation, "pause", "Pause the capture, lights off");
}
void add_resume(CLI::App& root, Invocation& invocation) {
  add_request(root, invocation, "resume", "Go on after pause or all-off");
}
void add_abort(CLI::App& root, Invocation& invocation) {
  add_request(root, invocation, "abort", "End the capture; what is committed stays");
}
void add_all_off(CLI::App& root, Invocation& invocation) {
  add_request(root, invocation, "all-off", "All lights off at once, in every state");
}

void add_reshoot(CLI::App& root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  CLI::App* verb = root.add_subcommand("reshoot", "Take shots of the present session again");
  verb->add_option("SHOTS", arguments->shots, "Numbers of shots")
      ->required()
      ->type_name("N...");
  add_daemon_options(*verb, *arguments);
  verb->footer("Example:\n  haarlight reshoot 17 18 402");
  add_common_options(*verb, invocation);
  verb->callback([arguments, &invocation] {
    invocation.command = "reshoot";
    invocation.run = [arguments](Report&) {
      DaemonClient client(client_config(*arguments));
      print_state(parse(client.post("/v1/reshoot", Json{{"shots", arguments->shots}}.dump())));
      return ExitCode::done;
    };
  });
}

}  // namespace haarlight
