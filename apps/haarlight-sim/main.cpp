// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight-sim RIG.toml --scene SCENE.toml`: a virtual rig on real sockets, until SIGTERM.

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <optional>
#include <thread>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "apps/command_line.h"
#include "apps/program_version.h"
#include "core/counted.h"
#include "core/log.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/progress.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/scene/scene.h"
#include "sim/rig_commands.h"
#include "sim/transport.h"
#include "sim/transport_stack.h"
#include "sim/truth.h"
#include "sim/virtual_rig.h"

namespace {

using haarlight::ExitCode;

struct Arguments {
  std::string rig;
  std::string scene;
  std::string faults;
  std::string truth;
  std::string ready_file;
  std::string own_folder;
  std::string cache;
  std::string stack;
  std::string usb_redir;
  std::string commands;
  std::string v4l2_output;
  std::string record;
  std::uint64_t seed = 1;
  double lit_electrons = 0.0;
  double doubtful_us = haarlight::sim::VirtualRigOptions{}.doubtful_us;
  int n_subpixels = 2;
  std::uint64_t memory_bytes = haarlight::sim::TransportOptions{}.memory_bytes;
  int threads = 0;
  bool subpixels_at_edges = false;
  bool only_transport = false;
  int bounces = 0;
  int paths = haarlight::render::IndirectOptions{}.paths;
  bool only_controller = false;
  bool quiet = false;
};

void add_options(haarlight::apps::Command program, Arguments& arguments) {
  using haarlight::apps::Bounds;
  program.option("RIG", &arguments.rig,
                 "Rig file: lights, cameras, controller, their addresses",
                 {.type = "RIG.toml", .is_required = true});
  program.option("--scene", &arguments.scene, "What stands in the rig", {.type = "SCENE.toml"});
  program.option("--faults", &arguments.faults, "What goes wrong, and when",
                 {.type = "F.toml"});
  program.option("--truth", &arguments.truth,
                 "What the rig truly is, where that differs from the rig file",
                 {.type = "T.toml"});
  program.option("--seed", &arguments.seed, "Of noise and faults", {.shows_default = true});
  program.option("--lit-electrons", &arguments.lit_electrons,
                 "Electrons of a lit pixel of the plane; 0 = half the full well",
                 {.bounds = Bounds{}, .shows_default = true});
  program.option("--doubtful-us", &arguments.doubtful_us,
                 "Frames begun this soon after a change of light are lost, so that the "
                 "committed pixels do not depend on the host's speed; 0 = none",
                 {.bounds = Bounds{}, .shows_default = true});
  program.option("--subpixels", &arguments.n_subpixels, "N x N sub-pixel centres per pixel",
                 {.bounds = Bounds{1, 16}, .shows_default = true});
  program.flag("--subpixels-at-edges", &arguments.subpixels_at_edges,
               "One for a pixel that shows a single smooth surface: faster, and penumbrae are "
               "not averaged within it");
  program.option("--bounces", &arguments.bounces,
                 "Light between the scene's surfaces: paths of at most N bounces; 0: only what "
                 "arrives directly",
                 {.bounds = Bounds{0, 1000}, .shows_default = true});
  program.option("--paths", &arguments.paths,
                 "With --bounces: paths per pixel, for all lights together",
                 {.bounds = Bounds{2, 1 << 20}, .shows_default = true});
  program.option("--cache", &arguments.cache, "Folder of rendered transport matrices",
                 {.type = "DIR"});
  program.option("--ready-file", &arguments.ready_file,
                 "Written when the rig can be used: its addresses as JSON", {.type = "PATH"});
  program.option("--own-addresses", &arguments.own_folder,
                 "Any free port, and sockets in this folder, instead of the rig file's "
                 "addresses; --ready-file tells them",
                 {.type = "DIR"});
  program.option("--memory", &arguments.memory_bytes,
                 "For a transport matrix while it is rendered, for example 512M or 4G",
                 {.default_text = "1G", .is_bytes = true});
  program.option("--threads", &arguments.threads, "Threads of the rendering; 0 = all",
                 {.bounds = Bounds{0, 1024}});
  program.option(
      "--stack", &arguments.stack,
      "Also write the first camera's matrix, in units of its scale, as a light stack",
      {.type = "FILE"});
  program.option("--usb-redir", &arguments.usb_redir,
                 "Where a virtual machine finds a controller of kind \"usb\": a socket to be "
                 "made, or a virtio-serial port",
                 {.type = "SOCKET"});
  program.option("--commands", &arguments.commands,
                 "A pipe (mkfifo) to read commands from: unplug, replug, stall, delay ...",
                 {.type = "FIFO"});
  program.option("--v4l2-output", &arguments.v4l2_output,
                 "Write the first camera's frames into this V4L2 output node (vivid's, or "
                 "v4l2loopback's) instead of serving them on a socket",
                 {.type = "NODE"});
  program.option("--record", &arguments.record,
                 "With --v4l2-output: keep every frame written, and the truth about it",
                 {.type = "DIR"});
  program.flag("--only-controller", &arguments.only_controller,
               "Serve no camera; needs no scene");
  program.flag("--only-transport", &arguments.only_transport,
               "Render the transport matrix into the cache and end");
  program.flag("--quiet", &arguments.quiet, "No progress, no messages");
  program.footer(
      "Example:\n"
      "  haarlight-sim configs/rigs/small8.toml --scene configs/scenes/blocks.toml\n"
      "Ends cleanly on SIGTERM or SIGINT. How a lab tests its own scripts against it:\n"
      "docs/reference/simulator.md.");
}

std::vector<haarlight::sim::Transport> make_transports(const haarlight::Rig& rig,
                                                       const Arguments& arguments) {
  haarlight::render::SceneFile scene = haarlight::render::read_scene(arguments.scene);
  haarlight::render::require_for_direct_light(scene.scene, arguments.scene, "haarlight-sim");
  scene.scene =
      haarlight::render::with_instances_expanded(std::move(scene.scene), arguments.scene);
  haarlight::sim::TransportOptions options;
  options.n_subpixels = arguments.n_subpixels;
  options.subpixels_at_edges = arguments.subpixels_at_edges;
  options.indirect = {.bounces = arguments.bounces, .paths = arguments.paths};
  if (arguments.paths % 2 != 0) {
    throw haarlight::Error("an odd number of paths", "--paths",
                           "give an even one: its halves tell the error",
                           haarlight::ExitCode::usage);
  }
  options.cache_folder = arguments.cache;
  options.memory_bytes = arguments.memory_bytes;
  options.progress = haarlight::choose_progress_style(arguments.quiet);
  std::optional<haarlight::ThreadLimit> limit;
  if (arguments.threads > 0) {
    limit.emplace(arguments.threads);
  }
  std::vector<haarlight::sim::Transport> transports;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    transports.push_back(
        haarlight::sim::make_transport(rig, static_cast<int>(i), scene.scene, options));
    const haarlight::sim::Transport& transport = transports.back();
    if (!arguments.quiet) {
      fmt::print(stderr,
                 "transport of camera {}: {} x {} pixels, {}; {:.1f} million rays in "
                 "{:.1f} s, {:.1f} Mrays/s when it was made\n",
                 rig.cameras[i].id, transport.width(), transport.height(),
                 haarlight::counted(transport.n_lights(), "light"),
                 static_cast<double>(transport.n_rays()) / 1e6, transport.seconds(),
                 static_cast<double>(transport.n_rays()) / 1e6 / transport.seconds());
    }
  }
  return transports;
}

