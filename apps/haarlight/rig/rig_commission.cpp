// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/rig/rig_commission.h"

#include <csignal>
#include <cstdio>
#include <iostream>
#include <optional>

#include <fmt/format.h>
#include <unistd.h>

#include "core/log.h"
#include "haarlight/capture/daemon/daemon_client.h"

namespace haarlight::apps {

namespace {

/// Flashing is begun by an operator who was told.
void require_consent(const CommissionArguments& arguments, const std::string& rig) {
  if (arguments.flash_ok) {
    return;
  }
  const std::string warning =
      "The lights will FLASH, several times per second, for minutes. Flashing light can cause\n"
      "epileptic seizures: nobody who might be at risk may see the rig, and nobody should "
      "look\n"
      "into it. Ctrl-C ends it at once, lights off.\n";
  if (::isatty(STDIN_FILENO) == 0) {
    throw Error("the lights will flash; nobody has agreed to it", rig,
                "clear the room of people at risk from flashing light, then give --flash-ok",
                ExitCode::usage);
  }
  fmt::print(stderr, "{}Type yes to begin: ", warning);
  std::fflush(stderr);
  std::string answer;
  std::getline(std::cin, answer);
  if (answer != "yes") {
    throw Error("not begun", rig, "type yes when the room is clear", ExitCode::usage);
  }
}

volatile std::sig_atomic_t g_is_requested_to_end = 0;

/// SIGINT, SIGTERM and SIGHUP are polled between frames instead of killing. This thread and
/// those it starts block them, so that no call of a driver is interrupted; a thread that a
/// library started when it was loaded (OpenBLAS does) does not, and runs the handler.
class PoliteSignals {
 public:
  PoliteSignals() {
    sigemptyset(&ends_);
    struct sigaction action = {};
    action.sa_handler = [](int) { g_is_requested_to_end = 1; };
    action.sa_flags = SA_RESTART;
    sigemptyset(&action.sa_mask);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
      sigaddset(&ends_, signal);
      sigaction(signal, &action, nullptr);
    }
    pthread_sigmask(SIG_BLOCK, &ends_, nullptr);
  }
  [[nodiscard]] bool is_requested_to_end() const {
    const timespec none{0, 0};
    return g_is_requested_to_end != 0 || sigtimedwait(&ends_, nullptr, &none) > 0;
  }

 private:
  sigset_t ends_{};
};

class CommissionProgress {
 public:
  explicit CommissionProgress(bool is_quiet) : is_quiet_(is_quiet) {}
  void operator()(std::string_view stage, double fraction) {
    const int percent = static_cast<int>(100.0 * fraction);
    if (is_quiet_ || (stage == stage_ && percent < percent_ + 10 && percent < 100)) {
      return;
    }
    if (stage != stage_ || percent != percent_) {
      fmt::print(stderr, "{:<8} {:3} %\n", stage, percent);
    }
    stage_ = stage;
    percent_ = percent;
  }

 private:
  bool is_quiet_;
  std::string stage_;
  int percent_ = 0;
};

}  // namespace

void add_commission_options(Command verb, CommissionArguments& arguments) {
  verb.flag("--flash-ok", &arguments.flash_ok,
            "commission: begin without asking; the room is clear of people at risk from "
            "flashing light");
  verb.flag("--timing-only", &arguments.options.measures_timing_only,
            "commission: neither the camera's noise nor each light");
  verb.option("--steps", &arguments.options.steps,
              "commission: switches of the light at each of two exposures",
              {.bounds = Bounds{20, 2000}, .shows_default = true});
}

ExitCode run_commission(const CommissionArguments& arguments, const CommonOptions& common,
                        Report& report) {
  capture::CommissionRigOptions options = arguments.options;
  std::optional<PoliteSignals> signals;  // the user may still kill the question
  options.may_overwrite = common.force;
  options.fetch = capture::fetch_local;
  options.require_consent = [&] { require_consent(arguments, options.rig); };
  options.begin = [&signals] { signals.emplace(); };
  options.should_stop = [&signals] { return signals->is_requested_to_end(); };
  options.progress = CommissionProgress(common.quiet);
  const capture::CommissionRigSummary summary = capture::commission_rig(options);
  capture::add_to_report(summary, report);
  if (!summary.warning.empty()) {
    log_warning(summary.warning);
  }
  fmt::print("{}", capture::commission_text(summary));
  fmt::print(stderr, "{}", capture::commission_faults(options, summary));
  return summary.is_good() ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace haarlight::apps
