// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/remote_capture.h"

#include <chrono>
#include <filesystem>
#include <optional>
#include <thread>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{200};
constexpr milliseconds kDaemonStarts{5000};
constexpr milliseconds kDaemonAway{30000};  // a restarted daemon resumes by itself: wait for it

/// The state, or nothing while the daemon has been away for less than half a minute.
class PatientClient {
 public:
  explicit PatientClient(DaemonClient& client) : client_(client) {}

  std::optional<RemoteState> state() {
    try {
      RemoteState found = ask_state(client_);
      last_answer_ = Clock::now();
      return found;
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

/// Waits briefly for a daemon that was only just started.
void await_daemon(DaemonClient& client, const RemoteCaptureOptions& options) {
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
    if (!is_told && options.tell) {
      options.tell("waiting for the daemon");
      is_told = true;
    }
    std::this_thread::sleep_for(kPoll);
  }
}

/// Waits until the session is done. @throws Error(interrupted)  it was aborted or taken over
RemoteState follow(DaemonClient& client, const std::string& session,
                   const RemoteCaptureOptions& options) {
  PatientClient patient(client);
  std::optional<Progress> progress;
  std::string told;
  for (;;) {
    const std::optional<RemoteState> state = patient.state();
    if (state) {
      const bool is_ours = state->session == session;
      if (is_ours && state->shots > 0 && !progress) {
        progress.emplace("capture", static_cast<std::size_t>(state->shots), options.progress);
      }
      if (is_ours && progress) {
        progress->set_done(static_cast<std::size_t>(state->committed));
      }
      const std::string& reason = state->reason;
      if (state->is_in(Phase::suspended) && reason != told && options.tell) {
        options.tell(fmt::format("suspended, goes on by itself: {}", reason));
        told = reason;
      }
      if (is_ours && !state->is_opening && state->is_in(Phase::done)) {
        return *state;
      }
      if (!state->is_opening &&
          (state->is_in(Phase::idle) ||
           (!is_ours && !state->is_in(Phase::boot) && !state->is_in(Phase::recover)))) {
        throw Error(
            fmt::format("the capture ended early: {}", reason.empty() ? state->phase : reason),
            "session " + session,
            fmt::format("`haarlight capture --session {}` goes on with it", session),
            ExitCode::interrupted);
      }
    }
    std::this_thread::sleep_for(kPoll);
  }
}

/// A link in its place lets the daemon keep showing the session and retaking its shots.
/// @return  a warning; empty: none
std::string leave_link(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::create_directory_symlink(fs::absolute(to).lexically_normal(), from, error);
  return error ? fmt::format("the daemon does not see the session any more: no link {}: {}",
                             from.string(), error.message())
               : std::string();
}

/// Moves a finished session to the requested location. @return  a warning; empty: none
std::string move_session(const fs::path& from, const fs::path& to) {
  std::error_code error;
  if (to.has_parent_path()) {
    fs::create_directories(to.parent_path(), error);
  }
  fs::rename(from, to, error);
  if (!error) {
    return leave_link(from, to);
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
  return leave_link(from, to);
}

void check_options(const RemoteCaptureOptions& options) {
  if (options.plan.empty() == options.session.empty()) {
    throw Error("give a plan, or --session to go on with one", "haarlight capture",
                "haarlight capture PLAN.toml", ExitCode::usage);
  }
  if (!options.output.empty() && fs::exists(options.output)) {
    throw Error("there is something already", options.output,
                "give a new folder; a session is never overwritten", ExitCode::usage);
  }
}

}  // namespace

RemoteCaptureSummary capture_remotely(DaemonClient& client,
                                      const RemoteCaptureOptions& options) {
  check_options(options);
  std::string query = "?session=" + DaemonClient::escape(options.session);
  std::string body;
  if (options.session.empty()) {
    body = read_file(options.plan, 64U << 20U);
    query = "?name=" + DaemonClient::escape(options.plan);
  }
  await_daemon(client, options);
  const RemoteState begun = read_state(client.post("/v1/run" + query, body));
  RemoteCaptureSummary summary;
  summary.state = follow(client, begun.session, options);
  summary.folder = summary.state.folder;
  if (!options.output.empty()) {
    summary.warning = move_session(summary.folder, options.output);
    summary.folder = options.output;
  }
  return summary;
}

}  // namespace haarlight::capture