std::string json_text(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      quoted += '\\';
    }
    quoted += c;
  }
  return quoted + '"';
}

void announce(const haarlight::Rig& rig, const Arguments& arguments) {
  std::string cameras;
  for (const haarlight::CameraSpec& camera : rig.cameras) {
    if (arguments.only_controller) {
      break;
    }
    fmt::print("camera {} {}\n", camera.id, camera.device);
    cameras += fmt::format("{}{{\"id\": {}, \"device\": {}}}", cameras.empty() ? "" : ", ",
                           json_text(camera.id), json_text(camera.device));
  }
  fmt::print("controller {}\nready\n", rig.controller.address);
  std::fflush(stdout);
  if (!arguments.ready_file.empty()) {
    haarlight::write_file_atomically(
        arguments.ready_file,
        std::string_view(fmt::format("{{\"controller\": {}, \"cameras\": [{}]}}\n",
                                     json_text(rig.controller.address), cameras)));
  }
}

/// Obeys the lines of a pipe until stopped; says on standard output what was done.
std::jthread follow_commands(haarlight::sim::VirtualRig& rig, const std::string& path) {
  // Open for writing too, so that the pipe does not end with each `echo`.
  haarlight::Fd pipe(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!pipe.is_open()) {
    throw haarlight::Error("the pipe of commands cannot be opened", path,
                           "make it: mkfifo " + path, ExitCode::unavailable);
  }
  return std::jthread([&rig, fd = std::move(pipe)](const std::stop_token& stop) {
    constexpr int kSliceMs = 50;
    std::string text;
    while (!stop.stop_requested()) {
      pollfd wait{.fd = fd.get(), .events = POLLIN, .revents = 0};
      std::array<char, 256> chunk{};
      const ssize_t n =
          ::poll(&wait, 1, kSliceMs) > 0 ? ::read(fd.get(), chunk.data(), chunk.size()) : 0;
      text.append(chunk.data(), n > 0 ? static_cast<std::size_t>(n) : 0);
      for (std::size_t end = text.find('\n'); end != std::string::npos; end = text.find('\n')) {
        const std::string line = text.substr(0, end);
        text.erase(0, end + 1);
        try {
          haarlight::sim::obey_rig_command(rig, line);
          fmt::print("did {}\n", line);
        } catch (const haarlight::Error& error) {
          fmt::print("refused {}: {}\n", line, error.problem());
        }
        std::fflush(stdout);
      }
    }
  });
}

