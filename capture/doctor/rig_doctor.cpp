// SPDX-License-Identifier: Apache-2.0
#include "capture/doctor/rig_doctor.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <fstream>
#include <system_error>

#include <fcntl.h>
#include <fmt/format.h>
#include <time.h>  // NOLINT(modernize-deprecated-headers): clock_getres is POSIX
#include <unistd.h>

#include "capture/camera/camera.h"
#include "capture/camera/v4l2_camera.h"
#include "capture/camera/v4l2_list.h"
#include "core/counted.h"
#include "core/order_statistics.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr double kRateTol = 0.03;        // of the frame rate; free-running cameras hold 0.1 %
constexpr double kFramesPerLight = 2.3;  // a camera that runs freely, rolling shutter

std::string first_line(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return line;
}

/// Nothing: `node` may be opened.
Hint access_hint(const fs::path& node, const std::string& group) {
  if (::access(node.c_str(), R_OK | W_OK) == 0) {
    return {};
  }
  return errno == EACCES ? Hint(HintText::join_group, {group, group})
                         : Hint(HintText::open_camera, {std::strerror(errno)});
}

/// "is /dev/v4l/by-id/usb-... (HD Camera, serial 1234), ...".
std::string cameras_there(const std::vector<V4l2Description>& cameras) {
  std::vector<std::string> words;
  words.reserve(cameras.size());
  for (const V4l2Description& camera : cameras) {
    words.push_back(
        fmt::format("{} ({})", camera.links.empty() ? camera.node : camera.links.front(),
                    camera.problem.empty() ? identity_text(camera.identity) : camera.problem));
  }
  return words.empty() ? "is none" : fmt::format("is {}", fmt::join(words, ", "));
}

double megabytes(std::uintmax_t bytes) { return static_cast<double>(bytes) / 1e6; }

struct FramesSeen {
  int n = 0;
  int n_bad = 0;
  int n_gaps = 0;
  bool is_monotonic = true;
  double fps = 0.0;  ///< 0: unknown
};

/// @return  why fewer than `n` frames came
std::optional<Fault> watch_frames(Camera& device, const CameraSpec& spec, int n,
                                  FramesSeen& seen) {
  std::vector<double> periods;
  std::int64_t last_timestamp = 0;
  std::uint64_t last_sequence = 0;
  for (; seen.n < n; ++seen.n) {
    const auto frame = device.next(
        Clock::now() + std::chrono::seconds(2) +
        std::chrono::milliseconds(static_cast<int>(4e3 / std::max(spec.fps, 0.01))));
    if (!frame) {
      return frame.error();
    }
    const FrameInfo& info = frame->info();
    seen.n_bad += (info.flags & (kFrameError | kFrameShort)) != 0U ? 1 : 0;
    seen.is_monotonic = seen.is_monotonic && (info.flags & kFrameMonotonic) != 0U;
    if (seen.n > 0 && info.sequence > last_sequence) {
      seen.n_gaps += static_cast<int>(info.sequence - last_sequence) - 1;
      periods.push_back(static_cast<double>(info.timestamp_ns - last_timestamp) / 1e9 /
                        static_cast<double>(info.sequence - last_sequence));
    }
    last_timestamp = info.timestamp_ns;
    last_sequence = info.sequence;
  }
  seen.fps = periods.empty() ? 0.0 : 1.0 / upper_median(periods);
  return std::nullopt;
}

/// Whether measurements can rest on what the camera sends.
void classify_camera(const CameraSpec& spec, const CameraSetup& setup, const FramesSeen& seen,
                     DoctorLine& line) {
  if (setup.use != PixelUse::measurement) {
    const bool is_kept = setup.use == PixelUse::display;
    line.finding = is_kept ? Finding::warning : Finding::wrong;
    line.hint = is_kept ? HintText::choose_raw_if_there : HintText::choose_raw;
  } else if (!seen.is_monotonic) {
    line.finding = Finding::wrong;
    line.hint = HintText::use_monotonic_driver;
  } else if (seen.n_bad > 0) {
    line.finding = Finding::wrong;
    line.hint = HintText::improve_usb;
  } else if (std::abs(seen.fps / spec.fps - 1.0) > kRateTol) {
    line.finding = Finding::warning;
    line.hint = {HintText::write_fps, {fmt::format("{:.2f}", seen.fps)}};
  } else if (std::abs(setup.exposure_us - spec.exposure_us) >
             std::max(1.0, 0.01 * spec.exposure_us)) {
    line.finding = Finding::warning;
    line.hint = {HintText::write_exposure, {fmt::format("{:g}", setup.exposure_us)}};
  } else if (seen.n_gaps > 0) {
    line.finding = Finding::warning;
    line.hint = HintText::unburden_usb;
  }
}

}  // namespace

