// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission_pipeline.h"

#include <chrono>
#include <filesystem>
#include <utility>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include "capture/camera/camera.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/firmware_iface/light_array.h"

namespace haarlight::capture {

namespace {

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

/// Keeps an earlier file's values for other cameras, and for the lights if they were not
/// measured now; replaces a file that cannot be read.
/// @return  a warning; empty: none
std::string keep_others(const std::filesystem::path& file, MeasuredRig& measured) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    return {};
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
    return fmt::format("{}: replaced, it could not be read: {}", file.string(),
                       error.problem());
  }
  return {};
}

/// @throws Error(unavailable)  a daemon answers
void require_no_daemon(const CommissionRigOptions& options, const Rig& rig) {
  const std::string url = fmt::format(
      "http://{}:{}", rig.http.address == "0.0.0.0" ? "127.0.0.1" : rig.http.address,
      rig.http.port);
  if (!options.fetch(url + "/v1/state").empty()) {
    throw Error("a daemon answers at " + url + " and holds the devices", options.rig,
                "stop it first: systemctl stop haarlightd", ExitCode::unavailable);
  }
}

/// The device, or an Error saying why not.
template <typename Device>
std::unique_ptr<Device> take(Result<std::unique_ptr<Device>> made, const std::string& rig) {
  if (!made) {
    throw Error(made.error().what, rig, "haarlight rig doctor tells what is wrong",
                ExitCode::unavailable);
  }
  return std::move(*made);
}

CommissionResult measure_rig(const CommissionRigOptions& options, const Rig& rig, int index) {
  const std::unique_ptr<Camera> camera =
      take(make_camera(rig.cameras[static_cast<std::size_t>(index)]), options.rig);
  const std::unique_ptr<firmware_iface::LightArray> lights =
      take(firmware_iface::make_light_array(rig.controller, rig.n_lights()), options.rig);
  if (options.begin) {
    options.begin();
  }
  CommissionOptions how;
  how.camera = index;
  how.fine_steps = options.steps;
  how.measures_noise = !options.measures_timing_only;
  how.measures_lights = !options.measures_timing_only;
  how.date = fmt::format(
      "{:%FT%TZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
  how.written_hash = rig.hash;
  how.should_stop = options.should_stop;
  how.progress = options.progress;
  return commission(rig, *camera, *lights, how);
}

}  // namespace

CommissionRigSummary commission_rig(const CommissionRigOptions& options) {
  const Rig rig = read_rig_as_written(options.rig);
  const int index = camera_index(rig, options.camera);
  const std::filesystem::path file = measured_path(options.rig);
  std::filesystem::path page = options.page;
  if (page.empty()) {
    page = options.rig;
    page.replace_extension(".commission.html");
  }
  require_absent(file, options.may_overwrite);
  require_absent(page, options.may_overwrite);
  require_no_daemon(options, rig);
  if (options.require_consent) {
    options.require_consent();
  }
  CommissionRigSummary summary;
  summary.result = measure_rig(options, rig, index);
  summary.rows = commission_rows(rig, index, summary.result);
  summary.page = page.string();
  write_file_atomically(page, commission_page(rig, index, summary.result));
  if (!summary.result.contradictions.empty()) {
    return summary;
  }
  summary.warning = keep_others(file, summary.result.measured);
  const std::string text = to_toml(summary.result.measured);
  // Every program will read what is written: validate it before it is in place.
  (void)parse_rig(join_rig_text({rig.text, text}, file.string()), options.rig);
  write_file_atomically(file, text);
  summary.measured = file.string();
  summary.bytes = text.size();
  return summary;
}

std::string commission_text(const CommissionRigSummary& summary) {
  std::string text;
  for (const CommissionRow& row : summary.rows) {
    text += fmt::format("{:<16} {:>18}{:<16} {}\n", row.name, row.measured,
                        row.sigma.empty() ? "" : " +- " + row.sigma,
                        row.written.empty() ? "" : "rig file: " + row.written);
  }
  for (const std::string& note : summary.result.notes) {
    text += fmt::format("note: {}\n", note);
  }
  text += fmt::format("page: {}\n", summary.page);
  if (!summary.measured.empty()) {
    text += fmt::format("measured values: {}\n", summary.measured);
  }
  return text;
}

std::string commission_faults(const CommissionRigOptions& options,
                              const CommissionRigSummary& summary) {
  std::string text;
  const CommissionResult& result = summary.result;
  if (!result.contradictions.empty()) {
    for (const std::string& contradiction : result.contradictions) {
      text += fmt::format("haarlight rig: {}\n", contradiction);
    }
    return text + fmt::format("  hint: correct {}, then commission again; nothing was stored\n",
                              options.rig);
  }
  for (const std::string& fault : result.faults) {
    text += fmt::format("haarlight rig: {}\n", fault);
  }
  if (!result.faults.empty()) {
    text +=
        "  hint: mend the cables and LEDs, then commission again (--force). What was measured "
        "is stored and holds for the rig as it is\n";
  }
  return text;
}

void add_to_report(const CommissionRigSummary& summary, Report& report) {
  const CommissionResult& result = summary.result;
  const MeasuredCamera& c = result.measured.cameras.front();
  const auto add = [&report](const char* key, const std::optional<Measured>& m) {
    if (m) {
      report.add_achieved(key, m->value);
      report.add_achieved(std::string(key) + "_sigma", m->sigma);
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
  report.add_achieved("timestamp", std::string(to_string(*c.timestamp)));
  report.add_detail("evidence", c.evidence);
  if (result.survey) {
    const auto numbers = [](const std::vector<int>& list) {
      return std::vector<double>(list.begin(), list.end());
    };
    report.add_achieved("dead", numbers(result.survey->dead));
    report.add_achieved("dim", numbers(result.survey->dim));
    report.add_achieved("miswired", numbers(result.survey->miswired));
    report.add_achieved("alike", numbers(result.survey->alike));
    report.add_achieved("unplaced", numbers(result.survey->unplaced));
  }
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::capture
