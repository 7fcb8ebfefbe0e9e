// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlightd RIG.toml`: the capture daemon's process. Reads and checks the configuration,
/// opens devices, tells the service manager, and watches its own threads.

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>

#include <fmt/format.h>
#include <poll.h>
#include <sys/signalfd.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include "apps/command_line.h"
#include "apps/page_folder.h"
#include "apps/program_version.h"
#include "apps/token_file.h"
#include "capture/daemon/daemon.h"
#include "core/log.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/firmware_iface/light_array.h"
#include "session/storage.h"

namespace {

using haarlight::Error;
using haarlight::ExitCode;
using haarlight::Rig;
using haarlight::capture::Daemon;
using haarlight::capture::DaemonConfig;

struct Options {
  std::string rig;
  std::string sessions;
  std::string web;
  int port = -1;
  bool is_check_only = false;
  bool stays_idle = false;
  bool is_all_off = false;
};

/// Blocks the ending signals in every thread; they are read from a descriptor.
haarlight::Fd open_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  return haarlight::Fd(::signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK));
}

DaemonConfig configure(const Options& options, Rig rig, haarlight::session::Storage& storage) {
  namespace fs = std::filesystem;
  DaemonConfig config;
  const fs::path beside = fs::absolute(rig.file).parent_path();
  config.sessions =
      options.sessions.empty() ? beside / rig.storage.folder : fs::absolute(options.sessions);
  if (!rig.http.token_file.empty()) {
    config.token = haarlight::apps::read_token(beside / rig.http.token_file);
  }
  if (options.port >= 0) {
    rig.http.port = options.port;
  }
  config.make_light = [spec = rig.controller, n = rig.n_lights()] {
    return haarlight::firmware_iface::make_light_array(spec, n);
  };
  config.make_camera = [spec = rig.cameras.front()] {
    return haarlight::capture::make_camera(spec);
  };
  config.storage = &storage;
  config.web_folder =
      options.web.empty() ? haarlight::apps::find_page_folder() : fs::path(options.web);
  config.resumes = !options.stays_idle;
  config.rig = std::move(rig);
  return config;
}

/// Waits for a signal; feeds the service manager as long as every thread makes progress.
ExitCode watch(const Daemon& daemon, const haarlight::Fd& signals) {
  constexpr int kSliceMs = 200;
  for (;;) {
    pollfd wait{.fd = signals.get(), .events = POLLIN, .revents = 0};
    if (::poll(&wait, 1, kSliceMs) > 0) {
      haarlight::log_info("requested to end: all lights off");
      sd_notify(0, "STOPPING=1");
      return ExitCode::done;
    }
    const std::string hanging = daemon.hanging_thread();
    if (!hanging.empty()) {
      haarlight::log_error("the " + hanging + " thread hangs in a call: giving up");
      // A second thread tries; this one leaves in time even if that hangs as well.
      std::thread([&daemon] { daemon.put_lights_out(); }).detach();
      ::usleep(1'500'000);
      ::_exit(static_cast<int>(ExitCode::internal));
    }
    sd_notify(0, "WATCHDOG=1");
  }
}

/// The service manager's stop action, and the operator's: lights off without a daemon.
ExitCode put_all_off(const Rig& rig) {
  auto lights = haarlight::firmware_iface::make_light_array(rig.controller, rig.n_lights());
  const auto connected =
      lights ? (*lights)->connect() : tl::unexpected<haarlight::Fault>(lights.error());
  const auto off =
      connected ? (*lights)->all_off() : tl::unexpected<haarlight::Fault>(connected.error());
  if (!off && !haarlight::firmware_iface::all_off_beside(rig.controller)) {
    throw Error("the lights were not turned off: " + off.error().what, rig.controller.address,
                "the controller's lease does it, or cut its power", ExitCode::unavailable);
  }
  fmt::print("all lights off\n");
  return ExitCode::done;
}

ExitCode run(const Options& options) {
  if (options.is_all_off) {
    return put_all_off(haarlight::read_rig_as_written(options.rig));  // stale values or not
  }
  const Rig rig = haarlight::read_rig(options.rig);
  haarlight::session::DiskStorage storage;
  DaemonConfig config = configure(options, rig, storage);
  if (options.is_check_only) {
    haarlight::capture::require_drivers(config);
    fmt::print("{}: good. Sessions go to {}, HTTP on {}:{}\n", options.rig,
               config.sessions.string(), config.rig.http.address, config.rig.http.port);
    return ExitCode::done;
  }
  const haarlight::Fd signals = open_signals();
  const std::string address = config.rig.http.address;
  const Daemon daemon(std::move(config));
  fmt::print("haarlightd {} on http://{}:{}\n", haarlight::kVersion,
             address.find(':') == std::string::npos ? address : "[" + address + "]",
             daemon.http_port());
  std::fflush(stdout);
  sd_notify(0, "READY=1");
  return watch(daemon, signals);
}

int run_command_line(int argc, char** argv) {
  haarlight::apps::CommandLine line("haarlightd",
                                    "haarlightd: captures an object under every light of a rig",
                                    haarlight::apps::program_version());
  haarlight::apps::Command program = line.root();
  Options options;
  program.option("RIG", &options.rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  program.option("--sessions", &options.sessions,
                 "Folder of sessions (default: the rig file's)", {.type = "DIR"});
  program.option("--web", &options.web,
                 "Folder of the daemon's page (default: the one installed with the program)",
                 {.type = "DIR"});
  program.option("--port", &options.port,
                 "HTTP port (default: the rig file's; 0: any free one)",
                 {.bounds = haarlight::apps::Bounds{0, 65535}});
  program.flag("--check-config", &options.is_check_only,
               "Read and check everything, touch no hardware, exit");
  program.flag("--all-off", &options.is_all_off,
               "Turn all lights off and exit: what the service manager does after a stop");
  program.flag("--stay-idle", &options.stays_idle, "Do not go on with an unfinished session");
  program.footer(
      "Exit codes: 0 ended by request, 2 usage, 65 bad configuration, 69 device or address "
      "not there,\n70 our own bug or a hanging device, 74 input/output.\n\n"
      "Example:\n  haarlightd configs/rigs/cube32.toml --sessions sessions");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  return static_cast<int>(run(options));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run_command_line(argc, argv);
  } catch (const Error& error) {
    (void)std::fprintf(stderr, "haarlightd: %s\n", error.what());
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    (void)std::fprintf(stderr,
                       "haarlightd: %s\n  hint: this is our own bug, please report it\n",
                       error.what());
    return static_cast<int>(ExitCode::internal);
  }
}