bool is_healthy(const std::vector<DoctorLine>& lines) {
  return std::none_of(lines.begin(), lines.end(),
                      [](const DoctorLine& l) { return l.finding == Finding::wrong; });
}

std::vector<DoctorLine> examine_measured(const fs::path& rig_file) {
  DoctorLine line{"measured values", Finding::good, measured_path(rig_file).filename().string(),
                  ""};
  try {
    const Rig rig = read_rig(rig_file);
    if (rig.measured == nullptr) {
      line.finding = Finding::warning;
      line.found = "none: the rig file's own delays and noise are used";
      line.hint = {HintText::measure, {rig_file.string()}};
    } else {
      const std::string changes = describe_changes(read_rig_as_written(rig_file), rig);
      line.found = fmt::format("of {}; {}", rig.measured->date,
                               changes.empty() ? "as the rig file says" : changes);
      if (const MeasuredGap gap = find_gap(*rig.measured); !gap.problem.empty()) {
        line.finding = Finding::warning;
        line.found += "; " + gap.problem;
        line.hint = {HintText::measure_again, {rig_file.string()}};
      }
    }
  } catch (const Error& error) {
    line.finding = Finding::wrong;
    line.found = error.problem();
    line.hint = Hint(error);
  }
  return {line};
}

std::vector<DoctorLine> examine_clock(const DoctorOptions& options) {
  DoctorLine line{"clock", Finding::good, "a clock of nanoseconds that never jumps", ""};
  timespec resolution{};
  ::clock_getres(CLOCK_MONOTONIC, &resolution);
  const std::string source = first_line(
      options.root / "sys/devices/system/clocksource/clocksource0/current_clocksource");
  line.found = fmt::format("{}, CLOCK_MONOTONIC resolves {} ns",
                           source.empty() ? "clock source unknown" : source,
                           resolution.tv_sec * 1'000'000'000 + resolution.tv_nsec);
  if (resolution.tv_sec > 0 || resolution.tv_nsec > 1000) {
    line.finding = Finding::wrong;
    line.hint = HintText::use_fine_timers;
  } else if (source == "jiffies" || source == "refined-jiffies" || source == "acpi_pm" ||
             source == "hpet") {
    line.finding = Finding::warning;
    line.hint = HintText::mend_clock_source;
  }
  return {line};
}

std::vector<DoctorLine> examine_daemon(const Rig& rig, const DoctorOptions& options,
                                       bool& holds_devices) {
  DoctorLine line{"daemon", Finding::good, "", ""};
  holds_devices = false;
  const std::string url = fmt::format("http://{}:{}", rig.http.address, rig.http.port);
  line.expected = "haarlightd or nothing on " + url;
  const std::string body = options.fetch ? options.fetch(url + "/v1/state") : std::string();
  if (body.empty()) {
    line.found = "nobody answers: no daemon runs";
  } else if (body.find("\"phase\"") != std::string::npos ||
             body.find("\"error\"") != std::string::npos) {
    holds_devices = true;
    line.found = "haarlightd answers: it holds camera and controller, which are not examined";
    line.finding = Finding::warning;
    line.hint = HintText::stop_daemon;
  } else {
    line.finding = Finding::wrong;
    line.found = "another program answers";
    line.hint = HintText::free_http_port;
  }
  return {line};
}

CameraPresence find_camera(const CameraSpec& spec, const DoctorOptions& options) {
  CameraPresence presence{
      {"camera " + spec.id, Finding::good,
       fmt::format("{} on {}: {} x {} at {:g} fps",
                   spec.kind == CameraKind::v4l2     ? "v4l2"
                   : spec.kind == CameraKind::remote ? "remote"
                                                     : "replay",
                   spec.device, spec.frame_width, spec.frame_height, spec.fps),
       ""},
      spec.device};
  const auto wrong = [&presence](std::string found, Hint hint) {
    presence.line.finding = Finding::wrong;
    presence.line.found = std::move(found);
    presence.line.hint = std::move(hint);
    return presence;
  };
  std::error_code failed;
  const bool is_v4l2 = spec.kind == CameraKind::v4l2;
  const V4l2Paths paths{options.root / "dev", options.root / "sys"};
  if (is_v4l2 && !spec.v4l2.serial.empty()) {
    // Whatever its node is now.
    presence.line.expected += fmt::format(", serial number {}", spec.v4l2.serial);
    const auto found = find_v4l2_camera(spec.device, {}, spec.v4l2.serial, paths);
    if (!found) {
      return wrong(found.error().what,
                   Hint(HintText::plug_in_serial, {cameras_there(list_v4l2_cameras(paths))}));
    }
    presence.node = found->node();
  } else if (!fs::exists(presence.node, failed)) {
    const std::vector<V4l2Description> others =
        is_v4l2 ? list_v4l2_cameras(paths) : std::vector<V4l2Description>{};
    return wrong("no such device or socket",
                 !others.empty() ? Hint(HintText::set_device, {cameras_there(others)})
                 : is_v4l2       ? HintText::plug_in_camera
                 : spec.kind == CameraKind::remote ? HintText::start_camera_program
                                                   : HintText::name_session);
  }
  if (is_v4l2) {
    if (const Hint hint = access_hint(presence.node, "video"); !hint.is_empty()) {
      return wrong(fmt::format("{} cannot be opened", presence.node), hint);
    }
  } else if (spec.kind == CameraKind::remote && !fs::is_socket(spec.device, failed)) {
    return wrong("it is there, but it is no socket", HintText::name_socket);
  }
  return presence;
}

Hint camera_hint(const CameraSpec& spec, const Fault& fault) {
  // A server that already has a client hangs up on the second one.
  const bool is_held = fault.code == Errc::device_busy ||
                       (fault.code == Errc::device_gone && spec.kind == CameraKind::remote &&
                        fault.sys_errno != ECONNREFUSED) ||
                       fault.what.find(fmt::format("errno {}", EBUSY)) != std::string::npos;
  return is_held                           ? HintText::end_camera_user
         : fault.code == Errc::device_gone ? HintText::start_program_again
         : fault.code == Errc::refused     ? HintText::correct_camera
                                           : HintText::plug_camera_again;
}

std::vector<DoctorLine> examine_camera(const Rig& rig, int camera,
                                       const DoctorOptions& options) {
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(camera));
  CameraPresence presence = find_camera(spec, options);
  DoctorLine& line = presence.line;
  if (line.finding != Finding::good) {
    return {line};
  }
  const auto wrong = [&line](std::string found, Hint hint) {
    line.finding = Finding::wrong;
    line.found = std::move(found);
    line.hint = std::move(hint);
    return std::vector<DoctorLine>{line};
  };
  const bool is_v4l2 = spec.kind == CameraKind::v4l2;
  const V4l2Paths paths{options.root / "dev", options.root / "sys"};
  Result<std::unique_ptr<Camera>> device =
      is_v4l2 ? Result<std::unique_ptr<Camera>>(std::make_unique<V4l2Camera>(paths))
              : make_camera(spec);
  if (!device) {
    return wrong(device.error().what, HintText::correct_camera_kind);
  }
  auto setup = (*device)->start(spec);
  if (!setup) {
    return wrong(setup.error().what, camera_hint(spec, setup.error()));
  }
  try {
    require_measured_camera(rig, spec.id, setup->identity);
  } catch (const Error& error) {
    return wrong(error.problem(), Hint(error));
  }
  FramesSeen seen;
  if (const std::optional<Fault> fault =
          watch_frames(**device, spec, options.camera_frames, seen)) {
    return wrong(
        fmt::format("{} frames came, then: {}", seen.n, fault->what),
        fault->code == Errc::timeout ? HintText::check_trigger : HintText::check_camera_cable);
  }
  (*device)->stop();
  line.found = fmt::format(
      "{}: {} x {} at {:.2f} fps, {} buffers; of {} frames {} damaged, {} "
      "lost; exposure {:g} us",
      setup->identity, setup->width, setup->height, seen.fps, setup->n_buffers,
      options.camera_frames, seen.n_bad, seen.n_gaps, setup->exposure_us);
  classify_camera(spec, *setup, seen, line);
  return {line};
}

