// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig doctor|commission RIG.toml`: is everything there, and what does it really do?

#include "apps/haarlight/rig.h"

#include <chrono>
#include <csignal>
#include <cstdio>
#include <iostream>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "apps/haarlight/verb.h"
#include "capture/commission/commission.h"
#include "capture/commission/commission_page.h"
#include "capture/daemon/daemon_client.h"
#include "capture/doctor/rig_doctor.h"
#include "core/files.h"
#include "core/log.h"
#include "core/rig/measured_rig.h"

namespace haarlight {

namespace {

struct RigArguments {
  std::string rig;
  std::string camera;
  std::string page;
  int steps = CommissionOptions{}.fine_steps;
  bool flash_ok = false;
  bool timing_only = false;
  bool json = false;
};

/// The body of an answer from a local address; empty: nobody answers.
std::string fetch(const std::string& url) {
  const std::size_t path = url.find('/', url.find("//") + 2);
  try {
    DaemonClient client(
        {.url = url.substr(0, path), .token = {}, .timeout = std::chrono::milliseconds(1500)});
    const DaemonReply reply = client.get(url.substr(path));
    return reply.body.empty() ? fmt::format("HTTP {}", reply.status) : reply.body;
  } catch (const Error&) {
    return {};
  }
}

// ---- doctor ----

void print_lines(const std::vector<DoctorLine>& lines) {
  std::size_t width = 0;
  for (const DoctorLine& line : lines) {
    width = std::max(width, line.subject.size());
  }
  for (const DoctorLine& line : lines) {
    fmt::print("{:<7}  {:<{}}  {}\n", to_string(line.finding), line.subject, width, line.found);
    if (line.finding != Finding::good) {
      fmt::print("{:<7}  {:<{}}  expected: {}\n", "", "", width, line.expected);
      fmt::print("{:<7}  {:<{}}  cure: {}\n", "", "", width, line.cure);
    }
  }
}

ExitCode run_doctor(const RigArguments& arguments, Report& report) {
  DoctorOptions options;
  options.fetch = fetch;
  const std::vector<DoctorLine> lines = examine_rig(arguments.rig, options);
  nlohmann::json json = nlohmann::json::array();
  std::int64_t n_wrong = 0;
  std::int64_t n_warnings = 0;
  for (const DoctorLine& line : lines) {
    n_wrong += line.finding == Finding::wrong ? 1 : 0;
    n_warnings += line.finding == Finding::warning ? 1 : 0;
    json.push_back({{"subject", line.subject},
                    {"finding", to_string(line.finding)},
                    {"expected", line.expected},
                    {"found", line.found},
                    {"cure", line.cure}});
    report.add_detail(line.subject,
                      fmt::format("{}: {}{}{}", to_string(line.finding), line.found,
                                  line.cure.empty() ? "" : "; cure: ", line.cure));
  }
  report.add_reached("wrong", n_wrong);
  report.add_reached("warnings", n_warnings);
  if (arguments.json) {
    fmt::print("{}\n", json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  } else {
    print_lines(lines);
  }
  return n_wrong == 0 ? ExitCode::done : ExitCode::target_missed;
}

// ---- commission ----

/// Flashing is begun by a person who was told.
void require_consent(const RigArguments& arguments) {
  if (arguments.flash_ok) {
    return;
  }
  const std::string warning =
      "The lights will FLASH, several times a second, for minutes. Flashing light can cause\n"
      "epileptic seizures: nobody who might be at risk may see the rig, and nobody should "
      "look\n"
      "into it. Ctrl-C ends it at once, lights off.\n";
  if (::isatty(STDIN_FILENO) == 0) {
    throw Error("the lights will flash; nobody has agreed to it", arguments.rig,
                "clear the room of people at risk from flashing light, then give --flash-ok",
                ExitCode::usage);
  }
  fmt::print(stderr, "{}Type yes to begin: ", warning);
  std::fflush(stderr);
  std::string answer;
  std::getline(std::cin, answer);
  if (answer != "yes") {
    throw Error("not begun", arguments.rig, "type yes when the room is clear", ExitCode::usage);
  }
}

int camera_index(const Rig& rig, const std::string& id) {
  if (id.empty()) {
    return 0;
  }
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    if (rig.cameras[i].id == id) {
      return static_cast<int>(i);
    }
  }
  throw Error("the rig has no camera \"" + id + "\"", rig.file.string(),
              "name one of its [[camera]] ids", ExitCode::usage);
}

/// What an earlier file holds of other cameras stays, and of the lights when they were not
/// measured now; a file that cannot be read is replaced.
void keep_others(const std::filesystem::path& file, MeasuredRig& measured) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    return;
  }
  try {
    MeasuredRig old = parse_measured(read_file(file, 16U << 20U), file.string());
    if (!measured.lights) {
      measured.lights = std::move(old.lights);
    }
    measured.faces = std::move(old.faces);
    measured.planes = std::move(old.planes);
    for (MeasuredCamera& camera : old.cameras) {
      if (camera.id != measured.cameras.front().id) {
        measured.cameras.push_back(std::move(camera));
      } else {
        measured.cameras.front().lens = camera.lens;
      }
    }
  } catch (const Error& error) {
    log_warning(
        fmt::format("{}: replaced, it could not be read: {}", file.string(), error.problem()));
  }
}

