// SPDX-License-Identifier: Apache-2.0
/// @file
/// How many lights per second the daemon captures from a virtual rig, beside the camera's own
/// rate and the store's own limit. The rig runs in a process of its own, so that the daemon's
/// fraction of the machine is told apart from the twin's.

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "apps/command_line.h"
#include "capture/daemon/daemon.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/storage.h"
#include "sim/virtual_rig.h"

namespace haarlight {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

struct Settings {
  std::string rig_file;
  std::string sync = "camera-leads";
  std::string shutter = "global";
  std::string sensor = "off";
  std::string store = "/dev/shm";
  double fps = 0.0;
  double exposure_us = 0.0;
  double skew_us = 0.0;
  double read_us = -1.0;
  double slow_ms = 0.0;
  int n_lights = 1024;
  int n_buffers = 32;
  std::string viewer = "off";
  std::string report;
};

double seconds_of(const timeval& t) {
  return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
}

/// CPU seconds of this process, user and system.
double cpu_seconds(int who) {
  rusage usage{};
  ::getrusage(who, &usage);
  return seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime);
}

/// A disk that takes its time, for every frame.
class SlowStorage final : public session::DiskStorage {
 public:
  explicit SlowStorage(double ms) : pause_(ms) {}
  Result<void> sync_file(const fs::path& path) override {
    std::this_thread::sleep_for(pause_);
    return session::DiskStorage::sync_file(path);
  }

 private:
  std::chrono::duration<double, std::milli> pause_;
};

/// MB/s that the store takes with one file per frame: written, synced, renamed, folder synced.
double store_limit(const fs::path& folder, std::size_t frame_bytes) {
  session::DiskStorage disk;
  fs::create_directories(folder);
  const std::vector<std::byte> frame(frame_bytes, std::byte{0x5a});
  constexpr int kFiles = 60;
  const auto begin = Clock::now();
  for (int i = 0; i < kFiles; ++i) {
    const fs::path file = folder / fmt::format("{}.new", i);
    const bool is_good = disk.write(file, frame) && disk.sync_file(file) &&
                         disk.rename(file, folder / fmt::format("{}.bin", i)) &&
                         disk.sync_folder(folder);
    if (!is_good) {
      throw Error("the store does not take a file", folder.string(), "give another --store",
                  ExitCode::io);
    }
  }
  const std::chrono::duration<double> length = Clock::now() - begin;
  fs::remove_all(folder);
  return 1e-6 * kFiles * static_cast<double>(frame_bytes) / length.count();
}

/// A transport of `n` lights that each show their own grey; of one light where the sensor model
/// is off.
sim::Transport make_transport(const fs::path& folder, const CameraSpec& camera, int n) {
  sim::TransportData data;
  data.width = camera.frame_width;
  data.height = camera.active_rows;
  data.n_lights = n;
  data.key = std::string(32, 'b');
  data.seconds = 1.0;
  std::vector<float> planes;
  const auto pixels =
      static_cast<std::size_t>(data.width) * static_cast<std::size_t>(data.height);
  for (int k = 0; k < n; ++k) {
    planes.insert(planes.end(), pixels, 0.3F + 0.02F * static_cast<float>(k % 16));
  }
  data.planes = planes;
  sim::write_transport(folder / "transport.bin", data);
  return sim::Transport::open(folder / "transport.bin");
}

/// What the rig's process tells at its end.
struct RigReport {
  sim::CameraServerCounts counts;
  double cpu_s = 0.0;
};

