// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/device_report.h"

#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;

std::string since(const DeviceState& device, std::int64_t now_ns) {
  const std::int64_t seconds = (now_ns - device.since_ns) / 1'000'000'000;
  return seconds < 120 ? fmt::format("for {} s", seconds)
                       : fmt::format("for {} min", seconds / 60);
}

DoctorLine report_controller(const Rig& rig, const DeviceState& state, std::int64_t now_ns) {
  const ControllerSpec& spec = rig.controller;
  DoctorLine line{"controller", Finding::good,
                  fmt::format("{} {}, {} elements",
                              spec.kind == ControllerKind::modbus_tcp   ? "Modbus TCP"
                              : spec.kind == ControllerKind::modbus_rtu ? "Modbus RTU"
                                                                        : "USB",
                              spec.address, rig.n_lights()),
                  ""};
  switch (state.link) {
    case DeviceState::Link::unused:
      line.found = "not queried yet: a run or a light for aiming connects it";
      break;
    case DeviceState::Link::good:
      line.found = "answers, " + since(state, now_ns);
      if (!state.problem.empty()) {  // it answered with a refusal
        line.finding = Finding::warning;
        line.found += "; it refused: " + state.problem;
        line.hint = HintText::light_fewer;
      }
      return line;
    case DeviceState::Link::lost:
      line.finding = Finding::wrong;
      line.found = fmt::format("lost {}: {}", since(state, now_ns), state.problem);
      line.hint = controller_hint(spec);
      return line;
  }
  if (!state.problem.empty()) {
    line.finding = Finding::wrong;
    line.found = state.problem;
    line.hint = controller_hint(spec);
  }
  return line;
}

DoctorLine report_camera(const CameraSpec& spec, const DeviceState& state, std::int64_t now_ns,
                         const DoctorOptions& options) {
  if (state.link == DeviceState::Link::good) {
    return {"camera " + spec.id, Finding::good,
            fmt::format("{} x {} at {:g} fps", spec.frame_width, spec.frame_height, spec.fps),
            "delivers frames, " + since(state, now_ns)};
  }
  // Nothing has it open: its presence can be checked from outside.
  DoctorLine line = find_camera(spec, options).line;
  if (state.link == DeviceState::Link::lost) {
    const Fault fault{
        .code = state.code, .what = state.problem, .sys_errno = 0, .file = "", .line = 0};
    if (line.finding == Finding::good) {
      line.hint = state.code == Errc::device_gone || state.code == Errc::timeout
                      ? HintText::check_camera_power
                      : camera_hint(spec, fault);
    }
    line.finding = Finding::wrong;
    line.found = fmt::format("lost {}: {}", since(state, now_ns), state.problem);
  } else if (line.finding == Finding::good) {
    line.found = "is there, and rests";
  }
  return line;
}

DoctorLine report_disk(const Rig& rig, const fs::path& sessions) {
  DoctorLine line{
      "disk", Finding::good,
      fmt::format("{:.0f} MB free beside a plan's own need", rig.storage.reserve_mb), ""};
  std::error_code error;
  const fs::space_info space = fs::space(sessions, error);
  if (error) {
    line.finding = Finding::wrong;
    line.found = fmt::format("{}: {}", sessions.string(), error.message());
    line.hint = HintText::mount_disk;
    return line;
  }
  const double free_mb = 1e-6 * static_cast<double>(space.available);
  line.found = fmt::format("{:.1f} GB free in {}", 1e-3 * free_mb, sessions.string());
  if (free_mb < rig.storage.reserve_mb) {
    line.finding = Finding::wrong;
    line.hint = HintText::free_space;
  }
  return line;
}

}  // namespace

std::vector<DoctorLine> report_devices(const Rig& rig, const fs::path& sessions,
                                       const DeviceState& controller, const DeviceState& camera,
                                       std::int64_t now_ns, const DoctorOptions& options) {
  std::vector<DoctorLine> lines{report_controller(rig, controller, now_ns)};
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    // The daemon operates the first.
    lines.push_back(
        report_camera(rig.cameras[i], i == 0 ? camera : DeviceState{}, now_ns, options));
  }
  lines.push_back(report_disk(rig, sessions));
  for (DoctorLine& line : examine_clock(options)) {
    lines.push_back(std::move(line));
  }
  if (!rig.file.empty()) {
    for (DoctorLine& line : examine_measured(rig.file)) {
      lines.push_back(std::move(line));
    }
  }
  return lines;
}

}  // namespace haarlight::capture