int g_end = -1;  // eventfd: SIGTERM or SIGINT came

/// From here on SIGTERM and SIGINT are waited for instead of killing. Blocked and waited for by
/// sigwait they would kill all the same where a library's own thread does not block them: the
/// ray caster's live on for a while.
class EndSignals {
 public:
  EndSignals() {
    g_end = eventfd(0, EFD_CLOEXEC);
    struct sigaction action = {};
    action.sa_handler = [](int) {
      const std::uint64_t one = 1;
      [[maybe_unused]] const ssize_t n = write(g_end, &one, sizeof one);
    };
    action.sa_flags = SA_RESTART;
    sigemptyset(&action.sa_mask);
    sigemptyset(&ends_);
    for (const int signal : {SIGINT, SIGTERM}) {
      sigaddset(&ends_, signal);
      sigaction(signal, &action, nullptr);
    }
    pthread_sigmask(SIG_BLOCK, &ends_, nullptr);  // in this thread and those it starts
  }
  void wait() const {
    pthread_sigmask(SIG_UNBLOCK, &ends_, nullptr);
    std::uint64_t n = 0;
    while (read(g_end, &n, sizeof n) < 0 && errno == EINTR) {
    }
  }

 private:
  sigset_t ends_{};
};

int run(const Arguments& arguments) {
  if (arguments.quiet) {
    haarlight::set_log_level(haarlight::LogLevel::error);
  }
  const haarlight::Rig rig = haarlight::read_rig_as_written(arguments.rig);
  haarlight::sim::VirtualRigOptions options;
  options.seed = arguments.seed;
  options.lit_electrons = arguments.lit_electrons;
  options.doubtful_us = arguments.doubtful_us;
  if (!arguments.faults.empty()) {
    options.faults = haarlight::sim::read_fault_script(arguments.faults);
  }
  if (!arguments.truth.empty()) {
    options.truth = haarlight::sim::read_truth(arguments.truth, rig);
  }
  options.usb_redir = arguments.usb_redir;
  options.has_cameras = !arguments.only_controller;
  options.own_folder = arguments.own_folder;
  options.v4l2_output = arguments.v4l2_output;
  options.record = arguments.record;
  if (arguments.scene.empty() && options.has_cameras) {
    throw haarlight::Error("no scene", arguments.rig,
                           "give --scene SCENE.toml, or --only-controller", ExitCode::usage);
  }
  const std::vector<haarlight::sim::Transport> transports =
      options.has_cameras ? make_transports(rig, arguments)
                          : std::vector<haarlight::sim::Transport>();
  if (!arguments.stack.empty()) {
    haarlight::sim::write_light_stack(transports.front(), arguments.stack);
  }
  if (arguments.only_transport) {
    return static_cast<int>(ExitCode::done);
  }
  const EndSignals ends;
  haarlight::sim::VirtualRig virtual_rig(rig, transports, options);
  std::jthread commands;
  if (!arguments.commands.empty()) {
    commands = follow_commands(virtual_rig, arguments.commands);
  }
  announce(virtual_rig.rig(), arguments);
  ends.wait();
  if (!arguments.quiet) {
    std::size_t first_served = 0;
    if (const haarlight::sim::V4l2Output* output = virtual_rig.v4l2_output()) {
      const haarlight::sim::V4l2OutputCounts counts = output->counts();
      fmt::print(stderr, "camera {}: {} written ({} of them mixed)\n", rig.cameras[0].id,
                 haarlight::counted(counts.n_written, "frame"), counts.n_mixed);
      first_served = 1;
    }
    for (std::size_t i = first_served; options.has_cameras && i < rig.cameras.size(); ++i) {
      const haarlight::sim::CameraServerCounts counts =
          virtual_rig.camera(static_cast<int>(i)).counts();
      fmt::print(stderr,
                 "camera {}: {} delivered ({} of them mixed), lost: {} no buffer, {} "
                 "overrun, {} doubtful; {} by script\n",
                 rig.cameras[i].id, haarlight::counted(counts.n_delivered, "frame"),
                 counts.n_mixed, counts.n_no_buffer, counts.n_overrun, counts.n_doubtful,
                 haarlight::counted(counts.n_faults, "fault"));
    }
  }
  return static_cast<int>(ExitCode::done);
}

}  // namespace

int main(int argc, char** argv) try {
  haarlight::apps::CommandLine line("haarlight-sim",
                                    "haarlight-sim: a virtual rig on real sockets",
                                    haarlight::apps::program_version());
  Arguments arguments;
  add_options(line.root(), arguments);
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  return run(arguments);
} catch (const haarlight::Error& error) {
  fmt::print(stderr, "haarlight-sim: {}\n", error.what());
  return static_cast<int>(error.code());
} catch (const std::exception& error) {
  std::fputs("haarlight-sim: ", stderr);
  std::fputs(error.what(), stderr);
  std::fputs("\n  hint: this is our own bug, please report it\n", stderr);
  return static_cast<int>(ExitCode::internal);
}
