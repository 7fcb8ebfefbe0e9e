// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight capture|status|pause|resume|abort|all-off|reshoot`: the daemon's client.

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/haarlight/daemon_address.h"
#include "apps/haarlight/verb.h"
#include "capture/daemon/daemon_client.h"
#include "core/files.h"
#include "core/log.h"
#include "core/progress.h"
#include "core/text_limits.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{200};
constexpr milliseconds kDaemonStarts{5000};
constexpr milliseconds kDaemonAway{30000};  // a restarted daemon goes on by itself: wait for it

struct ClientArguments {
  DaemonAddress address;
  std::string plan;
  std::string session;
  std::string output;
  std::vector<int> shots;
};

std::string text_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_string() ? json[key].get<std::string>()
                                                     : std::string();
}
int number_of(const Json& json, const char* key) {
  return json.contains(key) && json[key].is_number() ? json[key].get<int>() : 0;
}

/// @throws Error  what the daemon's error says, or no JSON
Json parse_reply(const DaemonReply& reply) {
  DaemonClient::require_good(reply);
  Json json = parse_json<Json>(reply.body, "haarlightd");
  if (!json.is_object()) {
    refuse_answer();
  }
  return json;
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
  if (state.contains("unfinished") && state["unfinished"].is_array()) {
    for (const Json& id : state["unfinished"]) {
      if (id.is_string()) {
        fmt::print("unfinished: {0}  (`haarlight capture --session {0}` goes on with it)\n",
                   id.get<std::string>());
      }
    }
  }
}

/// The state, or nothing while the daemon is away for less than half a minute.
class PatientClient {
 public:
  explicit PatientClient(DaemonClient& client) : client_(client) {}

  std::optional<Json> state() {
    try {
      Json json = parse_reply(client_.get("/v1/state"));
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

/// Waits a little for a daemon that was started just before.
void await_daemon(DaemonClient& client, ProgressStyle style) {
  using Clock = std::chrono::steady_clock;
  const Clock::time_point end = Clock::now() + kDaemonStarts;
  for (bool is_told = false;;) {
    try {
      (void)client.get("/v1/state");
      return;
    } catch (const Error&) {
      if (Clock::now() > end) {
        throw;
      }
    }
    if (!is_told && style != ProgressStyle::none) {
      fmt::print(stderr, "waiting for the daemon\n");
      is_told = true;
    }
    std::this_thread::sleep_for(kPoll);
  }
}

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
      if (is_ours && !is_opening && phase == "done") {
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

/// The daemon goes on showing the session, and takes shots of it again, by a link in its place.
void leave_link(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::create_directory_symlink(fs::absolute(to).lexically_normal(), from, error);
  if (error) {
    log_warning(fmt::format("the daemon does not see the session any more: no link {}: {}",
                            from.string(), error.message()));
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
    leave_link(from, to);
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
  leave_link(from, to);
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
  DaemonClient client(client_config(arguments.address));
  std::string query;
  std::string body;
  if (arguments.session.empty()) {
    report.add_input(arguments.plan);
    body = read_file(arguments.plan, 64U << 20U);
    query = "?name=" + DaemonClient::escape(arguments.plan);
  } else {
    query = "?session=" + DaemonClient::escape(arguments.session);
  }
  await_daemon(client, common.progress());
  const Json begun = parse_reply(client.post("/v1/run" + query, body));
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
  tell_next(common, {"compress", folder.string(), "-o", "NAME.hlb"});
  return ExitCode::done;
}

/// A verb that posts to one path and prints the state.
void add_request(Command root, Invocation& invocation, const std::string& name,
                 const std::string& help) {
  auto arguments = std::make_shared<ClientArguments>();
  Command verb = root.add_verb(name, help);
  add_daemon_options(verb, arguments->address);
  verb.footer("Example:\n  haarlight " + name);
  finish_verb(verb, invocation, [arguments, name](const CommonOptions&, Report&) {
    DaemonClient client(client_config(arguments->address));
    print_state(parse_reply(client.post("/v1/" + name)));
    return ExitCode::done;
  });
}

}  // namespace

void add_capture(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  Command verb = root.add_verb("capture", "Have the daemon capture a plan; wait for it");
  verb.option("PLAN", &arguments->plan, "Plan file, or a plan.json", {.type = "PLAN.toml"});
  verb.option("--session", &arguments->session, "Go on with this session of the daemon's",
              {.type = "ID"});
  verb.option("-o", &arguments->output,
              "Move the finished session here; the daemon keeps a link", {.type = "SESSION"});
  add_daemon_options(verb, arguments->address);
  verb.footer(
      "Prints the session's folder. Ending this command does not end the capture.\n"
      "Example:\n  haarlight capture configs/plans/one_at_a_time.toml -o vase");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_capture(*arguments, common, report);
  });
}

void add_status(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  Command verb = root.add_verb("status", "Say what the daemon is doing");
  add_daemon_options(verb, arguments->address);
  verb.footer("Example:\n  haarlight status");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report& report) {
    DaemonClient client(client_config(arguments->address));
    const Json state = parse_reply(client.get("/v1/state"));
    print_state(state);
    report.add_detail("phase", text_of(state, "phase"));
    report.add_reached("committed", std::int64_t{number_of(state, "committed")});
    return ExitCode::done;
  });
}

void add_pause(Command root, Invocation& invocation) {
  add_request(root, invocation, "pause", "Pause the capture, lights off");
}
void add_resume(Command root, Invocation& invocation) {
  add_request(root, invocation, "resume", "Go on after pause or all-off");
}
void add_abort(Command root, Invocation& invocation) {
  add_request(root, invocation, "abort", "End the capture; what is committed stays");
}
void add_all_off(Command root, Invocation& invocation) {
  add_request(root, invocation, "all-off", "All lights off at once, in every state");
}

void add_reshoot(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  Command verb = root.add_verb("reshoot", "Take shots of the present session again");
  verb.option("SHOTS", &arguments->shots, "Numbers of shots",
              {.type = "N...", .is_required = true});
  add_daemon_options(verb, arguments->address);
  verb.footer("Example:\n  haarlight reshoot 17 18 402");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report&) {
    DaemonClient client(client_config(arguments->address));
    print_state(
        parse_reply(client.post("/v1/reshoot", Json{{"shots", arguments->shots}}.dump())));
    return ExitCode::done;
  });
}

}  // namespace haarlight
