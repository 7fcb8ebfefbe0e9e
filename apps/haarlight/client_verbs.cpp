// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight capture|status|pause|resume|abort|all-off|reshoot`: the daemon's client.

#include <fmt/format.h>

#include "apps/haarlight/daemon_address.h"
#include "apps/haarlight/verb.h"
#include "capture/daemon/remote_capture.h"
#include "core/log.h"
#include "haarlight/capture/daemon/daemon_client.h"

namespace haarlight::apps {

namespace {

struct ClientArguments {
  DaemonAddress address;
  capture::RemoteCaptureOptions capture;
  std::vector<int> shots;
};

ExitCode run_capture(const ClientArguments& arguments, const CommonOptions& common,
                     Report& report) {
  capture::RemoteCaptureOptions options = arguments.capture;
  options.progress = common.progress();
  if (!common.quiet) {
    options.tell = [](const std::string& line) { fmt::print(stderr, "{}\n", line); };
  }
  capture::DaemonClient client(client_config(arguments.address));
  const capture::RemoteCaptureSummary summary = capture::capture_remotely(client, options);
  if (!summary.warning.empty()) {
    log_warning(summary.warning);
  }
  if (!options.plan.empty()) {
    report.add_input(options.plan);
  }
  report.add_achieved("shots", std::int64_t{summary.state.committed});
  report.add_achieved("frames", std::int64_t{summary.state.frames});
  report.add_achieved("retries", std::int64_t{summary.state.retries});
  report.add_detail("session", summary.folder);
  fmt::print("{}\n", summary.folder);
  tell_next(common, {"compress", summary.folder, "-o", "NAME.hlb"});
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
    capture::DaemonClient client(client_config(arguments->address));
    fmt::print("{}", capture::state_text(capture::request(client, name)));
    return ExitCode::done;
  });
}

}  // namespace

void add_capture(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ClientArguments>();
  Command verb = root.add_verb("capture", "Have the daemon capture a plan; wait for it");
  verb.option("PLAN", &arguments->capture.plan, "Plan file, or a plan.json",
              {.type = "PLAN.toml"});
  verb.option("--session", &arguments->capture.session,
              "Go on with this session of the daemon's", {.type = "ID"});
  verb.option("-o", &arguments->capture.output,
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
    capture::DaemonClient client(client_config(arguments->address));
    const capture::RemoteState state = capture::ask_state(client);
    fmt::print("{}", capture::state_text(state));
    report.add_detail("phase", state.phase);
    report.add_achieved("committed", std::int64_t{state.committed});
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
    capture::DaemonClient client(client_config(arguments->address));
    fmt::print("{}", capture::state_text(capture::reshoot(client, arguments->shots)));
    return ExitCode::done;
  });
}

}  // namespace haarlight::apps