std::vector<DoctorLine> examine_storage(const Rig& rig, const DoctorOptions& options) {
  fs::path folder = rig.storage.folder;
  if (folder.is_relative()) {
    folder = rig.file.parent_path() / folder;
  }
  DoctorLine line{"disk", Finding::good, "", ""};
  double rate = 0.0;
  for (const CameraSpec& c : rig.cameras) {
    rate += 2.0 * c.frame_width * c.frame_height * c.fps / kFramesPerLight;
  }
  line.expected = fmt::format("sessions in {}, {:.0f} MB free, {:.1f} MB/s", folder.string(),
                              rig.storage.reserve_mb, rate / 1e6);
  std::error_code failed;
  fs::path existing = fs::absolute(folder);
  while (!existing.empty() && !fs::exists(existing, failed) &&
         existing != existing.root_path()) {
    existing = existing.parent_path();
  }
  if (!fs::is_directory(existing, failed)) {
    line.finding = Finding::wrong;
    line.found = existing.string() + " is not a folder";
    line.hint = HintText::correct_storage;
    return {line};
  }
  const fs::space_info space = fs::space(existing, failed);
  const fs::path test = existing / fmt::format(".haarlight-doctor-{}", ::getpid());
  const Fd fd(::open(test.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600));
  if (!fd.is_open()) {
    line.finding = Finding::wrong;
    line.found = fmt::format("{}: {}", existing.string(), std::strerror(errno));
    line.hint = HintText::permit_storage;
    return {line};
  }
  const std::uint64_t bytes =
      std::min<std::uint64_t>(options.disk_test_bytes, space.available / 4);
  const std::vector<char> block(1U << 20U, 'x');
  const auto begin = Clock::now();
  std::uint64_t done = 0;
  int problem = 0;
  while (done < bytes && problem == 0) {
    const ssize_t n =
        ::write(fd.get(), block.data(), std::min<std::uint64_t>(block.size(), bytes - done));
    problem = n < 0 ? errno : 0;
    done += n > 0 ? static_cast<std::uint64_t>(n) : 0;
  }
  if (problem == 0 && ::fdatasync(fd.get()) != 0) {
    problem = errno;
  }
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  fs::remove(test, failed);
  const double speed = seconds > 0.0 ? megabytes(done) / seconds : 0.0;
  line.found =
      fmt::format("{:.0f} MB free, writes {:.0f} MB/s", megabytes(space.available), speed);
  if (problem != 0) {
    line.finding = Finding::wrong;
    line.found += fmt::format("; a test write failed: {}", std::strerror(problem));
    line.hint = HintText::replace_disk;
  } else if (megabytes(space.available) < rig.storage.reserve_mb) {
    line.finding = Finding::wrong;
    line.hint = HintText::make_room;
  } else if (speed < rate / 1e6) {
    line.finding = Finding::warning;
    line.hint = HintText::use_faster_disk;
  }
  return {line};
}