volatile std::sig_atomic_t g_is_asked_to_end = 0;

/// SIGINT, SIGTERM and SIGHUP are asked for between frames instead of killing. This thread and
/// those it starts block them, so that no call of a driver is interrupted; a thread that a
/// library started when it was loaded (OpenBLAS does) does not, and runs the handler.
class PoliteSignals {
 public:
  PoliteSignals() {
    sigemptyset(&ends_);
    struct sigaction action = {};
    action.sa_handler = [](int) { g_is_asked_to_end = 1; };
    action.sa_flags = SA_RESTART;
    sigemptyset(&action.sa_mask);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
      sigaddset(&ends_, signal);
      sigaction(signal, &action, nullptr);
    }
    pthread_sigmask(SIG_BLOCK, &ends_, nullptr);
  }
  [[nodiscard]] bool is_asked_to_end() const {
    const timespec none{0, 0};
    return g_is_asked_to_end != 0 || sigtimedwait(&ends_, nullptr, &none) > 0;
  }

 private:
  sigset_t ends_{};
};

class CommissionProgress {
 public:
  explicit CommissionProgress(bool is_quiet) : is_quiet_(is_quiet) {}
  void operator()(std::string_view stage, double share) {
    const int percent = static_cast<int>(100.0 * share);
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

ExitCode run_commission(const RigArguments& arguments, const CommonOptions& common,
                        Report& report) {
  const Rig rig = read_rig_as_written(arguments.rig);
  const int index = camera_index(rig, arguments.camera);
  const std::filesystem::path file = measured_path(arguments.rig);
  std::filesystem::path page = arguments.page;
  if (page.empty()) {
    page = arguments.rig;
    page.replace_extension(".commission.html");
  }
  require_absent(file, common.force);
  require_absent(page, common.force);
  const std::string url = fmt::format(
      "http://{}:{}", rig.http.address == "0.0.0.0" ? "127.0.0.1" : rig.http.address,
      rig.http.port);
  if (!fetch(url + "/v1/state").empty()) {
    throw Error("a daemon answers at " + url + " and holds the devices", arguments.rig,
                "stop it first: systemctl stop haarlightd", ExitCode::unavailable);
  }
  require_consent(arguments);
  auto camera = make_camera(rig.cameras[static_cast<std::size_t>(index)]);
  if (!camera) {
    throw Error(camera.error().what, arguments.rig, "haarlight rig doctor tells what is wrong",
                ExitCode::unavailable);
  }
  auto lights = make_light_array(rig.controller, rig.n_lights());
  if (!lights) {
    throw Error(lights.error().what, arguments.rig, "haarlight rig doctor tells what is wrong",
                ExitCode::unavailable);
  }
  const PoliteSignals signals;
  CommissionOptions options;
  options.camera = index;
  options.fine_steps = arguments.steps;
  options.measures_noise = !arguments.timing_only;
  options.measures_lights = !arguments.timing_only;
  options.date = fmt::format(
      "{:%FT%TZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
  options.written_hash = rig.hash;
  options.should_stop = [&signals] { return signals.is_asked_to_end(); };
  options.progress = CommissionProgress(common.quiet);
  CommissionResult result = commission(rig, **camera, **lights, options);
  for (const CommissionRow& row : commission_rows(rig, index, result)) {
    fmt::print("{:<16} {:>18}{:<16} {}\n", row.name, row.measured,
               row.sigma.empty() ? "" : " +- " + row.sigma,
               row.written.empty() ? "" : "rig file: " + row.written);
  }
  for (const std::string& note : result.notes) {
    fmt::print("note: {}\n", note);
  }
  write_file_atomically(page, commission_page(rig, index, result));
  fmt::print("page: {}\n", page.string());
  const MeasuredCamera& c = result.measured.cameras.front();
  const auto add = [&report](const char* key, const std::optional<Measured>& m) {
    if (m) {
      report.add_reached(key, m->value);
      report.add_reached(std::string(key) + "_sigma", m->sigma);
    }
  };
  add("latch_us", result.measured.controller->latch_us);
  add("latch_most_us", result.measured.controller->latch_most_us);
  add("rise_us", result.measured.controller->rise_us);
  add("fall_us", result.measured.controller->fall_us);
  add("read_us", c.read_us);
  add("skew_us", c.skew_us);
  add("ready_us", c.ready_us);
  add("exposure_delay_frames", c.exposure_delay_frames);
  add("gain", c.gain_e_per_dn);
  add("read", c.read_e);
  add("full_well", c.full_well_e);
  add("black", c.black_dn);
  add("linearity_percent", c.linearity_percent);
  report.add_reached("timestamp", std::string(to_string(*c.timestamp)));
  report.add_detail("evidence", c.evidence);
  if (result.survey) {
    const auto numbers = [](const std::vector<int>& list) {
      return std::vector<double>(list.begin(), list.end());
    };
    report.add_reached("dead", numbers(result.survey->dead));
    report.add_reached("dim", numbers(result.survey->dim));
    report.add_reached("miswired", numbers(result.survey->miswired));
    report.add_reached("alike", numbers(result.survey->alike));
    report.add_reached("unplaced", numbers(result.survey->unplaced));
  }
  if (!result.contradictions.empty()) {
    for (const std::string& text : result.contradictions) {
      fmt::print(stderr, "haarlight rig: {}\n", text);
    }
    fmt::print(stderr, "  cure: correct {}, then commission again; nothing was stored\n",
               arguments.rig);
    return ExitCode::target_missed;
  }
  keep_others(file, result.measured);
  const std::string text = to_toml(result.measured);
  // What is written is what every program will read: prove it before it is there.
  (void)parse_rig(join_rig_text({rig.text, text}, file.string()), arguments.rig);
  write_file_atomically(file, text);
  report.set_bytes(text.size());
  fmt::print("measured values: {}\n", file.string());
  for (const std::string& fault : result.faults) {
    fmt::print(stderr, "haarlight rig: {}\n", fault);
  }
  if (!result.faults.empty()) {
    fmt::print(stderr,
               "  cure: mend the cables and LEDs, then commission again (--force). What was "
               "measured is stored and holds for the rig as it is\n");
    return ExitCode::target_missed;
  }
  return ExitCode::done;
}

}  // namespace

void add_rig_doctor(Command rig, Invocation& invocation) {
  auto arguments = std::make_shared<RigArguments>();
  Command verb = rig.add_verb(
      "doctor", "Tell what is there, what was expected, and the cure; lights nothing");
  verb.option("RIG", &arguments->rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.flag("--json", &arguments->json, "The table as JSON");
  verb.footer(
      "Exit code 1: something is wrong.\n"
      "Example:\n"
      "  haarlight rig doctor configs/rigs/small8.toml");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report& report) {
    report.add_input(arguments->rig);
    report.add_asked("action", std::string("doctor"));
    return run_doctor(*arguments, report);
  });
}

void add_rig_commission(Command rig, Invocation& invocation) {
  auto arguments = std::make_shared<RigArguments>();
  Command verb = rig.add_verb("commission",
                              "Measure delays, time stamps, noise and lights by flashing them");
  verb.option("RIG", &arguments->rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.option("--camera", &arguments->camera, "The camera that looks (default: the first)",
              {.type = "ID"});
  verb.flag("--flash-ok", &arguments->flash_ok,
            "Begin without asking; the room is clear of people at risk from flashing light");
  verb.flag("--timing-only", &arguments->timing_only,
            "Neither the camera's noise nor each light");
  verb.option("--steps", &arguments->steps, "Switches of the light at each of two exposures",
              {.bounds = Bounds{20, 2000}, .shows_default = true});
  verb.option("--page", &arguments->page,
              "The page with figures (default: NAME.commission.html)", {.type = "FILE"});
  verb.footer(
      "Writes NAME.measured.toml beside the rig file; every program then puts these values "
      "over\nthe written ones. The daemon must not be running. "
      "docs/reference/commissioning.md tells how to set up.\n"
      "Exit code 1: the rig file contradicts what was measured, or lights are dead, dim or "
      "swapped.\n"
      "Example:\n"
      "  haarlight rig commission configs/rigs/small8.toml --flash-ok");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    report.add_input(arguments->rig);
    report.add_asked("action", std::string("commission"));
    return run_commission(*arguments, common, report);
  });
}

}  // namespace haarlight