/// Serves the rig until its input closes; tells the controller's address first, its counts
/// last.
[[noreturn]] void serve_rig(const Rig& rig, const Settings& settings, const fs::path& folder,
                            int in, int out) {
  try {
    std::vector<sim::Transport> transports;
    const bool has_sensor = settings.sensor == "on";
    transports.push_back(
        make_transport(folder, rig.cameras.front(), has_sensor ? rig.n_lights() : 1));
    RigReport report;
    {
      sim::VirtualRig served(
          rig, transports,
          {.n_buffers = settings.n_buffers, .is_prepared = !has_sensor, .own_folder = folder});
      std::array<char, 64> address{};
      const std::string text = served.rig().controller.address;
      std::copy_n(text.begin(), std::min(text.size(), address.size() - 1), address.begin());
      const double cpu_before = cpu_seconds(RUSAGE_SELF);
      bool is_good = ::write(out, address.data(), address.size()) == ssize_t{address.size()};
      char byte = 0;
      is_good = is_good && ::read(in, &byte, 1) >= 0;
      report.counts = served.camera(0).counts();
      report.cpu_s = cpu_seconds(RUSAGE_SELF) - cpu_before;
      if (!is_good || ::write(out, &report, sizeof report) != ssize_t{sizeof report}) {
        ::_exit(1);
      }
    }
    ::_exit(0);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "the rig: %s\n", error.what());
    ::_exit(1);
  }
}

/// What the page's live view does, from a process of its own: the newest picture and its facts,
/// as often as there is a new one. @return  the process
pid_t start_viewer(int port) {
  const pid_t viewer = ::fork();
  if (viewer != 0) {
    return viewer;
  }
  const std::string url = fmt::format("http://127.0.0.1:{}/v1/preview", port);
  const std::string loop = fmt::format(
      "while :; do curl -s -o /dev/null {0}.png; curl -s -o /dev/null {0}/facts; sleep 0.2; "
      "done",
      url);
  ::execl("/bin/sh", "sh", "-c", loop.c_str(), nullptr);
  ::_exit(127);
}

struct Outcome {
  double seconds = 0.0;  ///< from the first to the last committed frame's exposure
  double whole_s = 0.0;  ///< from the request to the finished session
  double cpu_s = 0.0;    ///< of the daemon, over the whole
  int n_frames = 0;
  std::uint64_t bytes = 0;
  std::string problem;
  capture::SequencerCounters counters;
};

Outcome capture(const Rig& rig, const Settings& settings, const fs::path& sessions) {
  Outcome outcome;
  std::unique_ptr<session::Storage> storage = std::make_unique<session::DiskStorage>();
  if (settings.slow_ms > 0.0) {
    storage = std::make_unique<SlowStorage>(settings.slow_ms);
  }
  capture::Daemon daemon(
      {.rig = rig,
       .sessions = sessions,
       .make_light =
           [&] { return firmware_iface::make_light_array(rig.controller, rig.n_lights()); },
       .make_camera = [&] { return capture::make_camera(rig.cameras.front()); },
       .storage = storage.get(),
       .has_http = settings.viewer == "on"});
  std::string plan = "schema = 1\nname = \"rate\"\npatterns = \"one_at_a_time\"\n";
  if (const int repeats = settings.n_lights / rig.n_lights(); repeats > 1) {
    plan += fmt::format("repeats = {}\n", repeats);
  } else if (settings.n_lights < rig.n_lights()) {
    plan += "lights = [";
    for (int k = 0; k < settings.n_lights; ++k) {
      plan += fmt::format("{}{}", k == 0 ? "" : ", ", k);
    }
    plan += "]\n";
  }
  while (daemon.state().phase != capture::Phase::idle) {
    std::this_thread::sleep_for(1ms);
  }
  const auto begin = Clock::now();
  const double cpu_before = cpu_seconds(RUSAGE_SELF);
  const capture::RunReceipt receipt = daemon.run(plan, "rate.toml");
  const pid_t viewer = settings.viewer == "on" ? start_viewer(daemon.http_port()) : 0;
  const auto stop_viewer = [viewer] {
    if (viewer > 0) {
      ::kill(viewer, SIGKILL);
      ::waitpid(viewer, nullptr, 0);
    }
  };
  const auto limit = begin + 600s;
  for (;;) {
    const capture::DaemonState state = daemon.state();
    if (state.phase == capture::Phase::done && state.session == receipt.session) {
      break;
    }
    const bool is_refused = !state.is_opening && state.phase == capture::Phase::idle &&
                            state.session == receipt.session;
    if (is_refused || Clock::now() > limit) {
      stop_viewer();
      outcome.problem = fmt::format("{}: {}", to_string(state.phase), state.reason_text);
      return outcome;
    }
    std::this_thread::sleep_for(20ms);
  }
  outcome.whole_s = std::chrono::duration<double>(Clock::now() - begin).count();
  outcome.cpu_s = cpu_seconds(RUSAGE_SELF) - cpu_before;
  stop_viewer();
  outcome.counters = daemon.state().counters;
  const session::Session session = session::Session::open(receipt.folder);
  std::int64_t first = capture::kNever;
  std::int64_t last = 0;
  for (const session::FrameRecord& frame : session.info().frames) {
    first = std::min(first, frame.evidence.t_exposure_start_ns);
    last = std::max(last, frame.evidence.t_exposure_start_ns);
    outcome.bytes += fs::file_size(receipt.folder / frame.file);
    ++outcome.n_frames;
  }
  outcome.seconds = 1e-9 * static_cast<double>(last - first);
  fs::remove_all(receipt.folder);
  return outcome;
}