std::vector<DoctorLine> examine_rig(const fs::path& rig_file, const DoctorOptions& options) {
  const Rig rig = read_rig_as_written(rig_file);
  std::vector<DoctorLine> lines;
  const auto add = [&lines](std::vector<DoctorLine> more) {
    lines.insert(lines.end(), std::make_move_iterator(more.begin()),
                 std::make_move_iterator(more.end()));
  };
  lines.push_back({"rig file", Finding::good, "readable, every key known",
                   fmt::format("{}: {}, {}", rig.name, counted(rig.n_lights(), "light"),
                               counted(rig.cameras.size(), "camera"))});
  add(examine_measured(rig_file));
  add(examine_clock(options));
  bool is_held = false;
  add(examine_daemon(rig, options, is_held));
  if (!is_held) {
    // Identities are compared with the measured ones, where those are usable.
    Rig measured = rig;
    try {
      measured = read_rig(rig_file);
    } catch (const Error&) {
      measured = rig;  // already reported by examine_measured
    }
    add(examine_controller(measured, options));
    for (std::size_t i = 0; i < measured.cameras.size(); ++i) {
      add(examine_camera(measured, static_cast<int>(i), options));
    }
  }
  add(examine_storage(rig, options));
  return lines;
}

}  // namespace haarlight::capture