Rig bench_rig(const Settings& settings) {
  Rig rig = read_rig(settings.rig_file);
  CameraSpec& camera = rig.cameras.front();
  if (settings.fps > 0.0) {
    camera.fps = settings.fps;
  }
  if (settings.exposure_us > 0.0) {
    camera.exposure_us = settings.exposure_us;
  }
  if (settings.read_us >= 0.0) {
    camera.read_us = settings.read_us;
  }
  camera.shutter = settings.shutter == "rolling" ? Shutter::rolling : Shutter::global;
  camera.skew_us = camera.shutter == Shutter::rolling ? settings.skew_us : 0.0;
  rig.sync = settings.sync == "free-run"      ? SyncMode::free_run
             : settings.sync == "light-leads" ? SyncMode::light_leads
                                              : SyncMode::camera_leads;
  rig.http.port = 0;
  rig.storage.reserve_mb = 0.0;
  if (settings.sensor == "on") {  // 16 pictures of 4.9 MB instead of 1024
    rig.faces.front().rows = 4;
    rig.faces.front().cols = 4;
  }
  return rig;
}

int run(const Settings& settings) {
  Rig rig = bench_rig(settings);
  const CameraSpec& camera = rig.cameras.front();
  const std::size_t frame_bytes = 2U * static_cast<std::size_t>(camera.frame_width) *
                                  static_cast<std::size_t>(camera.frame_height);
  const fs::path folder =
      fs::path(settings.store) / fmt::format("haarlight-rate-{}", ::getpid());
  fs::create_directories(folder);
  std::array<int, 2> to_rig{};
  std::array<int, 2> from_rig{};
  if (::pipe(to_rig.data()) != 0 || ::pipe(from_rig.data()) != 0) {
    throw Error("pipe failed", "capture_rate", "close some files");
  }
  const pid_t child = ::fork();
  if (child == 0) {
    ::close(to_rig[1]);
    ::close(from_rig[0]);
    serve_rig(rig, settings, folder, to_rig[0], from_rig[1]);
  }
  ::close(to_rig[0]);
  ::close(from_rig[1]);
  std::array<char, 64> address{};
  if (::read(from_rig[0], address.data(), address.size()) != ssize_t{address.size()}) {
    throw Error("the rig's process did not start", "capture_rate", "see its message");
  }
  rig.controller.address = address.data();
  rig.cameras.front().device = (folder / (camera.id + ".sock")).string();

  const double limit_before = store_limit(folder / "limit", frame_bytes);
  std::string refusal;
  Outcome outcome;
  try {
    outcome = capture(rig, settings, folder / "sessions");
  } catch (const Error& error) {
    refusal = error.what();
  }
  const double limit_after = store_limit(folder / "limit", frame_bytes);
  RigReport twin;
  ::close(to_rig[1]);
  const bool has_report = ::read(from_rig[0], &twin, sizeof twin) == ssize_t{sizeof twin};
  int status = 0;
  ::waitpid(child, &status, 0);
  fs::remove_all(folder);
  if (!refusal.empty() || !outcome.problem.empty() || !has_report) {
    fmt::print("refused or failed: {}{}\n", refusal, outcome.problem);
    return 1;
  }
  const double rate = (outcome.n_frames - 1) / outcome.seconds;
  const double mb_s = 1e-6 * static_cast<double>(outcome.bytes) / outcome.n_frames * rate;
  nlohmann::ordered_json json = {{"rig", rig.name},
                                 {"sync", settings.sync},
                                 {"shutter", settings.shutter},
                                 {"sensor_model", settings.sensor},
                                 {"store", settings.store},
                                 {"viewer", settings.viewer},
                                 {"lights", outcome.n_frames},
                                 {"camera_fps", camera.fps},
                                 {"lights_a_second", rate},
                                 {"share_of_camera", rate / camera.fps},
                                 {"frame_times_a_light", camera.fps / rate},
                                 {"megabytes_a_second", mb_s},
                                 {"store_limit_mb_s", {limit_before, limit_after}},
                                 {"whole_s", outcome.whole_s},
                                 {"daemon_cpu_share", outcome.cpu_s / outcome.whole_s},
                                 {"twin_cpu_share", twin.cpu_s / outcome.whole_s},
                                 {"buffers", settings.n_buffers},
                                 {"lost_for_want_of_a_buffer", twin.counts.n_no_buffer},
                                 {"lost_by_a_slow_twin", twin.counts.n_overrun},
                                 {"sequence_gaps", outcome.counters.sequence_gaps},
                                 {"retries", outcome.counters.retries},
                                 {"strobe_unproven", outcome.counters.strobe_unproven},
                                 {"blocks", outcome.counters.blocks},
                                 {"blocks_cut", outcome.counters.blocks_cut},
                                 {"suspensions", outcome.counters.suspensions}};
  fmt::print("{}\n", json.dump(2));
  if (!settings.report.empty()) {
    write_file_atomically(settings.report, json.dump(2) + "\n");
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  haarlight::Settings s;
  haarlight::apps::CommandLine line(
      "capture_rate", "Lights per second, beside camera and store", HAARLIGHT_VERSION);
  auto root = line.root();
  root.option("RIG", &s.rig_file, "Rig file", {.type = "RIG.toml", .is_required = true});
  root.option("--sync", &s.sync, "Sync mode",
              {.choices = {"camera-leads", "free-run", "light-leads"}});
  root.option("--shutter", &s.shutter, "Shutter", {.choices = {"global", "rolling"}});
  root.option("--skew", &s.skew_us, "Rolling shutter: last row after the first, us");
  root.option("--read", &s.read_us, "End of the first row's exposure to the timestamp, us");
  root.option("--sensor", &s.sensor, "The twin's sensor model: off = prepared frames and tag",
              {.choices = {"off", "on"}});
  root.option("--store", &s.store, "Folder on the store to measure", {.type = "DIR"});
  root.option("--fps", &s.fps, "Instead of the rig file's");
  root.option("--exposure", &s.exposure_us, "Instead of the rig file's, us");
  root.option("--slow", &s.slow_ms, "Each frame's sync takes so many ms more");
  root.option("--lights", &s.n_lights, "Lights to capture");
  root.option("--buffers", &s.n_buffers, "Frames that the daemon may hold");
  root.option("--viewer", &s.viewer, "Somebody looks at the page's live view",
              {.choices = {"off", "on"}});
  root.option("--report", &s.report, "Write the figures as JSON", {.type = "FILE"});
  if (const auto end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  try {
    return haarlight::run(s);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
